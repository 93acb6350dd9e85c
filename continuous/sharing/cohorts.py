"""Cohorts: instances of a template that share one computation over common windows.

All cohorts read the template's windows. So a cohort costs its plan, its partial aggregates and its
table, but stores no rows.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from typing import TypeAlias

import numpy as np
from pyoxigraph import Variable

from ...languages.csparql import bind
from ...languages.csparql.ast import ContinuousQuery, StreamOperator
from ...rdf.dictionary import Term
from ...sparql import ast
from ..algebra.plan import (
    Distinct,
    Extend,
    Filter,
    Project,
    Query,
    Select,
    outputs,
)
from ..algebra.plan_text import describe, describe_query
from ..algebra.rewrite_rules import optimize
from ..algebra.template_parameters import Joint, Step, Unfit, build_joint
from ..algebra.unsupported import Unsupported
from ..columns.budget import BudgetExceeded
from ..columns.expression_evaluation import evaluate, holds
from ..columns.relation import NeedsOxigraph, Relation
from ..estimation.costs import cost_table, operator_costs
from ..estimation.estimates import estimate
from ..estimation.input_rates import Flow
from ..estimation.pattern_sizes import Known
from ..evaluation.bulk_execution import ROWS, BulkPlan
from ..evaluation.execution import Execution, WindowRows
from ..evaluation.solver import QueryBody, Solver
from ..operators.executor import distinct, execute, run, united
from ..operators.result_forms import END, finish
from ..operators.sources import StaticSide
from ..windows.window_schedule import OpenWindows
from .instance_results import CommonResult, InstancesInBulk, JoinedResults, SeparateResults
from .instance_table import INSTANCE, InstanceTable


@dataclass(frozen=True, slots=True)
class CohortId:
    """The identity of a cohort: the terms that its instances agree on, and a serial number."""

    key: tuple[object, ...]
    serial: int


PAIRS_AT_ONCE = 2_000_000
"""The limit of (solution, instance) pairs in memory at a time."""
OwnQuery: TypeAlias = Callable[[int, Mapping[str, Term]], ContinuousQuery]
"""Returns the query of an instance, from its number and its terms in the cohort's table."""


class SingleCohort:
    """Instances with equal arguments: their query is evaluated once."""

    def __init__(
        self, query: ContinuousQuery, windows: OpenWindows, static: StaticSide, place: CohortId
    ) -> None:
        self.place = place
        self._solver = Solver(query, windows, static)
        self._members = array("q")

    @property
    def live(self) -> int:
        return len(self._members)

    def add(self, number: int, arguments: Mapping[str, Term]) -> None:
        self._members.append(number)

    def remove(self, number: int) -> None:
        self._members.remove(number)

    def explain(self) -> str:
        return str(self._solver.explanation({}))

    def fold(self, end: int) -> None:
        """Fold the rows up to ``end``, which are complete."""
        self._solver.fold(end)

    def results(self, end: int, *, reports: bool) -> tuple[CommonResult, ...]:
        result = self._solver.result(end, reports=reports)
        if result is None:
            return ()
        return (CommonResult(np.array(self._members, np.int64), result),)


class JoinedCohort:
    """Instances that agree on the fixed parameters. The plan is computed once, then joined with the
    table of their other arguments.

    ``own`` returns the query of a single instance. ``alone``: no other cohort reads the windows.

    Cost per window: that of the plan, then `InstanceTable.join`, then numpy per column of the
    result. If columns cannot compute a window, each instance is evaluated separately.
    """

    def __init__(
        self,
        own: OwnQuery,
        windows: OpenWindows,
        static: StaticSide,
        place: CohortId,
        joint: Joint,
        *,
        alone: bool = False,
    ) -> None:
        self.windows = windows
        self.static = static
        self.terms = static.terms
        self.place = place
        self.joint = joint
        self.table = InstanceTable(joint, self.terms)
        self._own = own
        self._execution = Execution(joint.plan, windows, static)
        if alone:
            self._execution.join_patterns(outputs(joint.plan))
        self._alone: dict[int, Solver] = {}
        self._bulk = BulkPlan.of(self._execution, joint.head)

    def explain(self) -> str:
        """Describe the shared plan, its execution, and the steps after the join."""
        lines = describe_query(Query(self.joint.head, self.joint.plan))
        shape = self._execution.shape
        if isinstance(shape, str):
            lines.append(f"in columns, each window anew: {shape}")
        else:
            lines.append("in columns, incrementally")
        lines += [f"then {describe(step)[0]}" for step in self.joint.rest]
        return "\n".join(lines)

    def costs(self, flows: Mapping[str, Flow]) -> Iterator[str]:
        """Yield the table of the shared plan's estimated costs; ``flows`` are the inputs' rates."""
        execution, options = self._execution, self.windows.options
        distinct = options.semantics == "set"
        known = Known(self.windows.schedule, self.static, flows, distinct)
        shape = None if isinstance(execution.shape, str) else execution.shape
        costs = estimate(execution.plan, known, shape, execution.served)
        return cost_table(operator_costs(execution.plan, costs, None), known)

    @property
    def live(self) -> int:
        return self.table.live

    def add(self, number: int, arguments: Mapping[str, Term]) -> None:
        self.table.add(number, arguments)

    def remove(self, number: int) -> None:
        self.table.remove(number)

    def fold(self, end: int) -> None:
        """Fold the rows up to ``end``, which are complete."""
        self._execution.fold(end)

    def results(
        self, end: int, *, reports: bool
    ) -> tuple[JoinedResults | CommonResult | SeparateResults, ...]:
        numbers, alive = self.table.members()
        start, shown = self.windows.span(end)
        rows = WindowRows(self.windows.contents, end)
        for source in self._execution.sources(rows):
            head = self.joint.head
            try:
                relation = execute(self._execution.plan, source, self.terms)
                if not self.table.columns:
                    # There are no other arguments: all instances have the same result.
                    self.terms.budget.check_result(relation.rows)
                    result = finish(head, relation, start, shown, self.terms)
                    return (CommonResult(numbers[alive], result),)
                relation = self._solutions(relation)
                self.terms.budget.check(relation.rows, "a join with the instances")
            except NeedsOxigraph:
                continue
            # Columns suffice again, so the plans of single instances can go.
            self._alone = {}
            return (JoinedResults(start, shown, head, relation, numbers, alive, self.terms),)
        return (self._solve_each(rows),)

    def in_bulk(self, ends: Sequence[int]) -> InstancesInBulk | None:
        """Return the results of the windows that end at some of ``ends``, from the first on,
        instead of `fold` and `results` of each; None if they must be evaluated one by one."""
        if isinstance(self._bulk, str) or not self.table.columns:
            return None
        numbers, alive = self.table.members()
        try:
            found = self._execution.in_bulk(ends, ROWS)
            if found is None:
                return None
            bulk, aggregated = found
            relation = self._solutions(run(self._bulk.steps, aggregated, self.terms))
            self.terms.budget.check(relation.rows, "a join with the instances")
        except (NeedsOxigraph, BudgetExceeded):
            # The window that is concerned raises it again, by itself.
            return None
        self._execution.follow(bulk)
        self._alone = {}
        spans = [self.windows.span(end) for end in bulk.ends]
        return InstancesInBulk(spans, self.joint.head, relation, numbers, alive, self.terms)

    def _solutions(self, relation: Relation) -> Relation:
        """Join the plan's solutions with the table, and apply the remaining steps."""
        pieces: list[Relation] = []
        after: tuple[Step, ...] = ()
        for piece in self._pieces(relation):
            joined, decided = self.table.join(piece)
            # The searched condition is the first step, and the join may have decided it.
            rest = self.joint.rest[1:] if decided else self.joint.rest
            # DISTINCT needs the solutions of all pieces; the steps before it do not.
            alone = tuple(takewhile(lambda step: not isinstance(step, Distinct), rest))
            for step in alone:
                joined = self._step(step, joined)
            pieces.append(joined)
            after = rest[len(alone) :]
        solutions = pieces[0]
        if len(pieces) > 1:
            # The pieces are parts of one relation, so its key holds for all of them.
            solutions = replace(united(pieces, self.terms), key=solutions.key)
        for step in after:
            solutions = self._step(step, solutions)
        return solutions

    def _pieces(self, relation: Relation) -> Sequence[Relation]:
        """Split the solutions if each would meet every instance, so that the pairs of one piece fit
        in memory."""
        size = relation.rows
        if not self.joint.joined and self.joint.search is None:
            size = max(1, PAIRS_AT_ONCE // self.live)
        if size >= relation.rows:
            return (relation,)
        starts = range(0, relation.rows, size)
        return [relation.take(np.arange(i, min(i + size, relation.rows))) for i in starts]

    def _step(self, step: Step, relation: Relation) -> Relation:
        columns, terms = relation.columns, self.terms
        match step:
            case Filter(condition):
                return relation.take(holds(condition, columns, relation.rows, terms))
            case Extend(variable, expression):
                if variable in columns:
                    raise NeedsOxigraph(f"?{variable} is bound twice")
                value = evaluate(expression, columns, relation.rows, terms)
                return Relation({**columns, variable: value}, relation.rows, relation.key)
            case Project(variables):
                # Parameters are in scope everywhere in a template, so a subquery keeps them.
                own = (*self.joint.joined, *self.joint.compared, INSTANCE, END)
                kept = {name: relation.column(name) for name in variables}
                kept |= {name: columns[name] for name in own if name in columns}
                key = relation.key
                key = key if key is not None and key <= kept.keys() else None
                return Relation(kept, relation.rows, key)
            case Distinct():
                return relation if relation.key is not None else distinct(relation, terms)

    def _solve_each(self, rows: WindowRows) -> SeparateResults:
        """Evaluate each instance separately. Cost: a plan and an evaluation per instance."""
        numbers, alive = self.table.members()
        results = {}
        for row in np.flatnonzero(alive).tolist():
            number = int(numbers[row])
            if number not in self._alone:
                columns = self.table.columns.items()
                query = self._own(number, {name: column.term(row) for name, column in columns})
                # No panes are folded for this solver, so it computes windows from their rows.
                self._alone[number] = Solver(query, self.windows, self.static, folds=False)
            results[number] = self._alone[number].solve(rows)
        return SeparateResults(results)


def find_joint(
    windows: OpenWindows,
    query: ContinuousQuery,
    arguments: Mapping[str, Term],
    fixed: tuple[str, ...] = (),
) -> tuple[Joint | None, dict[str, str]]:
    """Return how instances that agree with ``arguments`` on the fixed parameters are computed
    together, and the fixed parameters: ``fixed`` and those with a reason. None: there is nothing
    left to share."""
    reasons = dict.fromkeys(fixed, "")
    if query.operator is not StreamOperator.RSTREAM:
        why = f"{query.operator} compares the results of an instance"
        return None, dict.fromkeys(arguments, why)
    bound = bind(query, {Variable(name): term for name, term in arguments.items()})
    body = QueryBody.of(bound, windows.schedule)
    before = {variable.value: term for variable, term in query.bindings.items()}
    for name in arguments.keys() & _graph_names(body.tree):
        reasons[name] = f"?{name} is a graph"
    try:
        head = body.translate({**before, **arguments}).head
        # Each round makes at least one more parameter fixed, so the rounds end.
        while True:
            names = [name for name in arguments if name not in reasons]
            if not names:
                return None, reasons
            found = body.translate(before | {name: arguments[name] for name in reasons})
            shown = head if isinstance(head, Select) else found.head
            plan, _ = optimize(found.plan)
            try:
                return build_joint(Query(shown, plan), names), reasons
            except Unfit as unfit:
                reasons |= {name: str(unfit) for name in names if unfit.name in (name, "")}
    except (Unsupported, ValueError) as unsupported:
        return None, dict.fromkeys(arguments, str(unsupported))


def _graph_names(tree: ast.Query) -> frozenset[str]:
    """Return the variables after GRAPH or WINDOW."""
    graphs = (node for node in ast.walk(tree) if isinstance(node, ast.Graph))
    return frozenset(graph.name.value for graph in graphs if isinstance(graph.name, Variable))
