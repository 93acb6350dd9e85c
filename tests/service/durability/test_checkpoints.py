"""Checkpoints of a service: one that comes to nothing leaves nothing, and the last one is alone."""

from __future__ import annotations

import asyncio
import os
import signal
import threading
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from simulated_disk import SimulatedDisk

from dyknow.engine.durability.commands import DeclareStream
from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.journal.checkpoints import Checkpoints
from dyknow.journal.errors import JournalFull
from dyknow.journal.log import Log
from dyknow.service.config.settings import Settings
from dyknow.service.durability.command_queue import CHECKPOINT, CommandQueue
from dyknow.streams.sample import Field, FieldType


def run(work: Callable[[], Awaitable[None]]) -> None:
    async def patiently() -> None:
        async with asyncio.timeout(60):
            await work()

    asyncio.run(patiently())


def declare(commands: CommandQueue, name: str) -> None:
    commands.do(DeclareStream(StreamDeclaration(name, (Field("n", FieldType.INTEGER),))))


def left(path: Path) -> list[Path]:
    return list(path.rglob("*.part"))


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_one_of_a_log_that_cannot_be_kept_leaves_no_copy_and_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = RecordedEngine(tmp_path, now=0)
    troubles: dict[str, str] = {}
    commands = CommandQueue(recorded.engine, recorded, troubles)

    def full(log: Log) -> int:
        raise JournalFull("no room for the log")

    async def work() -> None:
        declare(commands, "s")
        before = descriptors()
        with monkeypatch.context() as patched:
            patched.setattr(Log, "commit", full)
            await commands._checkpoint(recorded)
        assert "no room for the log" in troubles[CHECKPOINT]
        assert commands._snapshots._child == 0, "nobody would wait for its end"
        assert descriptors() <= before + 1, "the thread of the log may have a file open"
        assert left(tmp_path) == []
        await commands._checkpoint(recorded)
        assert CHECKPOINT not in troubles
        commands.close()

    run(work)


def test_a_copy_that_is_killed_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where memory is short: each of them would take as much of the disk as a state has."""
    recorded = RecordedEngine(tmp_path, now=0)
    troubles: dict[str, str] = {}
    commands = CommandQueue(recorded.engine, recorded, troubles)
    write = Checkpoints._write_part

    def killed(self: Checkpoints, part: Path, checkpoint: object) -> None:
        part.write_bytes(b"half")
        os.kill(os.getpid(), signal.SIGKILL)

    async def work() -> None:
        declare(commands, "s")
        with monkeypatch.context() as patched:
            patched.setattr(Checkpoints, "_write_part", killed)
            await commands._checkpoint(recorded)
        assert "died (-9)" in troubles[CHECKPOINT]
        assert left(tmp_path) == []
        assert Checkpoints._write_part is write
        await commands._checkpoint(recorded)
        assert troubles == {}
        commands.close()

    run(work)


def test_one_that_fails_as_nobody_expects_is_not_tried_with_every_tick(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = RecordedEngine(tmp_path, now=0)
    troubles: dict[str, str] = {}
    commands = CommandQueue(recorded.engine, recorded, troubles)
    often = Settings(checkpoint_bytes=1)

    def odd(recorded: RecordedEngine) -> None:
        raise TypeError("something is odd")

    async def work() -> None:
        declare(commands, "s")
        with monkeypatch.context() as patched:
            patched.setattr(RecordedEngine, "_capture", odd)
            await commands.maintain(often)
            while commands._checkpoint_task is not None:
                await asyncio.sleep(0.001)
        assert troubles[CHECKPOINT] == "TypeError: something is odd"
        await commands.maintain(often)
        assert commands._checkpoint_task is None
        commands.close()

    run(work)


class Watched(SimulatedDisk):
    """Where a checkpoint is put beside the event loop's thread, it waits there for another one."""

    def __init__(self) -> None:
        super().__init__()
        self.loop = threading.current_thread()
        self.begun = threading.Event()
        self.another = threading.Event()
        self.overlapped = False

    def open(self, path: Path, *, new: bool = False) -> int:
        if path.suffix == ".part" and path.stem.isdigit():
            if threading.current_thread() is self.loop:
                if self.begun.is_set():
                    self.another.set()
            else:
                self.begun.set()
                self.overlapped = self.another.wait(0.3)
        found: int = super().open(path, new=new)
        return found


def test_the_last_one_waits_for_the_one_under_way(tmp_path: Path) -> None:
    """Both may be of the same position, and so have the same name."""
    disk = Watched()
    recorded = RecordedEngine(tmp_path, now=0, disk=disk)
    commands = CommandQueue(recorded.engine, recorded, {})
    commands._uses_fork = False

    async def work() -> None:
        declare(commands, "s")
        commands._checkpoint_task = asyncio.create_task(commands._checkpoint(recorded))
        while not disk.begun.is_set():
            await asyncio.sleep(0)
        commands.close()
        assert not disk.overlapped

    run(work)
    again = RecordedEngine(tmp_path, now=0)
    assert again.recovery.replayed == 0
    again.close()
