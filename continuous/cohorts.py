"""Cohorts: instances of a template that one computation serves, over windows that all share.

Each is a `ContinuousEvaluator` that reads the contents of the template's windows instead of its
own, so that a cohort costs its plan, its partial aggregates and its table, but no rows.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping
from typing import Any

import numpy as np
from pyoxigraph import Variable

from ..languages.csparql import algebra, bind
from ..languages.csparql.ast import ContinuousQuery, StreamOperator
from ..languages.csparql.shape import query_shape
from ..rdf.dictionary import Term
from .columns import NeedsOxigraph, Relation
from .evaluation import evaluate, holds
from .evaluator import ContinuousEvaluator, _Source, _Windows, _with_rows_only
from .flows import Flow
from .incremental import Incremental
from .instance_results import Common, Joined
from .instance_table import INSTANCE, InstanceTable
from .logical import Distinct, Extend, Filter, Plan, Project, Query, Select
from .parameters import Joint, Step, Unfit, joint
from .printing import describe, describe_query
from .relational import distinct, execute
from .results import WindowResult
from .rules import optimize
from .translate import Graphs, translate
from .unsupported import Unsupported


class Reader(ContinuousEvaluator):
    """An evaluator over the windows of another one, which tells it when they close."""

    def __init__(self, owner: ContinuousEvaluator, query: ContinuousQuery) -> None:
        self._owner = owner
        self.key: tuple[object, ...] = ()
        """What its instances agree on."""
        self.serial = 0
        dictionary, background = owner._terms.dictionary, owner._static.background
        super().__init__(query, dictionary, background, owner.inputs, owner.options)

    def _prepare(self, query: ContinuousQuery) -> None:
        owner = self._owner
        self._terms, self._static = owner._terms, owner._static
        self._contents = owner._contents
        self._plan_for(query)

    def _plan_for(self, query: ContinuousQuery) -> None:
        super()._prepare(query)

    def _join_patterns(self, plan: Plan) -> None:
        # The compiled loop keeps the rows in a form of its own; here they are everybody's.
        return

    def fold(self, end: int) -> None:
        """The rows up to ``end`` are there. The first time, the whole window is folded."""
        if self._incremental is not None:
            self._fold(self._incremental, end)
        self._closed = end


class Alone(Reader):
    """Instances with the same arguments, evaluated as their own query is."""

    def __init__(self, owner: ContinuousEvaluator, query: ContinuousQuery) -> None:
        self._members = array("q")
        super().__init__(owner, query)

    @property
    def live(self) -> int:
        return len(self._members)

    def add(self, number: int, arguments: Mapping[str, Term]) -> None:
        self._members.append(number)

    def remove(self, number: int) -> None:
        self._members.remove(number)

    def result(self, end: int, *, reports: bool) -> Common | None:
        found: WindowResult = self._solve(end)
        if self._difference is not None:
            found = self._difference.of(found)
            if not reports and not found.size:
                return None
        return Common(np.array(self._members, np.int64), found)

    def without_increment(self) -> Alone:
        """The same, computed from the rows of each window."""
        self._incremental = None
        return self


class Together(Reader):
    """Instances that agree on the fixed parameters: the plan is computed once, then joined with
    the table of their other arguments.

    Cost a window: that of the plan, then `InstanceTable.join`, then numpy a column on what that
    gives. A window that columns cannot judge is evaluated for each instance alone.
    """

    def __init__(
        self,
        owner: ContinuousEvaluator,
        query: ContinuousQuery,
        joint: Joint,
        fixed: Mapping[str, Term],
    ) -> None:
        self.joint = joint
        self.fixed = fixed
        self._alone: dict[int, Alone] = {}
        super().__init__(owner, query)
        self.table = InstanceTable(joint, self._terms)

    def _plan_for(self, query: ContinuousQuery) -> None:
        self._choose(self.joint.plan)

    def explain(self, flows: Mapping[str, Flow] | None = None) -> str:
        """The shared plan, how it is computed, and what is done to what the join gives."""
        lines = describe_query(Query(self.joint.head, self.joint.plan))
        if self._incremental is None:
            lines.append(f"in columns, each window anew: {self._no_increment}")
        else:
            lines.append("in columns, incrementally")
        lines += [f"then {describe(step)[0]}" for step in self.joint.rest]
        return "\n".join(lines)

    @property
    def live(self) -> int:
        return self.table.live

    def add(self, number: int, arguments: Mapping[str, Term]) -> None:
        self.table.add(number, arguments)

    def remove(self, number: int) -> None:
        self.table.remove(number)

    def result(self, end: int, *, reports: bool) -> Joined | tuple[Common, ...]:
        numbers, alive = self.table.members()
        start, shown = self._span(end)
        contents = _Windows(self._contents, end)
        attempts: dict[Incremental | None, None] = dict.fromkeys((self._incremental, None))
        for incremental in attempts:
            source = _Source(
                contents, self._static, self.options, self.schedule.named, incremental, None
            )
            try:
                relation = self._solutions(execute(self.joint.plan, source, self._terms))
            except NeedsOxigraph:
                continue
            self._alone = {}
            return Joined(start, shown, self.joint.head, relation, numbers, alive, self._terms)
        return self._each(end)

    def _solutions(self, relation: Relation) -> Relation:
        relation, decided = self.table.join(relation)
        rest = self.joint.rest[1:] if decided else self.joint.rest
        for step in rest:
            relation = self._step(step, relation)
        return relation

    def _step(self, step: Step, relation: Relation) -> Relation:
        columns, terms = relation.columns, self._terms
        match step:
            case Filter(condition):
                return relation.take(holds(condition, columns, relation.rows, terms))
            case Extend(variable, expression):
                if variable in columns:
                    raise NeedsOxigraph(f"?{variable} is bound twice")
                value = evaluate(expression, columns, relation.rows, terms)
                return Relation({**columns, variable: value}, relation.rows, relation.key)
            case Project(variables):
                # Parameters are known everywhere in a template.
                own = (*self.joint.joined, *self.joint.compared, INSTANCE)
                kept = {name: relation.column(name) for name in variables}
                kept |= {name: columns[name] for name in own if name in columns}
                key = relation.key
                key = key if key is not None and key <= kept.keys() else None
                return Relation(kept, relation.rows, key)
            case Distinct():
                return relation if relation.key is not None else distinct(relation, terms)

    def _each(self, end: int) -> tuple[Common, ...]:
        """Every instance alone. Cost: a plan each, and an evaluation each."""
        numbers, alive = self.table.members()
        found = []
        for row in np.flatnonzero(alive).tolist():
            number = int(numbers[row])
            if number not in self._alone:
                arguments = dict(self.fixed)
                for name, column in self.table.columns.items():
                    arguments[name] = column.term(row)
                bound = {Variable(name): term for name, term in arguments.items()}
                alone = Alone(self._owner, bind(self.query, bound)).without_increment()
                alone.add(number, arguments)
                self._alone[number] = alone
            result = self._alone[number].result(end, reports=True)
            assert result is not None
            found.append(result)
        return tuple(found)


def joint_of(
    owner: ContinuousEvaluator,
    query: ContinuousQuery,
    arguments: Mapping[str, Term],
    fixed: tuple[str, ...] = (),
) -> tuple[Joint | None, dict[str, str]]:
    """How instances that agree with ``arguments`` on the fixed parameters are computed together:
    these are ``fixed`` and those that the reasons name. None where nothing is left to share."""
    reasons = dict.fromkeys(fixed, "")
    if query.operator is not StreamOperator.RSTREAM:
        why = f"{query.operator} compares the results of an instance"
        return None, dict.fromkeys(arguments, why)
    bound = _with_rows_only(bind(query, {Variable(n): term for n, term in arguments.items()}))
    tree = algebra(bound).algebra
    before = {variable.value: term for variable, term in query.bindings.items()}
    shape = query_shape(query.sparql)
    every = shape is not None and shape.selects_all
    graphs = Graphs(owner.schedule.named, query.static_named, query.window_variables)
    for name in arguments.keys() & _graph_names(tree):
        reasons[name] = f"?{name} is a graph"
    try:
        head = translate(tree, {**before, **arguments}, graphs, selects_all=every).head
        while True:
            names = [name for name in arguments if name not in reasons]
            if not names:
                return None, reasons
            given = before | {name: arguments[name] for name in reasons}
            found = translate(tree, given, graphs, selects_all=every)
            shown = head if isinstance(head, Select) else found.head
            plan, _ = optimize(found.plan)
            try:
                return joint(Query(shown, plan), names), reasons
            except Unfit as unfit:
                reasons |= {name: str(unfit) for name in names if unfit.name in (name, "")}
    except (Unsupported, ValueError) as unsupported:
        return None, dict.fromkeys(arguments, str(unsupported))


def _graph_names(tree: Any) -> frozenset[str]:
    """The variables after GRAPH or WINDOW in rdflib's algebra."""
    if isinstance(tree, dict):
        own = {str(tree.get("term"))} if getattr(tree, "name", "") == "Graph" else set()
        return frozenset(own).union(*(map(_graph_names, tree.values())))
    if isinstance(tree, list | tuple):
        return frozenset().union(*map(_graph_names, tree))
    return frozenset()
