"""Samples that are published while their request arrives (docs/reference/streams.md).

A sender keeps one request open as long as it has samples. One call of the engine publishes all
that has arrived, so several small parts are one batch. `LiveBodies` has the bodies under way;
`LiveLines` and `LiveTables` cut a body into complete lines and record batches. Called by
routes/live.
"""

from __future__ import annotations

import asyncio
import re
import sys
from abc import ABC, abstractmethod
from dataclasses import replace
from itertools import groupby
from typing import Any

from fastapi import Request
from starlette.requests import ClientDisconnect
from starlette.types import Message

from ...converters.arrow.messages import ArrowMessages
from ...converters.arrow.stream import (
    ArrowMissing,
    bytes_of_table,
    joined,
    samples_of_table,
)
from ...converters.errors import WireError
from ...converters.ndjson import decode_ndjson
from ...converters.ndjson_errors import mixed_times
from ...converters.wire import BOM, BatchLimits, Incoming, Rounded
from ...engine.durability.commands import BatchKind, Publish
from ...engine.engine import Engine
from ...streams.generator import StreamGenerator
from ...streams.time import Clock
from ..admission.gate import CALLER, revoked
from ..admission.tokens import Caller, Scope, Tokens
from ..durability.command_queue import CommandQueue
from ..http.body_limit import BODY, Body
from ..http.problems import Problem
from ..sse.clients import OPEN
from ..turns.backlog_task import let_others

_PART = 1 << 16
"""Bytes that are processed before others get a turn: some milliseconds of work."""
_TOGETHER = 1 << 20
"""Bytes of columns that are published together, at least one record batch of any size within its
limits."""
_LINE = re.compile(rb"[^\n]*\n|[^\n]+")


class LiveSamples(ABC):
    """The samples of one body, published into stream ``name`` as they arrive.

    Law (tests/laws): the accepted samples do not depend on how the bytes were cut. They equal those
    of publishing sample by sample (record batch by record batch) until the first error.

    Errors: those of decoding and of `Engine.publish`; a `WireError` counts lines (rows) from the
    body's beginning. Samples published before the error stay; ``accepted`` counts them.
    """

    def __init__(
        self,
        engine: Engine,
        commands: CommandQueue,
        name: str,
        clock: Clock,
        limits: BatchLimits | None = None,
    ) -> None:
        self.accepted = 0
        self.rounded: Rounded | None = None
        """The accepted numbers that were rounded."""
        self._limits = limits
        self._engine = engine
        self._commands = commands
        self._name = name
        self._clock = clock
        self._before = 0
        """Lines (rows) of the body that are processed."""
        self._stamped: bool | None = None

    @property
    @abstractmethod
    def held(self) -> int:
        """Bytes that have arrived and are not published."""

    @abstractmethod
    def take(self, data: bytes) -> bool:
        """Publish the samples that ``data`` completes, as many as one turn allows. Return whether
        more may be left; a call with ``b""`` publishes them."""

    @abstractmethod
    def end(self) -> None:
        """Publish the rest of a complete body."""

    async def keep_up(self) -> bool:
        """Back-pressure: wait for the log, and a limited time for the units that read the stream.
        Return whether these can take more samples. Raises `JournalError`."""
        if self._commands.is_full:
            await self._commands.wait_durable()
        await self._commands.caught_up(self._name)
        # If the stream was removed meanwhile, the next sample raises the error.
        if not self._engine.has_stream(self._name):
            return True
        return not self._commands.is_overloaded(self._engine.generator(self._name))

    def _target(self) -> StreamGenerator:
        """The stream's generator, looked up each time: it may have been replaced or removed."""
        return self._engine.accepting(self._name)

    def _publish(self, incoming: Incoming, kind: BatchKind, body: bytes, line: int) -> None:
        """Publish ``incoming``, decoded from ``body``, whose first sample is at ``line``. Either
        all samples of a body have available times, or none."""
        if self._stamped not in (None, incoming.stamped):
            raise mixed_times(line)
        batch = Publish(self._name, kind, body, self._clock())
        batch.check(self._engine, incoming)
        self.accepted += self._commands.do(batch, incoming)
        self._commands.start_commit()
        self._note(incoming.rounded)
        self._stamped = incoming.stamped

    def _note(self, rounded: Rounded | None) -> None:
        """Count the rounded numbers of the part that comes next."""
        if rounded is None:
            return
        if self.rounded is None:
            self.rounded = replace(rounded, line=self._before + rounded.line)
        else:
            self.rounded = replace(self.rounded, count=self.rounded.count + rounded.count)

    def _placed(self, error: WireError) -> WireError:
        """An error in the part that comes next, with its place in the body."""
        if error.line is not None:
            error.line += self._before
        return error


class LiveLines(LiveSamples):
    """NDJSON: a line is complete with its line feed, the last one with the body.

    Cost: as `decode_ndjson`; the lines before a bad one are decoded twice.
    """

    def __init__(
        self,
        engine: Engine,
        commands: CommandQueue,
        name: str,
        clock: Clock,
        limits: BatchLimits | None = None,
    ) -> None:
        super().__init__(engine, commands, name, clock, limits)
        # The number of lines that arrive together is accidental, so it has no limit.
        self._limits = limits and replace(limits, samples=sys.maxsize)
        self._rest = bytearray()

    @property
    def held(self) -> int:
        return len(self._rest)

    def take(self, data: bytes) -> bool:
        cut = data.rfind(b"\n") + 1
        lines = b""
        if cut:
            lines = bytes(self._rest) + data[:cut] if self._rest else data[:cut]
            self._rest.clear()
        self._rest += data[cut:]
        self._take_lines(lines)
        return False

    def end(self) -> None:
        lines = bytes(self._rest)
        self._rest.clear()
        self._take_lines(lines)

    def _take_lines(self, lines: bytes) -> None:
        while lines and self._target().is_open:
            # The first line alone defines the fields of an open stream.
            cut = lines.find(b"\n") + 1 or len(lines)
            self._take_part(lines[:cut])
            lines = lines[cut:]
        if lines:
            self._take_part(lines)

    def _take_part(self, lines: bytes) -> None:
        """Publish complete lines, up to a bad one."""
        try:
            self._decode_and_publish(lines)
        except WireError as error:
            rows = _LINE.findall(lines)
            # The lines before it may have an error that decoding checks later; that one counts.
            if before := b"".join(rows[: (error.line or 1) - 1]):
                self._take_part(before)
            # The lines before this one are counted in `_before`, so it is the first of the rest.
            error.line = 1
            raise self._placed(error) from None
        self._before += lines.count(b"\n")

    def _decode_and_publish(self, lines: bytes) -> None:
        text = lines if self._before else lines.removeprefix(BOM)
        if not text.strip():
            return
        generator = self._target()
        # A byte order mark is valid at the body's beginning only.
        if text.startswith(BOM):
            raise WireError(1, "not JSON: a byte order mark", "send one JSON object a line")
        self._commands.check_room(len(text))
        incoming = decode_ndjson(text, generator.schema, generator.stream.pools, self._limits)
        blank = len(text) - len(text.lstrip())
        self._publish(incoming, "ndjson", text, 1 + text.count(b"\n", 0, blank))


class LiveTables(LiveSamples):
    """An Arrow IPC stream, or several in sequence. A record batch is accepted or refused as a
    whole."""

    def __init__(
        self,
        engine: Engine,
        commands: CommandQueue,
        name: str,
        clock: Clock,
        limits: BatchLimits | None = None,
    ) -> None:
        super().__init__(engine, commands, name, clock, limits)
        self._messages = ArrowMessages(limits)

    @property
    def held(self) -> int:
        return self._messages.held

    def take(self, data: bytes) -> bool:
        tables: list[Any] = []
        size = 0
        try:
            for table in self._messages.take(data):
                if table.num_rows:
                    tables.append(table)
                    size += max(table.nbytes, table.num_rows * table.num_columns)
                if size >= _TOGETHER:
                    break
        except ArrowMissing:
            raise
        except WireError as error:
            self._take_all(tables)
            raise self._placed(error) from None
        self._take_all(tables)
        return size >= _TOGETHER

    def _take_all(self, tables: list[Any]) -> None:
        for _, alike in groupby(tables, lambda table: table.schema):
            self._take_alike(list(alike))

    def _take_alike(self, tables: list[Any]) -> None:
        """Publish tables of the same columns together; if one is bad, one by one up to it."""
        table = joined(tables)
        generator = self._target()
        # Before decoding, which adds texts to the stream's pools.
        self._commands.check_room(table.nbytes)
        try:
            incoming = samples_of_table(
                table, generator.schema, generator.stream.pools, self._limits
            )
            body = bytes_of_table(table) if self._commands.is_recording else b""
            self._publish(incoming, "arrow", body, 1)
        except WireError as error:
            if len(tables) == 1:
                raise self._placed(error) from None
            for each in tables:
                self._take_alike([each])
            return
        self._before += table.num_rows

    def end(self) -> None:
        if self.held:
            raise WireError(None, "the body ends within an Arrow message")


class _UnderWay:
    """One body under way: ``wait`` is the timeout of its next part."""

    __slots__ = ("caller", "wait")

    def __init__(self, caller: Caller | None) -> None:
        self.caller = caller
        self.wait: asyncio.Timeout | None = None

    def wake(self) -> None:
        """End the wait for the next part."""
        if self.wait is not None and not self.wait.expired():
            self.wait.reschedule(0)


class LiveBodies:
    """The live bodies under way. They end when the service stops, or ``tokens`` no longer has their
    token."""

    def __init__(self, tokens: Tokens = OPEN) -> None:
        self._under_way: set[_UnderWay] = set()
        self._tokens = tokens
        self._closing = False

    async def publish(self, request: Request, live: LiveSamples, patience: float) -> None:
        """Publish the samples of the request's body until it ends.

        Raises the errors of `LiveSamples`; a 408 `Problem` after ``patience`` seconds without data,
        401 when the token is revoked, 503 when the service stops; `ClientDisconnect` when the
        client leaves.
        """
        body = _UnderWay(request.scope.get(CALLER))
        self._under_way.add(body)
        try:
            await self._publish(request, body, live, patience)
        finally:
            self._under_way.discard(body)

    async def _publish(
        self, request: Request, under_way: _UnderWay, live: LiveSamples, patience: float
    ) -> None:
        body: Body = request.scope[BODY]
        while not self._closing:
            if not self._may_go_on(under_way):
                raise revoked()
            message = await self._next(request, under_way, patience)
            if message["type"] == "http.disconnect":
                raise ClientDisconnect
            await self._take(live, message.get("body", b""))
            if not message.get("more_body", False):
                live.end()
                return
            body.keep(live.held)
            # Meanwhile the service reads nothing of the request.
            while not await live.keep_up() and not self._closing and self._may_go_on(under_way):
                continue
        raise Problem(
            503,
            "the service stops",
            "the service did not read the body to its end",
            hint="send the samples that were not accepted when the service is back",
        )

    async def _take(self, live: LiveSamples, data: bytes) -> None:
        """Publish ``data`` in parts, and let other requests have a turn after each."""
        is_more = live.take(data[:_PART])
        start = _PART
        while is_more or start < len(data):
            await let_others()
            if is_more:
                is_more = live.take(b"")
            else:
                is_more = live.take(data[start : start + _PART])
                start += _PART

    async def _next(self, request: Request, under_way: _UnderWay, patience: float) -> Message:
        try:
            async with asyncio.timeout(patience) as under_way.wait:
                try:
                    return await request.receive()
                finally:
                    under_way.wait = None
        except TimeoutError:
            if self._closing or not self._may_go_on(under_way):
                # The caller looks again whether the body may go on, and raises the right problem.
                return {"type": "http.request", "body": b"", "more_body": True}
            raise Problem(
                408,
                "nothing came",
                f"no data arrived for {patience:g} seconds",
                hint="send an empty line now and then while there are no samples",
            ) from None

    def close(self) -> None:
        """End all bodies, since the service stops; the answers have the accepted samples."""
        self._closing = True
        for body in self._under_way:
            body.wake()

    def revoke(self) -> int:
        """End the bodies whose token was removed or may not publish; return their number."""
        gone = [body for body in self._under_way if not self._may_go_on(body)]
        for body in gone:
            body.wake()
        return len(gone)

    def _may_go_on(self, body: _UnderWay) -> bool:
        return self._tokens.allows(body.caller, Scope.PUBLISH)
