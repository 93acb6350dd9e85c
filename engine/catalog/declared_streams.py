"""Streams that people declare and annotate ([Introspection15 §4.2], SPEC §3).

What a stream is to be, what it contains, and what of it is remembered over a restart.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping

from pyoxigraph import NamedNode

from ...converters.to_triples import SampleConverter
from ...converters.values import field_type
from ...languages.ssl.annotation import Role, StreamAnnotation
from ...ontology.graphs import STREAM_SPACE_ONTOLOGY
from ...ontology.ontology import Ontology
from ...ontology.units import Unit
from ...rdf.dictionary import TermDictionary
from ...rdf.namespaces import DYKNOW
from ...streams.generator import StreamGenerator
from ...streams.history import Retention
from ...streams.sample import TIME_FIELDS, Field, FieldType, Schema
from ...streams.string_pool import StringPool
from ...streams.time import HOUR
from ..configuration.configuration import (
    BUILT_IN,
    C_SPARQL,
    MERGE,
    RETENTION,
    SELECT_INSTANCE,
    SELECT_OBJECT,
    SYNCHRONIZE,
    Configuration,
)
from ..model.errors import BadArguments, Conflict, Refused
from ..model.status_changes import Change, ChangeKind
from ..model.status_stream import STATUS
from ..model.views import StreamDeclaration
from ..units.late_streams import LATE
from ..units.violations import SUFFIX
from .semantics_manager import term
from .transformation_library import IMPLEMENTATIONS

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")
_SYSTEM = (STATUS, SELECT_OBJECT, SELECT_INSTANCE, SYNCHRONIZE, MERGE, C_SPARQL, *BUILT_IN)
SYSTEMS_OWN = "dyknow_"
"""Names of streams and units that the system invents begin so."""


class DeclaredStreams:
    """The streams that people declared, and their annotations."""

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        configuration: Configuration,
        changed: Callable[[Change], None],
    ) -> None:
        self._ontology = ontology
        self._dictionary = dictionary
        self._configuration = configuration
        self._changed = changed
        self._annotations: dict[str, StreamAnnotation] = {}

    def declare(self, declaration: StreamDeclaration) -> StreamGenerator:
        """Make a stream, or change one; its annotation stays.

        The same declaration again changes nothing. While a stream is in use, it can get further
        fields, and another lateness, idle time, bound ahead and retention. Raises `Conflict` when
        anything else of a stream with samples or subscribers would change, `Refused` for a name
        that is not the user's to give, `BadArguments` for a namespace that is no IRI and for an
        ``idle`` of 0.
        """
        self.check_stream_name(declaration.name)
        schema = Schema(declaration.fields)
        if not schema.fields:
            raise Refused("a stream has at least one field", 'give "fields": [{"name", "type"}]')
        for name in schema.names:
            if name in TIME_FIELDS:
                raise Refused(f"a field cannot be called {name!r}: that is a sample's time")
        try:
            NamedNode(declaration.namespace)
        except ValueError as error:
            raise BadArguments(
                f"the namespace {declaration.namespace!r} is no IRI: {error}",
                f"objects of an id field are named in it, for example {DYKNOW}",
            ) from error
        if declaration.idle is not None and declaration.idle <= 0:
            raise BadArguments(
                "a stream is idle after longer than nothing",
                'give "idle" a time such as "10s", or leave it out: then it is always waited for',
            )
        if declaration.name in self._configuration.units or (
            declaration.name in self._configuration.late
        ):
            raise Refused(f"stream {declaration.name!r} is made by the system")
        existing = self._configuration.streams.get(declaration.name)
        if existing is None:
            existing = self._add(declaration)
        elif self._declaration(existing) == declaration:
            return existing
        elif self._extends(existing, declaration):
            self._extend(existing, declaration)
        else:
            existing = self._replace(existing, declaration)
        self._ontology.registered.streams[declaration.name] = _declaration_json(declaration)
        return existing

    def _extends(self, existing: StreamGenerator, declaration: StreamDeclaration) -> bool:
        """Whether the stream can become what the declaration says while it is in use."""
        return (
            not existing.is_open
            and self._configuration.namespaces[existing.name] == declaration.namespace
            and set(existing.schema.fields) <= set(declaration.fields)
        )

    def _extend(self, existing: StreamGenerator, declaration: StreamDeclaration) -> None:
        """Give the stream what `_extends` allows."""
        schema = Schema(declaration.fields)
        if existing.schema != schema:
            existing.widen(schema)
        existing.lateness, existing.ahead = declaration.lateness, declaration.ahead
        if existing.idle != declaration.idle:
            existing.idle = declaration.idle
            existing.wake()  # whether it is idle now is judged anew
        for each in (existing, existing.late_stream):
            if each is not None and each.stream.retention != declaration.retention:
                each.stream.retention = declaration.retention
                each.forget_texts()

    def _replace(
        self, existing: StreamGenerator, declaration: StreamDeclaration
    ) -> StreamGenerator:
        """A stream without samples and subscribers is made anew; its annotation stays."""
        self._refuse_if_in_use(existing, declaration)
        annotation = self.annotation_of(declaration.name)
        if annotation is not None:
            self._check_fields(annotation, Schema(declaration.fields))
        self._configuration.remove_stream(declaration.name)
        made = self._add(declaration)
        if annotation is not None:
            self._tell_annotation(annotation)
        return made

    def remove(self, name: str) -> None:
        """Forget a stream, its annotation and what is kept of both; raises `Conflict` while a unit
        reads it."""
        readers = self._configuration.readers_of(name)
        if readers:
            raise Conflict(
                f"stream {name!r} is read by {', '.join(readers)}",
                "cancel the requests that need it first",
            )
        self.forget_annotation(name)
        self._ontology.registered.streams.pop(name, None)
        self._configuration.remove_stream(name)

    def forget_annotation(self, name: str) -> None:
        """A stream is no more, and so is what it meant."""
        if self._annotations.pop(name, None) is not None:
            del self._ontology.registered.annotations[name]

    def annotate(self, annotation: StreamAnnotation, kept: str | None = None) -> None:
        """Say what a stream contains; one that does not exist comes into being. ``kept`` is the
        text that is remembered, where it is not the annotation's own. Contract:
        `check_annotation` has passed."""
        self._annotations[annotation.stream] = annotation
        existing = self._configuration.streams.get(annotation.stream)
        inferred = self._inferred(annotation)
        if existing is None:
            self._add(StreamDeclaration(annotation.stream, inferred, retention=RETENTION))
        elif existing.is_open:
            texts = [field.name for field in inferred if field.type is FieldType.STRING]
            existing.adopt(Schema(inferred), {name: StringPool() for name in texts})
        self._ontology.registered.annotations[annotation.stream] = kept or annotation.source
        self._tell_annotation(annotation)

    def _tell_annotation(self, annotation: StreamAnnotation) -> None:
        self._changed(
            Change(
                ChangeKind.STREAM_ANNOTATED,
                annotation.stream,
                specification=annotation.source,
                annotation=annotation,
            )
        )

    def name_of(self, stream: str) -> str:
        """The stream's own name, of an alias too; raises `UnknownStream`."""
        return self._configuration.stream(stream).name

    def annotations(self) -> tuple[StreamAnnotation, ...]:
        """What people said of streams, in order."""
        return tuple(self._annotations.values())

    def annotation_of(self, name: str) -> StreamAnnotation | None:
        """What stream ``name`` contains; None where nobody has said."""
        return self._annotations.get(name)

    def compile(
        self, annotation: StreamAnnotation, schema: Schema, namespace: str
    ) -> SampleConverter:
        """The converter of a stream's samples to triples, whose values are in the unit of their
        feature, as queries see them; raises `ConversionError`."""
        vocabulary = self._ontology.vocabulary
        units: dict[str, Unit] = {}
        for content in annotation.contents:
            info = vocabulary.feature(content.feature)
            if info is not None and info.unit is not None:
                units[content.feature] = info.unit
        return SampleConverter(
            annotation, schema, vocabulary, self._dictionary, namespace=namespace, units=units
        )

    def restore_streams(self) -> None:
        """The streams that an earlier run was told of.

        What cannot be read or does not hold any more (the ontology has changed since) is told on
        the status stream and left out; its text is kept.
        """
        for name, text in [*self._ontology.registered.streams.items()]:
            try:
                declaration = _declaration_of(name, text)
            except (KeyError, TypeError, ValueError) as error:
                reason = f"{type(error).__name__}: {error}\n{text}"
                self._changed(Change(ChangeKind.NOT_RESTORED, name, specification=reason))
                continue
            self._add(declaration)

    def _add(self, declaration: StreamDeclaration) -> StreamGenerator:
        return self._configuration.add_stream(
            declaration.name,
            Schema(declaration.fields),
            lateness=declaration.lateness,
            retention=declaration.retention,
            namespace=declaration.namespace,
            idle=declaration.idle,
            ahead=declaration.ahead,
        )

    def check_stream_name(self, name: str) -> None:
        """Raises `Refused` for what is no name of a stream that people may declare."""
        if not _NAME.match(name):
            raise Refused(
                f"{name!r} is no stream name", "letters, digits and _; the first is a letter"
            )
        self.check_name(name)

    def check_name(self, name: str) -> None:
        """Raises `Refused` for names that are the system's own."""
        if (
            name in _SYSTEM
            or name.startswith(SYSTEMS_OWN)
            or name.endswith(SUFFIX)
            or (name.endswith(LATE) and name not in self._ontology.registered.streams)
            or name in IMPLEMENTATIONS
            or self._is_term(name)
        ):
            raise Refused(f"{name!r} is the system's own name", "choose another name")

    def is_as_declared(self, declaration: StreamDeclaration) -> bool:
        """Whether there is the very stream of the declaration."""
        existing = self._configuration.streams.get(declaration.name)
        return existing is not None and self._declaration(existing) == declaration

    def _is_term(self, name: str) -> bool:
        """Streams, units and transformations are individuals beside the terms of the ontology."""
        said = self._ontology.static_store.quads_for_pattern(
            term(name), None, None, STREAM_SPACE_ONTOLOGY
        )
        return next(said, None) is not None

    def _refuse_if_in_use(self, generator: StreamGenerator, declaration: StreamDeclaration) -> None:
        late = self._configuration.late.belonging_to(generator.name)
        served = [generator, *(self._configuration.streams[name] for name in late)]
        subscribers = sum(each.subscribers for each in served)
        if not generator.counters.accepted and not subscribers:
            return
        found, hint = self._contradiction(generator, declaration)
        raise Conflict(
            f"stream {generator.name!r} is in use ({generator.counters.accepted} samples, "
            f"{subscribers} subscribers), and {found}",
            hint,
        )

    def _contradiction(
        self, generator: StreamGenerator, declaration: StreamDeclaration
    ) -> tuple[str, str]:
        """Why a declaration cannot be that of a stream in use, and what to do."""
        said = Schema(declaration.fields)
        for field in generator.schema.fields:
            other = said.get(field.name)
            if other is None:
                return (
                    f"the declaration lacks its field {field.name!r}",
                    "declare all of its fields (a sample may have null in any of them) and new "
                    "ones as you like, or choose another stream name",
                )
            if other.type is not field.type:
                return (
                    f"its field {field.name!r} is {field.type}, not {other.type}",
                    f"declare {field.name!r} as {field.type}, or choose another stream name",
                )
        namespace = self._configuration.namespaces[generator.name]
        return (
            f"the objects of its id fields are in the namespace {namespace}",
            "declare that namespace, or choose another stream name",
        )

    def _declaration(self, generator: StreamGenerator) -> StreamDeclaration:
        return StreamDeclaration(
            generator.name,
            generator.schema.fields,
            generator.lateness,
            generator.stream.retention,
            self._configuration.namespaces[generator.name],
            generator.idle,
            generator.ahead,
        )

    def check_annotation(self, annotation: StreamAnnotation) -> None:
        """Whether the stream may be annotated so; raises `Refused` and `Conflict`."""
        self.check_stream_name(annotation.stream)
        name = annotation.stream
        other = self._configuration.aliases.get(name)
        if other is not None:
            raise Refused(f"{name!r} is another name of {other!r}", "annotate that")
        if name in self._configuration.named:
            raise Refused(
                f"stream {name!r} is made by a specification",
                "annotate its transformation: that says what its streams contain",
            )
        existing = self._configuration.streams.get(name)
        if existing is not None and existing.is_open and name in self._configuration.units:
            raise Conflict(
                f"the fields of stream {name!r} are not known before its first sample",
                "declare the sort of its values, or annotate it later",
            )
        if existing is None or existing.is_open:
            schema = Schema(self._inferred(annotation))
        else:
            schema = existing.schema
        self._check_fields(annotation, schema)

    def check_fields(self, annotation: StreamAnnotation) -> None:
        """Whether a stream that is there has the fields that its annotation speaks of; raises
        `UnknownStream` and `Conflict`."""
        self._check_fields(annotation, self._configuration.stream(annotation.stream).schema)

    def _check_fields(self, annotation: StreamAnnotation, schema: Schema) -> None:
        """The annotation's fields must exist, its id fields must be text or integers."""
        for name, role in _fields_of(annotation):
            field = schema.get(name)
            if field is None:
                raise Conflict(
                    f"stream {annotation.stream!r} has no field {name!r}",
                    f"its fields are {', '.join(schema.names)}",
                )
            if role is not None and field.type not in (FieldType.STRING, FieldType.INTEGER):
                raise Conflict(
                    f"field {name!r} of stream {annotation.stream!r} is {field.type}, "
                    "it cannot name objects",
                    "an id field is a string or an integer",
                )
        self.compile(annotation, schema, DYKNOW)

    def _inferred(self, annotation: StreamAnnotation) -> tuple[Field, ...]:
        """Fields for a stream that only its annotation describes: id fields are text, the others
        have the type of their feature's range."""
        types: dict[str, FieldType] = {}
        features = {content.field: content.feature for content in annotation.contents}
        for name, role in _fields_of(annotation):
            if role is not None:
                types[name] = FieldType.STRING
            else:
                info = self._ontology.vocabulary.feature(features[name])
                types.setdefault(name, field_type(None if info is None else info.range))
        return tuple(Field(name, type) for name, type in types.items())


def _fields_of(annotation: StreamAnnotation) -> Iterator[tuple[str, Role | None]]:
    """The fields an annotation speaks of, with the role of those that name objects."""
    for content in annotation.contents:
        for role in content.roles:
            if role.id_field is not None:
                yield role.id_field, role
        yield content.field, None


def _declaration_json(declaration: StreamDeclaration) -> str:
    kept = declaration.retention
    return json.dumps(
        {
            "fields": [[field.name, str(field.type)] for field in declaration.fields],
            "lateness": declaration.lateness,
            "retention": [kept.samples, kept.age, *([] if kept.bytes is None else [kept.bytes])],
            "namespace": declaration.namespace,
            "idle": declaration.idle,
            "ahead": declaration.ahead,
        }
    )


def _declaration_of(name: str, text: str) -> StreamDeclaration:
    stored: Mapping[str, object] = json.loads(text)
    fields, retention = stored["fields"], stored["retention"]
    # What was kept before there were these has none of them.
    idle, ahead = stored.get("idle"), stored.get("ahead", HOUR)
    assert isinstance(fields, list)
    assert isinstance(retention, list)
    return StreamDeclaration(
        name,
        tuple(Field(field, FieldType(type)) for field, type in fields),
        int(str(stored["lateness"])),
        Retention(*retention),
        str(stored["namespace"]),
        None if idle is None else int(str(idle)),
        int(str(ahead)),
    )
