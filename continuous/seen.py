"""Which pairs of a subject and an object are in the window: each once, however often it came.

Called by `incremental` under set semantics. A pair belongs to the last pane in which it came; when
that pane ends, the pair leaves the window.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..streams.compiled import JIT, Kernel
from .kernels import read_only

_LEAST = 1024
_REFERENCE = 2**31 - 1
Pairs = tuple[NDArray[np.int32], NDArray[np.int64]]
"""Subjects, and the bits of their objects."""


def _find(
    young: Any,
    old: Any,
    subjects: Any,
    bits: Any,
    enter: bool,
    log_subjects: Any,
    log_bits: Any,
    again: Any,
    head: int,
    pane: int,
    tail: int,
    found: Any,
) -> tuple[int, int, int, int]:
    """Look for each pair; if ``enter``, write those that are new to the pane down in the log.

    ``found``: the rows whose pair is new to the window, or without ``enter``, those that are in it.
    Returned: how many, the new tail of the log, the slots newly taken in ``young``, and a number
    without meaning. ``pane`` is where the pane begins in the log, ``again`` marks what came again.
    """
    # A slot is (bits, subject * 2^32 + place in the log), (0, -1) where free. Linear probing; keys
    # are compared. The low 31 bits of a place tell whether it is in the log still.
    young_mask, old_mask = np.uint64(young.shape[0] - 1), np.uint64(old.shape[0] - 1)
    log_mask = log_subjects.shape[0] - 1
    low = np.int64(_REFERENCE)
    mixes = np.empty(128, np.uint64)
    rows = subjects.shape[0]
    count = taken = idle = np.int64(0)
    one, zero = np.uint64(1), np.uint64(0)
    for begin in range(0, rows, 128):
        stop = min(rows, begin + 128)
        # All slots of a block are loaded before one is waited for: a cache miss takes 100 ns.
        for i in range(begin, stop):
            mixed = np.uint64(bits[i]) ^ (np.uint64(subjects[i]) * np.uint64(0x9E3779B97F4A7C15))
            mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0xFF51AFD7ED558CCD)
            mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xC4CEB9FE1A85EC53)
            mixed = mixed ^ (mixed >> np.uint64(32))
            mixes[np.uint64(i - begin)] = mixed
            idle += young[mixed & young_mask, one] ^ old[mixed & old_mask, one]
        for i in range(begin, stop):
            mixed = mixes[np.uint64(i - begin)]
            key, subject = bits[i], np.int64(subjects[i])
            slot = mixed & young_mask
            word = young[slot, one]
            missing = 0
            while word >= 0 and not (word >> np.int64(32) == subject and young[slot, zero] == key):
                slot = (slot + one) & young_mask
                word = young[slot, one]
            place = np.int64(-1)
            if word >= 0:
                place = head + (((word & low) - head) & low)
            else:
                missing = 1
                other = mixed & old_mask
                word = old[other, one]
                while word >= 0 and not (
                    word >> np.int64(32) == subject and old[other, zero] == key
                ):
                    other = (other + one) & old_mask
                    word = old[other, one]
                if word >= 0:
                    place = head + (((word & low) - head) & low)
            known = place >= 0 and place < tail and not again[place & log_mask]
            if not enter:
                if known:
                    found[count] = i
                    count += 1
                continue
            if known:
                if place >= pane:
                    continue
                again[place & log_mask] = True
            else:
                found[count] = i
                count += 1
            taken += missing
            young[slot, zero] = key
            young[slot, one] = (subject << np.int64(32)) | (tail & low)
            log_subjects[tail & log_mask] = subject
            log_bits[tail & log_mask] = key
            again[tail & log_mask] = False
            tail += 1
    return int(count), tail, int(taken), int(idle)


def _signature() -> Any:
    from numba import types

    table = types.Array(types.int64, 2, "C")
    keys = (read_only(types.int32), read_only(types.int64))
    log = (types.int32[::1], types.int64[::1], types.boolean[::1])
    tuple_of: Any = types.UniTuple
    return tuple_of(types.int64, 4)(
        table, table, *keys, types.boolean, *log, *[types.int64] * 3, types.int64[::1]
    )


_find_kernel = Kernel(_find, _signature)


class SeenPairs:
    """The distinct pairs of the window.

    The pairs of each pane stand in a log, in order; a pair that comes again is written anew and
    marked at its old place, so what leaves is read off the log's beginning. A hash table says where
    a pair stands. Nothing is deleted from it: there are two, the *young* one takes what comes, and
    when all that is in the *old* one has left the window, the young one becomes the old one.

    Law: `see` and `leave` say of each pair once that it has come into the window, and once that it
    has left. Cost: two cache misses a row. Memory: 13 to 26 bytes a pair and pane in which it
    came, and 64 to 256 bytes a pair. Without compiled loops a dict does the same.
    """

    def __init__(self) -> None:
        self._young, self._old = _empty(_LEAST), _empty(_LEAST)
        self._in_young = self._old_tail = 0
        self._subjects: NDArray[np.int32] = np.zeros(_LEAST, np.int32)
        self._bits: NDArray[np.int64] = np.zeros(_LEAST, np.int64)
        self._again: NDArray[np.bool_] = np.zeros(_LEAST, np.bool_)
        self._head = self._tail = self._pane = 0
        self._ends: deque[tuple[int, int]] = deque()
        self._known: dict[tuple[int, int], int] = {}

    def see(self, end: int, pairs: Pairs) -> NDArray[np.int64]:
        """Rows of the pane that ends at ``end``; the answer: those whose pair is new to the window.

        Calls go on in order of ``end``, which may stay the same.
        """
        if not self._ends or self._ends[-1][0] != end:
            self._pane = self._tail
            self._ends.append((end, self._tail))
        rows = len(pairs[0])
        self._reserve(rows)
        fresh = self._entered(pairs) if JIT else self._entered_in_python(pairs)
        self._ends[-1] = (end, self._tail)
        return fresh

    def leave(self, until: int) -> Pairs | None:
        """Forget the panes that end at or before ``until``: the pairs that leave with them."""
        head = self._head
        while self._ends and self._ends[0][0] <= until:
            self._head = self._ends.popleft()[1]
        if head == self._head:
            return None
        places = np.arange(head, self._head) & (len(self._bits) - 1)
        places = places[~self._again[places]]
        gone = self._subjects[places], self._bits[places]
        if not JIT:
            for pair in zip(gone[0].tolist(), gone[1].tolist(), strict=True):
                del self._known[pair]
        elif self._head >= self._old_tail:
            # Half as large at least: after a gap the stream may go on as before.
            size = max(_size(self._in_young), len(self._old) // 2)
            spare = self._old if len(self._old) == size else _empty(size)
            spare[:, 1] = -1
            self._old, self._old_tail = self._young, self._tail
            self._young, self._in_young = spare, 0
        return gone

    def holds(self, pairs: Pairs) -> NDArray[np.bool_]:
        """Which of the pairs are in the window."""
        subjects, bits = pairs
        if not JIT:
            listed = zip(subjects.tolist(), bits.tolist(), strict=True)
            return np.array([pair in self._known for pair in listed], np.bool_)
        answer = np.zeros(len(subjects), np.bool_)
        answer[self._run(pairs, False)[0]] = True
        return answer

    def _entered(self, pairs: Pairs) -> NDArray[np.int64]:
        if _size(self._in_young + len(pairs[0])) > len(self._young):
            slots = self._young[self._young[:, 1] >= 0]
            self._young = _empty(_size(self._in_young + len(pairs[0])))
            _place(self._young, slots)
        fresh, self._tail, taken = self._run(pairs, True)
        self._in_young += taken
        return fresh

    def _run(self, pairs: Pairs, enter: bool) -> tuple[NDArray[np.int64], int, int]:
        found = np.empty(len(pairs[0]), np.int64)
        count, tail, taken, _ = _find_kernel(
            self._young,
            self._old,
            *pairs,
            enter,
            self._subjects,
            self._bits,
            self._again,
            self._head,
            self._pane,
            self._tail,
            found,
        )
        return found[:count], tail, taken

    def _entered_in_python(self, pairs: Pairs) -> NDArray[np.int64]:
        fresh, mask = [], len(self._bits) - 1
        for row, pair in enumerate(zip(pairs[0].tolist(), pairs[1].tolist(), strict=True)):
            place = self._known.get(pair)
            if place is None:
                fresh.append(row)
            elif place >= self._pane:
                continue
            else:
                self._again[place & mask] = True
            self._known[pair] = self._tail
            self._subjects[self._tail & mask], self._bits[self._tail & mask] = pair
            self._again[self._tail & mask] = False
            self._tail += 1
        return np.array(fresh, np.int64)

    def _reserve(self, rows: int) -> None:
        """Room for so many more in the log; less where it is mostly empty."""
        wanted = self._tail - self._head + rows
        if len(self._bits) >= wanted and (
            len(self._bits) <= _LEAST or len(self._bits) < 8 * wanted
        ):
            return
        places = np.arange(self._head, self._tail)
        size = max(_LEAST, 1 << (wanted - 1).bit_length())
        before, now = places & (len(self._bits) - 1), places & (size - 1)
        for name in ("_subjects", "_bits", "_again"):
            column = getattr(self, name)
            wider = np.zeros(size, column.dtype)
            wider[now] = column[before]
            setattr(self, name, wider)


def _size(pairs: int) -> int:
    """Slots for so many pairs: at most half of them full."""
    return max(_LEAST, 1 << (2 * pairs).bit_length())


def _empty(slots: int) -> NDArray[np.int64]:
    table = np.zeros((slots, 2), np.int64)
    table[:, 1] = -1
    return table


def _place(table: NDArray[np.int64], slots: NDArray[np.int64]) -> None:
    """Put the slots of another table in."""
    # Each is written down in a log of its own whose places are then put right.
    count = len(slots)
    size = max(_LEAST, 1 << count.bit_length())
    subjects, bits = (slots[:, 1] >> 32).astype(np.int32), slots[:, 0]
    log = np.zeros(size, np.int32), np.zeros(size, np.int64), np.zeros(size, np.bool_)
    found = np.empty(count, np.int64)
    _find_kernel(table, _empty(2), subjects, bits, True, *log, 0, 0, 0, found)
    taken = table[:, 1] >= 0
    table[taken, 1] = slots[table[taken, 1] & _REFERENCE, 1]
