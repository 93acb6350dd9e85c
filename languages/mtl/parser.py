"""Parses text to MTL formulas and monitors (SPEC §8). The grammar is `mtl.lark`.

Names are not resolved here, and truth is not told from number; `check` does that.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from functools import reduce
from typing import Final

from lark import Token, Tree
from lark.exceptions import UnexpectedInput

from ...ontology.units import is_unit
from ...rdf.namespaces import local_name
from ...streams.policies.policy import SynchronizationPolicy
from ...streams.time import parse_time
from ..arguments import PARAMETERS
from ..errors import LanguageError, Span
from ..kpl import ast as kpl
from ..kpl.constraints import to_synchronization
from ..kpl.parser import read_constraint
from ..kpl.printer import DEFAULT_UNIT
from ..ontology_names import possible_iris
from ..syntax import (
    check_names,
    expected_hint,
    grammar,
    span_of,
    syntax_error,
    tokens,
    trees,
)
from ..text_cache import TextCache
from . import ast
from .terms import TermReader

_STARTS: Final = ("start", "formula_text", "template_text")
DEEPEST: Final = 64
"""The greatest nesting of a formula."""
_OPTIONS: Final = frozenset({"SAMPLE", "MAX", "REPORT", "PRESENT"})
_OPTION_HINT: Final = (
    "an option is `sample every t`, `any change`, `max delay t`, `use most recent`, "
    "`no approximation`, `from a to b`, `present for t`, `once`, `robustness` or "
    "`report violations | changes | verdicts`"
)

# A comment reaches to the end of its line: without the assertion a line of many `#` would match in
# 2^n ways.
_SPACE: Final = r"(?:\s|(?:#|//)[^\n\r]*(?=[\n\r]|\Z))*"
_MONITOR: Final = re.compile(_SPACE + r"monitor(?![A-Za-z0-9_:])")
_TEMPLATE: Final = re.compile(
    _SPACE
    + rf"(?i:register)\s+(?i:template)\s[^()]*{PARAMETERS}\s*(?i:as)\b"
    + _SPACE
    + r"(?!(?i:select|construct|ask|describe|prefix|base|pattern|chronicle)\b)"
    r"(?:(?:always|eventually|historically|once|previous|not|forall|exists|true|false)\b"
    r"|[(\"?0-9-]|(?:[A-Za-z_][\w-]*:)?[A-Za-z_]\w*\s*[(<>=!+*/-]|<[^<>\s]*>\s*\()"
)
"""A template whose body begins like a formula and not with a keyword of another language."""


@TextCache
def parse_monitor(source: str) -> ast.Monitor:
    """Parse ``monitor NAME(?x in Car) = formula with options``; ``#`` and ``//`` start comments.

    Raises `LanguageError` for a text that the grammar refuses, with the place of the first wrong
    token.
    """
    return _Reader(source).monitor(trees(_parse(source, "start"))[0])


def is_monitor(source: str) -> bool:
    """Whether a text is a monitor rather than a query: its first word says so."""
    return _MONITOR.match(source) is not None


@TextCache
def parse_formula_template(source: str) -> ast.FormulaTemplate:
    """Parse ``REGISTER TEMPLATE name(?x, ?limit) AS formula with options``. Raises
    `LanguageError`."""
    return _Reader(source).template(_parse(source, "template_text"))


def is_formula_template(source: str) -> bool:
    """Whether a text registers a formula rather than a query: the word after ``AS`` says so."""
    return _TEMPLATE.match(source) is not None


@TextCache
def parse_formula(source: str) -> ast.Formula:
    """Parse a formula by itself. Raises `LanguageError`."""
    return _Reader(source).formula(_parse(source, "formula_text").children[0])


def _parse(source: str, start: str) -> Tree[Token]:
    _check_depth(source)
    try:
        tree = grammar("mtl/mtl.lark", "start", "formula_text", "template_text").parse(
            source, start=start
        )
    except UnexpectedInput as error:
        raise syntax_error(error, source, _syntax_hint) from None
    check_names(tree, source)
    return tree


def _check_depth(source: str) -> None:
    """Refuse deep parentheses before the parser, whose trees are walked recursively."""
    depth = 0
    for place, character in enumerate(source):
        depth += (character == "(") - (character == ")")
        if depth > DEEPEST:
            raise _too_deep(source, Span(place, place + 1))


def _too_deep(source: str, span: Span) -> LanguageError:
    return LanguageError(
        f"the formula is nested more than {DEEPEST} deep",
        source,
        span,
        "name a part of it: a monitor's verdicts are a stream that another formula can read",
    )


def _syntax_hint(found: str, expected: AbstractSet[str]) -> str:
    if expected >= _OPTIONS:
        return _OPTION_HINT
    if found in ("&&", "||", "!", "&", "|"):
        return "operators are words: `not`, `and`, `or`, and `->`"
    if found == "=":
        return "a comparison is one sign: `=`, `!=`, `<`, `<=`, `>`, `>=`"
    if found == ">":
        return "an implication is `->`, and a comparison `>=` or `>`; two are joined by `and`"
    if found in ("<", "<=", ">=") and "COMPARISON" not in expected:
        return "join two comparisons by `and`: `1 < speed(?x) and speed(?x) < 2`"
    if found == "/" and "RSQB" in expected:
        return "a unit is a product of powers: write `m.s-1` for m/s"
    if expected == {"IN"}:
        return "an object has a sort: `?x in Car`"
    if found == "]" and expected == {"COMMA"}:
        return "an interval has two ends: `[0s, 5s]`"
    if found != found.lower() and found.upper() in expected:
        return f"words are in small letters: `{found.lower()}`"
    if "NO_UNIT" in expected and (found == "%" or is_unit(found)):
        return "a unit stands in brackets, `20 [percent]`, as an interval does, `[0s, 5s]`"
    if "LPAR" in expected and (found == "[" or found[:1] == "?" or found[:1].isalpha()):
        return (
            "the objects of a feature stand in parentheses: `speed(?x)`; before a formula stand "
            "operators such as `always`, `eventually` and `not`"
        )
    return expected_hint(expected)


_ABOUT: Final = {
    "sample_every": "change",
    "any_change": "change",
    "use_most_recent": "approximation",
    "no_approximation": "approximation",
    "from_to": "duration",
    "to": "duration",
}
"""What options are about that exclude each other, by the grammar's names."""


class _Reader(TermReader):
    """Converts trees of the grammar to the AST."""

    def __init__(self, source: str) -> None:
        super().__init__(source)
        self._depth = 0

    # -- monitors ----------------------------------------------------------------------------

    def monitor(self, tree: Tree[Token]) -> ast.Monitor:
        name, *rest = _unmarked(tree)
        parameters: tuple[ast.Binding, ...] = ()
        if isinstance(head := rest[0], Tree) and head.data == "parameters":
            parameters = tuple(map(self.binding, trees(head)))
            rest.pop(0)
        return self.body(str(name), parameters, rest, span_of(tree))

    def template(self, tree: Tree[Token]) -> ast.FormulaTemplate:
        symbol, *rest = _unmarked(tree)
        assert isinstance(symbol, Tree)
        name = self.symbol(symbol)
        iri = possible_iris(name.text, name.span, self._source)[0]
        slots: list[ast.Slot] = []
        while isinstance(head := rest[0], Tree) and head.data == "slot":
            slots.append(self.slot(head, slots))
            rest.pop(0)
        self.check_defaults(slots)
        monitor = self.body(local_name(iri), (), rest, span_of(tree))
        return ast.FormulaTemplate(iri, tuple(slots), monitor, self._source)

    def body(
        self,
        name: str,
        parameters: tuple[ast.Binding, ...],
        rest: Sequence[Tree[Token] | Token],
        span: Span,
    ) -> ast.Monitor:
        first, *options = rest
        formula = self.formula(first)
        constraints: list[kpl.Constraint] = []
        report, once, robustness, present_for = ast.Report.VIOLATIONS, False, False, None
        given: dict[str, Span] = {}
        for option in options:
            assert isinstance(option, Tree)
            self.check_once(option, given)
            match option.data:
                case "report":
                    report = ast.Report(str(tokens(option)[-1]))
                case "once_only":
                    once = True
                case "robustness":
                    robustness = True
                case "present_for":
                    present_for = self.duration(tokens(trees(option)[0])[0])
                case _:
                    constraints.append(read_constraint(option, self._source))
        if robustness and report is ast.Report.CHANGES and not once:
            raise LanguageError(
                "`robustness` is that of a start, and `report changes` tells of runs of starts",
                self._source,
                given["robustness"],
                "write `report verdicts` or `report violations`",
            )
        return ast.Monitor(
            name,
            parameters,
            formula,
            self.policy(constraints, span),
            report,
            once,
            present_for,
            robustness,
            span,
        )

    def check_once(self, option: Tree[Token], given: dict[str, Span]) -> None:
        """Refuse a second option about the same thing."""
        about = _ABOUT.get(option.data, option.data)
        before, span = given.get(about), span_of(option)
        if before is not None:
            first, second = (self._source[s.start : s.end] for s in (before, span))
            raise LanguageError(
                f"`{second}` comes after `{first}`, and only one of them can hold",
                self._source,
                span,
                "leave one out",
            )
        given[about] = span

    def policy(self, constraints: list[kpl.Constraint], span: Span) -> SynchronizationPolicy:
        if not any(isinstance(each, kpl.Change) for each in constraints):
            constraints = [kpl.Change("any change", None, span), *constraints]
        return to_synchronization(constraints, self._source, DEFAULT_UNIT, span)

    # -- formulas ----------------------------------------------------------------------------

    def formula(self, node: Tree[Token] | Token) -> ast.Formula:
        if isinstance(node, Token):
            return self.leaf(node)
        self._depth += 1
        if self._depth > DEEPEST:
            raise _too_deep(self._source, span_of(node))
        try:
            return self.compound(node)
        finally:
            self._depth -= 1

    def leaf(self, token: Token) -> ast.Formula:
        span = span_of(token)
        match token.type:
            case "TRUE" | "FALSE":
                return ast.Truth(token.type == "TRUE", span)
            case "VARIABLE":
                return self.variable(token)
            case "QUOTED":
                return self.text(token)
            case _:
                try:
                    return ast.TimePoint(parse_time(str(token)), span)
                except ValueError as error:
                    raise LanguageError(str(error), self._source, span, "") from None

    def compound(self, tree: Tree[Token]) -> ast.Formula:
        span = span_of(tree)
        children = tree.children
        match tree.data:
            case "formula":
                left, right = self.operands(tree)
                return ast.Implies(left, right, span)
            case "disjunction":
                return reduce(lambda a, b: ast.Or(a, b, span), self.operands(tree))
            case "conjunction":
                return reduce(lambda a, b: ast.And(a, b, span), self.operands(tree))
            case "binary":
                interval = self.interval_of(tree)
                left, right = self.operands(tree)
                is_past = bool(tokens(tree, "SINCE"))
                return ast.Until(is_past, interval, left, right, span)
            case "unary":
                make = ast.Previous if tokens(tree, "PREVIOUS") else ast.Not
                return make(self.formula(children[1]), span)
            case "temporal":
                operator = ast.Temporal(str(children[0]))
                interval = self.interval_of(tree)
                return ast.Within(operator, interval, self.formula(children[-1]), span)
            case "quantified":
                bindings = [self.binding(each) for each in trees(tree) if each.data == "binding"]
                is_universal = bool(tokens(tree, "FORALL"))
                found = self.formula(children[-1])
                for binding in reversed(bindings):
                    found = ast.Quantified(is_universal, binding, found, span)
                return found
            case "comparison":
                sides = self.formula(children[0]), self.formula(children[2])
                return ast.Comparison(str(children[1]), *sides, span)
            case "sum" | "product":
                found = self.formula(children[0])
                for sign, operand in zip(children[1::2], children[2::2], strict=True):
                    found = ast.Arithmetic(str(sign), found, self.formula(operand), span)
                return found
            case "signed":
                value = self.formula(children[1])
                return value if children[0] == "+" else ast.Negative(value, span)
            case "quantity":
                return self.quantity(tree)
            case "measured":
                return self.measured(tree)
            case _:
                assert tree.data == "feature", tree.data
                return self.feature(tree)

    def operands(self, tree: Tree[Token]) -> list[ast.Formula]:
        kept = (child for child in tree.children if not _is_connective(child))
        return [self.formula(child) for child in kept]

    def feature(self, tree: Tree[Token]) -> ast.FeatureTerm:
        symbol, *arguments = tree.children
        assert isinstance(symbol, Tree)
        return ast.FeatureTerm(
            self.symbol(symbol), tuple(map(self.argument, arguments)), span_of(tree)
        )

    def argument(self, node: Tree[Token] | Token) -> ast.Variable | ast.Symbol | ast.Text:
        if isinstance(node, Tree):
            return self.symbol(node)
        return self.variable(node) if node.type == "VARIABLE" else self.text(node)

    # -- times -------------------------------------------------------------------------------

    def interval_of(self, tree: Tree[Token]) -> ast.Interval:
        found = next((node for node in trees(tree) if node.data == "interval"), None)
        if found is None:
            return ast.Interval()
        bounds = [self.bound(node) for node in trees(found)]
        if len(bounds) == 2 and bounds[0] > bounds[1]:
            raise LanguageError(
                "the interval ends before it begins",
                self._source,
                span_of(found),
                "write the smaller bound first: `[0s, 5s]`",
            )
        return ast.Interval(bounds[0], bounds[1] if len(bounds) == 2 else None)

    def bound(self, tree: Tree[Token]) -> int:
        sign, token = tokens(tree, "SIGN"), tokens(tree, "DURATION", "DECIMAL")[0]
        span = span_of(tree)
        if sign and sign[0] == "-":
            raise LanguageError(
                "an interval has no negative bound",
                self._source,
                span,
                "the past has operators of its own: `once`, `historically`, `since`, `previous`",
            )
        if token.type == "DECIMAL":
            if float(token) != 0.0:
                raise LanguageError(
                    f"`{token}` has no unit", self._source, span, f"write `{token}s` for seconds"
                )
            return 0
        return self.duration(token)


_MARKS: Final = frozenset(
    {"MONITOR", "REGISTER", "TEMPLATE", "AS", "WITH", "EQUAL", "COMMA", "LPAR", "RPAR"}
)
_CONNECTIVES: Final = frozenset({"ARROW", "OR", "AND", "UNTIL", "SINCE"})


def _unmarked(tree: Tree[Token]) -> list[Tree[Token] | Token]:
    """The children without keywords. The formula may be a bare token, so their order tells them
    apart."""
    return [c for c in tree.children if not (isinstance(c, Token) and c.type in _MARKS)]


def _is_connective(node: Tree[Token] | Token) -> bool:
    if isinstance(node, Tree):
        return bool(node.data == "interval")
    return node.type in _CONNECTIVES
