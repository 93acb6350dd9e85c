"""Stream operators: from the results of windows to the output stream: RSTREAM, ISTREAM, DSTREAM
([CQL §3]; RSP-QL §4.4).

ISTREAM outputs the part of a result that the previous result lacks, DSTREAM the part of the
previous result that this one lacks. The first result follows an empty one. Solutions are compared
as bags: three equal solutions after two output one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...languages.csparql.ast import StreamOperator
from ...rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows
from ...streams.sample import Times
from ..columns.relation import TermValues, concatenate, key_codes
from .results import ResultBatch, Solutions, WindowResult

Rows = NDArray[np.int64]


class Difference:
    """Compares each result with the previous one. Cost: a sort of the results; memory: one result.

    Law: the output for several results is that for one after the other.
    """

    def __init__(self, operator: StreamOperator, terms: TermValues) -> None:
        self.operator = operator
        self.terms = terms
        self._before: WindowResult | None = None

    def of(self, result: WindowResult) -> WindowResult:
        """Return the output for ``result``, the next one."""
        if result.answer is not None:
            return self._of_answer(result)
        starts, ends = (result.start,), (result.end,)
        size = 0 if result.solutions is None else result.solutions.length
        one = ResultBatch(starts, ends, result.solutions, result.triples, (0, size))
        output = self.of_batch(one)
        return replace(result, solutions=output.solutions, triples=output.triples)

    def of_batch(self, results: ResultBatch) -> ResultBatch:
        """Return the output for each of ``results``, the next ones."""
        before, self._before = self._before, results.window(len(results.ends) - 1)
        if results.triples is not None:
            old = () if before is None or before.triples is None else before.triples.tables
            return replace(results, triples=self._triples(old, results.triples, results.ends))
        assert results.solutions is not None
        old_solutions = None if before is None else before.solutions
        return self._solutions(old_solutions, results.solutions, results)

    def _of_answer(self, result: WindowResult) -> WindowResult:
        """An answer is a bag of solutions without variables: one, or none."""
        before, self._before = self._before, result
        new, old = bool(result.answer), before is not None and bool(before.answer)
        whole, without = (new, old) if self._inserts else (old, new)
        return replace(result, answer=whole and not without)

    @property
    def _inserts(self) -> bool:
        return self.operator is StreamOperator.ISTREAM

    def _solutions(
        self, old: Solutions | None, new: Solutions, results: ResultBatch
    ) -> ResultBatch:
        """Return the excess of ``new``, or of ``old`` and ``new`` over the window after each."""
        count, sizes = len(results.ends), np.diff(results.offsets)
        windows = np.repeat(np.arange(1, count + 1), sizes)
        whole = new
        if old is not None and old.length:
            windows = np.concatenate([np.zeros(old.length, np.int64), windows])
            columns = {
                name: concatenate([old.columns[name], new.columns[name]], new.dictionary)
                for name in new.variables
            }
            whole = Solutions(new.variables, columns, new.dictionary, len(windows))
        codes = np.zeros(len(windows), np.int64)
        if whole.variables:
            columns_of = ([whole.columns[name]] for name in whole.variables)
            codes = key_codes(columns_of, new.dictionary)[0]
        rows = self._excess(windows, codes, count)
        at = windows[rows] - 1 if self._inserts else windows[rows]
        offsets = np.searchsorted(at, np.arange(count + 1)).tolist()
        return replace(results, solutions=whole.take(rows), offsets=offsets)

    def _excess(self, windows: Rows, codes: Rows, count: int) -> Rows:
        """Return the rows of windows 0 … ``count``, ascending, in excess of rows with the same code
        in the window before (ISTREAM), or in the one after (DSTREAM), if there is one."""
        _, codes = np.unique(codes, return_inverse=True)
        codes = codes.reshape(-1)
        other = -1 if self._inserts else 1
        size = int(codes.max(initial=0)) + 1
        mine, theirs = windows * size + codes, (windows + other) * size + codes
        values, numbers = np.unique(mine, return_counts=True)
        order = np.argsort(mine, kind="stable")
        nth = np.empty(len(mine), np.int64)
        nth[order] = np.arange(len(mine)) - np.searchsorted(mine[order], mine[order])
        at = np.minimum(np.searchsorted(values, theirs), len(values) - 1)
        had = np.where(values[at] == theirs, numbers[at], 0)
        compared = (windows + other >= 0) & (windows + other <= count)
        # Results are bags: the n-th of equal rows is in excess if the other has fewer than n.
        return np.flatnonzero(compared & (nth >= had))

    def _triples(
        self, old: Sequence[TripleRows], new: TimedTriples, ends: Sequence[int]
    ) -> TimedTriples:
        """Return the triples of each graph that the one before or after it lacks, at the time of
        the window that outputs them. ``old`` is the graph before those of ``new``."""
        moments = np.array(ends, np.int64)
        tables = [*old, *new.tables]
        windows = [np.zeros(len(table), np.int64) for table in old]
        windows += [np.searchsorted(moments, table.time) + 1 for table in new.tables]
        kept: list[dict[int, ObjectColumn]] = [{} for _ in tables]
        for id in dict.fromkeys(id for table in tables for id in table.objects):
            places = [i for i, table in enumerate(tables) if id in table.objects]
            columns = [tables[i].objects[id] for i in places]
            present = [np.flatnonzero(column.present) for column in columns]
            subjects = [tables[i].subject[at] for i, at in zip(places, present, strict=True)]
            objects = [
                ObjectColumn(column.kind, column.values[at])
                for column, at in zip(columns, present, strict=True)
            ]
            of = np.concatenate([windows[i][at] for i, at in zip(places, present, strict=True)])
            order = np.argsort(of, kind="stable")
            keys = [
                [ObjectColumn(Kind.TERM, np.concatenate(subjects)).take(order)],
                [concatenate(objects, new.dictionary).take(order)],
            ]
            codes = key_codes(keys, new.dictionary)[0]
            marks = np.zeros(len(of), np.bool_)
            marks[order[self._excess(of[order], codes, len(ends))]] = True
            at = 0
            for i, column, rows in zip(places, columns, present, strict=True):
                null = np.ones(len(column), np.bool_)
                null[rows[marks[at : at + len(rows)]]] = False
                at += len(rows)
                kept[i][id] = ObjectColumn(column.kind, column.values, null)
        found = []
        for table, objects_of, mine in zip(tables, kept, windows, strict=True):
            output = mine - 1 if self._inserts else mine
            found.append(_without_nulls(table, objects_of, moments, output))
        return TimedTriples(new.dictionary, tuple(table for table in found if len(table)))


def _without_nulls(
    table: TripleRows, objects: dict[int, ObjectColumn], moments: Times, windows: Rows
) -> TripleRows:
    """Return the rows of ``table`` that have one of ``objects``, at the time of their window."""
    nulls = [column.null for column in objects.values() if column.null is not None]
    rows = np.flatnonzero(~np.logical_and.reduce(nulls))
    found = {}
    for id, column in objects.items():
        taken = column.take(rows)
        has_null = taken.null is not None and bool(taken.null.any())
        found[id] = taken if has_null else ObjectColumn(taken.kind, taken.values)
    times = moments[windows[rows]]
    return TripleRows(times, times, table.subject[rows], found)
