"""Doing commands, and waiting until they are kept: the service's way to change its engine.

    found = service.keeper.do(command)     # at once: the engine has done it
    await service.keeper.kept()            # then it may be told: it survives

Windows of continuous queries that take long are closed a little at a time, after the command that
made them due and between those that come next (`pausing`).

Requests that wait together share one write and sync of the log. What came of commands that are not
kept yet is shown to nobody: `Audience`. Without a data directory all of this costs nothing.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from contextvars import Context
from typing import Any, Protocol

import anyio
import anyio.to_thread

from ..engine.checkpoint import CheckpointError
from ..engine.commands import Command, EndStream, Publish, ReadAlready, TellUnkept, Tick, done
from ..engine.engine import Engine
from ..engine.recorded import DiskUse, RecordedEngine
from ..engine.remembering import Unkept
from ..engine.standing import Waiting
from ..journal.errors import JournalError
from .failures import Failures
from .journal_metrics import JournalTimes
from .logs import log
from .pausing import FIRST, FURTHER, Pausing
from .settings import Settings

JOURNAL = "journal"
CHECKPOINT = "checkpoint"
ENGINE = "engine"
SOURCES = "sources"
_SHARE = 20
"""A checkpoint for so many times the time that it takes: it holds up all else."""
_AGAIN = 10.0
"""Seconds after a checkpoint that failed until the next one is tried."""
_WAITING = 4 << 20
"""So many bytes may wait to be kept."""
_PASSES = 3
"""So often others have their turn between two turns of windows: a request takes some."""
_LOOK = 0.01
"""Seconds between two looks whether a stream's readers have caught up."""
_PATIENCE = 2.0
"""Seconds that who publishes waits for them: so a replay goes as fast as its queries do."""
_LATEST = 1.0
"""Seconds until what nobody waits for is kept."""
_DISK = 1.0
"""Seconds in which a disk tells how full it is."""


ANYTIME = (Publish, Tick, EndStream)
"""What can be done while a window is half done: units put by what they hear."""


class Audience(Protocol):
    """Those who look on from outside, and see only what is kept."""

    def mark(self) -> object:
        """What there is to be seen now."""

    def show(self, mark: Any) -> None:
        """Let them see what there was at ``mark``."""

    def keep_unseen(self, mark: Any) -> None:
        """What there was at ``mark`` is not kept yet."""

    @property
    def has_news(self) -> bool:
        """Whether there is more to be seen than is shown."""


class Keeper:
    """Does the commands of the service, one at a time, in the thread of its event loop.

    ``troubles``: why it keeps nothing at present, for people, by what fails; empty: all is well.
    """

    def __init__(
        self, engine: Engine, recorded: RecordedEngine | None, troubles: dict[str, str]
    ) -> None:
        self._engine = engine
        self._recorded = recorded
        turns = engine.behind.turns
        self._pausing = turns if isinstance(turns, Pausing) else None
        self._catching_up: asyncio.Task[None] | None = None
        self._woken = asyncio.Event()
        self._holding = 0
        """So many wait until no window is half done."""
        self._troubles = troubles
        self._failures = Failures()
        self._audience: Audience | None = None
        self._commit: asyncio.Task[None] | None = None
        self._hastening: set[asyncio.Task[None]] = set()
        self._thread = ThreadPoolExecutor(1, "dyknow-journal")
        self._looking = anyio.CapacityLimiter(1)
        self._written = 0
        """Bytes of the log at the last checkpoint."""
        self._kept_bytes = 0
        """And at the last commit."""
        self._worked = 0.0
        """Seconds of work since the last checkpoint: about as long a start would take."""
        self._cost = 0.0
        """Seconds that the last checkpoint held up all else."""
        self._begun: float | None = None
        self._not_before = float("-inf")
        """No checkpoint is tried before."""
        self._tended = float("-inf")
        self._unkept: set[Unkept] = set()
        """Processes of which was told that what they remember is not in checkpoints."""
        self.times = JournalTimes()
        """What writing takes."""

    @property
    def is_recording(self) -> bool:
        """Whether anything is kept."""
        return self._recorded is not None

    @property
    def is_kept(self) -> bool:
        """Whether all that was done is kept."""
        recorded = self._recorded
        return recorded is None or recorded.log.durable == recorded.log.position

    def not_started(self) -> tuple[Waiting, ...]:
        """What an earlier run has accepted and cannot be done at present, oldest first."""
        return () if self._recorded is None else self._recorded.waiting()

    def waits(self, kind: str) -> dict[str, Waiting]:
        """The same of one kind, by the id or name under which people give it up."""
        return {each.key.name: each for each in self.not_started() if each.key.kind == kind}

    def show_to(self, audience: Audience) -> None:
        """Whom to show what is kept."""
        self._audience = audience

    def do(self, command: Command, known: ReadAlready | None = None) -> Any:
        """Do ``command``; see `RecordedEngine.do`. What it makes due is done in part."""
        behind = self._engine.behind
        if behind.is_within and not isinstance(command, ANYTIME):
            # Whoever can wait has (`quiet`). What was closed before is written down before.
            behind.finish()
            self._go_on(0.0, begins=False)
        found = self._done(command, known)
        if behind.has_new and not self._holding:
            with suppress(JournalError):  # told, and tried again
                self._go_on(FIRST, new=True)
        if behind and self._catching_up is None:
            self._catching_up = asyncio.get_running_loop().create_task(
                self._catch_up(), context=Context()
            )
        self._woken.set()
        return found

    def _done(self, command: Command, known: ReadAlready | None) -> Any:
        if self._recorded is None:
            return done(self._engine, command, known)
        with self._recording():
            return self._recorded.do(command, known)

    def _go_on(self, seconds: float, *, new: bool = False, begins: bool = True) -> None:
        """Close windows for so long. Raises `JournalError`: none is closed then."""
        assert self._pausing is not None
        self._pausing.allow(seconds)
        if self._recorded is None:
            self._engine.go_on(new=new, begins=begins)
            return
        with self._recording():
            self._recorded.go_on(new=new, begins=begins)

    @contextmanager
    def _recording(self) -> Iterator[None]:
        """Something is done that is written down: what goes wrong is told."""
        assert self._recorded is not None
        begun = time.monotonic()
        try:
            yield
        except JournalError as error:
            self._fail(JOURNAL, error)
            raise
        finally:
            self._worked += time.monotonic() - begun
            if self._recorded.failure is not None:
                self._troubles[ENGINE] = self._recorded.failure
            self._note(SOURCES, self._recorded.unread)

    async def _catch_up(self) -> None:
        """Close windows, and let others do what they have to in between, until nobody is behind."""
        assert self._pausing is not None
        loop = asyncio.get_running_loop()

        def wake() -> None:
            with suppress(RuntimeError):  # the loop has come to its end
                loop.call_soon_threadsafe(self._woken.set)

        self._pausing.on_ready = wake
        behind = self._engine.behind
        try:
            while behind:
                for _ in range(_PASSES):
                    await asyncio.sleep(0)
                if behind.is_waiting:
                    await self._woken.wait()
                self._woken.clear()
                if self._holding and not behind.is_within:
                    continue
                try:
                    self._go_on(FURTHER, begins=not self._holding)
                except JournalError:
                    await asyncio.sleep(_LOOK)
            self.hasten()
        except Exception as error:  # noqa: BLE001  told by log and /readyz
            self._troubles[ENGINE] = f"{type(error).__name__}: {error}"
            log().exception("closing windows failed")
        finally:
            self._catching_up = None

    async def quiet(self) -> None:
        """Return when no window is half done: before what changes more than streams."""
        self._holding += 1
        try:
            while self._engine.behind.is_within:
                if JOURNAL in self._troubles:
                    # No window is told of before there is room.
                    self._engine.behind.finish()
                    return
                await asyncio.sleep(0.001)
        finally:
            self._holding -= 1

    async def caught_up(self, stream: str) -> None:
        """Return when nobody who reads ``stream`` is behind, or a moment has passed."""
        if not self._engine.behind:
            return
        loop = asyncio.get_running_loop()
        until = loop.time() + _PATIENCE
        while self._engine.is_behind(stream) and loop.time() < until:
            await asyncio.sleep(_LOOK)

    def check_room(self, size: int) -> None:
        """Before so many bytes are looked at: they can be kept. Raises `JournalError`."""
        if self._recorded is None:
            return
        try:
            self._recorded.log.check_room(size)
        except JournalError as error:
            self._fail(JOURNAL, error)
            raise

    @property
    def is_behind(self) -> bool:
        """Whether so much waits to be kept that who brings more should wait, too."""
        recorded = self._recorded
        return recorded is not None and recorded.log.written - self._kept_bytes > _WAITING

    @property
    def waiting(self) -> tuple[int, int]:
        """How many commands, and bytes of them, are done and wait to be kept."""
        recorded = self._recorded
        if recorded is None:
            return 0, 0
        log_ = recorded.log
        return log_.position - log_.durable, log_.written - self._kept_bytes

    @property
    def position(self) -> int:
        """How many commands the log has taken since there is one."""
        return 0 if self._recorded is None else self._recorded.log.position

    async def kept(self) -> None:
        """Return when all that is done by now is kept. Raises `JournalError`: then it may not be,
        and the same sent again under its Idempotency-Key does no harm."""
        if self._recorded is None:
            return
        log_ = self._recorded.log
        until = log_.position
        while log_.durable < until:
            # One that has begun may have begun before the last of it was done.
            await self._committed()

    def hasten(self) -> None:
        """Begin to keep what is done, for those who look on: nobody waits for it."""
        if not self.is_kept and self._commit is None:
            task = asyncio.get_running_loop().create_task(self.settled(), context=Context())
            self._hastening.add(task)
            task.add_done_callback(self._hastening.discard)

    async def settled(self) -> None:
        """Return when what was done before is kept, or cannot be at present: that is in
        `troubles`, and the next tick tries again."""
        try:
            await self.kept()
        except JournalError as error:
            log().debug("not kept yet", reason=str(error))

    async def _committed(self) -> None:
        if self._commit is None:
            # It is nobody's request's alone, and the log is not to say so.
            self._commit = asyncio.get_running_loop().create_task(
                self._commit_once(), context=Context()
            )
            # Those who wait hear of an error; if they have gone, `troubles` tells it.
            self._commit.add_done_callback(lambda done: done.cancelled() or done.exception())
        await asyncio.shield(self._commit)

    async def _commit_once(self) -> None:
        assert self._recorded is not None
        mark = None if self._audience is None else self._audience.mark()
        size = self._recorded.log.written
        try:
            await self._beside(self._commit_now)
        except JournalError as error:
            self.times.commit_failures.inc()
            if self._audience is not None:
                self._audience.keep_unseen(mark)
            self._fail(JOURNAL, error)
            raise
        finally:
            self._commit = None
        self.times.committed.inc(size - self._kept_bytes)
        self._kept_bytes = size
        self._recover(JOURNAL)
        if self._audience is not None:
            self._audience.show(mark)

    def _commit_now(self) -> None:
        """In the journal's own thread."""
        assert self._recorded is not None
        log_ = self._recorded.log
        before, begun = log_.durable, time.perf_counter()
        until = log_.commit()
        self.times.commit(time.perf_counter() - begun, until - before)

    async def tend(self, settings: Settings) -> None:
        """What is to be done now and then: keep what nobody waits for, if somebody is to see it or
        a second has passed; write a checkpoint when it is time. Raises `JournalError`."""
        recorded = self._recorded
        if recorded is None:
            return
        self._failures.review()
        now = asyncio.get_running_loop().time()
        if self._begun is None:
            self._begun = now
        audience = self._audience
        has_news = audience is not None and audience.has_news
        if not self.is_kept and (has_news or now - self._tended >= _LATEST):
            self._tended = now
            await self.kept()
        if self.is_kept and audience is not None and audience.has_news:
            # What came after the last commit had begun, and is in it.
            audience.show(audience.mark())
        written = recorded.log.written - self._written
        is_due = (
            (now - self._begun >= settings.checkpoint_interval and written > 0)
            or written >= settings.checkpoint_bytes
            or self._worked >= max(settings.checkpoint_work, _SHARE * self._cost)
        )
        if is_due and now >= self._not_before:
            self._begun = now
            await self._checkpoint(recorded)

    async def _checkpoint(self, recorded: RecordedEngine) -> None:
        """One that fails is told in ``troubles``, and tried again when it is time again."""
        await self.quiet()
        begun = time.monotonic()
        try:
            with self.times.step("state"):
                unwritten = recorded.checkpoint()
            self._worked, self._cost = 0.0, time.monotonic() - begun
            await self.kept()
            with self.times.step("disk"):
                await self._beside(unwritten.write)
        except (CheckpointError, JournalError, OSError) as error:
            self.times.checkpoint_failures.inc()
            # Each try costs as much as one that succeeds.
            self._not_before = asyncio.get_running_loop().time() + _AGAIN
            # All is kept by the log alone, which grows, and a start takes longer.
            self._fail(CHECKPOINT, error)
            return
        self._written = recorded.log.written
        self._recover(CHECKPOINT)
        for process in set(unwritten.unkept) - self._unkept:
            await self.quiet()
            self.do(TellUnkept(process.process, process.reason))
            self._unkept.add(process)
            log().warning(
                "the state of a process would not survive a restart", process=str(process)
            )

    async def disk_use(self) -> DiskUse | None:
        """What the data directory takes of the disk; None without one. Raises ``OSError``, and
        ``TimeoutError`` where the disk does not answer."""
        recorded = self._recorded
        if recorded is None:
            return None
        with anyio.fail_after(_DISK):
            # A limiter of its own: a disk that hangs takes no thread from anybody else.
            return await anyio.to_thread.run_sync(
                recorded.disk_use, limiter=self._looking, abandon_on_cancel=True
            )

    async def _beside(self, work: Callable[[], object]) -> None:
        """Do what waits for the disk in the journal's own thread, one thing at a time."""
        await asyncio.get_running_loop().run_in_executor(self._thread, work)

    def close(self) -> None:
        """Keep all there is, with a checkpoint, and let the directory go. What is behind stays so,
        and goes on at the next start."""
        if self._catching_up is not None:
            self._catching_up.cancel()
        if self._pausing is not None:
            self._engine.behind.finish()
            self._pausing.close()
        self._thread.shutdown()
        if self._recorded is not None:
            try:
                self._recorded.close()
            except (JournalError, CheckpointError, OSError) as error:
                # What was acknowledged is in the log: the next start does it again.
                log().error("no checkpoint at the end", reason=str(error))

    def _note(self, what: str, reason: str | None) -> None:
        """``what`` does not work for this ``reason``; None: it does."""
        if reason is None:
            self._recover(what)
            return
        self._troubles[what] = reason
        self._failures.failed(what, reason)

    def _fail(self, what: str, error: Exception) -> None:
        self._note(what, str(error))

    def _recover(self, what: str) -> None:
        if self._troubles.pop(what, None) is not None:
            self._failures.worked(what)
