"""Compiled loops for a small pane that comes alone: fold its rows into exact sums, read the sums
of the groups that are in the window, count the facts of a sort (docs/explanation/design/0012).

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


def _enter(
    subjects: Any, counts: Any, seen: Any, stamp: int, ids: Any, count: int, first: Any, some: int
) -> tuple[int, int]:
    """Append the distinct subjects that have no ``stamp`` in ``seen`` to the ``count`` entries of
    ``ids``, and those of them that had no count to the ``some`` entries of ``first``; count each.
    Return the numbers of entries."""
    entries, fresh = _unsigned(count), _unsigned(some)
    for i in range(subjects.shape[0]):
        subject = _unsigned(subjects[i])
        if seen[subject] != stamp:
            seen[subject] = stamp
            ids[entries] = subjects[i]
            entries += _unsigned(1)
            if counts[subject] == 0:
                first[fresh] = subjects[i]
                fresh += _unsigned(1)
            counts[subject] += 1
    return int(entries), int(fresh)


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


def _enter_signature() -> Any:
    from numba import types

    ids, int64 = types.int32[::1], types.int64
    tuple_of: Any = types.UniTuple
    subjects = read_only(types.int32)
    return tuple_of(int64, 2)(subjects, ids, ids, int64, ids, int64, ids, int64)


enter = Kernel(_enter, _enter_signature)
fold_pane = Kernel(_fold_pane, _fold_signature)
read = Kernel(_read, _read_signature)
