"""Translates the tree of a query to the logical plan (SPARQL 1.1 §18.2), with template arguments in
their places.

A part that plans cannot express raises `Unsupported` with the reason. Oxigraph then evaluates the
query, and `explain` shows the reason.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ...rdf.dictionary import Term
from ...rdf.namespaces import RDF_TYPE
from ...sparql import ast
from ...sparql.algebra import split_group
from ...sparql.scope import projected_variables, visible_variables
from ..values.literals import canonical
from .expressions import Const, Expression, Var
from .expressions_from_sparql import ExpressionTranslation
from .plan import (
    DEFAULT,
    Aggregate,
    Aggregation,
    AnyScan,
    Ask,
    Blank,
    Construct,
    Distinct,
    Exists,
    Extend,
    Filter,
    Head,
    Join,
    LeftJoin,
    Minus,
    Order,
    Plan,
    Position,
    Project,
    Query,
    Scan,
    Select,
    Slice,
    TemplatePosition,
    TypeScan,
    Union,
    Values,
    certain,
    named_variables,
    outputs,
)
from .property_paths import path_plan
from .triple_times import with_times
from .unsupported import Unsupported


@dataclass(frozen=True, slots=True)
class Graphs:
    """The graphs that GRAPH may name: windows and static graphs, by IRI. ``window_variables``: the
    variables that mean windows (``WINDOW ?w``); any other variable means static graphs."""

    windows: tuple[str, ...] = ()
    static: tuple[str, ...] = ()
    window_variables: frozenset[str] = frozenset()


def translate(
    query: ast.Query, bindings: Mapping[str, Term], graphs: Graphs | None = None
) -> Query:
    """Return the logical plan of ``query``, with ``bindings`` in place of their variables.

    Raises ``ValueError`` for an accessor of times that matches no pattern.
    """
    return _Translation(bindings, graphs or Graphs()).query(query)


class _Translation:
    def __init__(self, bindings: Mapping[str, Term], graphs: Graphs) -> None:
        self.bindings = {name: canonical(term) for name, term in bindings.items()}
        self.graphs = graphs
        self.graph = DEFAULT
        self.hidden = 0
        self.expressions = ExpressionTranslation(self._term, self.exists)
        self.waiting: list[tuple[str, Plan]] = []
        """The EXISTS of the expression being translated: marks and patterns."""

    def query(self, query: ast.Query) -> Query:
        if query.form is ast.Form.DESCRIBE:
            raise Unsupported("the form DESCRIBE")
        self.expressions.base = query.base
        plan = self.solutions(query)
        if query.form is ast.Form.SELECT:
            return Query(Select(projected_variables(query)), with_times(plan))
        # CONSTRUCT and ASK show no variables.
        head: Head = Ask()
        if query.form is ast.Form.CONSTRUCT:
            head = Construct(self._template(query.template or ()))
        return Query(head, with_times(plan))

    # -- queries ---------------------------------------------------------------------------

    def solutions(self, query: ast.Query) -> Plan:
        """Translate a query with its solution modifiers (§18.2.4, §18.2.5)."""
        assert query.where is not None, "only DESCRIBE has no WHERE"
        plan, expressions = self._grouped(query, self.group(query.where))
        for condition in query.having:
            plan = self._filtered(expressions.get(condition, condition), plan)
        if query.values is not None:
            plan = Join((plan, self._values(query.values)))
        for one in query.projection or ():
            if one.expression is not None:
                expression = expressions.get(one.expression, one.expression)
                plan = self._extended(one.variable.value, expression, plan)
        if query.order:
            keys = []
            for order in query.order:
                expression = expressions.get(order.expression, order.expression)
                keys.append((self.expression(expression), order.descending))
                plan = self.marked(plan)
            plan = Order(tuple(keys), plan)
        if query.form is ast.Form.SELECT:
            plan = self._shown(projected_variables(query), plan)
        if query.modifier:
            plan = Distinct(plan)
        if query.limit is not None or query.offset is not None:
            plan = Slice(query.offset or 0, query.limit, plan)
        return plan

    def _grouped(
        self, query: ast.Query, plan: Plan
    ) -> tuple[Plan, dict[ast.Expression, ast.Expression]]:
        """Return the groups of an aggregating query (§18.2.4.1), and its expressions over them with
        a variable for each aggregate. Equal aggregates share a variable."""
        if not query.is_aggregated:
            return plan, {}
        keys: list[str] = []
        for key in query.keys:
            if isinstance(key.expression, Variable) and key.alias is None:
                keys.append(key.expression.value)
                continue
            name = self.fresh() if key.alias is None else key.alias.value
            plan = self._extended(name, key.expression, plan)
            keys.append(name)
        written = [one.expression for one in query.projection or () if one.expression is not None]
        written += [*query.having, *(order.expression for order in query.order)]
        named: dict[ast.Aggregate, Variable] = {}
        assert query.where is not None, "only DESCRIBE has no WHERE"
        sampled = visible_variables(query.where).keys() - set(keys)

        def over_groups(expression: ast.Expression) -> ast.Expression:
            def change(node: object) -> object:
                if isinstance(node, ast.Exists):
                    return node
                # Beside aggregates a variable that is no key is any value of its group (§18.2.4).
                if isinstance(node, Variable) and node.value in sampled:
                    node = ast.Aggregate("SAMPLE", node)
                if isinstance(node, ast.Aggregate):
                    return named.setdefault(node, Variable(f"__agg_{len(named) + 1}__"))
                return None

            return ast.rewrite(expression, change)

        expressions = {expression: over_groups(expression) for expression in written}
        aggregations = []
        for one, variable in named.items():
            argument = None if one.argument is None else self.expression(one.argument)
            plan = self.marked(plan)
            separator = " " if one.separator is None else one.separator
            aggregations.append(
                Aggregation(variable.value, one.function, argument, one.distinct, separator)
            )
        # A bound parameter is constant, but still a key: without rows there is no group.
        free = tuple(key for key in keys if key not in self.bindings)
        return Aggregate(free, tuple(aggregations), plan, implicit=not keys), expressions

    def _shown(self, names: tuple[str, ...], plan: Plan) -> Plan:
        """Project to ``names``. A bound parameter among them becomes a column again."""
        for name in names:
            if name in self.bindings:
                plan = Extend(name, Const(self.bindings[name]), plan)
        return Project(names, plan)

    # -- graph patterns --------------------------------------------------------------------

    def group(self, group: ast.Group) -> Plan:
        """Translate a group graph pattern (§18.2.2)."""
        plan, conditions = self._unfiltered(group)
        return self._filtered_by(conditions, plan)

    def _unfiltered(self, group: ast.Group) -> tuple[Plan, list[ast.Expression]]:
        """Return a group without its filters, and these."""
        parts, conditions = split_group(group)
        plan: Plan | None = None
        for part in parts:
            before = Join(()) if plan is None else plan
            match part:
                case ast.Optional(inner):
                    plan = self._optional(before, inner)
                case ast.Minus(inner):
                    plan = Minus(before, self.group(inner))
                case ast.Bind(expression, variable):
                    plan = self._extended(variable.value, expression, before)
                case _:
                    found = self._part(part)
                    plan = found if plan is None else Join((plan, found))
        return Join(()) if plan is None else plan, conditions

    def _part(self, part: ast.Element) -> Plan:
        match part:
            case ast.Triples(triples):
                return self._basic(triples)
            case ast.Group():
                return self.group(part)
            case ast.Union(groups):
                plan = self.group(groups[0])
                for group in groups[1:]:
                    plan = Union((plan, self.group(group)))
                return plan
            case ast.Graph(name, group):
                return self._graph(name, group)
            case ast.Values():
                return self._values(part)
            case ast.SubSelect(query):
                return self.solutions(query)
        raise AssertionError(f"{type(part).__name__} stands in no group")

    def _basic(self, triples: Sequence[ast.Triple]) -> Plan:
        parts: list[Plan] = []
        for triple in triples:
            subject, object = self._position(triple.subject), self._position(triple.object)
            predicate = triple.predicate
            if isinstance(predicate, Variable | NamedNode):
                parts.append(self.pattern(subject, self._term(predicate), object))
                continue
            graph = self.graph
            parts.append(path_plan(predicate, subject, object, self.pattern, self.fresh, graph))
        return Join(tuple(parts))

    def pattern(self, subject: Position, predicate: Position, object: Position) -> Plan:
        """Translate a triple pattern in the present graph."""
        if isinstance(predicate, Var):
            return AnyScan(subject, predicate, object, self.graph)
        if not isinstance(predicate.term, NamedNode):
            # A parameter bound to a literal: no triple has such a predicate.
            names = outputs(Scan(subject, RDF_TYPE, object))
            return Values(tuple(sorted(names)), ())
        if predicate.term == RDF_TYPE:
            return TypeScan(subject, object, self.graph)
        return Scan(subject, predicate.term, object, self.graph)

    def fresh(self) -> str:
        """Return a variable that no text can contain."""
        self.hidden += 1
        return f"\0{self.hidden}"

    def _position(self, term: ast.Place) -> Position:
        # A blank node of a pattern is a variable that no result can show.
        return Var(f"_:{term.value}") if isinstance(term, BlankNode) else self._term(term)

    def _term(self, term: Variable | NamedNode | Literal) -> Position:
        """Return a variable, or the constant that it is bound to, or a constant of the text."""
        if isinstance(term, Variable):
            bound = self.bindings.get(term.value)
            return Var(term.value) if bound is None else Const(bound)
        return Const(canonical(term) if isinstance(term, Literal) else term)

    def _optional(self, child: Plan, group: ast.Group) -> Plan:
        """Translate OPTIONAL; the filters of its group apply to both sides."""
        optional, conditions = self._unfiltered(group)
        condition = None
        if conditions:
            condition = self.expression(_all_of(conditions))
            outer = outputs(child) - certain(optional)
            if any(named_variables(pattern) & outer for _, pattern in self.waiting):
                raise Unsupported("EXISTS over outer variables in a condition of OPTIONAL")
            # What it asks about is bound here: so it holds of the optional side alone.
            optional = self.marked(optional)
        return LeftJoin(child, optional, condition)

    def _graph(self, name: NamedNode | Variable, group: ast.Group) -> Plan:
        place = self._term(name)
        if isinstance(place, Const):
            # A literal names no graph, and neither does the empty name.
            value = place.term.value if isinstance(place.term, NamedNode) else ""
            return self._in_graph(value, group)
        windows = place.name in self.graphs.window_variables
        parts = [
            Join((Values((place.name,), ((NamedNode(iri),),)), self._in_graph(iri, group)))
            for iri in (self.graphs.windows if windows else self.graphs.static)
        ]
        # Without a graph there is no solution, but the names of the group stay in scope.
        return Union(tuple(parts)) if parts else self._in_graph("", group)

    def _in_graph(self, name: str, group: ast.Group) -> Plan:
        before, self.graph = self.graph, name
        plan = self.group(group)
        self.graph = before
        # The group was translated all the same, since its names are known only then.
        if name not in self.graphs.windows and name not in self.graphs.static:
            return Values(tuple(sorted(outputs(plan))), ())
        return plan

    def _values(self, values: ast.Values) -> Plan:
        names = tuple(variable.value for variable in values.variables)
        if any(name in self.bindings for name in names):
            raise Unsupported("VALUES for a parameter")
        return Values(
            names,
            tuple(
                tuple(canonical(t) if isinstance(t, Literal) else t for t in row)
                for row in values.rows
            ),
        )

    # -- expressions -----------------------------------------------------------------------

    def expression(self, node: ast.Expression) -> Expression:
        return self.expressions.of(node)

    def exists(self, group: ast.Group) -> Expression:
        """Translate EXISTS to a variable; the caller must bind it by `marked`."""
        # Expressions of the pattern bind their own EXISTS, which must not take those of this one.
        waiting, self.waiting = self.waiting, []
        pattern = self.group(group)
        mark = self.fresh()
        self.waiting = [*waiting, (mark, pattern)]
        return Var(mark)

    def marked(self, plan: Plan) -> Plan:
        """Bind the marks of the last translated expression on top of ``plan``."""
        waiting, self.waiting = self.waiting, []
        for mark, pattern in waiting:
            plan = Exists(mark, pattern, plan)
        return plan

    def _filtered_by(self, conditions: Sequence[ast.Expression], plan: Plan) -> Plan:
        return self._filtered(_all_of(conditions), plan) if conditions else plan

    def _filtered(self, condition: ast.Expression, plan: Plan) -> Plan:
        expression = self.expression(condition)
        return Filter(expression, self.marked(plan))

    def _extended(self, name: str, node: ast.Expression, plan: Plan) -> Plan:
        expression = self.expression(node)
        plan = self.marked(plan)
        if name in self.bindings:
            if isinstance(expression, Const):
                return plan
            raise Unsupported("an expression bound to a parameter")
        return plan if expression == Var(name) else Extend(name, expression, plan)

    def _template(
        self, triples: Sequence[ast.Triple]
    ) -> tuple[tuple[TemplatePosition, TemplatePosition, TemplatePosition], ...]:
        labels: dict[str, str] = {}

        def place(term: ast.Place) -> TemplatePosition:
            if isinstance(term, BlankNode):
                return Blank(labels.setdefault(term.value, f"b{len(labels)}"))
            return self._term(term)

        found = []
        for triple in triples:
            assert isinstance(triple.predicate, NamedNode | Variable), "a template has no paths"
            found.append((place(triple.subject), place(triple.predicate), place(triple.object)))
        return tuple(found)


def _all_of(conditions: Sequence[ast.Expression]) -> ast.Expression:
    return conditions[0] if len(conditions) == 1 else ast.Logical("&&", tuple(conditions))
