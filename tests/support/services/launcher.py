"""The process whose forks the processes of `launching` are: it has imported and warmed a service.

    python launcher.py SOCKET     makes the socket, writes "ready", and ends with standard input

A client sends a request as JSON, with its standard input, output and error; it gets the process id
and then, when the process has ended, its exit code (negative: the signal). Closing the connection
kills the process.
"""

from __future__ import annotations

import asyncio
import atexit
import gc
import json
import os
import select
import signal
import socket
import sys
import threading
import time
from contextlib import suppress
from typing import Any

MOST_REQUEST = 1 << 17


class End:
    """What a process does last, instead of clearing hundreds of modules, which takes a second."""

    code = 0

    def __call__(self) -> None:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(self.code)


async def warm() -> None:
    """Start a service in this process, and wait until it is ready."""
    import httpx

    from dyknow.engine.engine import Engine
    from dyknow.service.app import create_app
    from dyknow.service.cli.main import COMMANDS, command
    from dyknow.service.config.settings import Settings
    from dyknow.service.runtime.warm_up import WarmUp
    from dyknow.service.workers.fork_server import FORK_SERVER

    for name in COMMANDS:
        command(name)
    app = create_app(Engine(), Settings(port=0), time.time_ns)
    warming = WarmUp()
    warming.loops()
    async with (
        app.router.lifespan_context(app),
        httpx.AsyncClient(
            transport=httpx.ASGITransport(app), base_url="http://127.0.0.1"
        ) as client,
    ):
        warming.application(app)
        while warming.unfinished():
            await asyncio.sleep(0.01)
        for path in ("/healthz", "/status", "/streams"):
            (await client.get(path)).raise_for_status()
    FORK_SERVER.stop()


def forked(path: str) -> dict[str, Any] | None:
    """Return in each process that was asked for, with its request; in this one at the end, None."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as listener:
        listener.bind(path)
        listener.listen()
        print("ready", flush=True)
        while sys.stdin not in select.select([sys.stdin, listener], [], [])[0]:
            client, _ = listener.accept()
            with client:
                data, descriptors, _, _ = socket.recv_fds(client, MOST_REQUEST, 3)
                if data and not os.fork():
                    listener.close()
                    fork_watched(client, descriptors)
                    for number, descriptor in enumerate(descriptors):
                        os.dup2(descriptor, number)
                        os.close(descriptor)
                    return json.loads(data)
            for descriptor in descriptors:
                os.close(descriptor)
    return None


def fork_watched(client: socket.socket, descriptors: list[int]) -> None:
    """Fork, and return in the child. Its parent tells its end, and ends too."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    pid = os.fork()
    if not pid:
        return
    for descriptor in (0, 1, 2, *descriptors):
        os.close(descriptor)
    ended = os.pidfd_open(pid)
    with suppress(BrokenPipeError):
        client.send(b"%d" % pid)
    if ended not in select.select([ended, client], [], [])[0]:
        os.kill(pid, signal.SIGKILL)  # Whoever asked for it is gone.
    _, status = os.waitpid(pid, 0)
    with suppress(BrokenPipeError):
        client.send(b"%d" % os.waitstatus_to_exitcode(status))
    os._exit(0)


def main() -> None:
    end = End()
    atexit.register(end)  # Before the modules that it follows.
    asyncio.run(warm())
    while threading.active_count() > 1:
        time.sleep(0.001)  # A process with threads cannot be forked.
    gc.collect()
    gc.freeze()
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    request = forked(sys.argv[1])
    if request is not None:
        os.chdir(request["folder"])
        os.environ.clear()
        os.environ.update(request["environment"])
        sys.argv = ["-c", *request["arguments"]]
        end.code = 1
        try:
            exec(request["program"], {"__name__": "__main__"})
            end.code = 0
        except SystemExit as exit:
            end.code = exit.code if isinstance(exit.code, int) else int(exit.code is not None)
            raise


if __name__ == "__main__":
    main()
