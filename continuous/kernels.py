"""The compiled loops of windows: few, small, with fixed signatures (see `streams.compiled`). Where
they are not compiled, a numpy route gives the same results, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..streams.compiled import JIT, Kernel


def _ascending(times: Any) -> bool:
    """Whether no time is less than the one before."""
    ordered = True
    for i in range(1, times.shape[0]):
        ordered &= times[i - 1] <= times[i]
    return ordered


def _fold_sums(
    subjects: Any,
    values: Any,
    skip: Any,
    start: int,
    group_of: Any,
    members: Any,
    used: int,
    state: Any,
) -> tuple[int, int]:
    """Add ``values`` and 1 to ``state[group]``, giving new subjects the next groups.

    Stops where ``state`` is full: returns the row to go on with, and the groups used.
    """
    rows = subjects.shape[0]
    masked = skip.shape[0] > 0
    # Choosing the rows of a block first, without a branch, costs half of testing each one.
    chosen = np.empty(512, np.int64)
    row = start
    while row < rows:
        stop = min(rows, row + 512)
        count = 0
        for i in range(row, stop):
            chosen[count] = i
            if not (masked and skip[i]):
                count += 1
        for j in range(count):
            i = chosen[j]
            subject = subjects[i]
            group = group_of[subject]
            if group < 0:
                if used == state.shape[0]:
                    return i, used
                group = used
                group_of[subject] = group
                members[group] = subject
                used += 1
            state[group, 0] += values[i]
            state[group, 1] += 1
        row = stop
    return rows, used


def _signatures(value: str) -> Callable[[], Any]:
    def make() -> Any:
        from numba import types

        scalar = types.float64 if value == "float64" else types.int64

        def read(kind: Any) -> Any:
            # Any stride, and read-only arrays (mapped files, Arrow buffers) too.
            return types.Array(kind, 1, "A", readonly=True)

        ids = types.int32[::1]
        state = types.Array(scalar, 2, "C")
        tuple_of: Any = types.UniTuple
        pair = tuple_of(types.int64, 2)
        return pair(
            read(types.int32),
            read(scalar),
            read(types.boolean),
            types.int64,
            ids,
            ids,
            types.int64,
            state,
        )

    return make


def _times() -> Any:
    from numba import types

    return types.boolean(types.Array(types.int64, 1, "A", readonly=True))


_ascending_kernel = Kernel(_ascending, _times)
_fold_float_kernel = Kernel(_fold_sums, _signatures("float64"))
_fold_integer_kernel = Kernel(_fold_sums, _signatures("int64"))

KERNELS = (_ascending_kernel, _fold_float_kernel, _fold_integer_kernel)
"""Every kernel, for warming up and for tests of the twins."""


def ascending(times: NDArray[np.int64]) -> bool:
    """Whether no time is less than the one before."""
    if JIT and len(times) > 4096:
        return bool(_ascending_kernel(times))
    return bool(np.all(times[1:] >= times[:-1]))


class Groups:
    """Term ids ↔ dense groups 0, 1, 2 … in order of first appearance.

    Memory: 4 bytes a term of the dictionary, 4 a group.
    """

    __slots__ = ("group_of", "members", "used")

    def __init__(self) -> None:
        self.group_of: NDArray[np.int32] = np.full(0, -1, np.int32)
        self.members: NDArray[np.int32] = np.empty(0, np.int32)
        self.used = 0

    def reach(self, terms: int) -> None:
        """Make room for ids below ``terms``."""
        if len(self.group_of) < terms:
            grown = np.full(max(terms, 2 * len(self.group_of), 1024), -1, np.int32)
            grown[: len(self.group_of)] = self.group_of
            self.group_of = grown

    def reserve(self, capacity: int) -> None:
        """Make room for ``capacity`` groups."""
        if len(self.members) < capacity:
            grown = np.empty(capacity, np.int32)
            grown[: self.used] = self.members[: self.used]
            self.members = grown

    def keep(self, kept: NDArray[np.int64]) -> None:
        """Forget all groups but ``kept`` (ascending), which become 0, 1, 2 …"""
        self.group_of[self.members[: self.used]] = -1
        self.used = len(kept)
        self.members = self.members[kept]
        self.group_of[self.members] = np.arange(self.used, dtype=np.int32)

    def groups(self, subjects: NDArray[np.int32]) -> NDArray[np.int32]:
        """The group of each id, new ones given in order of appearance. In numpy."""
        found: NDArray[np.int32] = self.group_of[subjects]
        new = subjects[found < 0]
        if len(new):
            distinct, first = np.unique(new, return_index=True)
            distinct = distinct[np.argsort(first)]
            self.reserve(max(self.used + len(distinct), 2 * len(self.members)))
            self.group_of[distinct] = np.arange(self.used, self.used + len(distinct))
            self.members[self.used : self.used + len(distinct)] = distinct
            self.used += len(distinct)
            found = self.group_of[subjects]
        return found


_NO_SKIP = np.zeros(0, np.bool_)


def fold_sums(
    subjects: NDArray[np.int32],
    values: NDArray[Any],
    skip: NDArray[np.bool_] | None,
    groups: Groups,
    state: NDArray[Any],
) -> NDArray[Any]:
    """``state[g]`` += (value, 1) for each row not in ``skip``, one after the other.

    ``state`` has shape ``(capacity, 2)`` (sum, count), float64 or int64 like ``values``; a larger
    copy is returned when there are more groups. Law: folding the parts of a batch in order gives
    the same bits as folding the batch. Cost: about a nanosecond a row while the state fits a cache.
    """
    if not JIT or state.dtype == object:
        if skip is not None:
            subjects, values = subjects[~skip], values[~skip]
        found = groups.groups(subjects)
        state = grown(state, groups.used, 0)
        np.add.at(state[:, 0], found, values)
        np.add.at(state[:, 1], found, 1)
        return state
    kernel = _fold_float_kernel if state.dtype == np.float64 else _fold_integer_kernel
    state = grown(state, max(groups.used, 256), 0)
    row = 0
    mask = _NO_SKIP if skip is None else skip
    while True:
        groups.reserve(len(state))
        row, groups.used = kernel(
            subjects, values, mask, row, groups.group_of, groups.members, groups.used, state
        )
        if row == len(subjects):
            return state
        state = grown(state, 4 * len(state), 0)


def grown(state: NDArray[Any], capacity: int, fill: Any) -> NDArray[Any]:
    """``state`` with at least ``capacity`` rows, new ones ``fill``."""
    if len(state) >= capacity:
        return state
    larger = np.full((capacity, *state.shape[1:]), fill, state.dtype)
    larger[: len(state)] = state
    return larger
