"""An index of the (subject, object) pairs in the window: each once, however often it came.

`distinct_pairs` uses it under set semantics. A pair belongs to the last pane in which it came; when
that pane is evicted, the pair leaves the window.
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
"""The number of chunks in the smallest index."""
_FULL = 8
"""The average number of pairs per chunk at which the index grows; a chunk has room for twelve."""
_PANES = 2**32 - 1
"""Panes have numbers from 1 to this; then the numbers start again."""
_BLOCK = 128
_EACH = np.uint64(0x0101010101010101)
_HIGHS = np.uint64(0x8080808080808080)
_FOUR = np.uint64(0x80808080)
_PLACES = np.uint64(0x0001020304050607)
Pairs = tuple[NDArray[np.int32], NDArray[np.int64]]
"""Subjects, and the bits of their objects."""

# A pair has an entry of two words: the object's bits; the subject (32 bits) and the number of the
# last pane in which the pair came. The second word is 0 if the entry is free. An index finds
# entries by the hash of their pairs. It consists of chunks, each a cache line: twelve tags (a byte
# of a hash, not 0; 0 if there is none), a 32-bit count of the pairs that overflowed the chunk, and
# the numbers of twelve entries. So a lookup of a new pair reads one line and almost never an entry;
# it compares all tags at once, as bytes of two words. The design follows Facebook's F14. Numbers
# are never removed from an index: a stale number leads to the entry of another pair, or a free one,
# which the lookup skips.


def _hashed(subject: Any, bits: Any) -> Any:
    """Return a 32-bit hash of a pair."""
    mixed = np.uint64(bits) ^ (np.uint64(subject) * np.uint64(0x9E3779B97F4A7C15))
    mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0xFF51AFD7ED558CCD)
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xC4CEB9FE1A85EC53)
    return mixed >> np.uint64(32)


def _tag(hashed: Any) -> Any:
    """Return a byte of a hash, not 0, repeated in all bytes of the word."""
    byte = hashed & np.uint64(255)
    return (byte + np.uint64(byte == 0)) * _EACH


def _zeros(word: Any) -> Any:
    """Set the highest bit of each byte that is 0. Only the lowest mark is reliable: the subtraction
    borrows from the bytes above it."""
    return (word - _EACH) & ~word & _HIGHS


def _byte(marks: Any) -> Any:
    """Return the number of the lowest byte whose highest bit is set."""
    lowest = marks & (~marks + np.uint64(1))
    return ((lowest >> np.uint64(7)) * _PLACES) >> np.uint64(56)


def _find(index: Any, numbers: Any, entries: Any, home: Any, tag: Any, key: Any, who: Any) -> Any:
    """Return the entry of a pair whose first chunk is ``home``, or -1."""
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
            first, last_seen = entry << one, entries[entry << one | one]
            # A free entry is 0 and would look like subject 0, so its last word is tested, too.
            if entries[first] == key and last_seen >> 32 == who and last_seen != 0:
                return np.int64(entry)
        # No pair has overflowed this chunk, so no later chunk has a pair of it.
        if index[chunk << np.uint64(3) | one] >> np.uint64(32) == 0:
            return np.int64(-1)
        chunk = (chunk + one) & mask


def _place(index: Any, numbers: Any, home: Any, tag: Any, entry: Any) -> None:
    """Put an entry into the first chunk with room, from ``home`` on."""
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
        # The count of overflows tells `_find` to search the next chunk.
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
    """Record each pair that is not in ``skip`` as come in ``pane``.

    ``free`` contains ``left`` free entries; ``placed`` counts the entries put into the young index.
    ``log`` receives the entry of each pair that comes in this pane for the first time, ``found``
    the rows whose pair is new to the window. Stops if too few entries are free or the index is
    full. Returns the row to continue with, ``left``, ``placed``, the lengths of ``log`` and
    ``found``, and a meaningless number. That number keeps the compiler from removing the reads that
    only load cache lines.
    """
    one, three, last = np.uint64(1), np.uint64(3), np.int64(2**32 - 1)
    young_by, old_by = np.uint64(young_shift), np.uint64(old_shift)
    most = young.shape[0] // 8 * _FULL - _BLOCK
    masked = skip.shape[0] > 0
    chosen, hashes = np.empty(_BLOCK, np.uint64), np.empty(_BLOCK, np.uint64)
    rows = subjects.shape[0]
    idle = np.uint64(0)
    for begin in range(start, rows, _BLOCK):
        # This is tested once a block: a block never needs more room than that.
        if left < _BLOCK or placed > most:
            return begin, left, placed, logged, count, int(idle & one)
        some = np.uint64(0)
        for i in range(np.uint64(begin), np.uint64(min(rows, begin + _BLOCK))):
            chosen[some] = i
            some += np.uint64(not (masked and skip[i]))
        # Read the cache lines of a whole block first: the processor loads them in parallel.
        for j in range(some):
            i = chosen[j]
            hashes[j] = _hashed(subjects[i], bits[i])
            idle ^= young[hashes[j] >> young_by << three] ^ old[hashes[j] >> old_by << three]
        for j in range(some):
            i = chosen[j]
            tag, home = _tag(hashes[j]), hashes[j] >> young_by
            key, who = bits[i], np.int64(subjects[i])
            entry = _find(young, young_numbers, entries, home, tag, key, who)
            if entry < 0:
                entry = _find(old, old_numbers, entries, hashes[j] >> old_by, tag, key, who)
                if entry < 0:
                    left -= 1
                    entry = np.int64(free[np.uint64(left)])
                    entries[np.uint64(entry) << one] = key
                    found[count] = i
                    count += 1
                # A pair that only the old index has is placed, too: that index is dropped first.
                _place(young, young_numbers, home, tag, np.uint32(entry))
                placed += 1
            # The log of a pane has each pair once.
            elif entries[np.uint64(entry) << one | one] & last == pane:
                continue
            entries[np.uint64(entry) << one | one] = who << 32 | pane
            log[logged] = entry
            logged += 1
    return rows, left, placed, logged, count, int(idle & one)


def _leave(
    entries: Any, free: Any, left: int, log: Any, pane: int, subjects: Any, bits: Any
) -> int:
    """Free the entries of ``log`` whose last pane is ``pane``. Write their pairs to ``subjects``
    and ``bits``; return their number."""
    one, last, count = np.uint64(1), np.int64(2**32 - 1), 0
    for i in range(np.uint64(0), np.uint64(log.shape[0])):
        first = np.uint64(log[i]) << one
        last_seen = entries[first | one]
        # A pair that came again belongs to a later pane, and leaves with that one.
        if last_seen & last == pane:
            subjects[count], bits[count] = last_seen >> 32, entries[first]
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
        answer[i] |= _find(index, numbers, entries, home, tag, bits[i], who) >= 0


def _fill(index: Any, numbers: Any, shift: int, entries: Any) -> None:
    """Put all used entries into an empty index."""
    for i in range(np.uint64(0), np.uint64(entries.shape[0] // 2)):
        first = i << np.uint64(1)
        last_seen = entries[first | np.uint64(1)]
        if last_seen != 0:
            hashed = _hashed(last_seen >> 32, entries[first])
            _place(index, numbers, hashed >> np.uint64(shift), _tag(hashed), np.uint32(i))


def _signature(name: str) -> Callable[[], Any]:
    def make() -> Any:
        from numba import types
        from numba.extending import register_jitable

        for function in (_hashed, _tag, _zeros, _byte, _find, _place):
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


class PairIndex:
    """The distinct pairs of the window.

    Each pair has an entry with the last pane in which it came. Each pane has a log of the entries
    of its pairs. When the pane is evicted, the entries of pairs that have not come again are freed.
    There are two indexes. The *young* one receives new pairs; when all panes older than it have
    been evicted, it becomes the *old* one. That removes stale numbers without deleting any.

    Law: `enter` returns each pair once when it enters the window, and `leave` once when it has
    left. Cost: some tens of nanoseconds per row, a few more when its pane is evicted; a full index
    is rebuilt twice as large, at once. Memory: 36 to 72 bytes per pair, up to eight times that
    after there have been more, and 4 per pair and pane. Without compiled loops a dict does the
    same.
    """

    def __init__(self) -> None:
        self._entries: NDArray[np.int64] = np.zeros(0, np.int64)
        self._free: NDArray[np.uint32] = np.zeros(0, np.uint32)
        self._left = 0
        self._pane = 0
        self._end: int | None = None
        self._logs: deque[tuple[int, int, NDArray[np.uint32]]] = deque()
        """The end of a pane, its number and entries: one element per call of `enter`."""
        self._pane_of: dict[tuple[int, int], int] = {}
        self._python_logs: deque[tuple[int, int, list[tuple[int, int]]]] = deque()
        self._placed = 0
        self._until: int | None = None
        """When the panes up to this end have been evicted, the old index finds nothing more."""
        self._young, self._old = _index(1), _index(1)
        if JIT:
            self._rebuild(_LEAST)

    def enter(
        self, end: int, pairs: Pairs, skip: NDArray[np.bool_] | None = None
    ) -> NDArray[np.int64]:
        """Add the rows of the pane that ends at ``end``, except those in ``skip``; return the rows
        whose pair is new to the window.

        Calls must have ascending ``end``, which may repeat.
        """
        if end != self._end:
            self._end, self._pane = end, self._pane % _PANES + 1
        if not JIT:
            return self._enter_in_python(end, pairs, skip)
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
            # Stale numbers may have filled an index with few pairs: its size suffices then.
            crowded = 2 * self._left < len(self._free)
            self._rebuild(self._chunks * (2 if crowded else 1), log[:logged])
        if logged:
            self._logs.append((end, self._pane, log[:logged].copy()))
        return found[:count]

    def leave(self, until: int) -> Pairs | None:
        """Evict the panes that end at or before ``until``; return the pairs that leave."""
        if not JIT:
            return self._leave_in_python(until)
        parts = []
        while self._logs and self._logs[0][0] <= until:
            _, pane, log = self._logs.popleft()
            subjects, bits = np.empty(len(log), np.int32), np.empty(len(log), np.int64)
            count = _leave_kernel(self._entries, self._free, self._left, log, pane, subjects, bits)
            self._left += count
            parts.append((subjects[:count], bits[:count]))
        if parts and (self._until is None or until >= self._until):
            self._age()
        if len(parts) < 2:
            return parts[0] if parts else None
        subjects, bits = (np.concatenate(column) for column in zip(*parts, strict=True))
        return subjects, bits

    def pairs(self) -> Pairs:
        """Return the pairs of the window, in any order."""
        if not JIT:
            subjects, bits = zip(*self._pane_of, strict=True) if self._pane_of else ((), ())
            return np.array(subjects, np.int32), np.array(bits, np.int64)
        entries = self._entries.reshape(-1, 2)
        entries = entries[entries[:, 1] != 0]
        return (entries[:, 1] >> 32).astype(np.int32), entries[:, 0]

    def last_panes(self) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
        """Return the pairs of the window, in any order, and the end of the last pane of each."""
        if not JIT:
            subjects, bits = self.pairs()
            numbers = np.array(list(self._pane_of.values()), np.int64)
            logs = [(end, pane) for end, pane, _ in self._python_logs]
        else:
            entries = self._entries.reshape(-1, 2)
            entries = entries[entries[:, 1] != 0]
            subjects, bits = (entries[:, 1] >> 32).astype(np.int32), entries[:, 0]
            numbers = entries[:, 1] & 0xFFFFFFFF
            logs = [(end, pane) for end, pane, _ in self._logs]
        ends, panes = (np.array([log[i] for log in logs], np.int64) for i in (0, 1))
        order = np.argsort(panes)
        if not len(numbers):
            return subjects, bits, numbers
        return subjects, bits, ends[order][np.searchsorted(panes[order], numbers)]

    def holds(self, pairs: Pairs) -> NDArray[np.bool_]:
        """Return which of the pairs are in the window."""
        subjects, bits = pairs
        if not JIT:
            listed = zip(subjects.tolist(), bits.tolist(), strict=True)
            return np.array([pair in self._pane_of for pair in listed], np.bool_)
        answer = np.zeros(len(subjects), np.bool_)
        for index in (self._young, self._old):
            _hold_kernel(*index, self._entries, subjects, bits, answer)
        return answer

    @property
    def _chunks(self) -> int:
        return len(self._young[0]) // 8

    def _age(self) -> None:
        """Make the young index the old one: it has all pairs of the window."""
        if self._chunks > _LEAST and 8 * self._left > 7 * len(self._free):
            # Only half as large: after a gap the stream may continue at its former rate.
            self._rebuild(self._chunks // 2)
        spare = self._old if len(self._old[0]) == len(self._young[0]) else _index(self._chunks)
        spare[0].fill(0)
        self._old, self._young, self._placed = self._young, spare, 0
        self._until = self._end

    def _rebuild(self, chunks: int, *logs: NDArray[np.uint32]) -> None:
        """Put all pairs into a young index with this number of chunks. Their entries get new
        numbers, also in ``logs`` and in the logs of all panes."""
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

    def _enter_in_python(
        self, end: int, pairs: Pairs, skip: NDArray[np.bool_] | None
    ) -> NDArray[np.int64]:
        fresh, log = [], []
        for row, pair in enumerate(zip(pairs[0].tolist(), pairs[1].tolist(), strict=True)):
            if skip is not None and skip[row]:
                continue
            last = self._pane_of.get(pair)
            if last is None:
                fresh.append(row)
            if last != self._pane:
                self._pane_of[pair] = self._pane
                log.append(pair)
        self._python_logs.append((end, self._pane, log))
        return np.array(fresh, np.int64)

    def _leave_in_python(self, until: int) -> Pairs | None:
        freed, evicted = [], False
        while self._python_logs and self._python_logs[0][0] <= until:
            _, pane, log = self._python_logs.popleft()
            evicted = True
            for pair in log:
                if self._pane_of.get(pair) == pane:
                    del self._pane_of[pair]
                    freed.append(pair)
        if not evicted:
            return None
        subjects, bits = zip(*freed, strict=True) if freed else ((), ())
        return np.array(subjects, np.int32), np.array(bits, np.int64)


def _index(chunks: int) -> tuple[NDArray[np.uint64], NDArray[np.uint32], int]:
    """Return an empty index: as words, as numbers of entries, and the right shift that turns a hash
    into a chunk.

    It is aligned to a cache line: otherwise a chunk would span two.
    """
    words = np.zeros(8 * chunks + 7, np.uint64)
    first = -words.ctypes.data % 64 // 8
    index = words[first : first + 8 * chunks]
    return index, index.view(np.uint32), 33 - chunks.bit_length()
