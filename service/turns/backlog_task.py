"""Close due windows between requests (docs/explanation/design/0010-turns.md).

A command makes windows due. The service closes them for a moment before it answers, which is enough
for most; then a task closes the rest a little at a time, with requests in between. Without turns
windows close within the command, and the backlog stays empty.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from contextvars import Context
from typing import Final, Protocol

from ...engine.durability.commands import ANYTIME, Command
from ...engine.engine import Engine
from ...engine.units.backlog import Backlog
from ...journal.errors import JournalError
from ...streams.generator import StreamGenerator
from .window_turns import FIRST, FURTHER, WindowTurns

_POLL: Final = 0.01
"""Seconds between two looks at a stream's readers."""
_PATIENCE: Final = 2.0
"""Seconds that a publisher waits for the readers of its stream, which paces a replay."""
_PASSES: Final = 3
"""Passes of the event loop between two turns: a request takes several."""


class Work(Protocol):
    """Close windows until the time is over, and log which (`Engine.work_backlog`)."""

    def __call__(self, *, new: bool = False, begins: bool = True) -> None:
        """Raises `JournalError` and closes no window then."""


class BacklogTask:
    """Works off the backlog of ``engine`` by calling ``work`` in the event loop's thread.

    It calls ``ended`` when the backlog is empty again, and ``failed`` for an error in the program.
    """

    def __init__(
        self,
        engine: Engine,
        work: Work,
        ended: Callable[[], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._engine = engine
        self._work = work
        self._ended = ended
        self._failed = failed
        turns = engine.backlog.turns
        self._turns = turns if isinstance(turns, WindowTurns) else None
        self._task: asyncio.Task[None] | None = None
        self._woken = asyncio.Event()
        self._is_stuck = False
        """The log takes no records at present, so no windows close."""
        self._holding = 0
        """Callers of `windows_closed` that wait."""

    @property
    def _backlog(self) -> Backlog:
        return self._engine.backlog

    def before(self, command: Command) -> None:
        """Close and log the window that is half done, before ``command``. Callers that can wait
        use `windows_closed` first. Raises `JournalError`."""
        if self._backlog.is_mid_window and not isinstance(command, ANYTIME):
            self._backlog.finish_windows()
            # The windows have closed; this only emits and logs their results, so it needs no time.
            self._work_for(0.0, begins=False)

    def after_command(self) -> None:
        """Close for a moment what a command made due, and leave the rest to the task."""
        # While a command waits for the half-done windows, no other window may begin.
        if self._backlog.has_new and not self._holding:
            with suppress(JournalError):  # `CommandQueue` reports it, and the task tries again
                self._work_for(FIRST, new=True)
        if self._backlog and self._task is None:
            # The task serves all requests. An empty context keeps the id of this one from its logs.
            self._task = asyncio.get_running_loop().create_task(self._catch_up(), context=Context())
        self._woken.set()

    async def windows_closed(self, is_stuck: Callable[[], bool]) -> None:
        """Return when no window is half done, before a change of more than streams. While
        ``is_stuck`` the log takes no records; a half-done window is closed at once then."""
        self._holding += 1
        try:
            while self._backlog.is_mid_window:
                if is_stuck():
                    self._backlog.finish_windows()
                    return
                await asyncio.sleep(0.001)
        finally:
            self._holding -= 1

    async def caught_up(self, stream: str) -> None:
        """Return when the readers of ``stream`` have caught up, or after two seconds if none of
        them takes parts of a batch."""
        if not self._backlog:
            return
        loop = asyncio.get_running_loop()
        until = loop.time() + _PATIENCE
        while readers := self._engine.backlog_of(stream):
            # Without this wait the parts of any number of batches would pile up.
            takes = any(unit.is_taking_parts for unit in readers)
            if loop.time() >= until and (not takes or self._is_stuck or self._task is None):
                break
            await asyncio.sleep(_POLL)

    def is_overloaded(self, stream: StreamGenerator) -> bool:
        """Whether the service refuses samples of ``stream`` for now: a reader has worked for as
        long as a publisher waits and has not caught up. Without this a recording would arrive
        faster than it is evaluated, until its queries are cut off.

        Samples that are stamped on arrival are taken: later they would be other samples.
        """
        turns = self._turns
        if turns is None or not self._backlog or self._is_stuck or self._task is None:
            return False
        if stream.stamped is not False:
            return False
        # Publishers have to wait before the unit reaches its limit and is cut off.
        most = min(_PATIENCE, turns.limit / 4)
        return any(unit.spent >= most for unit in self._engine.backlog_of(stream.name))

    def close(self) -> None:
        """Stop; the backlog stays as it is."""
        if self._task is not None:
            self._task.cancel()
        if self._turns is not None:
            self._backlog.finish_windows()
            self._turns.close()

    def _work_for(self, seconds: float, *, new: bool = False, begins: bool = True) -> None:
        assert self._turns is not None
        self._turns.allow(seconds)
        try:
            self._work(new=new, begins=begins)
        except JournalError:
            self._is_stuck = True
            raise
        self._is_stuck = False

    async def _catch_up(self) -> None:
        """Work in turns with the event loop until the backlog is empty."""
        assert self._turns is not None
        self._turns.on_ready = _waking(self._woken)
        try:
            while self._backlog:
                await let_others()
                if self._backlog.is_waiting:
                    await self._woken.wait()
                self._woken.clear()
                # `windows_closed` is about to return, and its command comes before the next window.
                if self._holding and not self._backlog.is_mid_window:
                    continue
                try:
                    self._work_for(FURTHER, begins=not self._holding)
                except JournalError:
                    await asyncio.sleep(_POLL)
            self._ended()
        except Exception as error:  # noqa: BLE001  `failed` logs it, and /readyz shows it
            self._failed(error)
        finally:
            self._task = None


async def let_others() -> None:
    """Let the other tasks of the event loop run."""
    for _ in range(_PASSES):
        await asyncio.sleep(0)


def _waking(event: asyncio.Event) -> Callable[[], None]:
    """Return a function that sets ``event`` of the running loop from any thread."""
    loop = asyncio.get_running_loop()

    def wake() -> None:
        with suppress(RuntimeError):  # the loop has been closed
            loop.call_soon_threadsafe(event.set)

    return wake
