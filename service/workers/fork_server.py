"""The fork server: a process that has imported and warmed what a worker needs, and forks workers.

A fork takes some milliseconds and shares memory; a start takes the imports of 100 modules. The
service itself cannot fork its workers: it has threads, secrets, and much memory.
"""

from __future__ import annotations

import atexit
import os
import select
import signal
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from typing import Final

START_DEADLINE: Final = 60.0
"""Seconds for the start of the server and of a worker: they only import, but the machine may be
busy."""
STATUS_BYTES: Final = 4
"""Bytes of a worker's exit status, as of `os.waitstatus_to_exitcode`, big-endian and signed."""
_MOST_REPLY: Final = 1000


class ForkedProcess:
    """A worker's process, and this side of its pipes: ``jobs`` to write, ``answers`` to read.

    Its parent is the fork server, which writes its exit status to the pipe ``status``.
    """

    def __init__(self, pid: int, jobs: int, answers: int, status: int) -> None:
        self.pid = pid
        self.jobs = jobs
        self.answers = answers
        self._status = status
        self._exit_code: int | None = None
        self._lock = threading.Lock()
        os.set_blocking(jobs, False)
        os.set_blocking(answers, False)

    def poll(self) -> int | None:
        """Return the exit code (negative: the signal), or None while the process lives."""
        return self._exit_code_within(0)

    def wait(self) -> int:
        """Return the exit code when the process has ended."""
        code = self._exit_code_within(None)
        assert code is not None
        return code

    def kill(self) -> None:
        """Kill the process, unless it has ended. Does not wait."""
        if self.poll() is None:
            self._kill()

    def close(self) -> None:
        """Close the pipes. Contract: the process has ended; no other method follows."""
        for descriptor in (self.jobs, self.answers, self._status):
            os.close(descriptor)

    def _kill(self) -> None:
        with suppress(ProcessLookupError):
            os.kill(self.pid, signal.SIGKILL)

    def _exit_code_within(self, milliseconds: int | None) -> int | None:
        # `select.select` takes no descriptor above 1,023, and a service has one for each client.
        status = select.poll()
        status.register(self._status, select.POLLIN)
        with self._lock:
            if self._exit_code is None and status.poll(milliseconds):
                data = os.read(self._status, STATUS_BYTES)
                if not data:  # The server died, and with it the exit code.
                    self._kill()
                code = int.from_bytes(data, "big", signed=True)
                self._exit_code = code if data else -signal.SIGKILL
            return self._exit_code


class ForkServer:
    """The handle of the server, which starts at the first `fork` and ends with this process."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._socket: socket.socket | None = None

    def fork(self, memory: int) -> ForkedProcess:
        """Return a new worker with ``memory`` bytes for its jobs; it may not be ready yet.

        Starts the server if there is none or it died. Raises OSError.
        """
        request = memory.to_bytes(8, "big")
        with self._lock:
            try:
                if self._process is None:
                    self._restart()
                try:
                    reply, descriptors = self._exchange(request)
                except ConnectionError:  # It has died.
                    self._restart()
                    reply, descriptors = self._exchange(request)
            except OSError:
                self._stop()
                raise
        if not descriptors:
            raise OSError(reply.decode())
        jobs, answers, status = descriptors
        return ForkedProcess(int(reply), jobs, answers, status)

    def stop(self) -> None:
        """Kill the server; its workers end at the latest with their pipes."""
        with self._lock:
            self._stop()

    def forget(self) -> None:
        """Leave the server to the process whose fork this one is."""
        # Another thread may have held the lock at the fork, and nothing releases it here.
        self._lock = threading.Lock()
        if self._socket is not None:
            self._socket.close()
        self._socket = self._process = None

    def _exchange(self, request: bytes) -> tuple[bytes, list[int]]:
        assert self._socket is not None
        self._socket.sendall(request)
        reply, descriptors, _, _ = socket.recv_fds(self._socket, _MOST_REPLY, 3)
        if not reply:
            raise ConnectionResetError("the fork server ended")
        return reply, descriptors

    def _restart(self) -> None:
        """Start the server. Of the environment it gets the module path only: no secrets."""
        self._stop()
        environment = {
            "PYTHONPATH": os.pathsep.join(part for part in sys.path if part),
            "PYTHONHASHSEED": "0",
            "PYTHONDONTWRITEBYTECODE": "1",
            "LC_ALL": "C.UTF-8",
            "OPENBLAS_NUM_THREADS": "1",  # A process with threads cannot be forked.
        }
        # This kind of socket keeps messages apart, so each reply arrives whole, with its
        # descriptors.
        here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        here.settimeout(START_DEADLINE)
        try:
            with there:
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-m", f"{__package__}.worker_main"],
                    stdin=there.fileno(),
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    env=environment,
                    # Ctrl-C in the terminal must reach the service only, which ends its workers.
                    start_new_session=True,
                )
        except OSError:
            here.close()
            raise
        self._socket = here

    def _stop(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


FORK_SERVER: Final = ForkServer()
"""Of this process: all pools have their workers from it."""
atexit.register(FORK_SERVER.stop)
os.register_at_fork(after_in_child=FORK_SERVER.forget)
