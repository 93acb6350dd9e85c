"""Services that are killed, many a minute: one process that has everything loaded has children.

    python nursery.py      reads a JSON object a line: {"data", "die": [operation, count, share]}
                           answers with a line: {"pid", "port"}

A child serves the folder ``data``. With ``die`` it kills itself at the ``count``-th operation of
that name on its disk, of a write after so much of it as ``share`` says; of others before them, or,
where ``share`` is 1, after them.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import httpx

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


def serve(data: Path, die: tuple[str, int, float] | None, listener) -> None:
    disk = Disk() if die is None else DyingDisk(*die)
    # Small files and frequent checkpoints: all that happens in a month happens in a minute.
    recorded = RecordedEngine(data, now=time.time_ns(), disk=disk, segment=1 << 15)
    settings = Settings(port=0, checkpoint_bytes=1 << 12, tick=0.02)
    run(create_app(recorded, settings, time.time_ns), listener)


async def warm(folder: Path) -> None:
    """What each would do at its first requests is done once, by their parent."""
    recorded = RecordedEngine(folder, now=0)
    app = create_app(recorded, Settings(port=0), time.time_ns)
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(
            transport=httpx.ASGITransport(app), base_url="http://127.0.0.1"
        ) as client,
    ):
        for path in ("/healthz", "/status", "/streams"):
            (await client.get(path)).raise_for_status()


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(warm(Path(folder)))
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    print("ready", flush=True)
    for line in sys.stdin:
        given = json.loads(line)
        listener = bind(Settings(port=0))
        pid = os.fork()
        if not pid:
            try:
                signal.signal(signal.SIGCHLD, signal.SIG_DFL)
                serve(Path(given["data"]), given["die"], listener)
            finally:
                os._exit(0)
        print(json.dumps({"pid": pid, "port": listener.getsockname()[1]}), flush=True)
        listener.close()


if __name__ == "__main__":
    main()
