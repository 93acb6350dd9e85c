"""Parses text to chronicles (SPEC §8). The grammar is `chronicle.lark`.

Names are not resolved here, except declared prefixes; `check` does that.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import Final

from lark import Token, Tree
from lark.exceptions import UnexpectedInput

from ...streams.time import parse_time
from ..arguments import PARAMETERS
from ..errors import LanguageError, Span
from ..mtl.ast import Number, Slot, Symbol, TimePoint, Truth
from ..mtl.terms import TermReader
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

MOST_CLAUSES: Final = 256
MOST_ARGUMENTS: Final = 16
_LONGEST: Final = 2**60
"""Durations between events are shorter (36 years), as those of plans."""
_MOST_DIGITS: Final = 9
_TURNED: Final = {"<": ">", "<=": ">="}
_CLAUSE_HINT: Final = (
    "a clause is `event(…)`, `noevent(…)`, `hold(…)`, `occurs(…)`, `t2 - t1 in [0s, 5s]`, "
    "`t1 < t2`, `?x != ?y` or `?x in Car`, with `;` after it; `when recognized { … }` is the last"
)

# Each alternative begins with another character, and a comment reaches to the end of its line, so
# a text matches in one way only.
_SPACE: Final = r"(?>\s|(?:#|//)[^\n\r]*(?=[\n\r]|\Z))*"
_PREFIXES: Final = rf"(?>(?i:prefix)\b{_SPACE}(?:[A-Za-z_][\w-]*)?:{_SPACE}<[^<>]*>{_SPACE})*"
_REGISTER: Final = (
    rf"(?>(?i:register){_SPACE}(?:(?i:stream)\s+[^\s(){{}}]+"
    rf"|(?i:template)\s+[^()]*{PARAMETERS}){_SPACE}(?i:as)\b{_SPACE}{_PREFIXES})?"
)
_CHRONICLE: Final = re.compile(_SPACE + _PREFIXES + _REGISTER + r"chronicle(?![A-Za-z0-9_:])")


def is_chronicle(source: str) -> bool:
    """Whether a text is a chronicle, registers one, or is a template of one: its first word after
    prefixes and ``REGISTER … AS`` says so."""
    return _CHRONICLE.match(source) is not None


@TextCache
def parse_chronicle(source: str) -> ast.Chronicle:
    """Parse ``chronicle NAME(?x) { … }``, which may follow ``REGISTER STREAM name AS``; ``#`` and
    ``//`` start comments.

    Raises `LanguageError` for a text that the grammar refuses, with the place of the first wrong
    token.
    """
    tree = _parse(source, "start")
    stream = tokens(tree, "NAME")
    return _Reader(source, tree).chronicle(trees(tree)[-1], str(stream[0]) if stream else None)


@TextCache
def parse_chronicle_template(source: str) -> ast.ChronicleTemplate:
    """Parse ``REGISTER TEMPLATE name(?x, ?limit) AS chronicle NAME(?x) { … }``. Raises
    `LanguageError`."""
    tree = _parse(source, "template_text")
    return _Reader(source, tree).template(tree)


def _parse(source: str, start: str) -> Tree[Token]:
    try:
        tree = grammar("chronicle/chronicle.lark", "start", "template_text").parse(
            source, start=start
        )
    except UnexpectedInput as error:
        raise syntax_error(error, source, _syntax_hint) from None
    check_names(tree, source)
    return tree


def _syntax_hint(found: str, expected: AbstractSet[str]) -> str:
    if {"NOEVENT", "OCCURS"} <= expected:
        return _CLAUSE_HINT
    if found == "/" and "RSQB" in expected:
        return "a unit is a product of powers: write `m.s-1` for m/s"
    if found == "=" and "COMPARISON" not in expected:
        return "a comparison is one sign: `=`, `!=`, `<`, `<=`, `>`, `>=`"
    if found in ("<", "<=", "=", ">", ">=") and "SEMICOLON" in expected:
        return "write two clauses: `t1 < t2; t2 < t3`"
    if found == "(" and expected == {"LSQB"}:
        return "an interval stands in brackets: `[0s, 3s]`"
    if found == "(" and "LSQB" in expected:
        return "the objects of a feature stand in brackets: `speed[?x]`"
    if found == ")" and expected == {"COMMA"}:
        return "a change has two values, and an event a time: `event(speed[?x]:(?, < 3), t1)`"
    if found in ("<", "<=", "=", ">", ">=") and "COLON" in expected:
        return (
            "a value follows a colon: `speed[?x]:(?, > 3)` in an event, `speed[?x]:> 3` in a hold"
        )
    return expected_hint(expected)


class _Reader(TermReader):
    """Converts trees of the grammar to the AST."""

    def __init__(self, source: str, tree: Tree[Token]) -> None:
        super().__init__(source)
        self._prefixes = {
            str(tokens(each, "NAMESPACE")[0]): str(tokens(each, "IRI")[0])[1:-1]
            for each in trees(tree)
            if each.data == "prefix"
        }
        self._declared = {name[:-1]: iri for name, iri in self._prefixes.items()}

    def error(self, message: str, span: Span, hint: str) -> LanguageError:
        return LanguageError(message, self._source, span, hint)

    def symbol(self, tree: Tree[Token]) -> Symbol:
        """A name; one with a declared prefix is an IRI."""
        prefix, colon, local = str(tree.children[0]).partition(":")
        space = self._prefixes.get(prefix + colon)
        if space is None:
            return super().symbol(tree)
        return Symbol(f"<{space}{local}>", span_of(tree))

    # -- texts -------------------------------------------------------------------------------

    def template(self, tree: Tree[Token]) -> ast.ChronicleTemplate:
        nodes = [each for each in trees(tree) if each.data != "prefix"]
        name = self.symbol(nodes[0])
        iri = possible_iris(name.text, name.span, self._source)[0]
        slots = self.slots(nodes[1:-1])
        self.check_defaults(slots)
        return ast.ChronicleTemplate(iri, slots, self.chronicle(nodes[-1], None), self._source)

    def slots(self, nodes: Sequence[Tree[Token]]) -> tuple[Slot, ...]:
        if len(nodes) > MOST_ARGUMENTS:
            raise self.too_many(span_of(nodes[MOST_ARGUMENTS]))
        found: list[Slot] = []
        for node in nodes:
            found.append(self.slot(node, found))
        return tuple(found)

    def chronicle(self, tree: Tree[Token], stream: str | None) -> ast.Chronicle:
        name = str(tokens(tree, "NAME")[0])
        nodes = trees(tree)
        parameters: tuple[Slot, ...] = ()
        if nodes and nodes[0].data == "parameters":
            parameters = self.slots(trees(nodes.pop(0)))
        delay = None
        if nodes and nodes[-1].data == "delay":
            delay = self.duration(tokens(nodes.pop(), "DURATION")[0])
        emitted = None
        if nodes and nodes[-1].data == "recognized":
            emitted = self.emitted(nodes.pop(), name, parameters)
        if len(nodes) > MOST_CLAUSES:
            raise self.error(
                f"a chronicle has at most {MOST_CLAUSES} clauses",
                span_of(nodes[MOST_CLAUSES]),
                "divide it into chronicles that read each other's events",
            )
        clauses = tuple(map(self.clause, nodes))
        return ast.Chronicle(name, parameters, clauses, emitted, stream, delay, span_of(tree))

    def emitted(self, tree: Tree[Token], name: str, parameters: tuple[Slot, ...]) -> ast.Point:
        message_tree, point = trees(tree)
        message = self.message(message_tree)
        variables = tuple(slot.variable for slot in parameters)
        if (
            message.concept.text != name
            or message.arguments != variables
            or any(each.data in ("change", "test") for each in trees(message_tree))
        ):
            shown = ", ".join(f"?{each.name}" for each in variables)
            raise self.error(
                "a chronicle emits its own event, for the variables of its head",
                message.span,
                f"write `emit event({name}{f'[{shown}]' if shown else ''}, {point.children[0]})`",
            )
        return self.point(point)

    # -- clauses -----------------------------------------------------------------------------

    def clause(self, tree: Tree[Token]) -> ast.Clause:
        span = span_of(tree)
        nodes = trees(tree)
        match tree.data:
            case "event":
                return ast.Event(self.changed(nodes[0]), self.point(nodes[1]), span)
            case "noevent":
                return ast.Occurs(0, 0, self.changed(nodes[0]), *self.interval(nodes[1]), span)
            case "occurs":
                times, message, interval = nodes
                return ast.Occurs(
                    *self.times(times), self.changed(message), *self.interval(interval), span
                )
            case "hold":
                return ast.Hold(self.state(nodes[0]), *self.interval(nodes[1]), span)
            case "within":
                first, second = self.difference(nodes[0])
                return ast.Distance(first, second, *self.bounds(tree, *nodes[1:]), span)
            case "distance":
                first, second = self.difference(nodes[0])
                sign, bound = tokens(tree, "COMPARISON")[0], self.bound(nodes[1])
                if bound in (_LONGEST, -_LONGEST):
                    raise self.error(
                        "`oo` is no duration", span_of(nodes[1]), "leave the clause out"
                    )
                return ast.Distance(first, second, *self.compared(sign, str(sign), bound), span)
            case "order":
                return self.order(tree, *map(self.moment, nodes))
            case "comparison":
                variable, operator = (token for token in tokens(tree)[:2])
                operand = self.operand(tree.children[2])
                return ast.Comparison(self.variable(variable), str(operator), operand, span)
            case _:
                assert tree.data == "binding", tree.data
                return self.binding(tree)

    def times(self, tree: Tree[Token]) -> tuple[int, int | None]:
        found: list[int | None] = []
        for token in tokens(tree, "DECIMAL", "OO"):
            if token.type == "DECIMAL" and not (token.isdigit() and len(token) <= _MOST_DIGITS):
                raise self.error(
                    f"`{token}` is no number of times",
                    span_of(token),
                    "write `(2, 5)` or `(1, oo)`",
                )
            found.append(None if token.type == "OO" else int(token))
        least, most = found
        assert least is not None
        if most is not None and most < least:
            raise self.error(
                "the greatest number is smaller than the least",
                span_of(tree),
                f"write `({most}, {least})`",
            )
        return least, most

    # -- messages ----------------------------------------------------------------------------

    def message(self, tree: Tree[Token]) -> ast.Message:
        nodes = {str(each.data): each for each in trees(tree)}
        arguments: tuple[ast.Argument, ...] = ()
        if "arguments" in nodes:
            children = nodes["arguments"].children
            if len(children) > MOST_ARGUMENTS:
                raise self.too_many(span_of(children[MOST_ARGUMENTS]))
            arguments = tuple(map(self.argument, children))
        before = value = None
        if "change" in nodes:
            before, value = map(self.test, trees(nodes["change"]))
        elif "test" in nodes:
            value = self.test(nodes["test"])
        return ast.Message(self.symbol(nodes["symbol"]), arguments, before, value, span_of(tree))

    def changed(self, tree: Tree[Token]) -> ast.Message:
        """A message that is an event: it has a change, or no values at all."""
        test = next((each for each in trees(tree) if each.data == "test"), None)
        if test is not None:
            text = self.words(test)
            raise self.error(
                "a single value is a state, not an event",
                span_of(test),
                f"write the value before, too: `(?, {text})` for each sample with {text}",
            )
        return self.message(tree)

    def state(self, tree: Tree[Token]) -> ast.Message:
        if not any(each.data == "test" for each in trees(tree)):
            raise self.error(
                "`hold` needs a value that holds",
                span_of(tree),
                "write `hold(stopped[?x]:true, (t1, t2))`",
            )
        return self.message(tree)

    def argument(self, node: Tree[Token] | Token) -> ast.Argument:
        if isinstance(node, Tree):
            return self.symbol(node)
        match node.type:
            case "ANY":
                return None
            case "VARIABLE":
                return self.variable(node)
            case _:
                return self.text(node)

    def test(self, tree: Tree[Token]) -> ast.Test | None:
        """A test of a value; None for ``?``."""
        operand = tree.children[-1]
        if isinstance(operand, Token) and operand.type == "ANY":
            return None
        signs = tokens(tree, "COMPARISON")
        return ast.Test(str(signs[0]) if signs else "=", self.operand(operand), span_of(tree))

    def operand(self, node: Tree[Token] | Token) -> ast.Operand:
        if isinstance(node, Tree):
            match node.data:
                case "quantity":
                    number = self.quantity(node)
                    is_negative = tokens(node, "SIGN")[:1] == ["-"]
                    value = -number.value if is_negative else number.value
                    return Number(value, number.unit, number.span)
                case "measured":
                    return self.measured(node)
                case _:
                    return self.symbol(node)
        match node.type:
            case "TRUE" | "FALSE":
                return Truth(node.type == "TRUE", span_of(node))
            case "VARIABLE":
                return self.variable(node)
            case "QUOTED":
                return self.text(node)
            case _:
                try:
                    return TimePoint(parse_time(str(node)), span_of(node))
                except ValueError as error:
                    raise self.error(str(error), span_of(node), "") from None

    # -- times -------------------------------------------------------------------------------

    def point(self, tree: Tree[Token]) -> ast.Point:
        return ast.Point(str(tree.children[0]), span_of(tree))

    def interval(self, tree: Tree[Token]) -> tuple[ast.Moment, ast.Moment]:
        start, end = map(self.moment, trees(tree))
        return start, end

    def moment(self, tree: Tree[Token]) -> ast.Moment:
        name = tokens(tree, "NAME")[0]
        offset: ast.Duration = 0
        for token in tokens(tree, "DURATION", "DECIMAL", "VARIABLE"):
            offset = _times(self.sign(tree), self.length(token))
        return ast.Moment(ast.Point(str(name), span_of(name)), offset, span_of(tree))

    def difference(self, tree: Tree[Token]) -> tuple[ast.Point, ast.Point]:
        """The first and the second point of ``second - first``."""
        second, first = (ast.Point(str(each), span_of(each)) for each in tokens(tree, "NAME"))
        if self.sign(tree) > 0:
            raise self.error(
                "times are not added to each other",
                span_of(tree),
                f"write `{second.name} - {first.name}`, or a duration: `{second.name} + 5s`",
            )
        return first, second

    def bounds(
        self, tree: Tree[Token], low: Tree[Token], high: Tree[Token]
    ) -> tuple[ast.Duration | None, ast.Duration | None]:
        least, most = self.bound(low), self.bound(high)
        is_over = isinstance(least, int) and isinstance(most, int) and least > most
        if is_over or least == _LONGEST or most == -_LONGEST:
            raise self.error(
                "the interval ends before it begins",
                Span(span_of(low).start, span_of(high).end),
                "write the smaller bound first: `[0s, 5s]`, `[-oo, 5s]`",
            )
        return (None if least == -_LONGEST else least), (None if most == _LONGEST else most)

    def order(self, tree: Tree[Token], left: ast.Moment, right: ast.Moment) -> ast.Distance:
        """The distance of two points, from the one that the clause says is first."""
        sign = tokens(tree, "COMPARISON")[0]
        first, second = (right, left) if sign in (">", ">=") else (left, right)
        if isinstance(first.offset, ast.Given) and isinstance(second.offset, ast.Given):
            raise self.error(
                "two parameters stand in one bound",
                span_of(tree),
                "write one, which is their difference or sum",
            )
        bound = _difference(first.offset, second.offset)
        bounds = self.compared(sign, _TURNED.get(str(sign), str(sign)), bound)
        return ast.Distance(first.point, second.point, *bounds, span_of(tree))

    def compared(
        self, sign: Token, operator: str, bound: ast.Duration
    ) -> tuple[ast.Duration | None, ast.Duration | None]:
        """The bounds of a difference that is compared with ``bound``."""
        match operator:
            case "<":
                return None, _difference(bound, 1)
            case "<=":
                return None, bound
            case ">":
                return _difference(bound, -1), None
            case ">=":
                return bound, None
            case "=":
                return bound, bound
            case _:
                raise self.error(
                    "times that differ may do so in two ways",
                    span_of(sign),
                    "write `<` or `>`, or a chronicle for each",
                )

    def bound(self, tree: Tree[Token]) -> ast.Duration:
        """A duration; `_LONGEST` stands for ``oo``."""
        token = tokens(tree, "DURATION", "DECIMAL", "OO", "VARIABLE")[0]
        sign = self.sign(tree)
        if token.type == "OO":
            return sign * _LONGEST
        found = _times(sign, self.length(token))
        for more in trees(tree):
            length = self.length(tokens(more, "DURATION")[0])
            found = _difference(found, _times(-self.sign(more), length))
        return found

    def sign(self, tree: Tree[Token]) -> int:
        return -1 if tokens(tree, "SIGN")[:1] == ["-"] else 1

    def length(self, token: Token) -> ast.Duration:
        """A duration; ``0`` needs no unit."""
        if token.type == "VARIABLE":
            return ast.Given(self.variable(token))
        if token.type == "DECIMAL":
            if float(token) != 0.0:
                raise self.error(
                    f"`{token}` has no unit", span_of(token), f"write `{token}s` for seconds"
                )
            return 0
        found = self.duration(token)
        if found >= _LONGEST:
            raise self.error(
                f"`{token}` exceeds 36 years", span_of(token), "write `oo`, or a shorter duration"
            )
        return found

    # -- errors ------------------------------------------------------------------------------

    def words(self, tree: Tree[Token]) -> str:
        span = span_of(tree)
        return self._source[span.start : span.end]

    def too_many(self, span: Span) -> LanguageError:
        return self.error(f"at most {MOST_ARGUMENTS} stand here", span, "leave this one out")


def _times(sign: int, duration: ast.Duration) -> ast.Duration:
    if isinstance(duration, int):
        return sign * duration
    return replace(duration, sign=sign * duration.sign, offset=sign * duration.offset)


def _difference(one: ast.Duration, other: ast.Duration) -> ast.Duration:
    """One duration less another. Contract: at most one of them is a parameter."""
    if isinstance(other, ast.Given):
        assert isinstance(one, int)
        return _difference(_times(-1, other), -one)
    return one - other if isinstance(one, int) else replace(one, offset=one.offset - other)
