"""Compiled loops over the states in a formula's intervals.

Arrays of *moments* have shape ``(n, c)``: for each of n states and c columns (bindings of
variables) the index of the state at which something is determined, `NEVER` if it is not yet.
Arrays of *margins* have the same shape and are floats. What holds of least moments holds of
greatest margins, with infinity for `NEVER`: the same loops serve both.
States ``first[s] .. last[s] - 1`` are those in the interval of start s; neither bound decreases.
"""

from __future__ import annotations

from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import Kernel

Moments = NDArray[np.int64]
Table = TypeVar("Table", NDArray[np.int64], NDArray[np.float64])
NEVER: Final = 2**62
"""Not determined by the states seen."""
_WIDE: Final = 16
"""Columns from which on rows are compared as vectors."""
_CELLS: Final = 1 << 15
"""Cells that are compared at once: they fit into a core's cache."""


def least(table: Table, first: Moments, last: Moments) -> Table:
    """Return the least of ``table`` in each interval, `NEVER` or infinity if it is empty. Cost:
    O(n c), or O(n c log w) vector operations for many columns and w states in the longest
    interval."""
    return _least(table, first, last, 1)


def greatest(table: Table, first: Moments, last: Moments) -> Table:
    """Return the greatest of ``table`` in each interval, below 0 or -oo if it is empty. Cost: as
    `least`."""
    return _least(table, first, last, -1)


def _least(table: Table, first: Moments, last: Moments, sign: int) -> Table:
    """The least of ``sign * table``, times ``sign``."""
    out = np.empty(table.shape, table.dtype)
    rows, columns = table.shape
    is_margin = table.dtype.kind == "f"
    empty = np.inf if is_margin else NEVER
    if columns < _WIDE:
        kernel = _least_queue_of_margins if is_margin else _least_queue
        _run(kernel, table, first, last, np.empty(rows, np.int64), out, sign, empty)
    else:
        kernel = _least_wide_of_margins if is_margin else _least_wide
        width = min(columns, max(_WIDE, _CELLS // max(rows, 1)))
        _run(kernel, table, first, last, np.empty((rows, width), table.dtype), out, sign, empty)
    return out


def until(
    true_left: Moments,
    false_left: Moments,
    true_right: Moments,
    false_right: Moments,
    first: Moments,
    last: Moments,
    closed: Moments,
) -> tuple[Moments, Moments]:
    """Return when ``left until right`` is determined true, and false.

    ``closed[s]``: the state from which on no later state is in the interval of s. Cost: O(n c w)
    for w states up to the end of an interval.
    """
    out = np.empty_like(true_left), np.empty_like(true_left)
    _run(_until, true_left, false_left, true_right, false_right, first, last, closed, *out)
    return out


def since(
    true_left: Moments,
    false_left: Moments,
    true_right: Moments,
    false_right: Moments,
    first: Moments,
    last: Moments,
) -> tuple[Moments, Moments]:
    """Return when ``left since right`` is determined true, and false. Cost: as `until`."""
    out = np.empty_like(true_left), np.empty_like(true_left)
    _run(_since, true_left, false_left, true_right, false_right, first, last, *out)
    return out


def until_of_margins(
    left: NDArray[np.float64], right: NDArray[np.float64], first: Moments, last: Moments
) -> NDArray[np.float64]:
    """Return the margin of ``left until right``. Cost: as `until`."""
    out = np.empty_like(left)
    _run(_until_of_margins, left, right, first, last, out)
    return out


def since_of_margins(
    left: NDArray[np.float64], right: NDArray[np.float64], first: Moments, last: Moments
) -> NDArray[np.float64]:
    """Return the margin of ``left since right``. Cost: as `until`."""
    out = np.empty_like(left)
    _run(_since_of_margins, left, right, first, last, out)
    return out


def first_by(
    table: Moments, column: Moments, first: Moments, last: Moments, by: Moments
) -> Moments:
    """Return the first state in each interval whose moment is not after ``by``, in a column of its
    own; -1 if there is none. All but ``table`` have shape ``(m,)``. Cost: O(m w) for w states up to
    that one."""
    out = np.empty(len(first), np.int64)
    _run(_first_by, table, column, first, last, by, out)
    return out


def deciding(
    left: Moments,
    right: Moments,
    left_column: Moments,
    right_column: Moments,
    start: Moments,
    first: Moments,
    last: Moments,
    closed: Moments,
    *,
    is_true: bool,
    is_past: bool,
) -> Moments:
    """Return the state that decides each ``left until right``: that of right, or with ``is_true``
    False that at which left fails before right is false throughout; -1 if no state does.
    ``is_past``: ``left since right``. The tables have the moments at which the parts are true, or
    false; ``closed`` as in `until`. Cost: O(m w)
    for w states in an interval."""
    out = np.empty(len(start), np.int64)
    tables = left, right, left_column, right_column
    _run(_deciding, *tables, start, first, last, closed, int(is_true), int(is_past), out)
    return out


def _run(kernel: Kernel, *arguments: Any) -> None:
    arrays = [
        np.ascontiguousarray(a) if isinstance(a, np.ndarray) and not a.flags.c_contiguous else a
        for a in arguments
    ]
    kernel.run(*arrays, size=max(each.size for each in arrays if isinstance(each, np.ndarray)))


# Each loop takes a column of each table.


def least_in_queue(
    moments: Any, column: Any, rows: Any, first: Any, last: Any, queue: Any, out: Any, to: Any,
    sign: Any, empty: Any,
) -> None:  # fmt: skip
    """Keep a queue of the rows that may still be the least of an interval."""
    head = tail = row = 0
    for start in range(rows):
        while row < last[start]:
            new = sign * moments[row, column]
            while tail > head and sign * moments[queue[tail - 1], column] >= new:
                tail -= 1
            queue[tail] = row
            tail += 1
            row += 1
        while head < tail and queue[head] < first[start]:
            head += 1
        out[start, to] = (
            moments[queue[head], column]
            if head < tail and queue[head] < last[start]
            else sign * empty
        )


def _least_queue_loop(
    moments: Any, first: Any, last: Any, queue: Any, out: Any, sign: Any, empty: Any
) -> None:
    rows, columns = moments.shape
    for column in range(columns):
        least_in_queue(moments, column, rows, first, last, queue, out, column, sign, empty)


def _least_wide_loop(
    moments: Any, first: Any, last: Any, block: Any, out: Any, sign: Any, empty: Any
) -> None:
    """Some columns at a time, make the least of 1, 2, 4, … rows from each row on; an interval is
    two of these, which may overlap."""
    rows, columns = moments.shape
    width = block.shape[1]
    for left in range(0, columns, width):
        size = min(width, columns - left)
        for row in range(rows):
            for column in range(size):
                block[row, column] = sign * moments[row, left + column]
        span = 1
        goes_on = True
        while goes_on:
            goes_on = False
            for start in range(rows):
                length = last[start] - first[start]
                if length < 1:
                    if span == 1:
                        out[start, left : left + size] = sign * empty
                elif length >= 2 * span:
                    goes_on = True
                elif length >= span:
                    head, tail = first[start], last[start] - span
                    for column in range(size):
                        found = block[head, column]
                        other = block[tail, column]
                        out[start, left + column] = sign * (found if found < other else other)
            if goes_on:
                for row in range(rows - span):
                    for column in range(size):
                        found = block[row, column]
                        other = block[row + span, column]
                        block[row, column] = found if found < other else other
                span *= 2


def _until_loop(
    true_left: Any, false_left: Any, true_right: Any, false_right: Any, first: Any, last: Any,
    closed: Any, out_true: Any, out_false: Any,
) -> None:  # fmt: skip
    rows, columns = true_left.shape
    for i in range(columns):
        for start in range(rows):
            # When left is known to hold at all states before; when right is known to be false at
            # all states of the interval before.
            holds, ruled_out = -1, start
            true, false = 2**62, 2**62
            for state in range(start, last[start]):
                if state >= first[start]:
                    true = min(true, max(true_right[state, i], holds))
                    ruled_out = max(ruled_out, false_right[state, i])
                # If left fails here, no later state counts, seen or not.
                false = min(false, max(ruled_out, false_left[state, i]))
                holds = max(holds, true_left[state, i])
            out_true[start, i] = true
            out_false[start, i] = min(false, max(ruled_out, closed[start]))


def _since_loop(
    true_left: Any, false_left: Any, true_right: Any, false_right: Any, first: Any, last: Any,
    out_true: Any, out_false: Any,
) -> None:  # fmt: skip
    rows, columns = true_left.shape
    for i in range(columns):
        for start in range(rows):
            holds, broken = -1, 2**62
            true, false = 2**62, start
            for state in range(start, first[start] - 1, -1):
                if state < last[start]:
                    true = min(true, max(max(true_right[state, i], holds), start))
                    false = max(false, min(false_right[state, i], broken))
                holds = max(holds, true_left[state, i])
                broken = min(broken, false_left[state, i])
            out_true[start, i] = true
            out_false[start, i] = false


def until_of_margins_in_column(
    left: Any, a: Any, right: Any, b: Any, rows: Any, first: Any, last: Any, out: Any, to: Any
) -> None:
    for start in range(rows):
        # The least margin of left at the states before.
        held, found = np.inf, -np.inf
        for state in range(start, last[start]):
            if state >= first[start]:
                found = max(found, min(right[state, b], held))
            held = min(held, left[state, a])
            if held <= found:
                break  # no later state has more
        out[start, to] = found


def _until_of_margins_loop(left: Any, right: Any, first: Any, last: Any, out: Any) -> None:
    rows, columns = left.shape
    for i in range(columns):
        until_of_margins_in_column(left, i, right, i, rows, first, last, out, i)


def since_of_margins_in_column(
    left: Any, a: Any, right: Any, b: Any, rows: Any, first: Any, last: Any, out: Any, to: Any
) -> None:
    for start in range(rows):
        held, found = np.inf, -np.inf
        for state in range(start, first[start] - 1, -1):
            if state < last[start]:
                found = max(found, min(right[state, b], held))
            held = min(held, left[state, a])
            if held <= found:
                break
        out[start, to] = found


def _since_of_margins_loop(left: Any, right: Any, first: Any, last: Any, out: Any) -> None:
    rows, columns = left.shape
    for i in range(columns):
        since_of_margins_in_column(left, i, right, i, rows, first, last, out, i)


def _first_by_loop(table: Any, column: Any, first: Any, last: Any, by: Any, out: Any) -> None:
    for i in range(len(first)):
        out[i] = -1
        begin = first[i]
        # Starts that one state decides come together: it is the first one for each of them.
        if (
            i > 0
            and column[i] == column[i - 1]
            and first[i - 1] <= begin < out[i - 1]
            and by[i] <= by[i - 1]
        ):
            begin = out[i - 1]
        for state in range(begin, last[i]):
            if table[state, column[i]] <= by[i]:
                out[i] = state
                break


def deciding_state(
    left: Any,
    right: Any,
    left_column: Any,
    right_column: Any,
    start: Any,
    first: Any,
    last: Any,
    closed: Any,
    is_true: Any,
    is_past: Any,
) -> Any:
    """The state that decides a verdict, as `deciding` says."""
    # When left held at all states by now, or right was known to fail at all of the interval.
    least, held, found = 2**62, -1, -1
    count = start - first + 1 if is_past else last - start
    for step in range(count):
        state = start - step if is_past else start + step
        is_inside = state < last if is_past else state >= first
        own, other = left[state, left_column], right[state, right_column]
        if is_true:
            moment = max(other, held) if is_inside else 2**62
            held = max(held, own)
        else:
            if is_inside:
                held = max(held, other)
            moment = max(held, own)
        if moment < least:
            least, found = moment, state
    return found if is_true or least < max(held, closed) else -1


def _deciding_loop(
    left: Any,
    right: Any,
    left_column: Any,
    right_column: Any,
    start: Any,
    first: Any,
    last: Any,
    closed: Any,
    is_true: Any,
    is_past: Any,
    out: Any,
) -> None:
    for i in range(len(start)):
        out[i] = deciding_state(
            left, right, left_column[i], right_column[i], start[i], first[i], last[i], closed[i],
            is_true, is_past,
        )  # fmt: skip


def _types() -> tuple[Any, Any, Any, Any]:
    """Tables of moments and of margins, a row of indices, and the module."""
    from numba import types

    return types.int64[:, ::1], types.float64[:, ::1], types.int64[::1], types


def _least_signature() -> Any:
    table, _, row, types = _types()
    return types.void(table, row, row, row, table, types.int64, types.int64)


def _least_of_margins_signature() -> Any:
    _, table, row, types = _types()
    return types.void(table, row, row, row, table, types.int64, types.float64)


def _least_wide_signature() -> Any:
    table, _, row, types = _types()
    return types.void(table, row, row, table, table, types.int64, types.int64)


def _least_wide_of_margins_signature() -> Any:
    _, table, row, types = _types()
    return types.void(table, row, row, table, table, types.int64, types.float64)


def _until_signature() -> Any:
    table, _, row, types = _types()
    return types.void(table, table, table, table, row, row, row, table, table)


def _since_signature() -> Any:
    table, _, row, types = _types()
    return types.void(table, table, table, table, row, row, table, table)


def _margins_signature() -> Any:
    _, table, row, types = _types()
    return types.void(table, table, row, row, table)


def _first_by_signature() -> Any:
    table, _, row, types = _types()
    return types.void(table, row, row, row, row, row)


def _deciding_signature() -> Any:
    table, _, row, types = _types()
    flag = types.int64
    return types.void(table, table, row, row, row, row, row, row, flag, flag, row)


_COLUMNS: Final = (
    least_in_queue, until_of_margins_in_column, since_of_margins_in_column, deciding_state,
)  # fmt: skip
_least_queue = Kernel(_least_queue_loop, _least_signature, calls=_COLUMNS)
_least_queue_of_margins = Kernel(_least_queue_loop, _least_of_margins_signature, calls=_COLUMNS)
_least_wide = Kernel(_least_wide_loop, _least_wide_signature)
_least_wide_of_margins = Kernel(_least_wide_loop, _least_wide_of_margins_signature)
_until = Kernel(_until_loop, _until_signature)
_since = Kernel(_since_loop, _since_signature)
_until_of_margins = Kernel(_until_of_margins_loop, _margins_signature, calls=_COLUMNS)
_since_of_margins = Kernel(_since_of_margins_loop, _margins_signature, calls=_COLUMNS)
_first_by = Kernel(_first_by_loop, _first_by_signature)
_deciding = Kernel(_deciding_loop, _deciding_signature, calls=_COLUMNS)
