"""Yield points: where long work can be interrupted, so that other work goes on meanwhile.

An evaluation has them between operators, a decoder between parts of a batch, both around work on
data that no other thread uses. `service/turns/fibers` decides whether a thread yields there;
`STRAIGHT` never yields.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Protocol, TypeVar

Items = TypeVar("Items", bound=Any)


class Pauses(Protocol):
    """The yield points of one thread's work."""

    def breathe(self) -> None:
        """Yield here. Raises if the work was cancelled: for a window that has taken too long
        `continuous.columns.budget.Stopped`."""

    def apart(self, *, waits: bool = False) -> AbstractContextManager[None]:
        """Let other work run during the block, which uses no shared data; the code after the block
        waits for its turn. ``waits``: another process does the work. Raises at the end of the block
        as `breathe` does."""


class Straight:
    """Never yields."""

    def breathe(self) -> None:
        return

    def apart(self, *, waits: bool = False) -> AbstractContextManager[None]:
        return _ALWAYS


_ALWAYS = nullcontext()
STRAIGHT = Straight()


def slices(items: Items, size: int, pauses: Pauses) -> Iterator[Items]:
    """Parts of the sequence ``items`` of ``size`` each, with a yield point after each."""
    if len(items) <= size:
        yield items
        return
    for start in range(0, len(items), size):
        yield items[start : start + size]
        pauses.breathe()
