"""The witness of a verdict of a part, as `witness.Witnesses` has it, from the statuses of nodes."""

from __future__ import annotations

from typing import Any, Final

from ....streams.time import TIME_MAX
from ..programs import (
    ATOM,
    END,
    LEFT_T,
    ONCE,
    OPERATION,
    OR,
    PREVIOUS,
    RIGHT_T,
    SINCE,
    SPREAD,
    START,
    TRUTH,
    UNTIL,
)
from ..time_searches import ahead, back, behind, is_near, is_over, reach
from ..windows import NEVER, deciding_state
from .layout import SIDES, moment_of


def witness(
    nodes: Any, table: Any, row: Any, valid: Any, horizon: Any, count: Any, base: Any,
    statuses: Any, rows: Any, moments: Any, hint: Any,
) -> Any:  # fmt: skip
    """The row of the witness of what a table has at a row, or -1.

    ``count``: the rows known, which are ``rows`` of ``statuses``; ``base``: the moment of the
    first; ``moments`` int64 (2, rows) is scratch. ``hint``: the node, row and moment of the last
    question of `_first_by`, and its row.
    """
    while True:
        node, side = table >> 1, table & 1
        operation = nodes[node, OPERATION]
        left, right = nodes[node, LEFT_T + side], nodes[node, RIGHT_T + side]
        if operation in (ATOM, TRUTH):
            return row
        if operation == OR:
            a = moment_of(statuses[left >> 1, rows], left, row)
            b = moment_of(statuses[right >> 1, rows], right, row)
            is_left = a >= b if side else a <= b
            table = left if is_left else right
        elif operation == SPREAD:
            table = left
        elif operation == PREVIOUS:
            if row == 0:
                return -1
            table, row = left, row - 1
        elif operation in (UNTIL, SINCE):
            return _of_until(
                nodes, node, side, row, valid, horizon, count, base, statuses, rows, moments
            )
        else:
            if side:
                return -1
            return _first_by(nodes, node, row, valid, count, statuses, rows, hint)


def _of_until(
    nodes: Any, node: Any, side: Any, row: Any, valid: Any, horizon: Any, count: Any, base: Any,
    statuses: Any, rows: Any, moments: Any,
) -> Any:  # fmt: skip
    """The row of the right part, or that at which the left one fails."""
    is_past, closed = nodes[node, OPERATION] == SINCE, -1
    start, end = nodes[node, START], nodes[node, END]
    if is_past:
        first, last = back(valid, row, end), behind(valid, row, start)
    else:
        first, last, at = ahead(valid, row, start, count), reach(valid, row, end, count), row
        while at < count and not is_over(valid, row, end, horizon[at]):
            at += 1
        # The end of all streams comes after the last state, and so after what fails there.
        is_open = at == count or (at == count - 1 and horizon[at] == TIME_MAX)
        closed = NEVER if is_open else base + at
    for operand in range(2):
        table = nodes[node, (RIGHT_T if operand else LEFT_T) + side]
        column = statuses[table >> 1, rows]
        for each in range(min(first, row), max(last, row + 1)):
            moments[operand, each] = moment_of(column, table, each)
    columns = moments.T
    return deciding_state(columns, columns, 0, 1, row, first, last, closed, side == 0, is_past)


def _first_by(
    nodes: Any, node: Any, row: Any, valid: Any, count: Any, statuses: Any, rows: Any, hint: Any
) -> Any:
    """The first row in an interval at which the operand is known to hold when the node is, or
    -1."""
    operand = nodes[node, LEFT_T]
    column = statuses[operand >> 1, rows]
    by = moment_of(statuses[node, rows], SIDES * node, row)
    is_past, start, end = nodes[node, OPERATION] == ONCE, nodes[node, START], nodes[node, END]
    other = back(valid, row, end) if is_past else ahead(valid, row, start, count)
    # Starts that one state decides come together: it is the first one for each of them.
    if hint[0] == node and hint[1] <= row and by <= hint[2]:
        other = max(other, hint[3])
    while other < count and moment_of(column, operand, other) > by:
        other += 1
    found = other
    if is_past and other >= behind(valid, row, start):
        found = -1
    if not is_past and (other == count or not is_near(valid, row, other, end)):
        found = -1
    hint[0], hint[1], hint[2], hint[3] = node, row, by, found
    return found


WITNESS: Final = moment_of, deciding_state, _of_until, _first_by, witness
"""For `Kernel`, which compiles them into the loop that calls `witness`."""
