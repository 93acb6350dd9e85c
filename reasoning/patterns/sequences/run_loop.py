"""The compiled loop of runs: which rows follow each other under the strategies that select the next
row (SPEC §8; [SASE+] Agrawal et al. 2008, §3).

A row moves each run of its keys at most once: states are visited from the last to the first. A row
that continues a Kleene element (*take*) and begins the next element (*go*) splits the run.

The loop stops before a row when an array may become full, and continues there when it is called
again: before that, the row has changed no run.

Functions pass arrays on in tuples: ``plan`` (`run_packing`), ``tests`` (what `conditions.holds`
reads), ``store``, ``state`` (the runs), ``given`` (the matches); ``work`` is that of `scratch`.

The file is long because compiled code calls compiled code only, so that its steps stand beside it.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....streams.jit import Kernel
from ....streams.time import TIME_MAX
from ..evaluation.conditions import END, STACK, START, holds
from ..evaluation.join_loop import CALLED, OPEN, VIOLATED, answer, plus
from ..evaluation.packing import HIGH, HIGH_OFFSET, HIGH_START, RETAINED
from ..evaluation.store import (
    CUT_SHORT,
    DECIDED,
    DECISIONS,
    FIRST_OUT,
    IS_FULL,
    IS_OUT_FULL,
    IS_SHORT,
    LATE,
    LOOKED_AT,
    MADE,
    OUT,
    ROWS,
    UNSTORED,
    VECTOR_KEYS,
    WATERMARK,
    WATERMARKS,
    hashed,
    put,
    vector_of,
)
from ..plans.plan import MOST_ELEMENTS, NO_VALUE, Function
from .run_packing import (
    ACCUMULATOR,
    EACH,
    EACH_BELOW,
    FUNCTION,
    FUNCTIONS,
    OF_COLUMN,
    OF_ELEMENT,
    OF_NUMBERS,
    REPEATED,
    WHOLE,
    WHOLE_BELOW,
    WORDS,
)
from .runs import (
    BEGAN,
    HEAD,
    IN_RUNS,
    LENGTH,
    LISTS,
    LIVE,
    NEEDED,
    NEXT,
    NODES,
    NODES_NEEDED,
    PARENT,
    ROW,
    UNSTARTED,
    append_run,
    free_run,
    list_of,
    new_run,
    unlink_run,
)

# Settings of a plan as a whole: elements, how long a run lasts (ns), whether it needs contiguous
# rows, the elements that are Kleene and those whose rows are kept (bits), limits.
COUNT, LASTS, IS_CONTIGUOUS, KLEENE, LISTED, MOST_MATCHES, MOST_CANDIDATES, MOST_RUNS = range(8)
# The word of a row that numbers its part, or 0 (`store.Store`).
PART_WORD: Final = 8
# The rows of `scratch`: what is bound; nodes; vectors; the ends before which rows are dead; keys; a
# stack; the lists whose runs may take a row, and go on with it.
BOUND, CURSORS, FOUND, DEAD, KEYS, INTEGERS, TAKING, GOING = range(8)
WORK: Final = 8
AVERAGE: Final = FUNCTIONS.index(Function.AVG)
SLOTS: Final = 3 * MOST_ELEMENTS + 2
"""The length of ``bound`` (`conditions`)."""


def is_in_time(i: int, batch: Any, suits: int, part_word: int, marks: Any, times: Any) -> Any:
    """Whether a row is not late; if so, no row ends before it any more. With parts, the times are
    those of its part."""
    part = 0
    if part_word:
        part = batch[i, part_word]
        marks[WATERMARK], marks[DECIDED] = times[WATERMARKS, part], times[DECISIONS, part]
    if batch[i, END] < marks[WATERMARK]:
        marks[LATE] += suits != 0
        return False
    marks[WATERMARK] = batch[i, END]
    if part_word:
        times[WATERMARKS, part] = batch[i, END]
    return True


def mark_dead(buffers: Any, dead: Any, marks: Any) -> None:
    """Write for each buffer the end before which its rows are dead."""
    for b in range(buffers.shape[0]):
        dead[b] = plus(marks[DECIDED], -buffers[b, RETAINED])


def bind(words: Any, sums: Any, r: int, plan: Any, tests: Any, bound: Any) -> None:
    """Bind the rows of a run or match, and write its aggregates to row 0 of the table."""
    settings, _, _, _, accumulators, aggregates, _, _ = plan
    table, floats, n = tests[0], tests[1], settings[COUNT]
    for e in range(n):
        bound[e] = words[r, e]
        bound[n + 1 + e] = words[r, e]
        bound[2 * n + 1 + e] = words[r, n + e]
    bound[3 * n + 1] = 0
    for a in range(aggregates.shape[0]):
        k, function = aggregates[a, ACCUMULATOR], aggregates[a, FUNCTION]
        at = 3 * n + WORDS * k
        count = words[r, at]
        is_number = accumulators[k, OF_NUMBERS]
        if function == 0:
            table[0, a] = count
        elif function == AVERAGE:
            total = sums[r, at + 1] if is_number else float(words[r, at + 1])
            floats[0, a] = total / count if count else np.nan
        elif is_number:
            floats[0, a] = sums[r, at + function] if count else np.nan
        else:
            table[0, a] = words[r, at + function] if count else NO_VALUE


def add_row(e: int, row: int, r: int, plan: Any, tests: Any, state: Any) -> None:
    """Let a run take a row as the last one of an element."""
    words, sums, _, _, nodes, counts = state
    settings, accumulators = plan[0], plan[4]
    table, floats, n = tests[0], tests[1], settings[COUNT]
    words[r, n + e] = row
    if (settings[LISTED] >> e) & 1:
        node = counts[NODES]
        counts[NODES] += 1
        nodes[node, ROW], nodes[node, PARENT] = row, words[r, 2 * n + e]
        words[r, 2 * n + e] = node
    for k in range(accumulators.shape[0]):
        if accumulators[k, OF_ELEMENT] != e:
            continue
        at, column = 3 * n + WORDS * k, accumulators[k, OF_COLUMN]
        if column < 0:
            words[r, at] += 1
        elif accumulators[k, OF_NUMBERS]:
            x = floats[row, column]
            if x == x:
                is_first = words[r, at] == 0
                words[r, at] += 1
                sums[r, at + 1] = x if is_first else sums[r, at + 1] + x
                sums[r, at + 2] = x if is_first else min(sums[r, at + 2], x)
                sums[r, at + 3] = x if is_first else max(sums[r, at + 3], x)
        else:
            value = table[row, column]
            if value != NO_VALUE:
                is_first = words[r, at] == 0
                words[r, at] += 1
                words[r, at + 1] = value if is_first else words[r, at + 1] + value
                words[r, at + 2] = value if is_first else min(words[r, at + 2], value)
                words[r, at + 3] = value if is_first else max(words[r, at + 3], value)


def all_hold(
    e: int, group: int, words: Any, r: int, plan: Any, tests: Any, nodes: Any, work: Any
) -> Any:
    """Whether the conditions of a group of element e hold of what is bound, and of each row of
    those Kleene elements of the run or match of which they read each row."""
    settings, _, steps, each, _, _, _, _ = plan
    n, bound, cursors = settings[COUNT], work[BOUND], work[CURSORS]
    for c in range(steps[e, group], steps[e, group + 1]):
        elements = each[c]
        for x in range(n):
            if (elements >> x) & 1:
                cursors[x] = words[r, 2 * n + x]
                bound[x] = nodes[cursors[x], ROW]
        is_open = True
        while is_open:
            if not holds(c, bound, *tests):
                return False
            # The next combination of rows, as an odometer counts.
            is_open = False
            for x in range(n):
                if is_open or not (elements >> x) & 1:
                    continue
                cursors[x] = nodes[cursors[x], PARENT]
                is_open = cursors[x] != 0
                if not is_open:
                    cursors[x] = words[r, 2 * n + x]
                bound[x] = nodes[cursors[x], ROW]
    return True


def bind_next(e: int, row: int, n: int, bound: Any) -> None:
    """Bind a row as the first one of element e."""
    bound[e] = row
    bound[n + 1 + e] = row
    bound[2 * n + 1 + e] = row


def give_out(
    r: int, row: int, plan: Any, tests: Any, store: Any, state: Any, given: Any, work: Any
) -> Any:
    """Write a match: a run with all elements, whose last one gets a row that the run has not taken
    (``row``; -1: it has all). Return whether it is one: what its last element must meet as a whole
    holds, and no probe is violated."""
    runs, _, _, _, nodes, _ = state
    settings, _, _, _, _, _, probes, buffers = plan
    out, out_sums, due, marks = given
    table, floats, conditions, factors, code, constants, integers, numbers = tests
    n, o, bound = settings[COUNT], marks[OUT], work[BOUND]
    for word in range(runs.shape[1]):
        out[o, word] = runs[r, word]
    if row >= 0:
        out[o, n - 1], out[o, 2 * n - 1] = row, row
    is_tested = plan[2][n - 1, WHOLE] < plan[2][n - 1, WHOLE_BELOW]
    if is_tested or probes.shape[0]:
        bind(out, out_sums, o, plan, tests, bound)
    if is_tested and not all_hold(n - 1, WHOLE, out, o, plan, tests, nodes, work):
        return False
    now = table[out[o, 2 * n - 1], END]
    until = now
    for p in range(probes.shape[0]):
        said = answer(
            probes[p], n, now, bound, work[KEYS], integers, numbers, buffers, conditions, factors,
            code, constants, table, floats, *store,
        )  # fmt: skip
        if said == VIOLATED:
            return False
        if said == OPEN:
            last = table[bound[probes[p, HIGH]], START if probes[p, HIGH_START] else END]
            until = max(until, plus(plus(last, probes[p, HIGH_OFFSET]), 1))
    if marks[OUT] - marks[FIRST_OUT] >= settings[MOST_MATCHES]:
        marks[IS_SHORT] = 1
        return False
    due[o] = until
    marks[OUT] = o + 1
    return True


def visit_list(
    s: int,
    v: int,
    row: int,
    takes: bool,
    goes: bool,
    plan: Any,
    tests: Any,
    store: Any,
    state: Any,
    given: Any,
    work: Any,
) -> Any:
    """Let the runs of a list of state s take a row, or go to the next element with it; drop those
    that it ends. Return whether the row is in a run or match."""
    runs, sums, lists, list_heads, nodes, counts = state
    settings, run_keys, steps, _, _, _, _, _ = plan
    table, marks, bound, keys = tests[0], given[3], work[BOUND], work[KEYS]
    n, width = settings[COUNT], runs.shape[1]
    ends_open = (settings[KLEENE] >> (n - 1)) & 1 != 0
    is_tested = steps[s, EACH] < steps[s, WHOLE_BELOW] or (
        goes and steps[s + 1, EACH] < steps[s + 1, EACH_BELOW]
    )
    is_used = False
    start, end = table[row, START], table[row, END]
    target, before, r = -1, -1, lists[v, HEAD]
    marks[LOOKED_AT] += lists[v, LENGTH]
    while r >= 0:
        after = runs[r, width + NEXT]
        is_gone = end - runs[r, width + BEGAN] > settings[LASTS]
        fits = not is_gone and start > table[runs[r, n + s], END]
        take, go = fits and takes, fits and goes
        if is_tested and (take or go):
            bind(runs, sums, r, plan, tests, bound)
            if take:
                bound[s] = row
                take = all_hold(s, EACH, runs, r, plan, tests, nodes, work) and all_hold(
                    s, REPEATED, runs, r, plan, tests, nodes, work
                )
            if go:
                go = all_hold(s, WHOLE, runs, r, plan, tests, nodes, work)
                bind_next(s + 1, row, n, bound)
                go = go and all_hold(s + 1, EACH, runs, r, plan, tests, nodes, work)
        is_moved = False
        if go and s + 2 == n and not ends_open:
            is_used = give_out(r, row, plan, tests, store, state, given, work) or is_used
        elif go:
            q = r
            if take:
                q = new_run(runs, counts)
                for word in range(width):
                    runs[q, word] = runs[r, word]
            else:
                unlink_run(r, before, v, runs, lists)
                is_moved = True
            runs[q, s + 1] = row
            add_row(s + 1, row, q, plan, tests, state)
            if target < 0:
                for x in range(run_keys.shape[1]):
                    keys[x] = lists[v, VECTOR_KEYS + x]
                target = list_of(s + 1, keys, lists, list_heads, counts)
            append_run(q, target, runs, lists)
            is_used = True
            if s + 2 == n:
                give_out(q, -1, plan, tests, store, state, given, work)
        if take:
            add_row(s, row, r, plan, tests, state)
            is_used = True
            if s + 1 == n:
                give_out(r, -1, plan, tests, store, state, given, work)
        if not is_moved:
            if is_gone or (go and not take) or (settings[IS_CONTIGUOUS] and not take):
                unlink_run(r, before, v, runs, lists)
                free_run(r, runs, counts)
            else:
                before = r
        r = after
    return is_used


def start_run(
    row: int, plan: Any, tests: Any, store: Any, state: Any, given: Any, work: Any
) -> Any:
    """Begin a run with a row. Return whether the row is in a run or match."""
    runs, _, lists, list_heads, nodes, counts = state
    settings, run_keys = plan[0], plan[1]
    n, width, keys = settings[COUNT], runs.shape[1], work[KEYS]
    bind_next(0, row, n, work[BOUND])
    if tests[0][row, END] - tests[0][row, START] > settings[LASTS]:
        return False
    if not all_hold(0, EACH, runs, 0, plan, tests, nodes, work):
        return False
    if counts[LIVE] >= settings[MOST_RUNS]:
        counts[UNSTARTED] += 1
        return False
    q = new_run(runs, counts)
    for word in range(width):
        runs[q, word] = 0
    runs[q, 0], runs[q, width + BEGAN] = row, tests[0][row, START]
    add_row(0, row, q, plan, tests, state)
    is_used = n == 1 and give_out(q, -1, plan, tests, store, state, given, work)
    if n == 1 and not settings[KLEENE]:
        free_run(q, runs, counts)
        return is_used
    for x in range(run_keys.shape[1]):
        keys[x] = tests[0][row, run_keys[0, x]]
    append_run(q, list_of(0, keys, lists, list_heads, counts), runs, lists)
    return True


def mask_of(row: int, suits: int, own: Any, plan: Any, tests: Any, bound: Any) -> Any:
    """The elements and probes that a row suits, of those that read its source."""
    settings, run_keys = plan[0], plan[1]
    table, n = tests[0], settings[COUNT]
    bound[n] = row
    mask, e = 0, 0
    while suits >> e:
        if (suits >> e) & 1:
            fits = e >= n or table[row, START] <= table[row, END]
            for c in range(own[e], own[e + 1]):
                fits = fits and holds(c, bound, *tests)
            if fits and e < n:
                for x in range(run_keys.shape[1]):
                    fits = fits and table[row, run_keys[e, x]] != NO_VALUE
            if fits:
                mask |= 1 << e
        e += 1
    return mask


def list_with(s: int, e: int, row: int, plan: Any, tests: Any, state: Any, keys: Any) -> Any:
    """The list of runs in state s with the keys that a row has as one of element e, or -1."""
    _, _, lists, list_heads, _, _ = state
    run_keys, table = plan[1], tests[0]
    count = run_keys.shape[1]
    for x in range(count):
        keys[x] = table[row, run_keys[e, x]]
        if keys[x] == NO_VALUE:
            return -1
    _, v = vector_of(s, count, keys, hashed(s, count, keys, 0), lists, list_heads)
    return v


def _runs_loop(
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
    # The runs; their records as floats, too.
    runs: Any,
    sums: Any,
    lists: Any,
    list_heads: Any,
    nodes: Any,
    counts: Any,
    # The matches: records of runs, and from when on no later row changes them.
    out: Any,
    out_sums: Any,
    due: Any,
    # From `scratch`.
    work: Any,
    numbers: Any,
) -> Any:
    """Take rows from ``begin`` on; return the row before which an array was full, or their
    number."""
    plan = settings, run_keys, steps, each, accumulators, aggregates, probes, buffers
    tests = table, floats, conditions, factors, code, constants, work[INTEGERS], numbers
    store = ends, rows, vectors, heads
    state = runs, sums, lists, list_heads, nodes, counts
    given = out, out_sums, due, marks
    n, kleene = settings[COUNT], settings[KLEENE]
    is_contiguous = settings[IS_CONTIGUOUS] != 0
    every = (1 << n) - 1
    bound, keys, dead, taking, going = (
        work[BOUND],
        work[KEYS],
        work[DEAD],
        work[TAKING],
        work[GOING],
    )
    mark_dead(buffers, dead, marks)
    for i in range(begin, batch.shape[0]):
        suits = kinds[kind[i]] if kind[i] >= 0 else 0
        if not is_in_time(i, batch, suits, settings[PART_WORD], marks, times):
            continue
        if settings[PART_WORD]:
            mark_dead(buffers, dead, marks)
        if suits == 0 and not is_contiguous:
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
        mask = mask_of(row, suits, own, plan, tests, bound)
        if mask == 0 and not is_contiguous:
            continue
        # The states whose runs it may move, as bits; the lists of these runs, and room for what
        # comes of them.
        takes_of = every if is_contiguous else kleene & mask
        goes_of = (mask >> 1) & (every >> 1)
        needed, s = 1, 0
        while (takes_of | goes_of) >> s:
            taking[s] = going[s] = -1
            if (takes_of >> s) & 1:
                taking[s] = list_with(s, s, row, plan, tests, state, keys)
            if (goes_of >> s) & 1:
                going[s] = list_with(s, s + 1, row, plan, tests, state, keys)
            if taking[s] >= 0:
                needed += lists[taking[s], LENGTH]
            if going[s] >= 0 and going[s] != taking[s]:
                needed += lists[going[s], LENGTH]
            s += 1
        counts[NEEDED], counts[NODES_NEEDED] = needed, 2 * needed
        if marks[OUT] + needed > out.shape[0]:
            marks[IS_OUT_FULL] = 1
            return i
        if (
            counts[LIVE] + needed > runs.shape[0]
            or counts[LISTS] + n > lists.shape[0]
            or (settings[LISTED] and counts[NODES] + 2 * needed > nodes.shape[0])
        ):
            return i
        is_used = False
        if mask >> n:
            stored = put(
                row, mask, settings[MOST_CANDIDATES], dead, work[FOUND], keys, buffers, table, ends,
                rows, vectors, heads, marks,
            )  # fmt: skip
            if stored < 0:
                return i
            is_used = stored > 0
        marks[ROWS] = row + 1
        marks[FIRST_OUT], marks[IS_SHORT] = marks[OUT], 0
        while s > 0:
            s -= 1
            takes = ((kleene & mask) >> s) & 1 != 0
            is_one = going[s] == taking[s]
            if going[s] >= 0 and lists[going[s], HEAD] >= 0:
                is_used = (
                    visit_list(
                        s, going[s], row, takes and is_one, True, plan, tests, store, state, given,
                        work,
                    )
                    or is_used
                )  # fmt: skip
            if taking[s] >= 0 and not is_one and lists[taking[s], HEAD] >= 0:
                is_used = (
                    visit_list(
                        s, taking[s], row, takes, False, plan, tests, store, state, given, work
                    )
                    or is_used
                )  # fmt: skip
        if mask & 1:
            is_used = start_run(row, plan, tests, store, state, given, work) or is_used
        marks[MADE] += marks[OUT] - marks[FIRST_OUT]
        marks[CUT_SHORT] += marks[IS_SHORT]
        if not is_used:
            marks[ROWS] = row
    return batch.shape[0]


def _asks_loop(
    matches: Any,
    match_sums: Any,
    settings: Any,
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
    table: Any,
    floats: Any,
    ends: Any,
    rows: Any,
    vectors: Any,
    heads: Any,
    hold: Any,
    work: Any,
    numbers: Any,
) -> None:
    """Ask all probes of matches whose probes can be answered."""
    plan = settings, run_keys, steps, each, accumulators, aggregates, probes, buffers
    tests = table, floats, conditions, factors, code, constants, work[INTEGERS], numbers
    for m in range(matches.shape[0]):
        bind(matches, match_sums, m, plan, tests, work[BOUND])
        hold[m] = True
        for p in range(probes.shape[0]):
            said = answer(
                probes[p], settings[COUNT], TIME_MAX, work[BOUND], work[KEYS], work[INTEGERS],
                numbers, buffers, conditions, factors, code, constants, table, floats, ends, rows,
                vectors, heads,
            )  # fmt: skip
            if said == VIOLATED:
                hold[m] = False
                break


IN_LOOP: Final = (
    *CALLED, *IN_RUNS, is_in_time, mark_dead, bind, add_row, all_hold, bind_next, give_out,
    visit_list, start_run, mask_of, list_with,
)  # fmt: skip


def _types() -> tuple[Any, ...]:
    from numba import types

    row, table = types.int64[::1], types.int64[:, ::1]
    return types, row, table, types.float64[:, ::1], types.float64[::1]


def _runs_signature() -> Any:
    types, row, table, floats, numbers = _types()
    plan = (row, row, row, table, table, row, table, table, table, table)
    conditions = (table, floats, table, numbers)
    store = (table, floats, row, row, table, row, row, table)
    state = (table, floats, table, row, table, row)
    given = (table, floats, row)
    return types.int64(
        table, row, types.int64, *plan, *conditions, *store, *state, *given, table, numbers
    )


def _asks_signature() -> Any:
    types, row, table, floats, numbers = _types()
    plan = (row, table, table, row, table, table, table, table)
    conditions = (table, floats, table, numbers)
    store = (table, floats, row, row, table, row)
    return types.void(table, floats, *plan, *conditions, *store, types.boolean[::1], table, numbers)


_runs = Kernel(_runs_loop, _runs_signature, allocates=False, calls=IN_LOOP)
_asks = Kernel(_asks_loop, _asks_signature, allocates=False, calls=IN_LOOP)


def scratch(
    buffers: NDArray[np.int64], keys: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The last two arguments of `run` and `ask`, for a plan with these buffers and keys of runs."""
    size = max(STACK, SLOTS, *buffers.shape, *keys.shape)
    return np.zeros((WORK, size), np.int64), np.zeros(STACK, np.float64)


def run(*arguments: Any) -> int:
    """Run the loop over rows, as `_runs_loop` says."""
    return int(_runs.run(*arguments, size=len(arguments[0])))


def ask(*arguments: Any) -> None:
    """Ask the probes of matches, as `_asks_loop` says."""
    _asks.run(*arguments, size=len(arguments[0]))
