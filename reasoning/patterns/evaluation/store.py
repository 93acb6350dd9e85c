"""Rows that may still be part of a match, and for each buffer and key those to be searched.

A *table* has the rows as records (`conditions`). A buffer has the rows that suit one element, or
that one probe reads. Its rows of equal keys are a *vector*: (end, place in the table) in order of
end, then of arrival, in one pool for all vectors. Vectors are found by open addressing.

Nothing is removed one by one. Rows that can no longer be joined are dropped at the front of a
vector when the vector is full. When the table, the pool or the vectors are full, `Store.compact`
copies what is live to arrays of which a third is free.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....streams.jit import Kernel
from ....streams.time import TIME_MIN
from ....streams.time_arithmetic import earlier
from ..plans.plan import NO_VALUE
from .conditions import END
from .packing import KEEPS_LAST, KEY_COUNT, KEYS, OF, RETAINED, PackedRows

Integers = NDArray[np.int64]

# A vector: where its rows begin in the pool, the first one that is live, the one after the last,
# the number of places; its buffer, its keys.
BASE, FIRST, STOP, PLACES, BUFFER = range(5)
VECTOR_KEYS: Final = 5
# The state of the loops: how much of each array is used; the watermark; the time up to which
# matches have been decided, from which retention counts; whether rows are not stored for a limit,
# whether the loop stopped for want of room for matches; counters.
ROWS, VECTORS, POOL, OUT, WATERMARK, DECIDED, IS_FULL, IS_OUT_FULL = range(8)
LOOKED_AT, MADE, CUT_SHORT, LATE, UNSTORED, CROWDED = range(8, 14)
# Of one row: where its matches begin, whether it has more than the limit.
FIRST_OUT, IS_SHORT = 14, 15
MARKS: Final = 16
CANDIDATES_FULL: Final = -2
SMALLEST: Final = 64
"""Rows, places and vectors of a new store."""
# The times of the parts of a store (`Store.times`).
WATERMARKS, DECISIONS = range(2)


@dataclass(slots=True, eq=False)
class Store:
    """The arrays of a store, and their compaction.

    Law: a row that a match may still use is found until then, in order of end and arrival. Cost:
    O(1) hashing and O(log n) comparisons a look-up; compaction is O(live), once in half as many
    rows. Memory: 8 bytes a word of a live row and 16 bytes a candidate, both 1.5 to 2.3 times;
    while it compacts, twice that.

    ``part_word``: the word of a row that numbers its part, from 0. Each part has its own watermark
    and time of decision, and that word is among the keys of each buffer. 0: there are no parts.
    """

    plan: PackedRows
    capacity: int = SMALLEST
    most_rows: int = 1 << 62
    part_word: int = 0
    table: Integers = field(init=False)
    ends: Integers = field(init=False)
    """The pool: the ends of rows."""
    rows: Integers = field(init=False)
    """The pool: the places of these rows in the table."""
    vectors: Integers = field(init=False)
    heads: Integers = field(init=False)
    """By hash: the number of a vector plus 1, or 0."""
    marks: Integers = field(init=False)
    times: Integers = field(init=False)
    """The watermark and the time of decision of each part, shape ``(2, parts)``."""

    def __post_init__(self) -> None:
        self.table = np.zeros((self.capacity, self.plan.width), np.int64)
        self.ends = np.zeros(self.capacity, np.int64)
        self.rows = np.zeros(self.capacity, np.int64)
        self.vectors = np.zeros((self.capacity, self._vector_width), np.int64)
        self.heads = np.zeros(_heads(self.capacity), np.int64)
        self.marks = np.zeros(MARKS, np.int64)
        self.marks[[WATERMARK, DECIDED]] = TIME_MIN
        self.times = np.full((2, 1), TIME_MIN, np.int64)

    @property
    def _vector_width(self) -> int:
        return VECTOR_KEYS + int(self.plan.buffers.shape[1]) - KEYS

    @property
    def size(self) -> int:
        """The bytes of all arrays."""
        rows = self.table.nbytes + self.vectors.nbytes + self.heads.nbytes
        return int(rows + self.ends.nbytes + self.rows.nbytes)

    def state(self) -> tuple[Integers, ...]:
        """Copies of all arrays."""
        arrays = self.table, self.ends, self.rows, self.vectors, self.heads, self.marks
        return tuple(each.copy() for each in (*arrays, self.times))

    def restore(self, state: tuple[Integers, ...]) -> None:
        """Take the arrays of a state."""
        arrays = (each.copy() for each in state)
        self.table, self.ends, self.rows, self.vectors, self.heads, self.marks, self.times = arrays

    def dead(self) -> Integers:
        """The end before which rows are not joined any more: for each part and buffer, shape
        ``(parts, buffers)``."""
        decided = self.times[DECISIONS] if self.part_word else self.marks[DECIDED : DECIDED + 1]
        kept = self.plan.buffers[:, RETAINED].tolist()
        dead = np.empty((len(decided), len(kept)), np.int64)
        for buffer, each in enumerate(kept):
            dead[:, buffer] = earlier(decided, each)
        return dead

    def places(self, buffer: int, part: int = 0) -> list[int]:
        """The places in the table of the rows in a buffer that may still be joined; with parts,
        those of ``part``."""
        dead, found = int(self.dead()[part, buffer]), []
        for vector in self.vectors[: int(self.marks[VECTORS])]:
            if vector[BUFFER] == buffer:
                own = slice(vector[BASE] + vector[FIRST], vector[BASE] + vector[STOP])
                found += self.of_part(self.rows[own][self.ends[own] >= dead], part).tolist()
        return found

    def of_part(self, places: Integers, part: int) -> Integers:
        """The places in the table with rows of ``part``; all of them without parts."""
        if not self.part_word:
            return places
        own: Integers = places[self.table[places, self.part_word] == part]
        return own

    def compact(self, *roots: Integers) -> None:
        """Keep only what is live: rows in a buffer that may still be joined, and those at the
        places in ``roots``, which are renumbered. Then there is room in each array."""
        marks, buffers = self.marks, self.plan.buffers
        moved = np.zeros(int(marks[ROWS]), np.int64)
        sizes = np.zeros(2, np.int64)
        store = buffers, self.ends, self.rows, self.vectors, marks
        _mark.run(self.dead(), self.part_word, *store, moved, sizes, size=len(moved))
        for root in roots:
            moved[root] = 1
        live = int(np.count_nonzero(moved))
        vectors, pool = sizes.tolist()
        # Each buffer may get another vector with the next row.
        kept = self._roomy(vectors + len(buffers))
        table = np.empty((self._roomy(live), self.plan.width), np.int64)
        places = np.empty((2, self._roomy(pool + 2 * len(buffers))), np.int64)
        new = np.empty((kept, self._vector_width), np.int64)
        heads = np.zeros(_heads(kept), np.int64)
        _copy.run(self.table, *store, moved, table, *places, new, heads, size=len(moved))
        for root in roots:
            root[...] = moved[root]
        self.table, self.vectors, self.heads = table, new, heads
        self.ends, self.rows = places
        marks[IS_FULL] = live >= self.most_rows

    def _roomy(self, used: int) -> int:
        """A capacity of which a third is free."""
        return self.capacity + used + used // 2


def _heads(vectors: int) -> int:
    """A power of two that is at least twice this number."""
    return 1 << (2 * vectors - 1).bit_length()


# -- in the compiled loops -------------------------------------------------------------------


def hashed(buffer: int, keys: int, record: Any, first: int) -> Any:
    """A 31-bit hash of a buffer and the keys that begin at a place of a record."""
    mixed = buffer + 1
    for i in range(keys):
        mixed = mix(mixed, record[first + i])
    return mixed


def mix(mixed: Any, key: Any) -> Any:
    """Add a key to a hash of 31 bits. No product exceeds 63 bits."""
    folded = (key ^ (key >> 31)) & 0x7FFFFFFF
    return (((mixed ^ folded) * 2654435769) >> 17) & 0x7FFFFFFF


def vector_of(
    buffer: int, keys: int, wanted: Any, mixed: int, vectors: Any, heads: Any
) -> tuple[Any, Any]:
    """The place in ``heads`` and the number of the vector with these keys, or -1."""
    place = mixed & (heads.shape[0] - 1)
    while heads[place] != 0:
        v = heads[place] - 1
        if vectors[v, BUFFER] == buffer:
            is_same = True
            for i in range(keys):
                if vectors[v, VECTOR_KEYS + i] != wanted[i]:
                    is_same = False
                    break
            if is_same:
                return place, v
        place = (place + 1) & (heads.shape[0] - 1)
    return place, -1


def first_at_least(ends: Any, low: int, high: int, time: int) -> Any:
    """The first place in ``low .. high - 1`` with an end at ``time`` or after, or ``high``."""
    while high - low > 8:
        middle = (low + high) >> 1
        if ends[middle] < time:
            low = middle + 1
        else:
            high = middle
    while low < high and ends[low] < time:
        low += 1
    return low


def has_room(v: int, dead: int, most: int, vectors: Any, ends: Any, rows: Any, marks: Any) -> Any:
    """Make room for one more row in a vector, whose rows before ``dead`` may go, except the last of
    them. 1: there is; 0: the pool is full; -1: the vector has ``most`` live rows."""
    if vectors[v, STOP] < vectors[v, PLACES] and vectors[v, STOP] - vectors[v, FIRST] < most:
        return 1
    first, stop, base = vectors[v, FIRST], vectors[v, STOP], vectors[v, BASE]
    while first + 1 < stop and ends[base + first + 1] < dead:
        first += 1
    vectors[v, FIRST] = first
    live = stop - first
    if live >= most:
        return -1
    if stop < vectors[v, PLACES]:
        return 1
    to = base
    if vectors[v, PLACES] == 0 or live * 2 > vectors[v, PLACES]:
        places = max(2, 2 * live)
        if marks[POOL] + places > ends.shape[0]:
            return 0
        to = marks[POOL]
        marks[POOL] += places
        vectors[v, PLACES] = places
    for i in range(live):
        ends[to + i] = ends[base + first + i]
        rows[to + i] = rows[base + first + i]
    vectors[v, BASE], vectors[v, FIRST], vectors[v, STOP] = to, 0, live
    return 1


def insert(v: int, end: int, row: int, vectors: Any, ends: Any, rows: Any) -> None:
    """Put a row into a vector that has room, after those of the same end."""
    at = vectors[v, BASE] + vectors[v, STOP]
    least = vectors[v, BASE] + vectors[v, FIRST]
    while at > least and ends[at - 1] > end:
        ends[at], rows[at] = ends[at - 1], rows[at - 1]
        at -= 1
    ends[at], rows[at] = end, row
    vectors[v, STOP] += 1


def remove(v: int, row: int, vectors: Any, ends: Any, rows: Any) -> None:
    """Take a row out of a vector that has it."""
    stop = vectors[v, BASE] + vectors[v, STOP]
    at = stop - 1
    while rows[at] != row:
        at -= 1
    while at + 1 < stop:
        ends[at], rows[at] = ends[at + 1], rows[at + 1]
        at += 1
    vectors[v, STOP] -= 1


def put(
    row: int,
    mask: int,
    most: int,
    dead: Any,
    found: Any,
    keys: Any,
    buffers: Any,
    table: Any,
    ends: Any,
    rows: Any,
    vectors: Any,
    heads: Any,
    marks: Any,
) -> Any:
    """Put a row into the buffers of its elements and probes; ``found`` gets their vectors, or less
    than 0 where it is in none. Return the number of them, or -1 if an array is full: then the row
    is in no buffer."""
    for b in range(buffers.shape[0]):
        found[b] = -1
        count = buffers[b, KEY_COUNT]
        is_in = (mask >> buffers[b, OF]) & 1 == 1
        for i in range(count):
            keys[i] = table[row, buffers[b, KEYS + i]]
            is_in = is_in and keys[i] != NO_VALUE
        if not is_in:
            continue
        place, v = vector_of(b, count, keys, hashed(b, count, keys, 0), vectors, heads)
        if v < 0:
            if marks[VECTORS] == vectors.shape[0]:
                return -1
            v = marks[VECTORS]
            marks[VECTORS] += 1
            heads[place] = v + 1
            vectors[v, BASE], vectors[v, FIRST], vectors[v, STOP], vectors[v, PLACES] = 0, 0, 0, 0
            vectors[v, BUFFER] = b
            for i in range(count):
                vectors[v, VECTOR_KEYS + i] = keys[i]
        room = has_room(v, dead[b], most, vectors, ends, rows, marks)
        if room == 0:
            return -1
        found[b] = v if room > 0 else CANDIDATES_FULL
    stored = 0
    for b in range(buffers.shape[0]):
        if found[b] == CANDIDATES_FULL:
            marks[CROWDED] += 1
        elif found[b] >= 0:
            insert(found[b], table[row, END], row, vectors, ends, rows)
            stored += 1
    return stored


IN_LOOPS: Final = (mix, hashed, vector_of, first_at_least, has_room, insert, remove, put)
"""The functions that compiled loops call."""


def _mark_loop(
    dead: Any,
    part_word: int,
    buffers: Any,
    ends: Any,
    rows: Any,
    vectors: Any,
    marks: Any,
    is_live: Any,
    sizes: Any,
) -> None:
    """Drop what is dead at the front of each vector, and mark the rows that stay; ``sizes``: the
    vectors that are left, and the places that they need."""
    for v in range(marks[VECTORS]):
        first, stop, base = vectors[v, FIRST], vectors[v, STOP], vectors[v, BASE]
        buffer, part = vectors[v, BUFFER], 0
        for i in range(buffers[buffer, KEY_COUNT]):
            if part_word != 0 and buffers[buffer, KEYS + i] == part_word:
                part = vectors[v, VECTOR_KEYS + i]
        until = dead[part, buffer]
        # The state at the time of death is the last row before it.
        keeps = buffers[buffer, KEEPS_LAST]
        while first + keeps < stop and ends[base + first + keeps] < until:
            first += 1
        vectors[v, FIRST] = first
        for at in range(base + first, base + stop):
            is_live[rows[at]] = 1
        if first < stop:
            sizes[0] += 1
            sizes[1] += stop - first + (stop - first) // 2 + 1


def _copy_loop(
    table: Any,
    buffers: Any,
    ends: Any,
    rows: Any,
    vectors: Any,
    marks: Any,
    moved: Any,
    new_table: Any,
    new_ends: Any,
    new_rows: Any,
    new_vectors: Any,
    heads: Any,
) -> None:
    """Copy the rows that are marked in ``moved``, which gets their new places, and the vectors."""
    used = 0
    for row in range(marks[ROWS]):
        if moved[row]:
            for word in range(table.shape[1]):
                new_table[used, word] = table[row, word]
            moved[row] = used
            used += 1
    marks[ROWS] = used
    used, pool = 0, 0
    for v in range(marks[VECTORS]):
        first, stop, base = vectors[v, FIRST], vectors[v, STOP], vectors[v, BASE]
        size = stop - first
        if size == 0:
            continue
        for at in range(size):
            new_ends[pool + at] = ends[base + first + at]
            new_rows[pool + at] = moved[rows[base + first + at]]
        for word in range(vectors.shape[1]):
            new_vectors[used, word] = vectors[v, word]
        new_vectors[used, BASE], new_vectors[used, FIRST] = pool, 0
        new_vectors[used, STOP], new_vectors[used, PLACES] = size, size + size // 2 + 1
        pool += size + size // 2 + 1
        buffer = vectors[v, BUFFER]
        place = hashed(buffer, buffers[buffer, KEY_COUNT], vectors[v], VECTOR_KEYS)
        place &= heads.shape[0] - 1
        while heads[place] != 0:
            place = (place + 1) & (heads.shape[0] - 1)
        used += 1
        heads[place] = used
    marks[VECTORS], marks[POOL] = used, pool


def _types() -> tuple[Any, Any]:
    from numba import types

    return types.int64[::1], types.int64[:, ::1]


def _mark_signature() -> Any:
    from numba import types

    row, table = _types()
    return types.void(table, types.int64, table, row, row, table, row, row, row)


def _copy_signature() -> Any:
    from numba import types

    row, table = _types()
    return types.void(table, table, row, row, table, row, row, table, row, row, table, row)


_mark = Kernel(_mark_loop, _mark_signature, allocates=False, calls=IN_LOOPS)
_copy = Kernel(_copy_loop, _copy_signature, allocates=False, calls=IN_LOOPS)
