"""The compiled loops over rows: few, small, with fixed signatures (see `streams.jit`). Without
compilation, a numpy implementation gives the same results, bit for bit.

Indices are converted to unsigned integers before use: for a signed index numba checks whether it
counts from the end, which costs a third of these loops.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import JIT, Kernel

_unsigned = np.uint64
Layout = Literal["A", "C"]
_LAYOUTS: tuple[Layout, ...] = ("C", "A")


def _ascending(times: Any) -> bool:
    """Whether no time is less than its predecessor."""
    ordered = True
    for i in range(1, times.shape[0]):
        ordered &= times[i - 1] <= times[i]
    return ordered


def _fold(
    subjects: Any,
    values: Any,
    skip: Any,
    start: int,
    group_of: Any,
    members: Any,
    used: int,
    state: Any,
    touched: Any,
    count: int,
    listing: bool,
    turn: Any,
) -> tuple[int, int, int]:
    """Add ``values`` and 1 to ``state[group]``; new subjects get the next groups.

    If ``state`` has four columns, the third is the least value and the fourth the least mirrored
    value, ``turn - value``. As in numpy, NaN is less than all; -0.0 is 0.0. ``listing`` adds groups
    whose count was 0 to ``touched``. Stops when ``state`` is full. Returns the row to continue
    with, the number of groups, and the number of touched groups.
    """
    rows = subjects.shape[0]
    masked = skip.shape[0] > 0
    extremes = state.shape[1] == 4
    # Collecting the selected rows of a block first, without a branch, halves the cost of the mask.
    chosen = np.empty(512, np.uint64)
    touches = _unsigned(count)
    row = start
    while row < rows:
        stop = min(rows, row + 512)
        some = _unsigned(0)
        if masked:
            for i in range(_unsigned(row), _unsigned(stop)):
                chosen[some] = i
                some += _unsigned(not skip[i])
        else:
            for i in range(_unsigned(row), _unsigned(stop)):
                chosen[some] = i
                some += _unsigned(1)
        for j in range(some):
            i = chosen[j]
            subject = subjects[i]
            group = group_of[_unsigned(subject)]
            if group < 0:
                if used == state.shape[0]:
                    return int(i), used, int(touches)
                group = used
                group_of[_unsigned(subject)] = group
                members[_unsigned(group)] = subject
                used += 1
            at = _unsigned(group)
            if listing:
                touched[touches] = group
                touches += _unsigned(state[at, _unsigned(1)] == 0)
            value = values[i]
            state[at, _unsigned(0)] += value
            state[at, _unsigned(1)] += 1
            if extremes:
                least, mirrored = state[at, _unsigned(2)], state[at, _unsigned(3)]
                value += 0
                mirror = turn - value
                keep = least <= value or least != least
                state[at, _unsigned(2)] = least if keep else value
                keep = mirrored <= mirror or mirrored != mirrored
                state[at, _unsigned(3)] = mirrored if keep else mirror
        row = stop
    return rows, used, int(touches)


def read_only(kind: Any, layout: Layout = "A") -> Any:
    """Return the type of an array argument that may be read-only (a file, an Arrow buffer), of any
    stride (``"A"``) or contiguous (``"C"``)."""
    from numba import types

    return types.Array(kind, 1, layout, readonly=True)


def _signature(value: str, layout: Layout) -> Callable[[], Any]:
    def make() -> Any:
        from numba import types

        scalar = types.float64 if value == "float64" else types.int64
        ids = types.int32[::1]
        rows = tuple(read_only(kind, layout) for kind in (types.int32, scalar, types.boolean))
        state = types.Array(scalar, 2, "C")
        tuple_of: Any = types.UniTuple
        return tuple_of(types.int64, 3)(
            *rows,
            types.int64,
            ids,
            ids,
            types.int64,
            state,
            ids,
            types.int64,
            types.boolean,
            scalar,
        )

    return make


def _times() -> Any:
    from numba import types

    return types.boolean(read_only(types.int64, "C"))


_ascending_kernel = Kernel(_ascending, _times)
_folds = {
    (np.dtype(name), layout): Kernel(_fold, _signature(name, layout))
    for name in ("float64", "int64")
    for layout in _LAYOUTS
}
"""By type of the values and layout: contiguous rows, the usual case, take a fifth less time."""


def ascending(times: NDArray[np.int64]) -> bool:
    """Whether no time is less than its predecessor."""
    if JIT and len(times) > 4096:
        return bool(_ascending_kernel(np.ascontiguousarray(times)))
    return len(times) < 2 or not np.count_nonzero(times[1:] < times[:-1])


class Groups:
    """Term ids ↔ dense groups 0, 1, 2 … in order of first appearance.

    Memory: 4 bytes per term of the dictionary, 4 per group.
    """

    __slots__ = ("group_of", "members", "used")

    def __init__(self) -> None:
        self.group_of: NDArray[np.int32] = np.full(0, -1, np.int32)
        self.members: NDArray[np.int32] = np.empty(0, np.int32)
        self.used = 0

    def reach(self, terms: int) -> None:
        """Allocate space for ids below ``terms``."""
        if len(self.group_of) < terms:
            grown = np.full(max(terms, 2 * len(self.group_of), 1024), -1, np.int32)
            grown[: len(self.group_of)] = self.group_of
            self.group_of = grown

    def reserve(self, capacity: int) -> None:
        """Allocate space for ``capacity`` groups."""
        if len(self.members) < capacity:
            grown = np.empty(capacity, np.int32)
            grown[: self.used] = self.members[: self.used]
            self.members = grown

    def keep(self, kept: NDArray[np.int64]) -> None:
        """Drop all groups except ``kept`` (ascending), which become 0, 1, 2 …"""
        self.group_of[self.members[: self.used]] = -1
        self.used = len(kept)
        self.members = self.members[kept]
        self.group_of[self.members] = np.arange(self.used, dtype=np.int32)

    def groups(self, subjects: NDArray[np.int32]) -> NDArray[np.int32]:
        """Return the group of each id; new ids get groups in order of appearance. In numpy."""
        # `take` is twice as fast as an index here.
        found: NDArray[np.int32] = self.group_of.take(subjects)
        new = subjects[found < 0]
        if len(new):
            distinct, first = np.unique(new, return_index=True)
            distinct = distinct[np.argsort(first)]
            needed = self.used + len(distinct)
            if needed > len(self.members):
                self.reserve(2 * needed)
            self.group_of[distinct] = np.arange(self.used, self.used + len(distinct))
            self.members[self.used : self.used + len(distinct)] = distinct
            self.used += len(distinct)
            found = self.group_of.take(subjects)
        return found


NO_SKIP = np.zeros(0, np.bool_)


def mirror(values: NDArray[Any]) -> NDArray[Any]:
    """Reverse the order of the values, so that the least result stands for the greatest value.

    An integer becomes its complement, since the negative of the least int64 does not fit.
    """
    return -values if values.dtype == np.float64 else ~values


class RowFold:
    """Folds rows by group: sum, count and optionally the extremes.

    ``state``: shape ``(capacity, 2 or 4)``, of the type of the values: sum, count, the least value,
    the least mirrored value. Law: folding the parts of a batch in order gives the same bits as
    folding the batch. Cost: one to three nanoseconds per row while the state fits a cache. Memory:
    the state, and 4 bytes per group.
    """

    __slots__ = ("_count", "_listed", "_touched", "empty", "state")

    def __init__(self, dtype: np.dtype[Any], extremes: bool) -> None:
        greatest = np.inf if dtype == np.float64 else 2**63 - 1
        self.empty = np.array([0, 0, greatest, greatest][: 4 if extremes else 2], dtype)
        self.state: NDArray[Any] = np.zeros((0, len(self.empty)), dtype)
        self._touched: NDArray[np.int32] = np.empty(1, np.int32)
        self._count = 0
        self._listed = True

    def add(
        self,
        subjects: NDArray[np.int32],
        values: NDArray[Any],
        skip: NDArray[np.bool_] | None,
        groups: Groups,
    ) -> None:
        """Fold the rows that are not in ``skip``, in order."""
        if not JIT:
            if skip is not None:
                subjects, values = subjects[~skip], values[~skip]
            found = groups.groups(subjects)
            self.reserve(groups.used)
            np.add.at(self.state[:, 0], found, values)
            np.add.at(self.state[:, 1], found, 1)
            if len(self.empty) == 4:
                values = values + 0
                # A NaN is no error: it is less than all, as in the loop.
                with np.errstate(invalid="ignore"):
                    np.minimum.at(self.state[:, 2], found, values)
                    np.minimum.at(self.state[:, 3], found, mirror(values))
            self._listed = False
            return
        # If many groups are touched, a list of them costs more than a search.
        self._listed &= len(subjects) < groups.used
        self.reserve(max(groups.used, 256))
        mask = NO_SKIP if skip is None else skip
        contiguous = all(rows.flags.c_contiguous for rows in (subjects, values, mask))
        kernel, row = _folds[self.state.dtype, "C" if contiguous else "A"], 0
        while True:
            groups.reserve(len(self.state))
            row, groups.used, self._count = kernel(
                subjects,
                values,
                mask,
                row,
                groups.group_of,
                groups.members,
                groups.used,
                self.state,
                self._touched,
                self._count,
                self._listed,
                mirror(self.empty[:1])[0],
            )
            if row == len(subjects):
                break
            self.reserve(4 * len(self.state))

    def take(self, used: int) -> tuple[NDArray[np.int32] | None, NDArray[Any]]:
        """Return the folded values and reset: the touched groups, ascending, and the columns of
        their `state`, shape ``(2 or 4, n)``.

        None instead of groups: all of ``used``, in order, if at least a quarter was touched. Cost:
        O(touched), or O(groups) in that case.
        """
        self.reserve(used)
        count = self._count
        if not self._listed:
            count = int(np.count_nonzero(self.state[:used, 1]))
        at: NDArray[np.int32] | None = None
        if 4 * count >= used:
            columns = self.state[:used].T.copy()
            if len(self.empty) == 2:
                self.state[:used].fill(0)
            else:
                self.state[:used] = self.empty
        else:
            if self._listed:
                at = np.sort(self._touched[:count])
            else:
                at = np.flatnonzero(self.state[:used, 1]).astype(np.int32)
            columns = self.state[at].T.copy()
            self.state[at] = self.empty
        self._count, self._listed = 0, True
        return at, columns

    def reserve(self, capacity: int) -> None:
        """Allocate space for ``capacity`` groups."""
        if len(self.state) < capacity:
            larger = np.empty((capacity, len(self.empty)), self.state.dtype)
            larger[: len(self.state)] = self.state
            larger[len(self.state) :] = self.empty
            self.state = larger
            # One extra entry: the kernel writes an entry before it decides whether to keep it.
            touched = np.empty(capacity + 1, np.int32)
            touched[: self._count] = self._touched[: self._count]
            self._touched = touched


def grow(state: NDArray[Any], capacity: int, fill: Any) -> NDArray[Any]:
    """Return ``state`` with at least ``capacity`` rows; new ones have the value ``fill``."""
    if len(state) >= capacity:
        return state
    larger = np.full((capacity, *state.shape[1:]), fill, state.dtype)
    larger[: len(state)] = state
    return larger
