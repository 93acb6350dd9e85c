"""Partial aggregates: the state of an aggregate by group, in a form that can be merged.

A `Partial` separates integers, decimals, floats and doubles, because SPARQL promotes only the final
result, and counts terms that are no numbers. Law: the merge of the partials of a bag's parts is the
partial of the bag, whatever the parts (sums of float64 up to rounding).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...rdf.dictionary import Term
from ...rdf.timed import Kind, ObjectColumn
from ..columns.exact_sums import At
from ..columns.fold_kernels import Groups, RowFold, mirror
from ..columns.relation import (
    NeedsOxigraph,
    TermValues,
    either,
    exact_column,
    scatter,
    term_column,
)
from ..values import decimals
from ..values.decimals import Mantissas
from ..values.exact_values import Number, Singles, extreme, summed
from ..values.literals import LONG, Sort

SAFE = 2**62
"""Two int64 below this have a sum that does not overflow."""
TERMS, ERRORS, SINGLES = 0, 1, 2
"""Columns of counts: terms that are no numbers, errors of the argument, and `Singles`."""
GREAT = 2.0**960
"""The sum of 2^60 doubles below this is finite."""
_CERTAIN = 2.0**53
"""Below this, integers and decimals that are equal as float64 are equal: above, float64 has gaps
greater than 1."""

Key: TypeAlias = tuple[Kind, int]
"""A kind of number and, for decimals, the scale of their mantissas (`decimals.SCALES`); else 0."""


def dtype_of(key: Key) -> np.dtype[Any]:
    """Return the array type of a `Key`: int64 for integers and mantissas."""
    return np.dtype(np.int64 if key[0] <= Kind.DECIMAL else np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Numbers:
    """The values of one `Key` by group, of shape ``(groups,)`` except ``ends``.

    ``sums``: float64, int64, or Python integers if one does not fit. ``ends``: shape
    ``(groups, 2)``, the least value and the least mirrored value (`sliding_extremes`).
    """

    sums: NDArray[Any]
    counts: NDArray[np.int64]
    ends: NDArray[Any] | None


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Rows of one `Key`; without a key, rows that are no numbers: ``column`` is `TERMS` or
    `ERRORS`.

    ``single``: the values are Python numbers, each counted by itself (`Singles`).
    """

    key: Key | None
    subjects: NDArray[np.int32]
    values: NDArray[Any]
    skip: NDArray[np.bool_] | None = None
    column: int = TERMS

    @property
    def single(self) -> bool:
        return self.column == SINGLES


def parts_of(
    subjects: NDArray[np.int32],
    column: ObjectColumn,
    skip: NDArray[np.bool_] | None,
    terms: TermValues,
    *,
    by_value: bool = False,
) -> Iterator[Part]:
    """Yield the rows except those in ``skip``, once per kind of number. Nulls count as errors.

    ``by_value``: derive the `Key` from the number alone. A row that is subtracted later then has
    the key under which it was added, whatever other rows come with it.
    """
    if column.null is not None:
        failed = column.null if skip is None else column.null & ~skip
        if failed.any():
            yield Part(None, subjects[failed], column.values[failed], column=ERRORS)
        skip = column.null if skip is None else column.null | skip
    if column.kind.is_number:
        yield from _number_parts(column.kind, subjects, column.values, skip, by_value)
        return
    rows = np.arange(len(subjects)) if skip is None else np.flatnonzero(~skip)
    if column.kind is Kind.BOOLEAN:
        yield Part(None, subjects[rows], column.values[rows])
        return
    sorts = terms.sorts(column.values[rows])
    for sort in np.unique(sorts).tolist():
        at = rows[sorts == sort]
        part = ObjectColumn(Kind.TERM, column.values[at])
        if Sort.INTEGER <= sort <= Sort.DOUBLE:
            kind = Kind(sort)
            values = terms.typed(part, kind).values
            yield from _number_parts(kind, subjects[at], values, None, by_value)
        elif sort in LONG:
            kind = Kind.INTEGER if sort == Sort.LONG_INTEGER else Kind.DECIMAL
            yield _single(kind, subjects[at], terms.exact(part, range(len(at))))
        else:
            yield Part(None, subjects[at], part.values)


def _number_parts(
    kind: Kind,
    subjects: NDArray[np.int32],
    values: NDArray[Any],
    skip: NDArray[np.bool_] | None,
    by_value: bool,
) -> Iterator[Part]:
    """Yield the rows of one kind. Decimals become mantissas, of a common scale if allowed."""
    if kind is Kind.INTEGER:
        yield Part((kind, 0), subjects, values, skip)
    elif kind is not Kind.DECIMAL:
        if not len(values) or -GREAT < values.min() <= values.max() < GREAT:
            yield Part((kind, 0), subjects, values, skip)
            return
        great = np.isfinite(values) & (np.abs(values) >= GREAT)
        great = great if skip is None else great & ~skip
        if great.any():
            yield _single(kind, subjects[great], values[great].tolist())
            skip = great if skip is None else great | skip
        yield Part((kind, 0), subjects, values, skip)
    else:
        if skip is not None:
            rows = np.flatnonzero(~skip)
            subjects, values = subjects[rows], values[rows]
        found = None if by_value else decimals.mantissas(values)
        if found is not None:
            yield Part((kind, found.scale), subjects, found.values)
        else:
            yield from _decimal_parts(subjects, values)


def _decimal_parts(subjects: NDArray[np.int32], codes: NDArray[np.float64]) -> Iterator[Part]:
    """Yield decimals of several scales, a part each."""
    rows = np.arange(len(subjects))
    for scale in decimals.SCALES:
        fits, found = decimals.fit_scale(codes[rows], scale)
        if fits.any():
            yield Part((Kind.DECIMAL, scale), subjects[rows[fits]], found.values[fits])
            rows = rows[~fits]
    if len(rows):
        numbers = [decimals.of_code(code) for code in codes[rows].tolist()]
        yield _single(Kind.DECIMAL, subjects[rows], numbers)


def _single(kind: Kind, subjects: NDArray[np.int32], values: Sequence[Number]) -> Part:
    kept = np.empty(len(values), object)
    kept[:] = values
    return Part((kind, 0), subjects, kept, column=SINGLES)


class NumberFold:
    """Folds rows of one `Key` by group, integers exactly.

    An int64 sum wraps around at 64 bits. If it might, a second fold sums the upper halves of the
    values, which tells how often it wrapped.
    """

    def __init__(self, key: Key, extremes: bool) -> None:
        self._rows = RowFold(dtype_of(key), extremes)
        self._high: RowFold | None = None
        self._bound = 0

    def add(
        self,
        subjects: NDArray[np.int32],
        values: NDArray[Any],
        skip: NDArray[np.bool_] | None,
        groups: Groups,
    ) -> None:
        """Fold the rows that are not in ``skip``, in order."""
        if values.dtype == np.int64 and len(values):
            self._bound += magnitude(values) * len(values)
            if self._bound >= SAFE:
                if self._high is None:
                    self._high = RowFold(np.dtype(np.int64), False)
                self._high.add(subjects, values >> 32, skip, groups)
        self._rows.add(subjects, values, skip, groups)

    def take(self, used: int) -> tuple[At, NDArray[Any], NDArray[np.int64] | None]:
        """Return the folded values and reset; see `RowFold.take`.

        The third value: integers to add, times 2^32, to the first of the columns; None: none.
        """
        at, columns = self._rows.take(used)
        self._bound = 0
        if self._high is None:
            return at, columns, None
        self._high.reserve(used)
        high = self._high.state[slice(used) if at is None else at, 0].copy()
        self._high = None
        # The lower halves cannot overflow 64 bits: that would take 2^31 rows of 32 bits.
        columns[0] -= high << 32
        return at, columns, high

    def take_all(self, used: int) -> tuple[NDArray[Any], NDArray[np.int64] | None]:
        """Like `take`, but for every group."""
        at, columns, high = self.take(used)
        if at is None:
            return columns, high
        all_columns = np.repeat(self._rows.empty[:, np.newaxis], used, axis=1)
        all_columns[:, at] = columns
        if high is not None:
            all_high = np.zeros(used, np.int64)
            all_high[at] = high
            high = all_high
        return all_columns, high


@dataclass(slots=True, eq=False)
class Partial:
    """The rows of one argument by group.

    ``others``: shape ``(groups, 3)``, the numbers of `TERMS`, `ERRORS` and `SINGLES`; None: all 0.
    Cost and memory: see `RowFold` and `Singles`.
    """

    numbers: dict[Key, Numbers] = field(default_factory=dict)
    others: NDArray[np.int64] | None = None
    singles: Singles = field(default_factory=Singles)

    @classmethod
    def of(
        cls,
        subjects: NDArray[np.int32],
        column: ObjectColumn,
        groups: Groups,
        terms: TermValues,
        extremes: bool,
    ) -> Partial:
        """Fold all rows of ``column``; the groups of ``subjects`` must exist."""
        partial = cls()
        for part in parts_of(subjects, column, None, terms):
            if part.key is None or part.single:
                if partial.others is None:
                    partial.others = np.zeros((groups.used, 3), np.int64)
                at = groups.groups(part.subjects)
                np.add.at(partial.others[:, part.column], at, 1)
                if part.key is not None:
                    partial.singles.add(at, part.key[0], part.values, 1)
                continue
            fold = NumberFold(part.key, extremes)
            fold.add(part.subjects, part.values, part.skip, groups)
            columns, high = fold.take_all(groups.used)
            sums, counts = columns[0], columns[1].astype(np.int64)
            if high is not None:
                sums = high.astype(object) * 2**32 + sums.astype(object)
            partial.numbers[part.key] = Numbers(sums, counts, columns[2:].T if extremes else None)
        return partial

    def merged(self, groups: NDArray[np.int64], rows: NDArray[np.int64], count: int) -> Partial:
        """Return the partial of ``count`` groups where group ``groups[i]`` absorbs ``rows[i]``."""
        partial = Partial(singles=self.singles.merged(groups, rows))
        for key, mine in self.numbers.items():
            sums = mine.sums
            # Python integers are exact where a merged sum might not fit int64.
            if sums.dtype == np.int64 and len(sums) and magnitude(sums) * len(rows) >= SAFE:
                sums = sums.astype(object)
            total, counts = np.zeros(count, sums.dtype), np.zeros(count, np.int64)
            with np.errstate(all="ignore"):
                np.add.at(total, groups, sums[rows])
            np.add.at(counts, groups, mine.counts[rows])
            ends = None
            if mine.ends is not None:
                ends = np.full((count, 2), _nothing(mine.ends.dtype), mine.ends.dtype)
                np.minimum.at(ends, groups, mine.ends[rows])
            partial.numbers[key] = Numbers(total, counts, ends)
        if self.others is not None:
            partial.others = np.zeros((count, 3), np.int64)
            np.add.at(partial.others, groups, self.others[rows])
        return partial

    def finish(
        self, function: str, groups: NDArray[np.int64], terms: TermValues, star: bool = False
    ) -> ObjectColumn:
        """Return the aggregate's value for all ``groups``: null if it is an error or unbound."""
        keys = sorted(key for key, of in self.numbers.items() if np.count_nonzero(of.counts))
        numbers = self.numbers[keys[0]].counts if keys else np.zeros(len(groups), np.int64)
        for key in keys[1:]:
            numbers = numbers + self.numbers[key].counts
        others = self.others
        if others is not None:
            numbers = numbers + others[:, SINGLES]
        if function == "COUNT":
            if others is not None:
                numbers = numbers + others[:, TERMS] + (others[:, ERRORS] if star else 0)
            return ObjectColumn(Kind.INTEGER, numbers)
        is_extreme = function in ("MIN", "MAX")
        wrong: NDArray[np.bool_] | None = None
        if others is not None:
            # An error among the values makes the aggregate an error; so does a term in a sum.
            if is_extreme and others[:, TERMS].any():
                raise NeedsOxigraph(f"{function} over terms that are no numbers")
            wrong = np.asarray((others[:, TERMS] > 0) | (others[:, ERRORS] > 0))
        if is_extreme and np.count_nonzero(numbers) < len(numbers):
            wrong = numbers == 0 if wrong is None else wrong | (numbers == 0)
        null = wrong if wrong is not None and wrong.any() else None
        single: NDArray[np.bool_] | None = None
        if self.singles.groups:
            single = np.zeros(len(groups), np.bool_)
            single[list(self.singles.groups)] = True
        if not keys:
            column = ObjectColumn(Kind.INTEGER, np.zeros(len(groups), np.int64))
        elif is_extreme:
            column, doubtful = self._extreme(function, keys, len(groups), terms)
            single = either(single, doubtful)
        else:
            column = self._total(function == "AVG", keys, numbers, terms)
            if np.count_nonzero(numbers) < len(numbers):
                # The sum and the average of no rows are the integer 0, whatever other groups have.
                at, rest = np.flatnonzero(numbers == 0), np.flatnonzero(numbers)
                zero = ObjectColumn(Kind.INTEGER, np.zeros(len(at), np.int64))
                column = scatter([at, rest], [zero, column.take(rest)], terms.dictionary)
        if single is not None and single.any():
            at, rest = np.flatnonzero(single), np.flatnonzero(~single)
            found = [self._one_by_one(function, keys, group) for group in at.tolist()]
            few = term_column(found, terms.dictionary.transient_id)
            column = scatter([at, rest], [few, column.take(rest)], terms.dictionary)
        return ObjectColumn(column.kind, column.values, either(null, column.null))

    def _one_by_one(self, function: str, keys: list[Key], group: int) -> Term | None:
        """Return the aggregate's value for one group, in exact Python numbers."""
        there = [key for key in keys if self.numbers[key].counts[group]]
        singles = list(self.singles.numbers(group))
        if function in ("MIN", "MAX"):
            ends = [(key[0], self._end(key, group, function == "MIN")) for key in there]
            return extreme(
                [*ends, *((kind, value) for kind, value, _ in singles)], function == "MIN"
            )
        sums = [(key[0], _number(key, self.numbers[key].sums[group]), 1) for key in there]
        count = sum(times for _, _, times in singles)
        count += sum(int(self.numbers[key].counts[group]) for key in there)
        return summed([*sums, *singles], count if function == "AVG" else None)

    def _end(self, key: Key, group: int, least: bool) -> Number:
        ends = self.numbers[key].ends
        assert ends is not None
        return _number(key, ends[group, 0] if least else mirror(ends[group : group + 1, 1])[0])

    def _total(
        self, average: bool, keys: list[Key], numbers: NDArray[np.int64], terms: TermValues
    ) -> ObjectColumn:
        if len(keys) == 1:
            kind, scale = keys[0]
            sums = self.numbers[keys[0]].sums
            return _sum_column(kind, sums, scale, numbers, average, terms)
        promoted = np.full(len(numbers), int(Kind.INTEGER))
        for key in keys:
            promoted = np.where(self.numbers[key].counts > 0, int(key[0]), promoted)
        places, parts = [], []
        for code in np.unique(promoted).tolist():
            at = np.flatnonzero(promoted == code)
            own = [key for key in keys if key[0] <= code]
            scale = max((key[1] for key in own), default=0) if code <= Kind.DECIMAL else 0
            values: NDArray[Any] = np.zeros(len(at), np.int64)
            for key in own:
                part = self.numbers[key].sums[at]
                if code > Kind.DECIMAL:
                    with np.errstate(all="ignore"):
                        values = values + part.astype(np.float64) / 10.0 ** key[1]
                else:
                    values = _exact_sum(values, part, scale - key[1])
            places.append(at)
            parts.append(_sum_column(Kind(code), values, scale, numbers[at], average, terms))
        return scatter(places, parts, terms.dictionary)

    def _extreme(
        self, function: str, keys: list[Key], rows: int, terms: TermValues
    ) -> tuple[ObjectColumn, NDArray[np.bool_] | None]:
        """Return the extremes, and for which groups float64 cannot order two numbers (None: for
        none)."""
        side = 0 if function == "MIN" else 1
        ends = {}
        for key in keys:
            found = self.numbers[key].ends
            assert found is not None
            values = mirror(found[:, 1]) if side else found[:, 0]
            ends[key] = values / 10.0 ** key[1] if key[0] is Kind.DECIMAL else values
        if len(keys) == 1:
            return ObjectColumn(keys[0][0], ends[keys[0]]), None
        doubtful = np.zeros(rows, np.bool_)
        worst = np.inf if side == 0 else -np.inf
        best = np.full(rows, worst)
        chosen = np.full(rows, -1)
        for i, key in enumerate(keys):
            there = self.numbers[key].counts > 0
            value = np.where(there, ends[key].astype(np.float64), worst)
            # Values that are equal as float64 may still differ as numbers.
            doubtful |= there & (chosen >= 0) & (value == best) & (np.abs(value) >= _CERTAIN)
            better = (value < best) if side == 0 else (value > best)
            # A NaN is the extreme, whatever the other numbers.
            better |= ((chosen < 0) & there) | np.isnan(value)
            best, chosen = np.where(better, value, best), np.where(better, i, chosen)
        places, parts = [], []
        for i in np.unique(chosen).tolist():
            at = np.flatnonzero(chosen == i)
            key = keys[max(i, 0)]
            parts.append(ObjectColumn(key[0], ends[key][at]))
            places.append(at)
        return scatter(places, parts, terms.dictionary), doubtful


def _number(key: Key, value: Any) -> Number:
    """Return a sum or extreme of the arrays as a Python number."""
    if key[0] <= Kind.DECIMAL:
        return decimals.scaled(int(value), key[1])
    return float(value)


def _exact_sum(total: NDArray[Any], part: NDArray[Any], places: int) -> NDArray[Any]:
    """Return ``total + part * 10**places``, in Python integers if int64 might overflow."""
    if total.dtype == part.dtype == np.int64 and len(part):
        greatest = max(magnitude(part) * 10**places, magnitude(total))
        if greatest < SAFE // 2:
            return np.asarray(total + part * 10**places)
    return np.asarray(total.astype(object) + part.astype(object) * 10**places)


def _sum_column(
    kind: Kind,
    sums: NDArray[Any],
    scale: int,
    numbers: NDArray[np.int64],
    average: bool,
    terms: TermValues,
) -> ObjectColumn:
    """Return sums or averages as result values; ``scale``: that of sums that are mantissas."""
    if kind > Kind.DECIMAL:
        return ObjectColumn(kind, sums / np.maximum(numbers, 1) if average else sums)
    fitting = sums
    if sums.dtype == object:
        # Some exceed 64 bits, usually few: those are computed one by one.
        fits = np.array([-(2**63) <= value < 2**63 for value in sums], np.bool_)
        fitting = np.where(fits, sums, 0).astype(np.int64)
    else:
        fits = np.ones(len(sums), np.bool_)
    if average:
        # The average of integers is a decimal (SPARQL 1.1 §18.5.1.4), that of no rows is 0.
        kind = Kind.DECIMAL
        values, exact = decimals.quotients(fitting, scale, np.maximum(numbers, 1))
        exact &= fits
    elif kind is Kind.INTEGER:
        values, exact = fitting, fits
    else:
        values, exact = decimals.encode(Mantissas(fitting, scale))
        exact &= fits
    column = ObjectColumn(kind, values)
    if exact.all():
        return column
    at, rest = np.flatnonzero(~exact), np.flatnonzero(exact)
    numbers_one_by_one: list[Decimal | None] = []
    for value, count in zip(sums[at].tolist(), numbers[at].tolist(), strict=True):
        if average:
            total = Fraction(int(value), 10**scale)
            numbers_one_by_one.append(decimals.quotient(total, Fraction(max(count, 1))))
        else:
            numbers_one_by_one.append(decimals.scaled(int(value), scale))
    few = exact_column(kind, numbers_one_by_one, terms.dictionary.transient_id)
    return scatter([at, rest], [few, column.take(rest)], terms.dictionary)


def _nothing(dtype: np.dtype[Any]) -> Any:
    return np.inf if dtype == np.float64 else 2**63 - 1


def magnitude(values: NDArray[Any]) -> int:
    """Return the greatest absolute value."""
    if values.strides == (0,):
        return abs(int(values[0]))
    return max(abs(int(values.max())), abs(int(values.min())))
