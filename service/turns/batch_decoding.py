"""Large batches are decoded a little at a time, so that nobody waits for another's.

A small one is decoded at once: that takes less than to do anything about it. Others are decoded as
fibers (`fibers`), some of them at once and in turns, the rest in the order in which they came. What
is decoded touches nothing that others have, so whatever they do meanwhile is no matter to it: only
when its fields are not those of the stream any more it is decoded again, as if it had come now.
Used by routes/publish.
"""

from __future__ import annotations

import asyncio
from typing import Final

from ...converters.wire import BatchLimits, Incoming
from ...engine.durability.commands import Publish
from ...engine.engine import Engine
from .fibers import Fiber, Fibers, let_others, waking

AT_ONCE: Final = 1 << 17
"""A body of so many bytes takes some milliseconds at most; one of a thousand samples has less."""
TOGETHER: Final = 4
"""So many bodies are decoded at once: as Python's objects they take ten times their bytes."""
TURN: Final = 0.004
"""Seconds at a time, with others in between."""

_PATIENCE: Final = 0.001
"""Seconds more for what is done apart, with the other processor."""


class Decoding:
    """Decodes batches for streams of ``engine``.

    ``turn``: seconds at a time. ``at_once``: bytes of a body, once it is decompressed, that is
    decoded without turns.

    Law (tests/laws): what is decoded in turns is what is decoded at once, errors included, whatever
    others do in between, by the fields that the stream has at the end.
    """

    def __init__(
        self,
        engine: Engine,
        limits: BatchLimits,
        turn: float = TURN,
        at_once: int = AT_ONCE,
    ) -> None:
        self._engine = engine
        self._limits = limits
        self._turn_seconds = turn
        self._at_once = at_once
        self._fibers = Fibers("dyknow-decoding", _PATIENCE)
        self._places = asyncio.Semaphore(TOGETHER)
        self._turn = asyncio.Lock()
        self._ready = asyncio.Event()
        self.turns = 0
        """So many were taken."""

    async def decode(self, batch: Publish) -> Incoming:
        """What ``batch`` says; when it returns, its fields are those of the stream.

        Raises `WireError`, and what `Engine.accepting` does.
        """
        if not batch.is_large(self._at_once):
            return batch.decode(self._engine, self._limits)
        async with self._places:
            while (incoming := await self._in_turns(batch)) is None:
                continue
            return incoming

    def close(self) -> None:
        """Let the threads go."""
        self._fibers.close()

    async def _in_turns(self, batch: Publish) -> Incoming | None:
        found: list[Incoming | None] = []
        fiber = Fiber(
            self._fibers,
            lambda: found.append(batch.decode_apart(self._engine, self._limits, self._fibers)),
        )
        self._fibers.on_ready = waking(self._ready)
        try:
            while not await self._take_turn(fiber):
                while not fiber.is_ready:
                    self._ready.clear()
                    await self._ready.wait()
        finally:
            fiber.abandon()
        return found[0]

    async def _take_turn(self, fiber: Fiber) -> bool:
        """Whether it is done. Others have theirs before the next one."""
        async with self._turn:
            self.turns += 1
            self._fibers.allow(self._turn_seconds)
            if fiber.go_on():
                return True
            await let_others()
            return False
