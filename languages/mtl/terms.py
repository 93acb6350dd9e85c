"""Reads the terms that the languages over features share: names, variables, texts, numbers with
units, durations, and the parameters of templates."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from lark import Token, Tree

from ...streams.time import parse_duration
from ..arguments import check_order, default_in
from ..errors import LanguageError
from ..ssl.parser import read_units
from ..syntax import span_of, tokens, trees, unquoted
from . import ast

_LONGEST: Final = 2**62
"""Durations are shorter (146 years), so that sums of times stay within 64 bits."""
_SPELLED_OUT: Final = {
    "nanosecond": "ns",
    "microsecond": "us",
    "millisecond": "ms",
    "msec": "ms",
    "second": "s",
    "sec": "s",
    "minute": "m",
    "hour": "h",
    "day": "d",
}
_DURATION: Final = re.compile(r"([0-9.]+)[ \t]*([A-Za-z]+)\Z")
_DURATION_HINT: Final = "units are ns, us, ms, s, m, h and d: `5s`, `1.5h`"


class TermReader:
    """Converts trees of the grammars to the AST. All methods raise `LanguageError`."""

    def __init__(self, source: str) -> None:
        self._source = source
        self._declared: dict[str, str] = {}
        """The declared prefixes."""

    def slot(self, tree: Tree[Token], before: Sequence[ast.Slot]) -> ast.Slot:
        variable = self.variable(tokens(tree, "VARIABLE")[0])
        if variable in (slot.variable for slot in before):
            raise LanguageError(
                f"`?{variable.name}` is a parameter twice",
                self._source,
                variable.span,
                "give the second another name",
            )
        parts = {str(each.data): each for each in trees(tree)}
        sort = self.symbol(parts["symbol"]) if "symbol" in parts else None
        default = None
        if "default" in parts:
            sign = tokens(tree, "COMPARISON")[0]
            if sign != "=":
                hint = "write `=` before a default"
                raise LanguageError(
                    f"`{sign}` is not allowed here", self._source, span_of(sign), hint
                )
            default = default_in(self._source, span_of(parts["default"]), self._declared)
        return ast.Slot(variable, sort, variable.span if default else span_of(tree), default)

    def check_defaults(self, slots: Sequence[ast.Slot]) -> None:
        """Refuse a parameter without a default after one that has one."""
        names = [(slot.variable.name, slot.variable.span) for slot in slots]
        check_order(names, tuple(slot.default for slot in slots), self._source)

    def binding(self, tree: Tree[Token]) -> ast.Binding:
        variable = self.variable(tokens(tree, "VARIABLE")[0])
        return ast.Binding(variable, self.symbol(trees(tree)[0]), span_of(tree))

    def symbol(self, tree: Tree[Token]) -> ast.Symbol:
        return ast.Symbol(str(tree.children[0]), span_of(tree))

    def variable(self, token: Token) -> ast.Variable:
        return ast.Variable(str(token)[1:], span_of(token))

    def text(self, token: Token) -> ast.Text:
        return ast.Text(unquoted(token, self._source), span_of(token))

    def quantity(self, tree: Tree[Token]) -> ast.Number:
        number = float(tokens(tree, "DECIMAL")[0])
        if number in (float("inf"), float("-inf")):
            raise LanguageError(
                "the number exceeds a double", self._source, span_of(tree), "doubles reach 1.7e308"
            )
        units = trees(tree)
        unit = read_units(units[0], self._source) if units else None
        return ast.Number(number, unit, span_of(tree))

    def measured(self, tree: Tree[Token]) -> ast.Measured:
        unit = read_units(trees(tree)[0], self._source)
        return ast.Measured(self.variable(tokens(tree)[0]), unit, span_of(tree))

    def duration(self, token: Token) -> int:
        text = str(token)
        if text.startswith('"'):
            text = text[1:].partition('"')[0]
        elif (parts := _DURATION.match(text)) is not None:
            word = parts[2].lower()
            known = _SPELLED_OUT.get(word.removesuffix("s") if len(word) > 2 else word)
            text = f"{parts[1]}{known or parts[2]}"
        try:
            found = parse_duration(text)
            if found >= _LONGEST:
                raise ValueError("is outside")
        except ValueError as error:
            reason = "exceeds 146 years" if "outside" in str(error) else "is not a duration"
            if "finer" in str(error):
                reason = "is finer than a nanosecond"
            message = f"`{token}` {reason}"
            raise LanguageError(message, self._source, span_of(token), _DURATION_HINT) from None
        return found
