"""A state through the nodes of a formula, operands first: compiled loops over `layout`."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ..programs import (
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
from ..time_searches import SEARCHES, ahead, back, behind, is_later, is_near, is_over, reach
from .layout import HOLDS, KNOWN, PRESENT, STEP

MANY: Final = 2
"""More changed rows of an operand are taken together."""


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
    if operation in (SINCE, ONCE):
        return count - first[node]
    return changes[left] + (is_new if operation != SPREAD else 0)


def _candidate(
    nodes: Any, node: Any, k: Any, count: Any, changed: Any, changes: Any, first: Any
) -> Any:
    operation = nodes[node, OPERATION]
    left = nodes[node, LEFT_T] // TABLES
    if operation in (ATOM, TRUTH):
        return count - 1
    if operation in (SINCE, ONCE):
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
    low, high = back(valid, row, nodes[node, END]), behind(valid, row, nodes[node, START])
    for other in range(low, high):
        is_full = full[operand, other]
        for word in range(words):
            spare[0, word] |= tables[left_t, other, word]
            if not is_full:
                spare[1, word] &= tables[left_t, other, word] | tables[left_f, other, word]
    for word in range(words):
        spare[1, word] &= ~spare[0, word]


def _join(
    tables: Any, nodes: Any, node: Any, other: Any, is_inside: Any, words: Any, spare: Any,
    place: Any,
) -> None:  # fmt: skip
    """Go on by one state: let ``spare[place]`` and ``spare[place + 1]`` say where `until`, or
    `since`, is true and false from this state on; they say it from the state beyond on."""
    left_t, left_f = nodes[node, LEFT_T], nodes[node, LEFT_F]
    right_t, right_f = nodes[node, RIGHT_T], nodes[node, RIGHT_F]
    for word in range(words):
        true = tables[left_t, other, word] & spare[place, word]
        false = tables[left_f, other, word] | spare[place + 1, word]
        if is_inside:
            true |= tables[right_t, other, word]
            false &= tables[right_f, other, word]
        spare[place, word] = true
        spare[place + 1, word] = false


def _evaluate_since(
    tables: Any, nodes: Any, node: Any, row: Any, valid: Any, words: Any, spare: Any
) -> None:
    for word in range(words):
        spare[0, word] = 0
        spare[1, word] = ~np.uint64(0)
    low, high = back(valid, row, nodes[node, END]), behind(valid, row, nodes[node, START])
    for other in range(low, row + 1):
        _join(tables, nodes, node, other, other < high, words, spare, 0)


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
    tables: Any, valid: Any, nodes: Any, words: Any, full: Any, stamp: Any, spare: Any,
    control: Any, node: Any, row: Any,
) -> None:  # fmt: skip
    operation, wide = nodes[node, OPERATION], words[nodes[node, DOMAIN]]
    left_t, left_f = nodes[node, LEFT_T], nodes[node, LEFT_F]
    if operation == ATOM:
        _evaluate_atom(tables, nodes, node, row, wide, spare, control)
    elif operation == OR:
        _evaluate_or(tables, nodes, node, row, wide, stamp, spare, control)
    elif operation == ONCE:
        _evaluate_once(tables, nodes, node, row, valid, wide, full, spare)
    elif operation == SINCE:
        _evaluate_since(tables, nodes, node, row, valid, wide, spare)
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
    low = max(ahead(valid, row, nodes[node, START], count), first[operand])
    for other in range(low, reach(valid, row, nodes[node, END], count)):
        if not full[operand, other]:
            for word in range(words):
                spare[1, word] &= tables[left_t, other, word] | tables[left_f, other, word]


def _close(
    valid: Any, horizon: Any, end: Any, first: Any, closed: Any, count: Any, node: Any
) -> Any:
    """Go on to the first row whose interval may still get states, and return it."""
    row = max(closed[node], first[node])
    while row < count and is_over(valid, row, end, horizon[count - 1]):
        row += 1
    closed[node] = row
    return row


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
    now = _close(valid, horizon, end, first, closed, count, node)
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
                low = max(low, back(valid, other, end))
            reached = behind(valid, other, start)
            high = reached if is_true else min(high, reached)
        has_some = not is_true
        if is_true and not is_many:
            has_some = _put_new_true(tables, table, other, wide, spare, 0, False)
            if not has_some:
                continue
        for row in range(high - 1, low - 1, -1):
            place, has_own = 0, has_some
            if is_true and is_many:
                if is_near(valid, row, last, end):
                    # All that the later intervals have, and more.
                    while (
                        other >= row and other >= low_change and is_later(valid, row, other, start)
                    ):
                        if stamp[operand, other] == step:
                            has_some |= _put_new_true(
                                tables, table, other, wide, spare, 0, has_some
                            )
                        other -= 1
                    has_own = has_some
                elif not full[node, row]:
                    place, has_own = 2, False
                    own = max(ahead(valid, row, start, count), low_change)
                    for each in range(own, min(reach(valid, row, end, count), high_change + 1)):
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


def _until(
    tables: Any, valid: Any, horizon: Any, nodes: Any, words: Any, masks: Any, full: Any,
    stamp: Any, changed: Any, changes: Any, first: Any, closed: Any, spare: Any, control: Any,
    count: Any, node: Any,
) -> None:  # fmt: skip
    """From the newest start back. Where the interval may still get states, what is known from its
    first state on is that of the later starts, and more."""
    start, end = nodes[node, START], nodes[node, END]
    domain = nodes[node, DOMAIN]
    wide, step = words[domain], control[STEP]
    left, right = nodes[node, LEFT_T] // TABLES, nodes[node, RIGHT_T] // TABLES
    before = closed[node]
    now = _close(valid, horizon, end, first, closed, count, node)
    low, high, known = first[node], count, count
    if changes[left] == 0 and changes[right] == 0:
        # Only rows whose interval is over now.
        low, high = max(low, before), now
    for word in range(wide):
        spare[0, word] = spare[1, word] = 0
    for row in range(high - 1, low - 1, -1):
        inside = ahead(valid, row, start, count)
        place = 0
        if row >= now:
            while known > inside:
                known -= 1
                _join(tables, nodes, node, known, True, wide, spare, 0)
            if full[node, row]:
                continue
            if inside > row:
                place = 2
                for word in range(wide):
                    spare[2, word], spare[3, word] = spare[0, word], spare[1, word]
                for other in range(inside - 1, row - 1, -1):
                    _join(tables, nodes, node, other, False, wide, spare, 2)
        elif full[node, row]:
            continue
        else:
            place = 2
            for word in range(wide):
                spare[2, word], spare[3, word] = 0, ~np.uint64(0)
            for other in range(reach(valid, row, end, count) - 1, row - 1, -1):
                _join(tables, nodes, node, other, other >= inside, wide, spare, 2)
        for side in range(2):
            _gain(
                tables, node * TABLES + side, row, spare[place + side], wide, masks[domain], full,
                stamp, step, changed, changes,
            )  # fmt: skip


def take_step(
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
        elif operation == UNTIL:
            _until(
                tables, valid, horizon, nodes, words, masks, full, stamp, changed, changes, first,
                closed, spare, control, count, node,
            )  # fmt: skip
        else:
            for k in range(_candidates(nodes, node, count, is_new, changes, first)):
                row = _candidate(nodes, node, k, count, changed, changes, first)
                is_again = operation == OR and stamp[node, row] == step
                if full[node, row] and not is_again:
                    continue
                _evaluate(tables, valid, nodes, words, full, stamp, spare, control, node, row)
                for side in range(2):
                    _gain(
                        tables, node * TABLES + side, row, spare[side], wide, mask, full, stamp,
                        step, changed, changes,
                    )  # fmt: skip
        while first[node] < count and full[node, first[node]]:
            first[node] += 1


STEPS: Final = (
    *SEARCHES, _gain, _candidates, _candidate,
    _evaluate_atom, _evaluate_or, _evaluate_once, _join, _evaluate_since, _evaluate_exists,
    _evaluate, _put_new_true, _put_false, _close, _eventually, _until, take_step,
)  # fmt: skip
"""The functions of a step: `Kernel` compiles them into the loop that calls them."""
