"""From rdflib's algebra to the logical plan, template arguments in their places.

What the plan has no word for raises `Unsupported` with the reason: the query is then evaluated by
Oxigraph, and `explain` says why.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from typing import Any

from pyoxigraph import Literal, NamedNode
from rdflib.plugins.sparql.algebra import translateGroupGraphPattern
from rdflib.plugins.sparql.parserutils import CompValue
from rdflib.term import BNode, URIRef, Variable
from rdflib.term import Literal as RdflibLiteral

from ..rdf.dictionary import Term
from ..rdf.namespaces import RDF_TYPE
from .columns import canonical
from .expressions import Const, Expression, Var
from .logical import (
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
    outputs,
)
from .paths import path_plan
from .timestamps import with_times
from .translate_expressions import ExpressionTranslation
from .unsupported import Unsupported


@dataclass(frozen=True, slots=True)
class Graphs:
    """What GRAPH may name: windows and static graphs, by IRI. ``window_variables``: the variables
    that stand for windows (``WINDOW ?w``); any other stands for static graphs."""

    windows: tuple[str, ...] = ()
    static: tuple[str, ...] = ()
    window_variables: frozenset[str] = frozenset()


def translate(
    query: CompValue,
    bindings: Mapping[str, Term],
    graphs: Graphs | None = None,
    *,
    selects_all: bool = False,
) -> Query:
    """The logical plan of rdflib's ``query``, ``bindings`` put in their variables' places.

    ``selects_all``: the head is ``*`` (rdflib lists variables of EXISTS there, SPARQL does not).
    Raises ``ValueError`` for an accessor of times that no pattern fits.
    """
    return _Translation(bindings, graphs or Graphs(), selects_all).query(query)


class _Translation:
    def __init__(self, bindings: Mapping[str, Term], graphs: Graphs, selects_all: bool) -> None:
        self.bindings = {name: canonical(term) for name, term in bindings.items()}
        self.graphs = graphs
        self.selects_all = selects_all
        self.graph = DEFAULT
        self.hidden = 0
        self.expressions = ExpressionTranslation(self._term, self.exists)
        self.waiting: list[tuple[str, Plan]] = []
        """EXISTS of the expression that is being translated: its mark and its pattern."""

    def query(self, query: CompValue) -> Query:
        body = query.p
        if query.name != "SelectQuery":
            # CONSTRUCT and ASK show no variables: rdflib's projection is of all.
            body = _without_projection(body)
            head = self._template_head(query, body)
            return Query(head, with_times(self.plan(body)))
        plan = self.plan(body)
        names = tuple(str(name) for name in query.PV)
        if self.selects_all:
            known = outputs(_without_top(plan))
            names = tuple(name for name in names if name in known)
        if not isinstance(plan, Project | Distinct | Slice):
            plan = self._shown(names, plan)
        return Query(Select(names), with_times(plan))

    def _template_head(self, query: CompValue, body: CompValue) -> Head:
        match query.name:
            case "ConstructQuery":
                template = query.template
                if template is None:
                    # CONSTRUCT WHERE: the pattern is the template too (SPARQL 1.1 §16.2.4).
                    if body.name != "BGP":
                        raise Unsupported(f"CONSTRUCT WHERE with {body.name}")
                    template = body.triples
                return Construct(self._template(template))
            case "AskQuery":
                return Ask()
            case name:
                raise Unsupported(f"the form {name.removesuffix('Query').upper()}")

    # -- graph patterns --------------------------------------------------------------------

    def plan(self, node: Any) -> Plan:
        match node.name:
            case "BGP":
                return self._basic(node.triples)
            case "Join":
                return Join((self.plan(node.p1), self.plan(node.p2)))
            case "LeftJoin":
                return self._optional(node)
            case "Union":
                return Union((self.plan(node.p1), self.plan(node.p2)))
            case "Minus":
                return Minus(self.plan(node.p1), self.plan(node.p2))
            case "Graph":
                return self._graph(node)
            case "ToMultiSet":
                return self._values(node.p) if node.p.name == "values" else self.plan(node.p)
            case "Filter" | "Extend":
                return self._extend(node)
            case "AggregateJoin":
                return self._aggregate(node)[0]
            case "Project":
                names = tuple(str(name) for name in node.PV)
                return self._shown(names, self.plan(node.p))
            case "Distinct" | "Reduced":
                return Distinct(self.plan(node.p))
            case "OrderBy":
                return self._order(node)
            case "Slice":
                return Slice(int(node.start or 0), _length(node), self.plan(node.p))
            case "ServiceGraphPattern":
                raise Unsupported("SERVICE")
            case name:
                raise Unsupported(name)

    def _shown(self, names: tuple[str, ...], plan: Plan) -> Plan:
        """A bound parameter that is to be seen becomes a column again."""
        for name in names:
            if name in self.bindings:
                plan = Extend(name, Const(self.bindings[name]), plan)
        return Project(names, plan)

    def _basic(self, triples: Sequence[Any]) -> Plan:
        parts: list[Plan] = []
        for s, p, o in triples:
            subject, object = self._position(s), self._position(o)
            if isinstance(p, Variable | URIRef):
                parts.append(self.pattern(subject, self._term(p), object))
            else:
                parts.append(path_plan(p, subject, object, self.pattern, self.fresh, self.graph))
        return Join(tuple(parts))

    def pattern(self, subject: Position, predicate: Position, object: Position) -> Plan:
        """A triple pattern in the graph that is being translated."""
        if isinstance(predicate, Var):
            return AnyScan(subject, predicate, object, self.graph)
        if not isinstance(predicate.term, NamedNode):
            # A parameter that is given a literal: no triple has such a predicate.
            names = outputs(Scan(subject, RDF_TYPE, object))
            return Values(tuple(sorted(names)), ())
        if predicate.term == RDF_TYPE:
            return TypeScan(subject, object, self.graph)
        return Scan(subject, predicate.term, object, self.graph)

    def fresh(self) -> str:
        """A variable that no text can name."""
        self.hidden += 1
        return f"\0{self.hidden}"

    def _position(self, term: Any) -> Position:
        return Var(f"_:{term}") if isinstance(term, BNode) else self._term(term)

    def _term(self, term: Any) -> Position:
        """A variable (or the parameter given for it) or a constant of the text."""
        if isinstance(term, Variable):
            bound = self.bindings.get(str(term))
            return Var(str(term)) if bound is None else Const(bound)
        if isinstance(term, URIRef):
            return Const(NamedNode(str(term)))
        if not isinstance(term, RdflibLiteral):
            raise Unsupported(f"the term {term}")
        if term.language is not None:
            return Const(Literal(str(term), language=term.language))
        datatype = None if term.datatype is None else NamedNode(str(term.datatype))
        return Const(canonical(Literal(str(term), datatype=datatype)))

    def _optional(self, node: Any) -> Plan:
        child, optional = self.plan(node.p1), self.plan(node.p2)
        condition = None
        if not (isinstance(node.expr, CompValue) and node.expr.name == "TrueFilter"):
            condition = self.expression(node.expr)
            if self.waiting:
                raise Unsupported("EXISTS in a condition of OPTIONAL")
        return LeftJoin(child, optional, condition)

    def _graph(self, node: Any) -> Plan:
        place = self._term(node.term)
        if isinstance(place, Const):
            value = place.term.value if isinstance(place.term, NamedNode) else ""
            return self._in_graph(value, node.p)
        windows = place.name in self.graphs.window_variables
        parts = [
            Join((Values((place.name,), ((NamedNode(name),),)), self._in_graph(name, node.p)))
            for name in (self.graphs.windows if windows else self.graphs.static)
        ]
        return Union(tuple(parts)) if parts else self._in_graph("", node.p)

    def _in_graph(self, name: str, node: Any) -> Plan:
        before, self.graph = self.graph, name
        plan = self.plan(node)
        self.graph = before
        if name not in self.graphs.windows and name not in self.graphs.static:
            return Values(tuple(sorted(outputs(plan))), ())
        return plan

    def _values(self, node: Any) -> Plan:
        rows = node.res
        names = tuple(dict.fromkeys(str(name) for row in rows for name in row))
        if any(name in self.bindings for name in names):
            raise Unsupported("VALUES for a parameter")
        table = []
        for row in rows:
            given = {str(name): term for name, term in row.items()}
            cells: list[Term | None] = []
            for name in names:
                term = given.get(name)
                constant = None if term is None or term == "UNDEF" else self._term(term)
                cells.append(constant.term if isinstance(constant, Const) else None)
            table.append(tuple(cells))
        return Values(names, tuple(table))

    # -- what stands on a pattern ----------------------------------------------------------

    def expression(self, node: Any, renamed: Mapping[str, str] | None = None) -> Expression:
        return self.expressions.of(node, self._renamed(renamed or {}))

    def _renamed(self, renamed: Mapping[str, str]) -> Mapping[str, Expression]:
        return {
            name: Const(self.bindings[to]) if to in self.bindings else Var(to)
            for name, to in renamed.items()
        }

    def exists(self, graph: Any) -> Expression:
        """EXISTS as a variable, which whoever takes the expression has to bind (`marked`)."""
        if graph.name == "GroupGraphPatternSub":
            # rdflib translates in place, and the tree is shared.
            graph = translateGroupGraphPattern(deepcopy(graph))
        waiting, self.waiting = self.waiting, []
        pattern = self.plan(graph)
        mark = self.fresh()
        self.waiting = [*waiting, (mark, pattern)]
        return Var(mark)

    def marked(self, plan: Plan) -> Plan:
        """``plan`` with the marks of the expression that was just translated."""
        waiting, self.waiting = self.waiting, []
        for mark, pattern in waiting:
            plan = Exists(mark, pattern, plan)
        return plan

    def _extend(self, node: Any) -> Plan:
        """A chain of Extends and Filters, down to an aggregate whose keys rdflib renamed."""
        chain = []
        while node.name in ("Extend", "Filter"):
            chain.append(node)
            node = node.p
        renamed: dict[str, str] = {}
        if node.name == "AggregateJoin":
            plan, renamed = self._aggregate(node)
        else:
            plan = self.plan(node)
        for one in reversed(chain):
            expression = self.expression(one.expr, renamed)
            plan = self.marked(plan)
            if one.name == "Filter":
                plan = Filter(expression, plan)
                continue
            variable = str(one.var)
            if variable in self.bindings:
                if isinstance(expression, Const):
                    continue
                raise Unsupported("an expression bound to a parameter")
            if expression != Var(variable):
                plan = Extend(variable, expression, plan)
        return plan

    def _aggregate(self, node: Any) -> tuple[Plan, dict[str, str]]:
        """The aggregate, and the variables by which rdflib names its keys and what is there twice:
        name -> the one variable."""
        child, keys = self._keys(node.p)
        renamed: dict[str, str] = {}
        aggregations = []
        named: dict[tuple[object, ...], str] = {}
        for one in node.A:
            function, name = one.name.removeprefix("Aggregate_").upper(), str(one.res)
            function = "GROUP_CONCAT" if function == "GROUPCONCAT" else function
            if function == "SAMPLE" and str(one.vars) in keys:
                # rdflib reads a group key through SAMPLE; it is the key itself.
                renamed[name] = str(one.vars)
                continue
            argument = None if one.vars == "*" else self.expression(one.vars)
            child = self.marked(child)
            separator = str(one.separator) if one.separator is not None else " "
            made = Aggregation(name, function, argument, bool(one.distinct), separator)
            # Written twice (in the head and in HAVING), it is one.
            first = named.setdefault((function, argument, made.distinct, separator), name)
            if first == name:
                aggregations.append(made)
            else:
                renamed[name] = first
        free = tuple(key for key in keys if key not in self.bindings)
        return Aggregate(free, tuple(aggregations), child, implicit=not keys), renamed

    def _keys(self, group: Any) -> tuple[Plan, list[str]]:
        """What is grouped, and the names of the keys; rdflib binds an expression without a name
        to None."""
        node = group.p
        unnamed: list[Any] = []
        while node.name == "Extend" and node.var is None:
            unnamed.append(node.expr)
            node = node.p
        child = self.plan(node)
        keys: list[str] = []
        for key in group.expr or ():
            if isinstance(key, Variable):
                keys.append(str(key))
                continue
            if key is not None or not unnamed:
                raise Unsupported("GROUP BY an expression between named ones")
            name = self.fresh()
            expression = self.expression(unnamed.pop())
            child = Extend(name, expression, self.marked(child))
            keys.append(name)
        return child, keys

    def _order(self, node: Any) -> Plan:
        child = self.plan(node.p)
        keys = []
        for one in node.expr:
            keys.append((self.expression(one.expr), one.order == "DESC"))
            child = self.marked(child)
        return Order(tuple(keys), child)

    def _template(
        self, triples: Any
    ) -> tuple[tuple[TemplatePosition, TemplatePosition, TemplatePosition], ...]:
        labels: dict[str, str] = {}

        def place(term: Any) -> TemplatePosition:
            if isinstance(term, BNode):
                # rdflib names those of `[]` at random.
                return Blank(labels.setdefault(str(term), f"b{len(labels)}"))
            return self._term(term)

        return tuple((place(s), place(p), place(o)) for s, p, o in triples)


def _length(node: Any) -> int | None:
    # `get` of rdflib gives back the name of what is not there.
    return int(node.length) if "length" in node and node.length is not None else None


def _without_projection(node: Any) -> Any:
    """The body of a CONSTRUCT or ASK under rdflib's projection, LIMIT and OFFSET kept."""
    if node.name == "Project":
        return node.p
    if node.name == "Slice":
        inner = _without_projection(node.p)
        changed = CompValue("Slice", **node)
        changed["p"] = inner
        return changed
    return node


def _without_top(plan: Plan) -> Plan:
    """What the projection of the head projects."""
    while isinstance(plan, Slice | Distinct):
        plan = plan.child
    return plan.child if isinstance(plan, Project) else plan
