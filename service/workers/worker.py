"""The handle of a worker process: it sends jobs, receives answers, and kills a slow process."""

from __future__ import annotations

import os
import select
import signal
import time
from collections.abc import Callable
from enum import StrEnum
from typing import Final

from .fork_server import FORK_SERVER, START_DEADLINE, ForkedProcess
from .messages import (
    PREFIX,
    Answer,
    BadAnswer,
    Job,
    decode_answer,
    encode,
    tag_of,
)

PATIENCE: Final = 12.0
"""How many times its processor time a text may take by the clock: a busy machine is not its
fault."""
_CHUNK: Final = 1 << 20
_MEMORY_SIGNALS: Final = (signal.SIGABRT, signal.SIGSEGV, signal.SIGBUS)


class End(StrEnum):
    """Why a worker ended during a job."""

    DEADLINE = "deadline"
    """The job exceeded its time or processor time."""
    MEMORY = "memory"
    """The job exceeded memory or stack."""
    CRASH = "crash"
    """Any other cause, such as an invalid answer."""
    LEFT = "left"
    """The caller was cancelled: its client disconnected."""
    SHUTDOWN = "shutdown"
    """The service stops."""


class WorkerError(Exception):
    """A job without an answer; its worker is dead. The message is the reason, for users."""

    end = End.CRASH


class NoWorker(WorkerError):
    """No worker starts; the job is not the cause."""


class TookTooLong(WorkerError):
    """There was no answer within the deadline."""

    end = End.DEADLINE


class Died(WorkerError):
    """The process died, mostly for lack of memory or stack."""

    def __init__(self, message: str, end: End = End.CRASH) -> None:
        super().__init__(message)
        self.end = end


JobObserver = Callable[[str, str, float], None]
"""Receives the kind of each job, its outcome (the answer's tag, or an `End`), and its seconds."""


def _ignore(_kind: str, _outcome: str, _seconds: float) -> None:
    """Ignore a job."""


class Worker:
    """A process that does one job at a time (`worker_main`); `start` makes it.

    ``position`` and ``kept`` describe the process's state for its users (`sparql`,
    `oxigraph_client`). `call` blocks its thread; any thread may call `kill`.
    """

    def __init__(self, process: ForkedProcess, observe: JobObserver = _ignore) -> None:
        self.position: int | None = None
        self.kept: dict[str, int] = {}
        self.jobs = 0
        self.end: End | None = None
        """Why it ended during a job; None while it has not."""
        self._observe = observe
        self._process = process
        self._in, self._out = process.jobs, process.answers

    @classmethod
    def start(cls, memory: int, observe: JobObserver = _ignore) -> Worker:
        """Start a process with ``memory`` bytes for its jobs, and return it when it is ready.

        Raises `NoWorker` if it does not start.
        """
        try:
            process = FORK_SERVER.fork(memory)
        except OSError as error:
            raise NoWorker(f"a worker does not start: {error}") from error
        worker = cls(process, observe)
        ready = worker._kill_on_error(
            lambda: worker._receive(time.monotonic() + START_DEADLINE, 16)
        )
        if ready != b"ready":
            worker.kill()
            raise NoWorker("a worker does not start")
        return worker

    @property
    def pid(self) -> int:
        return self._process.pid

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def call(self, job: Job, most: int, *, patience: float = 1) -> Answer:
        """Send ``job``, and return its answer of at most ``most`` bytes.

        It may take its processor time, and by the clock ``patience`` times as long: on a busy
        machine it gets a part of a processor only. Raises `WorkerError`; then the process is dead.
        """
        self.jobs += 1
        begun = time.monotonic()
        outcome: str = End.CRASH
        try:
            answer = self._answer(job, begun + patience * job.seconds, most)
            outcome = tag_of(answer)
        except WorkerError as error:
            # The reason that `kill` got goes before the one that is guessed from the exit.
            outcome = self.end = self.end or error.end
            raise
        finally:
            self._observe(tag_of(job.work), outcome, time.monotonic() - begun)
        return answer

    def _answer(self, job: Job, until: float, most: int) -> Answer:
        message = encode(job)

        def exchange() -> bytes:
            self._send(len(message).to_bytes(PREFIX, "big"), until)
            self._send(message, until)
            return self._receive(until, most)

        data = self._kill_on_error(exchange)
        try:
            return decode_answer(data)
        except BadAnswer as error:
            self.kill()
            raise Died(f"a worker sent an invalid answer: {error}") from error

    def kill(self, end: End | None = None) -> None:
        """Kill the process; ``end`` is the reason unless there is one already."""
        self.end = self.end or end
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """Kill the process and close its pipes. Contract: no call is under way."""
        self.kill()
        self._process.close()

    def _kill_on_error(self, work: Callable[[], bytes]) -> bytes:
        try:
            return work()
        except WorkerError:
            self.kill()
            raise
        except OSError as error:  # a broken pipe: the process died
            self.kill()
            raise self._exit_error() from error

    def _send(self, data: bytes, until: float) -> None:
        left = memoryview(data)
        while left:
            _wait_ready(self._in, select.POLLOUT, until)
            left = left[os.write(self._in, left[:_CHUNK]) :]

    def _receive(self, until: float, most: int) -> bytes:
        size = int.from_bytes(self._receive_exactly(PREFIX, until), "big")
        # A malicious text may have taken over the worker, so its lengths are not to be trusted.
        if size > most:
            raise Died(f"its answer has {size} bytes, more than allowed")
        return self._receive_exactly(size, until)

    def _receive_exactly(self, size: int, until: float) -> bytes:
        data = bytearray()
        while len(data) < size:
            _wait_ready(self._out, select.POLLIN, until)
            part = os.read(self._out, min(size - len(data), _CHUNK))
            if not part:
                self._process.wait()
                raise self._exit_error()
            data += part
        return bytes(data)

    def _exit_error(self) -> Died:
        status = self._process.poll()
        if status is None or status >= 0:
            return Died("its process ended")
        number = signal.Signals(-status)
        if number in _MEMORY_SIGNALS:
            return Died("it needed more memory or stack than allowed", End.MEMORY)
        if number is signal.SIGXCPU:
            return Died("it needed more processor time than allowed", End.DEADLINE)
        return Died(f"signal {number.name} ended its process")


def _wait_ready(descriptor: int, event: int, until: float) -> None:
    """Wait until the descriptor is ready. Raises `TookTooLong`."""
    left = until - time.monotonic()
    poll = select.poll()
    poll.register(descriptor, event)
    if left <= 0 or not poll.poll(left * 1000):
        raise TookTooLong("there was no answer within the time limit")
