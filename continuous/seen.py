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
_Table = tuple[NDArray[np.int32], NDArray[np.uint8]]
Pairs = tuple[NDArray[np.int32], NDArray[np.int64]]
"""Subjects, and the bits of their objects."""


def _find(
    young: Any,
    young_tags: Any,
    old: Any,
    old_tags: Any,
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
    # A slot holds the low 31 bits of a place in the log, and a tag: seven bits of the hash, and 1;
    # 0 where it is free. Linear probing; where the tag fits, the keys in the log are compared. So
    # a pair that is new, as most are, reads one byte of each table, and these bytes fit a cache.
    young_mask, old_mask = np.uint64(young.shape[0] - 1), np.uint64(old.shape[0] - 1)
    log_mask = log_subjects.shape[0] - 1
    low = np.int64(_REFERENCE)
    mixes = np.empty(128, np.uint64)
    rows = subjects.shape[0]
    count = taken = idle = np.int64(0)
    one = np.uint64(1)
    for begin in range(0, rows, 128):
        stop = min(rows, begin + 128)
        # All tags of a block are loaded before one is waited for.
        for i in range(begin, stop):
            mixed = np.uint64(bits[i]) ^ (np.uint64(subjects[i]) * np.uint64(0x9E3779B97F4A7C15))
            mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0xFF51AFD7ED558CCD)
            mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xC4CEB9FE1A85EC53)
            mixed = mixed ^ (mixed >> np.uint64(32))
            mixes[np.uint64(i - begin)] = mixed
            idle += young_tags[mixed & young_mask] ^ old_tags[mixed & old_mask]
        for i in range(begin, stop):
            mixed = mixes[np.uint64(i - begin)]
            tag = np.uint8(mixed >> np.uint64(56)) | np.uint8(1)
            key, subject = bits[i], subjects[i]
            slot = mixed & young_mask
            place, known, missing = np.int64(0), False, True
            while young_tags[slot] != 0:
                if young_tags[slot] == tag:
                    place = head + ((np.int64(young[slot]) - head) & low)
                    at = place & log_mask
                    if place < tail and log_subjects[at] == subject and log_bits[at] == key:
                        known, missing = not again[at], False
                        break
                slot = (slot + one) & young_mask
            if missing:
                other = mixed & old_mask
                while old_tags[other] != 0:
                    if old_tags[other] == tag:
                        place = head + ((np.int64(old[other]) - head) & low)
                        at = place & log_mask
                        if place < tail and log_subjects[at] == subject and log_bits[at] == key:
                            known = not again[at]
                            break
                    other = (other + one) & old_mask
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
            young[slot] = tail & low
            young_tags[slot] = tag
            log_subjects[tail & log_mask] = subject
            log_bits[tail & log_mask] = key
            again[tail & log_mask] = False
            tail += 1
    return int(count), tail, int(taken), int(idle)


def _signature() -> Any:
    from numba import types

    table = (types.int32[::1], types.uint8[::1])
    keys = (read_only(types.int32), read_only(types.int64))
    log = (types.int32[::1], types.int64[::1], types.boolean[::1])
    tuple_of: Any = types.UniTuple
    return tuple_of(types.int64, 4)(
        *table, *table, *keys, types.boolean, *log, *[types.int64] * 3, types.int64[::1]
    )


_find_kernel = Kernel(_find, _signature)


class SeenPairs:
    """The distinct pairs of the window.

    The pairs of each pane stand in a log, in order; a pair that comes again is written anew and
    marked at its old place, so what leaves is read off the log's beginning. A hash table says where
    a pair stands. Nothing is deleted from it: there are two, the *young* one takes what comes, and
    when all that is in the *old* one has left the window, the young one becomes the old one.

    Law: `see` and `leave` say of each pair once that it has come into the window, and once that it
    has left. Cost: some tens of nanoseconds a row. Memory: 13 to 26 bytes a pair and pane in which
    it came, and 20 to 80 bytes a pair. Without compiled loops a dict does the same.
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
            size = max(_size(self._in_young), len(self._old[0]) // 2)
            spare = self._old if len(self._old[0]) == size else _empty(size)
            spare[1].fill(0)
            self._old, self._old_tail = self._young, self._tail
            self._young, self._in_young = spare, 0
        return gone

    def pairs(self) -> Pairs:
        """The pairs of the window, some more than once."""
        places = np.arange(self._head, self._tail) & (len(self._bits) - 1)
        return self._subjects[places], self._bits[places]

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
        if _size(self._in_young + len(pairs[0])) > len(self._young[0]):
            self._enlarge(_size(self._in_young + len(pairs[0])))
        fresh, self._tail, taken = self._run(pairs, True)
        self._in_young += taken
        return fresh

    def _run(self, pairs: Pairs, enter: bool) -> tuple[NDArray[np.int64], int, int]:
        found = np.empty(len(pairs[0]), np.int64)
        count, tail, taken, _ = _find_kernel(
            *self._young,
            *self._old,
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

    def _enlarge(self, size: int) -> None:
        """The young table, with so many slots."""
        places, tags = self._young
        places = self._head + ((places[tags != 0].astype(np.int64) - self._head) & _REFERENCE)
        places = places[places < self._tail]
        at = places & (len(self._bits) - 1)
        self._young = self._filled(_empty(size), self._subjects[at], self._bits[at], places)
        self._in_young = len(places)

    @staticmethod
    def _filled(
        table: _Table,
        subjects: NDArray[np.int32],
        bits: NDArray[np.int64],
        places: NDArray[np.int64],
    ) -> _Table:
        # Each is written down in a log of its own whose places are then put right.
        size = 1 << len(places).bit_length()
        log = np.zeros(size, np.int32), np.zeros(size, np.int64), np.zeros(size, np.bool_)
        found = np.empty(len(places), np.int64)
        _find_kernel(*table, *_empty(2), subjects, bits, True, *log, 0, 0, 0, found)
        slots = np.flatnonzero(table[1])
        table[0][slots] = places[table[0][slots]] & _REFERENCE
        return table

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


def _empty(slots: int) -> _Table:
    return np.zeros(slots, np.int32), np.zeros(slots, np.uint8)
