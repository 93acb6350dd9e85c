"""Sliding aggregates without subtraction: two stacks of partial aggregates.

Sums that subtract what expires drift, and minima cannot be subtracted. Two stacks need only a
merge: the front holds suffix totals of the older panes, the back the newer panes and their total.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from .partials import Partial


class Monoid(Protocol):
    """Anything whose values can be merged into a new value."""

    def __add__(self, other: Self, /) -> Self: ...


M = TypeVar("M", bound=Monoid)


class Sliding(Generic[M]):
    """The merge of the panes that are in the window.

    Law: `total` is the merge of all panes pushed and not evicted. Cost: two merges a pane,
    amortized, and one a `total`. Memory: one partial a pane.
    """

    def __init__(self) -> None:
        self._front: list[tuple[int, M]] = []
        self._back: list[tuple[int, M]] = []
        self._back_total: M | None = None

    def push(self, end: int, pane: M) -> None:
        """The next pane, which ends at ``end`` (later than all before)."""
        self._back.append((end, pane))
        self._back_total = pane if self._back_total is None else self._back_total + pane

    def evict(self, until: int) -> None:
        """Forget the panes that end at or before ``until``."""
        while self._front and self._front[-1][0] <= until:
            self._front.pop()
        if not self._front and self._back and self._back[0][0] <= until:
            total: M | None = None
            for end, pane in reversed(self._back):
                if end <= until:
                    break
                total = pane if total is None else pane + total
                self._front.append((end, total))
            self._back, self._back_total = [], None

    def change(self, of: Callable[[M], M]) -> None:
        """Put ``of(pane)`` in each pane's place; ``of`` keeps merges: of(a) + of(b) = of(a + b)."""
        self._front = [(end, of(total)) for end, total in self._front]
        self._back = [(end, of(pane)) for end, pane in self._back]
        self._back_total = None if self._back_total is None else of(self._back_total)

    def total(self) -> M | None:
        """The merge of all panes in the window, None if there is none."""
        if not self._front:
            return self._back_total
        front = self._front[-1][1]
        return front if self._back_total is None else front + self._back_total


class Partials(tuple[Partial, ...]):
    """A partial for each argument of a query, merged one by one."""

    __slots__ = ()

    def __add__(self, other: object) -> Partials:
        assert isinstance(other, Partials)
        return Partials(a + b for a, b in zip(self, other, strict=True))

    def taken(self, groups: NDArray[np.int64]) -> Partials:
        """Each with these groups only."""
        return Partials(partial.taken(groups) for partial in self)
