"""Work that may take long, a little at a time beside the event loop: fibers.

A fiber works on a thread of its own. It and the event loop's thread take turns: only one of them
touches the engine at a time. Where the work may be interrupted (`streams.yield_points`) the fiber
hands the turn back when its time is over. What it does apart (a loop over what is its own, a
question to a worker) it does while others have the turn. Windows of queries are closed so
(`window_turns`), and large batches decoded (`batch_decoding`).
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Final

FURTHER: Final = 0.005
"""Seconds at a time for what is left, with others in between."""
_PASSES: Final = 3
"""Passes of the event loop for others between two turns: a request takes some."""
_NOTHING = nullcontext()


async def let_others() -> None:
    """Everybody else in the event loop has a turn."""
    for _ in range(_PASSES):
        await asyncio.sleep(0)


def waking(event: asyncio.Event) -> Callable[[], None]:
    """What sets ``event`` of the loop that runs here, from any thread; see `Fibers.on_ready`."""
    loop = asyncio.get_running_loop()

    def wake() -> None:
        with suppress(RuntimeError):  # the loop has come to its end
            loop.call_soon_threadsafe(event.set)

    return wake


class Abandoned(Exception):
    """Nobody wants any more what the fiber does."""


class Fibers:
    """The threads of fibers and the time that they have; `Pauses` for what they do.

    ``patience``: for so many seconds more one is waited for that does something apart.
    ``on_ready`` is called, from any thread, when a fiber can go on that did something apart.

    Cost: two thread switches (some 15 µs) for each `Fiber.go_on`.
    """

    def __init__(self, name: str, patience: float = FURTHER) -> None:
        self.patience = patience
        self.on_ready: Callable[[], None] = _nobody
        self._name = name
        self._until = 0.0
        self._idle: deque[_Thread] = deque()
        self._here = threading.local()

    def allow(self, seconds: float) -> None:
        """From now on there is so much time."""
        self._until = time.monotonic() + seconds

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""
        return time.monotonic() >= self._until

    @property
    def left(self) -> float:
        """Seconds until it is."""
        return max(0.0, self._until - time.monotonic())

    def breathe(self) -> None:
        """See `Pauses`."""
        fiber: Fiber | None = getattr(self._here, "fiber", None)
        if fiber is not None:
            fiber.breathe()

    def apart(self, *, waits: bool = False) -> AbstractContextManager[None]:
        """See `Pauses`."""
        fiber: Fiber | None = getattr(self._here, "fiber", None)
        return _NOTHING if fiber is None else fiber.apart(waits)

    def close(self) -> None:
        """Let the threads go that do nothing."""
        while self._idle:
            self._idle.pop().leave()

    # -- for fibers --------------------------------------------------------------------------

    def borrow(self) -> _Thread:
        """A thread that does nothing."""
        return self._idle.pop() if self._idle else _Thread(self._name, self._here)

    def give_back(self, thread: _Thread) -> None:
        """It does nothing again."""
        self._idle.append(thread)


class _Thread(threading.Thread):
    """Works while it has the turn, and waits for it else. A daemon: one that waits for ever keeps
    nobody from ending."""

    def __init__(self, name: str, here: threading.local) -> None:
        super().__init__(name=name, daemon=True)
        self.turn, self.back = threading.Lock(), threading.Lock()
        self.turn.acquire()
        self.back.acquire()
        self.fiber: Fiber | None = None
        self._here = here
        self.start()

    def run(self) -> None:
        while True:
            self.turn.acquire()
            fiber = self.fiber
            if fiber is None:
                return
            self._here.fiber = fiber
            fiber.run()
            self.fiber = self._here.fiber = None
            del fiber
            self.back.release()

    def leave(self) -> None:
        """It has nothing to do any more."""
        self.turn.release()


class Fiber:
    """Does ``work``. Called by the thread of the event loop; `breathe`, `apart` and `run` by its
    own."""

    def __init__(self, fibers: Fibers, work: Callable[[], None]) -> None:
        self._fibers = fibers
        self._work = work
        self._thread: _Thread | None = None
        self._lock = threading.Lock()
        """Of the next three."""
        self._is_apart = False
        self._is_left = False
        """Whether the turn was taken while it was apart: then it waits for it."""
        self._is_ready = threading.Event()
        self._is_ready.set()
        self._to_end = False
        self._is_abandoned = False
        self._is_done = False
        self._error: BaseException | None = None

    @property
    def is_ready(self) -> bool:
        """Whether it can go on now; else it does something apart, or waits for it."""
        return self._is_ready.is_set()

    def go_on(self, *, to_end: bool = False) -> bool:
        """Work until the time is over, or the work is; whether it is. Raises what it does.

        ``to_end``: until the work is over, however long that takes.
        """
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

    def abandon(self) -> None:
        """Nobody wants it any more: it ends with `Abandoned` where it would breathe next, which is
        waited for."""
        self._is_abandoned = True
        if self._thread is None:
            self._work = _nobody
        while not self._is_done and self._thread is not None:
            self._is_ready.wait()
            self._hand_over()

    def _hand_over(self) -> None:
        """Give the turn to it, until it gives it back, or is apart when the time is over."""
        if self._thread is None:
            self._thread = self._fibers.borrow()
            self._thread.fiber = self
        thread = self._thread
        thread.turn.release()
        while not thread.back.acquire(timeout=self._fibers.left + self._fibers.patience):
            with self._lock:
                if self._is_apart:
                    self._is_left = True
                    self._is_ready.clear()
                    return
        if self._is_done:
            self._thread = None
            self._fibers.give_back(thread)

    # -- in its own thread -------------------------------------------------------------------

    def run(self) -> None:
        """Do the work, and keep what it raises for who waits for it."""
        # Work that is its own method would keep it, and what it works on, when it is done.
        work, self._work = self._work, _nobody
        try:
            work()
        except BaseException as error:  # noqa: BLE001  raised where it is waited for
            self._error = error
        self._is_done = True

    def breathe(self) -> None:
        """See `Pauses`."""
        if self._is_apart:
            return
        if self._is_abandoned:
            raise Abandoned
        if self._fibers.is_over and not self._to_end:
            assert self._thread is not None
            self._thread.back.release()
            self._thread.turn.acquire()
            if self._is_abandoned:
                raise Abandoned

    @contextmanager
    def apart(self, waits: bool) -> Iterator[None]:
        """See `Pauses`."""
        self._is_apart = True
        try:
            yield
        finally:
            with self._lock:
                self._is_apart = False
                was_left, self._is_left = self._is_left, False
            if was_left:
                self._is_ready.set()
                self._fibers.on_ready()
                assert self._thread is not None
                self._thread.turn.acquire()
        self.breathe()


def _nobody() -> None:
    pass
