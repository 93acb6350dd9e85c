"""Streams that users declare and annotate ([Introspection15 §4.2], SPEC §3).

The declarations and annotations are registered in the ontology, so they survive a restart.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping

from pyoxigraph import NamedNode

from ...converters.rdf.statement_converter import StatementConverter
from ...converters.to_triples import SampleConverter
from ...converters.values import field_type
from ...languages.csparql.body import stream_iri
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
    MTL,
    RETENTION,
    SELECT_INSTANCE,
    SELECT_OBJECT,
    SELECT_OBJECTS,
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
_SYSTEM_NAMES = (
    STATUS,
    SELECT_OBJECT,
    SELECT_OBJECTS,
    SELECT_INSTANCE,
    SYNCHRONIZE,
    MERGE,
    C_SPARQL,
    MTL,
    *BUILT_IN,
)
_SYSTEM_PREFIX = "dyknow_"
"""The prefix of the names that the system gives to streams and units."""


class DeclaredStreams:
    """The streams that users declared, and their annotations."""

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
        """Make or change a stream; its annotation stays.

        Repeating a declaration changes nothing. A stream in use accepts further fields, and another
        lateness, idle time, bound ahead and retention. Raises `Conflict` if anything else of a
        stream with samples or subscribers would change, `Refused` for a name of the system, and
        `BadArguments` for a namespace that is not an IRI and for an ``idle`` of 0.
        """
        self.check_stream_name(declaration.name)
        schema = Schema(declaration.fields)
        if not schema.fields:
            raise Refused("a stream has at least one field", 'give "fields": [{"name", "type"}]')
        for name in schema.names:
            if name in TIME_FIELDS:
                raise Refused(f"a field cannot have the name {name!r}: that is a sample's time")
        try:
            NamedNode(declaration.namespace)
        except ValueError as error:
            raise BadArguments(
                f"the namespace {declaration.namespace!r} is not an IRI: {error}",
                f"the objects of id fields get their names in it, for example {DYKNOW}",
            ) from error
        if declaration.idle is not None and declaration.idle <= 0:
            raise BadArguments(
                '"idle" must be more than 0',
                'give a time such as "10s", or leave it out: then readers always wait for it',
            )
        if declaration.name in self._configuration.units or (
            declaration.name in self._configuration.late
        ):
            raise Refused(f"the system makes stream {declaration.name!r}", "choose another name")
        if declaration.time_property:
            self._check_time_property(declaration.time_property)
        existing = self._configuration.streams.get(declaration.name)
        if existing is None:
            existing = self._add(declaration)
        elif self._declaration(existing) == declaration:
            return existing
        elif self.can_extend(declaration):
            self._extend(existing, declaration)
        else:
            existing = self._replace(existing, declaration)
        self._ontology.registered.streams[declaration.name] = _declaration_json(declaration)
        return existing

    def _check_time_property(self, property: str) -> None:
        try:
            NamedNode(property)
        except ValueError as error:
            raise BadArguments(
                f"the time property {property!r} is not an IRI: {error}",
                "write it out, for example http://www.w3.org/ns/sosa/resultTime",
            ) from error

    def can_extend(self, declaration: StreamDeclaration) -> bool:
        """Whether the stream of that name can change to ``declaration`` while it is in use. False
        if there is none. An open stream counts as one without fields."""
        existing = self._configuration.streams.get(declaration.name)
        return (
            existing is not None
            and self._configuration.namespaces[existing.name] == declaration.namespace
            and self._configuration.statements.get(existing.name) == declaration.time_property
            and set(existing.schema.fields) <= set(declaration.fields)
        )

    def _extend(self, existing: StreamGenerator, declaration: StreamDeclaration) -> None:
        """Make the changes that `can_extend` allows."""
        schema = Schema(declaration.fields)
        if existing.is_open:
            self._adopt(existing, schema)
        elif existing.schema != schema:
            existing.widen(schema)
        existing.lateness, existing.ahead = declaration.lateness, declaration.ahead
        if existing.idle != declaration.idle:
            existing.idle = declaration.idle
            existing.wake()  # `Idleness` decides anew whether it is idle
        for each in (existing, existing.late_stream):
            if each is not None and each.stream.retention != declaration.retention:
                each.stream.retention = declaration.retention
                each.forget_texts()

    def _adopt(self, existing: StreamGenerator, schema: Schema) -> None:
        """Give an open stream its fields."""
        texts = [field.name for field in schema.fields if field.type is FieldType.STRING]
        existing.adopt(schema, {name: StringPool() for name in texts})

    def _replace(
        self, existing: StreamGenerator, declaration: StreamDeclaration
    ) -> StreamGenerator:
        """Replace a stream that has no samples and subscribers; its annotation stays."""
        self._refuse_if_in_use(existing, declaration)
        annotation = self.annotation_of(declaration.name)
        if annotation is not None:
            self._check_fields(annotation, Schema(declaration.fields))
        self._configuration.remove_stream(declaration.name)
        replacement = self._add(declaration)
        if annotation is not None:
            self._report_annotation(annotation)
        return replacement

    def remove(self, name: str) -> None:
        """Remove a stream with its annotation and registrations. Raises `Conflict` while a unit
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
        """Forget the annotation of a removed stream."""
        if self._annotations.pop(name, None) is not None:
            del self._ontology.registered.annotations[name]

    def annotate(self, annotation: StreamAnnotation, kept: str | None = None) -> None:
        """Annotate a stream, and make it if it does not exist. ``kept``: the text to register, if
        not the annotation's own. Contract: `check_annotation` has passed."""
        self._annotations[annotation.stream] = annotation
        existing = self._configuration.streams.get(annotation.stream)
        inferred = self._infer_fields(annotation)
        if existing is None:
            self._add(StreamDeclaration(annotation.stream, inferred, retention=RETENTION))
        elif existing.is_open:
            self._adopt(existing, Schema(inferred))
        self._ontology.registered.annotations[annotation.stream] = kept or annotation.source
        self._report_annotation(annotation)

    def _report_annotation(self, annotation: StreamAnnotation) -> None:
        self._changed(
            Change(
                ChangeKind.STREAM_ANNOTATED,
                annotation.stream,
                specification=annotation.source,
                annotation=annotation,
            )
        )

    def name_of(self, stream: str) -> str:
        """Return the stream's own name, also for an alias. Raises `UnknownStream`."""
        return self._configuration.stream(stream).name

    def annotations(self) -> tuple[StreamAnnotation, ...]:
        """Return the annotations by users, in the order of the streams' first ones."""
        return tuple(self._annotations.values())

    def annotation_of(self, name: str) -> StreamAnnotation | None:
        """Return the annotation of stream ``name``; None if no user has annotated it."""
        return self._annotations.get(name)

    def compile(
        self, annotation: StreamAnnotation, schema: Schema, namespace: str
    ) -> SampleConverter:
        """Make the converter from a stream's samples to triples. It converts values to the units of
        their features, which queries expect. Raises `ConversionError`."""
        vocabulary = self._ontology.vocabulary
        units: dict[str, Unit] = {}
        for content in annotation.contents:
            info = vocabulary.feature(content.feature)
            if info is not None and info.unit is not None:
                units[content.feature] = info.unit
        return SampleConverter(
            annotation, schema, vocabulary, self._dictionary, namespace=namespace, units=units
        )

    def statements(self, stream: str) -> StatementConverter:
        """Make the converter of a stream of RDF."""
        return StatementConverter(stream, self._dictionary)

    def restore_streams(self) -> None:
        """Make the registered streams of an earlier run.

        The status stream reports a declaration that cannot be read; the registrations keep its
        text.
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
            time_property=declaration.time_property,
        )

    def check_stream_name(self, name: str) -> None:
        """Raise `Refused` if users may not declare a stream of this name."""
        if not _NAME.match(name):
            raise Refused(
                f"{name!r} is not a valid stream name",
                "use letters, digits and _, with a letter first",
            )
        self.check_name(name)

    def check_name(self, name: str) -> None:
        """Raise `Refused` for a name that the system uses."""
        if (
            name in _SYSTEM_NAMES
            or name.startswith(_SYSTEM_PREFIX)
            or name.endswith(SUFFIX)
            or (name.endswith(LATE) and name not in self._ontology.registered.streams)
            or name in IMPLEMENTATIONS
            or self._is_term(name)
        ):
            raise Refused(f"the system uses the name {name!r}", "choose another name")

    def has(self, declaration: StreamDeclaration) -> bool:
        """Whether a stream with exactly this declaration exists."""
        existing = self._configuration.streams.get(declaration.name)
        return existing is not None and self._declaration(existing) == declaration

    def _is_term(self, name: str) -> bool:
        """Whether the stream-space ontology has a term of this name. The individuals for streams,
        units and transformations share its namespace."""
        quads = self._ontology.static_store.quads_for_pattern(
            term(name), None, None, STREAM_SPACE_ONTOLOGY
        )
        return next(quads, None) is not None

    def _refuse_if_in_use(self, generator: StreamGenerator, declaration: StreamDeclaration) -> None:
        late = self._configuration.late.belonging_to(generator.name)
        streams = [generator, *(self._configuration.streams[name] for name in late)]
        subscribers = sum(each.subscribers for each in streams)
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
        """Return why a stream in use cannot change to ``declaration``, and a hint."""
        schema = Schema(declaration.fields)
        property = self._configuration.statements.get(generator.name)
        if property != declaration.time_property:
            told = "it takes samples" if property is None else "it takes RDF"
            if property is not None and declaration.time_property is not None:
                told = f"its times come from {property or 'no property'}"
            return told, "choose another stream name"
        for field in generator.schema.fields:
            other = schema.get(field.name)
            if other is None:
                return (
                    f"the declaration lacks its field {field.name!r}",
                    "declare all of its fields (a sample may have null in any of them) and any new "
                    "ones, or choose another stream name",
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
            self._configuration.statements.get(generator.name),
        )

    def check_annotation(self, annotation: StreamAnnotation) -> None:
        """Check that the stream may have this annotation. Raises `Refused` and `Conflict`."""
        self.check_stream_name(annotation.stream)
        name = annotation.stream
        other = self._configuration.aliases.get(name)
        if other is not None:
            raise Refused(f"{name!r} is another name of {other!r}", f"annotate {other!r}")
        if name in self._configuration.named:
            raise Refused(
                f"a specification made stream {name!r}",
                "annotate its transformation, which describes the contents of its streams",
            )
        if name in self._configuration.statements:
            raise Refused(
                f"stream {name!r} holds RDF, which says itself what it means",
                f"query it: FROM STREAM <{stream_iri(name)}>; the results of a SELECT can be "
                "annotated",
            )
        existing = self._configuration.streams.get(name)
        if existing is not None and existing.is_open and name in self._configuration.units:
            raise Conflict(
                f"stream {name!r} has no fields before its first sample",
                "declare the sort of its values, or annotate it later",
            )
        if existing is None or existing.is_open:
            schema = Schema(self._infer_fields(annotation))
        else:
            schema = existing.schema
        self._check_fields(annotation, schema)

    def check_fields(self, annotation: StreamAnnotation) -> None:
        """Check that an existing stream has the fields of its annotation. Raises `UnknownStream`
        and `Conflict`."""
        self._check_fields(annotation, self._configuration.stream(annotation.stream).schema)

    def _check_fields(self, annotation: StreamAnnotation, schema: Schema) -> None:
        """Check that the fields exist, that id fields are strings or integers, and that a converter
        can be made: that raises `ConversionError`."""
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
                    "so it cannot name objects",
                    "an id field is a string or an integer",
                )
        self.compile(annotation, schema, DYKNOW)

    def _infer_fields(self, annotation: StreamAnnotation) -> tuple[Field, ...]:
        """Infer the fields of a stream without a declaration: id fields are strings, the others
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
    """Return the fields of an annotation; id fields come with their role."""
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
        | ({} if declaration.time_property is None else {"time": declaration.time_property})
    )


def _declaration_of(name: str, text: str) -> StreamDeclaration:
    stored: Mapping[str, object] = json.loads(text)
    fields, retention = stored["fields"], stored["retention"]
    # Declarations of earlier versions have neither.
    idle, ahead = stored.get("idle"), stored.get("ahead", HOUR)
    property = stored.get("time")
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
        None if property is None else str(property),
    )
