"""A service that ends amid an operation on its disk.

    python dying.py DATA DIE      serves the folder DATA, and prints its port

DIE, in JSON: null, or [operation, count, share]: the service kills itself at the ``count``-th
operation of that name, of a write after so much of it as ``share`` says; of others before them, or,
where ``share`` is 1, after them.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from pathlib import Path

from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.journal.disk import Disk
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import bind, run

OPERATIONS = ("allocate", "write", "sync", "sync_folder", "rename", "remove", "open")


class DyingDisk(Disk):
    """Ends its process amid an operation."""

    def __init__(self, operation: str, count: int, share: float) -> None:
        self._operation = operation
        self._count = count
        self._share = share
        for name in OPERATIONS:
            setattr(self, name, self._counting(name))

    def _counting(self, name):
        usual = getattr(Disk, name)

        def call(*given, **more):
            if name == self._operation:
                self._count -= 1
            is_last = name == self._operation and self._count <= 0
            if is_last and name == "write":
                file, data, start = given
                usual(self, file, data[: int(self._share * len(data))], start)
                die()
            if is_last and self._share < 1:
                die()
            found = usual(self, *given, **more)
            if is_last:
                die()
            return found

        return call


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(60)


def main(data: str, given: str) -> None:
    listener = bind(Settings(port=0))
    print(listener.getsockname()[1], flush=True)
    last = json.loads(given)
    disk = Disk() if last is None else DyingDisk(*last)
    # Small files and frequent checkpoints: all that happens in a month happens in a minute.
    recorded = RecordedEngine(Path(data), now=time.time_ns(), disk=disk, segment=1 << 15)
    settings = Settings(port=0, checkpoint_bytes=1 << 12, tick=0.02)
    run(create_app(recorded, settings, time.time_ns), listener)


if __name__ == "__main__":
    main(*sys.argv[1:])
