"""Matches whose probes cannot be answered yet, by the time from which on they can."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....streams.jit import Kernel
from ....streams.sample import Times

Integers = NDArray[np.int64]


@dataclass(slots=True, eq=False)
class Waiting:
    """A heap of (due, places of the rows in the table), the least due first.

    Cost: O(n log w) to add or take a match of n elements, w of them waiting. Memory: 8 (n + 1)
    bytes a match, at most twice that.
    """

    count: int
    """The elements of a match."""
    _heap: Integers = field(init=False)
    _used: int = 0

    def __post_init__(self) -> None:
        self._heap = np.zeros((16, self.count + 1), np.int64)

    def __len__(self) -> int:
        return self._used

    @property
    def next_due(self) -> int | None:
        """The least due, or None."""
        return int(self._heap[0, 0]) if self._used else None

    @property
    def rows(self) -> Integers:
        """The places of all rows, shape ``(w, n)``: a view."""
        return self._heap[: self._used, 1:]

    @property
    def dues(self) -> Times:
        """From when on each can be decided, shape ``(w,)``: a view."""
        return self._heap[: self._used, 0]

    def add(self, rows: Integers, due: Times) -> None:
        """Let matches wait; shapes ``(k, n)`` and ``(k,)``."""
        needed = self._used + len(due)
        if needed > len(self._heap):
            self._resize(needed)
        new = np.concatenate([due[:, None], rows], axis=1)
        _push.run(self._heap, self._used, new, size=len(new))
        self._used = needed

    def take(self, watermark: int) -> tuple[Integers, Times]:
        """Remove the matches that are due by ``watermark``, in order of due, then of rows."""
        if not self._used or int(self._heap[0, 0]) > watermark:
            return self._heap[:0, 1:], self._heap[:0, 0]
        out = np.empty((self._used, self.count + 1), np.int64)
        count = int(_pop.run(self._heap, self._used, watermark, out, size=self._used))
        self._used -= count
        if 8 * self._used < len(self._heap) > 16:
            self._resize(self._used)
        found = out[:count]
        found = found[np.lexsort(found.T[::-1])]
        return found[:, 1:], found[:, 0]

    def take_where(self, is_due: NDArray[np.bool_]) -> tuple[Integers, Times]:
        """Remove the matches that are chosen among `rows`, in the order of `take`. Cost: O(w)."""
        found, rest = self._heap[: self._used][is_due], self._heap[: self._used][~is_due]
        if len(found):
            # In order of due is a heap.
            self._used = len(rest)
            self._resize(self._used)
            self._heap[: self._used] = rest[np.argsort(rest[:, 0], kind="stable")]
            found = found[np.lexsort(found.T[::-1])]
        return found[:, 1:], found[:, 0]

    def _resize(self, needed: int) -> None:
        heap = np.zeros((max(16, 2 * needed), self.count + 1), np.int64)
        heap[: self._used] = self._heap[: self._used]
        self._heap = heap


def _push_loop(heap: Any, used: int, new: Any) -> None:
    for i in range(new.shape[0]):
        place = used + i
        while place > 0 and heap[(place - 1) >> 1, 0] > new[i, 0]:
            parent = (place - 1) >> 1
            for x in range(new.shape[1]):
                heap[place, x] = heap[parent, x]
            place = parent
        for x in range(new.shape[1]):
            heap[place, x] = new[i, x]


def _pop_loop(heap: Any, used: int, watermark: int, out: Any) -> Any:
    count = 0
    while count < used and heap[0, 0] <= watermark:
        for x in range(out.shape[1]):
            out[count, x] = heap[0, x]
        count += 1
        last = used - count
        # The last one sinks from the root.
        place = 0
        while 2 * place + 1 < last:
            child = 2 * place + 1
            if child + 1 < last and heap[child + 1, 0] < heap[child, 0]:
                child += 1
            if heap[child, 0] >= heap[last, 0]:
                break
            for x in range(out.shape[1]):
                heap[place, x] = heap[child, x]
            place = child
        for x in range(out.shape[1]):
            heap[place, x] = heap[last, x]
    return count


def _push_signature() -> Any:
    from numba import types

    table = types.int64[:, ::1]
    return types.void(table, types.int64, table)


def _pop_signature() -> Any:
    from numba import types

    table = types.int64[:, ::1]
    return types.int64(table, types.int64, types.int64, table)


_push = Kernel(_push_loop, _push_signature)
_pop = Kernel(_pop_loop, _pop_signature)
