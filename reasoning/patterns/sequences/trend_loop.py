"""The compiled loop of trends: aggregates over all matches that end at a row (SPEC §8; GRETA,
Poppe et al. 2017, §4).

When a row ends matches, the rows before it are visited from the latest to the earliest. Each gets
the *cell* of all trends from it to the end: the row with the sum of the cells of the rows that may
follow it. Where no condition is tested on followers, the sum runs along.

A cell has the number of trends, and of each accumulator the number of values in all of them, their
sum, the least and the greatest. Numbers of trends are added up twice: as 64-bit integers, which
wrap around, and as floats, which tell whether the integers did.

"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....streams.jit import Kernel
from ....streams.time import TIME_MAX, TIME_MIN
from ..evaluation.conditions import END, STACK, START, compares, holds, number_at
from ..evaluation.join_loop import plus
from ..evaluation.store import (
    BASE,
    FIRST,
    IN_LOOPS,
    IS_FULL,
    IS_OUT_FULL,
    LOOKED_AT,
    MADE,
    OUT,
    ROWS,
    STOP,
    UNSTORED,
    first_at_least,
    hashed,
    put,
    vector_of,
)
from ..plans.plan import NO_VALUE
from .run_loop import (
    BOUND,
    COUNT,
    DEAD,
    FOUND,
    INTEGERS,
    KEYS,
    KLEENE,
    LASTS,
    MOST_CANDIDATES,
    PART_WORD,
    SLOTS,
    bind_next,
    is_in_time,
    mark_dead,
    mask_of,
)
from .run_packing import OF_COLUMN, OF_ELEMENT, OF_NUMBERS
from .trend_packing import AFTER, ENTRY

HAS_INTERVALS: Final = 9
"""A setting, after those of `run_loop`."""
# A cell in integers: the number of trends, and of each accumulator the number of values, the least
# and the greatest (of integers); in floats: the same with the sum before the least.
INTEGER_WORDS, FLOAT_WORDS = 3, 4
ROOM_NEEDED: Final = 0
"""The only word of ``needs``: for how many rows of an element cells are needed."""


def clear(p: int, ints: Any, floats: Any) -> None:
    """Let a cell have no trend."""
    for word in range(ints.shape[1]):
        ints[p, word] = 0
    for word in range(floats.shape[1]):
        floats[p, word] = 0.0
    for k in range((ints.shape[1] - 1) // INTEGER_WORDS):
        ints[p, INTEGER_WORDS * k + 2], ints[p, INTEGER_WORDS * k + 3] = TIME_MAX, TIME_MIN
        floats[p, FLOAT_WORDS * k + 3], floats[p, FLOAT_WORDS * k + 4] = np.inf, -np.inf


def add_cell(p: int, q: int, ints: Any, floats: Any) -> None:
    """Let a cell have the trends of another one, too."""
    ints[p, 0] += ints[q, 0]
    floats[p, 0] += floats[q, 0]
    for k in range((ints.shape[1] - 1) // INTEGER_WORDS):
        i, f = INTEGER_WORDS * k, FLOAT_WORDS * k
        ints[p, i + 1] += ints[q, i + 1]
        ints[p, i + 2] = min(ints[p, i + 2], ints[q, i + 2])
        ints[p, i + 3] = max(ints[p, i + 3], ints[q, i + 3])
        floats[p, f + 1] += floats[q, f + 1]
        floats[p, f + 2] += floats[q, f + 2]
        floats[p, f + 3] = min(floats[p, f + 3], floats[q, f + 3])
        floats[p, f + 4] = max(floats[p, f + 4], floats[q, f + 4])


def begin_with(
    p: int, e: int, row: int, accumulators: Any, ints: Any, floats: Any, tests: Any
) -> None:
    """Let each trend of a cell begin with a row of element e before its others."""
    table, numbers = tests[0], tests[1]
    if floats[p, 0] == 0.0:
        return
    for k in range(accumulators.shape[0]):
        if accumulators[k, OF_ELEMENT] != e:
            continue
        i, f, column = INTEGER_WORDS * k, FLOAT_WORDS * k, accumulators[k, OF_COLUMN]
        if column >= 0 and accumulators[k, OF_NUMBERS]:
            x = numbers[row, column]
            if x != x:
                continue
        elif column >= 0:
            value = table[row, column]
            if value == NO_VALUE:
                continue
            x = float(value)
            ints[p, i + 2] = min(ints[p, i + 2], value)
            ints[p, i + 3] = max(ints[p, i + 3], value)
        else:
            x = 0.0
        ints[p, i + 1] += ints[p, 0]
        floats[p, f + 1] += floats[p, 0]
        floats[p, f + 2] += x * floats[p, 0]
        floats[p, f + 3] = min(floats[p, f + 3], x)
        floats[p, f + 4] = max(floats[p, f + 4], x)


def may_follow(
    e: int, before: int, row: int, is_entry: bool, n: int, steps: Any, tests: Any, bound: Any
) -> Any:
    """Whether a row of element e may follow another one: of the element before (``is_entry``), or
    of element e."""
    if is_entry:
        bind_next(e - 1, before, n, bound)
        bind_next(e, row, n, bound)
    else:
        bound[e], bound[2 * n + 1 + e] = row, before
    group = ENTRY if is_entry else AFTER
    for c in range(steps[e, group], steps[e, group + 1]):  # noqa: SIM110 (numba has no all)
        if not holds(c, bound, *tests):
            return False
    return True


def is_free(e: int, group: int, settings: Any, steps: Any) -> Any:
    """Whether a row of element e may follow each row that ends before it starts, and rows start in
    order of their ends."""
    return not settings[HAS_INTERVALS] and steps[e, group] == steps[e, group + 1]


def add_tested(
    p: int,
    before: int,
    e: int,
    is_entry: bool,
    base: int,
    first: int,
    count: int,
    n: int,
    steps: Any,
    cells: Any,
    tests: Any,
    bound: Any,
) -> None:
    """Add the cells of the rows of element e that may follow a row to its cell p. They are cells
    ``base + first .. base + count - 1``, in order of their ends."""
    ints, floats, places = cells
    table = tests[0]
    end = table[before, END]
    for j in range(count - 1, first - 1, -1):
        row = places[base + j]
        if table[row, END] <= end:
            break
        if table[row, START] > end and may_follow(e, before, row, is_entry, n, steps, tests, bound):
            add_cell(p, base + j, ints, floats)


def window_of(
    e: int, row: int, settings: Any, run_keys: Any, store: Any, tests: Any, keys: Any
) -> Any:
    """The first place in the pool, and the one after the last, of the rows of element e that may
    stand before a row that ends matches."""
    ends, _, vectors, heads = store
    table, n, count = tests[0], settings[COUNT], run_keys.shape[1]
    for x in range(count):
        keys[x] = table[row, run_keys[n - 1, x]]
    _, v = vector_of(e, count, keys, hashed(e, count, keys, 0), vectors, heads)
    if v < 0:
        return 0, 0
    first, stop = vectors[v, BASE] + vectors[v, FIRST], vectors[v, BASE] + vectors[v, STOP]
    first = first_at_least(ends, first, stop, plus(table[row, END], -settings[LASTS]))
    return first, first_at_least(ends, first, stop, table[row, START])


def sum_trends(
    row: int,
    settings: Any,
    run_keys: Any,
    steps: Any,
    accumulators: Any,
    cells: Any,
    store: Any,
    tests: Any,
    marks: Any,
    work: Any,
) -> Any:
    """Sum the trends that end at a row; return the cell that has them."""
    ints, floats, places = cells
    _, rows, _, _ = store
    table, bound, n = tests[0], work[BOUND], settings[COUNT]
    room = (ints.shape[0] - 3) // 2
    entering, following, total = 2 * room, 2 * room + 1, 2 * room + 2
    clear(total, ints, floats)
    least = plus(table[row, END], -settings[LASTS])
    base, later_base, later_count = 0, 0, 0
    for e in range(n - 1, -1, -1):
        is_kleene = (settings[KLEENE] >> e) & 1 != 0
        first, stop = 0, 0
        if e < n - 1 or is_kleene:
            first, stop = window_of(e, row, settings, run_keys, store, tests, work[KEYS])
        count = stop - first
        marks[LOOKED_AT] += count
        clear(entering, ints, floats)
        clear(following, ints, floats)
        reached = later_count
        if e == n - 1:
            p = base + count
            places[p] = row
            clear(p, ints, floats)
            ints[p, 0], floats[p, 0] = 1, 1.0
            begin_with(p, e, row, accumulators, ints, floats, tests)
            if e == 0 and table[row, START] >= least:
                add_cell(total, p, ints, floats)
        own = count + (1 if e == n - 1 else 0)
        own_reached = own
        enters = e < n - 1
        enters_free = enters and is_free(e + 1, ENTRY, settings, steps)
        follows_free = is_kleene and is_free(e, AFTER, settings, steps)
        for i in range(count - 1, -1, -1):
            p, before = base + i, rows[first + i]
            end = table[before, END]
            places[p] = before
            clear(p, ints, floats)
            if enters_free:
                while reached > 0 and table[places[later_base + reached - 1], END] > end:
                    reached -= 1
                    add_cell(entering, later_base + reached, ints, floats)
                add_cell(p, entering, ints, floats)
            elif enters:
                add_tested(
                    p, before, e + 1, True, later_base, 0, later_count, n, steps, cells, tests,
                    bound,
                )  # fmt: skip
            if follows_free:
                while own_reached > i + 1 and table[places[base + own_reached - 1], END] > end:
                    own_reached -= 1
                    add_cell(following, base + own_reached, ints, floats)
                add_cell(p, following, ints, floats)
            elif is_kleene:
                add_tested(p, before, e, False, base, i + 1, own, n, steps, cells, tests, bound)
            begin_with(p, e, before, accumulators, ints, floats, tests)
            if e == 0 and table[before, START] >= least:
                add_cell(total, p, ints, floats)
        later_base, later_count = base, own
        base = room - base
    return total


def _trends_loop(
    # The rows: records and the numbers of their sources; the row to begin with.
    batch: Any,
    kind: Any,
    begin: int,
    # The plan (`trend_packing`).
    settings: Any,
    kinds: Any,
    own: Any,
    run_keys: Any,
    steps: Any,
    accumulators: Any,
    buffers: Any,
    conditions: Any,
    factors: Any,
    code: Any,
    constants: Any,
    # The store.
    table: Any,
    floats: Any,
    ends: Any,
    rows: Any,
    vectors: Any,
    heads: Any,
    marks: Any,
    times: Any,
    # Cells for two elements and three more, and the rows they belong to.
    cells: Any,
    cell_floats: Any,
    places: Any,
    needs: Any,
    # The results: the row, then the cell.
    out: Any,
    out_floats: Any,
    # From `scratch`.
    work: Any,
    numbers: Any,
) -> Any:
    """Take rows from ``begin`` on; return the row before which an array was full, or their
    number."""
    tests = table, floats, conditions, factors, code, constants, work[INTEGERS], numbers
    store = ends, rows, vectors, heads
    all_cells = cells, cell_floats, places
    plan = settings, run_keys
    n, kleene = settings[COUNT], settings[KLEENE]
    last = 1 << (n - 1)
    mark_dead(buffers, work[DEAD], marks)
    for i in range(begin, batch.shape[0]):
        suits = kinds[kind[i]] if kind[i] >= 0 else 0
        if not is_in_time(i, batch, suits, settings[PART_WORD], marks, times):
            continue
        if settings[PART_WORD]:
            mark_dead(buffers, work[DEAD], marks)
        if suits == 0:
            continue
        if marks[IS_FULL]:
            marks[UNSTORED] += 1
            continue
        row = marks[ROWS]
        marks[IS_OUT_FULL] = 0
        if row == table.shape[0]:
            return i
        for word in range(table.shape[1]):
            table[row, word] = batch[i, word]
        mask = mask_of(row, suits, own, plan, tests, work[BOUND])
        if mask == 0:
            continue
        if mask & last:
            if marks[OUT] == out.shape[0]:
                marks[IS_OUT_FULL] = 1
                return i
            needed = 1
            for e in range(n):
                first, stop = window_of(e, row, settings, run_keys, store, tests, work[KEYS])
                needed = max(needed, stop - first + 1)
            needs[ROOM_NEEDED] = needed
            if 2 * needed + 3 > cells.shape[0]:
                return i
        stored = 0
        kept = mask if kleene & last else mask & ~last
        if kept:
            stored = put(
                row, kept, settings[MOST_CANDIDATES], work[DEAD], work[FOUND], work[KEYS], buffers,
                table, ends, rows, vectors, heads, marks,
            )  # fmt: skip
            if stored < 0:
                return i
        is_used = stored > 0
        if mask & last:
            total = sum_trends(
                row, settings, run_keys, steps, accumulators, all_cells, store, tests, marks, work
            )
            if cell_floats[total, 0] > 0.0:
                o = marks[OUT]
                out[o, 0] = row
                for word in range(cells.shape[1]):
                    out[o, 1 + word] = cells[total, word]
                for word in range(cell_floats.shape[1]):
                    out_floats[o, 1 + cells.shape[1] + word] = cell_floats[total, word]
                marks[OUT] = o + 1
                marks[MADE] += 1
                is_used = True
        if is_used:
            marks[ROWS] = row + 1
    return batch.shape[0]


IN_LOOP: Final = (
    *IN_LOOPS, compares, number_at, holds, plus, is_in_time, mark_dead, bind_next, mask_of, clear,
    add_cell, begin_with, may_follow, is_free, add_tested, window_of, sum_trends,
)  # fmt: skip


def _trends_signature() -> Any:
    from numba import types

    row, table, floats = types.int64[::1], types.int64[:, ::1], types.float64[:, ::1]
    plan = (row, row, row, table, table, table, table)
    conditions = (table, floats, table, types.float64[::1])
    store = (table, floats, row, row, table, row, row, table)
    cells = (table, floats, row, row)
    given = (table, floats)
    return types.int64(
        table, row, types.int64, *plan, *conditions, *store, *cells, *given, table,
        types.float64[::1],
    )  # fmt: skip


_trends = Kernel(_trends_loop, _trends_signature, allocates=False, calls=IN_LOOP)


def scratch(
    buffers: NDArray[np.int64], keys: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The last two arguments of `run`, for a plan with these buffers and keys of rows."""
    size = max(STACK, SLOTS, *buffers.shape, *keys.shape)
    return np.zeros((INTEGERS + 1, size), np.int64), np.zeros(STACK, np.float64)


def run(*arguments: Any) -> int:
    """Run the loop over rows, as `_trends_loop` says."""
    return int(_trends.run(*arguments, size=len(arguments[0])))
