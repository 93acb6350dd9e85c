"""Runs: matches that have begun, in lists by their state and keys (SPEC §8).

A run of a plan of n elements is a record of integers: the place in the table of each element's
first row and last row, the last node of each Kleene element whose rows are kept, what it has added
up (`run_packing`), then the next run of its list, and its start. The *state* of its list is the
element that it bound last. Place 0 and node 0 stand for none: row 0 of the table has aggregates.

A *node* is a row and the node of the row taken before it. Runs that split share nodes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....streams.jit import Kernel
from ....streams.time_arithmetic import earlier
from ..evaluation.store import BUFFER, SMALLEST, VECTOR_KEYS, hashed, mix, vector_of
from .run_packing import WORDS, PackedRuns

Integers = NDArray[np.int64]

NEXT, BEGAN = -2, -1
"""The last words of a record."""
AFTER_ROWS: Final = 2
"""Words of a record beside those of elements and accumulators."""
# A list: its first and last run, the number of its runs; its state stands at `BUFFER`, its keys
# from `VECTOR_KEYS` on, so that `vector_of` finds it.
HEAD, TAIL, LENGTH = range(3)
# A node.
ROW, PARENT = range(2)
# Counts: records used, the first one that is free, the runs; lists and nodes used; how many runs
# the next row may add; runs not started for a limit; nodes that the next row may add.
USED, FREE, LIVE, LISTS, NODES, NEEDED, UNSTARTED, NODES_NEEDED = range(8)
COUNTS: Final = 8


def width_of(packed: PackedRuns) -> int:
    """The number of words of a record."""
    return 3 * len(packed.keys) + WORDS * len(packed.accumulators) + AFTER_ROWS


@dataclass(slots=True, eq=False)
class Runs:
    """The arrays of runs, and their compaction.

    Cost: O(1) hashing a look-up of a list; compaction is O(live). Memory: 8 bytes a word of a run
    and 16 a node, both 1.5 to 2.3 times; while it compacts, twice that.
    """

    packed: PackedRuns
    lasts: int
    """How long a run may last, in ns."""
    capacity: int = SMALLEST
    runs: Integers = field(init=False)
    lists: Integers = field(init=False)
    heads: Integers = field(init=False)
    """By hash: the number of a list plus 1, or 0."""
    nodes: Integers = field(init=False)
    counts: Integers = field(init=False)

    def __post_init__(self) -> None:
        elements = len(self.packed.keys)
        self.runs = np.zeros((self.capacity, width_of(self.packed)), np.int64)
        self.lists, self.heads = self._empty_lists(0, elements)
        self.nodes = np.zeros((self.capacity, 2), np.int64)
        self.counts = np.zeros(COUNTS, np.int64)
        self.counts[[FREE, NODES]] = -1, 1

    def _empty_lists(self, used: int, elements: int) -> tuple[Integers, Integers]:
        # The next row may need a list for each element.
        size = self.capacity + used + used // 2 + 2 * elements
        keys = int(self.packed.keys.shape[1])
        lists = np.zeros((size, VECTOR_KEYS + keys), np.int64)
        return lists, np.zeros(1 << (2 * size - 1).bit_length(), np.int64)

    @property
    def size(self) -> int:
        """The bytes of all arrays."""
        return int(self.runs.nbytes + self.lists.nbytes + self.heads.nbytes + self.nodes.nbytes)

    def state(self) -> tuple[Integers, ...]:
        """Copies of all arrays."""
        arrays = self.runs, self.lists, self.heads, self.nodes, self.counts
        return tuple(each.copy() for each in arrays)

    def restore(self, state: tuple[Integers, ...]) -> None:
        """Take the arrays of a state."""
        self.runs, self.lists, self.heads, self.nodes, self.counts = (each.copy() for each in state)

    def compact(
        self, watermarks: Integers, part_key: int, *records: Integers
    ) -> tuple[Integers, ...]:
        """Keep only runs that last at the watermark of their part, and the nodes of those and of
        the ``records``, which are renumbered. ``part_key``: which of the keys numbers the part; -1:
        there are no parts. Return views of the places of rows that remain."""
        counts, elements = self.counts, len(self.packed.keys)
        needed = int(counts[NEEDED])
        live = int(counts[LIVE])
        runs = np.zeros((self.capacity + live + live // 2 + needed, self.runs.shape[1]), np.int64)
        lists, heads = self._empty_lists(int(counts[LISTS]), elements)
        least = earlier(watermarks, self.lasts)
        given = self.runs, self.lists, least, part_key, runs, lists, heads, counts
        _copy_runs.run(*given, size=int(counts[USED]))
        self.runs, self.lists, self.heads = runs, lists, heads
        kept = (runs[: int(counts[USED])], *records)
        if self.packed.listed:
            self._compact_nodes([each[:, 2 * elements : 3 * elements] for each in kept])
        places = [each[:, : 2 * elements] for each in kept]
        return (*places, self.nodes[: int(counts[NODES]), ROW])

    def _compact_nodes(self, roots: list[Integers]) -> None:
        counts = self.counts
        needed = int(counts[NODES_NEEDED])
        moved = np.zeros(int(counts[NODES]), np.int64)
        moved[0] = 1
        for root in roots:
            moved[root] = 1
        live = int(_mark_nodes.run(self.nodes, moved, size=len(moved)))
        nodes = np.zeros((self.capacity + live + live // 2 + needed, 2), np.int64)
        _copy_nodes.run(self.nodes, moved, nodes, size=len(moved))
        for root in roots:
            root[...] = moved[root]
        self.nodes = nodes
        counts[NODES] = live


# -- in the compiled loops -------------------------------------------------------------------


def append_run(r: int, v: int, runs: Any, lists: Any) -> None:
    """Put a run at the end of a list."""
    next_ = runs.shape[1] + NEXT
    runs[r, next_] = -1
    if lists[v, HEAD] < 0:
        lists[v, HEAD] = r
    else:
        runs[lists[v, TAIL], next_] = r
    lists[v, TAIL] = r
    lists[v, LENGTH] += 1


def list_of(state: int, keys: Any, lists: Any, heads: Any, counts: Any) -> Any:
    """The list of a state with these keys; a new one if there is none."""
    count = lists.shape[1] - VECTOR_KEYS
    place, v = vector_of(state, count, keys, hashed(state, count, keys, 0), lists, heads)
    if v < 0:
        v = counts[LISTS]
        counts[LISTS] += 1
        heads[place] = v + 1
        lists[v, HEAD], lists[v, TAIL], lists[v, LENGTH] = -1, -1, 0
        lists[v, BUFFER] = state
        for i in range(count):
            lists[v, VECTOR_KEYS + i] = keys[i]
    return v


def new_run(runs: Any, counts: Any) -> Any:
    """A record that is free; there must be one."""
    r = counts[FREE]
    if r >= 0:
        counts[FREE] = runs[r, runs.shape[1] + NEXT]
    else:
        r = counts[USED]
        counts[USED] += 1
    counts[LIVE] += 1
    return r


def free_run(r: int, runs: Any, counts: Any) -> None:
    """Give a record back that is in no list."""
    runs[r, runs.shape[1] + NEXT] = counts[FREE]
    counts[FREE] = r
    counts[LIVE] -= 1


def unlink_run(r: int, before: int, v: int, runs: Any, lists: Any) -> None:
    """Take a run out of its list, where it comes after the run ``before`` (-1: it is the first)."""
    next_ = runs.shape[1] + NEXT
    if before < 0:
        lists[v, HEAD] = runs[r, next_]
    else:
        runs[before, next_] = runs[r, next_]
    if lists[v, TAIL] == r:
        lists[v, TAIL] = before
    lists[v, LENGTH] -= 1


IN_RUNS: Final = (mix, hashed, vector_of, append_run, list_of, new_run, free_run, unlink_run)
"""The functions that compiled loops call."""


def _copy_runs_loop(
    runs: Any,
    lists: Any,
    least: Any,
    part_key: int,
    new_runs: Any,
    new_lists: Any,
    new_heads: Any,
    counts: Any,
) -> None:
    """Copy the runs that began at the ``least`` time of their part or after, list by list, in
    order."""
    width, keys = runs.shape[1], lists.shape[1] - VECTOR_KEYS
    used, made = 0, 0
    for v in range(counts[LISTS]):
        r, to = lists[v, HEAD], -1
        part = lists[v, VECTOR_KEYS + part_key] if part_key >= 0 else 0
        while r >= 0:
            after = runs[r, width + NEXT]
            if runs[r, width + BEGAN] >= least[part]:
                if to < 0:
                    to = made
                    made += 1
                    state = lists[v, BUFFER]
                    place = hashed(state, keys, lists[v], VECTOR_KEYS) & (new_heads.shape[0] - 1)
                    while new_heads[place] != 0:
                        place = (place + 1) & (new_heads.shape[0] - 1)
                    new_heads[place] = to + 1
                    for word in range(lists.shape[1]):
                        new_lists[to, word] = lists[v, word]
                    new_lists[to, HEAD], new_lists[to, TAIL], new_lists[to, LENGTH] = -1, -1, 0
                for word in range(width):
                    new_runs[used, word] = runs[r, word]
                append_run(used, to, new_runs, new_lists)
                used += 1
            r = after
    counts[USED], counts[LIVE], counts[LISTS], counts[FREE] = used, used, made, -1


def _mark_nodes_loop(nodes: Any, is_live: Any) -> Any:
    """Mark the nodes before those that are marked; return the number of all."""
    count = 0
    for at in range(is_live.shape[0] - 1, -1, -1):
        if is_live[at]:
            is_live[nodes[at, PARENT]] = 1
            count += 1
    return count


def _copy_nodes_loop(nodes: Any, moved: Any, new_nodes: Any) -> None:
    """Copy the nodes that are marked in ``moved``, which gets their new numbers."""
    used = 0
    for at in range(moved.shape[0]):
        if moved[at]:
            moved[at] = used
            new_nodes[used, ROW] = nodes[at, ROW]
            new_nodes[used, PARENT] = moved[nodes[at, PARENT]]
            used += 1


def _types() -> tuple[Any, Any, Any]:
    from numba import types

    return types, types.int64[::1], types.int64[:, ::1]


def _copy_runs_signature() -> Any:
    types, row, table = _types()
    return types.void(table, table, row, types.int64, table, table, row, row)


def _mark_nodes_signature() -> Any:
    types, row, table = _types()
    return types.int64(table, row)


def _copy_nodes_signature() -> Any:
    types, row, table = _types()
    return types.void(table, row, table)


_copy_runs = Kernel(_copy_runs_loop, _copy_runs_signature, allocates=False, calls=IN_RUNS)
_mark_nodes = Kernel(_mark_nodes_loop, _mark_nodes_signature, allocates=False, calls=IN_RUNS)
_copy_nodes = Kernel(_copy_nodes_loop, _copy_nodes_signature, allocates=False, calls=IN_RUNS)
