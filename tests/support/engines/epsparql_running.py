"""EP-SPARQL queries at work on samples, for tests."""

from __future__ import annotations

import pickle

from epsparql_definition import Sample, Value
from epsparql_drawing import background, rows_of, value_of

from dyknow.reasoning.patterns.plans.query import Keys, PatternQuery, with_numbers
from dyknow.reasoning.patterns.recognition.combined import NO_ROW, CombinedMatches, CombinedRows
from dyknow.reasoning.patterns.recognition.static_tables import StaticTables

Result = tuple[tuple[int, ...], tuple[tuple[str, Value | None], ...], int]
"""The samples, the values of the head, and the time of decision."""


class Running:
    """A query at work on samples."""

    def __init__(self, query: PatternQuery, *, is_ordered: bool = True) -> None:
        self.query = query
        self.is_ordered = is_ordered
        self.keys = Keys()
        self.plans = [with_numbers(plan, self.keys) for plan in query.plans]
        self.numbers: list[int] = []
        """The sample of each row."""
        self.rows = self.made()

    def made(self) -> CombinedRows:
        return CombinedRows(
            self.plans,
            self.query.branches,
            is_ordered=self.is_ordered,
            capacity=8,
            static=StaticTables(background(), self.keys, ["urn:g"]),
        )

    def push(self, samples: list[Sample]) -> list[Result]:
        rows, numbers = rows_of(samples, self.query, self.keys)
        self.numbers += numbers
        return self.results(self.rows.push(rows))

    def advance(self, watermark: int) -> list[Result]:
        return self.results(self.rows.advance(watermark))

    def reopen(self) -> None:
        """Go on in another evaluator, from the state of this one."""
        state = pickle.loads(pickle.dumps(self.rows.state()))
        self.rows = self.made()
        self.rows.restore(state)

    def results(self, matches: CombinedMatches) -> list[Result]:
        found = []
        kinds = {result.name: result.kind for result in self.query.results}
        columns = {name: matches.outputs[name].tolist() for name in kinds}
        for i, rows in enumerate(matches.rows.tolist()):
            samples = tuple(self.numbers[row] for row in rows if row != NO_ROW)
            values = tuple(
                (name, value_of(kind, columns[name][i], self.keys)) for name, kind in kinds.items()
            )
            found.append((samples, values, int(matches.decided[i])))
        return found
