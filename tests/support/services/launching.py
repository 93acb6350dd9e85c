"""Processes that start at once: forks of one process, `launcher`, that has a service imported.

    python -IS launching.py PROGRAM [ARGUMENT …]     with the launcher's socket in LAUNCHER

does what `python -c PROGRAM ARGUMENT …` does, for scripts. A new interpreter takes some four
seconds of processor time until its service is ready; how one starts is tested by
tests/service/cli/test_starting.py and tests/service/runtime/test_warming.py.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import sys
from contextlib import suppress
from types import FrameType

SERVICE = "from dyknow.service.cli import main; main()"
"""The program that `dyknow` is."""
ENOUGH = 100
"""Bytes of an answer."""


class Forked:
    """A process that runs a program with its own standard input, output and error, in the current
    folder. Killed when this handle is lost."""

    def __init__(
        self,
        launcher: str,
        program: str,
        arguments: list[str],
        environment: dict[str, str],
        files: tuple[int, int, int],
    ) -> None:
        request = {
            "program": program,
            "arguments": arguments,
            "environment": environment,
            "folder": os.getcwd(),
        }
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.connect(launcher)
        socket.send_fds(self._socket, [json.dumps(request).encode()], files)
        self.pid = int(self._socket.recv(ENOUGH))
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """The exit code (negative: the signal), or None while it runs."""
        return self._ended(0)

    def wait(self, seconds: float | None = None) -> int:
        code = self._ended(seconds)
        if code is None:
            raise TimeoutError(f"process {self.pid} still runs after {seconds} s")
        return code

    def send_signal(self, number: int) -> None:
        if self.poll() is None:
            with suppress(ProcessLookupError):  # It ends just now.
                os.kill(self.pid, number)

    def terminate(self) -> None:
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        self.send_signal(signal.SIGKILL)

    def _ended(self, seconds: float | None) -> int | None:
        if self.returncode is None and select.select([self._socket], [], [], seconds)[0]:
            self.returncode = int(self._socket.recv(ENOUGH))
            self._socket.close()
        return self.returncode


def main() -> None:
    environment = dict(os.environ)
    launcher = environment.pop("LAUNCHER")
    forked = Forked(launcher, sys.argv[1], sys.argv[2:], environment, (0, 1, 2))

    def forward(number: int, _frame: FrameType | None) -> None:
        forked.send_signal(number)

    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, forward)
    code = forked.wait()
    sys.exit(code if code >= 0 else 128 - code)


if __name__ == "__main__":
    main()
