"""The compiled join of triple patterns: one loop for every query, which reads the patterns as data.

The rows are those of `row_kernels`. Solutions are kept from one evaluation to the next: that is
semi-naive evaluation. Solutions with a removed row are dropped. New ones are found pattern by
pattern: the new rows of one (its delta) are joined with the old rows of the patterns before it and
all rows of those after it, so that none is found twice. The patterns are ordered by selectivity and
matched as nested loops, along a hash chain if an end is bound. `solver` makes the tables and reads
the results. The loop is the same in plain Python (``py_func``).

It is one function of four hundred lines, and makes this file long: compiled code can only call
compiled code, and calls would cost time in the inner loop. Comments head its parts instead.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...streams.jit import Kernel
from ..values.decimals import POWERS
from .row_kernels import (
    BY_OBJECT,
    BY_SLOT,
    BY_SUBJECT,
    BY_TRIPLE,
    COUNT,
    FLOOR,
    HIGH,
    LASTING,
    LINKS,
    LOST,
    LOW,
    PLACE,
    SEEN_MASK,
    STATE_SHIFT,
    SUBJECT,
    TAG_MASK,
    TAG_SHIFT,
    VISIBLE,
    WAYS,
)

# The operations of a filter: push a value on the stack, or combine the last ones.
CONSTANT, VARIABLE, ADD, SUBTRACT, MULTIPLY, DIVIDE = 0, 1, 2, 3, 4, 5
EQUAL, UNEQUAL, LESS, LESS_EQUAL, GREATER, GREATER_EQUAL = 6, 7, 8, 9, 10, 11
AND, OR, NOT, NEGATE = 12, 13, 14, 15

LONGS = 9
"""`literals.Sort`: terms of this sort and above may be equal in value though their ids differ."""
OVERSPENT = -2
"""The result of `match` if it visited more rows than allowed."""
DOUBTFUL = -1
"""The result of `match` if a filter meets values that only `expression_evaluation` can compare."""

# A step of the join, one per depth: its slot, subject, object and way, which ends are bound before,
# the bounds of its rows (from, below), and whether it continues with static rows.
AT_SLOT, AT_SUBJECT, AT_OBJECT, AT_WAY, KNOWS_SUBJECT, KNOWS_OBJECT, ABOVE, BELOW = range(8)
GOES_ON, STEP = 8, 9

STATIC = -1
"""Stands for a static row in a solution."""


def _match(
    # The rows of the windows, and the static ones; the number of visible ones by slot.
    rows: Any,
    heads: Any,
    sizes: Any,
    visible: Any,
    floors: Any,
    marks: Any,
    static_rows: Any,
    static_heads: Any,
    static_sizes: Any,
    static_visible: Any,
    # Rows from here on are new, with their number by slot; ``from_scratch``: all rows are new.
    first_new: int,
    new: Any,
    from_scratch: bool,
    windows: int,
    # One row per pattern: slot, subject and object, each a variable, or a constant as -1 - i.
    patterns: Any,
    needed: Any,
    constant_tags: Any,
    constant_bits: Any,
    # The filters: one row per operation (code, argument), their starts, the variables they need.
    operations: Any,
    filter_starts: Any,
    filter_needs: Any,
    term_sorts: Any,
    # By variable: its output row, or -1.
    shown: Any,
    # The solutions: a row of each pattern, then the oldest of them; the first ``kept`` are known.
    solutions: Any,
    kept: int,
    out_tags: Any,
    out_bits: Any,
    uniform: Any,
    # The limit of visited rows, or below 0.
    visit_limit: int,
) -> tuple[int, int]:
    """Write the solutions, a row per variable. Return how many old ones stayed, and how many there
    are now (they may not have fitted), or `DOUBTFUL` or `OVERSPENT`. If ``solutions`` has no
    columns, nothing is kept for the next evaluation. ``uniform``: the common tag of a variable's
    values, or -1."""
    pattern_count = patterns.shape[0]
    variable_count = shown.shape[0]
    shown_count = out_tags.shape[0]
    slot_count = visible.shape[0]
    capacity = out_tags.shape[1]
    keeps = solutions.shape[1] > 0
    floor = marks[FLOOR]
    # The solutions that stay. With one window and no copies rows expire in order, which is simpler.
    found = np.int64(0)
    simple = windows == 1 and marks[LASTING] == 0
    for n in range(kept):
        stays = solutions[n, pattern_count] >= floor
        if not simple:
            stays = True
            for p in range(pattern_count):
                r = solutions[n, p]
                if r == LOST or (r >= 0 and rows[r, PLACE] >> STATE_SHIFT != VISIBLE):
                    stays = False
                    break
        if stays:
            if found < n:
                for p in range(pattern_count + 1):
                    solutions[found, p] = solutions[n, p]
                for v in range(shown_count):
                    out_tags[v, found] = out_tags[v, n]
                    out_bits[v, found] = out_bits[v, n]
            found += 1
    stayed = found
    visited = np.int64(0)
    order = np.empty(pattern_count, np.int64)
    ways = np.empty(pattern_count, np.int64)
    chosen = np.zeros(pattern_count, np.bool_)
    bound = np.zeros(variable_count + 1, np.bool_)
    filter_count = filter_starts.shape[0] - 1
    filter_depth = np.zeros(filter_count, np.int64)
    stack_tags = np.zeros(64, np.int64)
    stack_numbers = np.zeros(64, np.float64)
    stack_ids = np.zeros(64, np.int64)
    # The values of variables, then those of constants.
    value_tags = np.zeros(variable_count + constant_tags.shape[0] + 1, np.int64)
    value_bits = np.zeros(variable_count + constant_tags.shape[0] + 1, np.int64)
    for n in range(constant_tags.shape[0]):
        value_tags[variable_count + n] = constant_tags[n]
        value_bits[variable_count + n] = constant_bits[n]
    step = np.empty((pattern_count, STEP), np.int64)
    cursor = np.full(pattern_count + 1, -2, np.int64)
    on_static = np.zeros(pattern_count + 1, np.bool_)
    # One round per pattern that may have new rows; from scratch, one round over all rows.
    for delta in range(1 if from_scratch else pattern_count):
        possible = from_scratch or new[patterns[delta, 0]] > 0
        for p in range(pattern_count):
            slot = patterns[p, 0]
            number = visible[slot] + static_visible[slot]
            # Patterns before the delta read old rows: without any the round finds nothing.
            if number == 0 or (not from_scratch and p < delta and number == new[slot]):
                possible = False
        if not possible:
            continue
        # Order the patterns greedily by cost, and choose how to find the rows of each.
        chosen[:] = False
        bound[:] = False
        for depth in range(pattern_count):
            best, best_cost, best_way = -1, 1e300, 0
            for p in range(pattern_count):
                if chosen[p]:
                    continue
                slot, s, o = patterns[p, 0], patterns[p, 1], patterns[p, 2]
                if p == delta and not from_scratch:
                    number = float(new[slot])
                else:
                    number = float(visible[slot] + static_visible[slot])
                subject_bound = s < 0 or bound[s]
                object_bound = o < 0 or bound[o]
                if subject_bound and object_bound:
                    cost, way = 0.5, BY_TRIPLE if needed[slot] & 8 else BY_SUBJECT
                elif subject_bound:
                    # A constant subject may have most rows of a slot.
                    cost, way = 1.0 + (0.01 * number if s < 0 else 0.0), BY_SUBJECT
                elif object_bound:
                    cost, way = 2.0 + 0.1 * number, BY_OBJECT
                    if o >= 0:
                        cost = 2.0 + 0.01 * number
                else:
                    cost, way = 3.0 + number, BY_SLOT
                for f in range(filter_count):
                    # Of equal costs prefer a pattern with a filter: fewer rows remain.
                    if (s >= 0 and filter_needs[f, s]) or (o >= 0 and filter_needs[f, o]):
                        cost -= 0.25
                        break
                if not (s >= 0 and bound[s]) and not (o >= 0 and bound[o]) and depth > 0:
                    # It shares no variable with the bound ones: a product.
                    cost = cost * 4.0 + 4.0
                if cost < best_cost:
                    best, best_cost, best_way = p, cost, way
            chosen[best] = True
            order[depth] = best
            ways[depth] = best_way
            if patterns[best, 1] >= 0:
                bound[patterns[best, 1]] = True
            if patterns[best, 2] >= 0:
                bound[patterns[best, 2]] = True
        # Each filter runs at the depth at which all its variables are bound.
        filter_depth[:] = 0
        for f in range(filter_count):
            for depth in range(pattern_count):
                p = order[depth]
                for side in range(1, 3):
                    v = patterns[p, side]
                    if v >= 0 and filter_needs[f, v] and filter_depth[f] < depth:
                        first = True
                        for before in range(depth):
                            q = order[before]
                            if patterns[q, 1] == v or patterns[q, 2] == v:
                                first = False
                        if first:
                            filter_depth[f] = depth
        # The steps: which ends are bound at each depth, and between which rows it searches.
        bound[:] = False
        for depth in range(pattern_count):
            p = order[depth]
            slot, s, o = patterns[p, 0], patterns[p, 1], patterns[p, 2]
            step[depth, AT_SLOT] = slot
            step[depth, AT_WAY] = ways[depth]
            step[depth, AT_SUBJECT] = s if s >= 0 else variable_count - 1 - s
            step[depth, AT_OBJECT] = o if o >= 0 else variable_count - 1 - o
            step[depth, KNOWS_SUBJECT] = 1 if s < 0 or bound[s] else 0
            step[depth, KNOWS_OBJECT] = 1 if o < 0 or bound[o] else 0
            step[depth, ABOVE] = first_new if p == delta and not from_scratch else floors[slot]
            step[depth, BELOW] = first_new if p < delta and not from_scratch else marks[COUNT]
            # Static rows are never new, so the delta does not read them.
            goes_on = static_visible[slot] > 0 and (p != delta or from_scratch)
            step[depth, GOES_ON] = 1 if goes_on else 0
            if s >= 0:
                bound[s] = True
            if o >= 0:
                bound[o] = True
        # Nested loops without recursion; a cursor per depth: its row, and on which side it is.
        cursor[:] = -2
        on_static[:] = False
        depth = 0
        while depth >= 0:
            if visit_limit >= 0 and visited > visit_limit:
                return OVERSPENT, OVERSPENT
            if depth == pattern_count:
                # Solutions beyond the capacity are counted: the caller then makes room for all.
                if found < capacity:
                    for v in range(variable_count):
                        if shown[v] >= 0:
                            out_tags[shown[v], found] = value_tags[v]
                            out_bits[shown[v], found] = value_bits[v]
                    if keeps:
                        oldest = np.int64(2147483647)
                        for d in range(pattern_count):
                            if on_static[d]:
                                solutions[found, order[d]] = STATIC
                            else:
                                solutions[found, order[d]] = cursor[d]
                                oldest = min(oldest, cursor[d])
                        solutions[found, pattern_count] = oldest
                found += 1
                depth -= 1
                continue
            slot, way = step[depth, AT_SLOT], step[depth, AT_WAY]
            s, o = step[depth, AT_SUBJECT], step[depth, AT_OBJECT]
            subject_known, object_known = step[depth, KNOWS_SUBJECT], step[depth, KNOWS_OBJECT]
            above, below = step[depth, ABOVE], step[depth, BELOW]
            at, static_side = cursor[depth], on_static[depth]
            matched = False
            # A number cannot be a subject: then there is nothing to search.
            while not subject_known or value_tags[s] == 0:
                visited += 1
                if at == -2:
                    # Find the head of the chain.
                    if way == BY_SLOT:
                        key, static_key = slot, slot
                    else:
                        if way == BY_SUBJECT:
                            key = (value_bits[s] + (value_bits[s] >> 8)) * slot_count + slot
                        else:
                            key = value_bits[o] ^ (value_bits[o] >> 32) ^ (value_bits[o] >> 45)
                            key = (key & 0x7FFFFFFF) * 40503 + slot * 9973
                            if way == BY_TRIPLE:
                                key = key + value_bits[s] * 2246822519 + value_tags[o] * 131
                            key = key ^ (key >> 16)
                        static_key = key & (static_sizes[way] - 1)
                        key = key & (sizes[way] - 1)
                    if static_side:
                        at = np.int64(static_heads[static_key + static_sizes[WAYS + way]])
                    else:
                        at = np.int64(heads[key + sizes[WAYS + way]])
                elif static_side:
                    at = np.int64(static_rows[at, LINKS + way])
                else:
                    at = np.int64(rows[at, LINKS + way])
                if static_side:
                    if at < 0:
                        break
                    place = np.int64(static_rows[at, PLACE])
                    row_subject = np.int64(static_rows[at, SUBJECT])
                    low, high = np.int64(static_rows[at, LOW]), np.int64(static_rows[at, HIGH])
                else:
                    # A chain goes from new to old, so all further rows are below the bound, too.
                    if at < above:
                        if step[depth, GOES_ON] == 0:
                            break
                        at, static_side = np.int64(-2), True
                        continue
                    if at >= below:
                        continue
                    place = np.int64(rows[at, PLACE])
                    row_subject = np.int64(rows[at, SUBJECT])
                    low, high = np.int64(rows[at, LOW]), np.int64(rows[at, HIGH])
                # A chain has rows of other slots with the same hash, and rows that are not visible.
                if place & SEEN_MASK != slot:
                    continue
                if subject_known and row_subject != value_bits[s]:
                    continue
                row_tag = (place >> TAG_SHIFT) & TAG_MASK
                row_bits = (high << 32) | (low & 0xFFFFFFFF)
                if object_known:
                    if row_bits != value_bits[o] or row_tag != value_tags[o]:
                        continue
                elif s == o and (row_tag != 0 or row_bits != row_subject):
                    continue
                matched = True
                break
            if not matched:
                cursor[depth] = -2
                on_static[depth] = False
                depth -= 1
                continue
            cursor[depth] = at
            on_static[depth] = static_side
            if not subject_known:
                value_tags[s] = 0
                value_bits[s] = row_subject
            if not object_known:
                value_tags[o] = row_tag
                value_bits[o] = row_bits
            # Run the filters of this depth, in three-valued logic; only true passes.
            passes = True
            for f in range(filter_count):
                if filter_depth[f] != depth:
                    continue
                top = -1
                for k in range(filter_starts[f], filter_starts[f + 1]):
                    what, argument = operations[k, 0], operations[k, 1]
                    if what <= VARIABLE:
                        top += 1
                        if what == CONSTANT:
                            tag, word = np.int64(constant_tags[argument]), constant_bits[argument]
                        else:
                            tag, word = np.int64(value_tags[argument]), value_bits[argument]
                        stack_tags[top] = tag
                        stack_ids[top] = word
                        if tag == 0:
                            stack_numbers[top] = 0.0
                        elif tag == 1 or tag == 5:
                            stack_numbers[top] = float(word)
                            # float64 does not distinguish all integers beyond 2^53.
                            if abs(word) > 9007199254740992:
                                return DOUBTFUL, DOUBTFUL
                        else:
                            stack_numbers[top] = np.int64(word).view(np.float64)
                        continue
                    if what in (NOT, NEGATE):
                        tag = stack_tags[top]
                        if tag == -1:
                            continue
                        if what == NEGATE:
                            if 1 <= tag <= 4:
                                stack_numbers[top] = -stack_numbers[top]
                            else:
                                return DOUBTFUL, DOUBTFUL
                        else:
                            if tag == 0:
                                return DOUBTFUL, DOUBTFUL
                            number = stack_numbers[top]
                            truth = number != 0.0 and number == number
                            stack_tags[top] = 5
                            stack_numbers[top] = 0.0 if truth else 1.0
                        continue
                    a_tag, b_tag = stack_tags[top - 1], stack_tags[top]
                    a, b = stack_numbers[top - 1], stack_numbers[top]
                    a_id, b_id = stack_ids[top - 1], stack_ids[top]
                    top -= 1
                    if what in (AND, OR):
                        if a_tag == 0 or b_tag == 0:
                            return DOUBTFUL, DOUBTFUL
                        a_true = a_tag > 0 and a != 0.0 and a == a
                        b_true = b_tag > 0 and b != 0.0 and b == b
                        decisive = what == OR
                        if (a_tag > 0 and a_true == decisive) or (b_tag > 0 and b_true == decisive):
                            stack_tags[top] = 5
                            stack_numbers[top] = 1.0 if decisive else 0.0
                        elif a_tag < 0 or b_tag < 0:
                            stack_tags[top] = -1
                        else:
                            stack_tags[top] = 5
                            stack_numbers[top] = 0.0 if decisive else 1.0
                        continue
                    if a_tag < 0 or b_tag < 0:
                        stack_tags[top] = -1
                        continue
                    a_number, b_number = 1 <= a_tag <= 4, 1 <= b_tag <= 4
                    if what <= DIVIDE:
                        if not (a_number and b_number):
                            return DOUBTFUL, DOUBTFUL
                        tag = max(a_tag, b_tag)
                        if what == DIVIDE:
                            if b == 0.0:
                                if tag > 2:
                                    # Infinity or NaN.
                                    return DOUBTFUL, DOUBTFUL
                                stack_tags[top] = -1
                                continue
                            tag = max(tag, np.int64(2))
                        if tag != 2:
                            if what == ADD:
                                value = a + b
                            elif what == SUBTRACT:
                                value = a - b
                            elif what == MULTIPLY:
                                value = a * b
                            else:
                                value = a / b
                        else:
                            # As `decimals.combine`: mantissas of a common scale.
                            scale = np.int64(0)
                            while scale <= 15:
                                x = np.rint(a * POWERS[scale + 22])
                                y = np.rint(b * POWERS[scale + 22])
                                if x / POWERS[scale + 22] == a and y / POWERS[scale + 22] == b:
                                    break
                                scale += 1
                            if scale > 15 or abs(x) > 1e15 or abs(y) > 1e15:
                                return DOUBTFUL, DOUBTFUL
                            if what == ADD:
                                value = x + y
                            elif what == SUBTRACT:
                                value = x - y
                            elif what == MULTIPLY:
                                value = x * y
                                scale = scale * 2
                            else:
                                # As `decimals.quotients`, digit by digit.
                                above, below = np.int64(abs(x)), np.int64(abs(y))
                                digits, rest = above // below, above % below
                                scale = np.int64(0)
                                while rest != 0 and digits < 100000000000000 and scale < 22:
                                    digits = digits * 10 + rest * 10 // below
                                    rest = rest * 10 % below
                                    scale += 1
                                if rest != 0:
                                    others = below
                                    while others % 2 == 0:
                                        others = others // 2
                                    while others % 5 == 0:
                                        others = others // 5
                                    if above % others == 0 or scale == 22:
                                        return DOUBTFUL, DOUBTFUL
                                    if 2 * rest > below:
                                        digits += 1
                                value = float(digits)
                                if (x < 0.0) != (y < 0.0):
                                    value = -value
                            if abs(value) > 1e15 or scale > 22:
                                return DOUBTFUL, DOUBTFUL
                            value = value / POWERS[scale + 22]
                        if tag == 1 and abs(value) > 9007199254740992.0:
                            return DOUBTFUL, DOUBTFUL
                        stack_tags[top] = tag
                        stack_numbers[top] = value
                        continue
                    result = False
                    if (a_number and b_number) or (a_tag == 5 and b_tag == 5):
                        if what == EQUAL:
                            result = a == b
                        elif what == UNEQUAL:
                            result = a != b
                        elif what == LESS:
                            result = a < b
                        elif what == LESS_EQUAL:
                            result = a <= b
                        elif what == GREATER:
                            result = a > b
                        else:
                            result = a >= b
                    elif what <= UNEQUAL:
                        same = a_tag == b_tag and a_id == b_id
                        if not same:
                            # Other literals, and numbers that do not fit a column.
                            if a_tag == 0 and not 0 < term_sorts[a_id] < LONGS:
                                return DOUBTFUL, DOUBTFUL
                            if b_tag == 0 and not 0 < term_sorts[b_id] < LONGS:
                                return DOUBTFUL, DOUBTFUL
                        result = same == (what == EQUAL)
                    else:
                        return DOUBTFUL, DOUBTFUL
                    stack_tags[top] = 5
                    stack_numbers[top] = 1.0 if result else 0.0
                if stack_tags[0] == 0:
                    return DOUBTFUL, DOUBTFUL
                if not (
                    stack_tags[0] > 0
                    and stack_numbers[0] != 0.0
                    and stack_numbers[0] == stack_numbers[0]
                ):
                    passes = False
                    break
            if passes:
                depth += 1
    stop = min(found, capacity)
    for v in range(shown_count):
        uniform[v] = 0
        if stop:
            uniform[v] = out_tags[v, 0]
        for n in range(1, stop):
            if out_tags[v, n] != uniform[v]:
                uniform[v] = -1
                break
    return int(stayed), int(found)


def _match_signature() -> Any:
    from numba import types

    int8s, int32s, int64s = types.int8[::1], types.int32[::1], types.int64[::1]
    int32_rows, int64_rows = types.int32[:, ::1], types.int64[:, ::1]
    side = (int32_rows, int32s, int64s, int64s)
    tuple_of: Any = types.UniTuple
    return tuple_of(types.int64, 2)(
        *side,
        int64s,
        int64s,
        *side,
        types.int64,
        int64s,
        types.boolean,
        types.int64,
        int64_rows,
        int64s,
        int8s,
        int64s,
        int64_rows,
        int64s,
        types.boolean[:, ::1],
        int8s,
        int64s,
        int32_rows,
        types.int64,
        types.int8[:, ::1],
        int64_rows,
        int8s,
        types.int64,
    )


match = Kernel(_match, _match_signature)
