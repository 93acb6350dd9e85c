"""A query for Oxigraph, with calls of `standard_functions` where it is not as the standard."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from ...sparql import ast
from ..values.standard_functions import ORDER, TRUTH

_BOOLEANS: Final = (ast.Comparison, ast.Logical, ast.In, ast.Exists)


def standard(query: ast.Query) -> ast.Query:
    """The query with calls of `standard_functions` where Oxigraph may be otherwise."""
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
    """An expression of whose value the boolean value is asked."""
    found = ast.rewrite(expression, _changed)
    is_boolean = isinstance(expression, _BOOLEANS) or (
        isinstance(expression, ast.Unary) and expression.operator == "!"
    )
    return found if is_boolean else ast.FunctionCall(TRUTH, (found,))
