"""The compiled join: each match of a plan, found from its last row (SPEC §8).

A row that may be the last of a match is bound to its element. Then the other elements are bound in
the plan's order, depth first: the minimal network gives the window of ends, a vector of `store` the
rows in it. Where nothing is left to ask, all rows of the window are matches.

The loop stops before a row when an array is full and continues there when it is called again: of a
row either all matches are made or none.

The file is long because the loop is one function: calls would cost time in its inner part.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....streams.jit import Kernel
from ....streams.time import TIME_MAX, TIME_MIN
from ..plans.network import INFINITE
from ..plans.plan import MOST_ELEMENTS, NO_VALUE
from .conditions import END, STACK, START, compares, holds, number_at
from .packing import (
    ASKS_STATE,
    BELOW,
    BUFFER,
    CONDITION,
    COUNT,
    ELEMENT,
    HAS_INTERVALS,
    HIGH,
    HIGH_OFFSET,
    HIGH_START,
    IS_DISTINCT,
    IS_ORDERED,
    IS_WHOLE,
    KEY_COUNT,
    LEAST,
    LEVEL_KEYS,
    LOW,
    LOW_OFFSET,
    LOW_START,
    MAY_REPEAT,
    MOST,
    MOST_CANDIDATES,
    MOST_MATCHES,
    PART_WORD,
    PROBE_BELOW,
    PROBE_CONDITION,
    PROBE_KEYS,
    PROBED,
    RETAINED,
)
from .store import (
    BASE,
    CUT_SHORT,
    DECIDED,
    DECISIONS,
    FIRST,
    IN_LOOPS,
    IS_FULL,
    IS_OUT_FULL,
    LATE,
    LOOKED_AT,
    MADE,
    OUT,
    ROWS,
    STOP,
    UNSTORED,
    WATERMARK,
    WATERMARKS,
    first_at_least,
    hashed,
    put,
    remove,
    vector_of,
)

VIOLATED, OPEN, HOLDS = -1, 0, 1
"""The answers of a probe; open: rows that may still come change it."""


def plus(time: int, duration: int) -> Any:
    """A sum that stops at the ends of 64 bits."""
    if duration > 0:
        return TIME_MAX if time > TIME_MAX - duration else time + duration
    return TIME_MIN if time < TIME_MIN - duration else time + duration


def bucket(
    buffer: int,
    first: int,
    pairs: Any,
    bound: Any,
    keys: Any,
    buffers: Any,
    table: Any,
    vectors: Any,
    heads: Any,
) -> Any:
    """The vector of a buffer with the keys of bound rows: their elements and words are pairs from
    ``first`` on. -1: there is none."""
    count = buffers[buffer, KEY_COUNT]
    for i in range(count):
        keys[i] = table[bound[pairs[first + 2 * i]], pairs[first + 2 * i + 1]]
        if keys[i] == NO_VALUE:
            return -1
    _, v = vector_of(buffer, count, keys, hashed(buffer, count, keys, 0), vectors, heads)
    return v


def answer(
    probe: Any,
    count: int,
    now: int,
    bound: Any,
    keys: Any,
    integers: Any,
    numbers: Any,
    buffers: Any,
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
) -> Any:
    """What a probe says of the rows bound when all rows with ends before ``now`` are known."""
    low = plus(table[bound[probe[LOW]], START if probe[LOW_START] else END], probe[LOW_OFFSET])
    high = plus(table[bound[probe[HIGH]], START if probe[HIGH_START] else END], probe[HIGH_OFFSET])
    v = bucket(probe[PROBED], PROBE_KEYS, probe, bound, keys, buffers, table, vectors, heads)
    first, stop = 0, 0
    if v >= 0:
        first, stop = vectors[v, BASE] + vectors[v, FIRST], vectors[v, BASE] + vectors[v, STOP]
    if probe[ASKS_STATE]:
        if low >= now:
            return OPEN
        after = first_at_least(ends, first, stop, low + 1)
        if after == first:
            return VIOLATED
        bound[count] = rows[after - 1]
        for c in range(probe[PROBE_CONDITION], probe[PROBE_BELOW]):
            if not holds(
                c, bound, table, floats, conditions, factors, code, constants, integers, numbers
            ):
                return VIOLATED
        return HOLDS
    if low > high:
        return HOLDS if probe[LEAST] <= 0 else VIOLATED
    found = 0
    at = first_at_least(ends, first, stop, low)
    if probe[PROBE_CONDITION] == probe[PROBE_BELOW]:
        found = (stop if high == TIME_MAX else first_at_least(ends, at, stop, high + 1)) - at
    else:
        while at < stop and ends[at] <= high:
            bound[count] = rows[at]
            is_counted = True
            for c in range(probe[PROBE_CONDITION], probe[PROBE_BELOW]):
                if not holds(
                    c, bound, table, floats, conditions, factors, code, constants, integers, numbers
                ):
                    is_counted = False
                    break
            if is_counted:
                found += 1
            at += 1
    if found > probe[MOST]:
        return VIOLATED
    if high >= now:
        return OPEN
    return HOLDS if found >= probe[LEAST] else VIOLATED


def meets_hulls(hulls: Any, bound: Any, table: Any) -> Any:
    """Whether both sides of each hull begin and end together."""
    for h in range(hulls.shape[0]):
        start_left = start_right = TIME_MAX
        end_left = end_right = TIME_MIN
        for e in range(MOST_ELEMENTS):
            if (hulls[h, 0] >> e) & 1:
                start_left = min(start_left, table[bound[e], START])
                end_left = max(end_left, table[bound[e], END])
            if (hulls[h, 1] >> e) & 1:
                start_right = min(start_right, table[bound[e], START])
                end_right = max(end_right, table[bound[e], END])
        if start_left != start_right or end_left != end_right:
            return False
    return True


def starts_fit(
    j: int, row: int, level: int, first: int, levels: Any, greatest: Any, bound: Any, table: Any
) -> Any:
    """Whether the bounds on starts hold between a row for element j and what is bound."""
    n = greatest.shape[0] // 2
    start, end = table[row, START], table[row, END]
    for q in range(level):
        b = levels[first + q, ELEMENT]
        other_start, other_end = table[bound[b], START], table[bound[b], END]
        if (
            start - other_start > greatest[n + b, n + j]
            or other_start - start > greatest[n + j, n + b]
            or start - other_end > greatest[b, n + j]
            or other_end - start > greatest[n + j, b]
            or end - other_start > greatest[n + b, j]
            or other_start - end > greatest[j, n + b]
        ):
            return False
    return True


def _join_loop(
    # The rows: records and the numbers of their sources; the row to begin with.
    batch: Any,
    kind: Any,
    begin: int,
    # The plan (`packing`).
    settings: Any,
    kinds: Any,
    own: Any,
    triggers: Any,
    levels: Any,
    greatest: Any,
    buffers: Any,
    probes: Any,
    hulls: Any,
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
    # The matches: the places of their rows, and from when on no later row changes them.
    out: Any,
    due: Any,
    # From `scratch`.
    words: Any,
    numbers: Any,
) -> Any:
    """Take rows from ``begin`` on; return the row before which an array was full, or their number.
    ``due`` is only written where there are probes."""
    n = settings[COUNT]
    has_intervals, is_distinct = settings[HAS_INTERVALS] != 0, settings[IS_DISTINCT] != 0
    probe_count, width = probes.shape[0], table.shape[1]
    bound, at, stop, high = words[0], words[1], words[2], words[3]
    found, dead, keys, integers = words[4], words[5], words[6], words[7]
    for b in range(buffers.shape[0]):
        dead[b] = plus(marks[DECIDED], -buffers[b, RETAINED])
    for i in range(begin, batch.shape[0]):
        suits = kinds[kind[i]] if kind[i] >= 0 else 0
        now = batch[i, END]
        if settings[PART_WORD] != 0:
            # The row's part has its own time.
            part = batch[i, settings[PART_WORD]]
            marks[WATERMARK], marks[DECIDED] = times[WATERMARKS, part], times[DECISIONS, part]
            for b in range(buffers.shape[0]):
                dead[b] = plus(marks[DECIDED], -buffers[b, RETAINED])
            if settings[IS_ORDERED] and now > times[WATERMARKS, part]:
                times[WATERMARKS, part] = now
        if now < marks[WATERMARK]:
            marks[LATE] += suits != 0
            continue
        if settings[IS_ORDERED]:
            marks[WATERMARK] = now
        if suits == 0:
            continue
        row = marks[ROWS]
        marks[IS_OUT_FULL] = 0
        if row == table.shape[0]:
            return i
        for word in range(width):
            table[row, word] = batch[i, word]
        bound[n] = row
        mask, e = 0, 0
        while suits >> e:
            if (suits >> e) & 1:
                fits = True
                if has_intervals and e < n:
                    lasts = now - table[row, START]
                    fits = 0 <= lasts <= greatest[n + e, e] and -lasts <= greatest[e, n + e]
                for c in range(own[e], own[e + 1]):
                    if not fits:
                        break
                    fits = holds(
                        c,
                        bound,
                        table,
                        floats,
                        conditions,
                        factors,
                        code,
                        constants,
                        integers,
                        numbers,
                    )
                if fits:
                    mask |= 1 << e
            e += 1
        if mask == 0:
            continue
        marks[ROWS] = row + 1
        first_made, looked, made = marks[OUT], 0, 0
        stored = 0
        if not (is_distinct or marks[IS_FULL]):
            # A row may suit two elements of a match: it is found beside itself.
            stored = put(
                row,
                mask,
                settings[MOST_CANDIDATES],
                dead,
                found,
                keys,
                buffers,
                table,
                ends,
                rows,
                vectors,
                heads,
                marks,
            )
            if stored < 0:
                marks[ROWS] = row
                return i
        is_short = is_crowded = False
        for g in range(triggers.shape[0]):
            e = triggers[g]
            if is_short or is_crowded or not (mask >> e) & 1:
                continue
            bound[e] = row
            top = g * n
            goes_on = True
            for c in range(levels[top, CONDITION], levels[top, BELOW]):
                goes_on = goes_on and holds(
                    c, bound, table, floats, conditions, factors, code, constants, integers, numbers
                )
            level = 1 if goes_on else 0
            is_new = True
            while level > 0:
                if level == n:
                    until = now
                    is_match = meets_hulls(hulls, bound, table)
                    for p in range(probe_count):
                        if not is_match:
                            break
                        said = answer(
                            probes[p], n, now, bound, keys, integers, numbers, buffers,
                            conditions, factors, code, constants,
                            table, floats, ends, rows, vectors, heads,
                        )  # fmt: skip
                        if said == VIOLATED:
                            is_match = False
                        elif said == OPEN:
                            last = table[
                                bound[probes[p, HIGH]], START if probes[p, HIGH_START] else END
                            ]
                            until = max(until, plus(plus(last, probes[p, HIGH_OFFSET]), 1))
                    if is_match:
                        if made >= settings[MOST_MATCHES]:
                            is_short = True
                            break
                        if marks[OUT] == out.shape[0]:
                            is_crowded = True
                            marks[IS_OUT_FULL] = 1
                            break
                        for x in range(n):
                            out[marks[OUT], x] = bound[x]
                        if probe_count:
                            due[marks[OUT]] = until
                        marks[OUT] += 1
                        made += 1
                    level -= 1
                    is_new = False
                    continue
                step = levels[top + level]
                j = step[ELEMENT]
                if is_new:
                    low, most = TIME_MIN, TIME_MAX
                    for q in range(level):
                        b = levels[top + q, ELEMENT]
                        time = table[bound[b], END]
                        if greatest[j, b] < INFINITE:
                            low = max(low, plus(time, -greatest[j, b]))
                        if greatest[b, j] < INFINITE:
                            most = min(most, plus(time, greatest[b, j]))
                    v = bucket(
                        step[BUFFER], LEVEL_KEYS, step, bound, keys, buffers, table, vectors, heads
                    )
                    at[level], stop[level], high[level] = 0, 0, most
                    if v >= 0:
                        stop[level] = vectors[v, BASE] + vectors[v, STOP]
                        at[level] = first_at_least(
                            ends, vectors[v, BASE] + vectors[v, FIRST], stop[level], low
                        )
                place, below, most = at[level], stop[level], high[level]
                if step[IS_WHOLE]:
                    if most < TIME_MAX:
                        below = first_at_least(ends, place, below, most + 1)
                    looked += below - place
                    size = min(below - place, settings[MOST_MATCHES] - made)
                    is_short = size < below - place
                    o = marks[OUT]
                    if o + size > out.shape[0]:
                        is_crowded = True
                        marks[IS_OUT_FULL] = 1
                        break
                    for x in range(n):
                        if x != j:
                            same = bound[x]
                            for y in range(size):
                                out[o + y, x] = same
                    for y in range(size):
                        out[o + y, j] = rows[place + y]
                    marks[OUT] = o + size
                    made += size
                    if is_short:
                        break
                    level -= 1
                    is_new = False
                    continue
                is_bound = False
                while place < below and ends[place] <= most:
                    candidate = rows[place]
                    place += 1
                    looked += 1
                    fits = True
                    if step[MAY_REPEAT]:
                        if is_distinct:
                            for q in range(level):
                                fits = fits and bound[levels[top + q, ELEMENT]] != candidate
                        elif candidate == row:
                            # It is found once: from the first of the elements that it is bound to.
                            for q in range(g):
                                fits = fits and triggers[q] != j
                    if fits and has_intervals:
                        fits = starts_fit(j, candidate, level, top, levels, greatest, bound, table)
                    bound[j] = candidate
                    for c in range(step[CONDITION], step[BELOW]):
                        if not fits:
                            break
                        fits = holds(
                            c,
                            bound,
                            table,
                            floats,
                            conditions,
                            factors,
                            code,
                            constants,
                            integers,
                            numbers,
                        )
                    if fits:
                        is_bound = True
                        break
                at[level] = place
                if is_bound:
                    level += 1
                    is_new = True
                else:
                    level -= 1
                    is_new = False
        if is_distinct and not is_crowded and not marks[IS_FULL]:
            stored = put(
                row,
                mask,
                settings[MOST_CANDIDATES],
                dead,
                found,
                keys,
                buffers,
                table,
                ends,
                rows,
                vectors,
                heads,
                marks,
            )
            is_crowded = stored < 0
        if is_crowded:
            if not is_distinct:
                for b in range(buffers.shape[0]):
                    if stored > 0 and found[b] >= 0:
                        remove(found[b], row, vectors, ends, rows)
            marks[OUT], marks[ROWS] = first_made, row
            return i
        marks[LOOKED_AT] += looked
        marks[MADE] += made
        marks[CUT_SHORT] += is_short
        marks[UNSTORED] += marks[IS_FULL]
        if stored == 0 and made == 0:
            marks[ROWS] = row
    return batch.shape[0]


def _answers_loop(
    matches: Any,
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
    words: Any,
    numbers: Any,
) -> None:
    """Ask all probes of matches whose probes can be answered."""
    n = matches.shape[1]
    bound, keys, integers = words[0], words[6], words[7]
    for m in range(matches.shape[0]):
        for x in range(n):
            bound[x] = matches[m, x]
        hold[m] = True
        for p in range(probes.shape[0]):
            said = answer(
                probes[p], n, TIME_MAX, bound, keys, integers, numbers, buffers,
                conditions, factors, code, constants,
                table, floats, ends, rows, vectors, heads,
            )  # fmt: skip
            if said == VIOLATED:
                hold[m] = False
                break


CALLED: Final = (
    *IN_LOOPS, compares, number_at, holds, plus, bucket, answer, meets_hulls, starts_fit,
)  # fmt: skip


def _types() -> tuple[Any, ...]:
    from numba import types

    row, table = types.int64[::1], types.int64[:, ::1]
    return types, row, table, types.float64[:, ::1], types.float64[::1]


def _join_signature() -> Any:
    types, row, table, floats, numbers = _types()
    plan = (row, row, row, row, table, table, table, table, table)
    conditions = (table, floats, table, numbers)
    store = (table, floats, row, row, table, row, row, table)
    return types.int64(
        table, row, types.int64, *plan, *conditions, *store, table, row, table, numbers
    )


def _answers_signature() -> Any:
    types, row, table, floats, numbers = _types()
    conditions = (table, floats, table, numbers)
    store = (table, floats, row, row, table, row)
    return types.void(table, table, table, *conditions, *store, types.boolean[::1], table, numbers)


_join = Kernel(_join_loop, _join_signature, allocates=False, calls=CALLED)
_answers = Kernel(_answers_loop, _answers_signature, allocates=False, calls=CALLED)


def scratch(buffers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The last two arguments of `join` and `ask`, for a plan with these buffers."""
    size = max(STACK, MOST_ELEMENTS + 1, *buffers.shape)
    return np.zeros((8, size), np.int64), np.zeros(STACK, np.float64)


def join(*arguments: Any) -> int:
    """Run the join over rows, as `_join_loop` says."""
    return int(_join.run(*arguments, size=len(arguments[0])))


def ask(*arguments: Any) -> None:
    """Ask the probes of matches, as `_answers_loop` says."""
    _answers.run(*arguments, size=len(arguments[0]))
