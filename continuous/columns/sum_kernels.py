"""The compiled loops of exact sums (`exact_sums`), and two for a small pane that comes alone: fold
its rows, and read the groups that are in the window (docs/explanation/design/0012).

Law: `fold_pane` gives what `RowFold.add`, `RowFold.take` and `FloatTotals.add` give, to the last
bit; `read` gives what `FloatTotals.values` gives. A call of numpy takes as long as these loops take
for a hundred rows, and the other way has twenty.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...streams.jit import Kernel
from .fold_kernels import read_only

_unsigned = np.uint64
BITS = 40
"""The bits of a digit (`exact_sums`)."""
HALF = 2 ** (BITS - 1)


def _add(
    digits: Any,
    counts: Any,
    at: Any,
    values: Any,
    numbers: Any,
    start: int,
    sign: float,
    grains: Any,
    inverse: Any,
) -> int:
    """Add ``sign`` times each value and its number to its group; return the row where it stopped.

    Without ``at`` the groups are 0, 1, 2 …; without ``numbers`` each is 1. The loop adds a block of
    512 rows at a time, or nothing of it: it stops at a block with a value that the digits cannot
    represent. It first computes the digits of a whole block without branches, so that the compiler
    uses vector instructions.
    """
    depth, rows = digits.shape[0], values.shape[0]
    limit = grains[0] * 2.0**BITS
    rest, counted = np.empty(512, np.float64), np.empty(512, np.int64)
    parts = np.empty((depth, 512), np.int64)
    counted[:] = np.int64(sign)
    for begin in range(start, rows, 512):
        size = min(512, rows - begin)
        beyond = 0
        for i in range(size):
            rest[i] = sign * values[begin + i]
            beyond += not abs(rest[i]) < limit
        if beyond > 0:
            return begin
        for k in range(depth):
            row = parts[k]
            for i in range(size):
                part = np.int64(rest[i] * inverse[k])
                row[i] = part
                rest[i] -= part * grains[k]
        for i in range(size):
            beyond += rest[i] != 0.0
        if beyond > 0:
            return begin
        if numbers.shape[0] > 0:
            for i in range(size):
                counted[i] = np.int64(sign * numbers[begin + i])
        if at.shape[0] > 0:
            for k in range(depth):
                row, total = parts[k], digits[k]
                for i in range(size):
                    total[np.uint64(at[begin + i])] += row[i]
            for i in range(size):
                counts[np.uint64(at[begin + i])] += counted[i]
        else:
            for k in range(depth):
                row, total = parts[k], digits[k, begin : begin + size]
                for i in range(size):
                    total[i] += row[i]
            total = counts[begin : begin + size]
            for i in range(size):
                total[i] += counted[i]
    return int(rows)


def _round(digits: Any, rows: Any, grains: Any, out: Any) -> None:
    """Write the sum of group ``rows[i]`` to ``out[i]``. Carries are propagated first, so that equal
    sums have equal digits and round equally."""
    depth = digits.shape[0]
    for i in range(rows.shape[0]):
        group = np.uint64(rows[i])
        carry = np.int64(0)
        total = 0.0
        for j in range(depth):
            k = depth - 1 - j
            digit = digits[k, group] + carry
            carry = (digit + HALF) >> BITS
            total += (digit - (carry << BITS)) * grains[k]
        if carry != 0:
            total += carry * (grains[0] * 2.0**BITS)
        out[i] = total


def _fold_pane(
    subjects: Any,
    values: Any,
    great: float,
    group_of: Any,
    members: Any,
    used: int,
    state: Any,
    digits: Any,
    counts: Any,
    grains: Any,
    inverse: Any,
    at: Any,
    columns: Any,
) -> tuple[int, int, bool]:
    """Fold the rows by group into ``columns`` (the rows of `RowFold.state`), with the groups in
    ``at``, ascending; then add sums and counts to ``digits`` and ``counts``.

    Return the number of all groups, the number of groups in ``at``, and whether they have been
    added: a sum may need other digits. If a value is not below ``great``, do nothing and return -1
    as the second number. ``state`` is empty before and after.
    """
    rows, extremes = subjects.shape[0], state.shape[1] == 4
    for i in range(rows):
        if not abs(values[i]) < great:
            return used, -1, False
    touched = 0
    for i in range(rows):
        subject = _unsigned(subjects[i])
        group = group_of[subject]
        if group < 0:
            group = used
            group_of[subject] = group
            members[_unsigned(group)] = subjects[i]
            used += 1
        g = _unsigned(group)
        if state[g, 1] == 0.0:
            at[touched] = group
            touched += 1
        state[g, 0] += values[i]
        state[g, 1] += 1.0
        if extremes:
            value = values[i] + 0.0
            state[g, 2] = min(state[g, 2], value)
            state[g, 3] = min(state[g, 3], -value)
    if 4 * touched >= used:
        place = 0
        for group in range(used):
            if state[_unsigned(group), 1] != 0.0:
                at[place] = group
                place += 1
    else:
        at[:touched].sort()
    depth, limit = digits.shape[0], grains[0] * 2.0**BITS
    fits = True
    for i in range(touched):
        g = _unsigned(at[i])
        rest = state[g, 0]
        columns[0, i], columns[1, i] = rest, state[g, 1]
        state[g, 0], state[g, 1] = 0.0, 0.0
        if extremes:
            columns[2, i], columns[3, i] = state[g, 2], state[g, 3]
            state[g, 2], state[g, 3] = np.inf, np.inf
        if not abs(rest) < limit:
            fits = False
            continue
        for k in range(depth):
            rest -= np.int64(rest * inverse[k]) * grains[k]
        fits &= rest == 0.0
    if fits:
        for i in range(touched):
            g = _unsigned(at[i])
            rest = columns[0, i]
            for k in range(depth):
                part = np.int64(rest * inverse[k])
                digits[k, g] += part
                rest -= part * grains[k]
            counts[g] += np.int64(columns[1, i])
    return used, touched, fits


def _read(
    digits: Any, counts: Any, of: Any, used: int, grains: Any, rows: Any, sums: Any, numbers: Any
) -> int:
    """Write the groups below ``used`` that have rows, and are in ``of`` unless that is empty, their
    sums and their counts; return how many there are. The sums are rounded as `exact_sums` does."""
    depth, found = digits.shape[0], 0
    for group in range(used):
        g = _unsigned(group)
        if counts[g] == 0 or (of.shape[0] > 0 and not of[g]):
            continue
        carry = np.int64(0)
        total = 0.0
        for j in range(depth):
            k = depth - 1 - j
            digit = digits[k, g] + carry
            carry = (digit + HALF) >> BITS
            total += (digit - (carry << BITS)) * grains[k]
        if carry != 0:
            total += carry * (grains[0] * 2.0**BITS)
        rows[found], sums[found], numbers[found] = group, total, counts[g]
        found += 1
    return found


def _fold_signature() -> Any:
    from numba import types

    ids, floats = types.int32[::1], types.float64[::1]
    table = types.Array(types.float64, 2, "C")
    tuple_of: Any = types.Tuple
    return tuple_of((types.int64, types.int64, types.boolean))(
        read_only(types.int32, "C"),
        read_only(types.float64, "C"),
        types.float64,
        ids,
        ids,
        types.int64,
        table,
        types.Array(types.int64, 2, "C"),
        types.int64[::1],
        floats,
        floats,
        ids,
        table,
    )


def _read_signature() -> Any:
    from numba import types

    ints, floats = types.int64[::1], types.float64[::1]
    return types.int64(
        types.Array(types.int64, 2, "C"),
        ints,
        read_only(types.boolean, "C"),
        types.int64,
        floats,
        ints,
        floats,
        ints,
    )


def _add_signature() -> Any:
    from numba import types

    value, ints = read_only(types.float64, "C"), types.int64[::1]
    return types.int64(
        types.Array(types.int64, 2, "C"),
        ints,
        read_only(types.int32, "C"),
        value,
        value,
        types.int64,
        types.float64,
        types.float64[::1],
        types.float64[::1],
    )


def _round_signature() -> Any:
    from numba import types

    return types.void(
        types.Array(types.int64, 2, "C"),
        read_only(types.int64),
        types.float64[::1],
        types.float64[::1],
    )


add = Kernel(_add, _add_signature)
round_sums = Kernel(_round, _round_signature)
fold_pane = Kernel(_fold_pane, _fold_signature)
read = Kernel(_read, _read_signature)
