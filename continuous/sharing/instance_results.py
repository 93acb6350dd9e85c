"""Results of a window for all instances: columns with an instance number per row."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn, TripleRows
from ..algebra.plan import Ask, Construct, Head, Select
from ..columns.pane_runs import equal_runs
from ..columns.relation import (
    Relation,
    TermValues,
    concatenate,
    first_rows,
    key_codes,
)
from ..operators.result_forms import END, construct, finish, instantiated
from ..operators.results import ResultBatch, Solutions, WindowResult
from .instance_table import INSTANCE

Numbers: TypeAlias = NDArray[np.int64]
"""Instance numbers: ascending for a set of instances, in row order for rows."""


@dataclass(frozen=True, eq=False)
class CommonResult:
    """Instances with the same result."""

    instances: Numbers
    result: WindowResult

    def of(self, instance: int) -> WindowResult | None:
        return self.result if _has(self.instances, instance) else None

    @property
    def reported(self) -> Numbers:
        return self.instances

    @property
    def answered(self) -> Numbers:
        some = self.result.answer is not None or self.result.size > 0
        return self.instances if some else self.instances[:0]

    def silent(self) -> Iterator[tuple[Numbers, WindowResult]]:
        if not len(self.answered):
            yield self.instances, self.result

    @property
    def rows(self) -> int:
        return self.result.size * len(self.instances)

    def solutions(self) -> Iterator[tuple[Numbers, Solutions]]:
        found = self.result.solutions
        if found is not None:
            rows = np.tile(np.arange(len(found)), len(self.instances))
            yield np.repeat(self.instances, len(found)), found.take(rows)

    def triples(self) -> Iterator[tuple[Numbers, TripleRows]]:
        for table in () if self.result.triples is None else self.result.triples.tables:
            rows = np.tile(np.arange(len(table)), len(self.instances))
            yield np.repeat(self.instances, len(table)), table.take(rows)

    def holding(self) -> Numbers:
        return self.instances if self.result.answer else self.instances[:0]


@dataclass(frozen=True, eq=False)
class SeparateResults:
    """Instances with separate results, by ascending number."""

    results: Mapping[int, WindowResult]

    def of(self, instance: int) -> WindowResult | None:
        return self.results.get(instance)

    @property
    def reported(self) -> Numbers:
        return np.array([*self.results], np.int64)

    @property
    def answered(self) -> Numbers:
        return self._select(lambda result: result.answer is not None or result.size > 0)

    def silent(self) -> Iterator[tuple[Numbers, WindowResult]]:
        for part in self._parts():
            yield from part.silent()

    @property
    def rows(self) -> int:
        return sum(result.size for result in self.results.values())

    def solutions(self) -> Iterator[tuple[Numbers, Solutions]]:
        for part in self._parts():
            yield from part.solutions()

    def triples(self) -> Iterator[tuple[Numbers, TripleRows]]:
        for part in self._parts():
            yield from part.triples()

    def holding(self) -> Numbers:
        return self._select(lambda result: bool(result.answer))

    def _parts(self) -> Iterator[CommonResult]:
        for number, result in self.results.items():
            yield CommonResult(np.array([number], np.int64), result)

    def _select(self, chosen: Callable[[WindowResult], bool]) -> Numbers:
        return np.array([n for n, result in self.results.items() if chosen(result)], np.int64)


@dataclass(frozen=True, eq=False)
class JoinedResults:
    """The solutions of all instances of a cohort in one relation.

    ``numbers``: the instance numbers of the rows of the cohort's table, which `INSTANCE` indexes.
    Only ``alive`` rows have a result.
    """

    start: int
    end: int
    head: Head
    relation: Relation
    numbers: Numbers
    alive: NDArray[np.bool_]
    terms: TermValues

    def of(self, instance: int) -> WindowResult | None:
        row = int(np.searchsorted(self.numbers, instance))
        if row == len(self.numbers) or self.numbers[row] != instance or not self.alive[row]:
            return None
        order, ordered = self._by_instance
        low, high = np.searchsorted(ordered, [row, row + 1])
        found = _of_one(self.relation.take(order[low:high]))
        return finish(self.head, found, self.start, self.end, self.terms)

    def batch(self) -> ResultBatch | None:
        """Return the results of all instances that have solutions as one batch, with the numbers of
        the instances in place of the windows' ends; None for ASK. Cost: numpy per column."""
        return _by_key(self.head, self.relation, self._numbers, self.terms)

    def __post_init__(self) -> None:
        self.terms.dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[np.int32]]:
        """See `dictionary.Holder`."""
        for column in self.relation.columns.values():
            yield column.held_ids

    @property
    def reported(self) -> Numbers:
        return self.numbers[self.alive]

    @property
    def answered(self) -> Numbers:
        return self.reported if isinstance(self.head, Ask) else np.unique(self._numbers)

    def silent(self) -> Iterator[tuple[Numbers, WindowResult]]:
        others = np.setdiff1d(self.reported, self.answered, assume_unique=True)
        if len(others):
            nothing = self.relation.take(np.zeros(0, np.int64))
            yield others, finish(self.head, nothing, self.start, self.end, self.terms)

    @property
    def rows(self) -> int:
        return self.relation.rows

    def solutions(self) -> Iterator[tuple[Numbers, Solutions]]:
        if isinstance(self.head, Select):
            found = finish(self.head, self.relation, self.start, self.end, self.terms).solutions
            assert found is not None
            yield self._numbers, found

    def triples(self) -> Iterator[tuple[Numbers, TripleRows]]:
        """As `result_forms.construct`, each triple once per instance."""
        if not isinstance(self.head, Construct):
            return
        relation = _of_one(self.relation)
        parts_of = instantiated(self.head, relation, np.full(relation.rows, self.end), self.terms)
        for predicate, parts in parts_of.items():
            numbers = np.concatenate([self._numbers[part.rows] for part in parts])
            subjects = np.concatenate([part.subjects for part in parts])
            objects = concatenate([part.objects for part in parts], self.terms.dictionary)
            if len(subjects) > 1 and (len(parts) > 1 or not parts[0].unique):
                keys = [
                    [ObjectColumn(Kind.INTEGER, numbers)],
                    [ObjectColumn(Kind.TERM, subjects)],
                    [objects],
                ]
                once = first_rows(key_codes(keys, self.terms.dictionary)[0])
                numbers, subjects, objects = numbers[once], subjects[once], objects.take(once)
            if len(numbers):
                times = np.full(len(numbers), self.end, np.int64)
                yield numbers, TripleRows(times, times, subjects, {predicate: objects})

    def holding(self) -> Numbers:
        return np.unique(self._numbers)

    @cached_property
    def _numbers(self) -> Numbers:
        numbers: Numbers = self.numbers[self.relation.columns[INSTANCE].values]
        return numbers

    @cached_property
    def _by_instance(self) -> tuple[Numbers, Numbers]:
        rows = self.relation.columns[INSTANCE].values
        order = np.argsort(rows, kind="stable")
        return order, rows[order]


InstancePart: TypeAlias = CommonResult | SeparateResults | JoinedResults
"""The results of some instances in a window."""


@dataclass(frozen=True, eq=False)
class InstanceResults:
    """The results of the window with end ``end`` (ns) for all present instances.

    Law: ``of(i)`` is the result of instance i alone. Cost: columns are made on request; `of` sorts
    the solutions once, then finds those of one instance. Memory: the solutions and the table's
    numbers.
    """

    start: int
    end: int
    parts: tuple[InstancePart, ...]

    def of(self, instance: int) -> WindowResult | None:
        """Return the result of one instance; None if it did not exist when the window closed."""
        return next((r for part in self.parts if (r := part.of(instance)) is not None), None)

    @property
    def instances(self) -> Numbers:
        """The instances that have a result, empty ones included, ascending."""
        return np.sort(np.concatenate([_NONE, *(part.reported for part in self.parts)]))

    @property
    def answered(self) -> Numbers:
        """The instances that have solutions (for ASK: an answer), ascending."""
        return np.sort(np.concatenate([_NONE, *(part.answered for part in self.parts)]))

    def silent(self) -> Iterator[tuple[Numbers, WindowResult]]:
        """Yield the instances whose result has no solutions, ascending, and that result, which many
        share."""
        for part in self.parts:
            yield from part.silent()

    @property
    def size(self) -> int:
        """The number of solutions of all instances (of common results: rows)."""
        return sum(part.rows for part in self.parts)

    def solutions(self) -> Iterator[tuple[Numbers, Solutions]]:
        """Yield tables of solutions of a SELECT, with the instance of each row."""
        for part in self.parts:
            yield from part.solutions()

    def triples(self) -> Iterator[tuple[Numbers, TripleRows]]:
        """Yield tables of triples of a CONSTRUCT, with the instance of each row."""
        for part in self.parts:
            yield from part.triples()

    def holding(self) -> Numbers:
        """Return the instances whose answer to an ASK is true, ascending."""
        return np.sort(np.concatenate([_NONE, *(part.holding() for part in self.parts)]))

    def windows(self) -> Iterator[InstanceResults]:
        """Yield the results of each window: these."""
        yield self


@dataclass(frozen=True, eq=False)
class InstancesInBulk:
    """The results of successive windows with these ``spans`` (start and end, ns) for all instances
    of a cohort. `END` is the number of a row's window in ``relation``, and the rest as in
    `JoinedResults`."""

    spans: Sequence[tuple[int, int]]
    head: Head
    relation: Relation
    numbers: Numbers
    alive: NDArray[np.bool_]
    terms: TermValues

    def __post_init__(self) -> None:
        self.terms.dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[np.int32]]:
        """See `dictionary.Holder`."""
        for column in self.relation.columns.values():
            yield column.held_ids

    def batch(self) -> ResultBatch | None:
        """Return the results of all instances in all windows as one batch, with ``number * windows
        + window`` in place of the windows' ends; see `JoinedResults.batch`."""
        columns = self.relation.columns
        own = self.numbers[columns[INSTANCE].values] * len(self.spans) + columns[END].values
        return _by_key(self.head, self.relation, own, self.terms)

    def windows(self) -> Iterator[InstanceResults]:
        """Yield the results of each window."""
        windows = self.relation.columns[END].values
        order = np.argsort(windows, kind="stable")
        first = np.searchsorted(windows[order], np.arange(len(self.spans) + 1)).tolist()
        key = self.relation.key
        relation = replace(self.relation, key=None if key is None else key - {END})
        for i, (start, end) in enumerate(self.spans):
            rows = relation.take(order[first[i] : first[i + 1]])
            part = JoinedResults(start, end, self.head, rows, self.numbers, self.alive, self.terms)
            yield InstanceResults(start, end, (part,))


_NONE: Numbers = np.zeros(0, np.int64)


def _by_key(head: Head, relation: Relation, keys: Numbers, terms: TermValues) -> ResultBatch | None:
    """Return a result for each distinct key (of each solution), which stands in place of a window's
    end. None for ASK."""
    if isinstance(head, Ask):
        return None
    order = np.argsort(keys, kind="stable")
    relation, keys = relation.take(order), keys[order]
    first = [run.start for run in equal_runs(keys)]
    places = keys[first].tolist()
    if isinstance(head, Select):
        columns = {name: relation.columns[name] for name in head.variables}
        found = Solutions(head.variables, columns, terms.dictionary, relation.rows)
        offsets = [*first, relation.rows]
        return ResultBatch(places, places, solutions=found, offsets=offsets)
    if relation.key is not None:
        # Equal triples of two keys are two triples, as those of two windows are.
        relation = replace(relation, key=relation.key - {INSTANCE} | {END})
    return ResultBatch(places, places, triples=construct(head, relation, keys, terms))


def _of_one(relation: Relation) -> Relation:
    """Replace the key by that of a single instance's rows."""
    return replace(relation, key=None if relation.key is None else relation.key - {INSTANCE})


def _has(ascending: Numbers, number: int) -> bool:
    at = int(np.searchsorted(ascending, number))
    return at < len(ascending) and int(ascending[at]) == number
