"""The compiled join of triple patterns: one loop for every query, which reads its patterns as data.

Triples are numbers here: a *slot* (a predicate in a graph that the query names), a subject id, and
an object as tag and bits (`columns.TermValues.encoded`). `select` picks the rows of the windows
that close, slot by slot; `chain` links rows with an equal end; `match` puts the patterns in order
by how much they leave, and matches one inside the other, along a chain where an end is bound.
`patterns` makes the tables and reads the answers. Each is the same in plain Python (``py_func``).

`_match` is one function of four hundred lines, and makes this file long, because what is compiled
can call nothing that is not: its parts are headed by comments instead of names.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..streams.compiled import Kernel
from .decimals import POWERS

# What a filter does: put a value on the stack, or combine the last ones.
CONSTANT, VARIABLE, ADD, SUBTRACT, MULTIPLY, DIVIDE = 0, 1, 2, 3, 4, 5
EQUAL, UNEQUAL, LESS, LESS_EQUAL, GREATER, GREATER_EQUAL = 6, 7, 8, 9, 10, 11
AND, OR, NOT, NEGATE = 12, 13, 14, 15

DOUBTFUL = -1
"""The answer of `match` where a filter meets what only `evaluation` can judge."""


def _select(
    windows: Any,
    slots: Any,
    subjects: Any,
    tags: Any,
    bits: Any,
    times: Any,
    first: int,
    end: int,
    lows: Any,
    highs: Any,
    sort_starts: Any,
    sort_windows: Any,
    sort_slots: Any,
    sort_classes: Any,
    starts: Any,
) -> tuple[Any, Any, Any, bool]:
    """The rows whose time is within the bounds of their window, slot by slot in order of arrival.

    A row of slot -1 says of what sort its subject is: it becomes a fact a class, from
    ``sort_starts[sort]`` on. ``starts`` takes where each slot begins. Returns subjects, tags, bits
    and whether the rows of each slot are in order of (time, tag).
    """
    slot_count = starts.shape[0] - 1
    starts[:] = 0
    for i in range(first, end):
        w = windows[i]
        if times[i] <= lows[w] or times[i] > highs[w]:
            continue
        if slots[i] >= 0:
            starts[slots[i] + 1] += 1
            continue
        for j in range(sort_starts[bits[i]], sort_starts[bits[i] + 1]):
            if sort_windows[j] == w:
                starts[sort_slots[j] + 1] += 1
    for k in range(slot_count):
        starts[k + 1] += starts[k]
    total = starts[slot_count]
    place = starts[:slot_count].copy()
    last_time = np.full(slot_count, -9223372036854775807, np.int64)
    last_tag = np.zeros(slot_count, np.int64)
    out_subjects = np.empty(total, np.int32)
    out_tags = np.empty(total, np.int8)
    out_bits = np.empty(total, np.int64)
    ordered = True
    for i in range(first, end):
        w = windows[i]
        if times[i] <= lows[w] or times[i] > highs[w]:
            continue
        slot = slots[i]
        if slot >= 0:
            at = place[slot]
            place[slot] = at + 1
            out_subjects[at] = subjects[i]
            out_tags[at] = tags[i]
            out_bits[at] = bits[i]
            if times[i] < last_time[slot] or (
                times[i] == last_time[slot] and tags[i] < last_tag[slot]
            ):
                ordered = False
            last_time[slot] = times[i]
            last_tag[slot] = tags[i]
            continue
        for j in range(sort_starts[bits[i]], sort_starts[bits[i] + 1]):
            if sort_windows[j] == w:
                at = place[sort_slots[j]]
                place[sort_slots[j]] = at + 1
                out_subjects[at] = subjects[i]
                out_tags[at] = 0
                out_bits[at] = sort_classes[j]
    return out_subjects, out_tags, out_bits, ordered


def _chain(starts: Any, subjects: Any, bits: Any, by_subject: bool) -> tuple[Any, Any]:
    """Links each row to the next one of its slot with an equal subject (or object), in order.

    Returns the heads, by bucket, and the links; -1 ends a chain. Subjects are ids, and neighbours
    often come together: they get neighbouring buckets, in a range a slot. Objects are scattered.
    """
    rows = subjects.shape[0]
    size = 16
    while size < 2 * rows:
        size *= 2
    spread = size // max(1, starts.shape[0] - 1)
    heads = np.full(size, -1, np.int32)
    links = np.empty(rows, np.int32)
    for slot in range(starts.shape[0] - 2, -1, -1):
        for i in range(starts[slot + 1] - 1, starts[slot] - 1, -1):
            if by_subject:
                key = np.int64(subjects[i])
                bucket = (key + (key >> 8) + slot * spread) & (size - 1)
            else:
                key = bits[i]
                # No product leaves 63 bits, so that plain Python agrees; doubles differ above.
                mixed = (key ^ (key >> 32) ^ (key >> 45)) & 0x7FFFFFFF
                mixed = mixed * 40503 + slot * 9973
                bucket = (mixed ^ (mixed >> 16)) & (size - 1)
            links[i] = heads[bucket]
            heads[bucket] = i
    return heads, links


def _match(
    # The window's rows and the static ones: where slots begin, and their triples.
    starts: Any,
    subjects: Any,
    tags: Any,
    bits: Any,
    static_starts: Any,
    static_subjects: Any,
    static_tags: Any,
    static_bits: Any,
    static_subject_heads: Any,
    static_subject_links: Any,
    static_object_heads: Any,
    static_object_links: Any,
    # A row a pattern: slot, subject and object as a variable, or below 0 as constant -1 - i.
    patterns: Any,
    constant_tags: Any,
    constant_bits: Any,
    # By slot: whether equal triples count once.
    once: Any,
    # The filters: a row an operation (what, argument), where each begins, the variables it needs.
    operations: Any,
    filter_starts: Any,
    filter_needs: Any,
    term_sorts: Any,
    out_tags: Any,
    out_bits: Any,
    uniform: Any,
) -> int:
    """Writes the solutions, a row a variable, and returns how many there are (they may not have
    fitted), or `DOUBTFUL`. ``uniform``: the one tag of a variable's values, -1 if they differ."""
    pattern_count = patterns.shape[0]
    variable_count = out_tags.shape[0]
    slot_count = starts.shape[0] - 1
    rows = subjects.shape[0]
    size = 16
    while size < 2 * rows:
        size *= 2
    mask = size - 1
    spread = size // max(1, slot_count)
    static_spread = static_subject_heads.shape[0] // max(1, slot_count)
    static_subject_mask = static_subject_heads.shape[0] - 1
    static_object_mask = static_object_heads.shape[0] - 1
    # Which slots are asked of by subject, which by object: by subject where that is bound.
    order = np.empty(pattern_count, np.int64)
    ways = np.empty(pattern_count, np.int64)
    chosen = np.zeros(pattern_count, np.bool_)
    bound = np.zeros(variable_count + 1, np.bool_)
    for depth in range(pattern_count):
        best, best_cost, best_way = -1, 1e300, 0
        for p in range(pattern_count):
            if chosen[p]:
                continue
            slot, s, o = patterns[p, 0], patterns[p, 1], patterns[p, 2]
            number = float(
                starts[slot + 1] - starts[slot] + static_starts[slot + 1] - static_starts[slot]
            )
            subject_bound = s < 0 or bound[s]
            object_bound = o < 0 or bound[o]
            if subject_bound and object_bound:
                cost, way = 0.5, 1
            elif subject_bound:
                cost, way = 1.0, 1
            elif object_bound:
                cost, way = 2.0 + 0.1 * number, 2
                if o >= 0:
                    cost = 2.0 + 0.01 * number
            else:
                cost, way = 3.0 + number, 0
            for f in range(filter_starts.shape[0] - 1):
                # Among equals first what a filter looks at: fewer go on from there.
                if (s >= 0 and filter_needs[f, s]) or (o >= 0 and filter_needs[f, o]):
                    cost -= 0.25
                    break
            if not (s >= 0 and bound[s]) and not (o >= 0 and bound[o]) and depth > 0:
                # It shares nothing with what is bound: a product.
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
    # Chains of the window's rows in the slots that need them.
    by_subject = np.zeros(slot_count, np.bool_)
    by_object = np.zeros(slot_count, np.bool_)
    for depth in range(pattern_count):
        if ways[depth] == 1:
            by_subject[patterns[order[depth], 0]] = True
        elif ways[depth] == 2:
            by_object[patterns[order[depth], 0]] = True
    subject_heads = np.full(size, -1, np.int32)
    object_heads = np.full(size, -1, np.int32)
    subject_links = np.empty(rows, np.int32)
    object_links = np.empty(rows, np.int32)
    dropped = np.zeros(rows, np.bool_)
    for slot in range(slot_count):
        if once[slot]:
            # Each triple where it first stands; one of the static side is there already. The
            # chains are used for finding equal ones first, and are linked anew afterwards.
            for i in range(starts[slot], starts[slot + 1]):
                key = np.int64(subjects[i])
                key += key >> 8
                j = static_subject_heads[(key + slot * static_spread) & static_subject_mask]
                while j >= 0:
                    if (
                        static_subjects[j] == subjects[i]
                        and static_bits[j] == bits[i]
                        and static_tags[j] == tags[i]
                        and static_starts[slot] <= j < static_starts[slot + 1]
                    ):
                        dropped[i] = True
                        break
                    j = static_subject_links[j]
                if dropped[i]:
                    continue
                bucket = (key + slot * spread) & mask
                j = subject_heads[bucket]
                while j >= 0:
                    if (
                        subjects[j] == subjects[i]
                        and bits[j] == bits[i]
                        and tags[j] == tags[i]
                        and starts[slot] <= j < starts[slot + 1]
                    ):
                        dropped[i] = True
                        break
                    j = subject_links[j]
                if not dropped[i]:
                    subject_links[i] = subject_heads[bucket]
                    subject_heads[bucket] = i
    subject_heads[:] = -1
    for slot in range(slot_count - 1, -1, -1):
        for way in range(1, 3):
            if not (by_subject[slot] if way == 1 else by_object[slot]):
                continue
            for i in range(starts[slot + 1] - 1, starts[slot] - 1, -1):
                if dropped[i]:
                    continue
                if way == 1:
                    key = np.int64(subjects[i])
                    bucket = (key + (key >> 8) + slot * spread) & mask
                    subject_links[i] = subject_heads[bucket]
                    subject_heads[bucket] = i
                else:
                    key = bits[i]
                    mixed = (key ^ (key >> 32) ^ (key >> 45)) & 0x7FFFFFFF
                    mixed = mixed * 40503 + slot * 9973
                    bucket = (mixed ^ (mixed >> 16)) & mask
                    object_links[i] = object_heads[bucket]
                    object_heads[bucket] = i
    # The depth at which all variables of a filter are bound.
    filter_count = filter_starts.shape[0] - 1
    filter_depth = np.zeros(filter_count, np.int64)
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
    stack_tags = np.zeros(64, np.int64)
    stack_numbers = np.zeros(64, np.float64)
    stack_ids = np.zeros(64, np.int64)
    # Matching, one pattern inside the other; a cursor a depth: the row, and on which side it is.
    value_tags = np.zeros(variable_count + 1, np.int8)
    value_bits = np.zeros(variable_count + 1, np.int64)
    owner = np.full(variable_count + 1, -1, np.int64)
    cursor = np.full(pattern_count + 1, -2, np.int64)
    on_static = np.zeros(pattern_count + 1, np.bool_)
    capacity = out_tags.shape[1]
    found = 0
    depth = 0
    while depth >= 0:
        if depth == pattern_count:
            if found < capacity:
                for v in range(variable_count):
                    if found == 0:
                        uniform[v] = value_tags[v]
                    elif uniform[v] != value_tags[v]:
                        uniform[v] = -1
                    out_tags[v, found] = value_tags[v]
                    out_bits[v, found] = value_bits[v]
            found += 1
            depth -= 1
            continue
        p = order[depth]
        slot, s, o, way = patterns[p, 0], patterns[p, 1], patterns[p, 2], ways[depth]
        # What this depth had bound is free again.
        if s >= 0 and owner[s] == depth:
            owner[s] = -1
        if o >= 0 and owner[o] == depth:
            owner[o] = -1
        subject_known, object_known = False, False
        subject_bits, object_bits, object_tag = np.int64(0), np.int64(0), np.int64(0)
        if s < 0:
            subject_known, subject_bits = True, constant_bits[-1 - s]
            if constant_tags[-1 - s] != 0:
                depth -= 1
                continue
        elif owner[s] >= 0:
            subject_known, subject_bits = True, value_bits[s]
            if value_tags[s] != 0:
                # No number is the subject of a triple.
                cursor[depth] = -2
                on_static[depth] = False
                depth -= 1
                continue
        if o < 0:
            object_known = True
            object_tag, object_bits = np.int64(constant_tags[-1 - o]), constant_bits[-1 - o]
        elif owner[o] >= 0:
            object_known = True
            object_tag, object_bits = np.int64(value_tags[o]), value_bits[o]
        # The next row. Where a slot has none in the windows, or no static one, nobody looks.
        at = cursor[depth]
        if at == -2 and starts[slot] == starts[slot + 1]:
            on_static[depth] = True
        matched = False
        while True:
            static_side = on_static[depth]
            if at == -2:
                if way == 0:
                    at = static_starts[slot] if static_side else starts[slot]
                elif way == 1:
                    key = subject_bits + (subject_bits >> 8)
                    if static_side:
                        bucket = (key + slot * static_spread) & static_subject_mask
                        at = np.int64(static_subject_heads[bucket])
                    else:
                        at = np.int64(subject_heads[(key + slot * spread) & mask])
                else:
                    key = object_bits
                    mixed = (key ^ (key >> 32) ^ (key >> 45)) & 0x7FFFFFFF
                    mixed = mixed * 40503 + slot * 9973
                    mixed = mixed ^ (mixed >> 16)
                    if static_side:
                        at = np.int64(static_object_heads[mixed & static_object_mask])
                    else:
                        at = np.int64(object_heads[mixed & mask])
            elif way == 0:
                at += 1
            elif static_side:
                at = np.int64(static_subject_links[at] if way == 1 else static_object_links[at])
            else:
                at = np.int64(subject_links[at] if way == 1 else object_links[at])
            if way == 0:
                end = static_starts[slot + 1] if static_side else starts[slot + 1]
                if at >= end:
                    at = np.int64(-1)
            if at < 0:
                if static_side or static_starts[slot] == static_starts[slot + 1]:
                    break
                on_static[depth] = True
                at = np.int64(-2)
                continue
            if static_side:
                row_subject = np.int64(static_subjects[at])
                row_tag, row_bits = np.int64(static_tags[at]), static_bits[at]
                inside = static_starts[slot] <= at < static_starts[slot + 1]
            else:
                row_subject = np.int64(subjects[at])
                row_tag, row_bits = np.int64(tags[at]), bits[at]
                inside = starts[slot] <= at < starts[slot + 1] and not dropped[at]
            if not inside:
                continue
            if subject_known and row_subject != subject_bits:
                continue
            if object_known and (row_bits != object_bits or row_tag != object_tag):
                continue
            if s >= 0 and s == o and not (row_tag == 0 and row_bits == row_subject):
                continue
            matched = True
            break
        if not matched:
            cursor[depth] = -2
            on_static[depth] = False
            depth -= 1
            continue
        cursor[depth] = at
        if s >= 0 and not subject_known:
            owner[s] = depth
            value_tags[s] = 0
            value_bits[s] = row_subject
        if o >= 0 and not object_known and o != s:
            owner[o] = depth
            value_tags[o] = row_tag
            value_bits[o] = row_bits
        # The filters that can be judged now: three-valued; only what is true goes on.
        passes = True
        for f in range(filter_count):
            if filter_depth[f] != depth:
                continue
            top = -1
            for k in range(filter_starts[f], filter_starts[f + 1]):
                what, argument = operations[k, 0], operations[k, 1]
                if what <= 1:
                    top += 1
                    if what == 0:
                        tag, word = np.int64(constant_tags[argument]), constant_bits[argument]
                    else:
                        tag, word = np.int64(value_tags[argument]), value_bits[argument]
                    stack_tags[top] = tag
                    stack_ids[top] = word
                    if tag == 0:
                        stack_numbers[top] = 0.0
                    elif tag == 1 or tag == 5:
                        stack_numbers[top] = float(word)
                        if abs(word) > 9007199254740992:
                            return -1
                    else:
                        stack_numbers[top] = np.int64(word).view(np.float64)
                    continue
                if what == 14 or what == 15:
                    tag = stack_tags[top]
                    if tag == -1:
                        continue
                    if what == 15:
                        if 1 <= tag <= 4:
                            stack_numbers[top] = -stack_numbers[top]
                        else:
                            return -1
                    else:
                        if tag == 0:
                            return -1
                        number = stack_numbers[top]
                        truth = number != 0.0 and number == number
                        stack_tags[top] = 5
                        stack_numbers[top] = 0.0 if truth else 1.0
                    continue
                a_tag, b_tag = stack_tags[top - 1], stack_tags[top]
                a, b = stack_numbers[top - 1], stack_numbers[top]
                a_id, b_id = stack_ids[top - 1], stack_ids[top]
                top -= 1
                if what == 12 or what == 13:
                    if a_tag == 0 or b_tag == 0:
                        return -1
                    a_true = a_tag > 0 and a != 0.0 and a == a
                    b_true = b_tag > 0 and b != 0.0 and b == b
                    decisive = what == 13
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
                if what <= 5:
                    if not (a_number and b_number):
                        return -1
                    tag = max(a_tag, b_tag)
                    if what == 2:
                        value = a + b
                    elif what == 3:
                        value = a - b
                    elif what == 4:
                        value = a * b
                    else:
                        if tag <= 2:
                            tag = np.int64(2)
                            if b == 0.0:
                                stack_tags[top] = -1
                                continue
                        elif b == 0.0:
                            # The quotient of a double by zero: infinite, or no number.
                            return -1
                        value = a / b
                    if tag == 2 and value != 0.0:
                        # As `decimals.rounded`.
                        size_of = max(abs(a), abs(b)) if what <= 3 else abs(value)
                        place = 44
                        while place >= 0 and POWERS[place] > size_of:
                            place -= 1
                        digits = 14 - (place - 22)
                        if 14 <= place <= 43:
                            if digits >= 0:
                                scale = POWERS[digits + 22]
                                value = np.rint(value * scale) / scale
                            else:
                                scale = POWERS[22 - digits]
                                value = np.rint(value / scale) * scale
                    if tag == 1 and abs(value) > 9007199254740992.0:
                        return -1
                    stack_tags[top] = tag
                    stack_numbers[top] = value
                    continue
                result = False
                if (a_number and b_number) or (a_tag == 5 and b_tag == 5):
                    if what == 6:
                        result = a == b
                    elif what == 7:
                        result = a != b
                    elif what == 8:
                        result = a < b
                    elif what == 9:
                        result = a <= b
                    elif what == 10:
                        result = a > b
                    else:
                        result = a >= b
                elif what <= 7:
                    same = a_tag == b_tag and a_id == b_id
                    if not same:
                        if a_tag == 0 and term_sorts[a_id] == 0:
                            return -1
                        if b_tag == 0 and term_sorts[b_id] == 0:
                            return -1
                    result = same == (what == 6)
                else:
                    return -1
                stack_tags[top] = 5
                stack_numbers[top] = 1.0 if result else 0.0
            if stack_tags[0] == 0:
                return -1
            if not (
                stack_tags[0] > 0
                and stack_numbers[0] != 0.0
                and stack_numbers[0] == stack_numbers[0]
            ):
                passes = False
                break
        if passes:
            depth += 1
    return found


def _of_select() -> Any:
    from numba import types

    int8s, int32s, int64s = types.int8[::1], types.int32[::1], types.int64[::1]
    tuple_of: Any = types.Tuple
    result = tuple_of((int32s, int8s, int64s, types.boolean))
    return result(
        int8s,
        int32s,
        int32s,
        int8s,
        int64s,
        int64s,
        types.int64,
        types.int64,
        int64s,
        int64s,
        int64s,
        int64s,
        int64s,
        int64s,
        int64s,
    )


def _of_chain() -> Any:
    from numba import types

    int32s, int64s = types.int32[::1], types.int64[::1]
    tuple_of: Any = types.Tuple
    result = tuple_of((int32s, int32s))
    return result(int64s, int32s, int64s, types.boolean)


def _of_match() -> Any:
    from numba import types

    int8s, int32s, int64s = types.int8[::1], types.int32[::1], types.int64[::1]
    rows = (int64s, int32s, int8s, int64s)
    return types.int64(
        *rows,
        *rows,
        int32s,
        int32s,
        int32s,
        int32s,
        types.int64[:, ::1],
        int8s,
        int64s,
        types.boolean[::1],
        types.int64[:, ::1],
        int64s,
        types.boolean[:, ::1],
        int8s,
        types.int8[:, ::1],
        types.int64[:, ::1],
        int8s,
    )


select = Kernel(_select, _of_select)
chain = Kernel(_chain, _of_chain)
match = Kernel(_match, _of_match)
