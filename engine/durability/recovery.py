"""Recovery: make an engine of the newest sound checkpoint and the log after it
(docs/explanation/design/0007-the-journal.md).

Recovery reports commands that it cannot replay, and keeps them for another start. A new epoch
begins then, because the streams are not the same any more.
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
from .accepted_commands import AcceptedCommands, Key
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
    decode_command,
    encode_command,
)
from .missing_processes import missing_message, missing_processes, process_modules
from .portable_state import Portable, PortableHead, engine_from


@dataclass(slots=True)
class Recovery:
    """The result of a recovery. ``notes``: messages to the operator."""

    position: int = 0
    """The position of the checkpoint; 0: there was none."""
    replayed: int = 0
    """The number of commands that were replayed."""
    is_continued: bool = True
    """Whether numbers and ids continue; otherwise a new epoch has begun."""
    notes: list[str] = field(default_factory=list)


class RecoveryRun:
    """The recovery of a ``directory`` whose ``log`` and ``checkpoints`` are open. ``program``
    identifies this program (`checkpoint.program`). Law: see `RecordedEngine`.
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
        self.report = Recovery()
        self.accepted = AcceptedCommands()
        """The accepted commands of the engine."""
        self.needed: dict[str, str] = {}
        """The modules of user-written processes that an earlier run had, by name of the process."""
        self._directory = directory
        self._log = log
        self._checkpoints = checkpoints
        self._outside = outside
        self._tape = tape
        self._program = program
        self._writer = program
        """The program that wrote the checkpoint or record that is read at present."""
        self._refused_batches: Counter[str] = Counter()
        """The number of batches that this program refuses, by stream and reason."""

    def run(self, now: int, progress: Callable[[int, int], None] | None) -> Engine:
        """Return the engine after the last command of the log. Raises `JournalError`."""
        if self._log.torn is not None:
            self.report.notes.append(f"cut off, an unfinished write: {self._log.torn}")
        if self._log.mark_fault is not None and self._log.doubt is None:
            self.report.notes.append(self._log.mark_fault)
        if self._directory.repaired is not None:
            self._begin_epoch(self._directory.repaired)
        self.report.notes += self._checkpoints.gone()
        found = self._from_checkpoint(now)
        if found is None:
            found = self._from_log(now)
        engine, done = found
        count = self._log.position - done
        # The tape returns the readings of sources; it calls neither sources nor sinks again.
        self._tape.is_replaying = True
        for position, data in self._log.read(done):
            self._replay(engine, position, data)
            self.report.replayed += 1
            if progress is not None and self.report.replayed % 1000 == 0:
                progress(self.report.replayed, count)
        self._tape.is_replaying = False
        # If no command follows the checkpoint, no replay has compared the writer.
        self._check_writer()
        for reason, times in self._refused_batches.items():
            note = f"{times} batches could not be replayed: {reason}"
            self.report.notes.append(note)
            engine.report_not_restored(note)
        gone = still_missing(engine, self.accepted, self.needed, self._outside.processes)
        for name, module in gone.items():
            self.report.notes.append(missing_message(name, module))
            if not self.report.is_continued:
                engine.report_not_restored(missing_message(name, module))
        if not self.report.is_continued:
            modules = gone | process_modules(self._outside.processes)
            begin = Begin(secrets.token_hex(4), now, self._program, modules, INSTANTS)
            self._log.append(encode_command(begin))
            begin.apply(engine)
        return engine

    def _from_checkpoint(self, now: int) -> tuple[Engine, int] | None:
        """Return the engine of the newest sound checkpoint, and its position."""
        for position in self._checkpoints.positions():
            try:
                kept = self._checkpoints.read(position)
                found = self._from_state(kept, now)
            except (JournalDamaged, CheckpointError) as error:
                self.report.notes.append(f"a checkpoint was skipped: {error}")
                continue
            if position > self._log.position or position + 1 < self._log.first:
                # Checkpoint and log contradict each other, so acknowledged commands are missing.
                raise JournalDamaged(
                    f"the checkpoint is of record {position}, the log has records "
                    f"{self._log.first} to {self._log.position}",
                    "restore the folder from a backup (dyknow restore)",
                )
            self.report.position = position
            return found, position
        return None

    def _from_state(self, kept: Checkpoint, now: int) -> Engine:
        """Return the engine of a checkpoint: by its pickle if this program wrote it, else by its
        portable state. Raises `CheckpointError`."""
        reason = _writer_differs(kept.program, self._program)
        try:
            head = msgspec.msgpack.decode(kept.portable, type=PortableHead)
        except msgspec.DecodeError as error:
            raise CheckpointError(f"{reason}; {error}") from error
        self._writer = kept.program
        self.needed |= head.processes
        if kept.program == self._program:
            try:
                engine, self.accepted = engine_of(kept.state, self._outside)
                for each in head.unkept:
                    if each.is_computing:
                        # Its output from here on differs from what clients would have seen.
                        self._begin_epoch(
                            f"the state of a process is not in the checkpoint: {each}"
                        )
                return engine
            except CheckpointError as error:
                # It may refer to user-written processes that are not loaded any more.
                reason = str(error)
        try:
            portable = msgspec.msgpack.decode(kept.portable, type=Portable)
        except msgspec.DecodeError as error:
            raise CheckpointError(f"{reason}; {error}") from error
        first_reserved = self._after_queries(kept.position)
        engine, self.accepted, lost = engine_from(portable, now, self._outside, first_reserved)
        self._begin_epoch(reason)
        self.report.notes += lost
        return engine

    def _from_log(self, now: int) -> tuple[Engine, int]:
        """Return a new engine, and the position after which the log is to be replayed."""
        store = self._directory.old_store
        ontology = None if store is None else Ontology.open_copy(store)
        if not self._log.position:
            modules = process_modules(self._outside.processes)
            begin = Begin(secrets.token_hex(4), now, self._program, modules, INSTANTS)
            self._log.append(encode_command(begin))
            # `Log.read` returns committed records only, and this one is read below.
            self._log.commit()
            if store is not None:
                self.report.notes.append(
                    f"{self._directory.path} was written by an earlier version: definitions were "
                    "restored, and there are no samples"
                )
        elif self._log.first > 1:
            raise JournalDamaged(
                f"there is no sound checkpoint, and the log begins with record {self._log.first}",
                "restore the folder from a backup (dyknow restore)",
            )
        first = next(decode_command(data) for _, data in self._log.read(0))
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
            **self._outside.arguments(),
        )
        first.apply(engine)
        return engine, 1

    def _after_queries(self, position: int) -> int:
        """Return the first N above those of the queries ``dyknow_reserved<N>`` in the log after
        ``position``. Another program may create other streams, which must not take these names."""
        names = []
        for _, data in self._log.read(position):
            with suppress(msgspec.DecodeError):  # the replay reports it
                command = decode_command(data)
                if isinstance(command, RegisterQuery):
                    names.append(command.name)
        return after_reserved(names)

    def _begin_epoch(self, reason: str) -> None:
        self.report.is_continued = False
        self.report.notes.append(f"{reason}: numbers of samples and ids of events begin anew")

    def _replay(self, engine: Engine, position: int, data: bytes) -> None:
        """Replay a command. It succeeded once, so a failure means another program or an error in
        this one."""
        try:
            command = decode_command(data)
        except msgspec.DecodeError as error:
            self._begin_epoch(f"record {position} cannot be read: {error}")
            return
        if isinstance(command, Begin):
            self._writer = command.program
            self.needed |= command.processes
        else:
            self._check_writer()
        if isinstance(command, Tick):
            self._tape.replay(command.readings)
        if isinstance(command, Refused) and not self.report.is_continued:
            # This program might accept it, although the client was told that it failed.
            return
        expected = None
        try:
            # The execution may use up the id even if it fails, so the key is needed before.
            expected = self.accepted.expected_key(command, engine)
            self.accepted.record(command, self.accepted.do(engine, command))
        except REFUSALS as error:
            self._handle_refusal(engine, position, command, expected, error)
        except Exception as error:  # noqa: BLE001  the service starts without it and reports it
            self._begin_epoch(f"record {position} could not be replayed: {error}")

    def _check_writer(self) -> None:
        """Begin a new epoch if another program wrote the record: its results may differ."""
        if self._writer != self._program and self.report.is_continued:
            self._begin_epoch(_writer_differs(self._writer, self._program))

    def _handle_refusal(
        self,
        engine: Engine,
        position: int,
        command: Command,
        expected: Key | None,
        error: Exception,
    ) -> None:
        """Report an accepted command that is refused now, and keep it for another start."""
        match command:
            case Publish(stream=stream):
                # The log may have thousands of such batches, so `run` notes each reason once.
                self._refused_batches[f"{stream}: {error}"] += 1
                self.report.is_continued = False
                return
            case WorkBacklog() if not self.report.is_continued:
                # In another program other windows may be due; the backlog closes them.
                return
            case AddKpl(text=text, unit=unit):
                engine.restore_kpl(text, unit)
            case RemoveKpl(name=name) if engine.forget_kpl(name):
                return
            case _ if isinstance(command, DEFINING):
                self.accepted.add_waiting(command, expected, engine, error)
        self._begin_epoch(f"record {position} could not be replayed: {error}")


def still_missing(
    engine: Engine, accepted: AcceptedCommands, needed: Mapping[str, str], processes: Processes
) -> dict[str, str]:
    """Return the ``needed`` user-written processes that are not loaded, with their modules."""
    if all(name in processes for name in needed):
        return {}
    waiting = [encode_command(command) for _, command in accepted.waiting()]
    return missing_processes(needed, processes, [engine.ontology.quads(), *waiting])


def _writer_differs(writer: str, program: str) -> str:
    return f"the directory was written by {writer}, this is {program}"
