"""Verdicts of a formula with robustness over the states of a part.

A margin needs the whole interval, so a verdict waits until the reach of the formula is over, and is
then the sign of its margin. The margins of all nodes are made anew at all states that are kept.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from ..programs import (
    ATOM,
    END,
    EVENTUALLY,
    IS_UPPER,
    LEFT_T,
    NUMBER,
    ONCE,
    OPERATION,
    OR,
    PREVIOUS,
    RIGHT_T,
    SINCE,
    SPREAD,
    START,
    TRUTH,
)
from ..time_searches import is_later, is_near, is_over
from ..windows import (
    NEVER,
    least_in_queue,
    since_of_margins_in_column,
    until_of_margins_in_column,
)
from .layout import IN_A_WORD, SIDES, UNKNOWN

TIED: Final = 2
"""In place of a value: a margin of 0 does not tell `>` from `>=`."""


def _bounds(
    valid: Any, count: Any, is_past: Any, start: Any, end: Any, first: Any, last: Any
) -> None:
    """Write the rows in the interval of each row: the first, and the one after the last."""
    low = high = 0
    for row in range(count):
        if is_past:
            while low < row and not is_near(valid, low, row, end):
                low += 1
            while high <= row and is_later(valid, high, row, start):
                high += 1
        else:
            low, high = max(low, row), max(high, row)
            while low < count and not is_later(valid, row, low, start):
                low += 1
            while high < count and is_near(valid, row, high, end):
                high += 1
        first[row], last[row] = low, high


def fill_margins(
    nodes: Any, valid: Any, atoms: Any, margins: Any, count: Any, tables: Any, scratch: Any
) -> None:
    """Fill the tables of margins, one a node, that of a negated operand being the opposite, and
    two more. ``scratch`` int64 (3, rows)."""
    first, last, queue = scratch[0], scratch[1], scratch[2]
    columns = tables.T
    for node in range(len(nodes)):
        operation, start, end = nodes[node, OPERATION], nodes[node, START], nodes[node, END]
        left, right = nodes[node, LEFT_T] // SIDES, nodes[node, RIGHT_T] // SIDES
        sign = 1 - 2 * (nodes[node, LEFT_T] % SIDES)
        other = 1 - 2 * (nodes[node, RIGHT_T] % SIDES)
        if operation == ATOM:
            number = nodes[node, NUMBER]
            word, shift = number // IN_A_WORD, 2 * (number % IN_A_WORD)
            unknown = np.inf if nodes[node, IS_UPPER] else -np.inf
            for row in range(count):
                is_known = (atoms[word, row] >> shift) & UNKNOWN == 0
                tables[node, row] = margins[number, row] if is_known else unknown
        elif operation == TRUTH:
            for row in range(count):
                tables[node, row] = np.inf
        elif operation == OR:
            for row in range(count):
                tables[node, row] = max(sign * tables[left, row], other * tables[right, row])
        elif operation == SPREAD:
            for row in range(count):
                tables[node, row] = sign * tables[left, row]
        elif operation == PREVIOUS:
            for row in range(count - 1, 0, -1):
                tables[node, row] = sign * tables[left, row - 1]
            tables[node, 0] = -np.inf
        else:
            _bounds(valid, count, operation in (ONCE, SINCE), start, end, first, last)
            if operation in (EVENTUALLY, ONCE):
                # The greatest of the opposite is the opposite of the least.
                least_in_queue(
                    columns, left, count, first, last, queue, columns, node, -sign, np.inf
                )
                for row in range(count):
                    tables[node, row] *= sign
                continue
            # Without the signs, in the two tables after those of nodes.
            a, b = len(tables) - 2, len(tables) - 1
            for row in range(count):
                tables[a, row] = sign * tables[left, row]
                tables[b, row] = other * tables[right, row]
            if operation == SINCE:
                since_of_margins_in_column(
                    columns, a, columns, b, count, first, last, columns, node
                )
            else:
                until_of_margins_in_column(
                    columns, a, columns, b, count, first, last, columns, node
                )


def decide_by_margins(
    roots: Any, is_done: Any, valid: Any, horizon: Any, count: Any, margins: Any, reach: Any,
    looks_back: Any, reports_all: Any, decided: Any, values: Any,
) -> tuple[Any, Any]:  # fmt: skip
    """Write when each start without a verdict is decided, `NEVER` if it is not yet, and as what:
    once the reach of the formula is over, its verdict is the sign of its margin, or `TIED`. Return
    the rows of which statuses are needed for that, or for a witness: the first, and the one after
    the last."""
    low_row, high_row, closed = count, 0, 0
    for row in range(count):
        closed = max(closed, row)
        while closed < count and not is_over(valid, row, reach, horizon[closed]):
            closed += 1
        decided[row] = NEVER
        if is_done[row] or closed == count:
            continue
        decided[row] = closed
        low, high = margin_of(roots[0], row, margins), margin_of(roots[2], row, margins)
        value = 1 if low > 0 else 0 if high < 0 else -1
        if low == 0 or high == 0:
            value = TIED
        values[row] = value
        if value == TIED or value == 0 or (value == 1 and reports_all):
            low_row, high_row = min(low_row, row), max(high_row, closed + 1)
    return 0 if looks_back else low_row, high_row


def margin_of(table: Any, row: Any, margins: Any) -> Any:
    """The margin of a node, or the opposite, at a row."""
    return margins[table // SIDES, row] * (1 - 2 * (table % SIDES))


MARGINS: Final = (
    least_in_queue, since_of_margins_in_column, until_of_margins_in_column, _bounds, fill_margins,
    decide_by_margins, margin_of,
)  # fmt: skip
"""For `Kernel`, which compiles them into the loop that calls these."""
