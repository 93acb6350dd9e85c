"""The rows that windows in bulk aggregate: selected, with their arguments; distinct ones by window.

`bulk_aggregation` makes tables of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn, TripleRows
from ...streams.sample import Times
from ..columns.relation import Pairs, concatenate
from ..operators.partial_aggregates import GREAT, SAFE, magnitude
from .aggregation import IncrementalAggregate

_KINDS: Final = (Kind.INTEGER, Kind.FLOAT, Kind.DOUBLE)


@dataclass(frozen=True, slots=True, eq=False)
class SelectedRows:
    """Rows of the folded predicate that the aggregate selects, in order within each pane and
    subject, with a column for each of its arguments, of one kind of number each."""

    times: Times
    subjects: NDArray[np.int32]
    objects: ObjectColumn
    arguments: list[ObjectColumn]

    @classmethod
    def of(
        cls, tables: Sequence[TripleRows], aggregate: IncrementalAggregate
    ) -> SelectedRows | None:
        """Return those in ``tables``; None if there are none to select from, or if a value is not
        a number of its column's kind."""
        predicate = aggregate.terms.dictionary.find(aggregate.shape.scan.predicate)
        times, subjects, objects = [], [], []
        for table in tables:
            column = table.objects.get(predicate)
            if column is None:
                continue
            rows = slice(None) if column.null is None else np.flatnonzero(column.present)
            times.append(table.time[rows])
            subjects.append(table.subject[rows])
            objects.append(ObjectColumn(column.kind, column.values[rows]))
        if len({column.kind for column in objects}) != 1 or not sum(map(len, times)):
            return None
        time = np.concatenate(times)
        pairs = (
            ObjectColumn(Kind.TERM, np.concatenate(subjects)),
            concatenate(objects, aggregate.terms.dictionary),
        )
        if not aggregate.shape.plain:
            selected = aggregate.selected(pairs)
            pairs = pairs[0].take(selected), pairs[1].take(selected)
            time = time[selected]
        return cls.with_arguments(time, pairs, aggregate)

    @classmethod
    def with_arguments(
        cls, times: Times, pairs: Pairs, aggregate: IncrementalAggregate
    ) -> SelectedRows | None:
        """Return these pairs with the arguments; None if a value is not a number of its column's
        kind, or if sums might overflow."""
        arguments = aggregate.arguments(pairs)
        if any(column.null is not None or column.kind not in _KINDS for column in arguments):
            return None
        rows = cls(times, pairs[0].values, pairs[1], arguments)
        return rows if rows.are_safe() else None

    def are_safe(self) -> bool:
        """Whether no sum of them overflows or needs more than float64."""
        return not len(self.times) or all(
            magnitude(column.values) * len(column) < SAFE
            if column.kind is Kind.INTEGER
            # This is False if there is a NaN.
            else -GREAT < column.values.min() <= column.values.max() < GREAT
            for column in self.arguments
        )


@dataclass(frozen=True, slots=True, eq=False)
class Spans:
    """Distinct pairs: ``rows`` has each once a pane, at the pane's end. It counts in the windows
    that end then or later, and before ``until``: when it leaves the window, or comes again."""

    rows: SelectedRows
    until: Times
