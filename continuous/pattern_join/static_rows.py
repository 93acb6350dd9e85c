"""The static triples that patterns can match, as rows of numbers (`row_kernels`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...rdf.namespaces import RDF_TYPE
from ..algebra.expressions import Var
from ..algebra.plan import Scan, TypeScan
from ..operators.sources import StaticSide
from .plan_cut import Slot
from .row_kernels import (
    HIGH,
    LOW,
    PLACE,
    ROW,
    SUBJECT,
    TAG_SHIFT,
    chain_heads,
    link,
)

StaticArrays: TypeAlias = tuple[NDArray[Any], ...]
"""Rows, the heads of their chains with their sizes, and by slot the number of rows."""


class StaticRows:
    """The static triples of the slots, with their chains: built once per background version."""

    def __init__(
        self,
        slots: Sequence[Slot],
        windows: frozenset[str],
        static: StaticSide,
        needed: NDArray[np.int64],
    ) -> None:
        self.slots = slots
        self.windows = windows
        self.static = static
        self.needed = needed
        self._version: int | None = None
        self._arrays: StaticArrays = ()

    @property
    def arrays(self) -> StaticArrays:
        """The arrays for the present version of the background."""
        version = self.static.background.version
        if version != self._version:
            self._version = version
            self._arrays = self._read()
        return self._arrays

    def _read(self) -> StaticArrays:
        terms = self.static.terms
        counts = np.zeros(len(self.slots), np.int64)
        parts: list[tuple[NDArray[Any], ...]] = []
        for number, slot in enumerate(self.slots):
            # A named window has nothing static.
            if slot.graph in self.windows:
                continue
            if slot.predicate == RDF_TYPE:
                scan: Scan | TypeScan = TypeScan(Var("s"), Var("o"), slot.graph)
            else:
                scan = Scan(Var("s"), slot.predicate, Var("o"), slot.graph)
            subjects, objects = self.static.pairs(scan)
            parts.append((subjects.values, *terms.encode(terms.canonical(objects))))
            counts[number] = len(subjects)
        total = int(counts.sum())
        rows = np.zeros((total, ROW), np.int32)
        rows[:, PLACE] = np.repeat(np.arange(len(self.slots)), counts)
        if parts:
            ends, tags, words = (np.concatenate(column) for column in zip(*parts, strict=True))
            rows[:, SUBJECT] = ends
            rows[:, PLACE] += tags.astype(np.int32) << TAG_SHIFT
            rows[:, LOW] = words.astype(np.int32)
            rows[:, HIGH] = words >> 32
        # A join reads several slots of one subject, so keep a subject's rows together. Subjects are
        # in order of appearance: an order by id would depend on the dictionary's history.
        _, first, who = np.unique(rows[:, SUBJECT], return_index=True, return_inverse=True)
        rows = rows[np.argsort(first[who.reshape(-1)], kind="stable")]
        heads, sizes = chain_heads(total, self.needed)
        link(rows, self.needed, heads, sizes, total)
        return rows, heads, sizes, counts
