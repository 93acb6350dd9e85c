"""A pool of workers of one kind, with a bounded number of waiting callers."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

import anyio
import anyio.to_thread
from prometheus_client import Histogram

from .messages import Answer
from .worker import End, Worker, WorkerError

MOST_JOBS: Final = 20_000
"""Jobs after which a worker is replaced: a store leaks memory over many changes."""
_SECONDS: Final = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10)


class Busy(Exception):
    """All workers are busy, and too many callers wait already."""


class Pool:
    """``count`` workers with ``memory`` bytes each; at most ``waiting`` callers wait for one.

    Workers start at the first need or by `warm`; a dead one is replaced. `run` is for the event
    loop, `call` for a thread that may block. Senders take turns: none has all workers if there are
    several, and of those who wait, the sender with the fewest jobs comes first.
    """

    def __init__(self, count: int, memory: int, waiting: int = 0) -> None:
        self.count = count
        self.ends: Counter[End] = Counter(dict.fromkeys(End, 0))
        """The number of workers that ended during a job, by reason."""
        self.jobs = Histogram(
            "dyknow_worker_job_seconds",
            "Duration of the jobs of workers",
            ["kind", "outcome"],
            registry=None,
            buckets=_SECONDS,
        )
        """By kind of job and outcome (`worker.JobObserver`)."""
        self.failure: str | None = None
        """Why the last start of a worker failed; None: it succeeded."""
        self._memory = memory
        self._waiting_limit = waiting
        self._limit_per_sender = max(1, count - 1)
        self._waiting: list[_Place] = []
        self._running: Counter[str] = Counter()
        """The number of callers that have a worker, by sender."""
        self._threads = anyio.CapacityLimiter(2 * count)
        self._idle: list[Worker] = []
        self._working: set[Worker] = set()
        self._lock = threading.Lock()
        self._closed = False

    async def run(
        self, job: Callable[[Worker], Answer], timeout: float, sender: str = ""
    ) -> Answer:
        """Call ``job`` of ``sender`` with a worker in another thread, and return its answer.

        Cancelling this kills the worker. Raises `Busy` if no worker is free within ``timeout``
        seconds or too many callers wait already, and `WorkerError`.
        """
        await self._wait_turn(sender, timeout)
        call = _Call(self, job)
        try:
            return await anyio.to_thread.run_sync(
                call.run, limiter=self._threads, abandon_on_cancel=True
            )
        except anyio.get_cancelled_exc_class():
            call.cancel()
            raise
        finally:
            self._leave(sender)

    async def _wait_turn(self, sender: str, timeout: float) -> None:
        """Return when ``sender`` gets a worker. Raises `Busy`."""
        place = _Place(sender)
        self._waiting.append(place)
        self._admit()
        if place in self._waiting and self.waiting > self._waiting_limit:
            self._waiting.remove(place)
            raise Busy
        try:
            with anyio.fail_after(timeout):
                await place.turn.wait()
        except BaseException as error:
            if place in self._waiting:
                self._waiting.remove(place)
            else:
                # The turn came while the caller gave up, so the next caller gets the worker.
                self._leave(sender)
            if isinstance(error, TimeoutError):
                raise Busy from error
            raise

    def _admit(self) -> None:
        """Give free workers to callers that wait."""
        while self._running.total() < self.count:
            eligible = [
                one for one in self._waiting if self._running[one.sender] < self._limit_per_sender
            ]
            if not eligible:
                return
            first = min(eligible, key=lambda one: self._running[one.sender])
            self._waiting.remove(first)
            # Its sender's other callers now come after those of other senders.
            self._waiting.sort(key=lambda one: one.sender == first.sender)
            self._running[first.sender] += 1
            first.turn.set()

    def _leave(self, sender: str) -> None:
        self._running[sender] -= 1
        # The addition drops senders without a worker, whose names would pile up.
        self._running += Counter()
        self._admit()

    @property
    def waiting(self) -> int:
        """The number of callers that wait for a worker."""
        return len(self._waiting)

    def call(self, job: Callable[[Worker], Answer]) -> Answer:
        """Do the same in the caller's thread, which blocks. Raises `WorkerError`."""
        return _Call(self, job).run()

    def warm(self) -> None:
        """Start all workers now, unless the service stops meanwhile."""
        workers: list[Worker] = []
        try:
            while len(workers) < self.count:
                workers.append(self.acquire())
        except WorkerError:
            if not self._closed:
                raise
        finally:
            for worker in workers:
                self.release(worker)

    def acquire(self) -> Worker:
        """Return an idle worker, or a new one. Raises `WorkerError`."""
        with self._lock:
            if self._closed:
                raise WorkerError("the service stops")
            worker = self._idle.pop() if self._idle else None
        if worker is not None and not worker.is_alive:
            worker.close()
            worker = None
        if worker is None:
            worker = self._start()
        with self._lock:
            self._working.add(worker)
        return worker

    def _start(self) -> Worker:
        try:
            worker = Worker.start(self._memory, self._observe)
        except WorkerError as error:
            self.failure = str(error)
            raise
        self.failure = None
        return worker

    def _observe(self, kind: str, outcome: str, seconds: float) -> None:
        self.jobs.labels(kind, outcome).observe(seconds)

    def release(self, worker: Worker) -> None:
        """Return a worker to the pool, idle or dead."""
        with self._lock:
            self._working.discard(worker)
            is_alive = worker.is_alive
            if not is_alive:
                self.ends[worker.end or End.CRASH] += 1
            # `warm` and callers may have started more than ``count`` together.
            is_wanted = len(self._idle) + len(self._working) < self.count
            stays = is_alive and is_wanted and not self._closed and worker.jobs < MOST_JOBS
            if stays:
                self._idle.append(worker)
        if not stays:
            worker.close()

    @property
    def ended(self) -> int:
        """The number of workers that ended during a job."""
        return self.ends.total()

    @property
    def busy(self) -> int:
        """The number of busy workers."""
        return len(self._working)

    @property
    def idle(self) -> int:
        """The number of idle workers."""
        return len(self._idle)

    @property
    def is_down(self) -> bool:
        """Whether there is no worker, and the last start failed."""
        return self.failure is not None and not self._idle and not self._working

    def restart(self) -> None:
        """Try again to start a worker if there is none. Blocks."""
        if self.is_down:
            with suppress(WorkerError):
                self.release(self.acquire())

    def open(self) -> None:
        """Allow workers again after `close`."""
        with self._lock:
            self._closed = False

    def close(self) -> None:
        """Kill all workers; waiting callers get `WorkerError`."""
        with self._lock:
            self._closed = True
            idle, self._idle = self._idle, []
            working = list(self._working)
        for worker in idle:
            worker.close()
        for worker in working:
            worker.kill(End.SHUTDOWN)


@dataclass(frozen=True, slots=True, eq=False)
class _Place:
    """A caller that waits; ``turn`` is set when it gets a worker."""

    sender: str
    turn: anyio.Event = field(default_factory=anyio.Event)


class _Call:
    """One job under way, which another thread may cancel."""

    def __init__(self, pool: Pool, job: Callable[[Worker], Answer]) -> None:
        self._pool = pool
        self._job = job
        self._lock = threading.Lock()
        self._worker: Worker | None = None
        self._is_cancelled = False

    def run(self) -> Answer:
        worker = self._pool.acquire()
        try:
            with self._lock:
                self._worker = worker
                if self._is_cancelled:
                    worker.kill(End.LEFT)
            return self._job(worker)
        finally:
            with self._lock:
                self._worker = None
            self._pool.release(worker)

    def cancel(self) -> None:
        """Kill the worker, so that `run` returns."""
        with self._lock:
            self._is_cancelled = True
            if self._worker is not None:
                self._worker.kill(End.LEFT)
