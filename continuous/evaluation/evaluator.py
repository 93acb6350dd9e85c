"""The evaluator of one continuous query ([Events14 §III]): it takes rows and watermarks and returns
a result per window.

The engine's units and `evaluate` call it. Time is an argument: the same rows give the same results,
however they are cut into batches. `window_schedule` decides when a window closes, `solver` computes
its result.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ...languages.csparql.ast import ContinuousQuery
from ...rdf.dictionary import TermDictionary
from ..algebra.options import Options
from ..columns.budget import UNLIMITED, Budget
from ..estimation.input_rates import Flow
from ..operators.background import Background
from ..operators.entailment import PatternNeeds
from ..operators.profile import Profile
from ..operators.results import ResultBatch, WindowResult
from ..windows.window_schedule import EvaluateWindows
from .explain import Explanation
from .solver import Solver
from .windowed_evaluator import WindowedEvaluator


class ContinuousEvaluator(WindowedEvaluator[WindowResult | ResultBatch]):
    """One continuous query over named inputs.

    ``inputs`` are the names of the input streams. If a FROM STREAM clause names an input, the input
    has that clause's window; any other has the query's WINDOW. Each input pushes its rows in order
    of τ, and its watermarks state its progress. Raises ``ValueError`` if there is no window, or if
    the query has no SPARQL form (BIND of a bound parameter).

    A window that exceeds ``budget`` has no result and appears in `overruns`; `OVERRUNS` such
    windows in a row set `quarantine`. None of that depends on how rows are cut into pushes.

    Law (tests/laws): results equal the definition's. They depend neither on how rows are cut into
    pushes nor on how often watermarks come.

    Cost: see `aggregation`, `executor` and `window_store`; `explain` shows which one evaluates the
    query. Memory: the rows of the open windows, or their partial aggregates, and their terms. The
    caller must call the dictionary's `collect` between two calls; else all terms stay.
    """

    def __init__(
        self,
        query: ContinuousQuery,
        dictionary: TermDictionary,
        background: Background,
        inputs: Sequence[str],
        options: Options | None = None,
        budget: Budget = UNLIMITED,
    ) -> None:
        super().__init__(query, dictionary, background, inputs, options, budget)
        self.query = query
        self.inputs, self.schedule = self._windows.inputs, self._windows.schedule
        self._solver = Solver(query, self._windows, self._static, alone=True)
        if self._solver.translated is not None:
            self._windows.entailment.needs = PatternNeeds.of(self._solver.translated.plan)

    @property
    def profile(self) -> Profile | None:
        """Set it to record the cost of the operators; `explain` then shows it."""
        return self._solver.profile

    @profile.setter
    def profile(self, profile: Profile | None) -> None:
        self._solver.profile = profile
        self._windows.clock = None if profile is None else profile.clock

    def explain(self, flows: Mapping[str, Flow] | None = None) -> str:
        """Return the text of `explanation`."""
        return str(self.explanation(flows))

    def explanation(self, flows: Mapping[str, Flow] | None = None) -> Explanation:
        """Describe the query, its windows, its logical plan, its execution and its cost. ``flows``
        are the known rates of the inputs, by name."""
        return self._solver.explanation(flows or {})

    def _in_bulk(self) -> EvaluateWindows | None:
        return self._close_many if self._solver.works_in_bulk else None

    def _close_many(self, ends: list[int]) -> tuple[int, bool] | None:
        found = self._solver.results(ends)
        if found is None:
            return None
        closed, batch = found
        self._in_a_row = 0
        if batch.ends:
            self._results.append(batch)
        return closed, self._solver.retains

    def _evaluate(self, end: int, reports: bool) -> bool:
        solver = self._solver
        solver.fold(end)
        result = solver.result(end, reports=reports)
        if result is not None:
            self._results.append(result)
        return solver.retains
