"""Stream operators: from the results of windows to the output stream: RSTREAM, ISTREAM, DSTREAM
([CQL §3]; RSP-QL §4.4).

ISTREAM outputs the part of a result that the previous result lacks, DSTREAM the part of the
previous result that this one lacks. The first result follows an empty one. Solutions are compared
as bags: three equal solutions after two output one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...languages.csparql.ast import StreamOperator
from ...rdf.terms_to_columns import from_terms
from ...rdf.timed import TimedTriples
from ..columns.relation import TermValues, key_codes
from .results import Solutions, WindowResult


class Difference:
    """Compares each result with the previous one. Cost: a sort of both; memory: one result."""

    def __init__(self, operator: StreamOperator, terms: TermValues) -> None:
        self.operator = operator
        self.terms = terms
        self._before: WindowResult | None = None

    def of(self, result: WindowResult) -> WindowResult:
        """Return the output for ``result``, the next one."""
        before, self._before = self._before, result
        new, old = (before, result), (result, before)
        without, whole = new if self.operator is StreamOperator.ISTREAM else old
        if result.answer is not None:
            # An answer is a bag of solutions without variables: one, or none.
            was = without is not None and bool(without.answer)
            return replace(result, answer=whole is not None and bool(whole.answer) and not was)
        if result.triples is not None:
            return replace(result, triples=self._triples(whole, without, result.end))
        assert result.solutions is not None
        if whole is None or whole.solutions is None:
            nothing = result.solutions.take(np.zeros(0, np.int64))
            return replace(result, solutions=nothing)
        rows = self._rows(whole.solutions, None if without is None else without.solutions)
        return replace(result, solutions=whole.solutions.take(rows))

    def _rows(self, whole: Solutions, without: Solutions | None) -> NDArray[np.int64]:
        """Return the rows of ``whole`` in excess of equal rows in ``without``."""
        if without is None or not without.length:
            return np.arange(whole.length)
        if not whole.variables:
            return np.arange(min(whole.length, without.length), whole.length)
        pairs = [[whole.columns[name], without.columns[name]] for name in whole.variables]
        mine, theirs = key_codes(pairs, self.terms.dictionary)
        values, numbers = np.unique(theirs, return_counts=True)
        order = np.argsort(mine, kind="stable")
        ordered = mine[order]
        nth = np.arange(len(mine)) - np.searchsorted(ordered, ordered, "left")
        at = np.searchsorted(values, ordered)
        common = (at < len(values)) & (values[np.minimum(at, len(values) - 1)] == ordered)
        had = np.where(common, numbers[np.minimum(at, len(values) - 1)], 0)
        return np.sort(order[nth >= had])

    def _triples(
        self, whole: WindowResult | None, without: WindowResult | None, end: int
    ) -> TimedTriples:
        """Return the triples of one graph that the other lacks, at the time of this result."""
        removed = set() if without is None else _graph(without)
        kept = [] if whole is None else [one for one in _graph(whole) if one not in removed]
        return from_terms(((end, *triple) for triple in kept), self.terms.dictionary)


def _graph(result: WindowResult) -> dict[tuple, None]:  # type: ignore[type-arg]
    return {} if result.triples is None else {(s, p, o): None for _, s, p, o in result.triples}
