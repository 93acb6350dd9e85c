"""Partial aggregates: what is kept of an aggregate's rows, by group, so that parts can be merged.

A `Partial` keeps integers, decimals, floats and doubles apart (SPARQL promotes only at the end),
and counts what is no number. Law: merging the partials of the parts of a bag is the partial of
the bag (sums of float64 up to rounding), whatever the parts.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal

from ..rdf.timed import DATATYPES, Kind, ObjectColumn
from .columns import NeedsOxigraph, Sort, TermValues, concatenate
from .decimals import rounded
from .kernels import Groups, fold_sums, grown

NUMBERS = (Kind.INTEGER, Kind.DECIMAL, Kind.FLOAT, Kind.DOUBLE)
_SAFE = 2**62


@dataclass(slots=True, eq=False)
class Partial:
    """One argument's rows by group.

    ``sums[kind]``: shape ``(groups, 2)``, sum and count. ``extremes[kind]``: shape ``(groups, 2)``,
    least and greatest. ``others``: shape ``(groups, 2)``, values that are no numbers, and errors.
    Arrays may be shorter than there are groups: the rest is empty. ``bound`` is at least the
    greatest absolute sum of integers; beyond 62 bits sums are Python integers.
    """

    sums: dict[Kind, NDArray[Any]] = field(default_factory=dict)
    extremes: dict[Kind, NDArray[Any]] = field(default_factory=dict)
    others: NDArray[np.int64] | None = None
    bound: int = 0

    def add(
        self,
        subjects: NDArray[np.int32],
        column: ObjectColumn,
        skip: NDArray[np.bool_] | None,
        groups: Groups,
        terms: TermValues,
        extremes: bool,
    ) -> None:
        """Fold rows in: values of ``column`` for the groups of ``subjects``, but those in ``skip``.

        A null that is not skipped is an error of the argument.
        """
        if column.null is not None:
            failed = column.null if skip is None else column.null & ~skip
            if failed.any():
                self._count(groups.groups(subjects[failed]), 1)
            skip = column.null if skip is None else column.null | skip
        if column.kind is Kind.TERM:
            rows = np.arange(len(subjects)) if skip is None else np.flatnonzero(~skip)
            sorts = terms.sorts(column.values[rows])
            for sort in np.unique(sorts).tolist():
                at = rows[sorts == sort]
                part = ObjectColumn(Kind.TERM, column.values[at])
                if Sort.INTEGER <= sort <= Sort.DOUBLE:
                    numbers = terms.typed(part, Kind(sort))
                    self.add(subjects[at], numbers, None, groups, terms, extremes)
                else:
                    self._count(groups.groups(subjects[at]), 0)
        elif column.kind is Kind.BOOLEAN:
            rows = np.arange(len(subjects)) if skip is None else np.flatnonzero(~skip)
            self._count(groups.groups(subjects[rows]), 0)
        else:
            self._numbers(subjects, column, skip, groups, extremes)

    def _numbers(
        self,
        subjects: NDArray[np.int32],
        column: ObjectColumn,
        skip: NDArray[np.bool_] | None,
        groups: Groups,
        extremes: bool,
    ) -> None:
        kind, values = column.kind, column.values
        state = self.sums.get(kind)
        if state is None:
            state = np.zeros((0, 2), values.dtype)
        if kind is Kind.INTEGER and len(values):
            greatest = max(abs(int(values.max())), abs(int(values.min())))
            self.bound += greatest * len(values)
            if self.bound >= _SAFE:
                state = state.astype(object)
        self.sums[kind] = fold_sums(subjects, values, skip, groups, state)
        if extremes:
            if skip is not None:
                subjects, values = subjects[~skip], values[~skip]
            found = groups.groups(subjects)
            low, high = _limits(kind)
            ends = self.extremes.get(kind)
            if ends is None:
                ends = np.zeros((0, 2), values.dtype)
            before = len(ends)
            ends = grown(ends, groups.used, low)
            ends[before:, 0] = high
            np.minimum.at(ends[:, 0], found, values)
            np.maximum.at(ends[:, 1], found, values)
            self.extremes[kind] = ends

    def _count(self, found: NDArray[np.int32], column: int) -> None:
        capacity = int(found.max(initial=-1)) + 1
        others = np.zeros((0, 2), np.int64) if self.others is None else self.others
        self.others = grown(others, capacity, 0)
        np.add.at(self.others[:, column], found, 1)

    def rows(self, groups: int) -> NDArray[np.float64]:
        """How many rows each group has, errors too, shape ``(groups,)``."""
        total = np.zeros(groups, np.float64)
        for state in self.sums.values():
            part = state[:groups, 1]
            total[: len(part)] += part.astype(np.float64)
        if self.others is not None:
            part = self.others[:groups]
            total[: len(part)] += part.sum(axis=1)
        return total

    def merged(self, groups: NDArray[np.int64], rows: NDArray[np.int64], count: int) -> Partial:
        """The partial of ``count`` groups where group ``groups[i]`` takes in our ``rows[i]``."""
        made = Partial(bound=self.bound * max(1, len(rows)))
        for kind, state in self.sums.items():
            state = _padded(state, rows, 0)
            if kind is Kind.INTEGER and made.bound >= _SAFE:
                state = state.astype(object)
            target = np.zeros((count, 2), state.dtype)
            np.add.at(target, groups, state[rows])
            made.sums[kind] = target
        for kind, state in self.extremes.items():
            low, high = _limits(kind)
            target = np.full((count, 2), low, state.dtype)
            target[:, 0] = high
            known = rows < len(state)
            np.minimum.at(target[:, 0], groups[known], state[rows[known], 0])
            np.maximum.at(target[:, 1], groups[known], state[rows[known], 1])
            made.extremes[kind] = target
        if self.others is not None:
            made.others = np.zeros((count, 2), np.int64)
            np.add.at(made.others, groups, _padded(self.others, rows, 0)[rows])
        return made

    def taken(self, groups: NDArray[np.int64]) -> Partial:
        """The partial of these groups (ascending), renumbered 0, 1, 2 …"""

        def of(state: NDArray[Any]) -> NDArray[Any]:
            taken: NDArray[Any] = state[groups[groups < len(state)]]
            return taken

        sums = {kind: of(state) for kind, state in self.sums.items()}
        extremes = {kind: of(state) for kind, state in self.extremes.items()}
        others = None if self.others is None else of(self.others)
        return Partial(sums, extremes, others, self.bound)

    def __add__(self, other: Partial) -> Partial:
        """Both together, group by group: a new value, the old ones stay as they are."""
        made = Partial(bound=self.bound + other.bound)
        for kind in NUMBERS:
            a, b = self.sums.get(kind), other.sums.get(kind)
            if a is not None or b is not None:
                total = _added(a, b)
                if kind is Kind.INTEGER and made.bound >= _SAFE and total.dtype != object:
                    exact = [None if s is None else s.astype(object) for s in (a, b)]
                    total = _added(exact[0], exact[1])
                made.sums[kind] = total
            c, d = self.extremes.get(kind), other.extremes.get(kind)
            if c is not None or d is not None:
                made.extremes[kind] = _wider(c, d)
        if self.others is not None or other.others is not None:
            made.others = _added(self.others, other.others)
        return made

    def finish(
        self, function: str, rows: NDArray[np.int64], terms: TermValues, star: bool = False
    ) -> ObjectColumn:
        """The aggregate's value for the groups ``rows``: null where it is an error or unbound."""
        counts = {k: _padded(s, rows, 0)[rows, 1].astype(np.int64) for k, s in self.sums.items()}
        others = np.zeros((len(rows), 2), np.int64)
        if self.others is not None:
            others = _padded(self.others, rows, 0)[rows]
        numbers = np.zeros(len(rows), np.int64)
        for count in counts.values():
            numbers += count
        if function == "COUNT":
            total = numbers + others[:, 0] + (others[:, 1] if star else 0)
            return ObjectColumn(Kind.INTEGER, total)
        # One error among the values makes the aggregate an error; so does a term in a sum.
        wrong = others[:, 1] > 0
        if function in ("MIN", "MAX"):
            if others[:, 0].any():
                raise NeedsOxigraph(f"{function} over terms that are no numbers")
            wrong |= numbers == 0
        else:
            wrong |= others[:, 0] > 0
        null = wrong if wrong.any() else None
        kinds = [kind for kind in NUMBERS if kind in counts and counts[kind].any()]
        if not kinds:
            return ObjectColumn(Kind.INTEGER, np.zeros(len(rows), np.int64), null)
        if function in ("MIN", "MAX"):
            column = self._extreme(function, kinds, rows, counts, terms)
        else:
            column = self._total(function == "AVG", kinds, rows, counts, numbers, terms)
        nulls = (
            column.null if null is None else (null if column.null is None else null | column.null)
        )
        return ObjectColumn(column.kind, column.values, nulls)

    def _total(
        self,
        average: bool,
        kinds: list[Kind],
        rows: NDArray[np.int64],
        counts: dict[Kind, NDArray[np.int64]],
        numbers: NDArray[np.int64],
        terms: TermValues,
    ) -> ObjectColumn:
        sums = {kind: _padded(self.sums[kind], rows, 0)[rows, 0] for kind in kinds}
        if len(kinds) == 1:
            return _sum_column(kinds[0], sums[kinds[0]], numbers, average, terms)
        promoted = np.full(len(rows), int(Kind.INTEGER))
        for kind in kinds:
            promoted = np.where(counts[kind] > 0, int(kind), promoted)
        places, parts = [], []
        for code in np.unique(promoted).tolist():
            at = np.flatnonzero(promoted == code)
            values: NDArray[Any] = np.zeros(len(at), np.int64)
            for kind in kinds:
                if int(kind) <= code:
                    part = sums[kind][at]
                    values = values + (part if code == Kind.INTEGER else part.astype(np.float64))
            places.append(at)
            parts.append(_sum_column(Kind(code), values, numbers[at], average, terms))
        return _scattered(places, parts, len(rows), terms)

    def _extreme(
        self,
        function: str,
        kinds: list[Kind],
        rows: NDArray[np.int64],
        counts: dict[Kind, NDArray[np.int64]],
        terms: TermValues,
    ) -> ObjectColumn:
        side = 0 if function == "MIN" else 1
        ends = {}
        for kind in kinds:
            low, high = _limits(kind)
            ends[kind] = _padded(self.extremes[kind], rows, low if side else high)[rows, side]
        if len(kinds) == 1:
            return ObjectColumn(kinds[0], ends[kinds[0]])
        worst = np.inf if side == 0 else -np.inf
        best = np.full(len(rows), worst)
        chosen = np.zeros(len(rows), np.int64)
        for kind in kinds:
            value = np.where(counts[kind] > 0, ends[kind].astype(np.float64), worst)
            better = (value < best) if side == 0 else (value > best)
            better |= (chosen == 0) & (counts[kind] > 0)
            best, chosen = np.where(better, value, best), np.where(better, int(kind), chosen)
        places, parts = [], []
        for code in np.unique(chosen).tolist():
            at = np.flatnonzero(chosen == code)
            kind = kinds[0] if code == 0 else Kind(code)
            parts.append(ObjectColumn(kind, ends[kind][at]))
            places.append(at)
        return _scattered(places, parts, len(rows), terms)


def _sum_column(
    kind: Kind,
    sums: NDArray[Any],
    numbers: NDArray[np.int64],
    average: bool,
    terms: TermValues,
) -> ObjectColumn:
    if average:
        # The average of integers is a decimal (SPARQL 1.1 §18.5.1.4), of nothing the integer 0.
        values = sums.astype(np.float64) / np.maximum(numbers, 1)
        if kind in (Kind.INTEGER, Kind.DECIMAL):
            return ObjectColumn(Kind.DECIMAL, rounded(values))
        return ObjectColumn(kind, values)
    if sums.dtype == object:
        whole = [int(value) for value in sums]
        if all(-(2**63) <= value < 2**63 for value in whole):
            return ObjectColumn(kind, np.array(whole, np.int64))
        datatype = DATATYPES[Kind.INTEGER]
        ids = [terms.dictionary.id(Literal(str(value), datatype=datatype)) for value in whole]
        return ObjectColumn(Kind.TERM, np.array(ids, np.int32))
    return ObjectColumn(kind, rounded(sums) if kind is Kind.DECIMAL else sums)


def _scattered(
    places: list[NDArray[np.int64]], parts: list[ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    kept = [(at, part) for at, part in zip(places, parts, strict=True) if len(at)]
    if not kept:
        return parts[0]
    whole = concatenate([part for _, part in kept], terms.dictionary)
    back = np.empty(rows, np.int64)
    back[np.concatenate([at for at, _ in kept])] = np.arange(rows)
    return whole.take(back)


def _limits(kind: Kind) -> tuple[Any, Any]:
    if kind is Kind.INTEGER:
        return -(2**63), 2**63 - 1
    return -np.inf, np.inf


def _padded(state: NDArray[Any], rows: NDArray[np.int64], fill: Any) -> NDArray[Any]:
    return grown(state, int(rows.max(initial=-1)) + 1, fill)


def _added(a: NDArray[Any] | None, b: NDArray[Any] | None) -> NDArray[Any]:
    if a is None or b is None:
        present = b if a is None else a
        assert present is not None
        return present
    if len(a) < len(b):
        a, b = b, a
    if len(a) == len(b):
        total: NDArray[Any] = a + b
        return total
    total = a.astype(np.result_type(a.dtype, b.dtype))
    total[: len(b)] += b
    return total


def _wider(a: NDArray[Any] | None, b: NDArray[Any] | None) -> NDArray[Any]:
    if a is None or b is None:
        present = b if a is None else a
        assert present is not None
        return present
    if len(a) < len(b):
        a, b = b, a
    wide = a.copy()
    np.minimum(wide[: len(b), 0], b[:, 0], out=wide[: len(b), 0])
    np.maximum(wide[: len(b), 1], b[:, 1], out=wide[: len(b), 1])
    return wide
