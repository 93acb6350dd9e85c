"""Partial aggregates: what is kept of an aggregate's rows, by group, so that parts can be merged.

A `Partial` keeps integers, decimals, floats and doubles apart (SPARQL promotes only at the end),
and counts what is no number. Law: merging the partials of the parts of a bag is the partial of
the bag (sums of float64 up to rounding), whatever the parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal

from ..rdf.timed import DATATYPES, Kind, ObjectColumn
from .columns import NeedsOxigraph, Sort, TermValues, either, scattered
from .decimals import rounded
from .exact import At
from .kernels import Groups, RowFold, mirrored

KINDS = (Kind.INTEGER, Kind.DECIMAL, Kind.FLOAT, Kind.DOUBLE)
SAFE = 2**62
TERMS, ERRORS = 0, 1
"""Columns of what is no number: other terms, and errors of the argument."""


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """The values of one kind by group, all of shape ``(groups,)`` but ``ends``.

    ``sums``: float64, int64, or Python integers where one does not fit. ``ends``: shape
    ``(groups, 2)``, the least value and the least mirrored one (`extremes`).
    """

    sums: NDArray[Any]
    counts: NDArray[np.int64]
    ends: NDArray[Any] | None


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Rows of one kind; with None as kind, of no number: ``column`` is `TERMS` or `ERRORS`."""

    kind: Kind | None
    subjects: NDArray[np.int32]
    values: NDArray[Any]
    skip: NDArray[np.bool_] | None = None
    column: int = TERMS


def parts_of(
    subjects: NDArray[np.int32],
    column: ObjectColumn,
    skip: NDArray[np.bool_] | None,
    terms: TermValues,
) -> Iterator[Part]:
    """The rows but those in ``skip``, each kind of number once. A null that is not skipped is an
    error."""
    if column.null is not None:
        failed = column.null if skip is None else column.null & ~skip
        if failed.any():
            yield Part(None, subjects[failed], column.values[failed], column=ERRORS)
        skip = column.null if skip is None else column.null | skip
    if column.kind is Kind.TERM:
        rows = np.arange(len(subjects)) if skip is None else np.flatnonzero(~skip)
        sorts = terms.sorts(column.values[rows])
        for sort in np.unique(sorts).tolist():
            at = rows[sorts == sort]
            part = ObjectColumn(Kind.TERM, column.values[at])
            if Sort.INTEGER <= sort <= Sort.DOUBLE:
                kind = Kind(sort)
                yield Part(kind, subjects[at], terms.typed(part, kind).values)
            else:
                yield Part(None, subjects[at], part.values)
    elif column.kind is Kind.BOOLEAN:
        rows = np.arange(len(subjects)) if skip is None else np.flatnonzero(~skip)
        yield Part(None, subjects[rows], column.values[rows])
    else:
        yield Part(column.kind, subjects, column.values, skip)


class NumberFold:
    """Rows of one kind folded by group, integers exactly.

    A sum of int64 wraps around at 64 bits. Where it might, the upper halves of the values are
    summed too, which tells how often it did.
    """

    def __init__(self, kind: Kind, extremes: bool) -> None:
        self._rows = RowFold(kind.dtype, extremes)
        self._high: RowFold | None = None
        self._bound = 0

    def add(
        self,
        subjects: NDArray[np.int32],
        values: NDArray[Any],
        skip: NDArray[np.bool_] | None,
        groups: Groups,
    ) -> None:
        """Fold the rows that are not in ``skip``, one after the other."""
        if values.dtype == np.int64 and len(values):
            self._bound += _greatest(values) * len(values)
            if self._bound >= SAFE:
                if self._high is None:
                    self._high = RowFold(np.dtype(np.int64), False)
                self._high.add(subjects, values >> 32, skip, groups)
        self._rows.add(subjects, values, skip, groups)

    def take(self, used: int) -> tuple[At, NDArray[Any], NDArray[np.int64] | None]:
        """What was folded, and begin anew: see `RowFold.take`.

        The third: integers whose 2^32-fold the first of the columns lacks, None: of none.
        """
        at, columns = self._rows.take(used)
        self._bound = 0
        if self._high is None:
            return at, columns, None
        self._high.reserve(used)
        high = self._high.state[slice(used) if at is None else at, 0].copy()
        self._high = None
        # In the lower halves no sum can leave 64 bits: 2^30 rows of 32 bits.
        columns[0] -= high << 32
        return at, columns, high

    def take_all(self, used: int) -> tuple[NDArray[Any], NDArray[np.int64] | None]:
        """As `take`, but of each group, also where few were touched."""
        at, columns, high = self.take(used)
        if at is None:
            return columns, high
        whole = np.repeat(self._rows.empty[:, np.newaxis], used, axis=1)
        whole[:, at] = columns
        if high is not None:
            above = np.zeros(used, np.int64)
            above[at] = high
            high = above
        return whole, high


@dataclass(slots=True, eq=False)
class Partial:
    """One argument's rows by group.

    ``others``: shape ``(groups, 2)``, how many are `TERMS` and how many `ERRORS`, None: none are.
    Cost and memory: see `RowFold`.
    """

    numbers: dict[Kind, Numbers] = field(default_factory=dict)
    others: NDArray[np.int64] | None = None

    @classmethod
    def of(
        cls,
        subjects: NDArray[np.int32],
        column: ObjectColumn,
        groups: Groups,
        terms: TermValues,
        extremes: bool,
    ) -> Partial:
        """All rows of ``column`` for the groups of ``subjects``, which are there."""
        made = cls()
        for part in parts_of(subjects, column, None, terms):
            if part.kind is None:
                if made.others is None:
                    made.others = np.zeros((groups.used, 2), np.int64)
                np.add.at(made.others[:, part.column], groups.groups(part.subjects), 1)
                continue
            fold = NumberFold(part.kind, extremes)
            fold.add(part.subjects, part.values, part.skip, groups)
            columns, high = fold.take_all(groups.used)
            sums, counts = columns[0], columns[1].astype(np.int64)
            if high is not None:
                sums = high.astype(object) * 2**32 + sums.astype(object)
            made.numbers[part.kind] = Numbers(sums, counts, columns[2:].T if extremes else None)
        return made

    def merged(self, groups: NDArray[np.int64], rows: NDArray[np.int64], count: int) -> Partial:
        """The partial of ``count`` groups where group ``groups[i]`` takes in our ``rows[i]``."""
        made = Partial()
        for kind, mine in self.numbers.items():
            sums = mine.sums
            if sums.dtype == np.int64 and len(sums) and _greatest(sums) * len(rows) >= SAFE:
                sums = sums.astype(object)
            total, counts = np.zeros(count, sums.dtype), np.zeros(count, np.int64)
            np.add.at(total, groups, sums[rows])
            np.add.at(counts, groups, mine.counts[rows])
            ends = None
            if mine.ends is not None:
                ends = np.full((count, 2), _nothing(kind), mine.ends.dtype)
                np.minimum.at(ends, groups, mine.ends[rows])
            made.numbers[kind] = Numbers(total, counts, ends)
        if self.others is not None:
            made.others = np.zeros((count, 2), np.int64)
            np.add.at(made.others, groups, self.others[rows])
        return made

    def finish(
        self, function: str, groups: NDArray[np.int64], terms: TermValues, star: bool = False
    ) -> ObjectColumn:
        """The aggregate's value for all ``groups``: null where it is an error or unbound."""
        counts = {kind: of.counts for kind, of in self.numbers.items()}
        kinds = [kind for kind in KINDS if kind in counts and counts[kind].any()]
        numbers = counts[kinds[0]] if kinds else np.zeros(len(groups), np.int64)
        for kind in kinds[1:]:
            numbers = numbers + counts[kind]
        others = self.others
        if function == "COUNT":
            if others is not None:
                numbers = numbers + others[:, TERMS] + (others[:, ERRORS] if star else 0)
            return ObjectColumn(Kind.INTEGER, numbers)
        extreme = function in ("MIN", "MAX")
        wrong: NDArray[np.bool_] | None = None
        if others is not None:
            # One error among the values makes the aggregate an error; so does a term in a sum.
            if extreme and others[:, TERMS].any():
                raise NeedsOxigraph(f"{function} over terms that are no numbers")
            wrong = np.asarray(others.any(axis=1))
        if extreme and not numbers.all():
            wrong = numbers == 0 if wrong is None else wrong | (numbers == 0)
        null = wrong if wrong is not None and wrong.any() else None
        if not kinds:
            return ObjectColumn(Kind.INTEGER, np.zeros(len(groups), np.int64), null)
        if extreme:
            column = self._extreme(function, kinds, len(groups), counts, terms)
        else:
            column = self._total(function == "AVG", kinds, counts, numbers, terms)
        return ObjectColumn(column.kind, column.values, either(null, column.null))

    def _total(
        self,
        average: bool,
        kinds: list[Kind],
        counts: dict[Kind, NDArray[np.int64]],
        numbers: NDArray[np.int64],
        terms: TermValues,
    ) -> ObjectColumn:
        sums = {kind: self.numbers[kind].sums for kind in kinds}
        if len(kinds) == 1:
            return _sum_column(kinds[0], sums[kinds[0]], numbers, average, terms)
        promoted = np.full(len(numbers), int(Kind.INTEGER))
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
        return scattered(places, parts, terms.dictionary)

    def _extreme(
        self,
        function: str,
        kinds: list[Kind],
        rows: int,
        counts: dict[Kind, NDArray[np.int64]],
        terms: TermValues,
    ) -> ObjectColumn:
        side = 0 if function == "MIN" else 1
        ends = {}
        for kind in kinds:
            found = self.numbers[kind].ends
            assert found is not None
            ends[kind] = mirrored(found[:, 1]) if side else found[:, 0]
        if len(kinds) == 1:
            return ObjectColumn(kinds[0], ends[kinds[0]])
        worst = np.inf if side == 0 else -np.inf
        best = np.full(rows, worst)
        chosen = np.zeros(rows, np.int64)
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
        return scattered(places, parts, terms.dictionary)


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
        literals = (Literal(str(value), datatype=datatype) for value in whole)
        return ObjectColumn(Kind.TERM, terms.dictionary.transient_ids(literals))
    return ObjectColumn(kind, rounded(sums) if kind is Kind.DECIMAL else sums)


def _nothing(kind: Kind) -> Any:
    return 2**63 - 1 if kind is Kind.INTEGER else np.inf


def _greatest(values: NDArray[Any]) -> int:
    """The greatest absolute value."""
    if values.strides == (0,):
        return abs(int(values[0]))
    return max(abs(int(values.max())), abs(int(values.min())))
