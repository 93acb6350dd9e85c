"""States one by one through the nodes of a formula, over tables of bits: compiled loops.

Arrays that the loops share:

``tables``    uint64 (tables, rows, words): a row a state, a bit an object. Four tables a node
              (`sliced_program`), then those named in ``control``
``valid``     int64 (rows,): the valid times of the states; ``horizon``: as in `States`
``nodes``     int64 (nodes, fields): the program
``masks``     uint64 (domains, words): the columns in use; ``words``: int64 (domains,)
``full``      uint8 (nodes, rows): whether all objects are decided there
``stamp``     int64 (nodes, rows): the step in which the row changed last
``changed``   int64 (nodes, rows), ``changes`` int64 (nodes,): the rows changed in this step
``first``     int64 (nodes,): the first row that is not full
``closed``    int64 (nodes,): the first row whose interval may still get states
``spare``     uint64 (4, words): for a loop's own use; ``fresh`` int64 (2 rows,): the same
``control``   int64: numbers, at the places below
``out``       int64 (n, 5): verdicts: the row of the start, of the deciding state, the object, the
              value, the row of the witness or -1
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ...streams.jit import Kernel
from ...streams.time import TIME_MAX
from .sliced_program import (
    ATOM,
    BY_LEFT,
    DOMAIN,
    END,
    EVENTUALLY,
    EXISTS,
    FALSE,
    IS_UPPER,
    LEFT_F,
    LEFT_T,
    NEW,
    NO_END,
    NUMBER,
    ONCE,
    OPERATION,
    OR,
    OVER,
    PREVIOUS,
    RIGHT_F,
    RIGHT_T,
    SINCE,
    SPREAD,
    START,
    TABLES,
    TRUE,
    TRUTH,
    UNTIL,
)

CONTROLS: Final = 21
(
    STEP,  # the number of this step
    HOLDS,  # the first table of atoms' values, one an atom
    KNOWN,  # the first table of whether they are known
    PRESENT,  # the first table of objects that are there, one a domain
    DONE,  # the table of verdicts that are out
    NEWS,  # the table of verdicts of this step
    LOWER_T,  # the tables of the whole formula in both readings
    LOWER_F,
    UPPER_T,
    UPPER_F,
    ROOT_DOMAIN,  # the domain of verdicts
    OPEN,  # the first row with a verdict to come
    EMITTED,  # the verdicts in ``out``
    TRUES,  # true and unknown verdicts that are counted instead
    UNKNOWNS,
    REPORTS_ALL,  # whether these are in ``out``, too
    IS_WHOLE,  # whether row 0 is the first state of all
    LOOKS_BACK,  # whether rows before `OPEN` may still be needed
    IS_REPLAY,  # whether the verdicts of these states were given before
    FRESH,  # the rows in ``fresh``
    WAITING,  # their verdicts, which are not in ``out`` yet
) = range(CONTROLS)
MANY: Final = 2
"""More changed rows of an operand are taken together."""


def _is_later(valid: Any, row: Any, other: Any, gap: Any) -> Any:
    """Whether ``other`` is valid at least ``gap`` after ``row``, which is not later."""
    return np.uint64(valid[other] - valid[row]) >= np.uint64(gap)


def _is_near(valid: Any, row: Any, other: Any, end: Any) -> Any:
    """Whether ``other`` is valid at most ``end`` after ``row``, which is not later."""
    return end == NO_END or np.uint64(valid[other] - valid[row]) <= np.uint64(end)


def _ahead(valid: Any, row: Any, gap: Any, count: Any) -> Any:
    """The first row that is valid at least ``gap`` after ``row``; ``count`` if there is none."""
    if gap == 0:
        return row
    low, step = row, 1
    while low + step < count and not _is_later(valid, row, low + step, gap):
        low += step
        step *= 2
    # Not at ``low``; at ``high``, or it is the end.
    high = min(low + step, count)
    while high - low > 1:
        middle = (low + high) >> 1
        if _is_later(valid, row, middle, gap):
            high = middle
        else:
            low = middle
    return high


def _reach(valid: Any, row: Any, end: Any, count: Any) -> Any:
    """The row after the last one that is valid at most ``end`` after ``row``."""
    if end == NO_END:
        return count
    low, step = row, 1
    while low + step < count and _is_near(valid, row, low + step, end):
        low += step
        step *= 2
    high = min(low + step, count)
    while high - low > 1:
        middle = (low + high) >> 1
        if _is_near(valid, row, middle, end):
            low = middle
        else:
            high = middle
    return high


def _back(valid: Any, row: Any, end: Any) -> Any:
    """The first row that is valid at most ``end`` before ``row``."""
    if end == NO_END:
        return 0
    high, step = row, 1
    while high - step >= 0 and _is_near(valid, high - step, row, end):
        high -= step
        step *= 2
    low = max(high - step, -1)
    while high - low > 1:
        middle = (low + high) >> 1
        if _is_near(valid, middle, row, end):
            high = middle
        else:
            low = middle
    return high


def _behind(valid: Any, row: Any, gap: Any) -> Any:
    """The row after the last one that is valid at least ``gap`` before ``row``."""
    if gap == 0:
        return row + 1
    high, step = row, 1
    while high - step >= 0 and not _is_later(valid, high - step, row, gap):
        high -= step
        step *= 2
    low = max(high - step, -1)
    while high - low > 1:
        middle = (low + high) >> 1
        if _is_later(valid, middle, row, gap):
            low = middle
        else:
            high = middle
    return high


def _is_over(valid: Any, row: Any, end: Any, horizon: Any) -> Any:
    """Whether no later state is valid up to ``end`` after ``row``."""
    if horizon == TIME_MAX:
        return True
    return end != NO_END and np.uint64(horizon - valid[row]) >= np.uint64(end)


def _gain(
    tables: Any, table: Any, row: Any, gained: Any, words: Any, mask: Any, full: Any, stamp: Any,
    step: Any, changed: Any, changes: Any,
) -> None:  # fmt: skip
    """Let a node be true, or false, for more objects at a row."""
    node = table // TABLES
    some = np.uint64(0)
    for word in range(words):
        some |= gained[word] & ~tables[table, row, word]
    if some == 0:
        return
    new, other = node * TABLES + NEW, 2 * node * TABLES + TRUE + FALSE - table
    is_first = stamp[node, row] != step
    if is_first:
        stamp[node, row] = step
        changed[node, changes[node]] = row
        changes[node] += 1
    for word in range(words):
        bits = gained[word] & ~tables[table, row, word]
        tables[table, row, word] |= bits
        # What an earlier step left there is over.
        tables[new, row, word] = bits if is_first else tables[new, row, word] | bits
    undecided = np.uint64(0)
    for word in range(words):
        undecided |= mask[word] & ~(tables[table, row, word] | tables[other, row, word])
    if undecided == 0:
        full[node, row] = 1


# -- nodes whose rows are evaluated one by one: into spare[0] where true, spare[1] where false ----


def _candidates(nodes: Any, node: Any, count: Any, is_new: Any, changes: Any, first: Any) -> Any:
    """How many rows of a node may change in this step."""
    operation = nodes[node, OPERATION]
    if operation in (ATOM, TRUTH):
        return is_new
    left, right = nodes[node, LEFT_T] // TABLES, nodes[node, RIGHT_T] // TABLES
    if operation == OR:
        return changes[left] + changes[right]
    if operation in (UNTIL, SINCE, ONCE):
        return count - first[node]
    return changes[left] + (is_new if operation != SPREAD else 0)


def _candidate(
    nodes: Any, node: Any, k: Any, count: Any, changed: Any, changes: Any, first: Any
) -> Any:
    operation = nodes[node, OPERATION]
    left = nodes[node, LEFT_T] // TABLES
    if operation in (ATOM, TRUTH):
        return count - 1
    if operation in (UNTIL, SINCE, ONCE):
        return first[node] + k
    if k < changes[left]:
        row = changed[left, k] + (operation == PREVIOUS)
        return min(row, count - 1)
    if operation == OR:
        return changed[nodes[node, RIGHT_T] // TABLES, k - changes[left]]
    return count - 1


def _evaluate_atom(
    tables: Any, nodes: Any, node: Any, row: Any, words: Any, spare: Any, control: Any
) -> None:
    number = nodes[node, NUMBER]
    for word in range(words):
        bits = tables[control[HOLDS] + number, row, word]
        if nodes[node, IS_UPPER]:
            bits |= ~tables[control[KNOWN] + number, row, word]
        spare[0, word] = bits
        spare[1, word] = ~bits


def _evaluate_or(
    tables: Any, nodes: Any, node: Any, row: Any, words: Any, stamp: Any, spare: Any, control: Any
) -> None:
    left_t, left_f = nodes[node, LEFT_T], nodes[node, LEFT_F]
    right_t, right_f = nodes[node, RIGHT_T], nodes[node, RIGHT_F]
    left, own = left_t // TABLES, node * TABLES
    is_new, is_again = stamp[left, row] == control[STEP], stamp[node, row] == control[STEP]
    for word in range(words):
        true = tables[left_t, row, word] | tables[right_t, row, word]
        false = tables[left_f, row, word] & tables[right_f, row, word]
        # Of two parts that decide at the same state it is the left one.
        by_left = true & ~tables[own + TRUE, row, word]
        if is_again:
            by_left |= true & tables[own + NEW, row, word]
        by_left &= tables[left_t, row, word]
        if is_new:
            more = false & ~tables[own + FALSE, row, word]
            by_left |= more & tables[left * TABLES + NEW, row, word]
        tables[own + BY_LEFT, row, word] |= by_left
        spare[0, word] = true
        spare[1, word] = false


def _evaluate_once(
    tables: Any, nodes: Any, node: Any, row: Any, valid: Any, words: Any, full: Any, spare: Any
) -> None:
    left_t, left_f = nodes[node, LEFT_T], nodes[node, LEFT_F]
    operand = left_t // TABLES
    for word in range(words):
        spare[0, word] = 0
        spare[1, word] = ~np.uint64(0)
    low, high = _back(valid, row, nodes[node, END]), _behind(valid, row, nodes[node, START])
    for other in range(low, high):
        is_full = full[operand, other]
        for word in range(words):
            spare[0, word] |= tables[left_t, other, word]
            if not is_full:
                spare[1, word] &= tables[left_t, other, word] | tables[left_f, other, word]
    for word in range(words):
        spare[1, word] &= ~spare[0, word]


def _join(
    tables: Any, nodes: Any, node: Any, other: Any, is_inside: Any, words: Any, spare: Any
) -> None:
    """Let `until` or `since` be what the operands say at a state, and else what it is beyond."""
    left_t, left_f = nodes[node, LEFT_T], nodes[node, LEFT_F]
    right_t, right_f = nodes[node, RIGHT_T], nodes[node, RIGHT_F]
    for word in range(words):
        true = tables[left_t, other, word] & spare[0, word]
        false = tables[left_f, other, word] | spare[1, word]
        if is_inside:
            true |= tables[right_t, other, word]
            false &= tables[right_f, other, word]
        spare[0, word] = true
        spare[1, word] = false


def _evaluate_until(
    tables: Any, nodes: Any, node: Any, row: Any, count: Any, valid: Any, words: Any, closed: Any,
    spare: Any,
) -> None:  # fmt: skip
    is_closed, is_past = row < closed[node], nodes[node, OPERATION] == SINCE
    for word in range(words):
        spare[0, word] = 0
        spare[1, word] = ~np.uint64(0) if is_closed or is_past else np.uint64(0)
    if is_past:
        low, high = _back(valid, row, nodes[node, END]), _behind(valid, row, nodes[node, START])
        for other in range(low, row + 1):
            _join(tables, nodes, node, other, other < high, words, spare)
    else:
        low = _ahead(valid, row, nodes[node, START], count)
        high = _reach(valid, row, nodes[node, END], count)
        for other in range(high - 1, row - 1, -1):
            _join(tables, nodes, node, other, other >= low, words, spare)


def _evaluate_exists(
    tables: Any, nodes: Any, node: Any, row: Any, words: Any, spare: Any, control: Any
) -> None:
    """``words``: those of the domain of the quantifier."""
    present = control[PRESENT] + nodes[node, OVER]
    true, open_or_true = np.uint64(0), np.uint64(0)
    for word in range(words):
        there = tables[present, row, word]
        true |= there & tables[nodes[node, LEFT_T], row, word]
        open_or_true |= there & ~tables[nodes[node, LEFT_F], row, word]
    spare[0, 0] = np.uint64(1) if true != 0 else np.uint64(0)
    spare[1, 0] = np.uint64(1) if open_or_true == 0 else np.uint64(0)


def _evaluate(
    tables: Any, valid: Any, nodes: Any, words: Any, full: Any, stamp: Any, closed: Any, spare: Any,
    control: Any, count: Any, node: Any, row: Any,
) -> None:  # fmt: skip
    operation, wide = nodes[node, OPERATION], words[nodes[node, DOMAIN]]
    left_t, left_f = nodes[node, LEFT_T], nodes[node, LEFT_F]
    if operation == ATOM:
        _evaluate_atom(tables, nodes, node, row, wide, spare, control)
    elif operation == OR:
        _evaluate_or(tables, nodes, node, row, wide, stamp, spare, control)
    elif operation == ONCE:
        _evaluate_once(tables, nodes, node, row, valid, wide, full, spare)
    elif operation in (UNTIL, SINCE):
        _evaluate_until(tables, nodes, node, row, count, valid, wide, closed, spare)
    elif operation == EXISTS:
        _evaluate_exists(tables, nodes, node, row, words[nodes[node, OVER]], spare, control)
    else:
        for word in range(wide):
            true, false = ~np.uint64(0), np.uint64(0)
            if operation == SPREAD:
                true = ~np.uint64(0) if tables[left_t, row, 0] & np.uint64(1) else np.uint64(0)
                false = ~np.uint64(0) if tables[left_f, row, 0] & np.uint64(1) else np.uint64(0)
            elif operation == PREVIOUS:
                true = tables[left_t, row - 1, word] if row else np.uint64(0)
                false = tables[left_f, row - 1, word] if row else ~np.uint64(0)
            spare[0, word] = true
            spare[1, word] = false


# -- `eventually`: what an operand's row makes true of many rows at once -------------------------


def _put_new_true(
    tables: Any, table: Any, row: Any, words: Any, spare: Any, place: Any, is_more: Any
) -> Any:
    """Put into ``spare[place]``, with ``is_more`` add to it, which objects an operand has just made
    true; return whether any."""
    new = table // TABLES * TABLES + NEW
    some = np.uint64(0)
    for word in range(words):
        bits = tables[table, row, word] & tables[new, row, word]
        some |= bits
        spare[place, word] = bits | spare[place, word] if is_more else bits
    return some != 0


def _put_false(
    tables: Any, nodes: Any, node: Any, row: Any, count: Any, valid: Any, words: Any, full: Any,
    first: Any, spare: Any,
) -> None:  # fmt: skip
    """Put into ``spare[1]`` where the operand is decided in the whole interval, and never true."""
    left_t, left_f = nodes[node, LEFT_T], nodes[node, LEFT_F]
    operand = left_t // TABLES
    for word in range(words):
        spare[1, word] = ~tables[node * TABLES + TRUE, row, word]
    low = max(_ahead(valid, row, nodes[node, START], count), first[operand])
    for other in range(low, _reach(valid, row, nodes[node, END], count)):
        if not full[operand, other]:
            for word in range(words):
                spare[1, word] &= tables[left_t, other, word] | tables[left_f, other, word]


def _eventually(
    tables: Any, valid: Any, horizon: Any, nodes: Any, words: Any, masks: Any, full: Any,
    stamp: Any, changed: Any, changes: Any, first: Any, closed: Any, spare: Any, control: Any,
    count: Any, node: Any,
) -> None:  # fmt: skip
    """First what becomes true, by each changed row of the operand, or by many of them together;
    then what becomes false: rows that waited for the operand, and those whose interval is over."""
    start, end, table = nodes[node, START], nodes[node, END], nodes[node, LEFT_T]
    domain = nodes[node, DOMAIN]
    wide, mask, step = words[domain], masks[domain], control[STEP]
    operand, last = table // TABLES, count - 1
    before = closed[node]
    now = max(before, first[node])
    while now < count and _is_over(valid, now, end, horizon[last]):
        now += 1
    closed[node] = now
    is_many = changes[operand] > MANY
    groups = 1 if is_many else changes[operand]
    low_change, high_change = count, -1
    for k in range(changes[operand]):
        low_change = min(low_change, changed[operand, k])
        high_change = max(high_change, changed[operand, k])
    for group in range(2 * groups + 1):
        is_true = group < groups
        low, high, other = first[node], before, high_change
        if group == 2 * groups:
            low, high = max(low, before), now
        else:
            if not is_many:
                other = changed[operand, group if is_true else group - groups]
                low = max(low, _back(valid, other, end))
            reached = _behind(valid, other, start)
            high = reached if is_true else min(high, reached)
        has_some = not is_true
        if is_true and not is_many:
            has_some = _put_new_true(tables, table, other, wide, spare, 0, False)
            if not has_some:
                continue
        for row in range(high - 1, low - 1, -1):
            place, has_own = 0, has_some
            if is_true and is_many:
                if _is_near(valid, row, last, end):
                    # All that the later intervals have, and more.
                    while (
                        other >= row and other >= low_change and _is_later(valid, row, other, start)
                    ):
                        if stamp[operand, other] == step:
                            has_some |= _put_new_true(
                                tables, table, other, wide, spare, 0, has_some
                            )
                        other -= 1
                    has_own = has_some
                elif not full[node, row]:
                    place, has_own = 2, False
                    own = max(_ahead(valid, row, start, count), low_change)
                    for each in range(own, min(_reach(valid, row, end, count), high_change + 1)):
                        if stamp[operand, each] == step:
                            has_own |= _put_new_true(tables, table, each, wide, spare, 2, has_own)
            if has_own and not full[node, row]:
                if not is_true:
                    place = 1
                    _put_false(tables, nodes, node, row, count, valid, wide, full, first, spare)
                _gain(
                    tables, node * TABLES + (TRUE if is_true else FALSE), row, spare[place], wide,
                    mask, full, stamp, step, changed, changes,
                )  # fmt: skip


def _step(
    tables: Any, valid: Any, horizon: Any, nodes: Any, words: Any, masks: Any, full: Any,
    stamp: Any, changed: Any, changes: Any, first: Any, closed: Any, spare: Any, control: Any,
    count: Any, is_new: Any,
) -> None:  # fmt: skip
    """Take the last of ``count`` states, whose rows of the nodes are 0; without ``is_new`` its
    horizon alone. That is the same step: what a state and its horizon decide is decided at the same
    state."""
    control[STEP] += is_new
    step, last = control[STEP], count - 1
    for node in range(len(nodes)):
        domain, operation = nodes[node, DOMAIN], nodes[node, OPERATION]
        wide, mask = words[domain], masks[domain]
        if is_new:
            changes[node] = 0
            used = np.uint64(0)
            for word in range(wide):
                used |= mask[word]
            full[node, last] = used == 0
        if operation == EVENTUALLY:
            _eventually(
                tables, valid, horizon, nodes, words, masks, full, stamp, changed, changes, first,
                closed, spare, control, count, node,
            )  # fmt: skip
        else:
            if operation == UNTIL:
                now = max(closed[node], first[node])
                while now < count and _is_over(valid, now, nodes[node, END], horizon[last]):
                    now += 1
                closed[node] = now
            for k in range(_candidates(nodes, node, count, is_new, changes, first)):
                row = _candidate(nodes, node, k, count, changed, changes, first)
                is_again = operation == OR and stamp[node, row] == step
                if full[node, row] and not is_again:
                    continue
                _evaluate(
                    tables, valid, nodes, words, full, stamp, closed, spare, control, count, node,
                    row,
                )  # fmt: skip
                for side in range(2):
                    _gain(
                        tables, node * TABLES + side, row, spare[side], wide, mask, full, stamp,
                        step, changed, changes,
                    )  # fmt: skip
        while first[node] < count and full[node, first[node]]:
            first[node] += 1


# -- verdicts --------------------------------------------------------------------------------------


def _ones(word: Any) -> Any:
    """The number of bits set."""
    word = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    word = (word & np.uint64(0x3333333333333333)) + (
        (word >> np.uint64(2)) & np.uint64(0x3333333333333333)
    )
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((word * np.uint64(0x0101010101010101)) >> np.uint64(56))


def _has(tables: Any, table: Any, row: Any, place: Any) -> Any:
    """Whether the bit of an object is set."""
    word = tables[table, row, place >> 6]
    return (word >> np.uint64(place & 63)) & np.uint64(1) != 0


def _witness_of_until(
    tables: Any, nodes: Any, node: Any, is_true: Any, row: Any, place: Any, count: Any, valid: Any,
    horizon: Any,
) -> Any:  # fmt: skip
    """The state of the right operand, or that at which the left one fails."""
    end = nodes[node, END]
    low = _ahead(valid, row, nodes[node, START], count)
    high = _reach(valid, row, end, count)
    if is_true:
        for other in range(row, high):
            if other >= low and _has(tables, nodes[node, RIGHT_T], other, place):
                return other
        return -1
    # The end of all streams comes after what fails at the last state.
    known = horizon[count - 1]
    if known == TIME_MAX:
        known = horizon[count - 2] if count > 1 else valid[0] - 1
    is_over = known >= valid[row] and known != TIME_MAX and _is_over(valid, row, end, known)
    found = -1
    for other in range(row, high):
        if other >= low and not _has(tables, nodes[node, RIGHT_F], other, place):
            is_over = False
            if found < 0:
                return -1
        if found < 0 and _has(tables, nodes[node, LEFT_F], other, place):
            found = other
    return -1 if is_over else found


def _witness(
    tables: Any, nodes: Any, table: Any, row: Any, place: Any, count: Any, valid: Any, horizon: Any,
    control: Any,
) -> Any:  # fmt: skip
    """The row of the witness, or -1; of a formula about one object."""
    while True:
        node, is_true = table // TABLES, table % TABLES == TRUE
        operation = nodes[node, OPERATION]
        own = 0 if nodes[node, DOMAIN] == 0 else place
        if operation in (ATOM, TRUTH):
            return row
        if operation == PREVIOUS:
            return -1 if row == 0 and control[IS_WHOLE] else row - 1
        if operation in (EVENTUALLY, ONCE):
            if not is_true:
                return -1
            if operation == ONCE:
                low, high = _back(valid, row, nodes[node, END]), row + 1
            else:
                low = _ahead(valid, row, nodes[node, START], count)
                high = count
            for other in range(low, high):
                if _has(tables, nodes[node, LEFT_T], other, own):
                    return other
            return -1
        if operation == UNTIL:
            return _witness_of_until(tables, nodes, node, is_true, row, own, count, valid, horizon)
        if operation == EXISTS:
            return -2 - node if is_true else -1
        if operation == OR:
            by_left = _has(tables, node * TABLES + BY_LEFT, row, own)
            if is_true:
                table = nodes[node, LEFT_T] if by_left else nodes[node, RIGHT_T]
            else:
                table = nodes[node, LEFT_F] if by_left else nodes[node, RIGHT_F]
        else:
            table = nodes[node, LEFT_T] if is_true else nodes[node, LEFT_F]


def _witness_of_verdict(
    tables: Any, nodes: Any, words: Any, table: Any, row: Any, place: Any, count: Any, valid: Any,
    horizon: Any, control: Any,
) -> Any:  # fmt: skip
    """The row of the witness; of a quantifier the first one among the objects that decide it."""
    found = _witness(tables, nodes, table, row, place, count, valid, horizon, control)
    if found >= -1:
        return found
    node = -2 - found
    over, inner = nodes[node, OVER], nodes[node, LEFT_T]
    best = -1
    for other in range(64 * words[over]):
        if _has(tables, control[PRESENT] + over, row, other) and _has(tables, inner, row, other):
            state = _witness(tables, nodes, inner, row, other, count, valid, horizon, control)
            if state >= 0 and (best < 0 or state < best):
                best = state
    return best


def _put_news(
    tables: Any, row: Any, words: Any, control: Any
) -> Any:  # fmt: skip
    """Mark the verdicts of a row that are not out yet; return whether there are any."""
    done, news = control[DONE], control[NEWS]
    lower_t, upper_f = control[LOWER_T], control[UPPER_F]
    present = control[PRESENT] + control[ROOT_DOMAIN]
    for word in range(words):
        tables[news, row, word] = tables[lower_t, row, word] | tables[upper_f, row, word]
    if lower_t // TABLES != upper_f // TABLES:
        for word in range(words):
            tables[news, row, word] |= (
                tables[control[LOWER_F], row, word] & tables[control[UPPER_T], row, word]
            )
    some = np.uint64(0)
    for word in range(words):
        new = tables[news, row, word] & tables[present, row, word] & ~tables[done, row, word]
        tables[news, row, word] = new
        some |= new
    for word in range(words):
        tables[done, row, word] |= tables[news, row, word]
    return some != 0


def _report(tables: Any, row: Any, words: Any, spare: Any, control: Any, is_more: Any) -> Any:
    """Put into ``spare[3]``, with ``is_more`` add to it, the objects with a new verdict to report;
    return the number of these verdicts. Others are counted, and are news no more."""
    news, upper_f = control[NEWS], control[UPPER_F]
    if not control[REPORTS_ALL]:
        for word in range(words):
            other = tables[news, row, word] & ~tables[upper_f, row, word]
            control[TRUES] += _ones(other)
        if control[LOWER_T] // TABLES != upper_f // TABLES:
            for word in range(words):
                other = tables[news, row, word] & ~tables[upper_f, row, word]
                unknown = _ones(other & ~tables[control[LOWER_T], row, word])
                control[TRUES] -= unknown
                control[UNKNOWNS] += unknown
        for word in range(words):
            tables[news, row, word] &= tables[upper_f, row, word]
    some = np.uint64(0)
    for word in range(words):
        some |= tables[news, row, word]
    count = 0
    if some != 0:
        for word in range(words):
            new = tables[news, row, word]
            spare[3, word] = new | spare[3, word] if is_more else new
            count += _ones(tables[news, row, word])
    return count


def _collect(
    tables: Any, words: Any, stamp: Any, changed: Any, changes: Any, spare: Any, fresh: Any,
    control: Any,
) -> None:  # fmt: skip
    """Find the verdicts of this step that are reported: their rows, in order, in ``fresh``, and
    the objects in ``spare[3]``."""
    lower, upper = control[LOWER_T] // TABLES, control[UPPER_T] // TABLES
    wide = words[control[ROOT_DOMAIN]]
    rows = 0
    for side in range(1 if lower == upper else 2):
        node = upper if side else lower
        for k in range(changes[node]):
            row = changed[node, k]
            if row < control[OPEN] or (side and stamp[lower, row] == control[STEP]):
                continue
            if not _put_news(tables, row, wide, control):
                continue
            found = _report(tables, row, wide, spare, control, rows > 0)
            if found:
                control[WAITING] += found
                place = rows
                while place > 0 and fresh[place - 1] > row:
                    fresh[place] = fresh[place - 1]
                    place -= 1
                fresh[place] = row
                rows += 1
    control[FRESH] = rows


def _emit(
    tables: Any, nodes: Any, words: Any, valid: Any, horizon: Any, spare: Any, fresh: Any,
    control: Any, count: Any, out: Any,
) -> Any:  # fmt: skip
    """Write the verdicts of this step to ``out``, by object and start; return whether there is
    room for them."""
    if control[EMITTED] + control[WAITING] > len(out):
        return False
    rows, at = control[FRESH], control[EMITTED]
    lower_t, upper_f, news = control[LOWER_T], control[UPPER_F], control[NEWS]
    if control[WAITING]:
        for word in range(words[control[ROOT_DOMAIN]]):
            left = spare[3, word]
            while left != 0:
                low = left & (~left + np.uint64(1))
                left ^= low
                place = 64 * word + _ones(low - np.uint64(1))
                for k in range(rows):
                    row = fresh[k]
                    if tables[news, row, word] & low == 0:
                        continue
                    is_true = tables[lower_t, row, word] & low != 0
                    is_false = tables[upper_f, row, word] & low != 0
                    out[at, 0] = row
                    out[at, 1] = count - 1
                    out[at, 2] = place
                    out[at, 3] = 1 if is_true else 0 if is_false else -1
                    out[at, 4] = -1
                    if is_true or is_false:
                        out[at, 4] = _witness_of_verdict(
                            tables, nodes, words, lower_t if is_true else upper_f, row, place,
                            count, valid, horizon, control,
                        )  # fmt: skip
                    at += 1
    control[EMITTED] = at
    control[WAITING] = 0
    return True


def _open(tables: Any, words: Any, first: Any, count: Any, control: Any) -> None:
    """Go on to the first row with a verdict to come; what is before it needs no more work."""
    domain = control[ROOT_DOMAIN]
    present, row = control[PRESENT] + domain, control[OPEN]
    while row < count:
        some = np.uint64(0)
        for word in range(words[domain]):
            some |= tables[present, row, word] & ~tables[control[DONE], row, word]
        if some != 0:
            break
        row += 1
    control[OPEN] = row
    if not control[LOOKS_BACK]:
        for node in range(len(first)):
            first[node] = max(first[node], row)


def _run_loop(
    tables: Any, valid: Any, horizon: Any, nodes: Any, words: Any, masks: Any, full: Any,
    stamp: Any, changed: Any, changes: Any, first: Any, closed: Any, spare: Any, fresh: Any,
    control: Any, out: Any, begin: Any, end: Any, is_new: Any,
) -> Any:  # fmt: skip
    """Take the rows ``begin`` to ``end - 1``; return the row to go on with once ``out`` has more
    room, or ``end``."""
    for row in range(begin, end):
        if control[WAITING] == 0:
            _step(
                tables, valid, horizon, nodes, words, masks, full, stamp, changed, changes, first,
                closed, spare, control, row + 1, is_new,
            )  # fmt: skip
            if control[IS_REPLAY]:
                continue
            _collect(tables, words, stamp, changed, changes, spare, fresh, control)
        if not _emit(tables, nodes, words, valid, horizon, spare, fresh, control, row + 1, out):
            return row
        _open(tables, words, first, row + 1, control)
    return end


def _signature() -> Any:
    from numba import types

    bits, index = types.uint64[:, ::1], types.int64[:, ::1]
    row = types.int64[::1]
    number = types.int64
    return number(
        types.uint64[:, :, ::1], row, row, index, row, bits, types.uint8[:, ::1], index, index, row,
        row, row, bits, row, row, index, number, number, number,
    )  # fmt: skip


CALLED: Final = (
    _is_later, _is_near, _ahead, _reach, _back, _behind, _is_over, _gain, _candidates, _candidate,
    _evaluate_atom, _evaluate_or, _evaluate_once, _join, _evaluate_until, _evaluate_exists,
    _evaluate, _put_new_true, _put_false, _eventually, _step, _ones, _has, _witness_of_until,
    _witness, _witness_of_verdict, _put_news, _report, _collect, _emit, _open,
)  # fmt: skip
run = Kernel(_run_loop, _signature, allocates=False, calls=CALLED)
"""Take states, or with ``is_new`` 0 the horizon of the last one."""
