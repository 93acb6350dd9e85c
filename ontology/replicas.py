"""The log of recent changes, from which replicas of the store catch up.

Replicas live in other processes, which may be killed at any time (service/workers). The log keeps
the last changes only; a replica that is further behind gets the whole store.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Set
from dataclasses import dataclass, field
from typing import Final

from pyoxigraph import Quad

from .churn import weight

MOST: Final = 20_000
"""The size of the log in short quads. Above it, copying the whole store is cheaper."""


@dataclass(slots=True)
class ChangeLog:
    """The last changes of a store, numbered. Cost of `note`: O(quads). Memory: `MOST` quads."""

    position: int = 0
    """The number of changes so far."""
    _changes: deque[tuple[Set[Quad], Set[Quad], int]] = field(default_factory=deque)
    """Added quads, removed quads, and their size."""
    _size: int = 0

    def note(self, added: Set[Quad], removed: Set[Quad]) -> None:
        """Append a change."""
        self.position += 1
        size = weight(added) + weight(removed)
        self._changes.append((added, removed, size))
        self._size += size
        while self._size > MOST:
            self._size -= self._changes.popleft()[2]

    def reset(self) -> None:
        """Drop all changes after one that is not in the log: replicas start anew."""
        self.position += 1
        self._changes.clear()
        self._size = 0

    def since(self, position: int) -> tuple[Set[Quad], Set[Quad]] | None:
        """Return the net additions and removals after the first ``position`` changes; None if the
        log does not reach back."""
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
    """Return quads as N-Quads; blank nodes keep their names."""
    return "".join(f"{quad} .\n" for quad in quads).encode()
