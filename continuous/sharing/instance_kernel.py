"""The compiled loop that finds the instances of solutions (see `streams.jit`), and its numpy twin,
which visits every instance of a group.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import JIT, Kernel
from ..columns.fold_kernels import read_only

Rows = NDArray[np.int64]


def _find_pairs(
    groups: Any,
    values: Any,
    starts: Any,
    limits: Any,
    least: Any,
    strict: bool,
    at: Any,
    places: Any,
) -> int:
    """Write each pair of a row and a place in its group whose limit the row's value exceeds (or
    reaches, unless ``strict``). Returns the number of pairs, including those that did not fit.

    ``least[group + 1]`` is the least limit of a group; for no group (-1) it is NaN.
    """
    rows, room = groups.shape[0], at.shape[0]
    # Most rows match no instance. Selecting the others first, without a branch, halves the cost.
    chosen = np.empty(512, np.int64)
    count = 0
    start = 0
    while start < rows:
        stop = min(rows, start + 512)
        some = 0
        if strict:
            for row in range(start, stop):
                chosen[some] = row
                some += least[groups[row] + 1] < values[row]
        else:
            for row in range(start, stop):
                chosen[some] = row
                some += least[groups[row] + 1] <= values[row]
        for i in range(some):
            row = chosen[i]
            group, value = groups[row], values[row]
            for place in range(starts[group], starts[group + 1]):
                limit = limits[place]
                # Limits ascend, so the first failure ends the search; comparisons with NaN fail.
                if not (limit < value or (not strict and limit == value)):
                    break
                if count < room:
                    at[count] = row
                    places[count] = place
                count += 1
        start = stop
    return count


def _signature() -> Any:
    from numba import types

    written = types.int64[::1]
    return types.int64(
        read_only(types.int64),
        read_only(types.float64),
        read_only(types.int64),
        read_only(types.float64),
        read_only(types.float64),
        types.boolean,
        written,
        written,
    )


kernel = Kernel(_find_pairs, _signature)
_FIRST_ROOM = 1024


def find_pairs(
    groups: Rows,
    values: NDArray[np.float64],
    starts: Rows,
    limits: NDArray[np.float64],
    least: NDArray[np.float64],
    strict: bool,
) -> tuple[Rows, Rows]:
    """Return all pairs of a row and a place with ``limits[place] < values[row]`` (``<=`` unless
    strict), in order of rows, then of places.

    The places of row ``i`` are ``starts[groups[i]]`` to ``starts[groups[i] + 1]``, by ascending
    limit (NaN last); it has none if its group is -1. ``least`` is `least_of` these. Cost: O(rows +
    pairs).
    """
    if not JIT:
        return find_pairs_plain(groups, values, starts, limits, strict)
    room = max(_FIRST_ROOM, len(groups) // 4)
    while True:
        at, places = np.empty(room, np.int64), np.empty(room, np.int64)
        count = kernel(groups, values, starts, limits, least, strict, at, places)
        if count <= room:
            return at[:count], places[:count]
        room = count


def least_of(starts: Rows, limits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the least limit of each group, after a NaN for no group. No group is empty."""
    return np.concatenate([[np.nan], limits[starts[:-1]]])


def find_pairs_plain(
    groups: Rows,
    values: NDArray[np.float64],
    starts: Rows,
    limits: NDArray[np.float64],
    strict: bool,
) -> tuple[Rows, Rows]:
    """The twin of `find_pairs`. Cost: O(rows + instances of their groups)."""
    rows = np.flatnonzero(groups >= 0)
    low = starts[groups[rows]]
    sizes = starts[groups[rows] + 1] - low
    at = np.repeat(rows, sizes)
    offset = np.arange(len(at)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    places = np.repeat(low, sizes) + offset
    with np.errstate(invalid="ignore"):
        hit = limits[places] < values[at] if strict else limits[places] <= values[at]
    return at[hit], places[hit]
