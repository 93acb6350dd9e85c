"""From rdflib's expressions to ours (SPARQL 1.1 §17), by the names of the functions in SPARQL."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pyoxigraph import Literal
from rdflib.plugins.sparql.parserutils import CompValue
from rdflib.term import BNode, URIRef, Variable
from rdflib.term import Literal as RdflibLiteral

from .expressions import Call, Const, Expression
from .unsupported import Unsupported

_ARGUMENTS = ("arg", "arg1", "arg2", "arg3", "text", "pattern", "start", "length", "replacement")
"""Where rdflib keeps the arguments of a built-in call, in the order in which they are written."""
_IN_A_ROW = 64
_NAMES = {"ISURI": "ISIRI", "URI": "IRI"}
_NOT_HERE = {
    "BNODE": "BNODE, whose nodes are new in each solution",
    "IRI": "IRI(), which depends on the BASE",
}


class ExpressionTranslation:
    """``term`` reads a variable or constant; ``exists`` a pattern, as the variable of its mark."""

    def __init__(
        self, term: Callable[[Any], Expression], exists: Callable[[Any], Expression]
    ) -> None:
        self.term = term
        self.exists = exists

    def of(self, node: Any, renamed: Mapping[str, Expression]) -> Expression:
        """``node`` as an `Expression`, these variables under their other names."""

        def go(node: Any) -> Expression:
            if isinstance(node, Variable) and str(node) in renamed:
                return renamed[str(node)]
            if isinstance(node, Variable | URIRef | RdflibLiteral):
                return self.term(node)
            if isinstance(node, BNode) or not isinstance(node, CompValue):
                raise Unsupported(f"the expression {node}")
            match node.name:
                case "ConditionalAndExpression" | "ConditionalOrExpression":
                    operator = "&&" if "And" in node.name else "||"
                    return _either(operator, [go(node.expr), *map(go, node.other)])
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
                case "Builtin_EXISTS":
                    return self.exists(node.graph)
                case "Builtin_NOTEXISTS":
                    return Call("!", (self.exists(node.graph),))
                case "Function":
                    arguments = tuple(go(one) for one in node.expr or ())
                    return Call(f"<{node.iri}>", arguments)
                case name if name.startswith("Builtin_"):
                    return built_in(node)
                case name:
                    raise Unsupported(f"the expression {name}")

        def built_in(node: Any) -> Expression:
            name = str(node.name).removeprefix("Builtin_").upper()
            name = _NAMES.get(name, name)
            if name in _NOT_HERE:
                raise Unsupported(_NOT_HERE[name])
            arguments: list[Expression] = []
            for place in (*_ARGUMENTS, "flags"):
                # `get` of rdflib gives back the name of what is not there.
                if place not in node or node[place] is None:
                    continue
                given = node[place]
                # CONCAT and COALESCE keep a list; `()` is rdf:nil.
                listed = given if isinstance(given, list) else [given]
                if name in ("CONCAT", "COALESCE") and not isinstance(given, list):
                    listed = []
                arguments.extend(go(one) for one in listed)
            return Call(name, tuple(arguments))

        def relation(node: Any) -> Expression:
            left, operator = go(node.expr), str(node.op)
            if operator not in ("IN", "NOT IN"):
                return Call(operator, (left, go(node.other)))
            if not node.other or isinstance(node.other, URIRef):
                # rdflib reads `()` as rdf:nil.
                return Const(Literal(operator == "NOT IN"))
            tests = [Call("=", (left, go(one))) for one in node.other]
            found = _either("||", tests)
            return found if operator == "IN" else Call("!", (found,))

        return go(node)


def _either(operator: str, tests: Sequence[Expression]) -> Expression:
    """All tests by ``&&`` or ``||``, which are associative, errors included (SPARQL 1.1 §17.2): so
    many of them are halved until they are few, for who reads an expression recurses."""
    if len(tests) > _IN_A_ROW:
        half = len(tests) // 2
        return Call(operator, (_either(operator, tests[:half]), _either(operator, tests[half:])))
    return _chain(tests[0], [(operator, test) for test in tests[1:]])


def _chain(first: Expression, rest: list[tuple[str, Expression]]) -> Expression:
    for operator, right in rest:
        first = Call(operator, (first, right))
    return first
