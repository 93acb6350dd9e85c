"""Where work that may take long can be interrupted, so that others go on meanwhile.

The work says so itself: an evaluation between operators, a decoder between parts of a batch, both
around what touches nothing that others have. Whoever runs it decides whether it pauses there
(service/turns/fibers); `STRAIGHT` never does.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Protocol, TypeVar

Items = TypeVar("Items", bound=Any)


class Pauses(Protocol):
    """The moments of one thread's work."""

    def breathe(self) -> None:
        """Others may go on here, and this later. Raises where it is not wanted any more: of a
        window that has taken too long `continuous.columns.budget.Stopped`."""

    def apart(self, *, waits: bool = False) -> AbstractContextManager[None]:
        """What is done within touches nothing but what is its own: others may go on meanwhile, and
        what comes after it waits for its turn. ``waits``: it is another process that does it.
        Raises at its end as `breathe` does."""


class Straight:
    """No pauses."""

    def breathe(self) -> None:
        return

    def apart(self, *, waits: bool = False) -> AbstractContextManager[None]:
        return _ALWAYS


_ALWAYS = nullcontext()
STRAIGHT = Straight()


def slices(items: Items, size: int, pauses: Pauses) -> Iterator[Items]:
    """``items``, a sequence, so many at once, with a moment for others between them."""
    if len(items) <= size:
        yield items
        return
    for start in range(0, len(items), size):
        yield items[start : start + size]
        pauses.breathe()
