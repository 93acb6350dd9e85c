"""The compiled products of trends whose neighbours are not compared (SPEC §8; GRETA and COGRA,
Poppe et al. 2017 and 2019).

A state of a trend is the number of elements that have begun, ``0 … n``. The rows of one time and
key are an *item*, a matrix: the identity, as each row may be left out, and for each row that suits
element e a step from e to e + 1 and, of a Kleene element, from e + 1 to itself. The trends of a
window are in the product of its items, in order of time. The entries are cells (`trend_loop`).

The window moves, so each key has its items in two parts. Those of the later part are multiplied as
they come. When an item of the later part has to go, the part is turned over: each item gets row 0
of the product from it to the end of the part. So an item costs O(1) products, however long the
window is.

"""

from __future__ import annotations

from typing import Any, Final

from ....streams.jit import Kernel
from ..evaluation.conditions import END
from ..evaluation.join_loop import plus
from ..evaluation.store import (
    BUFFER,
    IS_OUT_FULL,
    LOOKED_AT,
    MADE,
    OUT,
    ROWS,
    UNSTORED,
    VECTOR_KEYS,
    hashed,
    vector_of,
)
from .run_loop import (
    BOUND,
    COUNT,
    INTEGERS,
    KEYS,
    KLEENE,
    LASTS,
    MOST_RUNS,
    PART_WORD,
    is_in_time,
    mask_of,
)
from .trend_loop import FLOAT_WORDS, INTEGER_WORDS, begin_with, clear
from .trend_loop import IN_LOOP as IN_TREND_LOOP

# A window, of one key: its first and last item, whether the last one may still get rows, the last
# item of the part that was turned over (-1: none); its keys stand from `VECTOR_KEYS` on.
HEAD, TAIL, IS_OPEN, TURNED = range(4)
# An item: its time, the ones after and before it.
TIME, NEXT, BEFORE = range(3)
# Counts: windows; items used, the first one that is free, those in windows.
WINDOWS, USED, FREE, LIVE = range(4)
COUNTS: Final = 4
# Cells after the matrices of all windows: a matrix, a row's cell, a cell of 1, the total.
SCRATCH: Final = 3


def multiply_add(p: int, to: Any, x: int, left: Any, y: int, right: Any) -> None:
    """Add the trends of cell x, each gone on with each of cell y, to cell p, which may be x."""
    ints, floats = to
    left_ints, left_floats = left
    right_ints, right_floats = right
    if left_floats[x, 0] == 0.0 or right_floats[y, 0] == 0.0:
        return
    for k in range((ints.shape[1] - 1) // INTEGER_WORDS):
        i, f = INTEGER_WORDS * k, FLOAT_WORDS * k
        ints[p, i + 1] += (
            left_ints[x, i + 1] * right_ints[y, 0] + left_ints[x, 0] * right_ints[y, i + 1]
        )
        ints[p, i + 2] = min(ints[p, i + 2], left_ints[x, i + 2], right_ints[y, i + 2])
        ints[p, i + 3] = max(ints[p, i + 3], left_ints[x, i + 3], right_ints[y, i + 3])
        for word in (f + 1, f + 2):
            floats[p, word] += (
                left_floats[x, word] * right_floats[y, 0]
                + left_floats[x, 0] * right_floats[y, word]
            )
        floats[p, f + 3] = min(floats[p, f + 3], left_floats[x, f + 3], right_floats[y, f + 3])
        floats[p, f + 4] = max(floats[p, f + 4], left_floats[x, f + 4], right_floats[y, f + 4])
    ints[p, 0] += left_ints[x, 0] * right_ints[y, 0]
    floats[p, 0] += left_floats[x, 0] * right_floats[y, 0]


def make_identity(first: int, size: int, cells: Any) -> None:
    """Let the matrix of cells from ``first`` on be the identity."""
    ints, floats = cells
    for p in range(first, first + size * size):
        clear(p, ints, floats)
    for a in range(size):
        p = first + a * size + a
        ints[p, 0], floats[p, 0] = 1, 1.0


def close_item(v: int, settings: Any, state: Any) -> None:
    """Multiply the product of the later part of a window with its last item."""
    windows, _, items_of, products = state[0], state[1], state[2], state[3]
    n, size = settings[COUNT], settings[COUNT] + 1
    first, row = v * size * size, windows[v, TAIL] * (n + size)
    windows[v, IS_OPEN] = 0
    # A column changes before the one that it is made of.
    for e in range(n - 1, -1, -1):
        for a in range(size):
            p = first + a * size + e + 1
            if (settings[KLEENE] >> e) & 1:
                multiply_add(p, products, p, products, row + e, items_of)
            multiply_add(p, products, p - 1, products, row + e, items_of)


def turn_over(v: int, settings: Any, state: Any) -> None:
    """Give each item of a window row 0 of the product of the items from it on."""
    windows, items, items_of, products = state[0], state[1], state[2], state[3]
    n, size = settings[COUNT], settings[COUNT] + 1
    scratch = windows.shape[0] * size * size
    one = scratch + size * size + 1
    make_identity(scratch, size, products)
    item = windows[v, TAIL]
    while item >= 0:
        row = item * (n + size)
        # A row changes before the one that it was made of.
        for a in range(size):
            for b in range(a, size):
                p = scratch + a * size + b
                if a > 0 and (settings[KLEENE] >> (a - 1)) & 1:
                    multiply_add(p, products, p, products, row + a - 1, items_of)
                if a < n:
                    multiply_add(p, products, p + size, products, row + a, items_of)
        for b in range(size):
            clear(row + n + b, items_of[0], items_of[1])
            multiply_add(row + n + b, items_of, scratch + b, products, one, products)
        item = items[item, BEFORE]
    windows[v, TURNED] = windows[v, TAIL]
    make_identity(v * size * size, size, products)


def drop_items(v: int, least: int, settings: Any, state: Any, counts: Any) -> None:
    """Drop the items of a window whose time is before ``least``; none is open."""
    windows, items, _, products = state[0], state[1], state[2], state[3]
    size = settings[COUNT] + 1
    if windows[v, TAIL] >= 0 and items[windows[v, TAIL], TIME] < least:
        windows[v, TURNED] = windows[v, TAIL]
        make_identity(v * size * size, size, products)
    while windows[v, HEAD] >= 0 and items[windows[v, HEAD], TIME] < least:
        if windows[v, TURNED] < 0:
            turn_over(v, settings, state)
        item = windows[v, HEAD]
        if item == windows[v, TURNED]:
            windows[v, TURNED] = -1
        windows[v, HEAD] = items[item, NEXT]
        if items[item, NEXT] >= 0:
            items[items[item, NEXT], BEFORE] = -1
        else:
            windows[v, TAIL] = -1
        items[item, NEXT] = counts[FREE]
        counts[FREE] = item
        counts[LIVE] -= 1


def add_to_item(
    v: int,
    row: int,
    mask: int,
    settings: Any,
    accumulators: Any,
    state: Any,
    counts: Any,
    tests: Any,
) -> None:
    """Add a row to the open item of a window, or to a new one."""
    windows, items, items_of, products = state[0], state[1], state[2], state[3]
    n, size = settings[COUNT], settings[COUNT] + 1
    cell = windows.shape[0] * size * size + size * size
    item = windows[v, TAIL]
    if not windows[v, IS_OPEN]:
        before, item = item, counts[FREE]
        if item >= 0:
            counts[FREE] = items[item, NEXT]
        else:
            item = counts[USED]
            counts[USED] += 1
        counts[LIVE] += 1
        items[item, TIME] = tests[0][row, END]
        items[item, NEXT], items[item, BEFORE] = -1, before
        if before >= 0:
            items[before, NEXT] = item
        else:
            windows[v, HEAD] = item
        windows[v, TAIL], windows[v, IS_OPEN] = item, 1
        for e in range(n):
            clear(item * (n + size) + e, items_of[0], items_of[1])
    for e in range(n):
        if (mask >> e) & 1:
            clear(cell, products[0], products[1])
            products[0][cell, 0], products[1][cell, 0] = 1, 1.0
            begin_with(cell, e, row, accumulators, products[0], products[1], tests)
            multiply_add(item * (n + size) + e, items_of, cell, products, cell + 1, products)


def total_of(v: int, row: int, settings: Any, accumulators: Any, state: Any, tests: Any) -> Any:
    """The cell of all trends that end at a row, after the items of its window (-1: it has none)."""
    windows, _, items_of, products = state[0], state[1], state[2], state[3]
    n, size = settings[COUNT], settings[COUNT] + 1
    total = windows.shape[0] * size * size + size * size + 2
    clear(total, products[0], products[1])
    if v < 0 and n == 1:
        products[0][total, 0], products[1][total, 0] = 1, 1.0
    # A row of a Kleene element may come after others of its own.
    for end in (n - 1, n):
        if v < 0 or (end == n and not (settings[KLEENE] >> (n - 1)) & 1):
            continue
        column = v * size * size + end
        if windows[v, TURNED] < 0:
            multiply_add(total, products, column, products, total - 1, products)
        else:
            turned = windows[v, HEAD] * (n + size) + n
            for x in range(size):
                multiply_add(total, products, turned + x, items_of, column + x * size, products)
    begin_with(total, n - 1, row, accumulators, products[0], products[1], tests)
    return total


def _products_loop(
    # The rows: records and the numbers of their sources; the row to begin with.
    batch: Any,
    kind: Any,
    begin: int,
    # The plan (`trend_packing`).
    settings: Any,
    kinds: Any,
    own: Any,
    run_keys: Any,
    accumulators: Any,
    conditions: Any,
    factors: Any,
    code: Any,
    constants: Any,
    # The rows that end matches.
    table: Any,
    floats: Any,
    marks: Any,
    times: Any,
    # The windows, their items, and the cells of both: n + (n + 1) an item, (n + 1)² a window.
    windows: Any,
    window_heads: Any,
    items: Any,
    item_cells: Any,
    item_floats: Any,
    cells: Any,
    cell_floats: Any,
    counts: Any,
    # The results: the row, then the cell.
    out: Any,
    out_floats: Any,
    # From `trend_loop.scratch`.
    work: Any,
    numbers: Any,
) -> Any:
    """Take rows from ``begin`` on; return the row before which an array was full, or their
    number."""
    tests = table, floats, conditions, factors, code, constants, work[INTEGERS], numbers
    products = cells, cell_floats
    state = windows, items, (item_cells, item_floats), products
    plan = settings, run_keys
    n, size, count, keys = settings[COUNT], settings[COUNT] + 1, run_keys.shape[1], work[KEYS]
    last = 1 << (n - 1)
    one = windows.shape[0] * size * size + size * size + 1
    clear(one, cells, cell_floats)
    cells[one, 0], cell_floats[one, 0] = 1, 1.0
    for i in range(begin, batch.shape[0]):
        suits = kinds[kind[i]] if kind[i] >= 0 else 0
        if not is_in_time(i, batch, suits, settings[PART_WORD], marks, times):
            continue
        if suits == 0:
            continue
        row = marks[ROWS]
        marks[IS_OUT_FULL] = 0
        if row == table.shape[0] or (counts[FREE] < 0 and counts[USED] == items.shape[0]):
            return i
        if marks[OUT] == out.shape[0]:
            marks[IS_OUT_FULL] = 1
            return i
        for word in range(table.shape[1]):
            table[row, word] = batch[i, word]
        mask = mask_of(row, suits, own, plan, tests, work[BOUND])
        if mask == 0:
            continue
        # Each element that the row suits has the same keys: `ProductTrends` sees to that.
        e = 0
        while not (mask >> e) & 1:
            e += 1
        for x in range(count):
            keys[x] = table[row, run_keys[e, x]]
        place, v = vector_of(0, count, keys, hashed(0, count, keys, 0), windows, window_heads)
        kept = mask if settings[KLEENE] & last else mask & ~last
        if v < 0 and kept:
            if counts[WINDOWS] == windows.shape[0]:
                return i
            v = counts[WINDOWS]
            counts[WINDOWS] += 1
            window_heads[place] = v + 1
            windows[v, HEAD], windows[v, TAIL] = -1, -1
            windows[v, IS_OPEN], windows[v, TURNED], windows[v, BUFFER] = 0, -1, 0
            for x in range(count):
                windows[v, VECTOR_KEYS + x] = keys[x]
            make_identity(v * size * size, size, products)
        if v >= 0:
            if windows[v, IS_OPEN] and items[windows[v, TAIL], TIME] < batch[i, END]:
                close_item(v, settings, state)
            if not windows[v, IS_OPEN]:
                drop_items(v, plus(batch[i, END], -settings[LASTS]), settings, state, counts)
        marks[LOOKED_AT] += 1
        if mask & last:
            total = total_of(v, row, settings, accumulators, state, tests)
            if cell_floats[total, 0] > 0.0:
                o = marks[OUT]
                out[o, 0] = row
                for word in range(cells.shape[1]):
                    out[o, 1 + word] = cells[total, word]
                for word in range(cell_floats.shape[1]):
                    out_floats[o, 1 + cells.shape[1] + word] = cell_floats[total, word]
                marks[OUT] = o + 1
                marks[MADE] += 1
                marks[ROWS] = row + 1
        if kept and counts[LIVE] >= settings[MOST_RUNS]:
            marks[UNSTORED] += 1
        elif kept:
            add_to_item(v, row, kept, settings, accumulators, state, counts, tests)
    return batch.shape[0]


def _sweep_loop(
    watermarks: Any,
    part_key: int,
    settings: Any,
    windows: Any,
    items: Any,
    item_cells: Any,
    item_floats: Any,
    cells: Any,
    cell_floats: Any,
    counts: Any,
    new_windows: Any,
    new_heads: Any,
    new_cells: Any,
    new_floats: Any,
) -> None:
    """Drop the items that the watermark of their part has passed, and copy the windows that have
    some."""
    state = windows, items, (item_cells, item_floats), (cells, cell_floats)
    size, keys = settings[COUNT] + 1, windows.shape[1] - VECTOR_KEYS
    one = windows.shape[0] * size * size + size * size + 1
    clear(one, cells, cell_floats)
    cells[one, 0], cell_floats[one, 0] = 1, 1.0
    used = 0
    for v in range(counts[WINDOWS]):
        watermark = watermarks[windows[v, VECTOR_KEYS + part_key] if part_key >= 0 else 0]
        least = plus(watermark, -settings[LASTS])
        if windows[v, IS_OPEN] and items[windows[v, TAIL], TIME] < watermark:
            close_item(v, settings, state)
        if not windows[v, IS_OPEN]:
            drop_items(v, least, settings, state, counts)
        if windows[v, HEAD] < 0:
            continue
        place = hashed(0, keys, windows[v], VECTOR_KEYS) & (new_heads.shape[0] - 1)
        while new_heads[place] != 0:
            place = (place + 1) & (new_heads.shape[0] - 1)
        new_heads[place] = used + 1
        for word in range(windows.shape[1]):
            new_windows[used, word] = windows[v, word]
        for p in range(size * size):
            for word in range(cells.shape[1]):
                new_cells[used * size * size + p, word] = cells[v * size * size + p, word]
            for word in range(cell_floats.shape[1]):
                new_floats[used * size * size + p, word] = cell_floats[v * size * size + p, word]
        used += 1
    counts[WINDOWS] = used


_IN_LOOP: Final = (
    *IN_TREND_LOOP, multiply_add, make_identity, close_item, turn_over, drop_items, add_to_item,
    total_of,
)  # fmt: skip


def _types() -> tuple[Any, ...]:
    from numba import types

    return types, types.int64[::1], types.int64[:, ::1], types.float64[:, ::1]


def _products_signature() -> Any:
    types, row, table, floats = _types()
    plan = (row, row, row, table, table)
    conditions = (table, floats, table, types.float64[::1])
    state = (table, row, table, table, floats, table, floats, row)
    given = (table, floats, table, types.float64[::1])
    return types.int64(
        table, row, types.int64, *plan, *conditions, table, floats, row, table, *state, *given
    )


def _sweep_signature() -> Any:
    types, row, table, floats = _types()
    old = (table, table, table, floats, table, floats, row)
    return types.void(row, types.int64, row, *old, table, row, table, floats)


_products = Kernel(_products_loop, _products_signature, allocates=False, calls=_IN_LOOP)
_sweep = Kernel(_sweep_loop, _sweep_signature, allocates=False, calls=_IN_LOOP)


def run(*arguments: Any) -> int:
    """Run the loop over rows, as `_products_loop` says."""
    return int(_products.run(*arguments, size=len(arguments[0])))


def sweep(*arguments: Any) -> None:
    """Drop what is of no use any more, as `_sweep_loop` says."""
    _sweep.run(*arguments)
