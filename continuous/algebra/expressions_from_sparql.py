"""Translates expressions of a SPARQL tree to those of plans (SPARQL 1.1 §17): operators become
binary."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pyoxigraph import Literal, NamedNode, Variable

from ...sparql import ast
from .expressions import Call, Const, Expression
from .unsupported import Unsupported

_IN_A_ROW = 64
_NAMES = {"ISURI": "ISIRI", "URI": "IRI"}


class ExpressionTranslation:
    """``term`` translates a variable or constant; ``exists`` a pattern, to the variable of its
    mark. IRI() resolves against ``base``, which is part of the name of its call."""

    def __init__(
        self,
        term: Callable[[Variable | NamedNode | Literal], Expression],
        exists: Callable[[ast.Group], Expression],
        base: str = "",
    ) -> None:
        self.term = term
        self.exists = exists
        self.base = base

    def of(self, node: ast.Expression) -> Expression:
        """Translate ``node`` to an `Expression`."""
        go = self.of
        match node:
            case Variable() | NamedNode() | Literal():
                return self.term(node)
            case ast.Logical(operator, operands):
                return _either(operator, list(map(go, operands)))
            case ast.Comparison(operator, left, right):
                return Call(operator, (go(left), go(right)))
            case ast.In(operand, options, negated):
                return self._listed(go(operand), options, negated)
            case ast.Arithmetic(first, rest):
                return _chain(go(first), [(operator, go(one)) for operator, one in rest])
            case ast.Unary("!", operand):
                return Call("!", (go(operand),))
            case ast.Unary("-", operand):
                return Call("NEGATE", (go(operand),))
            case ast.Unary(_, operand):
                return go(operand)
            case ast.Exists(group, negated):
                found = self.exists(group)
                return Call("!", (found,)) if negated else found
            case ast.FunctionCall(iri, arguments):
                return Call(str(iri), tuple(map(go, arguments)))
            case ast.Call(name, arguments):
                name = _NAMES.get(name, name)
                if name == "BNODE":
                    raise Unsupported("BNODE, whose nodes are new in each solution")
                if name == "IRI" and self.base:
                    name = f"BASE <{self.base}> IRI"
                return Call(name, tuple(map(go, arguments)))
            case ast.Aggregate():
                raise AssertionError("an aggregate has become a variable (`translate`)")

    def _listed(
        self, operand: Expression, options: Sequence[ast.Expression], negated: bool
    ) -> Expression:
        """Translate IN: ``=`` of each option (SPARQL 1.1 §17.4.1.9)."""
        if not options:
            return Const(Literal(negated))
        found = _either("||", [Call("=", (operand, self.of(one))) for one in options])
        return Call("!", (found,)) if negated else found


def _either(operator: str, tests: Sequence[Expression]) -> Expression:
    """Join tests by ``&&`` or ``||``, which are associative, errors included (SPARQL 1.1 §17.2). A
    long list becomes a balanced tree: evaluation is recursive, and a chain would be too deep."""
    if len(tests) > _IN_A_ROW:
        half = len(tests) // 2
        return Call(operator, (_either(operator, tests[:half]), _either(operator, tests[half:])))
    return _chain(tests[0], [(operator, test) for test in tests[1:]])


def _chain(first: Expression, rest: list[tuple[str, Expression]]) -> Expression:
    for operator, right in rest:
        first = Call(operator, (first, right))
    return first
