"""The repeated rows of matches: their last ones, aggregates, lists."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..evaluation.outputs import Repetition
from ..plans.plan import NO_VALUE, Function
from ..plans.rows import Values
from .run_packing import FUNCTIONS, OF_NUMBERS, WORDS, PackedRuns
from .runs import PARENT, ROW

Integers = NDArray[np.int64]


class RunRepetition(Repetition):
    """What records of runs have of their Kleene elements."""

    def __init__(self, packed: PackedRuns, records: Integers, nodes: Integers) -> None:
        self._packed = packed
        self._records = records
        self._nodes = nodes
        self._count = len(packed.keys)

    @property
    def last_rows(self) -> Integers:
        """The places of the last row of each element, shape ``(m, n)``."""
        return self._records[:, self._count : 2 * self._count]

    def aggregate(self, element: int, word: int | None, function: Function) -> Values:
        """An aggregate over the rows of an element; ``word``: that of the column."""
        wanted = [element, -1 if word is None else word]
        k = next(
            i for i, each in enumerate(self._packed.accumulators.tolist()) if each[:2] == wanted
        )
        at = 3 * self._count + WORDS * k
        records = self._records[:, at : at + WORDS]
        counts = records[:, 0]
        if function is Function.COUNT:
            return counts
        is_number = bool(self._packed.accumulators[k, OF_NUMBERS])
        values = np.ascontiguousarray(records).view(np.float64) if is_number else records
        if function is Function.AVG:
            with np.errstate(all="ignore"):
                return np.where(counts == 0, np.nan, values[:, 1] / counts)
        found = values[:, FUNCTIONS.index(function)]
        return np.where(counts == 0, np.nan if is_number else NO_VALUE, found)

    def rows(self, element: int) -> list[Integers]:
        """The places of all rows of an element, an array a match."""
        nodes = self._records[:, 2 * self._count + element]
        matches = np.arange(len(nodes))
        found, owners = [], []
        while len(nodes):
            found.append(self._nodes[nodes, ROW])
            owners.append(matches)
            nodes = self._nodes[nodes, PARENT]
            matches, nodes = matches[nodes != 0], nodes[nodes != 0]
        if not found:
            return []
        owner = np.concatenate(owners[::-1])
        order = np.argsort(owner, kind="stable")
        places = np.concatenate(found[::-1])[order]
        return np.split(places, np.cumsum(np.bincount(owner))[:-1])
