"""Executes commands, and waits until the log has them on disk: the only way to change the engine.

    result = service.commands.do(command)     # the engine executes it at once
    await service.commands.wait_durable()     # now the service may acknowledge it

A crash must not take back an acknowledged command or an event that a client has seen. `GatedOutput`
therefore holds back the effects of commands until the log has synced them. Requests that wait at
the same time share one write and sync. Without a data directory all of this costs nothing.

`backlog_task` closes slow windows in parts, after the command that made them due and between later
commands.
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
from ...streams.generator import StreamGenerator
from ..admission.memory_limit import Memory
from ..config.logs import log
from ..config.settings import Settings
from ..turns.backlog_task import BacklogTask
from .checkpoint_policy import CheckpointPolicy
from .failure_log import FailureLog
from .fork_snapshot import IS_SUPPORTED, SnapshotError, Snapshots
from .journal_metrics import JournalMetrics

JOURNAL = "journal"
CHECKPOINT = "checkpoint"
ENGINE = "engine"
SOURCES = "sources"
_MOST_UNCOMMITTED = 4 << 20
"""Bytes that may wait for a commit before live bodies wait too."""
_COMMIT_INTERVAL = 1.0
"""Seconds until a commit of commands that no request waits for."""
_DISK_TIMEOUT = 1.0
"""Seconds in which a disk must report its free space: a network disk may hang."""


class GatedOutput(Protocol):
    """Output to clients that is released when its commands are durable (`Feeds`)."""

    def take_pending(self) -> object:
        """Return the pending output. A later `release` or `requeue` gets it."""

    def release(self, pending: Any) -> None:
        """Show ``pending`` to clients: its commands are durable."""

    def requeue(self, pending: Any) -> None:
        """Make ``pending`` pending again: the commit failed."""

    @property
    def has_pending(self) -> bool:
        """Whether there is output that clients do not see yet."""


class CommandQueue:
    """Executes the commands of the service, one at a time, in the event loop's thread.

    ``troubles``: reasons for users why the queue does not work, by the failing part.
    """

    def __init__(
        self,
        engine: Engine,
        recorded: RecordedEngine | None,
        troubles: dict[str, str],
        memory: Memory | None = None,
    ) -> None:
        """Without ``memory`` there is no memory limit."""
        self._engine = engine
        self._recorded = recorded
        self._backlog = BacklogTask(
            engine, self._work_backlog, self.start_commit, self._backlog_failed
        )
        self._memory = memory or Memory()
        self._troubles = troubles
        self._failures = FailureLog()
        self._output: GatedOutput | None = None
        self._commit: asyncio.Task[None] | None = None
        self._commit_tasks: set[asyncio.Task[None]] = set()
        self._journal_thread = ThreadPoolExecutor(1, "dyknow-journal")
        self._disk_limiter = anyio.CapacityLimiter(1)
        self._checkpoints = CheckpointPolicy()
        self._checkpoint_task: asyncio.Task[None] | None = None
        self._snapshots = Snapshots()
        self._uses_fork = IS_SUPPORTED
        """Whether a fork of the process writes checkpoints."""
        self._checkpoint_thread = ThreadPoolExecutor(1, "dyknow-checkpoints")
        self._committed_bytes = 0
        """Bytes of the log that the last commit covers."""
        self._journal_failures = 0
        self._last_commit = float("-inf")
        self._unsaved: set[Unkept] = set()
        """User-written processes whose state checkpoints lack, and that were reported."""
        self.metrics = JournalMetrics()

    @property
    def is_recording(self) -> bool:
        """Whether there is a data directory."""
        return self._recorded is not None

    @property
    def is_durable(self) -> bool:
        """Whether the log has all commands on disk."""
        recorded = self._recorded
        return recorded is None or recorded.log.durable == recorded.log.position

    def deferred(self) -> tuple[WaitingCommand, ...]:
        """Return accepted commands of earlier runs that cannot be executed now, oldest first."""
        return () if self._recorded is None else self._recorded.waiting()

    def deferred_by_name(self, kind: str) -> dict[str, WaitingCommand]:
        """Return the deferred commands of one kind, by the id or name that removes them."""
        return {each.key.name: each for each in self.deferred() if each.key.kind == kind}

    def gate(self, output: GatedOutput) -> None:
        """Release ``output`` with each commit."""
        self._output = output

    def do(self, command: Command, prepared: ParsedBody | None = None) -> Any:
        """Execute ``command`` (`RecordedEngine.do`), and close windows that it makes due for a
        moment."""
        self._backlog.before(command)
        result = self._execute(command, prepared)
        self._backlog.after_command()
        return result

    def _execute(self, command: Command, prepared: ParsedBody | None) -> Any:
        if self._recorded is None:
            return execute(self._engine, command, prepared)
        with self._recording():
            return self._recorded.do(command, prepared)

    def _work_backlog(self, *, new: bool = False, begins: bool = True) -> None:
        """Implement `backlog_task.Work`."""
        if self._recorded is None:
            self._engine.work_backlog(new=new, begins=begins)
            return
        with self._recording():
            self._recorded.work_backlog(new=new, begins=begins)

    @contextmanager
    def _recording(self) -> Iterator[None]:
        """Measure recorded work, and report its failures in ``troubles``."""
        assert self._recorded is not None
        begun = time.monotonic()
        try:
            yield
        except JournalError as error:
            self._fail(JOURNAL, error)
            raise
        finally:
            self._checkpoints.work_seconds += time.monotonic() - begun
            if self._recorded.failure is not None:
                self._troubles[ENGINE] = self._recorded.failure
            self._set_trouble(SOURCES, self._recorded.unread)

    def _backlog_failed(self, error: Exception) -> None:
        """Report an error in the program: from now on the engine's state may be wrong."""
        self._troubles[ENGINE] = f"{type(error).__name__}: {error}"
        log().error("closing windows failed", exc_info=error)

    async def windows_closed(self) -> None:
        """Return when no window is half done, before a command that changes more than streams."""
        # The log records closed windows, so none can close while it takes no records.
        await self._backlog.windows_closed(lambda: JOURNAL in self._troubles)

    async def caught_up(self, stream: str) -> None:
        """Return when the readers of ``stream`` have caught up, or after two seconds."""
        await self._backlog.caught_up(stream)

    def is_overloaded(self, stream: StreamGenerator) -> bool:
        """Whether publishers of ``stream`` have to wait until its readers have caught up."""
        return self._backlog.is_overloaded(stream)

    def check_room(self, size: int) -> None:
        """Check that there is memory, and room in the log, for a body of ``size`` bytes. Raises a
        503 `Problem`, and `JournalError`."""
        self._memory.check()
        if self._recorded is None:
            return
        try:
            self._recorded.log.check_room(size)
        except JournalError as error:
            self._fail(JOURNAL, error)
            raise

    @property
    def is_full(self) -> bool:
        """Whether live bodies should wait for a commit before they bring more (back-pressure)."""
        recorded = self._recorded
        return (
            recorded is not None
            and recorded.log.written - self._committed_bytes > _MOST_UNCOMMITTED
        )

    @property
    def uncommitted(self) -> tuple[int, int]:
        """The number and the bytes of executed commands that wait for a commit."""
        recorded = self._recorded
        if recorded is None:
            return 0, 0
        log_ = recorded.log
        return log_.position - log_.durable, log_.written - self._committed_bytes

    @property
    def position(self) -> int:
        """The number of the last command in the log."""
        return 0 if self._recorded is None else self._recorded.log.position

    async def wait_durable(self) -> None:
        """Return when the log has all commands up to now on disk. After a `JournalError` that is
        unknown; a client may safely repeat its request under the same Idempotency-Key."""
        if self._recorded is None:
            return
        log_ = self._recorded.log
        until = log_.position
        while log_.durable < until:
            # A commit under way may have begun before the last command: then await the next one.
            await self._join_commit()

    def start_commit(self) -> None:
        """Begin a commit without waiting for it, so that clients see new output soon."""
        if not self.is_durable and self._commit is None:
            task = asyncio.get_running_loop().create_task(self.try_commit(), context=Context())
            self._commit_tasks.add(task)
            task.add_done_callback(self._commit_tasks.discard)

    async def try_commit(self) -> None:
        """Like `wait_durable`, but return also if the commit fails: ``troubles`` has the reason,
        and the next tick tries again."""
        try:
            await self.wait_durable()
        except JournalError as error:
            log().debug("not durable yet", reason=str(error))

    async def _join_commit(self) -> None:
        """Await the commit under way, or a new one."""
        if self._commit is None:
            # Many requests share it: an empty context keeps the id of this one out of the log.
            self._commit = asyncio.get_running_loop().create_task(
                self._commit_once(), context=Context()
            )
            # Retrieve the error, or asyncio warns if all waiting requests were cancelled.
            self._commit.add_done_callback(lambda done: done.cancelled() or done.exception())
        await asyncio.shield(self._commit)

    async def _commit_once(self) -> None:
        assert self._recorded is not None
        output = self._output
        # The commit covers all commands up to now, and perhaps none of those that follow.
        pending = None if output is None else output.take_pending()
        size, failures = self._recorded.log.written, self._journal_failures
        try:
            await self._in_journal_thread(self._write_and_sync)
        except JournalError as error:
            self.metrics.commit_failures.inc()
            if output is not None:
                output.requeue(pending)
            self._fail(JOURNAL, error)
            raise
        finally:
            self._commit = None
        self.metrics.written_bytes.inc(size - self._committed_bytes)
        self._committed_bytes = size
        if self._journal_failures == failures:  # Else it says nothing about what was refused since.
            self._recover(JOURNAL)
        if output is not None:
            output.release(pending)

    def _write_and_sync(self) -> None:
        """Commit the log, in the journal's own thread."""
        assert self._recorded is not None
        log_ = self._recorded.log
        before, begun = log_.durable, time.perf_counter()
        until = log_.commit()
        self.metrics.observe_commit(time.perf_counter() - begun, until - before)

    async def maintain(self, settings: Settings) -> None:
        """Commit if there is pending output or after `_COMMIT_INTERVAL`, and begin a checkpoint
        when one is due. Each tick calls this. Raises `JournalError`."""
        recorded = self._recorded
        if recorded is None:
            return
        self._failures.review()
        now = asyncio.get_running_loop().time()
        output = self._output
        has_pending = output is not None and output.has_pending
        if not self.is_durable and (has_pending or now - self._last_commit >= _COMMIT_INTERVAL):
            self._last_commit = now
            await self.wait_durable()
        if self.is_durable and output is not None and output.has_pending:
            # Output since `take_pending` of the last commit, of commands that it covers.
            output.release(output.take_pending())
        if self._checkpoint_task is None and self._checkpoints.is_due(
            now, recorded.log.written, settings
        ):
            self._checkpoint_task = asyncio.create_task(
                self._checkpoint(recorded), context=Context()
            )
            self._checkpoint_task.add_done_callback(self._checkpoint_ended)

    def _checkpoint_ended(self, task: asyncio.Task[None]) -> None:
        self._checkpoint_task = None
        if not task.cancelled() and (error := task.exception()) is not None:
            self._checkpoints.checkpoint_failed(asyncio.get_running_loop().time())
            self._troubles[CHECKPOINT] = f"{type(error).__name__}: {error}"
            log().error("a checkpoint failed", exc_info=error)

    async def _checkpoint(self, recorded: RecordedEngine) -> None:
        """Write a checkpoint. A failure goes to ``troubles``; the policy decides on the next."""
        await self.windows_closed()
        begun = time.monotonic()
        try:
            with self.metrics.time_step("state"):
                unwritten = recorded.checkpoint(self._snapshots.take if self._uses_fork else None)
            self._checkpoints.snapshot_taken(recorded.log.written)
            with self.metrics.time_step("disk"):
                unsaved = await self._write_checkpoint(unwritten)
            self._uses_fork = IS_SUPPORTED
        except (CheckpointError, JournalError, OSError) as error:
            if isinstance(error, SnapshotError):
                # The next one blocks the service while it is pickled, which is better than none.
                self._uses_fork = False
            self.metrics.checkpoint_failures.inc()
            self._checkpoints.checkpoint_failed(asyncio.get_running_loop().time())
            # No command is lost: the log grows, and the next start replays more of it.
            self._fail(CHECKPOINT, error)
            return
        self._checkpoints.checkpoint_written(time.monotonic() - begun)
        self._recover(CHECKPOINT)
        for process in set(unsaved) - self._unsaved:
            await self.windows_closed()
            self.do(ReportUnkept(process.process, process.reason))
            log().warning(
                "the state of a process would not survive a restart", process=str(process)
            )
        # Replaced, not extended: a process may give another reason each time.
        self._unsaved = set(unsaved)

    async def _write_checkpoint(self, unwritten: PendingCheckpoint) -> tuple[Unkept, ...]:
        """Write a checkpoint, and activate it once the log is durable. On failure, delete it."""
        loop = asyncio.get_running_loop()
        try:
            unsaved = await loop.run_in_executor(self._checkpoint_thread, unwritten.put)
            await self.wait_durable()
            # This syncs and shortens the log, so it must not run beside a commit.
            await self._in_journal_thread(unwritten.keep)
        except (CheckpointError, JournalError, OSError):
            await loop.run_in_executor(self._checkpoint_thread, unwritten.drop)
            raise
        return unsaved

    async def disk_use(self) -> DiskUse | None:
        """Return the disk use of the data directory; None without one. Raises ``OSError``, and
        ``TimeoutError`` if the disk does not respond."""
        recorded = self._recorded
        if recorded is None:
            return None
        with anyio.fail_after(_DISK_TIMEOUT):
            # A limiter of its own, so that a hanging disk blocks no thread of the shared pool.
            return await anyio.to_thread.run_sync(
                recorded.disk_use, limiter=self._disk_limiter, abandon_on_cancel=True
            )

    async def _in_journal_thread(self, work: Callable[[], object]) -> None:
        """Run ``work`` in the journal's thread, which waits for the disk."""
        await asyncio.get_running_loop().run_in_executor(self._journal_thread, work)

    def close(self) -> None:
        """Write a last checkpoint, and release the directory. The backlog goes on at the next
        start."""
        self._backlog.close()
        if self._checkpoint_task is not None:
            self._checkpoint_task.cancel()
        self._snapshots.kill()
        # No other thread may write into the directory during the last checkpoint.
        self._checkpoint_thread.shutdown()
        self._journal_thread.shutdown()
        if self._recorded is not None:
            try:
                self._recorded.close()
            except (JournalError, CheckpointError, OSError) as error:
                # The log has all acknowledged commands: the next start replays them.
                log().error("no checkpoint at the end", reason=str(error))

    def _set_trouble(self, part: str, reason: str | None) -> None:
        """Note why ``part`` does not work; None: it works."""
        if reason is None:
            self._recover(part)
            return
        self._troubles[part] = reason
        self._failures.report(part, reason)

    def _fail(self, part: str, error: Exception) -> None:
        self._journal_failures += part == JOURNAL
        self._set_trouble(part, str(error))

    def _recover(self, part: str) -> None:
        if self._troubles.pop(part, None) is not None:
            self._failures.report_success(part)
