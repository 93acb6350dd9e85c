"""Annotations in SSL: what streams, sources and units mean ([Events14 §III.A], SPEC §3)."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

from ...converters.errors import ConversionError
from ...languages.errors import LanguageError
from ...languages.ssl import check_ssl, parse_ssl
from ...languages.ssl.annotation import (
    CheckedAnnotation,
    Content,
    Role,
    StreamAnnotation,
)
from ...languages.ssl.annotation_text import with_ssl_source
from ...ontology.ontology import Ontology
from ...ontology.units import parse_unit
from ...ontology.vocabulary import Vocabulary
from ..model.errors import BadArguments, DyknowError
from ..model.process_reports import Report
from ..model.status_changes import Change, ChangeKind
from .declared_streams import DeclaredStreams
from .iri_annotations import DescribedStream, DescribedTransformation, Describer
from .registered_transformations import RegisteredTransformations, check_quality
from .transformation_library import Transformations


class Annotations:
    """SSL texts, and what they say of streams and of transformations."""

    def __init__(
        self,
        ontology: Ontology,
        streams: DeclaredStreams,
        registered: RegisteredTransformations,
        transformations: Transformations,
        changed: Callable[[Change], None],
    ) -> None:
        self._ontology = ontology
        self._streams = streams
        self._registered = registered
        self._transformations = transformations
        self._changed = changed
        self._left = dict(ontology.registered.annotations)
        """Those that an earlier run was told and that are still to be restored."""

    def annotate(self, ssl: str) -> tuple[CheckedAnnotation, ...]:
        """Annotate streams and transformations by an SSL text; all of it or nothing.

        A stream's annotation says all that the stream contains: a new one replaces the old. A
        stream that does not exist comes into being, its fields typed by the features' ranges.
        Raises `LanguageError`, `Conflict` (a field that the stream lacks or of another type).
        """
        checked = check_ssl(parse_ssl(ssl), ssl, self._ontology.vocabulary)
        for annotation in checked:
            self._check(annotation)
        for annotation in checked:
            self._apply(annotation)
        return checked

    def describe_all(
        self,
        described: Sequence[DescribedStream],
        transformations: Sequence[DescribedTransformation] = (),
    ) -> tuple[CheckedAnnotation, ...]:
        """Annotate streams and transformations by descriptions in names, all of them or none; as
        `annotate` does by SSL. Raises what `Describer` raises, and `Conflict`."""
        describer = Describer(self._ontology.vocabulary)
        annotations = (
            *(describer.stream(each) for each in described),
            *(describer.transformation(each).annotation for each in transformations),
        )
        names = [_key(annotation) for annotation in annotations]
        for (kind, name), number in Counter(names).items():
            if number > 1:
                raise BadArguments(
                    f"{kind} {name!r} is described twice",
                    "one description says all that a stream contains",
                )
        for annotation in annotations:
            self._check(annotation)
        for annotation in annotations:
            self._apply(annotation)
        return annotations

    def set_quality(self, stream: str, quality: float) -> None:
        """How good a stream is now (0..1); raises `UnknownStream` and `BadArguments`."""
        check_quality(quality)
        name = self._streams.name_of(stream)
        text = f"quality {quality:g}"
        change = Change(ChangeKind.QUALITY_CHANGED, name, specification=text, quality=quality)
        self._changed(change)

    def reported(self, stream: str, report: Report) -> None:
        """A process has said something of the stream that it makes ([Introspection15 §4.4]). What
        makes no sense is told on the status stream."""
        try:
            if report.quality is not None:
                self.set_quality(stream, report.quality)
            if report.contains is not None:
                self._annotate_own(stream, report.contains)
        except (LanguageError, DyknowError, ConversionError) as error:
            self._changed(Change(ChangeKind.REFUSED, stream, specification=str(error)))

    def _annotate_own(self, stream: str, contains: str) -> None:
        """The meaning of a stream that the system makes, as its maker says. Not remembered: the
        process says it again after a restart."""
        text = f"stream s contains {contains}"
        (said,) = check_ssl(parse_ssl(text), text, self._ontology.vocabulary)
        assert isinstance(said, StreamAnnotation)
        annotation = replace(said, stream=stream, source=f"stream {stream} contains {contains}")
        self._streams.check_fields(annotation)
        self._changed(
            Change(
                ChangeKind.STREAM_ANNOTATED,
                stream,
                specification=annotation.source,
                annotation=annotation,
            )
        )

    def all(self) -> tuple[CheckedAnnotation, ...]:
        """Every annotation in force: streams first, then transformations."""
        known = (transformation.annotation for transformation in self._transformations.values())
        return (*self._streams.annotations(), *known)

    def restore(self, later: Collection[str] = ()) -> None:
        """The annotations that an earlier run was told, but for those ``later``.

        What does not hold any more (the ontology has changed since) is told on the status stream
        and left out; its text is kept.
        """
        for name in [name for name in self._left if name not in later]:
            self.restore_of(name)

    def restore_of(self, name: str) -> None:
        """The same for stream ``name``, unless it is done."""
        source = self._left.pop(name, None)
        if source is not None:
            self._restore(name, source)

    def _restore(self, name: str, source: str) -> None:
        try:
            checked = self._read(name, source)
            for annotation in checked:
                self._check(annotation)
        except (LanguageError, DyknowError, ConversionError, ValueError, KeyError) as error:
            reason = f"{error}\n{source}"
            self._changed(Change(ChangeKind.NOT_RESTORED, name, specification=reason))
            return
        for annotation in checked:
            self._apply(annotation, kept=source)

    def _read(self, name: str, kept: str) -> tuple[CheckedAnnotation, ...]:
        """SSL, or the JSON of earlier versions; raises `ValueError` and `KeyError` for neither."""
        if kept.startswith("{"):
            return (_of_json(name, kept, self._ontology.vocabulary),)
        return check_ssl(parse_ssl(kept), kept, self._ontology.vocabulary)

    def _check(self, annotation: CheckedAnnotation) -> None:
        if isinstance(annotation, StreamAnnotation):
            self._streams.check_annotation(annotation)
        else:
            self._registered.check(annotation)

    def _apply(self, annotation: CheckedAnnotation, kept: str | None = None) -> None:
        if isinstance(annotation, StreamAnnotation):
            self._streams.annotate(annotation, kept=kept)
        else:
            self._registered.annotate(annotation)


def _key(annotation: CheckedAnnotation) -> tuple[str, str]:
    if isinstance(annotation, StreamAnnotation):
        return "stream", annotation.stream
    return "transformation", annotation.name


def _of_json(stream: str, kept: str, vocabulary: Vocabulary) -> StreamAnnotation:
    """An annotation as directories of earlier versions have it, where SSL had no names for it."""
    contents = tuple(
        Content(
            content["feature"],
            content["field"],
            parse_unit(content["unit"]),
            tuple(Role(*role) for role in content["roles"]),
        )
        for content in json.loads(kept)["contents"]
    )
    return with_ssl_source(StreamAnnotation(stream, contents, ""), vocabulary)
