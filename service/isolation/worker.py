"""One worker process as its parent has it: jobs in, answers out, killed when one takes too long."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Final

from .messages import PREFIX, Answer, BadAnswer, Job, decode_answer, encode

START_DEADLINE: Final = 60.0
"""Seconds in which a worker is ready: it only imports, but a machine may be busy."""
_CHUNK: Final = 1 << 20
_MEMORY_SIGNALS: Final = (signal.SIGABRT, signal.SIGSEGV, signal.SIGBUS)


class WorkerError(Exception):
    """A job that has no answer; its worker is gone. The message says why, for people."""


class TookTooLong(WorkerError):
    """No answer within the deadline."""


class Died(WorkerError):
    """The process ended: out of memory or of stack, most likely."""


class Worker:
    """A process that does one job at a time (`child`); made by `start`.

    ``position`` and ``kept`` are for who asks: what the process has by now (`sparql`, `asking`).
    Calls wait in the thread that makes them; `kill` may be called from any.
    """

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.position: int | None = None
        self.kept: dict[str, int] = {}
        self.jobs = 0
        self._process = process
        assert process.stdin is not None
        assert process.stdout is not None
        self._in, self._out = process.stdin.fileno(), process.stdout.fileno()
        os.set_blocking(self._in, False)
        os.set_blocking(self._out, False)

    @classmethod
    def start(cls, memory: int) -> Worker:
        """A new process, with ``memory`` bytes for what it is given; ready when this returns.

        It starts anew (no fork: this process has threads), and of the environment it gets where
        modules are found and nothing else. Raises `WorkerError` if it does not come up.
        """
        environment = {
            "PYTHONPATH": os.pathsep.join(part for part in sys.path if part),
            "PYTHONHASHSEED": "0",
            "PYTHONDONTWRITEBYTECODE": "1",
            "LC_ALL": "C.UTF-8",
        }
        process = subprocess.Popen(
            [sys.executable, "-P", "-m", f"{__package__}.child", str(memory)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            close_fds=True,
            # What a terminal sends to the service is not for its workers.
            start_new_session=True,
        )
        worker = cls(process)
        ready = worker._guarded(lambda: worker._receive(time.monotonic() + START_DEADLINE, 16))
        if ready != b"ready":
            worker.kill()
            raise WorkerError("a worker does not start")
        return worker

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def call(self, job: Job, most: int) -> Answer:
        """The answer to ``job``, of at most ``most`` bytes.

        Raises `WorkerError`; then the process is gone.
        """
        self.jobs += 1
        until = time.monotonic() + job.seconds
        message = encode(job)

        def exchange() -> bytes:
            self._send(len(message).to_bytes(PREFIX, "big"), until)
            self._send(message, until)
            return self._receive(until, most)

        data = self._guarded(exchange)
        try:
            return decode_answer(data)
        except BadAnswer as error:
            self.kill()
            raise Died(f"a worker answered nonsense: {error}") from error

    def kill(self) -> None:
        """End the process, whatever it does."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the process and give its pipes back; nobody waits for it."""
        self.kill()
        for pipe in (self._process.stdin, self._process.stdout):
            assert pipe is not None
            pipe.close()

    def _guarded(self, work: Callable[[], bytes]) -> bytes:
        try:
            return work()
        except WorkerError:
            self.kill()
            raise
        except OSError as error:  # a pipe without anybody at its other end
            self.kill()
            raise Died(self._last_words()) from error

    def _send(self, data: bytes, until: float) -> None:
        left = memoryview(data)
        while left:
            _await(self._in, select.POLLOUT, until)
            left = left[os.write(self._in, left[:_CHUNK]) :]

    def _receive(self, until: float, most: int) -> bytes:
        size = int.from_bytes(self._receive_exactly(PREFIX, until), "big")
        if size > most:
            raise Died(f"an answer of {size} bytes")
        return self._receive_exactly(size, until)

    def _receive_exactly(self, size: int, until: float) -> bytes:
        data = bytearray()
        while len(data) < size:
            _await(self._out, select.POLLIN, until)
            part = os.read(self._out, min(size - len(data), _CHUNK))
            if not part:
                self._process.wait()
                raise Died(self._last_words())
            data += part
        return bytes(data)

    def _last_words(self) -> str:
        status = self._process.poll()
        if status is None or status >= 0:
            return "its process ended"
        number = signal.Signals(-status)
        if number in _MEMORY_SIGNALS:
            return "it needed more memory or stack than it may have"
        if number is signal.SIGXCPU:
            return "it needed more processor time than it may have"
        return f"its process was ended by {number.name}"


def _await(descriptor: int, event: int, until: float) -> None:
    """Wait until the descriptor is ready. Raises `TookTooLong`."""
    left = until - time.monotonic()
    poll = select.poll()
    poll.register(descriptor, event)
    if left <= 0 or not poll.poll(left * 1000):
        raise TookTooLong("no answer within its time")
