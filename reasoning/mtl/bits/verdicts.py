"""The verdicts of a step, and the loop over states: compiled, over `layout`."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ....streams.jit import Kernel
from ....streams.time import TIME_MAX, TIME_MIN
from ..programs import (
    ATOM,
    BY_LEFT,
    DOMAIN,
    END,
    EVENTUALLY,
    EXISTS,
    LEFT_F,
    LEFT_T,
    ONCE,
    OPERATION,
    OR,
    OVER,
    PREVIOUS,
    RIGHT_F,
    RIGHT_T,
    START,
    TABLES,
    TRUE,
    TRUTH,
    UNTIL,
)
from ..time_searches import ahead, back, is_over, reach
from .layout import (
    DONE,
    EMITTED,
    FRESH,
    IS_REPLAY,
    IS_WHOLE,
    LOOKS_BACK,
    LOWER_F,
    LOWER_T,
    NEWS,
    OPEN,
    PRESENT,
    REPORTS_ALL,
    ROOT_DOMAIN,
    STEP,
    TRUES,
    UNKNOWNS,
    UPPER_F,
    UPPER_T,
    WAITING,
)
from .steps import STEPS, take_step


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
    low = ahead(valid, row, nodes[node, START], count)
    high = reach(valid, row, end, count)
    if is_true:
        for other in range(row, high):
            if other >= low and _has(tables, nodes[node, RIGHT_T], other, place):
                return other
        return -1
    # The end of all streams comes after what fails at the last state.
    known = horizon[count - 1]
    if known == TIME_MAX:
        known = horizon[count - 2] if count > 1 else valid[0] - 1
    is_closed = known >= valid[row] and known != TIME_MAX and is_over(valid, row, end, known)
    found = -1
    for other in range(row, high):
        if other >= low and not _has(tables, nodes[node, RIGHT_F], other, place):
            is_closed = False
            if found < 0:
                return -1
        if found < 0 and _has(tables, nodes[node, LEFT_F], other, place):
            found = other
    return -1 if is_closed else found


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
                low, high = back(valid, row, nodes[node, END]), row + 1
            else:
                low = ahead(valid, row, nodes[node, START], count)
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
                    witness = -1
                    if is_true or is_false:
                        witness = _witness_of_verdict(
                            tables, nodes, words, lower_t if is_true else upper_f, row, place,
                            count, valid, horizon, control,
                        )  # fmt: skip
                    out[at, 0] = valid[row]
                    out[at, 1] = valid[count - 1]
                    out[at, 2] = TIME_MIN if witness < 0 else valid[witness]
                    out[at, 3] = count - 1
                    out[at, 4] = place
                    out[at, 5] = 1 if is_true else 0 if is_false else -1
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
            take_step(
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
    *STEPS, _ones, _has, _witness_of_until, _witness, _witness_of_verdict, _put_news, _report,
    _collect, _emit, _open,
)  # fmt: skip
run = Kernel(_run_loop, _signature, allocates=False, calls=CALLED)
"""Take states, or with ``is_new`` 0 the horizon of the last one."""
