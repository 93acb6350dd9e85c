"""The continuous evaluator: rows and watermarks in, a result a window out ([Events14 §III]).

Called by the engine's units and by `evaluate`. Time is an argument; the same rows give the same
results however they were cut into batches. `window_schedule` says when, `solver` what.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ...languages.csparql.ast import ContinuousQuery
from ...rdf.dictionary import TermDictionary
from ..algebra.options import Options
from ..columns.budget import UNLIMITED, Budget
from ..estimation.input_rates import Flow
from ..operators.background import Background
from ..operators.entailment import Asked
from ..operators.profile import Profile
from ..operators.results import WindowResult
from .solver import Solver
from .windowed_evaluator import WindowedEvaluator


class ContinuousEvaluator(WindowedEvaluator[WindowResult]):
    """One continuous query over named inputs.

    ``inputs`` are the names of the input streams. An input that a FROM STREAM clause of the query
    names has that clause's window; any other has the query's WINDOW. Every input gives its rows in
    order of τ, a push at a time, and says by watermarks how far it has come. Raises ``ValueError``
    when no window is known, or the query makes no SPARQL (BIND of a parameter that is given).

    A window that needs more than ``budget`` has no result and is among `overruns`; after some in a
    row there is a `quarantine`. None of that depends on how rows were cut into pushes.

    Law (tests/laws): results equal the definition's, and do not depend on how rows were cut into
    pushes or how often watermarks were told.

    Cost: see `aggregation`, `executor` and `window_store`; `explain` says which serves the query.
    Memory: the rows of the open windows, or their partial aggregates, and their terms, if whoever
    calls has the dictionary `collect` between two calls; else all terms that ever came.
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
            self._windows.entailment.asked = Asked.by(self._solver.translated.plan)

    @property
    def profile(self) -> Profile | None:
        """Where it is set, it takes what the operators cost, and `explain` shows it."""
        return self._solver.profile

    @profile.setter
    def profile(self, profile: Profile | None) -> None:
        self._solver.profile = profile
        self._windows.clock = None if profile is None else profile.clock

    def explain(self, flows: Mapping[str, Flow] | None = None) -> str:
        """The query, its windows, its logical plan, how that is executed and what it costs, for
        people; ``flows`` is what is known of the inputs, by name."""
        return self._solver.explain(flows or {})

    def _closed(self, end: int, reports: bool) -> bool:
        solver = self._solver
        solver.fold(end)
        result = solver.result(end, reports=reports)
        if result is not None:
            self._results.append(result)
        return solver.retains
