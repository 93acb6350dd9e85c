"""The streams that a query names itself, FROM STREAM or FROM NAMED WINDOW ([Events14 §III.A])."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from urllib.parse import unquote

from ...converters.to_triples import SampleConverter
from ...languages.csparql.ast import ContinuousQuery
from ...languages.csparql.body import stream_iri
from ...languages.ssl.annotation import StreamAnnotation
from ...rdf.namespaces import DYKNOW, STREAM_SPACE
from ...streams.generator import StreamGenerator
from ..configuration.configuration import Configuration
from ..model.errors import NotAnnotated, UnknownStream

ENDING = ".trdf"
"""What the IRI of a stream ends with in the papers' FROM STREAM."""


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """A stream that a query names, and what makes triples of its samples.

    All that the stream says is converted, also what no pattern asks for: a window counts the
    triples in it, and is evaluated where it has any, whatever they say.
    """

    generator: StreamGenerator
    converter: SampleConverter

    @property
    def name(self) -> str:
        return self.generator.name

    @property
    def annotation(self) -> StreamAnnotation:
        return self.converter.annotation


def read_streams(
    configuration: Configuration,
    converter_of: Callable[[str], SampleConverter | None],
    query: ContinuousQuery,
) -> tuple[ContinuousQuery, tuple[Reading, ...]]:
    """The query with its streams under their own names, and these streams, each once.

    Raises `UnknownStream`, and `NotAnnotated` for one of which nobody has said what it contains.
    """
    found: dict[str, Reading] = {}
    clauses = []
    for clause in query.streams:
        generator = stream_called(configuration, clause.iri)
        if generator is None:
            raise _no_stream(configuration, clause.iri)
        converter = converter_of(generator.name)
        if converter is None:
            raise NotAnnotated(
                f"nobody has said what stream {generator.name!r} contains",
                _how_to_annotate(generator),
            )
        found.setdefault(generator.name, Reading(generator, converter))
        clauses.append(replace(clause, iri=stream_iri(generator.name)))
    return replace(query, streams=tuple(clauses)), tuple(found.values())


def stream_called(configuration: Configuration, iri: str) -> StreamGenerator | None:
    """The stream that an IRI in a query means; None if there is none."""
    found = (configuration.find(name) for name in _names(iri))
    return next((generator for generator in found if generator is not None), None)


def _no_stream(configuration: Configuration, iri: str) -> UnknownStream:
    names = tuple(_names(iri))
    known = sorted({*configuration.streams, *configuration.aliases})
    near = difflib.get_close_matches(names[-1], known, n=3)
    hint = f"did you mean {' or '.join(f'<{stream_iri(name)}>' for name in near)}?"
    if not near:
        hint = f"write <{DYKNOW}NAME{ENDING}> with the name of a stream; GET /streams lists them"
    return UnknownStream(f"<{iri}> names no stream", hint)


def _names(iri: str) -> Iterator[str]:
    """What a stream may be called that an IRI means: its name, the papers' IRI, or the one that
    the stream space has for it."""
    yield iri
    for namespace in (DYKNOW, STREAM_SPACE):
        if iri.startswith(namespace):
            name = unquote(iri.removeprefix(namespace))
            yield name
            yield name.removesuffix(ENDING)


def _how_to_annotate(generator: StreamGenerator) -> str:
    fields = ", ".join(generator.schema.names) or "not known before the first sample"
    return (
        f"annotate it (POST /annotations): stream {generator.name} contains FEATURE(SORT) = FIELD "
        f"for every SORT = ID; its fields are {fields}"
    )
