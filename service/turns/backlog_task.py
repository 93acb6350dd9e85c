"""Closing windows between everybody's requests (docs/explanation/design/0010-turns.md).

A command makes windows due. They are closed for a moment before it is answered, which is enough for
most, then a little at a time, with others in between. Without turns nobody is ever behind, and
nothing here waits.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from contextvars import Context
from typing import Final, Protocol

from ...engine.durability.commands import ANYTIME, Command
from ...engine.engine import Engine
from ...engine.units.backlog import Behind
from ...journal.errors import JournalError
from .fibers import FURTHER, let_others, waking
from .window_turns import FIRST, Pausing

_LOOK: Final = 0.01
"""Seconds between two looks whether a stream's readers have caught up."""
_PATIENCE: Final = 2.0
"""Seconds that who publishes waits for them: so a replay goes as fast as its queries do."""


class GoOn(Protocol):
    """Close windows until the time is over, and write down which (`Engine.go_on`)."""

    def __call__(self, *, new: bool = False, begins: bool = True) -> None:
        """Raises `JournalError`: none is closed then."""


class CatchingUp:
    """Closes the windows that are due in ``engine``, by ``go_on``, in its loop's thread.

    ``ended`` is called when nobody is behind any more, ``failed`` for what should never happen.
    """

    def __init__(
        self,
        engine: Engine,
        go_on: GoOn,
        ended: Callable[[], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._engine = engine
        self._go_on = go_on
        self._ended = ended
        self._failed = failed
        turns = engine.behind.turns
        self._pausing = turns if isinstance(turns, Pausing) else None
        self._task: asyncio.Task[None] | None = None
        self._woken = asyncio.Event()
        self._is_stuck = False
        """The log takes nothing at present, so nothing is closed or taken."""
        self._holding = 0
        """So many wait until no window is half done."""

    @property
    def _behind(self) -> Behind:
        return self._engine.behind

    def before(self, command: Command) -> None:
        """``command`` comes next. Who could wait has (`quiet`); for the others the window that is
        half done is closed, and written down before. Raises `JournalError`."""
        if self._behind.is_within and not isinstance(command, ANYTIME):
            self._behind.finish()
            self._close_for(0.0, begins=False)

    def after_command(self) -> None:
        """A command is done: close what it made due, for a moment, and the rest in turns."""
        if self._behind.has_new and not self._holding:
            with suppress(JournalError):  # told, and tried again
                self._close_for(FIRST, new=True)
        if self._behind and self._task is None:
            self._task = asyncio.get_running_loop().create_task(self._catch_up(), context=Context())
        self._woken.set()

    async def quiet(self, is_stuck: Callable[[], bool]) -> None:
        """Return when no window is half done: before what changes more than streams. While
        ``is_stuck`` none can be told of."""
        self._holding += 1
        try:
            while self._behind.is_within:
                if is_stuck():
                    self._behind.finish()
                    return
                await asyncio.sleep(0.001)
        finally:
            self._holding -= 1

    async def caught_up(self, stream: str) -> None:
        """Return when nobody who reads ``stream`` is behind, or a moment has passed and none of
        them takes parts of a batch."""
        if not self._behind:
            return
        loop = asyncio.get_running_loop()
        until = loop.time() + _PATIENCE
        while behind := self._engine.behind_of(stream):
            # Else any number of samples would wait to be taken.
            takes = any(unit.is_taking for unit in behind)
            if loop.time() >= until and (not takes or self._is_stuck or self._task is None):
                break
            await asyncio.sleep(_LOOK)

    def is_overloaded(self, stream: str) -> bool:
        """Whether more samples for ``stream`` have to wait outside: a unit that reads it has worked
        for as long as a publisher waits, and is behind still. So a recording cannot be sent faster
        than it is evaluated, until some unit is cut off for it.

        Samples that are stamped on arrival do not wait: they would be other samples then.
        """
        pausing = self._pausing
        if pausing is None or not self._behind or self._is_stuck or self._task is None:
            return False
        generator = self._engine.generator(stream)
        if generator.stamped is not False:
            return False
        most = min(_PATIENCE, pausing.most / 4)
        return any(unit.spent >= most for unit in self._engine.behind_of(generator.name))

    def close(self) -> None:
        """What is behind stays so."""
        if self._task is not None:
            self._task.cancel()
        if self._pausing is not None:
            self._behind.finish()
            self._pausing.close()

    def _close_for(self, seconds: float, *, new: bool = False, begins: bool = True) -> None:
        assert self._pausing is not None
        self._pausing.allow(seconds)
        try:
            self._go_on(new=new, begins=begins)
        except JournalError:
            self._is_stuck = True
            raise
        self._is_stuck = False

    async def _catch_up(self) -> None:
        """Close windows, and let others do what they have to in between, until nobody is behind."""
        assert self._pausing is not None
        self._pausing.on_ready = waking(self._woken)
        try:
            while self._behind:
                await let_others()
                if self._behind.is_waiting:
                    await self._woken.wait()
                self._woken.clear()
                if self._holding and not self._behind.is_within:
                    continue
                try:
                    self._close_for(FURTHER, begins=not self._holding)
                except JournalError:
                    await asyncio.sleep(_LOOK)
            self._ended()
        except Exception as error:  # noqa: BLE001  told by log and /readyz
            self._failed(error)
        finally:
            self._task = None
