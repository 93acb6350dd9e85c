"""One worker process as its parent has it: jobs in, answers out, killed when one takes too long."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from enum import StrEnum
from typing import Final

from .messages import (
    PREFIX,
    Answer,
    BadAnswer,
    Job,
    decode_answer,
    encode,
    tag_of,
)

START_DEADLINE: Final = 60.0
"""Seconds in which a worker is ready: it only imports, but a machine may be busy."""
_CHUNK: Final = 1 << 20
_MEMORY_SIGNALS: Final = (signal.SIGABRT, signal.SIGSEGV, signal.SIGBUS)


class End(StrEnum):
    """Why a worker came to its end in the middle of a job."""

    DEADLINE = "deadline"
    """It took more time, or more of a processor, than it may."""
    MEMORY = "memory"
    """It needed more memory or stack."""
    CRASH = "crash"
    """Anything else, also an answer that is none."""
    LEFT = "left"
    """Who had asked has gone."""
    SHUTDOWN = "shutdown"
    """The service stops."""


class WorkerError(Exception):
    """A job that has no answer; its worker is gone. The message says why, for people."""

    end = End.CRASH


class NoWorker(WorkerError):
    """None starts: nothing is wrong with the job."""


class TookTooLong(WorkerError):
    """No answer within the deadline."""

    end = End.DEADLINE


class Died(WorkerError):
    """The process ended: out of memory or of stack, most likely."""

    def __init__(self, message: str, end: End = End.CRASH) -> None:
        super().__init__(message)
        self.end = end


Tell = Callable[[str, str, float], None]
"""Told of each job: its kind, what became of it (the answer's tag, or an `End`), the seconds."""


def _unheard(_kind: str, _outcome: str, _seconds: float) -> None:
    """Nobody counts."""


class Worker:
    """A process that does one job at a time (`worker_main`); made by `start`.

    ``position`` and ``kept`` are for who asks: what the process has by now (`sparql`,
    `oxigraph_client`). Calls wait in the thread that makes them; `kill` may be called from any.
    """

    def __init__(self, process: subprocess.Popen[bytes], tell: Tell = _unheard) -> None:
        self.position: int | None = None
        self.kept: dict[str, int] = {}
        self.jobs = 0
        self.end: End | None = None
        """Why it came to its end; None while it has not, or where nobody waited for it."""
        self._tell = tell
        self._process = process
        assert process.stdin is not None
        assert process.stdout is not None
        self._in, self._out = process.stdin.fileno(), process.stdout.fileno()
        os.set_blocking(self._in, False)
        os.set_blocking(self._out, False)

    @classmethod
    def start(cls, memory: int, tell: Tell = _unheard) -> Worker:
        """A new process, with ``memory`` bytes for what it is given; ready when this returns.

        It starts anew (no fork: this process has threads), and of the environment it gets where
        modules are found and nothing else. Raises `NoWorker` if it does not come up.
        """
        environment = {
            "PYTHONPATH": os.pathsep.join(part for part in sys.path if part),
            "PYTHONHASHSEED": "0",
            "PYTHONDONTWRITEBYTECODE": "1",
            "LC_ALL": "C.UTF-8",
        }
        try:
            process = cls._process_of(memory, environment)
        except OSError as error:  # no memory, no room for a process
            raise NoWorker(f"a worker does not start: {error}") from error
        worker = cls(process, tell)
        ready = worker._guarded(lambda: worker._receive(time.monotonic() + START_DEADLINE, 16))
        if ready != b"ready":
            worker.kill()
            raise NoWorker("a worker does not start")
        return worker

    @staticmethod
    def _process_of(memory: int, environment: dict[str, str]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-P", "-m", f"{__package__}.worker_main", str(memory)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            close_fds=True,
            # What a terminal sends to the service is not for its workers.
            start_new_session=True,
        )

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
        begun = time.monotonic()
        outcome: str = End.CRASH
        try:
            answer = self._answer(job, begun + job.seconds, most)
            outcome = tag_of(answer)
        except WorkerError as error:
            # Who ended it knows better than who found it so.
            outcome = self.end = self.end or error.end
            raise
        finally:
            self._tell(tag_of(job.work), outcome, time.monotonic() - begun)
        return answer

    def _answer(self, job: Job, until: float, most: int) -> Answer:
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

    def kill(self, end: End | None = None) -> None:
        """End the process, whatever it does, and say why if nobody else will."""
        self.end = self.end or end
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
            raise self._last_words() from error

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
                raise self._last_words()
            data += part
        return bytes(data)

    def _last_words(self) -> Died:
        status = self._process.poll()
        if status is None or status >= 0:
            return Died("its process ended")
        number = signal.Signals(-status)
        if number in _MEMORY_SIGNALS:
            return Died("it needed more memory or stack than it may have", End.MEMORY)
        if number is signal.SIGXCPU:
            return Died("it needed more processor time than it may have", End.DEADLINE)
        return Died(f"its process was ended by {number.name}")


def _await(descriptor: int, event: int, until: float) -> None:
    """Wait until the descriptor is ready. Raises `TookTooLong`."""
    left = until - time.monotonic()
    poll = select.poll()
    poll.register(descriptor, event)
    if left <= 0 or not poll.poll(left * 1000):
        raise TookTooLong("no answer within its time")
