"""The results of one query for successive windows, in columns or by Oxigraph.

`evaluator` uses it for the windows of one query, `cohorts` for windows that many queries share.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from pyoxigraph import Literal

from ...languages.csparql import body_tree, group_keys
from ...languages.csparql.ast import ContinuousQuery
from ...languages.errors import Span
from ...rdf.dictionary import Term
from ...sparql import ast
from ..algebra.from_sparql import Graphs, translate
from ..algebra.plan import Ask, Head, Query
from ..algebra.rewrite_rules import optimize
from ..algebra.triple_times import asks_for_times, at_time
from ..algebra.unsupported import Unsupported
from ..algebra.volatile_functions import calls_volatile, with_seeds
from ..columns.budget import BudgetExceeded
from ..columns.relation import NeedsOxigraph, Relation
from ..estimation.input_rates import Flow
from ..estimation.pattern_sizes import Known
from ..operators.executor import execute
from ..operators.profile import Profile
from ..operators.result_forms import finish, head_variables
from ..operators.results import ResultBatch, WindowResult
from ..operators.sources import StaticSide
from ..operators.stream_operators import Difference
from ..oxigraph.window_store import OxigraphWindows
from ..windows.grid import Schedule
from ..windows.window_schedule import OpenWindows
from .bulk_execution import BulkPlan
from .execution import Execution, WindowRows
from .explain import Explanation


@dataclass(frozen=True, slots=True)
class QueryBody:
    """A query as the tree to plan, and the graphs that its translation needs; ``query`` is the
    query that Oxigraph evaluates if columns cannot."""

    tree: ast.Query
    query: ContinuousQuery
    graphs: Graphs

    @classmethod
    def of(cls, query: ContinuousQuery, schedule: Schedule) -> QueryBody:
        """Return the body of ``query`` over these windows. Raises ``ValueError`` if it has no
        SPARQL form."""
        query = _drop_empty_aggregate(query)
        graphs = Graphs(schedule.named, query.static_named, query.window_variables)
        return cls(body_tree(query), query, graphs)

    def translate(self, bindings: Mapping[str, Term]) -> Query:
        """Return the logical plan with these terms bound. Raises as `from_sparql.translate`."""
        return translate(self.tree, bindings, self.graphs)


def _drop_empty_aggregate(query: ContinuousQuery) -> ContinuousQuery:
    """An AGGREGATE over no rows gives no row ([Events14 §III.A]), but SPARQL gives one if there are
    no group keys: so filter by COUNT(*) > 0."""
    if not query.aggregations or group_keys(query):
        return query
    some = (ast.Comparison(">", ast.Aggregate("COUNT", None), Literal(0)), Span(0, 0))
    return replace(query, aggregate_filters=(*query.aggregate_filters, some))


class Solver:
    """One query over windows; other queries may read the same windows.

    ``alone``: no other query reads them, so the rows may be stored as this one needs them.
    ``folds``: see `Execution`. Raises ``ValueError`` if the query has no SPARQL form.
    """

    def __init__(
        self,
        query: ContinuousQuery,
        windows: OpenWindows,
        static: StaticSide,
        *,
        alone: bool = False,
        folds: bool = True,
    ) -> None:
        self.query = query
        self.windows = windows
        self.static = static
        self.terms = static.terms
        body = QueryBody.of(query, windows.schedule)
        bound = sorted((variable.value, str(term)) for variable, term in query.bindings.items())
        # The seed contains name, streams and windows, so each query draws its own values.
        self._seed = f"{query.source} {bound}"
        self.oxigraph = OxigraphWindows(
            body.query,
            static,
            self.terms,
            body.graphs,
            distinct=windows.options.semantics == "set",
            seed=self._seed,
        )
        self._difference: Difference | None = None
        if windows.differs:
            self._difference = Difference(query.operator, self.terms)
        self.profile: Profile | None = None
        """Set it to record the cost of the operators; `explain` then shows it."""
        self.translated: Query | None = None
        self.execution: Execution | None = None
        """None: Oxigraph evaluates the query, because of `reason`."""
        self.bulk: BulkPlan | str = "Oxigraph evaluates them"
        """How windows that are due at once are evaluated in one pass, or why they are not."""
        self.rules: tuple[str, ...] = ()
        self.reason = ""
        try:
            bindings = {variable.value: term for variable, term in query.bindings.items()}
            self.translated = body.translate(bindings)
            plan, self.rules = optimize(self.translated.plan)
            self.execution = Execution(plan, windows, static, folds=folds)
            if alone:
                self.execution.join_patterns(head_variables(self.translated.head))
            self.bulk = BulkPlan.of(self.execution, self.translated.head)
        except Unsupported as unsupported:
            self.reason = str(unsupported)
            if calls_volatile(body.tree):
                raise ValueError(
                    f"RAND(), UUID() and STRUUID() do not go together with {unsupported}: "
                    "Oxigraph would draw other values when it computes a window again"
                ) from unsupported
            if asks_for_times(body.tree):
                raise ValueError(
                    f"times of triples and {unsupported} do not go together in one query"
                ) from unsupported

    @property
    def retains(self) -> bool:
        """Whether the rows of a window are needed after it has closed."""
        return self.execution is None or self.execution.retains

    def fold(self, end: int) -> None:
        """Fold the rows up to ``end``, which are complete."""
        if self.execution is not None:
            self.execution.fold(end, self.profile)
            if self.profile is not None and self.execution.served:
                # The parts share the selection of rows: the first one is charged with its cost.
                self.profile.beside(self.execution.served[0], self.windows.select_ns)

    def result(self, end: int, *, reports: bool) -> WindowResult | None:
        """Return the result at ``end``, after `fold`. If ``reports`` is False, return a result only
        if the stream operator (ISTREAM, DSTREAM) finds a difference."""
        rows = WindowRows(self.windows.contents, end)
        if self._difference is None:
            return self.solve(rows) if reports else None
        difference = self._difference.of(self.solve(rows))
        return difference if reports or difference.size else None

    @property
    def works_in_bulk(self) -> bool:
        """Whether windows that are due at once may be evaluated in one pass. A profile is of one
        window after the other."""
        return isinstance(self.bulk, BulkPlan) and self.profile is None

    def results(self, ends: Sequence[int]) -> tuple[int, ResultBatch] | None:
        """Return how many windows one pass has evaluated, those that end at the first of ``ends``,
        and the results that `fold` and `result` of each would give; None if they must be evaluated
        one by one."""
        batch = self.bulk.results(ends) if isinstance(self.bulk, BulkPlan) else None
        if batch is None:
            return None
        count = len(batch.ends)
        if self._difference is not None:
            batch = self._difference.of_batch(batch)
            sizes, contents = batch.sizes, self.windows.contents
            # A window without content is reported only if its difference has something.
            batch = batch.of([i for i in range(count) if sizes[i] or contents.has_content(ends[i])])
        return count, batch

    def solve(self, rows: WindowRows) -> WindowResult:
        """Compute the query over these rows."""
        start, shown = self.windows.span(rows.end)
        execution = self.execution
        if execution is not None and self.translated is not None:
            head, plan = self.translated.head, execution.plan
            # The short way records no cost of an operator, so a profile does without it.
            found = execution.solutions() if self.profile is None else None
            if found is not None:
                return self._finished(head, found, start, shown)
            if execution.names_now:
                plan = at_time(plan, shown)
            if execution.has_volatile:
                plan = with_seeds(plan, f"{self._seed} {shown}")
            for source in execution.sources(rows, self.profile):
                try:
                    relation = execute(plan, source, self.terms)
                    return self._finished(head, relation, start, shown)
                except NeedsOxigraph:
                    # The next source does not fold, which may suffice. Else Oxigraph evaluates
                    # exactly, usually bags too; if not, the result is marked `merged`.
                    continue
            if execution.has_volatile:
                raise BudgetExceeded(
                    "RAND(), UUID() and STRUUID() need values that columns can compute: "
                    "Oxigraph would draw others when it computes the window again"
                )
        return self.oxigraph.solve(rows.tables, start, shown)

    def _finished(self, head: Head, relation: Relation, start: int, shown: int) -> WindowResult:
        if not isinstance(head, Ask):
            self.terms.budget.check_result(relation.rows)
        return finish(head, relation, start, shown, self.terms)

    def known(self, flows: Mapping[str, Flow]) -> Known:
        """Return the basis of cost estimates; ``flows`` are the known rates of the inputs, by
        name."""
        distinct = self.windows.options.semantics == "set"
        return Known(self.windows.schedule, self.static, flows, distinct)

    def explanation(self, flows: Mapping[str, Flow]) -> Explanation:
        """Describe the query, its windows, its logical plan, its execution and its cost."""
        oxigraph, execution = self.oxigraph, self.execution
        plan = None
        if execution is not None and self.translated is not None:
            plan = Query(self.translated.head, execution.plan)
        return Explanation(
            self.query,
            oxigraph.sparql,
            self.windows.options,
            self.windows.schedule,
            self.translated,
            plan,
            self.rules,
            self.reason,
            "" if execution is None else execution.shape,
            "" if oxigraph.bag_text is not None else oxigraph.merges,
            self.known(flows),
            () if execution is None else execution.served,
            self.bulk if isinstance(self.bulk, str) else "",
            tuple(self.windows.entailment.describe()),
            self.profile,
        )
