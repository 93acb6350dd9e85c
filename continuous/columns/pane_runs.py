"""Runs of panes: the windows of many ends over one table of panes.

A table has a *cell* for each pane and each group: cell ``pane * groups + group``. A window is a
run of panes, ``low`` to ``high - 1``. Its sums are differences of prefix sums, and its extremes
those of two runs whose lengths are a power of two. `bulk_aggregation` uses it for windows that are
due at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class PaneRuns:
    """The runs of a table with ``panes`` panes and ``groups`` groups; ``low`` and ``high`` have
    shape ``(runs,)``.

    Cost: a pass over the cells, times the logarithm of the longest run for extremes.
    """

    panes: int
    groups: int
    low: Rows
    high: Rows

    @property
    def cells(self) -> int:
        """The number of cells."""
        return self.panes * self.groups

    def sums(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the sums of all runs and groups, shape ``(runs, groups)``."""
        prefix = self._prefix(cells[np.newaxis])[0]
        found: NDArray[np.int64] = prefix[self.high] - prefix[self.low]
        return found

    def differences(self, state: NDArray[np.int64], wanted: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return the sums over each run of each group that is ``wanted``, of shape ``(runs,
        groups)``, run by run, for each row of ``state``, of shape ``(n, cells or more)``."""
        prefix = self._prefix(state)
        # All sums, then those wanted: whole rows are copied five times as fast as single cells.
        found = prefix.take(self.high, axis=1)
        found -= prefix.take(self.low, axis=1)
        found = found.reshape(len(state), -1)
        return found if wanted.all() else np.ascontiguousarray(found[:, wanted.reshape(-1)])

    def least(self, cells: NDArray[Any], rows: Rows, at: Rows) -> NDArray[Any]:
        """Return the least values of group ``at[i]`` over run ``rows[i]``. ``cells`` has shape
        ``(cells, 2)``. Contract: no run in ``rows`` is empty."""
        level = cells.reshape(self.panes, self.groups, 2)
        low, high = self.low[rows], self.high[rows]
        found = np.empty((len(rows), 2), cells.dtype)
        length, longest = 1, int((high - low).max(initial=0))
        while length <= longest:
            # ``level[p]`` has the least values of the panes p to p + length - 1.
            mine = np.flatnonzero((high - low >= length) & (high - low < 2 * length))
            begin, end = low[mine], high[mine] - length
            found[mine] = np.minimum(level[begin, at[mine]], level[end, at[mine]])
            if 2 * length <= longest:
                level = np.minimum(level[: len(level) - length], level[length:])
            length *= 2
        return found

    def _prefix(self, state: NDArray[np.int64]) -> NDArray[np.int64]:
        prefix = np.zeros((len(state), self.panes + 1, self.groups), np.int64)
        cells = state[:, : self.cells].reshape(len(state), self.panes, self.groups)
        np.cumsum(cells, axis=1, out=prefix[:, 1:])
        return prefix


def equal_runs(values: NDArray[np.int64]) -> list[slice]:
    """Return the runs of equal values, in order."""
    first = np.flatnonzero(np.append(True, values[1:] != values[:-1]))[: len(values)].tolist()
    return [slice(*ends) for ends in pairwise([*first, len(values)])]
