"""An engine whose commands are written down before they are done, and done again at the next start
(docs/design/0007-the-journal.md).

A data directory holds the log of commands, and checkpoints of the engine between them. At a start
the engine of the newest checkpoint does again what the log has after it. What comes of it are the
same streams: the same samples under the same numbers, byte by byte.
"""

from __future__ import annotations

import secrets
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from ..continuous.budget import UNLIMITED, Budget
from ..journal.checkpoints import Checkpoint, Checkpoints, Kept
from ..journal.directory import DataDirectory
from ..journal.disk import DISK, Disk
from ..journal.errors import JournalDamaged, JournalError
from ..journal.log import SEGMENT, Durability, Log
from ..ontology.ontology import Ontology
from .busy import Stopwatch
from .checkpoint import CheckpointError, Outside, engine_of, program, state_of
from .commands import (
    REFUSALS,
    Begin,
    Command,
    OpenStream,
    Publish,
    ReadAlready,
    Refused,
    Tick,
    done,
    read,
    written,
)
from .engine import Engine
from .portable import Portable, Standing, engine_from, portable_of
from .processes import PROCESSES, Processes
from .supervision import DIRECT, Runner
from .tape import Tape

T = TypeVar("T")

_READINGS = 1 << 16
"""Bytes that are kept free for what sources say in a tick, which is not known before."""


class RecordedRunner:
    """Calls as another runner does, and has a tape."""

    def __init__(self, runner: Runner) -> None:
        self.tape = Tape()
        self._runner = runner

    def run(self, work: Callable[[], T], deadline: int | None, progress: Callable[[], int]) -> T:
        return self._runner.run(work, deadline, progress)


@dataclass(slots=True)
class Recovery:
    """What a start has found. ``notes``: what people should know, worst first."""

    position: int = 0
    """The checkpoint's position; 0: there was none."""
    replayed: int = 0
    """So many commands were done again."""
    is_continued: bool = True
    """Whether numbers and ids go on from where they were."""
    notes: list[str] = field(default_factory=list)


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
        durability: Durability = Durability.FSYNC,
        segment: int = SEGMENT,
        disk: Disk = DISK,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """Raises `JournalError`: the directory is in use, of another format or damaged.

        ``progress`` is told now and then how many commands are done again, and of how many.
        """
        self.recovery = Recovery()
        self._runner = RecordedRunner(runner)
        self._outside = Outside(processes, self._runner, stopwatch, budget)
        self._standing = Standing()
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
                self._directory.journal, durability=durability, segment=segment, disk=disk
            )
            if self.log.torn is not None:
                self.recovery.notes.append(f"cut off, an unfinished write: {self.log.torn}")
            if self.log.lost:
                self._begin_anew(f"the last {self.log.lost} commands that were kept are lost")
            if self._directory.repaired is not None:
                self._begin_anew(f"the directory was repaired: {self._directory.repaired}")
            self.engine = self._recovered(now, progress)
            self.engine.on_opened(self._opened)
            self.log.commit()
            self._directory.forget_repair()
            if self._directory.old_store is not None:
                self.checkpoint().write()
                self._directory.forget_old_store()
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
        self._within = True
        try:
            with self.log.entry(written(command), _READINGS) as entry:
                self._runner.tape.record()
                found = done(self.engine, command, known)
                readings = self._runner.tape.taken()
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
        return found

    def checkpoint(self) -> Unwritten:
        """The state as it is now, to be written by `Unwritten.write`, in any thread.

        Raises `CheckpointError` where something cannot be written down. Cost: O(state).
        """
        if self.failure is not None:
            raise CheckpointError(f"the state is not to be trusted: {self.failure}")
        position = self.log.position
        unkept: list[str] = []
        state = state_of(self.engine, self._standing, self._outside, unkept)
        portable = msgspec.msgpack.encode(portable_of(self.engine, self._standing))
        found = Checkpoint(position, program(), portable, state)
        return Unwritten(found, self.log, self._checkpoints, tuple(unkept))

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

    def _recovered(self, now: int, progress: Callable[[int, int], None] | None) -> Engine:
        found = self._from_checkpoint(now)
        if found is None:
            found = self._from_nothing(now)
        engine, done = found
        count = self.log.position - done
        self._runner.tape.is_playing = True
        for position, data in self.log.read(done):
            self._again(engine, position, data)
            self.recovery.replayed += 1
            if progress is not None and self.recovery.replayed % 1000 == 0:
                progress(self.recovery.replayed, count)
        self._runner.tape.is_playing = False
        if not self.recovery.is_continued:
            begin = Begin(secrets.token_hex(4), now, program())
            self.log.append(written(begin))
            begin.apply(engine)
        return engine

    def _from_checkpoint(self, now: int) -> tuple[Engine, int] | None:
        """The engine of the newest checkpoint that is sound, and its position."""
        for position in self._checkpoints.positions():
            try:
                kept = self._checkpoints.read(position)
                found = self._from(kept, now)
            except (JournalDamaged, CheckpointError) as error:
                self.recovery.notes.append(f"a checkpoint is passed over: {error}")
                continue
            if position > self.log.position or position + 1 < self.log.first:
                raise JournalDamaged(
                    f"the checkpoint is of record {position}, the log has records "
                    f"{self.log.first} to {self.log.position}",
                    "restore the folder from a backup (dyknow restore)",
                )
            self.recovery.position = position
            return found, position
        return None

    def _from(self, kept: Checkpoint, now: int) -> Engine:
        """The engine of a checkpoint; raises `CheckpointError`."""
        reason = f"the directory was written by {kept.program}, this is {program()}"
        if kept.program == program():
            try:
                engine, self._standing = engine_of(kept.state, self._outside)
                return engine
            except CheckpointError as error:
                # Of user-written processes it may name what is not there any more.
                reason = str(error)
        try:
            portable = msgspec.msgpack.decode(kept.portable, type=Portable)
        except msgspec.DecodeError as error:
            raise CheckpointError(f"{reason}; {error}") from error
        engine, self._standing, lost = engine_from(portable, now, self._outside)
        self._begin_anew(reason)
        self.recovery.notes += lost
        return engine

    def _from_nothing(self, now: int) -> tuple[Engine, int]:
        """The engine where there is no checkpoint, and the position after which commands are to be
        done."""
        store = self._directory.old_store
        ontology = None if store is None else Ontology.copied(store)
        if not self.log.position:
            self.log.append(written(Begin(secrets.token_hex(4), now, program())))
            self.log.commit()
            if store is not None:
                self.recovery.notes.append(
                    f"{self._directory.path} was written by an earlier version: definitions are "
                    "taken over, samples were not kept"
                )
        elif self.log.first > 1:
            raise JournalDamaged(
                f"there is no sound checkpoint, and the log begins with record {self.log.first}",
                "restore the folder from a backup (dyknow restore)",
            )
        begin = next(read(data) for _, data in self.log.read(0))
        if not isinstance(begin, Begin):
            raise JournalDamaged(f"the log begins with {type(begin).__name__}")
        if begin.program != program():
            self._begin_anew(f"the directory was written by {begin.program}, this is {program()}")
        engine = Engine(
            epoch=begin.epoch,
            now=begin.now,
            ontology=ontology,
            **self._outside.given(),
        )
        return engine, 1

    def _begin_anew(self, reason: str) -> None:
        self.recovery.is_continued = False
        self.recovery.notes.append(f"{reason}: numbers of samples and ids of events begin anew")

    def _again(self, engine: Engine, position: int, data: bytes) -> None:
        """Do a command again. One that was done once is done now: where it is not, this is another
        program or an error in it."""
        try:
            command = read(data)
            if isinstance(command, Tick):
                self._runner.tape.play(command.readings)
            self._standing.note(command, command.apply(engine))
        except Exception as error:  # noqa: BLE001  the service starts without it, and says so
            self._begin_anew(f"record {position} could not be done again: {error}")


@dataclass(frozen=True, slots=True)
class Unwritten:
    """A checkpoint that is not on the disk yet."""

    checkpoint: Checkpoint
    log: Log
    checkpoints: Checkpoints
    unkept: tuple[str, ...]
    """User-written processes whose state cannot be written down: what they are, and why."""

    def write(self) -> None:
        """Write it, and forget of the log what no checkpoint needs. Raises `JournalError`."""
        # Never ahead of the log: its numbers would be given twice.
        if self.log.synced < self.checkpoint.position:
            self.log.sync()
        self.checkpoints.write(self.checkpoint)
        self.log.drop(min(self.checkpoints.positions()))
