"""What copies of the store have to be told: the changes since they last asked.

Copies are in other processes, which may be ended while they work (service/workers). The log keeps
the last changes only; who asks for older ones gets everything anew.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Set
from dataclasses import dataclass, field
from typing import Final

from pyoxigraph import Quad

from .churn import weight

MOST: Final = 20_000
"""Short quads of changes that are kept: a copy is made anew rather than told more."""


@dataclass(slots=True)
class ChangeLog:
    """The last changes of a store, numbered. Cost of `note`: O(quads). Memory: `MOST` quads."""

    position: int = 0
    """How many changes there were."""
    _changes: deque[tuple[Set[Quad], Set[Quad], int]] = field(default_factory=deque)
    """What came, what went, and how much that is."""
    _size: int = 0

    def note(self, added: Set[Quad], removed: Set[Quad]) -> None:
        """These came and these went, in one change."""
        self.position += 1
        size = weight(added) + weight(removed)
        self._changes.append((added, removed, size))
        self._size += size
        while self._size > MOST:
            self._size -= self._changes.popleft()[2]

    def reset(self) -> None:
        """More has changed than is kept: copies are made anew."""
        self.position += 1
        self._changes.clear()
        self._size = 0

    def since(self, position: int) -> tuple[Set[Quad], Set[Quad]] | None:
        """What came and what went after the first ``position`` changes, on balance; None if they
        are not all kept."""
        missing = self.position - position
        if missing > len(self._changes):
            return None
        added_since: set[Quad] = set()
        removed_since: set[Quad] = set()
        for number in range(len(self._changes) - missing, len(self._changes)):
            added, removed, _ = self._changes[number]
            added_since = (added_since - removed) | added
            removed_since = (removed_since - added) | removed
        return added_since, removed_since


def as_nquads(quads: Iterable[Quad]) -> bytes:
    """Quads as N-Quads; blank nodes keep their names."""
    return "".join(f"{quad} .\n" for quad in quads).encode()
