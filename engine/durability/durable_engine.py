"""An engine that logs its commands before it executes them, and replays them at the next start
(docs/explanation/design/0007-the-journal.md).

A data directory contains the log of commands and checkpoints of the engine. At a start the engine
of the newest checkpoint replays the commands after it. The resulting streams are the same: the same
samples under the same numbers, byte by byte.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

import msgspec

from ...continuous.columns.budget import UNLIMITED, Budget
from ...journal.checkpoints import Checkpoint, Checkpoints, Kept
from ...journal.directory import DataDirectory
from ...journal.disk import DISK, Disk
from ...journal.durability import Durability
from ...journal.errors import JournalError
from ...journal.log import SEGMENT, Entry, Log
from ...languages.specification.ast import is_reserved
from ..processes.external_io import READINGS, Tape
from ..processes.registry import PROCESSES, Processes
from ..processes.supervision import DIRECT, Runner
from ..units.backlog import Turns
from ..units.work_time import Stopwatch
from .accepted_commands import WaitingCommand
from .checkpoint import CheckpointError, Outside, program, state_of
from .commands import (
    REFUSALS,
    Command,
    OpenStream,
    ParsedBody,
    Publish,
    Refused,
    RegisterQuery,
    ReportSinkFailures,
    Tick,
    WorkBacklog,
    encode_command,
)
from .missing_processes import process_modules
from .portable_state import portable_of
from .process_state import Unkept
from .recovery import RecoveryRun, still_missing

T = TypeVar("T")

_WINDOWS = 1 << 16
"""Bytes reserved for the record of closed windows, whose size is not known before they close."""


class RecordedRunner:
    """Runs user-written code by another runner, and has the tape of its results."""

    def __init__(self, runner: Runner) -> None:
        self.tape = Tape()
        self._runner = runner

    def run(self, work: Callable[[], T], deadline: int | None, progress: Callable[[], int]) -> T:
        return self._runner.run(work, deadline, progress)


@dataclass(frozen=True, slots=True)
class DiskUse:
    """The size of a data directory: bytes and files of the log, the position of its oldest command,
    free bytes of the disk, and the newest checkpoint, if there is one."""

    log_bytes: int
    log_files: int
    log_first: int
    free: int
    checkpoint: Kept | None


class RecordedEngine:
    """The engine of a data directory. One thread calls it; another may commit `log`.

    Law (tests/laws): reopened after any command, with any part of the uncommitted records, the
    engine behaves like one that executed the same commands and was never closed.

    A command is durable when `Log.commit` has returned. The caller has to wait for that before it
    acknowledges the command or shows its results.
    """

    def __init__(
        self,
        path: Path,
        *,
        now: int,
        processes: Processes = PROCESSES,
        runner: Runner = DIRECT,
        stopwatch: Stopwatch | None = None,
        budget: Budget = UNLIMITED,
        turns: Turns | None = None,
        durability: Durability = Durability.FSYNC,
        segment: int = SEGMENT,
        disk: Disk = DISK,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Raises `JournalError`: the directory is in use, has another format or is damaged. Calls
        ``progress`` during a replay with the number of replayed commands and of all."""
        self._runner = RecordedRunner(runner)
        self._outside = Outside(processes, self._runner, stopwatch, budget, turns)
        self._program = program(processes)
        self._is_executing = False
        self._opened_on_demand: list[OpenStream] = []
        """Streams that the present command has created on demand."""
        self._pending_records: list[Command] = []
        """Records to append before the next command: opened streams and refused commands, which
        the log could not take yet."""
        self.refused_outside: tuple[type[Exception], ...] = ()
        """Errors of `Engine.before_demand`, which the service sets. They are raised before a
        command has changed anything; a replay does not call it, so they are not logged."""
        self.failure: str | None = None
        """An unexpected error within a command. The state is undefined since, so no checkpoint is
        made of it."""
        self._disk = disk
        self._directory = DataDirectory(path, disk)
        try:
            self._checkpoints = Checkpoints(self._directory.checkpoints, disk)
            self.log = Log(
                self._directory.journal,
                durability=durability,
                segment=segment,
                disk=disk,
                on_doubt=self._directory.note_loss,
            )
            recovery = RecoveryRun(
                self._directory,
                self.log,
                self._checkpoints,
                self._outside,
                self._runner.tape,
                self._program,
            )
            self.recovery = recovery.report
            self.engine = recovery.run(now, progress)
            self._accepted, self._needed = recovery.accepted, recovery.needed
            self.engine.on_opened(self._on_opened)
            self.log.commit()
            # The log has the new epoch on the disk now, so the note about the loss has served.
            self._directory.forget_loss()
            if self._directory.old_store is not None:
                # Until a checkpoint has the definitions of the old store, no other file has them.
                self.checkpoint().write()
                self._directory.forget_old_store()
            elif not self.recovery.is_continued:
                self._write_first_checkpoint()
        except BaseException:
            self._directory.close()
            raise

    # -- commands ----------------------------------------------------------------------------

    def do(self, command: Command, parsed: ParsedBody | None = None) -> Any:
        """Log ``command``, execute it and return its result. ``parsed``: its parsed body.

        Raises `JournalFull`, `JournalBroken` and the errors of the command. Then the command was
        not executed, and the log has at most a record that it was `Refused`.
        """
        refusals: tuple[type[Exception], ...] = (*REFUSALS, *self.refused_outside)
        self._log_pending()
        if isinstance(command, RegisterQuery):
            # Users refer to an unnamed query by the name that the engine gave it. Logging the name
            # makes every replay give the same one.
            name = self.engine.queries.name_for(command.text)
            if is_reserved(name):
                command = msgspec.structs.replace(command, name=name)
        try:
            with self._executing(command, "a command", refusals) as entry:
                # The size of the sources' results is not known before, so the tape checks for room
                # as it records them.
                begun = len(entry.payload) + READINGS
                self._runner.tape.record(lambda size: entry.has_room(begun + size))
                result = self._accepted.do(self.engine, command, parsed)
                readings = self._runner.tape.readings()
                if readings and isinstance(command, Tick):
                    entry.payload = encode_command(Tick(command.now, readings))
        except JournalError:
            raise
        except refusals as error:
            # A refused command may still have had effects, which a replay must repeat: streams
            # opened on demand, numbers used. A batch can only have opened streams.
            self._pending_records += self._opened_on_demand
            if isinstance(error, REFUSALS) and not isinstance(command, Publish | Tick):
                self._pending_records.append(Refused(encode_command(command)))
            self._try_append_pending()
            raise
        self._accepted.record(command, result)
        self._try_report_sink_failures()
        return result

    def work_backlog(self, *, new: bool = False, begins: bool = True) -> None:
        """Close due windows (`Backlog.work`), and log which.

        Raises `JournalFull` and `JournalBroken`, and closes no window then.
        """
        self._log_pending()
        # Closing a window cannot be undone, so its record needs room before.
        self.log.check_room(_WINDOWS)
        with self._executing(WorkBacklog(), "closing windows") as entry:
            done = self.engine.work_backlog(new=new, begins=begins)
            entry.payload = encode_command(WorkBacklog(done)) if done else b""
        self._try_report_sink_failures()

    @property
    def unread(self) -> str | None:
        """The sources that are not read at present, and why; None: all are read."""
        return self._runner.tape.unread

    def waiting(self) -> tuple[WaitingCommand, ...]:
        """Commands that an earlier run accepted and this one cannot execute, oldest first."""
        return self._accepted.waiting_views()

    def checkpoint(self, aside: SnapshotRunner | None = None) -> PendingCheckpoint:
        """Take a snapshot of the state; `PendingCheckpoint.write` writes it, in any thread.

        Contract: no window is half done (`Backlog.is_mid_window`). Raises `CheckpointError` where
        something cannot be pickled; with ``aside``, which pickles later, `write` raises it.
        Cost: O(state), or that of ``aside``.
        """
        if self.failure is not None:
            raise CheckpointError(f"the state is undefined since an error: {self.failure}")
        self._try_report_sink_failures()
        if self._runner.tape.outcomes:
            # The tape is no part of the state, so a start from this checkpoint would lose them.
            raise CheckpointError("failures of sinks could not be logged yet")
        position = self.log.position
        if aside is not None:
            wait_for_pickle = aside(lambda: self._put(*self._capture()), self.engine.ontology.lock)
            return PendingCheckpoint(position, wait_for_pickle, self.log, self._checkpoints)
        captured, unkept = self._capture()
        return PendingCheckpoint(
            position, lambda: self._put(captured, unkept), self.log, self._checkpoints
        )

    def _capture(self) -> tuple[Checkpoint, tuple[Unkept, ...]]:
        """Pickle the state; return it with the process states that it lacks."""
        state = state_of(self.engine, self._accepted, self._outside)
        loaded = self._outside.processes
        gone = still_missing(self.engine, self._accepted, self._needed, loaded)
        processes = gone | process_modules(loaded)
        portable = portable_of(self.engine, self._accepted, processes, state.unkept)
        encoded = msgspec.msgpack.encode(portable)
        return Checkpoint(self.log.position, self._program, encoded, state.data), state.unkept

    def _put(self, checkpoint: Checkpoint, unkept: tuple[Unkept, ...]) -> tuple[Unkept, ...]:
        self._checkpoints.put(checkpoint)
        return unkept

    def disk_use(self) -> DiskUse:
        """Measure the data directory, in any thread. Raises ``OSError``."""
        return DiskUse(
            self.log.size,
            self.log.segments,
            self.log.first,
            self._disk.free(self._directory.path),
            self._checkpoints.newest(),
        )

    def close(self, *, checkpoint: bool = True) -> None:
        """Commit the log and close the directory. With ``checkpoint`` the next start replays
        nothing."""
        try:
            if checkpoint:
                self.checkpoint().write()
        finally:
            try:
                self.log.close()
            finally:
                self._directory.close()

    # -- internals ---------------------------------------------------------------------------

    @contextmanager
    def _executing(
        self, command: Command, work: str, refusals: tuple[type[Exception], ...] = ()
    ) -> Iterator[Entry]:
        """Execute ``command`` in the body, with its entry of the log: the only way to change the
        engine. Records an error that is none of ``refusals``."""
        expected: tuple[type[Exception], ...] = (JournalError, *refusals)
        # Encode first: a command that cannot be encoded must not be executed.
        text = encode_command(command)
        self._opened_on_demand.clear()
        self._is_executing = True
        try:
            with self.log.entry(text) as entry:
                yield entry
        except expected:
            raise
        except Exception as error:
            self.failure = f"{type(error).__name__} in {work}: {error}"
            raise
        finally:
            self._is_executing = False

    def _on_opened(self, stream: str) -> None:
        """Log that a stream was created on demand. A replay of the present command, if there is
        one, creates it again, so only a refused command needs the record."""
        if self._is_executing:
            self._opened_on_demand.append(OpenStream(stream))
        else:
            self._pending_records.append(OpenStream(stream))
            self._try_append_pending()

    def _try_append_pending(self) -> None:
        try:
            self._append_pending()
        except JournalError:
            # A reader's request must not fail for this: the next command appends the records first.
            return

    def _log_pending(self) -> None:
        """Log what the next command must come after."""
        self._append_pending()
        self._report_sink_failures()

    def _append_pending(self) -> None:
        while self._pending_records:
            self.log.append(encode_command(self._pending_records[0]))
            del self._pending_records[0]

    def _try_report_sink_failures(self) -> None:
        try:
            self._report_sink_failures()
        except JournalError:
            # The failures stay on the tape, unreported, until the next command logs them.
            return

    def _report_sink_failures(self) -> None:
        """Log failures of sinks and report them, as a command of its own: any command may call
        sinks. A loop, since a sink may read the status stream and fail on the report."""
        tape = self._runner.tape
        while tape.outcomes:
            command = ReportSinkFailures(tuple(tape.outcomes))
            with self._executing(command, "reporting failures of sinks"):
                del tape.outcomes[: len(command.outcomes)]
                command.apply(self.engine)

    def _write_first_checkpoint(self) -> None:
        """Write a checkpoint of a new epoch. Without one, each start before the first checkpoint
        would begin another epoch, and clients could not resume."""
        try:
            self.checkpoint().write()
        except (CheckpointError, JournalError, OSError) as error:
            self.recovery.notes.append(f"no checkpoint yet: {error}")


class SnapshotRunner(Protocol):
    """Runs long work on a snapshot of the state, for example in a fork, while the state itself
    changes further."""

    def __call__(
        self, work: Callable[[], T], lock: AbstractContextManager[object]
    ) -> Callable[[], T]:
        """Start ``work`` and return a function that waits for its result, in any thread. Both
        raise `CheckpointError`. Other threads change parts of the state under ``lock`` only.
        """


@dataclass(frozen=True, slots=True)
class PendingCheckpoint:
    """A checkpoint after command ``position`` that is not in use yet."""

    position: int
    _put: Callable[[], tuple[Unkept, ...]]
    _log: Log
    _checkpoints: Checkpoints

    def put(self) -> tuple[Unkept, ...]:
        """Write it to a file that a start does not read yet; return the process states that it
        lacks. Raises `JournalError`, and `CheckpointError` where the state is pickled only now."""
        return self._put()

    def keep(self) -> None:
        """Let the next start use it, and drop the part of the log that no checkpoint needs. Raises
        `JournalError`."""
        # A checkpoint ahead of the durable log would have record numbers that are used again.
        if self._log.synced < self.position:
            self._log.sync()
        self._checkpoints.keep(self.position)
        # The newest checkpoint may get damaged, so the log goes back to the older one.
        self._log.drop(min(self._checkpoints.positions()))

    def drop(self) -> None:
        """Delete it and its partial files; the process that wrote it may have been killed. Raises
        ``OSError``."""
        self._checkpoints.drop(self.position)

    def write(self) -> tuple[Unkept, ...]:
        """`put` and `keep`; return the result of `put`."""
        unkept = self.put()
        self.keep()
        return unkept
