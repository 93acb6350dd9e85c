"""From rdflib's algebra to the logical plan, template arguments in their places.

What the plan has no word for raises `Unsupported` with the reason: the query is then evaluated by
Oxigraph, and `explain` says why.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pyoxigraph import Literal, NamedNode
from rdflib.plugins.sparql.parserutils import CompValue
from rdflib.term import BNode, URIRef, Variable
from rdflib.term import Literal as RdflibLiteral

from ..rdf.dictionary import Term
from ..rdf.namespaces import RDF_TYPE
from .columns import canonical
from .expressions import Call, Const, Expression, Var
from .logical import (
    Aggregate,
    Aggregation,
    Ask,
    Construct,
    Distinct,
    Extend,
    Filter,
    Head,
    Join,
    Plan,
    Position,
    Project,
    Query,
    Scan,
    Select,
    TypeScan,
    Values,
)


class Unsupported(Exception):
    """A part of SPARQL that goes to Oxigraph; the message names it."""


_BUILTINS = {
    "ABS": "ABS",
    "CEIL": "CEIL",
    "FLOOR": "FLOOR",
    "ROUND": "ROUND",
    "isIRI": "ISIRI",
    "isURI": "ISIRI",
    "isBLANK": "ISBLANK",
    "isLITERAL": "ISLITERAL",
    "isNUMERIC": "ISNUMERIC",
    "BOUND": "BOUND",
}


def translate(query: CompValue, bindings: Mapping[str, Term]) -> Query:
    """The logical plan of rdflib's ``query``, ``bindings`` put in their variables' places."""
    return _Translation(bindings).query(query)


class _Translation:
    def __init__(self, bindings: Mapping[str, Term]) -> None:
        self.bindings = {name: canonical(term) for name, term in bindings.items()}

    def query(self, query: CompValue) -> Query:
        head: Head
        body = query.p
        match query.name:
            case "SelectQuery":
                head = Select(tuple(str(name) for name in query.PV))
                if isinstance(body, CompValue) and body.name not in ("Distinct", "Reduced"):
                    body = body.p if body.name == "Project" else body
                    return Query(head, self._shown(head.variables, self.plan(body)))
                return Query(head, self.plan(body))
            case "ConstructQuery":
                head = Construct(self._template(query.template))
                body = body.p if body.name == "Project" else body
            case "AskQuery":
                head = Ask()
                body = body.p if body.name == "Project" else body
            case name:
                raise Unsupported(f"the form {name}")
        return Query(head, self.plan(body))

    def plan(self, node: Any) -> Plan:
        match node.name:
            case "BGP":
                return Join(tuple(self._pattern(*triple) for triple in node.triples))
            case "Join":
                return Join((self.plan(node.p1), self.plan(node.p2)))
            case "ToMultiSet":
                return self._values(node.p) if node.p.name == "values" else self.plan(node.p)
            case "Filter" | "Extend":
                return self._extend(node)
            case "AggregateJoin":
                return self._aggregate(node, {})[0]
            case "Project":
                names = tuple(str(name) for name in node.PV)
                return Project(names, self._shown(names, self.plan(node.p)))
            case "Distinct" | "Reduced":
                return Distinct(self.plan(node.p))
            case name:
                raise Unsupported(_PART.get(name, name))

    def _shown(self, names: tuple[str, ...], plan: Plan) -> Plan:
        """A bound parameter that is to be seen becomes a column again."""
        for name in names:
            if name in self.bindings:
                plan = Extend(name, Const(self.bindings[name]), plan)
        return Project(names, plan)

    def _pattern(self, s: Any, p: Any, o: Any) -> Plan:
        predicate = self._position(p)
        if not (isinstance(predicate, Const) and isinstance(predicate.term, NamedNode)):
            raise Unsupported("a predicate that is no IRI (a variable or a path)")
        subject, object = self._position(s), self._position(o)
        if predicate.term == RDF_TYPE:
            return TypeScan(subject, object)
        return Scan(subject, predicate.term, object)

    def _position(self, term: Any) -> Position:
        if isinstance(term, BNode):
            return Var(f"_:{term}")
        if not isinstance(term, Variable | URIRef | RdflibLiteral):
            raise Unsupported("a property path")
        return self._term(term)

    def _term(self, term: Any) -> Position:
        if isinstance(term, Variable):
            bound = self.bindings.get(str(term))
            return Var(str(term)) if bound is None else Const(bound)
        if isinstance(term, URIRef):
            return Const(NamedNode(str(term)))
        if term.language is not None:
            return Const(Literal(str(term), language=term.language))
        datatype = None if term.datatype is None else NamedNode(str(term.datatype))
        return Const(canonical(Literal(str(term), datatype=datatype)))

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
                if term is None or term == "UNDEF":
                    raise Unsupported("UNDEF in VALUES")
                constant = self._term(term)
                assert isinstance(constant, Const)
                cells.append(constant.term)
            table.append(tuple(cells))
        return Values(names, tuple(table))

    def _extend(self, node: Any) -> Plan:
        """A chain of Extends and Filters, down to an aggregate whose keys rdflib renamed."""
        chain = []
        while node.name in ("Extend", "Filter"):
            chain.append(node)
            node = node.p
        renamed: dict[str, str] = {}
        if node.name == "AggregateJoin":
            plan, renamed = self._aggregate(node, renamed)
        else:
            plan = self.plan(node)
        for one in reversed(chain):
            if one.name == "Filter":
                plan = Filter(self.expression(one.expr, renamed), plan)
                continue
            variable = str(one.var)
            expression = self.expression(one.expr, renamed)
            if variable in self.bindings:
                if isinstance(expression, Const):
                    continue
                raise Unsupported("an expression bound to a parameter")
            if expression != Var(variable):
                plan = Extend(variable, expression, plan)
        return plan

    def _aggregate(self, node: Any, renamed: dict[str, str]) -> tuple[Plan, dict[str, str]]:
        group = node.p
        keys: list[str] = []
        for key in group.expr or ():
            if not isinstance(key, Variable):
                raise Unsupported("GROUP BY an expression")
            keys.append(str(key))
        aggregations = []
        named: dict[tuple[str, Expression | None], str] = {}
        for one in node.A:
            function, name = one.name.removeprefix("Aggregate_").upper(), str(one.res)
            if one.distinct:
                raise Unsupported(f"{function}(DISTINCT …)")
            if function == "SAMPLE" and str(one.vars) in keys:
                # rdflib reads a group key through SAMPLE; it is the key itself.
                renamed[name] = str(one.vars)
            elif function in ("COUNT", "SUM", "AVG", "MIN", "MAX"):
                argument = None if one.vars == "*" else self.expression(one.vars)
                # Written twice (in the head and in HAVING), it is one.
                first = named.setdefault((function, argument), name)
                if first == name:
                    aggregations.append(Aggregation(name, function, argument))
                else:
                    renamed[name] = first
            else:
                raise Unsupported(f"the aggregate {function}")
        free = tuple(key for key in keys if key not in self.bindings)
        plan = Aggregate(free, tuple(aggregations), self.plan(group.p), implicit=not keys)
        return plan, renamed

    def _template(self, triples: Any) -> tuple[tuple[Position, Position, Position], ...]:
        template = []
        for triple in triples:
            if any(isinstance(term, BNode) for term in triple):
                raise Unsupported("a blank node in the template")
            s, p, o = (self._term(term) for term in triple)
            template.append((s, p, o))
        return tuple(template)

    def expression(self, node: Any, renamed: Mapping[str, str] | None = None) -> Expression:
        names = renamed or {}

        def go(node: Any) -> Expression:
            if isinstance(node, Variable) and str(node) in names:
                name = names[str(node)]
                return Const(self.bindings[name]) if name in self.bindings else Var(name)
            if isinstance(node, Variable | URIRef | RdflibLiteral):
                return self._term(node)
            if not isinstance(node, CompValue):
                raise Unsupported(f"the expression {node}")
            match node.name:
                case "ConditionalAndExpression" | "ConditionalOrExpression":
                    operator = "&&" if "And" in node.name else "||"
                    return _chain(go(node.expr), [(operator, go(one)) for one in node.other])
                case "RelationalExpression":
                    return relation(node)
                case "AdditiveExpression" | "MultiplicativeExpression":
                    steps = zip(node.op, node.other, strict=True)
                    return _chain(go(node.expr), [(str(op), go(one)) for op, one in steps])
                case "UnaryNot":
                    return Call("!", (go(node.expr),))
                case "UnaryMinus":
                    return Call("NEGATE", (go(node.expr),))
                case "UnaryPlus":
                    return go(node.expr)
                case name if name.removeprefix("Builtin_") in _BUILTINS:
                    return Call(_BUILTINS[name.removeprefix("Builtin_")], (go(node.arg),))
                case "Builtin_EXISTS" | "Builtin_NOTEXISTS":
                    raise Unsupported("EXISTS")
                case name:
                    raise Unsupported(f"the function {name.removeprefix('Builtin_')}")

        def relation(node: Any) -> Expression:
            left, operator = go(node.expr), str(node.op)
            if operator not in ("IN", "NOT IN"):
                return Call(operator, (left, go(node.other)))
            if not node.other:
                return Const(Literal(operator == "NOT IN"))
            tests = [Call("=", (left, go(one))) for one in node.other]
            found = _chain(tests[0], [("||", test) for test in tests[1:]])
            return found if operator == "IN" else Call("!", (found,))

        return go(node)


def _chain(first: Expression, rest: list[tuple[str, Expression]]) -> Expression:
    for operator, right in rest:
        first = Call(operator, (first, right))
    return first


_PART = {
    "LeftJoin": "OPTIONAL",
    "Union": "UNION",
    "Minus": "MINUS",
    "Graph": "GRAPH",
    "OrderBy": "ORDER BY",
    "Slice": "LIMIT or OFFSET",
    "ServiceGraphPattern": "SERVICE",
}
