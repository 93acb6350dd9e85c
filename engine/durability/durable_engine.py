"""An engine whose commands are written down before they are done, and done again at the next start
(docs/explanation/design/0007-the-journal.md).

A data directory holds the log of commands, and checkpoints of the engine between them. At a start
the engine of the newest checkpoint does again what the log has after it. What comes of it are the
same streams: the same samples under the same numbers, byte by byte.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
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
from ...journal.log import SEGMENT, Log
from ...languages.specification.ast import is_reserved
from ..processes.external_io import READINGS, Tape
from ..processes.registry import PROCESSES, Processes
from ..processes.supervision import DIRECT, Runner
from ..units.backlog import Turns
from ..units.work_time import Stopwatch
from .accepted_commands import Waiting
from .checkpoint import CheckpointError, Outside, program, state_of
from .commands import (
    REFUSALS,
    Command,
    HearOfSinks,
    OpenStream,
    Publish,
    ReadAlready,
    Refused,
    RegisterQuery,
    Tick,
    WorkBacklog,
    written,
)
from .missing_processes import origins
from .portable_state import portable_of
from .process_state import Unkept
from .recovery import Recovering, still_missing

T = TypeVar("T")

_WINDOWS = 1 << 16
"""Bytes that are kept free for which windows have closed, which is not known before."""


class RecordedRunner:
    """Calls as another runner does, and has a tape."""

    def __init__(self, runner: Runner) -> None:
        self.tape = Tape()
        self._runner = runner

    def run(self, work: Callable[[], T], deadline: int | None, progress: Callable[[], int]) -> T:
        return self._runner.run(work, deadline, progress)


@dataclass(frozen=True, slots=True)
class DiskUse:
    """What a data directory takes: bytes and files of the log, the newest checkpoint, if there is
    one, and the bytes that there is room for."""

    log_bytes: int
    log_files: int
    free: int
    checkpoint: Kept | None


class RecordedEngine:
    """The engine of a data directory. Called from one thread; `log` may be committed in another.

    Law (tests/laws): opened again after any command, with any part of what was not committed, the
    engine goes on as one that did the same commands and was never closed.

    What is done by `do` is kept when `Log.commit` has returned, not before: who tells others of it,
    or shows them what came of it, waits for that.
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
        """Raises `JournalError`: the directory is in use, of another format or damaged.

        ``progress`` is told now and then how many commands are done again, and of how many.
        """
        self._runner = RecordedRunner(runner)
        self._outside = Outside(processes, self._runner, stopwatch, budget, turns)
        self._program = program(processes)
        self._within = False
        self._asked_for: list[OpenStream] = []
        """Those that the command asked for that is done at present."""
        self._unwritten: list[Command] = []
        """What was done while the log took nothing: streams opened, commands refused."""
        self.refused_outside: tuple[type[Exception], ...] = ()
        """What those raise who are asked within a command (`Engine.before_demand`): before anything
        is done, and not when it is done again."""
        self.failure: str | None = None
        """What failed within a command, so that nobody knows what of it was done."""
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
            recovering = Recovering(
                self._directory,
                self.log,
                self._checkpoints,
                self._outside,
                self._runner.tape,
                self._program,
            )
            self.recovery = recovering.found
            self.engine = recovering.run(now, progress)
            self._standing, self._needed = recovering.standing, recovering.needed
            self.engine.on_opened(self._opened)
            self.log.commit()
            self._directory.forget_loss()
            if self._directory.old_store is not None:
                self.checkpoint().write()
                self._directory.forget_old_store()
            elif not self.recovery.is_continued:
                self._settle_down()
        except BaseException:
            self._directory.close()
            raise

    # -- doing -------------------------------------------------------------------------------

    def do(self, command: Command, known: ReadAlready | None = None) -> Any:
        """Write ``command`` down, and do it; gives what it gives. ``known`` is what of it is
        read already.

        Raises `JournalFull` and `JournalBroken`, and what the command does: nothing is written
        down then, and nothing done.
        """
        refusals: tuple[type[Exception], ...] = (*REFUSALS, *self.refused_outside)
        self._write_opened()
        self._hear_of_sinks()
        if isinstance(command, RegisterQuery):
            # Its name is written down where the text says none: by it people know it.
            name = self.engine.queries.name_for(command.text)
            if is_reserved(name):
                command = msgspec.structs.replace(command, name=name)
        # What cannot be written is not begun.
        text = written(command)
        self._within = True
        try:
            with self.log.entry(text) as entry:
                # What sources say is not known before: the tape asks for room as they say it.
                begun = len(entry.payload) + READINGS
                self._runner.tape.record(lambda size: entry.has_room(begun + size))
                found = self._standing.do(self.engine, command, known)
                readings = self._runner.tape.readings()
                if readings and isinstance(command, Tick):
                    entry.payload = written(Tick(command.now, readings))
        except JournalError:
            raise
        except refusals as error:
            # It is not done, but may have left something on the way. A batch leaves but streams.
            self._unwritten += self._asked_for
            if isinstance(error, REFUSALS) and not isinstance(command, Publish | Tick):
                self._unwritten.append(Refused(written(command)))
            self._write_what_can_be()
            raise
        except Exception as error:
            self.failure = f"{type(error).__name__} in a command: {error}"
            raise
        finally:
            self._within = False
            self._asked_for.clear()
        self._standing.note(command, found)
        self._hear_if_there_is_room()
        return found

    def work_backlog(self, *, new: bool = False, begins: bool = True) -> None:
        """Close windows that are due (`Backlog.work`), and log which.

        Raises `JournalFull` and `JournalBroken`: nothing is done then.
        """
        self._write_opened()
        self._hear_of_sinks()
        self._within = True
        try:
            self.log.check_room(_WINDOWS)
            with self.log.entry(written(WorkBacklog())) as entry:
                done = self.engine.work_backlog(new=new, begins=begins)
                entry.payload = written(WorkBacklog(done)) if done else b""
        except JournalError:
            raise
        except Exception as error:
            self.failure = f"{type(error).__name__} in closing windows: {error}"
            raise
        finally:
            self._within = False
            self._asked_for.clear()
        self._hear_if_there_is_room()

    @property
    def unread(self) -> str | None:
        """Which sources are not asked at present, and why; None: all are."""
        return self._runner.tape.unread

    def waiting(self) -> tuple[Waiting, ...]:
        """What an earlier run has accepted and cannot be done at present, oldest first."""
        return self._standing.waiting_views()

    def checkpoint(self, aside: Aside | None = None) -> Unwritten:
        """The state as it is now, to be written by `Unwritten.write`, in any thread.

        Contract: no window is half done (`Backlog.is_mid_window`). Raises `CheckpointError` where
        something cannot be written down; with ``aside``, which finds the state later, `write` does.
        Cost: O(state), or what ``aside`` takes.
        """
        if self.failure is not None:
            raise CheckpointError(f"the state is not to be trusted: {self.failure}")
        self._hear_if_there_is_room()
        if self._runner.tape.outcomes:
            raise CheckpointError("what went wrong in sinks could not be written down yet")
        position = self.log.position
        if aside is not None:
            found_aside = aside(lambda: self._put(*self._found()), self.engine.ontology.lock)
            return Unwritten(position, found_aside, self.log, self._checkpoints)
        found, unkept = self._found()
        return Unwritten(position, lambda: self._put(found, unkept), self.log, self._checkpoints)

    def _found(self) -> tuple[Checkpoint, tuple[Unkept, ...]]:
        """The state, and what could not be written of it."""
        state = state_of(self.engine, self._standing, self._outside)
        known = self._outside.processes
        gone = still_missing(self.engine, self._standing, self._needed, known)
        processes = gone | origins(known)
        portable = portable_of(self.engine, self._standing, processes, state.unkept)
        encoded = msgspec.msgpack.encode(portable)
        return Checkpoint(self.log.position, self._program, encoded, state.data), state.unkept

    def _put(self, found: Checkpoint, unkept: tuple[Unkept, ...]) -> tuple[Unkept, ...]:
        self._checkpoints.put(found)
        return unkept

    def disk_use(self) -> DiskUse:
        """What it takes of the disk at present. May be asked in any thread. Raises ``OSError``."""
        return DiskUse(
            self.log.size,
            self.log.segments,
            self._disk.free(self._directory.path),
            self._checkpoints.newest(),
        )

    def close(self, *, checkpoint: bool = True) -> None:
        """Commit what there is; with ``checkpoint`` the next start has nothing to do again."""
        try:
            if checkpoint:
                self.checkpoint().write()
        finally:
            try:
                self.log.close()
            finally:
                self._directory.close()

    # -- within ------------------------------------------------------------------------------

    def _opened(self, stream: str) -> None:
        """Somebody has asked for a stream that is there only now. Within a command, doing that
        again opens it again."""
        if self._within:
            self._asked_for.append(OpenStream(stream))
        else:
            self._unwritten.append(OpenStream(stream))
            self._write_what_can_be()

    def _write_what_can_be(self) -> None:
        try:
            self._write_opened()
        except JournalError:
            # Who reads need not hear of it: it is written down before the next command is done.
            return

    def _write_opened(self) -> None:
        while self._unwritten:
            self.log.append(written(self._unwritten[0]))
            del self._unwritten[0]

    def _hear_if_there_is_room(self) -> None:
        try:
            self._hear_of_sinks()
        except JournalError:
            # Nobody is told of it before: it is written down before the next command is done.
            return

    def _hear_of_sinks(self) -> None:
        """Write down what went wrong in sinks, and have it told: a command by itself, as sinks are
        called by any. What is told may be read by sinks, and go wrong there."""
        tape = self._runner.tape
        while tape.outcomes:
            command = HearOfSinks(tuple(tape.outcomes))
            self._within = True
            try:
                with self.log.entry(written(command)):
                    del tape.outcomes[: len(command.outcomes)]
                    command.apply(self.engine)
            except JournalError:
                raise
            except Exception as error:
                self.failure = f"{type(error).__name__} in telling of sinks: {error}"
                raise
            finally:
                self._within = False
                self._asked_for.clear()

    def _settle_down(self) -> None:
        """Write a checkpoint of a life that has just begun: else each start before the first one
        would begin another, whose ids nobody can resume."""
        try:
            self.checkpoint().write()
        except (CheckpointError, JournalError, OSError) as error:
            self.recovery.notes.append(f"no checkpoint yet: {error}")


class Aside(Protocol):
    """Does what takes long on the state as it is now, while that goes on to change."""

    def __call__(
        self, work: Callable[[], T], lock: AbstractContextManager[object]
    ) -> Callable[[], T]:
        """Gives what waits for what ``work`` gives, in any thread. Both raise `CheckpointError`.

        ``lock``: under which other threads change some of the state.
        """


@dataclass(frozen=True, slots=True)
class Unwritten:
    """A checkpoint after command ``position`` that is not kept yet."""

    position: int
    _put: Callable[[], tuple[Unkept, ...]]
    _log: Log
    _checkpoints: Checkpoints

    def put(self) -> tuple[Unkept, ...]:
        """Put it on the disk, where nobody looks for it yet. Gives the user-written processes whose
        state cannot be written down: what they are, and why. Raises `JournalError`, and
        `CheckpointError` where the state is found only now."""
        return self._put()

    def keep(self) -> None:
        """Let the next start begin with it, and forget of the log what no checkpoint needs. Raises
        `JournalError`."""
        # Never ahead of the log: its numbers would be given twice.
        if self._log.synced < self.position:
            self._log.sync()
        self._checkpoints.keep(self.position)
        self._log.drop(min(self._checkpoints.positions()))

    def drop(self) -> None:
        """It is not to be kept: leave nothing of it. Who has made it may have been killed. Raises
        ``OSError``."""
        self._checkpoints.drop(self.position)

    def write(self) -> tuple[Unkept, ...]:
        """`put` and `keep`; gives what `put` gives."""
        unkept = self.put()
        self.keep()
        return unkept
