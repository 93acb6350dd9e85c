"""The papers' AGGREGATE clause: aggregations and conditions on them ([Events14 Listing 3])."""

from __future__ import annotations

from typing import Final

from pyoxigraph import Variable

from ...sparql.ast import Expression
from ...sparql.cursor import Cursor
from ...sparql.expressions import ExpressionReader
from ...sparql.tokens import Kind
from ..errors import Span
from ..hints import suggest_name
from .ast import Aggregation

FUNCTIONS: Final = ("AVG", "SUM", "COUNT", "MIN", "MAX")
_EXAMPLE: Final = "write `AGGREGATE {(?avg, AVG, {?x}) FILTER (?avg > 100)}`"


def read_aggregate(
    at: ExpressionReader,
    aggregations: list[Aggregation],
    filters: list[tuple[Expression, Span]],
) -> None:
    """Read ``{(?a, AVG, {?x}) FILTER (…)}`` after AGGREGATE, in any order, into both lists."""
    at.expect_mark("{", _EXAMPLE)
    while not at.is_mark("}"):
        if at.is_word("FILTER"):
            filters.append(_filter(at))
        elif at.is_mark("("):
            aggregations.append(_aggregation(at))
        elif at.is_mark(".", ",", ";"):
            at.take()
        else:
            raise at.expected("`(` or FILTER", _EXAMPLE)
    close = at.take()
    if not aggregations:
        raise at.error("the AGGREGATE clause aggregates nothing", close, _EXAMPLE)


def _filter(at: ExpressionReader) -> tuple[Expression, Span]:
    at.take()
    start = at.here
    if start is None or at.is_mark("}", ")", "]"):
        raise at.expected("a condition", "write `FILTER (?avg > 100)`")
    condition = at.constraint()
    return condition, Span(start.start, at.last_token.end)


def _aggregation(at: Cursor) -> Aggregation:
    first = at.take()
    alias = at.variable("the name of the aggregate, like `?avg`", _EXAMPLE)
    at.expect_mark(",", _EXAMPLE)
    function = _function(at)
    at.expect_mark(",", _EXAMPLE)
    at.expect_mark("{", _EXAMPLE)
    argument = at.variable("a variable of WHERE", _EXAMPLE)
    if at.is_mark(","):
        raise at.error("an aggregate has one variable", at.here, _EXAMPLE)
    at.expect_mark("}", _EXAMPLE)
    close = at.expect_mark(")", _EXAMPLE)
    span = Span(first.start, close.end)
    return Aggregation(Variable(alias.text[1:]), function, Variable(argument.text[1:]), span)


def _function(at: Cursor) -> str:
    word = at.here
    if word is None or word.kind is not Kind.WORD:
        raise at.expected("a function", suggest_name("", FUNCTIONS))
    name = word.text.upper()
    if name not in FUNCTIONS:
        hint = suggest_name(name, FUNCTIONS)
        raise at.error(f"`{word.text}` is not an aggregate function", word, hint)
    at.take()
    return name
