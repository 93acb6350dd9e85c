"""Doing commands, and waiting until they are kept: the service's way to change its engine.

    found = service.keeper.do(command)     # at once: the engine has done it
    await service.keeper.kept()            # then it may be told: it survives

Windows of continuous queries that take long are closed a little at a time, after the command that
made them due and between those that come next (`backlog_task`).

Requests that wait together share one write and sync of the log. What came of commands that are not
kept yet is shown to nobody: `Audience`. Without a data directory all of this costs nothing.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import Context
from typing import Any, Protocol

import anyio
import anyio.to_thread

from ...engine.durability.accepted_commands import WaitingCommand
from ...engine.durability.checkpoint import CheckpointError
from ...engine.durability.commands import Command, ParsedBody, ReportUnkept, execute
from ...engine.durability.durable_engine import DiskUse, PendingCheckpoint, RecordedEngine
from ...engine.durability.process_state import Unkept
from ...engine.engine import Engine
from ...journal.errors import JournalError
from ..admission.memory_limit import Memory
from ..config.logs import log
from ..config.settings import Settings
from ..turns.backlog_task import BacklogTask
from .checkpoint_policy import CheckpointTimes
from .failure_log import Failures
from .fork_snapshot import CAN, SnapshotError, Snapshots
from .journal_metrics import JournalTimes

JOURNAL = "journal"
CHECKPOINT = "checkpoint"
ENGINE = "engine"
SOURCES = "sources"
_WAITING = 4 << 20
"""So many bytes may wait to be kept."""
_LATEST = 1.0
"""Seconds until what nobody waits for is kept."""
_DISK = 1.0
"""Seconds in which a disk tells how full it is."""


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
        self,
        engine: Engine,
        recorded: RecordedEngine | None,
        troubles: dict[str, str],
        memory: Memory | None = None,
    ) -> None:
        """Without ``memory`` there is no limit to it."""
        self._engine = engine
        self._recorded = recorded
        self._backlog = BacklogTask(engine, self._work_backlog, self.hasten, self._fault)
        self._memory = memory or Memory()
        self._troubles = troubles
        self._failures = Failures()
        self._audience: Audience | None = None
        self._commit: asyncio.Task[None] | None = None
        self._hastening: set[asyncio.Task[None]] = set()
        self._thread = ThreadPoolExecutor(1, "dyknow-journal")
        self._looking = anyio.CapacityLimiter(1)
        self._checkpoints = CheckpointTimes()
        self._checkpointing: asyncio.Task[None] | None = None
        self._snapshots = Snapshots()
        self._aside = CAN
        """Whether checkpoints are made by a copy of the process."""
        self._putting = ThreadPoolExecutor(1, "dyknow-checkpoints")
        self._kept_bytes = 0
        """Bytes of the log at the last commit."""
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

    def not_started(self) -> tuple[WaitingCommand, ...]:
        """What an earlier run has accepted and cannot be done at present, oldest first."""
        return () if self._recorded is None else self._recorded.waiting()

    def waits(self, kind: str) -> dict[str, WaitingCommand]:
        """The same of one kind, by the id or name under which people give it up."""
        return {each.key.name: each for each in self.not_started() if each.key.kind == kind}

    def show_to(self, audience: Audience) -> None:
        """Whom to show what is kept."""
        self._audience = audience

    def do(self, command: Command, known: ParsedBody | None = None) -> Any:
        """Do ``command``; see `RecordedEngine.do`. What it makes due is done in part."""
        self._backlog.before(command)
        found = self._done(command, known)
        self._backlog.after_command()
        return found

    def _done(self, command: Command, known: ParsedBody | None) -> Any:
        if self._recorded is None:
            return execute(self._engine, command, known)
        with self._recording():
            return self._recorded.do(command, known)

    def _work_backlog(self, *, new: bool = False, begins: bool = True) -> None:
        """See `backlog_task.Work`."""
        if self._recorded is None:
            self._engine.work_backlog(new=new, begins=begins)
            return
        with self._recording():
            self._recorded.work_backlog(new=new, begins=begins)

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
            self._checkpoints.worked += time.monotonic() - begun
            if self._recorded.failure is not None:
                self._troubles[ENGINE] = self._recorded.failure
            self._note(SOURCES, self._recorded.unread)

    def _fault(self, error: Exception) -> None:
        """Closing windows does not work: nothing is as it should be."""
        self._troubles[ENGINE] = f"{type(error).__name__}: {error}"
        log().error("closing windows failed", exc_info=error)

    async def windows_closed(self) -> None:
        """Return when no window is half done: before what changes more than streams."""
        # No window is told of before there is room.
        await self._backlog.windows_closed(lambda: JOURNAL in self._troubles)

    async def caught_up(self, stream: str) -> None:
        """Return when nobody who reads ``stream`` is behind, or a moment has passed."""
        await self._backlog.caught_up(stream)

    def is_overloaded(self, stream: str) -> bool:
        """Whether more samples for ``stream`` have to wait until the queries that read it have
        caught up."""
        return self._backlog.is_overloaded(stream)

    def check_room(self, size: int) -> None:
        """Before so many bytes are looked at: there is memory for more, and they can be kept.
        Raises a 503 `Problem`, and `JournalError`."""
        self._memory.check()
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
        audience = self._audience
        has_news = audience is not None and audience.has_news
        if not self.is_kept and (has_news or now - self._tended >= _LATEST):
            self._tended = now
            await self.kept()
        if self.is_kept and audience is not None and audience.has_news:
            # What came after the last commit had begun, and is in it.
            audience.show(audience.mark())
        if self._checkpointing is None and self._checkpoints.is_due(
            now, recorded.log.written, settings
        ):
            self._checkpointing = asyncio.create_task(self._checkpoint(recorded), context=Context())
            self._checkpointing.add_done_callback(self._has_checkpointed)

    def _has_checkpointed(self, task: asyncio.Task[None]) -> None:
        self._checkpointing = None
        if not task.cancelled() and (error := task.exception()) is not None:
            self._checkpoints.failed(asyncio.get_running_loop().time())
            self._troubles[CHECKPOINT] = f"{type(error).__name__}: {error}"
            log().error("a checkpoint failed", exc_info=error)

    async def _checkpoint(self, recorded: RecordedEngine) -> None:
        """One that fails is told in ``troubles``, and tried again when it is time again."""
        await self.windows_closed()
        begun = time.monotonic()
        try:
            with self.times.step("state"):
                unwritten = recorded.checkpoint(self._snapshots.take if self._aside else None)
            self._checkpoints.taken(recorded.log.written)
            with self.times.step("disk"):
                unkept = await self._put(unwritten)
            self._aside = CAN
        except (CheckpointError, JournalError, OSError) as error:
            if isinstance(error, SnapshotError):
                # The next one is made here, as long as that takes: better than none.
                self._aside = False
            self.times.checkpoint_failures.inc()
            self._checkpoints.failed(asyncio.get_running_loop().time())
            # All is kept by the log alone, which grows, and a start takes longer.
            self._fail(CHECKPOINT, error)
            return
        self._checkpoints.kept(time.monotonic() - begun)
        self._recover(CHECKPOINT)
        for process in set(unkept) - self._unkept:
            await self.windows_closed()
            self.do(ReportUnkept(process.process, process.reason))
            log().warning(
                "the state of a process would not survive a restart", process=str(process)
            )
        # No more than there are processes: a reason may be another one each time.
        self._unkept = set(unkept)

    async def _put(self, unwritten: PendingCheckpoint) -> tuple[Unkept, ...]:
        """Put a checkpoint on the disk and keep it, or leave nothing of it."""
        loop = asyncio.get_running_loop()
        try:
            unkept = await loop.run_in_executor(self._putting, unwritten.put)
            await self.kept()
            await self._beside(unwritten.keep)
        except (CheckpointError, JournalError, OSError):
            await loop.run_in_executor(self._putting, unwritten.drop)
            raise
        return unkept

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
        self._backlog.close()
        if self._checkpointing is not None:
            self._checkpointing.cancel()
        self._snapshots.end()
        # Nobody else writes into the directory when the last checkpoint is written.
        self._putting.shutdown()
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
