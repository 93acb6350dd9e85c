"""The compiled search: every match of a plan with repetition that ends at a row (SPEC §8).

A stack has the match so far, a record of a run (`runs`) for each of its rows. At each depth the
search takes a further row of the same Kleene element, then begins the next element, then tries to
end with the row that completes the match. So matches with equal first and last rows come in order
of their other rows.

The loop stops before a row when an array is full and continues there when it is called again: of a
row either all matches are made or none.
"""

from __future__ import annotations

from typing import Any, Final

from ....streams.jit import Kernel
from ..evaluation.conditions import END, START
from ..evaluation.join_loop import plus
from ..evaluation.store import (
    CUT_SHORT,
    FIRST_OUT,
    IS_FULL,
    IS_OUT_FULL,
    IS_SHORT,
    LOOKED_AT,
    MADE,
    OUT,
    ROWS,
    UNSTORED,
    first_at_least,
    put,
)
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
    MOST_MATCHES,
    PART_WORD,
    add_row,
    all_hold,
    bind,
    bind_next,
    give_out,
    is_in_time,
    mark_dead,
    mask_of,
)
from .run_loop import IN_LOOP as IN_RUN_LOOP
from .run_packing import EACH, REPEATED, WHOLE
from .runs import BEGAN, NODES, NODES_NEEDED, PARENT, ROW
from .trend_loop import window_of

SEARCHED: Final = 10_000
"""Rows looked at for each match that a row may complete."""
# A depth of the search: the element bound last (-1: none), what is tried, the next row.
STATE, PHASE, AT = range(3)
FRAME: Final = 3
TAKES, GOES, ENDS, DONE = range(4)
DEPTH_NEEDED: Final = 0
"""The word of the stack's counts with the depth that a search needs; of the others it reads only
that at `NODES`."""


def fits(
    depth: int,
    s: int,
    row: int,
    is_taken: bool,
    plan: Any,
    tests: Any,
    state: Any,
    work: Any,
) -> Any:
    """Whether a match so far may go on with a row: as a further one of element s, or as the first
    one of the next element."""
    stack, sums, _, _, path, _ = state
    table, n, bound = tests[0], plan[0][COUNT], work[BOUND]
    if s >= 0 and table[row, START] <= table[stack[depth, n + s], END]:
        return False
    bind(stack, sums, depth, plan, tests, bound)
    if is_taken:
        bound[s] = row
        return all_hold(s, EACH, stack, depth, plan, tests, path, work) and all_hold(
            s, REPEATED, stack, depth, plan, tests, path, work
        )
    if s >= 0 and not all_hold(s, WHOLE, stack, depth, plan, tests, path, work):
        return False
    bind_next(s + 1, row, n, bound)
    return all_hold(s + 1, EACH, stack, depth, plan, tests, path, work)


def push_row(
    depth: int, s: int, row: int, is_taken: bool, plan: Any, tests: Any, state: Any
) -> None:
    """Let the match so far go on with a row, one deeper."""
    stack, _, frames, _, _, counts = state
    table, width = tests[0], stack.shape[1]
    for word in range(width):
        stack[depth + 1, word] = stack[depth, word]
    e = s if is_taken else s + 1
    if not is_taken:
        stack[depth + 1, e] = row
    if s < 0:
        stack[depth + 1, width + BEGAN] = table[row, START]
    counts[NODES] = depth + 1
    add_row(e, row, depth + 1, plan, tests, state)
    frames[depth + 1, STATE], frames[depth + 1, PHASE], frames[depth + 1, AT] = e, TAKES, -1


def keep_path(o: int, n: int, out: Any, path: Any, nodes: Any, counts: Any) -> Any:
    """Keep the rows of a match's Kleene elements as nodes, as the stack changes. False: there is no
    room."""
    for e in range(n):
        last = out[o, 2 * n + e]
        if last == 0:
            continue
        first = last
        while path[first, PARENT] != 0:
            first = path[first, PARENT]
        if counts[NODES] + last - first + 1 > nodes.shape[0]:
            counts[NODES_NEEDED] = counts[NODES] + last - first + 1
            return False
        parent = 0
        for at in range(first, last + 1):
            node = counts[NODES]
            counts[NODES] += 1
            nodes[node, ROW], nodes[node, PARENT] = path[at, ROW], parent
            parent = node
        out[o, 2 * n + e] = parent
    return True


def search_matches(
    row: int,
    plan: Any,
    tests: Any,
    store: Any,
    state: Any,
    nodes: Any,
    counts: Any,
    given: Any,
    work: Any,
) -> Any:
    """Make the matches that a row completes. Return 1, or 0 if an array is full."""
    stack, _, frames, _, path, _ = state
    settings, run_keys = plan[0], plan[1]
    table, n, kleene = tests[0], settings[COUNT], settings[KLEENE]
    ends, rows = store[0], store[1]
    out, marks = given[0], given[3]
    least = plus(table[row, END], -settings[LASTS])
    budget = marks[LOOKED_AT] + SEARCHED * (settings[MOST_MATCHES] + 1)
    for word in range(stack.shape[1]):
        stack[0, word] = 0
    frames[0, STATE], frames[0, PHASE], frames[0, AT] = -1, GOES, -1
    depth = 0
    while depth >= 0:
        s, phase = frames[depth, STATE], frames[depth, PHASE]
        if marks[IS_SHORT] or marks[LOOKED_AT] >= budget:
            marks[IS_SHORT] = 1
            return 1
        if phase == DONE:
            depth -= 1
            continue
        is_taken = phase == TAKES or (phase == ENDS and s == n - 1)
        e = s if is_taken else s + 1
        is_repeated = e < n and (kleene >> e) & 1 != 0
        if phase == ENDS:
            frames[depth, PHASE] = DONE
            marks[LOOKED_AT] += 1
            is_in = e == n - 1 and (not is_taken or is_repeated)
            if is_in and s < 0:
                is_in = table[row, START] >= least
            if is_in and fits(depth, s, row, is_taken, plan, tests, state, work):
                if marks[OUT] == out.shape[0]:
                    marks[IS_OUT_FULL] = 1
                    return 0
                push_row(depth, s, row, is_taken, plan, tests, state)
                if give_out(depth + 1, -1, plan, tests, store, state, given, work) and not (
                    keep_path(marks[OUT] - 1, n, out, path, nodes, counts)
                ):
                    return 0
            continue
        # The rows of element e after the last one, up to the row that completes the match.
        if (is_taken and not is_repeated) or e >= n or (e == n - 1 and not is_repeated):
            frames[depth, PHASE], frames[depth, AT] = phase + 1, -1
            continue
        first, stop = window_of(e, row, settings, run_keys, store, tests, work[KEYS])
        at = frames[depth, AT]
        if at < 0:
            after = least if s < 0 else table[stack[depth, n + s], END] + 1
            at = first_at_least(ends, first, stop, after)
        if at >= stop:
            frames[depth, PHASE], frames[depth, AT] = phase + 1, -1
            continue
        frames[depth, AT] = at + 1
        marks[LOOKED_AT] += 1
        candidate = rows[at]
        if s < 0 and table[candidate, START] < least:
            continue
        if fits(depth, s, candidate, is_taken, plan, tests, state, work):
            push_row(depth, s, candidate, is_taken, plan, tests, state)
            depth += 1
    return 1


def _search_loop(
    # The rows: records and the numbers of their sources; the row to begin with.
    batch: Any,
    kind: Any,
    begin: int,
    # The plan (`run_packing`).
    settings: Any,
    kinds: Any,
    own: Any,
    run_keys: Any,
    steps: Any,
    each: Any,
    accumulators: Any,
    aggregates: Any,
    buffers: Any,
    probes: Any,
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
    # The stack; its records as floats, too; the rows of the match so far as nodes.
    stack: Any,
    sums: Any,
    frames: Any,
    list_heads: Any,
    path: Any,
    path_counts: Any,
    # The nodes of matches.
    nodes: Any,
    counts: Any,
    # The matches: records of runs, and from when on no later row changes them.
    out: Any,
    out_sums: Any,
    due: Any,
    # From `run_loop.scratch`.
    work: Any,
    numbers: Any,
) -> Any:
    """Take rows from ``begin`` on; return the row before which an array was full, or their
    number."""
    plan = settings, run_keys, steps, each, accumulators, aggregates, probes, buffers
    tests = table, floats, conditions, factors, code, constants, work[INTEGERS], numbers
    store = ends, rows, vectors, heads
    state = stack, sums, frames, list_heads, path, path_counts
    given = out, out_sums, due, marks
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
        marks[FIRST_OUT], marks[IS_SHORT] = marks[OUT], 0
        first_node, looked = counts[NODES], marks[LOOKED_AT]
        is_done = 1
        if mask & last:
            depth = 3
            for e in range(n):
                first, stop = window_of(e, row, settings, run_keys, store, tests, work[KEYS])
                depth += stop - first
            path_counts[DEPTH_NEEDED] = depth
            if depth > stack.shape[0]:
                return i
            is_done = search_matches(row, plan, tests, store, state, nodes, counts, given, work)
        stored = 0
        kept = mask if kleene & last else mask & ~last
        if is_done and kept:
            stored = put(
                row, kept, settings[MOST_CANDIDATES], work[DEAD], work[FOUND], work[KEYS], buffers,
                table, ends, rows, vectors, heads, marks,
            )  # fmt: skip
        if not is_done or stored < 0:
            marks[OUT], counts[NODES], marks[LOOKED_AT] = marks[FIRST_OUT], first_node, looked
            return i
        made = marks[OUT] - marks[FIRST_OUT]
        marks[MADE] += made
        marks[CUT_SHORT] += marks[IS_SHORT]
        if stored or made:
            marks[ROWS] = row + 1
    return batch.shape[0]


_IN_LOOP: Final = (
    *IN_RUN_LOOP, first_at_least, window_of, fits, push_row, keep_path, search_matches,
)  # fmt: skip


def _search_signature() -> Any:
    from numba import types

    row, table, floats = types.int64[::1], types.int64[:, ::1], types.float64[:, ::1]
    plan = (row, row, row, table, table, row, table, table, table, table)
    conditions = (table, floats, table, types.float64[::1])
    store = (table, floats, row, row, table, row, row, table)
    state = (table, floats, table, row, table, row, table, row)
    given = (table, floats, row)
    return types.int64(
        table, row, types.int64, *plan, *conditions, *store, *state, *given, table,
        types.float64[::1],
    )  # fmt: skip


_search = Kernel(_search_loop, _search_signature, allocates=False, calls=_IN_LOOP)


def search(*arguments: Any) -> int:
    """Run the loop over rows, as `_search_loop` says."""
    return int(_search.run(*arguments, size=len(arguments[0])))
