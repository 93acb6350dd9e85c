"""The result of one query for one window after the other: in columns, or by Oxigraph.

Called by `evaluator` for the windows of one query, and by `cohorts` for windows that many share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from pyoxigraph import Literal

from ...languages.csparql import body_tree, group_keys
from ...languages.csparql.ast import ContinuousQuery
from ...languages.errors import Span
from ...rdf.dictionary import Term
from ...sparql import ast
from ..algebra.from_sparql import Graphs, translate
from ..algebra.plan import Ask, Query
from ..algebra.rewrite_rules import optimize
from ..algebra.triple_times import asks_for_times, at_time
from ..algebra.unsupported import Unsupported
from ..algebra.volatile_functions import names_chance, with_seeds
from ..columns.budget import BudgetExceeded
from ..columns.relation import NeedsOxigraph
from ..estimation.input_rates import Flow
from ..estimation.pattern_sizes import Known
from ..operators.executor import execute
from ..operators.profile import Profile
from ..operators.result_forms import finish, head_variables
from ..operators.results import WindowResult
from ..operators.sources import StaticSide
from ..operators.stream_operators import Difference
from ..oxigraph.window_store import OxigraphWindows
from ..windows.grid import Schedule
from ..windows.window_schedule import Windowing
from .execution import Execution, WindowRows
from .explain import Stages


@dataclass(frozen=True, slots=True)
class Reading:
    """A query as the tree that is planned, with what the translation has to know of it; ``asked``
    is the query that Oxigraph would be asked."""

    tree: ast.Query
    asked: ContinuousQuery
    graphs: Graphs

    @classmethod
    def of(cls, query: ContinuousQuery, schedule: Schedule) -> Reading:
        """``query`` over these windows; raises ``ValueError`` where it makes no SPARQL."""
        asked = _with_rows_only(query)
        graphs = Graphs(schedule.named, query.static_named, query.window_variables)
        return cls(body_tree(asked), asked, graphs)

    def translated(self, bindings: Mapping[str, Term]) -> Query:
        """The logical plan with these terms put in; raises as `translate`."""
        return translate(self.tree, bindings, self.graphs)


def _with_rows_only(query: ContinuousQuery) -> ContinuousQuery:
    """An AGGREGATE over nothing gives no row, as one with group keys does ([Events14 §III.A])."""
    if not query.aggregations or group_keys(query):
        return query
    some = (ast.Comparison(">", ast.Aggregate("COUNT", None), Literal(0)), Span(0, 0))
    return replace(query, aggregate_filters=(*query.aggregate_filters, some))


class Solver:
    """One query over windows, whose rows others may read too.

    ``alone``: nobody else reads them, so that they may be kept as the query needs them. ``folds``:
    see `Execution`. Raises ``ValueError`` where the query makes no SPARQL.
    """

    def __init__(
        self,
        query: ContinuousQuery,
        windows: Windowing,
        static: StaticSide,
        *,
        alone: bool = False,
        folds: bool = True,
    ) -> None:
        self.query = query
        self.windows = windows
        self.static = static
        self.terms = static.terms
        reading = Reading.of(query, windows.schedule)
        bound = sorted((variable.value, str(term)) for variable, term in query.bindings.items())
        # With its name, streams and windows: another query draws other values.
        self._seed = f"{query.source} {bound}"
        self.oxigraph = OxigraphWindows(
            reading.asked,
            static,
            self.terms,
            reading.graphs,
            distinct=windows.options.semantics == "set",
            seed=self._seed,
        )
        self._difference: Difference | None = None
        if windows.differs:
            self._difference = Difference(query.operator, self.terms)
        self.profile: Profile | None = None
        """Where it is set, it takes what the operators cost, and `explain` shows it."""
        self.translated: Query | None = None
        self.execution: Execution | None = None
        """None: by Oxigraph, because of `reason`."""
        self.rules: tuple[str, ...] = ()
        self.reason = ""
        try:
            bindings = {variable.value: term for variable, term in query.bindings.items()}
            self.translated = reading.translated(bindings)
            plan, self.rules = optimize(self.translated.plan)
            self.execution = Execution(plan, windows, static, folds=folds)
            if alone:
                self.execution.join_patterns(head_variables(self.translated.head))
        except Unsupported as unsupported:
            self.reason = str(unsupported)
            if names_chance(reading.tree):
                raise ValueError(
                    f"RAND(), UUID() and STRUUID() do not go together with {unsupported}: "
                    "Oxigraph would draw others when a window is computed again"
                ) from unsupported
            if asks_for_times(reading.tree):
                raise ValueError(
                    f"times of triples and {unsupported} do not go together in one query"
                ) from unsupported

    @property
    def retains(self) -> bool:
        """Whether the rows of a window are read again when it has closed."""
        return self.execution is None or self.execution.retains

    def fold(self, end: int) -> None:
        """The rows up to ``end`` are there."""
        if self.execution is not None:
            self.execution.fold(end, self.profile)
            if self.profile is not None and self.execution.served:
                # All parts read what the windows selected: it is told with the first of them.
                self.profile.beside(self.execution.served[0], self.windows.turned)

    def result(self, end: int, *, reports: bool) -> WindowResult | None:
        """What is given out at ``end``, after `fold`; where ``reports`` is not, only a difference
        that there is."""
        rows = WindowRows(self.windows.contents, end)
        if self._difference is None:
            return self.solve(rows) if reports else None
        found = self._difference.of(self.solve(rows))
        return found if reports or found.size else None

    def solve(self, rows: WindowRows) -> WindowResult:
        """The result of the query over these rows."""
        start, shown = self.windows.span(rows.end)
        execution = self.execution
        if execution is not None and self.translated is not None:
            head, plan = self.translated.head, execution.plan
            if execution.names_now:
                plan = at_time(plan, shown)
            if execution.has_chance:
                plan = with_seeds(plan, f"{self._seed} {shown}")
            for source in execution.sources(rows, self.profile):
                try:
                    relation = execute(plan, source, self.terms)
                    if not isinstance(head, Ask):
                        self.terms.budget.check_result(relation.rows)
                    return finish(head, relation, start, shown, self.terms)
                except NeedsOxigraph:
                    # Not folded, columns may do; else Oxigraph is as exact, bags too; where it is
                    # not, the result says so (`merged`).
                    continue
            if execution.has_chance:
                raise BudgetExceeded(
                    "RAND(), UUID() and STRUUID() need values that columns can compute: "
                    "Oxigraph would give others when the window is computed again"
                )
        return self.oxigraph.solve(rows.tables, start, shown)

    def known(self, flows: Mapping[str, Flow]) -> Known:
        """What costs are estimated from; ``flows`` is what is known of the inputs, by name."""
        distinct = self.windows.options.semantics == "set"
        return Known(self.windows.schedule, self.static, flows, distinct)

    def explain(self, flows: Mapping[str, Flow]) -> str:
        """The query, its windows, its logical plan, how that is executed and what it costs, for
        people."""
        oxigraph, execution = self.oxigraph, self.execution
        plan = None
        if execution is not None and self.translated is not None:
            plan = Query(self.translated.head, execution.plan)
        return str(
            Stages(
                self.query,
                oxigraph.sparql,
                self.windows.options,
                self.windows.schedule,
                self.translated,
                plan,
                self.rules,
                self.reason,
                "" if execution is None else execution.shape,
                "" if oxigraph.counting is not None else oxigraph.merges,
                self.known(flows),
                () if execution is None else execution.served,
                tuple(self.windows.entailment.described()),
                self.profile,
            )
        )
