"""Which pairs of a subject and an object are in the window: each once, however often it came.

Called by `distinct_pairs` under set semantics. A pair belongs to the last pane in which it came;
when that pane ends, the pair leaves the window.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import JIT, Kernel
from ..columns.fold_kernels import NO_SKIP, read_only

_LEAST = 64
"""Chunks of the smallest index."""
_FULL = 8
"""So many pairs a chunk, and the index grows: a chunk has room for twelve."""
_PANES = 2**32 - 1
"""So many numbers of panes, from 1 on; then they begin anew."""
_BLOCK = 128
_EACH = np.uint64(0x0101010101010101)
_HIGHS = np.uint64(0x8080808080808080)
_FOUR = np.uint64(0x80808080)
_PLACES = np.uint64(0x0001020304050607)
Pairs = tuple[NDArray[np.int32], NDArray[np.int64]]
"""Subjects, and the bits of their objects."""

# A pair has an entry of two words: the object's bits; the subject (32 bits) and the number of the
# last pane in which the pair came. The second word is 0 where the entry is free. An index finds
# entries by the hash of their pairs. It consists of chunks, each a cache line: twelve tags (a byte
# of a hash, not 0; 0 where there is none), 32 bits that count the pairs which passed the chunk as
# it was full, and the numbers of twelve entries. So a line is read to see that a pair is new, and
# nearly never an entry; all tags are compared at once, as bytes of two words. After Facebook's F14.
# Nothing is taken out of an index: a number that it has kept too long leads to another pair.


def _hashed(subject: Any, bits: Any) -> Any:
    """32 bits of a pair."""
    mixed = np.uint64(bits) ^ (np.uint64(subject) * np.uint64(0x9E3779B97F4A7C15))
    mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0xFF51AFD7ED558CCD)
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xC4CEB9FE1A85EC53)
    return mixed >> np.uint64(32)


def _tag(hashed: Any) -> Any:
    """A byte of a hash, not 0, and the same in all bytes of the word."""
    byte = hashed & np.uint64(255)
    return (byte + np.uint64(byte == 0)) * _EACH


def _zeros(word: Any) -> Any:
    """The highest bit of each byte that is 0; above the lowest of them perhaps of others."""
    return (word - _EACH) & ~word & _HIGHS


def _byte(marks: Any) -> Any:
    """Which is the lowest byte of which the highest bit is set."""
    lowest = marks & (~marks + np.uint64(1))
    return ((lowest >> np.uint64(7)) * _PLACES) >> np.uint64(56)


def _sought(index: Any, numbers: Any, entries: Any, home: Any, tag: Any, key: Any, who: Any) -> Any:
    """The entry of a pair whose first chunk is ``home``; -1: there is none."""
    mask = np.uint64(index.shape[0] // 8 - 1)
    one, chunk = np.uint64(1), home
    while True:
        low = _zeros(index[chunk << np.uint64(3)] ^ tag)
        high = _zeros(index[chunk << np.uint64(3) | one] ^ tag) & _FOUR
        while low | high != 0:
            if low != 0:
                at = _byte(low)
                low = low & (low - one)
            else:
                at = _byte(high) + np.uint64(8)
                high = high & (high - one)
            entry = np.uint64(numbers[(chunk << np.uint64(4)) + np.uint64(4) + at])
            first, known = entry << one, entries[entry << one | one]
            if entries[first] == key and known >> 32 == who and known != 0:
                return np.int64(entry)
        if index[chunk << np.uint64(3) | one] >> np.uint64(32) == 0:
            return np.int64(-1)
        chunk = (chunk + one) & mask


def _place(index: Any, numbers: Any, home: Any, tag: Any, entry: Any) -> None:
    """Put an entry into the first chunk from ``home`` on that has room."""
    mask = np.uint64(index.shape[0] // 8 - 1)
    one, chunk = np.uint64(1), home
    while True:
        first = chunk << np.uint64(3)
        low, high = _zeros(index[first]), _zeros(index[first | one]) & _FOUR
        if low | high != 0:
            upper = np.uint64(low == 0)
            at = _byte(high if low == 0 else low)
            index[first | upper] |= (tag & np.uint64(255)) << (at << np.uint64(3))
            numbers[(chunk << np.uint64(4)) + np.uint64(4) + at + (upper << np.uint64(3))] = entry
            return
        index[first | one] += np.uint64(2**32)
        chunk = (chunk + one) & mask


def _enter(
    young: Any,
    young_numbers: Any,
    young_shift: int,
    old: Any,
    old_numbers: Any,
    old_shift: int,
    entries: Any,
    free: Any,
    left: int,
    placed: int,
    subjects: Any,
    bits: Any,
    skip: Any,
    start: int,
    pane: int,
    log: Any,
    logged: int,
    found: Any,
    count: int,
) -> tuple[int, int, int, int, int, int]:
    """Let each pair that is not in ``skip`` come in ``pane``.

    ``free`` are free entries, ``left`` of them; ``placed`` is how many have been put into the young
    index. ``log`` takes the entry of each pair that comes in this pane for the first time,
    ``found`` the rows whose pair is new to the window. Stops where too few entries are free or the
    index is full. Returned: the row to go on with, ``left``, ``placed``, the lengths of ``log`` and
    ``found``, and a number without meaning.
    """
    one, three, last = np.uint64(1), np.uint64(3), np.int64(2**32 - 1)
    young_by, old_by = np.uint64(young_shift), np.uint64(old_shift)
    most = young.shape[0] // 8 * _FULL - _BLOCK
    masked = skip.shape[0] > 0
    chosen, hashes = np.empty(_BLOCK, np.uint64), np.empty(_BLOCK, np.uint64)
    rows = subjects.shape[0]
    idle = np.uint64(0)
    for begin in range(start, rows, _BLOCK):
        if left < _BLOCK or placed > most:
            return begin, left, placed, logged, count, int(idle & one)
        some = np.uint64(0)
        for i in range(np.uint64(begin), np.uint64(min(rows, begin + _BLOCK))):
            chosen[some] = i
            some += np.uint64(not (masked and skip[i]))
        # The lines of a block are all asked for before one is waited for.
        for j in range(some):
            i = chosen[j]
            hashes[j] = _hashed(subjects[i], bits[i])
            idle ^= young[hashes[j] >> young_by << three] ^ old[hashes[j] >> old_by << three]
        for j in range(some):
            i = chosen[j]
            tag, home = _tag(hashes[j]), hashes[j] >> young_by
            key, who = bits[i], np.int64(subjects[i])
            entry = _sought(young, young_numbers, entries, home, tag, key, who)
            if entry < 0:
                entry = _sought(old, old_numbers, entries, hashes[j] >> old_by, tag, key, who)
                if entry < 0:
                    left -= 1
                    entry = np.int64(free[np.uint64(left)])
                    entries[np.uint64(entry) << one] = key
                    found[count] = i
                    count += 1
                _place(young, young_numbers, home, tag, np.uint32(entry))
                placed += 1
            elif entries[np.uint64(entry) << one | one] & last == pane:
                continue
            entries[np.uint64(entry) << one | one] = who << 32 | pane
            log[logged] = entry
            logged += 1
    return rows, left, placed, logged, count, int(idle & one)


def _leave(
    entries: Any, free: Any, left: int, log: Any, pane: int, subjects: Any, bits: Any
) -> int:
    """Free the entries of ``log`` whose last pane is ``pane``, into ``subjects`` and ``bits``: how
    many."""
    one, last, count = np.uint64(1), np.int64(2**32 - 1), 0
    for i in range(np.uint64(0), np.uint64(log.shape[0])):
        first = np.uint64(log[i]) << one
        known = entries[first | one]
        if known & last == pane:
            subjects[count], bits[count] = known >> 32, entries[first]
            entries[first | one] = 0
            free[left + count] = log[i]
            count += 1
    return count


def _hold(
    index: Any, numbers: Any, shift: int, entries: Any, subjects: Any, bits: Any, answer: Any
) -> None:
    """Mark the pairs that the index finds."""
    for i in range(np.uint64(0), np.uint64(subjects.shape[0])):
        hashed, who = _hashed(subjects[i], bits[i]), np.int64(subjects[i])
        home, tag = hashed >> np.uint64(shift), _tag(hashed)
        answer[i] |= _sought(index, numbers, entries, home, tag, bits[i], who) >= 0


def _fill(index: Any, numbers: Any, shift: int, entries: Any) -> None:
    """Put all entries that are taken into an empty index."""
    for i in range(np.uint64(0), np.uint64(entries.shape[0] // 2)):
        first = i << np.uint64(1)
        known = entries[first | np.uint64(1)]
        if known != 0:
            hashed = _hashed(known >> 32, entries[first])
            _place(index, numbers, hashed >> np.uint64(shift), _tag(hashed), np.uint32(i))


def _signature(name: str) -> Callable[[], Any]:
    def make() -> Any:
        from numba import types
        from numba.extending import register_jitable

        for function in (_hashed, _tag, _zeros, _byte, _sought, _place):
            register_jitable(function)
        number, ids, entries = types.int64, types.uint32[::1], types.int64[::1]
        index = (types.uint64[::1], ids, number)
        if name == "fill":
            return types.void(*index, entries)
        if name == "leave":
            gone = (types.int32[::1], types.int64[::1])
            return number(entries, ids, number, ids, number, *gone)
        keys = (read_only(types.int32), read_only(types.int64))
        if name == "hold":
            return types.void(*index, entries, *keys, types.boolean[::1])
        rows = (*keys, read_only(types.boolean), number)
        result = (number, ids, number, types.int64[::1], number)
        tuple_of: Any = types.UniTuple
        return tuple_of(number, 6)(*index, *index, entries, ids, number, number, *rows, *result)

    return make


_enter_kernel = Kernel(_enter, _signature("enter"))
_leave_kernel = Kernel(_leave, _signature("leave"))
_hold_kernel = Kernel(_hold, _signature("hold"))
_fill_kernel = Kernel(_fill, _signature("fill"))


class SeenPairs:
    """The distinct pairs of the window.

    Each has an entry, which says in which pane it came last. Each pane has a log of the entries of
    what came in it: when it ends, these are looked at, and those of pairs that have not come again
    are freed. There are two indexes: the *young* one takes what comes, and when all has left the
    window that was there before it, it becomes the *old* one.

    Law: `see` and `leave` say of each pair once that it has come into the window, and once that it
    has left. Cost: some tens of nanoseconds a row that comes, a few when its pane ends; what is
    full is made anew, twice as large, at once. Memory: 36 to 72 bytes a pair, up to eight times
    that after there have been more, and 4 a pair and pane. Without compiled loops a dict does the
    same.
    """

    def __init__(self) -> None:
        self._entries: NDArray[np.int64] = np.zeros(0, np.int64)
        self._free: NDArray[np.uint32] = np.zeros(0, np.uint32)
        self._left = 0
        self._pane = 0
        self._end: int | None = None
        self._logs: deque[tuple[int, int, NDArray[np.uint32]]] = deque()
        """The end of a pane, its number and entries: an element for each call of `see`."""
        self._known: dict[tuple[int, int], int] = {}
        self._came: deque[tuple[int, int, list[tuple[int, int]]]] = deque()
        self._placed = 0
        self._until: int | None = None
        """When the panes up to this end have left, the old index finds nothing more."""
        self._young, self._old = _index(1), _index(1)
        if JIT:
            self._rebuild(_LEAST)

    def see(
        self, end: int, pairs: Pairs, skip: NDArray[np.bool_] | None = None
    ) -> NDArray[np.int64]:
        """Rows of the pane that ends at ``end``, but those in ``skip``; the answer: those whose
        pair is new to the window.

        Calls go on in order of ``end``, which may stay the same.
        """
        if end != self._end:
            self._end, self._pane = end, self._pane % _PANES + 1
        if not JIT:
            return self._seen_in_python(end, pairs, skip)
        rows = len(pairs[0])
        log, found = np.empty(rows, np.uint32), np.empty(rows, np.int64)
        mask = NO_SKIP if skip is None else skip
        row = logged = count = 0
        while True:
            state = *self._young, *self._old, self._entries, self._free
            row, self._left, self._placed, logged, count, _ = _enter_kernel(
                *state,
                self._left,
                self._placed,
                *pairs,
                mask,
                row,
                self._pane,
                log,
                logged,
                found,
                count,
            )
            if row == rows:
                break
            crowded = 2 * self._left < len(self._free)
            self._rebuild(self._chunks * (2 if crowded else 1), log[:logged])
        if logged:
            self._logs.append((end, self._pane, log[:logged].copy()))
        return found[:count]

    def leave(self, until: int) -> Pairs | None:
        """Forget the panes that end at or before ``until``: the pairs that leave with them."""
        if not JIT:
            return self._left_in_python(until)
        parts = []
        while self._logs and self._logs[0][0] <= until:
            _, pane, log = self._logs.popleft()
            subjects, bits = np.empty(len(log), np.int32), np.empty(len(log), np.int64)
            count = _leave_kernel(self._entries, self._free, self._left, log, pane, subjects, bits)
            self._left += count
            parts.append((subjects[:count], bits[:count]))
        if parts and (self._until is None or until >= self._until):
            self._turn()
        if len(parts) < 2:
            return parts[0] if parts else None
        subjects, bits = (np.concatenate(column) for column in zip(*parts, strict=True))
        return subjects, bits

    def pairs(self) -> Pairs:
        """The pairs of the window, in any order."""
        if not JIT:
            subjects, bits = zip(*self._known, strict=True) if self._known else ((), ())
            return np.array(subjects, np.int32), np.array(bits, np.int64)
        entries = self._entries.reshape(-1, 2)
        entries = entries[entries[:, 1] != 0]
        return (entries[:, 1] >> 32).astype(np.int32), entries[:, 0]

    def holds(self, pairs: Pairs) -> NDArray[np.bool_]:
        """Which of the pairs are in the window."""
        subjects, bits = pairs
        if not JIT:
            listed = zip(subjects.tolist(), bits.tolist(), strict=True)
            return np.array([pair in self._known for pair in listed], np.bool_)
        answer = np.zeros(len(subjects), np.bool_)
        for index in (self._young, self._old):
            _hold_kernel(*index, self._entries, subjects, bits, answer)
        return answer

    @property
    def _chunks(self) -> int:
        return len(self._young[0]) // 8

    def _turn(self) -> None:
        """All pairs of the window are in the young index: it becomes the old one."""
        if self._chunks > _LEAST and 8 * self._left > 7 * len(self._free):
            # Half as large and no less: after a gap the stream may go on as before.
            self._rebuild(self._chunks // 2)
        spare = self._old if len(self._old[0]) == len(self._young[0]) else _index(self._chunks)
        spare[0].fill(0)
        self._old, self._young, self._placed = self._young, spare, 0
        self._until = self._end

    def _rebuild(self, chunks: int, *logs: NDArray[np.uint32]) -> None:
        """All pairs in a young index of so many chunks. Their entries get other numbers, in
        ``logs`` as well as in those of all panes."""
        old, size = self._entries.reshape(-1, 2), chunks * _FULL
        taken = np.flatnonzero(old[:, 1])
        number = np.zeros(len(old), np.uint32)
        number[taken] = np.arange(len(taken), dtype=np.uint32)
        for log in (*logs, *(log for _, _, log in self._logs)):
            log[:] = number[log]
        entries = np.zeros((size, 2), np.int64)
        entries[: len(taken)] = old[taken]
        self._entries = entries.reshape(-1)
        self._free = np.arange(size, 0, -1, dtype=np.uint32) - np.uint32(1)
        self._placed, self._left = len(taken), size - len(taken)
        self._young, self._old = _index(chunks), _index(1)
        _fill_kernel(*self._young, self._entries)

    def _seen_in_python(
        self, end: int, pairs: Pairs, skip: NDArray[np.bool_] | None
    ) -> NDArray[np.int64]:
        fresh, came = [], []
        for row, pair in enumerate(zip(pairs[0].tolist(), pairs[1].tolist(), strict=True)):
            if skip is not None and skip[row]:
                continue
            last = self._known.get(pair)
            if last is None:
                fresh.append(row)
            if last != self._pane:
                self._known[pair] = self._pane
                came.append(pair)
        self._came.append((end, self._pane, came))
        return np.array(fresh, np.int64)

    def _left_in_python(self, until: int) -> Pairs | None:
        gone, left = [], False
        while self._came and self._came[0][0] <= until:
            _, pane, came = self._came.popleft()
            left = True
            for pair in came:
                if self._known.get(pair) == pane:
                    del self._known[pair]
                    gone.append(pair)
        if not left:
            return None
        subjects, bits = zip(*gone, strict=True) if gone else ((), ())
        return np.array(subjects, np.int32), np.array(bits, np.int64)


def _index(chunks: int) -> tuple[NDArray[np.uint64], NDArray[np.uint32], int]:
    """An empty index: as words, as numbers of entries, and how far a hash is shifted to be a chunk.

    It begins on the bound of a cache line.
    """
    words = np.zeros(8 * chunks + 7, np.uint64)
    first = -words.ctypes.data % 64 // 8
    index = words[first : first + 8 * chunks]
    return index, index.view(np.uint32), 33 - chunks.bit_length()
