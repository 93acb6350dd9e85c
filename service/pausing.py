"""Closing windows a little at a time, so that nobody waits for a query that takes long.

A task closes the windows of one unit on a thread of its own. It and the event loop's thread take
turns: only one of them touches the engine at a time. Where a window may be interrupted
(`continuous.pauses`) the task hands the turn back when its time is over. What it does apart (a join
of rows that are its own, a question to a worker) it does while others have the turn.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Final

from ..continuous.budget import Stopped

FIRST: Final = 0.01
"""Seconds for what a request has brought about, before it is answered."""
FURTHER: Final = 0.005
"""Seconds at a time for what is left, with others in between."""
_NOTHING = nullcontext()


class Pausing:
    """`Turns` for an engine and `Pauses` for the windows of its units.

    ``seconds``: how much processor time one window may take; ``most``: and a unit until it has
    caught up. ``on_ready`` is called, from any thread, when a task can go on that did something
    apart.

    Cost: two thread switches (some 15 µs) for each `Task.go_on`.
    """

    def __init__(self, seconds: float, most: float) -> None:
        self.most = most
        self.on_ready: Callable[[], None] = _nobody
        self._seconds = seconds
        self._until = 0.0
        self._idle: deque[_Thread] = deque()
        self._here = threading.local()

    def allow(self, seconds: float) -> None:
        """From now on there is so much time."""
        self._until = time.monotonic() + seconds

    @property
    def is_over(self) -> bool:
        """See `Turns`."""
        return time.monotonic() >= self._until

    @property
    def left(self) -> float:
        """Seconds until it is."""
        return max(0.0, self._until - time.monotonic())

    def begin(self, close_next: Callable[[], bool]) -> _Task:
        """See `Turns`."""
        return _Task(self, close_next)

    def breathe(self) -> None:
        """See `Pauses`."""
        task: _Task | None = getattr(self._here, "task", None)
        if task is not None:
            task.breathe()

    def apart(self, *, waits: bool = False) -> AbstractContextManager[None]:
        """See `Pauses`."""
        task: _Task | None = getattr(self._here, "task", None)
        return _NOTHING if task is None else task.apart(waits)

    def close(self) -> None:
        """Let the threads go that do nothing."""
        while self._idle:
            self._idle.pop().leave()

    # -- for tasks ---------------------------------------------------------------------------

    def borrow(self) -> _Thread:
        """A thread that does nothing."""
        return self._idle.pop() if self._idle else _Thread(self._here)

    def give_back(self, thread: _Thread) -> None:
        """It does nothing again."""
        self._idle.append(thread)

    def check(self, spent: float) -> None:
        """Raises `Stopped` where a window has taken too long."""
        if spent > self._seconds:
            raise Stopped(
                f"it took more than {self._seconds:g} s of processor time (DYKNOW_QUERY_SECONDS)"
            )


class _Thread(threading.Thread):
    """Works while it has the turn, and waits for it else. A daemon: one that waits for ever keeps
    nobody from ending."""

    def __init__(self, here: threading.local) -> None:
        super().__init__(name="dyknow-windows", daemon=True)
        self.turn, self.back = threading.Lock(), threading.Lock()
        self.turn.acquire()
        self.back.acquire()
        self.task: _Task | None = None
        self._here = here
        self.start()

    def run(self) -> None:
        while True:
            self.turn.acquire()
            task = self.task
            if task is None:
                return
            self._here.task = task
            task.work()
            self.task = self._here.task = None
            del task
            self.back.release()

    def leave(self) -> None:
        """It has nothing to do any more."""
        self.turn.release()


class _Task:
    """See `engine.behind.Task`. Called by the thread of the event loop; `breathe`, `apart` and
    `work` by the task's own."""

    def __init__(self, pausing: Pausing, close_next: Callable[[], bool]) -> None:
        self._pausing = pausing
        self._close_next = close_next
        self._thread: _Thread | None = None
        self._lock = threading.Lock()
        """Of the next three."""
        self._is_apart = False
        self._is_left = False
        """Whether the turn was taken while it was apart: then it waits for it."""
        self._is_ready = threading.Event()
        self._is_ready.set()
        self._to_end = self._is_last = False
        self._is_done = False
        self._error: BaseException | None = None
        self._begun = self._began = 0.0
        """Processor time of the thread when the first and the present window began."""
        self._waited = 0.0
        """Seconds that another process worked for it."""
        self.spent = 0.0
        """See `engine.behind.Task`."""

    @property
    def is_ready(self) -> bool:
        """See `engine.behind.Task`."""
        return self._is_ready.is_set()

    def end(self) -> None:
        """See `engine.behind.Task`."""
        self._is_last = True

    def go_on(self, *, to_end: bool = False) -> bool:
        """See `engine.behind.Task`."""
        self._to_end |= to_end
        while not self._is_done:
            if to_end:
                self._is_ready.wait()
            self._hand_over()
            if not self._is_done and not to_end:
                return False
        if self._error is not None:
            raise self._error
        return True

    def _hand_over(self) -> None:
        """Give the turn to the task, until it gives it back, or is apart when the time is over."""
        if self._thread is None:
            self._thread = self._pausing.borrow()
            self._thread.task = self
        thread = self._thread
        thread.turn.release()
        while not thread.back.acquire(timeout=self._pausing.left + FURTHER):
            with self._lock:
                if self._is_apart:
                    self._is_left = True
                    self._is_ready.clear()
                    return
        if self._is_done:
            self._thread = None
            self._pausing.give_back(thread)

    # -- in its own thread -------------------------------------------------------------------

    def work(self) -> None:
        """Close windows until there are no more, or the time is over."""
        self._begun = time.thread_time()
        try:
            while True:
                self._began = time.thread_time()
                found = self._close_next()
                self._count()
                if not found or self._to_end or self._is_last or self._pausing.is_over:
                    break
        except BaseException as error:  # noqa: BLE001  raised where it is waited for
            self._error = error
        self._count()
        self._is_done = True

    def breathe(self) -> None:
        """See `Pauses`."""
        if self._is_apart:
            return
        self._pausing.check(time.thread_time() - self._began)
        self._count()
        if self._pausing.is_over and not self._to_end:
            self._wait_for_turn()

    @contextmanager
    def apart(self, waits: bool) -> Iterator[None]:
        """See `Pauses`."""
        begun = time.monotonic()
        self._is_apart = True
        try:
            yield
        finally:
            if waits:
                self._waited += time.monotonic() - begun
            with self._lock:
                self._is_apart = False
                was_left, self._is_left = self._is_left, False
            if was_left:
                self._is_ready.set()
                self._pausing.on_ready()
                assert self._thread is not None
                self._thread.turn.acquire()
        self.breathe()

    def _count(self) -> None:
        self.spent = time.thread_time() - self._begun + self._waited

    def _wait_for_turn(self) -> None:
        assert self._thread is not None
        self._thread.back.release()
        self._thread.turn.acquire()


def _nobody() -> None:
    pass
