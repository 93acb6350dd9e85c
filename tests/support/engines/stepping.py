"""Turns that end at random moments: who closes windows for an engine without a service."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from random import Random


class Steps:
    """`Turns` that are over after a random number of windows, or of parts of a batch; ``limit`` as
    there."""

    def __init__(self, random: Random, limit: float = float("inf")) -> None:
        self.limit = limit
        self._random = random
        self._left = 0

    def allow(self, windows: int | None = None) -> None:
        """So many windows may close now; some, where that is not said."""
        self._left = self._random.randrange(4) if windows is None else windows

    @property
    def is_over(self) -> bool:
        # Nobody tells of parts that are taken.
        return self._left <= 0 or self._random.random() < 0.1

    def start(self, close_next: Callable[[], int], emitting: float = 0.0) -> _Steps:
        return _Steps(self, close_next)

    def time(self, what: Callable[[], None]) -> float:
        what()
        return 0.0

    def pauses(self) -> bool:
        """Whether the window that is begun is half done when the turn ends."""
        return self._random.random() < 0.2

    def closed(self, windows: int) -> None:
        self._left -= windows


class _Steps:
    """Now and then a window is half done: it was begun, and has not closed."""

    is_ready = True

    def __init__(self, steps: Steps, close_next: Callable[[], int]) -> None:
        self.spent = 0.0
        self._steps = steps
        self._close_next = close_next
        bound = close_next.func if isinstance(close_next, partial) else close_next
        self._evaluator = bound.__self__  # type: ignore[attr-defined]
        self._is_last = False

    def stop_early(self) -> None:
        self._is_last = True

    def run(self, *, to_end: bool = False) -> bool:
        # Only a window that is there can be half done.
        is_due = self._evaluator.is_due
        while to_end or not (is_due and self._steps.pauses()):
            closed = self._close_next()
            if not closed:
                return True
            self.spent += closed
            self._steps.closed(closed)
            if self._steps.is_over or self._is_last or to_end:
                return True
            is_due = self._evaluator.is_due
        return False


def caught_up(work: Callable[[], object], behind: object, steps: Steps) -> None:
    """Close all windows that can."""
    for _ in range(10_000):
        if not behind:
            return
        steps.allow(1_000)
        work()
    raise AssertionError("it never catches up")
