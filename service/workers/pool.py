"""Workers of one kind: so many at once, a bounded number of callers waiting for one."""

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
"""A worker is replaced after so many: a store that is changed for long leaks."""
_SECONDS: Final = (0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10)


class Busy(Exception):
    """All workers are taken, and as many callers are waiting as may."""


class Pool:
    """``count`` workers with ``memory`` bytes each, and ``waiting`` callers more than that.

    Workers are started when they are first needed, or by `warm`, and replaced when they were
    ended. `run` is for the event loop, `call` for a thread that waits itself. Senders take turns:
    none has all workers of several, and who waits comes before those of whom more are at work.
    """

    def __init__(self, count: int, memory: int, waiting: int = 0) -> None:
        self.count = count
        self.ends: Counter[End] = Counter(dict.fromkeys(End, 0))
        """How many workers came to their end in the middle of a job, by reason."""
        self.jobs = Histogram(
            "dyknow_worker_job_seconds",
            "How long jobs of workers took",
            ["kind", "outcome"],
            registry=None,
            buckets=_SECONDS,
        )
        """By the kind of job and what became of it (`worker.Tell`)."""
        self.failure: str | None = None
        """Why no worker could be started at the last try."""
        self._memory = memory
        self._most_waiting = waiting
        self._most_of_one = max(1, count - 1)
        self._waiting: list[_Place] = []
        self._running: Counter[str] = Counter()
        """How many callers have a worker, by their sender."""
        self._threads = anyio.CapacityLimiter(2 * count)
        self._idle: list[Worker] = []
        self._working: set[Worker] = set()
        self._lock = threading.Lock()
        self._closed = False

    async def run(
        self, job: Callable[[Worker], Answer], patience: float, sender: str = ""
    ) -> Answer:
        """What ``job`` of ``sender`` gives, which is called with a worker on a thread of its own.

        Whoever cancels this ends the worker. Raises `Busy` when no worker is free for ``patience``
        seconds or too many callers wait already, and `WorkerError`.
        """
        await self._admitted(sender, patience)
        errand = _Errand(self, job)
        try:
            return await anyio.to_thread.run_sync(
                errand.run, limiter=self._threads, abandon_on_cancel=True
            )
        except anyio.get_cancelled_exc_class():
            errand.give_up()
            raise
        finally:
            self._leave(sender)

    async def _admitted(self, sender: str, patience: float) -> None:
        """Return when it is the turn of ``sender``; raises `Busy`."""
        place = _Place(sender)
        self._waiting.append(place)
        self._admit()
        if place in self._waiting and self.waiting > self._most_waiting:
            self._waiting.remove(place)
            raise Busy
        try:
            with anyio.fail_after(patience):
                await place.comes.wait()
        except BaseException as error:
            if place in self._waiting:
                self._waiting.remove(place)
            else:
                self._leave(sender)
            if isinstance(error, TimeoutError):
                raise Busy from error
            raise

    def _admit(self) -> None:
        """Let callers go on for whom there is a worker."""
        while self._running.total() < self.count:
            able = [one for one in self._waiting if self._running[one.sender] < self._most_of_one]
            if not able:
                return
            first = min(able, key=lambda one: self._running[one.sender])
            self._waiting.remove(first)
            # Its sender's others come after those of other senders: they take turns.
            self._waiting.sort(key=lambda one: one.sender == first.sender)
            self._running[first.sender] += 1
            first.comes.set()

    def _leave(self, sender: str) -> None:
        self._running[sender] -= 1
        self._running += Counter()
        self._admit()

    @property
    def waiting(self) -> int:
        """How many callers wait for a worker."""
        return len(self._waiting)

    def call(self, job: Callable[[Worker], Answer]) -> Answer:
        """The same in the thread of the caller, which waits. Raises `WorkerError`."""
        return _Errand(self, job).run()

    def warm(self) -> None:
        """Start all workers now; none where the service stops meanwhile."""
        taken: list[Worker] = []
        try:
            while len(taken) < self.count:
                taken.append(self.take())
        except WorkerError:
            if not self._closed:
                raise
        finally:
            for worker in taken:
                self.give(worker)

    def take(self) -> Worker:
        """A worker that does nothing, started if there is none. Raises `WorkerError`."""
        with self._lock:
            if self._closed:
                raise WorkerError("the service stops")
            worker = self._idle.pop() if self._idle else None
        if worker is not None and not worker.is_alive:
            worker.close()
            worker = None
        if worker is None:
            worker = self._started()
        with self._lock:
            self._working.add(worker)
        return worker

    def _started(self) -> Worker:
        try:
            worker = Worker.start(self._memory, self._tell)
        except WorkerError as error:
            self.failure = str(error)
            raise
        self.failure = None
        return worker

    def _tell(self, kind: str, outcome: str, seconds: float) -> None:
        self.jobs.labels(kind, outcome).observe(seconds)

    def give(self, worker: Worker) -> None:
        """``worker`` has done what it was taken for, or has come to its end."""
        with self._lock:
            self._working.discard(worker)
            is_alive = worker.is_alive
            if not is_alive:
                self.ends[worker.end or End.CRASH] += 1
            # While all were started beside those who asked, there may be more than there are to be.
            is_wanted = len(self._idle) + len(self._working) < self.count
            stays = is_alive and is_wanted and not self._closed and worker.jobs < MOST_JOBS
            if stays:
                self._idle.append(worker)
        if not stays:
            worker.close()

    @property
    def ended(self) -> int:
        """How many workers came to their end in the middle of a job."""
        return self.ends.total()

    @property
    def busy(self) -> int:
        """How many workers are at work."""
        return len(self._working)

    @property
    def idle(self) -> int:
        """How many wait for work."""
        return len(self._idle)

    @property
    def is_down(self) -> bool:
        """Whether there is no worker, and none could be started when one was needed."""
        return self.failure is not None and not self._idle and not self._working

    def mend(self) -> None:
        """Try again to start a worker where there is none. Waits for it."""
        if self.is_down:
            with suppress(WorkerError):
                self.give(self.take())

    def open(self) -> None:
        """There are workers again, after `close`."""
        with self._lock:
            self._closed = False

    def close(self) -> None:
        """End all workers; who waits for one gets `WorkerError`."""
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
    """A caller that waits until its turn ``comes``."""

    sender: str
    comes: anyio.Event = field(default_factory=anyio.Event)


class _Errand:
    """One job on its way: it may be given up from another thread."""

    def __init__(self, pool: Pool, job: Callable[[Worker], Answer]) -> None:
        self._pool = pool
        self._job = job
        self._lock = threading.Lock()
        self._worker: Worker | None = None
        self._given_up = False

    def run(self) -> Answer:
        worker = self._pool.take()
        try:
            with self._lock:
                self._worker = worker
                if self._given_up:
                    worker.kill(End.LEFT)
            return self._job(worker)
        finally:
            with self._lock:
                self._worker = None
            self._pool.give(worker)

    def give_up(self) -> None:
        """End the worker, and with it the wait for it."""
        with self._lock:
            self._given_up = True
            if self._worker is not None:
                self._worker.kill(End.LEFT)
