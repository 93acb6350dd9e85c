"""Compiled loops over the states in a formula's intervals.

Arrays of *moments* have shape ``(n, c)``: for each of n states and c columns (bindings of
variables) the index of the state at which something is determined, `NEVER` if it is not yet.
States ``first[s] .. last[s] - 1`` are those in the interval of start s; neither bound decreases.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import JIT, Kernel

Moments = NDArray[np.int64]
NEVER: Final = np.int64(2**62)
"""Not determined by the states seen."""
_WIDE: Final = 16
"""Columns from which on rows are compared as vectors."""
_CELLS: Final = 1 << 15
"""Cells that are compared at once: they fit into a core's cache."""


def least(moments: Moments, first: Moments, last: Moments) -> Moments:
    """Return the least of ``moments`` in each interval, `NEVER` if it is empty. Cost: O(n c), or
    O(n c log w) vector operations for many columns and w states in the longest interval."""
    return _least(moments, first, last, 1)


def greatest(moments: Moments, first: Moments, last: Moments) -> Moments:
    """Return the greatest of ``moments`` in each interval, below 0 if it is empty. Cost: as
    `least`."""
    return _least(moments, first, last, -1)


def _least(moments: Moments, first: Moments, last: Moments, sign: int) -> Moments:
    """The least of ``sign * moments``, times ``sign``."""
    out = np.empty_like(moments)
    rows, columns = moments.shape
    if columns < _WIDE:
        _run(_least_queue, moments, first, last, np.empty(rows, np.int64), out, sign)
    else:
        block = np.empty((rows, min(columns, max(_WIDE, _CELLS // max(rows, 1)))), np.int64)
        _run(_least_wide, moments, first, last, block, out, sign)
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


def _run(kernel: Kernel, *arguments: Any) -> None:
    arrays = (a if isinstance(a, int) else np.ascontiguousarray(a) for a in arguments)
    (kernel if JIT else kernel.py_func)(*arrays)


def _least_queue_loop(moments: Any, first: Any, last: Any, queue: Any, out: Any, sign: Any) -> None:
    """Keep a queue of the rows that may still be the least of an interval."""
    rows, columns = moments.shape
    for column in range(columns):
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
            out[start, column] = (
                moments[queue[head], column]
                if head < tail and queue[head] < last[start]
                else sign * 2**62
            )


def _least_wide_loop(moments: Any, first: Any, last: Any, block: Any, out: Any, sign: Any) -> None:
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
                        out[start, left : left + size] = sign * 2**62
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
    true_left: Any,
    false_left: Any,
    true_right: Any,
    false_right: Any,
    first: Any,
    last: Any,
    closed: Any,
    out_true: Any,
    out_false: Any,
) -> None:
    rows, columns = true_left.shape
    for column in range(columns):
        for start in range(rows):
            # When left is known to hold at all states before; when right is known to be false at
            # all states of the interval before.
            holds, ruled_out = -1, start
            true, false = 2**62, 2**62
            for state in range(start, last[start]):
                if state >= first[start]:
                    true = min(true, max(true_right[state, column], holds))
                    ruled_out = max(ruled_out, false_right[state, column])
                # If left fails here, no later state counts, seen or not.
                false = min(false, max(ruled_out, false_left[state, column]))
                holds = max(holds, true_left[state, column])
            out_true[start, column] = true
            out_false[start, column] = min(false, max(ruled_out, closed[start]))


def _since_loop(
    true_left: Any,
    false_left: Any,
    true_right: Any,
    false_right: Any,
    first: Any,
    last: Any,
    out_true: Any,
    out_false: Any,
) -> None:
    rows, columns = true_left.shape
    for column in range(columns):
        for start in range(rows):
            holds, broken = -1, 2**62
            true, false = 2**62, start
            for state in range(start, first[start] - 1, -1):
                if state < last[start]:
                    true = min(true, max(max(true_right[state, column], holds), start))
                    false = max(false, min(false_right[state, column], broken))
                holds = max(holds, true_left[state, column])
                broken = min(broken, false_left[state, column])
            out_true[start, column] = true
            out_false[start, column] = false


def _least_signature() -> Any:
    from numba import types

    table, row = types.int64[:, ::1], types.int64[::1]
    return types.void(table, row, row, row, table, types.int64)


def _least_wide_signature() -> Any:
    from numba import types

    table, row = types.int64[:, ::1], types.int64[::1]
    return types.void(table, row, row, table, table, types.int64)


def _until_signature() -> Any:
    from numba import types

    table, row = types.int64[:, ::1], types.int64[::1]
    return types.void(table, table, table, table, row, row, row, table, table)


def _since_signature() -> Any:
    from numba import types

    table, row = types.int64[:, ::1], types.int64[::1]
    return types.void(table, table, table, table, row, row, table, table)


_least_queue = Kernel(_least_queue_loop, _least_signature)
_least_wide = Kernel(_least_wide_loop, _least_wide_signature)
_until = Kernel(_until_loop, _until_signature)
_since = Kernel(_since_loop, _since_signature)
