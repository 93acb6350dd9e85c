"""Close windows in turns with the event loop, so that a long window delays no other request.

A task closes the windows of one unit on a thread of its own. The thread and the event loop take
turns: only one of them touches the engine at a time. Where an evaluation may pause
(`continuous.columns.pauses`) the thread hands the turn back once its time is over. It computes
without the turn what needs nothing of the engine: a compiled join, a question to a worker. Design
and measurements: docs/explanation/design/0010-turns.md.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Final

from ...continuous.columns.budget import Stopped

FIRST: Final = 0.01
"""Seconds for the windows that a request makes due, before its answer."""
FURTHER: Final = 0.005
"""Seconds of each later turn, and of patience with a task that works without the turn."""
_NOTHING = nullcontext()


class WindowTurns:
    """`Turns` for an engine, and `Pauses` for the windows of its units.

    ``seconds``: processor time that one window may take. ``limit``: processor time that a unit may
    take until it has caught up. Any thread may call ``on_ready``: a task that worked without the
    turn waits for it again.

    Cost: two thread switches (some 15 µs) for each `WindowTask.run`.
    """

    def __init__(self, seconds: float, limit: float) -> None:
        self.limit = limit
        self.on_ready: Callable[[], None] = _ignore
        self._seconds = seconds
        self._until = 0.0
        self._idle: deque[_Thread] = deque()
        self._here = threading.local()

    def allow(self, seconds: float) -> None:
        """Let tasks work for ``seconds`` from now on."""
        self._until = time.monotonic() + seconds

    @property
    def left(self) -> float:
        """Seconds until the time is over."""
        return max(0.0, self._until - time.monotonic())

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""
        return time.monotonic() >= self._until

    def start(self, close_next: Callable[[], int], emitting: float = 0.0) -> WindowTask:
        """See `Turns`."""
        return WindowTask(self, close_next, emitting)

    def time(self, work: Callable[[], None]) -> float:
        """See `Turns`."""
        begun = time.thread_time()
        work()
        return time.thread_time() - begun

    def pause(self) -> None:
        """See `Pauses`."""
        task: WindowTask | None = getattr(self._here, "task", None)
        if task is not None:
            task.pause()

    def released(self, *, waits: bool = False) -> AbstractContextManager[None]:
        """See `Pauses`."""
        task: WindowTask | None = getattr(self._here, "task", None)
        return _NOTHING if task is None else task.released(waits)

    def close(self) -> None:
        """End the idle threads."""
        while self._idle:
            self._idle.pop().end()

    # -- for tasks ---------------------------------------------------------------------------

    def check(self, spent: float) -> None:
        """Raise `Stopped` where a window has taken ``spent`` seconds and may not."""
        if spent > self._seconds:
            raise Stopped(
                f"it took more than {self._seconds:g} s of processor time (DYKNOW_QUERY_SECONDS)"
            )

    def borrow(self) -> _Thread:
        """Give an idle thread."""
        return self._idle.pop() if self._idle else _Thread(self._here)

    def give_back(self, thread: _Thread) -> None:
        """Take a thread back whose task is done."""
        self._idle.append(thread)


class _Thread(threading.Thread):
    """Runs one task after the other. Two locks pass the turn: the loop's thread releases ``turn``
    and waits for ``back``, this thread does the opposite. A daemon: a task that never gets the turn
    again does not keep the process alive."""

    def __init__(self, here: threading.local) -> None:
        super().__init__(name="dyknow-windows", daemon=True)
        self.turn, self.back = threading.Lock(), threading.Lock()
        self.turn.acquire()
        self.back.acquire()
        self.task: WindowTask | None = None
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
            del task  # else this frame would keep the evaluator until the next task
            self.back.release()

    def end(self) -> None:
        """End, as no task is left."""
        self.turn.release()


class WindowTask:
    """Closes windows of one unit: see `engine.units.backlog.Task`.

    The thread of the event loop calls `is_ready`, `run` and `stop_early`; the task's thread calls
    the methods below them.
    """

    def __init__(self, turns: WindowTurns, close_next: Callable[[], int], emitting: float) -> None:
        self._turns = turns
        self._close_next = close_next
        self._emitting = emitting
        self._thread: _Thread | None = None
        self._lock = threading.Lock()
        """Guards the next three."""
        self._is_released = False
        self._has_lost_turn = False
        """Whether the loop's thread took the turn back while the task worked without it."""
        self._is_ready = threading.Event()
        self._is_ready.set()
        self._to_end = False
        self._stops_early = False
        self._is_done = False
        self._error: BaseException | None = None
        self._begun = self._began = 0.0
        """Processor time of the thread when the first and the present window began."""
        self._waited = 0.0
        """Seconds of other processes that worked for it."""
        self.spent = 0.0
        """See `engine.units.backlog.Task`."""

    @property
    def is_ready(self) -> bool:
        """See `engine.units.backlog.Task`."""
        return self._is_ready.is_set()

    def stop_early(self) -> None:
        """See `engine.units.backlog.Task`."""
        self._stops_early = True

    def run(self, *, to_end: bool = False) -> bool:
        """See `engine.units.backlog.Task`."""
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
        """Give the turn to the thread, until it gives the turn back, or works without it when the
        time is over."""
        if self._thread is None:
            self._thread = self._turns.borrow()
            self._thread.task = self
        thread = self._thread
        thread.turn.release()
        # A thread that is beyond its time and not released cannot pause now, so this waits.
        while not thread.back.acquire(timeout=self._turns.left + FURTHER):
            with self._lock:
                if self._is_released:
                    self._has_lost_turn = True
                    self._is_ready.clear()
                    return
        if self._is_done:
            self._thread = None
            self._turns.give_back(thread)

    # -- in the task's thread ----------------------------------------------------------------

    def work(self) -> None:
        """Close windows, and keep what that raises for `run`."""
        try:
            self._close_windows()
        except BaseException as error:  # noqa: BLE001  `run` raises it
            self._error = error
        self._is_done = True

    def pause(self) -> None:
        """See `Pauses`."""
        # A released block has no turn to hand back.
        if self._is_released:
            return
        # Processor time is independent of other programs, so a busy machine stops no window.
        self._turns.check(time.thread_time() - self._began)
        self._count()
        if self._turns.is_over and not self._to_end:
            assert self._thread is not None
            self._thread.back.release()
            self._thread.turn.acquire()

    @contextmanager
    def released(self, waits: bool) -> Iterator[None]:
        """See `Pauses`."""
        begun = time.monotonic()
        self._is_released = True
        try:
            yield
        finally:
            if waits:
                self._waited += time.monotonic() - begun
            with self._lock:
                self._is_released = False
                has_lost_turn, self._has_lost_turn = self._has_lost_turn, False
            if has_lost_turn:
                self._is_ready.set()
                self._turns.on_ready()
                assert self._thread is not None
                self._thread.turn.acquire()
        self.pause()

    def _close_windows(self) -> None:
        """Close windows until none is due, or the time that is left is needed to emit results."""
        # Threads run several tasks, so the time of one does not begin at 0.
        self._begun = time.thread_time()
        to_emit = 0.0
        try:
            while True:
                self._began = time.thread_time()
                found = self._close_next()
                self._count()
                to_emit += self._emitting * found
                is_over = self._turns.left <= to_emit
                if not found or self._to_end or self._stops_early or is_over:
                    break
        finally:
            self._count()

    def _count(self) -> None:
        self.spent = time.thread_time() - self._begun + self._waited


def _ignore() -> None:
    pass
