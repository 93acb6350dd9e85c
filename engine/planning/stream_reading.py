"""Resolves the streams that a query names in FROM STREAM or FROM NAMED WINDOW ([Events14
§III.A])."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from urllib.parse import unquote

from ...converters.to_triples import ToTriples
from ...languages.csparql.ast import ContinuousQuery
from ...languages.csparql.body import stream_iri
from ...languages.ssl.annotation import StreamAnnotation
from ...rdf.namespaces import DYKNOW, STREAM_SPACE
from ...streams.generator import StreamGenerator
from ..configuration.configuration import Configuration
from ..model.errors import NotAnnotated, UnknownStream

ENDING = ".trdf"
"""The ending of a stream's IRI in the papers' FROM STREAM."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadStream:
    """A stream that a query names, and the converter of its samples to triples.

    All contents of the stream are converted, also those that no pattern matches: count windows
    count every triple, and a window is evaluated if it contains any.
    """

    generator: StreamGenerator
    converter: ToTriples

    @property
    def name(self) -> str:
        return self.generator.name

    @property
    def annotation(self) -> StreamAnnotation:
        return self.converter.annotation


def read_streams(
    configuration: Configuration,
    converter_of: Callable[[str], ToTriples | None],
    query: ContinuousQuery,
) -> tuple[ContinuousQuery, tuple[ReadStream, ...]]:
    """Return the query with the streams' own names, and its streams, each once. Raises
    `UnknownStream`, and `NotAnnotated` for a stream without an annotation.
    """
    found: dict[str, ReadStream] = {}
    clauses = []
    for clause in query.streams:
        generator = find_stream(configuration, clause.iri)
        if generator is None:
            raise _unknown_stream(configuration, clause.iri)
        converter = converter_of(generator.name)
        if converter is None:
            raise NotAnnotated(
                f"stream {generator.name!r} has no annotation, so its contents are unknown",
                _annotation_hint(generator),
            )
        found.setdefault(generator.name, ReadStream(generator, converter))
        clauses.append(replace(clause, iri=stream_iri(generator.name)))
    return replace(query, streams=tuple(clauses)), tuple(found.values())


def find_stream(configuration: Configuration, iri: str) -> StreamGenerator | None:
    """Return the stream that an IRI in a query names; None if there is none."""
    found = (configuration.find(name) for name in _names(iri))
    return next((generator for generator in found if generator is not None), None)


def _unknown_stream(configuration: Configuration, iri: str) -> UnknownStream:
    names = tuple(_names(iri))
    existing = sorted({*configuration.streams, *configuration.aliases})
    near = difflib.get_close_matches(names[-1], existing, n=3)
    hint = f"did you mean {' or '.join(f'<{stream_iri(name)}>' for name in near)}?"
    if not near:
        hint = f"write <{DYKNOW}NAME{ENDING}> with the name of a stream; GET /streams lists them"
    return UnknownStream(f"<{iri}> names no stream", hint)


def _names(iri: str) -> Iterator[str]:
    """Yield the names that an IRI can stand for: a stream's name itself, the papers' IRI, or that
    of the stream space."""
    yield iri
    for namespace in (DYKNOW, STREAM_SPACE):
        if iri.startswith(namespace):
            name = unquote(iri.removeprefix(namespace))
            yield name
            yield name.removesuffix(ENDING)


def _annotation_hint(generator: StreamGenerator) -> str:
    fields = ", ".join(generator.schema.names) or "not known before the first sample"
    return (
        f"annotate it (POST /annotations): stream {generator.name} contains FEATURE(SORT) = FIELD "
        f"for every SORT = ID; its fields are {fields}"
    )
