"""A history answer, encoded a piece at a time: a long one takes neither the loop nor the memory.

Samples are kept as codes of texts that are kept once, so that some kilobytes may stand for
gigabytes of an answer. Only the piece that is being sent is ever encoded, and the next one when the
client has taken it. Used by routes/samples.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator

import anyio.to_thread
import numpy as np
from fastapi import Response
from fastapi.responses import StreamingResponse
from numpy.typing import NDArray
from starlette.types import Receive, Scope, Send

from ...converters.arrow.stream import ArrowWriter
from ...converters.csv_table import encode_csv
from ...converters.ndjson import encode_ndjson
from ...streams.sample import Column, SampleBatch
from ..config.media_types import ARROW, CSV, NDJSON, NTRIPLES
from .response_limit import HELD

PIECE_BYTES = 256 * 1024
"""A piece has at most so many, as far as the texts in it say, or one sample."""
PIECE_SAMPLES = 10_000
"""And at most so many samples."""
_SAMPLE, _VALUE = 64, 24
"""Bytes that a sample's times are reckoned with, and a value that is no text."""

Triples = Callable[[SampleBatch], list[str]]
"""N-Triples of each sample."""


async def history_answer(kind: str, batch: SampleBatch, triples: Triples) -> Response:
    """``batch`` as ``kind``: in one go where it is short, else in pieces.

    ``triples`` is called on the event loop, as the engine's terms belong to it; all else is encoded
    beside it.
    """
    written = _written(kind, batch, triples)

    async def take() -> bytes | None:
        if kind == NTRIPLES:
            await asyncio.sleep(0)  # others have their turn
            return next(written, None)
        # Batches do not change.
        return await anyio.to_thread.run_sync(next, written, None)

    begun = [await take(), await take()]
    if begun[1] is None:
        return Response(begun[0], media_type=kind)

    async def body() -> AsyncIterator[bytes]:
        while begun:
            # What is sent is let go: the next one may be asked for much later.
            yield begun.pop(0) or b""
        while (piece := await take()) is not None:
            yield piece

    return HistoryResponse(body(), batch.nbytes, kind)


class HistoryResponse(StreamingResponse):
    """One that comes in pieces. ``held`` bytes of samples stay until the last one is taken."""

    def __init__(self, pieces: AsyncIterator[bytes], held: int, kind: str) -> None:
        super().__init__(pieces, media_type=kind)
        self._held = held

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        scope[HELD] = self._held
        await super().__call__(scope, receive, send)


def pieces(batch: SampleBatch) -> Iterator[SampleBatch]:
    """The batch in parts to be encoded one by one; at least one, which may be empty.

    Law: together they are the batch, and each has at most `PIECE_SAMPLES`, and `PIECE_BYTES` or one
    sample. Cost: O(samples), a look at each text once a `PIECE_SAMPLES`.
    """
    for start in range(0, max(1, len(batch)), PIECE_SAMPLES):
        part = batch.take(slice(start, start + PIECE_SAMPLES))
        for cut in _cuts(_sizes(part)):
            yield part.take(cut)


def _sizes(batch: SampleBatch) -> NDArray[np.int64]:
    """About how many bytes each sample is."""
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
    """Where to cut, so that each part has at most `PIECE_BYTES`, or one sample."""
    ends = np.cumsum(sizes)
    start = before = 0
    while start < max(1, len(sizes)):
        stop = max(start + 1, int(np.searchsorted(ends, before + PIECE_BYTES, "right")))
        yield slice(start, stop)
        start, before = stop, int(ends[stop - 1]) if len(ends) else 0


def _written(kind: str, batch: SampleBatch, triples: Triples) -> Iterator[bytes]:
    """The pieces of an answer."""
    table = ArrowWriter() if kind == ARROW else None
    parts = pieces(batch)
    part: SampleBatch | None = next(parts)
    is_first = True
    while part is not None:
        following = next(parts, None)
        if kind == NTRIPLES:
            yield "".join(f"{text}\n" for text in triples(part) if text).encode()
        elif kind == NDJSON:
            yield encode_ndjson(part)
        elif kind == CSV:
            yield encode_csv(part, header=is_first)
        elif table is not None:
            yield table.write(part) + (b"" if following is not None else table.close())
        else:
            # A JSON array is the lines with commas between.
            lines = b",".join(encode_ndjson(part).splitlines())
            yield (b"[" if is_first else b",") + lines + (b"]" if following is None else b"")
        part, is_first = following, False
