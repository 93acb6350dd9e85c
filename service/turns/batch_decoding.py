"""Decode large batches on threads beside the event loop.

Decoding changes nothing that other requests see, so it needs no turn of the engine: the batch has
string pools of its own, and the loop's thread takes it afterwards. The interpreter passes from the
decoder to the loop within `sys.getswitchinterval`, which `dyknow serve` sets to a millisecond. A
small batch is decoded at once, which takes less time than a switch. Called by `routes/publish`.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import Final

from ...converters.wire import BatchLimits, Incoming
from ...engine.durability.commands import Publish
from ...engine.engine import Engine

AT_ONCE: Final = 1 << 17
"""Bytes of a body that is decoded without a thread: some milliseconds of work at most."""
THREADS: Final = 2
"""Bodies that are decoded at the same time. As Python objects they take ten times their bytes, and
each thread that holds the interpreter delays the event loop by one more switch interval."""


class BatchDecoder:
    """Decodes batches for streams of ``engine``, several at a time, the rest in order of arrival.

    ``at_once``: bytes of a body, after decompression, that the calling thread decodes itself.

    Law (tests/laws/converters): the result equals that of decoding at once, errors included, by the
    fields that the stream has when the result is returned.
    """

    def __init__(self, engine: Engine, limits: BatchLimits, at_once: int = AT_ONCE) -> None:
        self._engine = engine
        self._limits = limits
        self._at_once = at_once
        self._threads = ThreadPoolExecutor(THREADS, "dyknow-decoding")

    async def decode(self, batch: Publish) -> Incoming:
        """Decode ``batch``. When it returns, the batch has the fields of its stream.

        Raises `WireError`, and what `Engine.accepting` raises.
        """
        if not batch.is_large(self._at_once):
            return batch.decode(self._engine, self._limits)
        loop = asyncio.get_running_loop()
        while True:
            generator = self._engine.accepting(batch.stream)
            schema, property = generator.schema, batch.time_property(self._engine, generator)
            incoming = await loop.run_in_executor(
                self._threads, batch.decode_beside, generator.stream, schema, self._limits, property
            )
            now = self._engine.accepting(batch.stream)
            if now.schema == schema and batch.time_property(self._engine, now) == property:
                return incoming
            # A command gave the stream another declaration meanwhile: decode the batch by that.

    def close(self) -> None:
        """Let the threads end after the batches that they decode at present."""
        self._threads.shutdown(wait=False, cancel_futures=True)
