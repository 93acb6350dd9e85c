"""Rewrites a query for Oxigraph: it calls `standard_functions` where Oxigraph deviates."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from ...sparql import ast
from ..values.standard_functions import ORDER, TRUTH

_BOOLEANS: Final = (ast.Comparison, ast.Logical, ast.In, ast.Exists)


def rewrite_to_standard(query: ast.Query) -> ast.Query:
    """Replace the parts of a query that Oxigraph evaluates otherwise by `standard_functions`."""
    return ast.rewrite(query, _changed)


def _changed(node: object) -> object | None:
    match node:
        case ast.Filter(condition):
            return ast.Filter(_truth(condition))
        case ast.Logical(operator, operands):
            return ast.Logical(operator, tuple(map(_truth, operands)))
        case ast.Unary("!", operand):
            return ast.Unary("!", _truth(operand))
        case ast.Call("IF", (condition, *results)):
            rest = tuple(ast.rewrite(one, _changed) for one in results)
            return ast.Call("IF", (_truth(condition), *rest))
        case ast.Comparison(operator, left, right) if operator in ORDER:
            sides = tuple(ast.rewrite(one, _changed) for one in (left, right))
            return ast.FunctionCall(ORDER[operator], sides)
        case ast.Query(having=having) if having:
            bare = ast.rewrite(replace(node, having=()), _changed)
            return replace(bare, having=tuple(map(_truth, having)))
    return None


def _truth(expression: ast.Expression) -> ast.Expression:
    """Rewrite an expression whose effective boolean value is used."""
    found = ast.rewrite(expression, _changed)
    is_boolean = isinstance(expression, _BOOLEANS) or (
        isinstance(expression, ast.Unary) and expression.operator == "!"
    )
    return found if is_boolean else ast.FunctionCall(TRUTH, (found,))
