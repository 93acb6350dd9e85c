"""A history answer, encoded in pieces, so that a long one blocks neither the event loop nor fills
the memory.

A stream keeps each text once and codes in its samples, so that kilobytes of samples may become
gigabytes of an answer. The service encodes a piece when the client has taken the one before.
Called by routes/samples.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field

import anyio.to_thread
import numpy as np
from fastapi import Response
from fastapi.responses import StreamingResponse
from numpy.typing import NDArray
from pyoxigraph import RdfFormat, parse, serialize
from starlette.types import Receive, Scope, Send

from ....converters.arrow.stream import ArrowWriter
from ....converters.csv_table import encode_csv
from ....converters.ndjson import encode_ndjson
from ....converters.rdf.ntriples import GENERATED
from ....converters.rdf.statements import GRAPH
from ....converters.wire import format_times
from ....rdf.namespaces import XSD
from ....streams.instants import Places, PlacesOf
from ....streams.sample import Column, SampleBatch
from ...config.media_types import ARROW, CSV, JSON_LD, NDJSON, NQUADS, NTRIPLES, TRIG
from ..response_limit import HELD

PIECE_BYTES = 256 * 1024
"""The estimated size of a piece, at most, unless it is one sample."""
PIECE_SAMPLES = 10_000
"""Samples of a piece, at most."""
_SAMPLE, _VALUE = 64, 24
"""Estimated bytes of a sample's times, and of a value that is no text."""

RDF_KINDS = (NTRIPLES, NQUADS, TRIG, JSON_LD)
RDF_SAMPLES = 1_000
"""Samples of a piece of RDF, at most: the event loop makes it, in some milliseconds."""
_GENERATED = str(GENERATED)


@dataclass(slots=True)
class RdfWriter:
    """Writes the samples of one answer as RDF, in order of available time. ``stream`` is the IRI of
    their stream; ``triples`` returns the N-Triples of each sample, in lines, by its place in its
    instant; ``is_rdf``: they are statements, which may have a graph."""

    stream: str
    triples: Callable[[SampleBatch, PlacesOf], list[str]]
    is_rdf: bool = False
    _places: Places = field(default_factory=Places)
    _timed: set[tuple[str, int]] = field(default_factory=set)
    """The graphs of the last available time whose time is written."""

    def written(self, batch: SampleBatch, kind: str) -> str:
        """The samples as N-Triples, or as timestamped graphs in N-Quads or TriG: the samples of one
        available time are a graph, unless they have a graph of their own."""
        if not len(batch):
            return ""
        texts = self.triples(batch, self._places.of)
        if kind == NTRIPLES:
            return "".join(f"{text}\n" for text in texts if text)
        times, told = batch.available.tolist(), format_times(batch.available)
        names = [f"<{self.stream}/{time}>" for time in told]
        if self.is_rdf:
            own = batch.columns[GRAPH].tolist()
            names = [str(graph or name) for graph, name in zip(own, names, strict=True)]
        lines: list[str] = []
        for name, time, spelled, text in zip(names, times, told, texts, strict=True):
            if not text:
                continue
            if (name, time) not in self._timed:
                self._timed = {each for each in self._timed if each[1] == time}
                self._timed.add((name, time))
                lines.append(f'{name} {_GENERATED} "{spelled}"^^<{XSD}dateTime> .')
            statements = text.split("\n")
            if kind == TRIG:
                lines.append(f"{name} {{ {' '.join(statements)} }}")
            else:
                lines += [f"{statement[:-1]}{name} ." for statement in statements]
        return "".join(f"{line}\n" for line in lines)


def _json_ld(nquads: str) -> bytes:
    """The same as JSON-LD: the objects of an array, without its brackets. Objects of several arrays
    with one ``@id`` are one, so that the arrays of all pieces are a document."""
    # The service has written these terms itself, so that they need no check.
    quads = parse(nquads.encode(), RdfFormat.N_QUADS, lenient=True)
    written = serialize(quads, format=RdfFormat.JSON_LD)
    assert written is not None  # without a file to write to
    return written[1:-1]


async def history_answer(kind: str, batch: SampleBatch, rdf: RdfWriter) -> Response:
    """``batch`` in the media type ``kind``: as a whole if it is short, else in pieces.

    The event loop calls ``rdf``, since the engine's terms belong to its thread; another thread
    encodes everything else.
    """
    written = _written(kind, batch, rdf)

    async def take() -> bytes | None:
        if kind in RDF_KINDS:
            await asyncio.sleep(0)  # yield to other requests
            return next(written, None)
        # Safe in another thread: batches are immutable.
        return await anyio.to_thread.run_sync(next, written, None)

    begun = [await take(), await take()]
    if begun[1] is None:
        return Response(begun[0], media_type=kind)

    async def body() -> AsyncIterator[bytes]:
        while begun:
            # Free each piece when it is sent: the client may take the next one much later.
            yield begun.pop(0) or b""
        while (piece := await take()) is not None:
            yield piece

    return HistoryResponse(body(), batch.nbytes, kind)


class HistoryResponse(StreamingResponse):
    """An answer in pieces, with ``held`` bytes of samples until its end."""

    def __init__(self, pieces: AsyncIterator[bytes], held: int, kind: str) -> None:
        super().__init__(pieces, media_type=kind)
        self._held = held

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope[HELD] = self._held
        await super().__call__(scope, receive, send)


def pieces(batch: SampleBatch, most: int = PIECE_SAMPLES) -> Iterator[SampleBatch]:
    """Cut the batch into parts to encode one by one; at least one, which may be empty.

    Law: the parts concatenated are the batch, and each has at ``most`` so many samples, and either
    `PIECE_BYTES` or one sample. Cost: O(samples), and each text once per ``most`` samples.
    """
    for start in range(0, max(1, len(batch)), most):
        part = batch.take(slice(start, start + most))
        for cut in _cuts(_sizes(part)):
            yield part.take(cut)


def _sizes(batch: SampleBatch) -> NDArray[np.int64]:
    """The estimated bytes of each sample."""
    sizes = np.full(len(batch), _SAMPLE, np.int64)
    for column in batch.columns.values():
        sizes += _VALUE if column.pool is None else _text_sizes(column)
    return sizes


def _text_sizes(column: Column) -> NDArray[np.int64]:
    pool, present = column.pool, column.present
    assert pool is not None
    sizes = np.full(len(column), _VALUE, np.int64)
    codes, places = np.unique(column.values[present], return_inverse=True)
    lengths = np.fromiter((len(pool[code]) for code in codes.tolist()), np.int64, len(codes))
    sizes[present] += lengths[places]
    return sizes


def _cuts(sizes: NDArray[np.int64]) -> Iterator[slice]:
    """The slices whose parts have at most `PIECE_BYTES`, or one sample."""
    ends = np.cumsum(sizes)
    start = before = 0
    while start < max(1, len(sizes)):
        stop = max(start + 1, int(np.searchsorted(ends, before + PIECE_BYTES, "right")))
        yield slice(start, stop)
        start, before = stop, int(ends[stop - 1]) if len(ends) else 0


def _written(kind: str, batch: SampleBatch, rdf: RdfWriter) -> Iterator[bytes]:
    """The encoded pieces of an answer."""
    table = ArrowWriter() if kind == ARROW else None
    parts = pieces(batch, RDF_SAMPLES if kind in RDF_KINDS else PIECE_SAMPLES)
    part: SampleBatch | None = next(parts)
    is_first, has_objects = True, False
    while part is not None:
        following = next(parts, None)
        if kind == JSON_LD:
            objects = _json_ld(rdf.written(part, NQUADS))
            # A piece may have none: samples without triples.
            comma = b"," if has_objects and objects else b""
            has_objects |= bool(objects)
            yield b"[" * is_first + comma + objects + b"]" * (following is None)
        elif kind in RDF_KINDS:
            yield rdf.written(part, kind).encode()
        elif kind == NDJSON:
            yield encode_ndjson(part)
        elif kind == CSV:
            yield encode_csv(part, header=is_first)
        elif table is not None:
            yield table.write(part) + (b"" if following is not None else table.close())
        else:
            # A JSON array is the NDJSON lines with commas between.
            lines = b",".join(encode_ndjson(part).splitlines())
            yield (b"[" if is_first else b",") + lines + (b"]" if following is None else b"")
        part, is_first = following, False
