"""What a start does: an engine out of the newest sound checkpoint and the log after it
(docs/explanation/design/0007-the-journal.md).

What cannot be had again is told, and kept for another start; then numbers and ids begin anew.
"""

from __future__ import annotations

import secrets
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import msgspec

from ...journal.checkpoints import Checkpoint, Checkpoints
from ...journal.directory import DataDirectory
from ...journal.errors import JournalDamaged
from ...journal.log import Log
from ...ontology.ontology import Ontology
from ...streams.stream_rules import INSTANTS
from ..configuration.configuration import after_reserved
from ..engine import Engine
from ..processes.external_io import Tape
from ..processes.registry import Processes
from .accepted_commands import Key, Standing
from .checkpoint import CheckpointError, Outside, engine_of
from .commands import (
    DEFINING,
    REFUSALS,
    AddKpl,
    Begin,
    Command,
    Publish,
    Refused,
    RegisterQuery,
    RemoveKpl,
    Tick,
    WorkBacklog,
    read,
    written,
)
from .missing_processes import missing, origins, told
from .portable_state import Portable, PortableHead, engine_from


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


class Recovering:
    """Of a ``directory`` whose ``log`` and ``checkpoints`` are open. ``program`` is this one, see
    `checkpoint.program`.

    Law: see `RecordedEngine`.
    """

    def __init__(
        self,
        directory: DataDirectory,
        log: Log,
        checkpoints: Checkpoints,
        outside: Outside,
        tape: Tape,
        program: str,
    ) -> None:
        self.found = Recovery()
        self.standing = Standing()
        """What stands in the engine."""
        self.needed: dict[str, str] = {}
        """User-written processes that an earlier run had, with their modules."""
        self._directory = directory
        self._log = log
        self._checkpoints = checkpoints
        self._outside = outside
        self._tape = tape
        self._program = program
        self._writer = program
        """The program that has written what is read now."""
        self._unplaced: Counter[str] = Counter()
        """Batches that this program could not take again, by stream and why."""

    def run(self, now: int, progress: Callable[[int, int], None] | None) -> Engine:
        """The engine, which has done all that the log has. Raises `JournalError`."""
        if self._log.torn is not None:
            self.found.notes.append(f"cut off, an unfinished write: {self._log.torn}")
        if self._log.mark_fault is not None and self._log.doubt is None:
            self.found.notes.append(self._log.mark_fault)
        if self._directory.repaired is not None:
            self._begin_anew(self._directory.repaired)
        self.found.notes += self._checkpoints.gone()
        found = self._from_checkpoint(now)
        if found is None:
            found = self._from_nothing(now)
        engine, done = found
        count = self._log.position - done
        self._tape.is_playing = True
        for position, data in self._log.read(done):
            self._again(engine, position, data)
            self.found.replayed += 1
            if progress is not None and self.found.replayed % 1000 == 0:
                progress(self.found.replayed, count)
        self._tape.is_playing = False
        self._check_writer()
        for reason, times in self._unplaced.items():
            note = f"{times} batches could not be taken again: {reason}"
            self.found.notes.append(note)
            engine.tell_not_restored(note)
        gone = still_missing(engine, self.standing, self.needed, self._outside.processes)
        for name, module in gone.items():
            self.found.notes.append(told(name, module))
            if not self.found.is_continued:
                engine.tell_not_restored(told(name, module))
        if not self.found.is_continued:
            known = gone | origins(self._outside.processes)
            begin = Begin(secrets.token_hex(4), now, self._program, known, INSTANTS)
            self._log.append(written(begin))
            begin.apply(engine)
        return engine

    def _from_checkpoint(self, now: int) -> tuple[Engine, int] | None:
        """The engine of the newest checkpoint that is sound, and its position."""
        for position in self._checkpoints.positions():
            try:
                kept = self._checkpoints.read(position)
                found = self._from(kept, now)
            except (JournalDamaged, CheckpointError) as error:
                self.found.notes.append(f"a checkpoint is passed over: {error}")
                continue
            if position > self._log.position or position + 1 < self._log.first:
                raise JournalDamaged(
                    f"the checkpoint is of record {position}, the log has records "
                    f"{self._log.first} to {self._log.position}",
                    "restore the folder from a backup (dyknow restore)",
                )
            self.found.position = position
            return found, position
        return None

    def _from(self, kept: Checkpoint, now: int) -> Engine:
        """The engine of a checkpoint; raises `CheckpointError`."""
        reason = _of_another(kept.program, self._program)
        try:
            head = msgspec.msgpack.decode(kept.portable, type=PortableHead)
        except msgspec.DecodeError as error:
            raise CheckpointError(f"{reason}; {error}") from error
        self._writer = kept.program
        self.needed |= head.processes
        if kept.program == self._program:
            try:
                engine, self.standing = engine_of(kept.state, self._outside)
                for each in head.unkept:
                    if each.is_computing:
                        # What it makes from here on is not what those who looked on have seen.
                        self._begin_anew(f"the state of a process was not kept: {each}")
                return engine
            except CheckpointError as error:
                # Of user-written processes it may name what is not there any more.
                reason = str(error)
        try:
            portable = msgspec.msgpack.decode(kept.portable, type=Portable)
        except msgspec.DecodeError as error:
            raise CheckpointError(f"{reason}; {error}") from error
        first_reserved = self._after_queries(kept.position)
        engine, self.standing, lost = engine_from(portable, now, self._outside, first_reserved)
        self._begin_anew(reason)
        self.found.notes += lost
        return engine

    def _from_nothing(self, now: int) -> tuple[Engine, int]:
        """The engine where there is no checkpoint, and the position after which commands are to be
        done."""
        store = self._directory.old_store
        ontology = None if store is None else Ontology.copied(store)
        if not self._log.position:
            known = origins(self._outside.processes)
            begin = Begin(secrets.token_hex(4), now, self._program, known, INSTANTS)
            self._log.append(written(begin))
            self._log.commit()
            if store is not None:
                self.found.notes.append(
                    f"{self._directory.path} was written by an earlier version: definitions are "
                    "taken over, samples were not kept"
                )
        elif self._log.first > 1:
            raise JournalDamaged(
                f"there is no sound checkpoint, and the log begins with record {self._log.first}",
                "restore the folder from a backup (dyknow restore)",
            )
        first = next(read(data) for _, data in self._log.read(0))
        if not isinstance(first, Begin):
            raise JournalDamaged(f"the log begins with {type(first).__name__}")
        self._writer = first.program
        self.needed |= first.processes
        engine = Engine(
            epoch=first.epoch,
            now=first.now,
            first_reserved=1 if first.program == self._program else self._after_queries(0),
            ontology=ontology,
            rules=first.rules,
            **self._outside.given(),
        )
        first.apply(engine)
        return engine, 1

    def _after_queries(self, position: int) -> int:
        """The first N of ``dyknow_reserved<N>`` that no query of the log after ``position`` is
        called: what another program makes besides takes none of these names."""
        names = []
        for _, data in self._log.read(position):
            with suppress(msgspec.DecodeError):  # told when it is its turn
                command = read(data)
                if isinstance(command, RegisterQuery):
                    names.append(command.name)
        return after_reserved(names)

    def _begin_anew(self, reason: str) -> None:
        self.found.is_continued = False
        self.found.notes.append(f"{reason}: numbers of samples and ids of events begin anew")

    def _again(self, engine: Engine, position: int, data: bytes) -> None:
        """Do a command again. One that was done once is done now: where it is not, this is another
        program or an error in it."""
        try:
            command = read(data)
        except msgspec.DecodeError as error:
            self._begin_anew(f"record {position} cannot be read: {error}")
            return
        if isinstance(command, Begin):
            self._writer = command.program
            self.needed |= command.processes
        else:
            self._check_writer()
        if isinstance(command, Tick):
            self._tape.play(command.readings)
        if isinstance(command, Refused) and not self.found.is_continued:
            # It need not be refused here, and nobody was promised what would come of it.
            return
        expected = None
        try:
            expected = self.standing.expected(command, engine)
            self.standing.note(command, self.standing.do(engine, command))
        except REFUSALS as error:
            self._refused_again(engine, position, command, expected, error)
        except Exception as error:  # noqa: BLE001  the service starts without it, and says so
            self._begin_anew(f"record {position} could not be done again: {error}")

    def _check_writer(self) -> None:
        """What another program has done need not be what comes of it here."""
        if self._writer != self._program and self.found.is_continued:
            self._begin_anew(_of_another(self._writer, self._program))

    def _refused_again(
        self,
        engine: Engine,
        position: int,
        command: Command,
        expected: Key | None,
        error: Exception,
    ) -> None:
        """What was accepted is refused: say so, and keep what can be done at another start."""
        match command:
            case Publish(stream=stream):
                self._unplaced[f"{stream}: {error}"] += 1
                self.found.is_continued = False
                return
            case WorkBacklog() if not self.found.is_continued:
                # Of another program other windows are due; they close when it is their turn.
                return
            case AddKpl(text=text, unit=unit):
                engine.restore_kpl(text, unit)
            case RemoveKpl(name=name) if engine.forget_kpl(name):
                return
            case _ if isinstance(command, DEFINING):
                self.standing.wait(command, expected, engine, error)
        self._begin_anew(f"record {position} could not be done again: {error}")


def still_missing(
    engine: Engine, standing: Standing, needed: Mapping[str, str], processes: Processes
) -> dict[str, str]:
    """User-written processes that are ``needed`` and not there, with their modules."""
    if all(name in processes for name in needed):
        return {}
    waiting = [written(command) for _, command in standing.waiting()]
    return missing(needed, processes, [engine.ontology.quads(), *waiting])


def _of_another(writer: str, program: str) -> str:
    return f"the directory was written by {writer}, this is {program}"
