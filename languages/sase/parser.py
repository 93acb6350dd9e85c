"""Parses text to SASE+ patterns (SPEC §8). The grammar is `sase.lark`.

Names are not resolved here; `check` does that.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from collections.abc import Set as AbstractSet
from typing import Final, TypeAlias

from lark import Token, Tree
from lark.exceptions import UnexpectedInput

from ...rdf.namespaces import local_name
from ...streams.time import parse_time
from ..arguments import PARAMETERS
from ..errors import LanguageError, Span
from ..mtl.ast import Number, Slot, Symbol, Text, TimePoint, Truth, Variable
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

DEEPEST: Final = 32
"""The greatest nesting of parentheses and signs."""
MOST_OPERATIONS: Final = 64
"""The greatest number of operations in a condition or result."""
_MOST_MATCHES: Final = 10**6

# The group is atomic: what it has taken it never gives back, so a match is linear in the text.
_SPACE: Final = r"(?>(?:\s|(?:#|//)[^\n\r]*)*)"
_SASE: Final = re.compile(
    _SPACE
    + rf"(?:prefix{_SPACE}[\w-]*:{_SPACE}<[^<>\s]*>{_SPACE})*"
    + rf"(?:register\s+(?:(?:stream|query)\s+[^\s()]+\s|template\s[^()]*{PARAMETERS}){_SPACE}as\b)?"
    + rf"{_SPACE}(?:from\s+[^\s()]+\s{_SPACE})?pattern(?![\w:])",
    re.IGNORECASE,
)
_Node: TypeAlias = Tree[Token] | Token
_INDEXES: Final = {
    "RSQB": ast.Index.ALL,
    "FIRST": ast.Index.FIRST,
    "EACH": ast.Index.EACH,
    "PREVIOUS": ast.Index.PREVIOUS,
    "BEFORE": ast.Index.BEFORE,
}
_OPERATORS: Final = {"==": "=", "≠": "!="}
_INDEX_HINT: Final = (
    "the events of a repeated part `a` are `a[1]`, `a[i]`, `a[i-1]`, `a[a.LEN]`, and in aggregates "
    "`a[]` and `a[..i-1]`"
)


def is_sase(source: str) -> bool:
    """Whether a text is a SASE+ pattern or a template of one: the first keyword of its body is
    ``PATTERN``, or it is ``FROM`` and the next one is. Cost: linear in the text."""
    return _SASE.match(source) is not None


@TextCache
def parse_sase(source: str) -> ast.Pattern:
    """Parse ``REGISTER STREAM name AS PATTERN …``, or one without REGISTER; ``#`` and ``//`` start
    comments.

    Raises `LanguageError` for a text that the grammar refuses, with the place of the first wrong
    token.
    """
    tree = _parse(source, "start")
    return _Reader(source, tree).registered(tree)


@TextCache
def parse_sase_template(source: str) -> ast.PatternTemplate:
    """Parse ``REGISTER TEMPLATE name(?x in Car, ?limit) AS PATTERN …``. Raises `LanguageError`."""
    tree = _parse(source, "template_text")
    return _Reader(source, tree).template(tree)


def _parse(source: str, start: str) -> Tree[Token]:
    try:
        tree = grammar("sase/sase.lark", "start", "template_text").parse(source, start=start)
    except UnexpectedInput as error:
        raise syntax_error(error, source, _syntax_hint) from None
    check_names(tree, source)
    return tree


def _syntax_hint(found: str, expected: AbstractSet[str]) -> str:
    if {"EACH", "PREVIOUS"} & expected:
        return _INDEX_HINT
    if found.lower() in ("or", "||", "|", "∨"):
        return "conditions are joined by `and`: write a pattern for each alternative"
    if found in ("&&", "&", "^"):
        return "conditions are joined by `and`, `∧` or a comma"
    if found == "<" and "COMPARISON" in expected:
        return "write `!=` for <>"
    if found in ("*", "?") and "PLUS" in expected:
        return "a part is repeated by `+`: write a second pattern for no event at all"
    if found.lower() == "seq" or (found == "(" and "PLUS" in expected):
        return "sequences do not nest: list all parts in one SEQ"
    if found == "/" and "RSQB" in expected:
        return "a unit is a product of powers: write `m.s-1` for m/s"
    if expected in ({"DURATION"}, {"DURATION", "VARIABLE"}):
        return 'write a duration with its unit, such as `12 hours`, `5s` or `"PT5S"^^xsd:duration`'
    return expected_hint(expected)


class _Reader(TermReader):
    """Converts trees of the grammar to the AST."""

    def __init__(self, source: str, tree: Tree[Token]) -> None:
        super().__init__(source)
        self._depth = self._operations = 0
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

    def registered(self, tree: Tree[Token]) -> ast.Pattern:
        *before, body = trees(tree)
        name = ""
        for each in before:
            if each.data == "symbol":
                written = self.symbol(each)
                iris = possible_iris(written.text, written.span, self._source)
                name = written.text if written.text.isidentifier() else iris[0]
        return self.pattern(body, name)

    def template(self, tree: Tree[Token]) -> ast.PatternTemplate:
        symbol, *rest, body = (each for each in trees(tree) if each.data != "prefix")
        name = self.symbol(symbol)
        iri = possible_iris(name.text, name.span, self._source)[0]
        slots: list[Slot] = []
        for each in rest:
            slots.append(self.slot(each, slots))
        self.check_defaults(slots)
        return ast.PatternTemplate(
            iri, tuple(slots), self.pattern(body, local_name(iri)), self._source
        )

    def pattern(self, tree: Tree[Token], name: str) -> ast.Pattern:
        found = {str(each.data): each for each in trees(tree)}
        parts = [each for each in trees(tree) if each.data in ("event", "negated")]
        strategy, where = self.where(found.get("where"))
        from_, within, limit, delay = (
            found.get(each) for each in ("from", "within", "limit", "delay")
        )
        return ast.Pattern(
            name,
            self.symbol(trees(from_)[0]) if from_ else None,
            tuple(map(self.part, parts)),
            strategy,
            where,
            self.within(tokens(within, "DURATION", "VARIABLE")[0]) if within else None,
            self.conditions(found["having"]) if "having" in found else (),
            tuple(map(self.item, trees(found["return"]))) if "return" in found else (),
            self.limit(tokens(limit, "DECIMAL")[0]) if limit else None,
            self.duration(tokens(delay, "DURATION")[0]) if delay else None,
            span_of(tree),
        )

    def part(self, tree: Tree[Token]) -> ast.Part:
        span, is_negated = span_of(tree), False
        while tree.data == "negated":
            if is_negated:
                raise self.error("a part is negated twice", span, "write `~` once, or not at all")
            tree, is_negated = trees(tree)[0], True
        plus, brackets = tokens(tree, "PLUS"), tokens(tree, "LSQB")
        name = tokens(tree, "NAME")[0]
        if brackets and not plus:
            raise self.error(
                f"`{name}[]` is a repeated part, but its type has no `+`",
                span_of(tree),
                f"write `+` after the type, or `{name}` for one event",
            )
        if plus and is_negated:
            raise self.error(
                "a negated part is not repeated",
                span_of(plus[0]),
                "omit `+`: no event at all is what `~` asks for",
            )
        types = tuple(map(self.symbol, trees(tree)))
        return ast.Part(types, str(name), is_negated, bool(plus), span)

    def where(
        self, tree: Tree[Token] | None
    ) -> tuple[ast.Strategy | None, tuple[ast.Condition, ...]]:
        if tree is None:
            return None, ()
        written = tokens(tree, "STRATEGY")
        strategy = ast.Strategy(str(written[0]).lower().replace("-", "_")) if written else None
        return strategy, self.conditions(tree)

    def within(self, token: Token) -> int | Variable:
        return self.variable(token) if token.type == "VARIABLE" else self.duration(token)

    def limit(self, token: Token) -> int:
        if not token.isdigit() or not 0 < float(token) <= _MOST_MATCHES:
            raise self.error(
                f"`{token}` is no number of matches",
                span_of(token),
                f"write a whole number from 1 to {_MOST_MATCHES}",
            )
        return int(token)

    def item(self, tree: Tree[Token]) -> ast.Item:
        term, *names = (child for child in tree.children if not _is_mark(child))
        self._operations = 0
        return ast.Item(self.term(term), str(names[0]) if names else None, span_of(tree))

    # -- conditions --------------------------------------------------------------------------

    def conditions(self, tree: Tree[Token]) -> tuple[ast.Condition, ...]:
        children = (child for child in tree.children if not _is_mark(child))
        return tuple(each for child in children for each in self.condition(child))

    def condition(self, node: _Node) -> Sequence[ast.Condition]:
        """One condition, or those of a parenthesis."""
        self._operations = 0
        match node:
            case Tree(data="comparison", children=[left, operator, right]):
                sign = _OPERATORS.get(str(operator), str(operator))
                sides = self.term(left), self.term(right)
                return [ast.Comparison(sign, *sides, span_of(node))]
            case Tree(data="equivalence", children=[name]):
                return [ast.Equivalence(str(name), None, span_of(node))]
            case Tree(data="equivalence", children=[name, operator, value]):
                if operator not in ("=", "=="):
                    raise self.error(
                        f"`[{name}]` is an equality",
                        span_of(operator),
                        f"write `a.{name} {operator} …` for each part",
                    )
                return [ast.Equivalence(str(name), self.term(value), span_of(node))]
            case Tree(data="group"):
                depth = self.deeper(node)
                found = self.conditions(node)
                self._depth = depth - 1
                return found
            case _:
                raise self.error(
                    "this is no condition",
                    span_of(node),
                    "compare it with something, such as `a.price > 100`",
                )

    def deeper(self, node: _Node) -> int:
        self._depth += 1
        if self._depth > DEEPEST:
            raise self.error(
                f"a condition is nested more than {DEEPEST} deep",
                span_of(node),
                "leave parentheses out, or divide the condition",
            )
        return self._depth

    # -- terms -------------------------------------------------------------------------------

    def term(self, node: _Node) -> ast.Term:
        if isinstance(node, Token):
            return self.leaf(node)
        depth = self.deeper(node)
        found = self.compound(node)
        self._depth = depth - 1
        return found

    def leaf(self, token: Token) -> ast.Term:
        span = span_of(token)
        match token.type:
            case "TRUE" | "FALSE":
                return Truth(token.type == "TRUE", span)
            case "VARIABLE":
                return self.variable(token)
            case "QUOTED":
                return self.text(token)
            case "SINGLE_QUOTED":
                return Text(str(token)[1:-1], span)
            case "PERCENT":
                return self.percentage(token)
            case "DURATION":
                return ast.Duration(self.duration(token), span)
            case _:
                try:
                    return TimePoint(parse_time(str(token)), span)
                except ValueError as error:
                    raise self.error(str(error), span, "") from None

    def percentage(self, token: Token) -> Number:
        value = float(token[:-1]) / 100
        if value == float("inf"):
            raise self.error("the number exceeds a double", span_of(token), "doubles reach 1.7e308")
        return Number(value, None, span_of(token))

    def compound(self, tree: Tree[Token]) -> ast.Term:
        children, span = tree.children, span_of(tree)
        match tree.data:
            case "sum" | "product":
                found = self.term(children[0])
                for sign, operand in zip(children[1::2], children[2::2], strict=True):
                    self.count_operation(tree)
                    found = ast.Arithmetic(str(sign), found, self.term(operand), span)
                return found
            case "signed":
                self.count_operation(tree)
                value = self.term(children[1])
                return value if children[0] == "+" else ast.Negative(value, span)
            case "quantity":
                return self.quantity(tree)
            case "measured":
                return self.measured(tree)
            case "symbol":
                return self.symbol(tree)
            case "attribute":
                name, *index, attribute = children
                return ast.Attribute(str(name), self.index(name, index), str(attribute), span)
            case "aggregate":
                return self.aggregate(tree)
            case "group" if len(children) == 1:
                return self.term(children[0])
            case _:
                raise self.error(
                    "this is a condition, and a value is wanted",
                    span,
                    "conditions are joined by `and`: `a.price > 1 and a.price < 2`",
                )

    def count_operation(self, tree: Tree[Token]) -> None:
        self._operations += 1
        if self._operations > MOST_OPERATIONS:
            raise self.error(
                f"a condition or result has more than {MOST_OPERATIONS} operations",
                span_of(tree),
                "divide it into several",
            )

    def index(self, part: _Node, written: Sequence[_Node]) -> ast.Index:
        match written:
            case []:
                return ast.Index.ONE
            case [Token(type=kind)]:
                return _INDEXES[kind]
            case [Tree() as last]:
                if last.children[0] != part:
                    raise self.error(
                        f"`{last.children[0]}.LEN` is the length of another part",
                        span_of(last),
                        f"the last event of `{part}` is `{part}[{part}.LEN]`",
                    )
        return ast.Index.LAST

    def aggregate(self, tree: Tree[Token]) -> ast.Aggregate | ast.CountMatches:
        function, first, *rest = tree.children
        span, word = span_of(tree), str(function).lower()
        if isinstance(first, Token) and first.type == "STAR":
            if word != "count":
                raise self.error(f"`{word}` needs an attribute", span, f"write `{word}(a[].price)`")
            return ast.CountMatches(span)
        is_named = bool(rest) and isinstance(rest[-1], Token) and rest[-1].type == "NAME"
        name = str(rest.pop()) if is_named else None
        index = self.index(first, rest)
        if index not in (ast.Index.ONE, ast.Index.ALL, ast.Index.BEFORE):
            raise self.error(
                f"`{first}{index}` is one event, and an aggregate is over several",
                span,
                f"write `{first}[]` for all events, `{first}[..i-1]` for those before",
            )
        if name is None and word != "count":
            raise self.error(
                f"`{word}` needs an attribute", span, f"write `{word}({first}[].price)`"
            )
        if name is not None and word == "count":
            raise self.error(
                "`count` counts events, not values", span, f"write `count({first}{index})`"
            )
        return ast.Aggregate(word, str(first), index, name, span)


_MARKS: Final = frozenset({"WHERE", "STRATEGY", "AND", "HAVING", "AS"})


def _is_mark(node: _Node) -> bool:
    """Whether a child says nothing in conditions and results. The names after a strategy repeat
    those of the parts."""
    return node.type in _MARKS if isinstance(node, Token) else bool(node.data == "names")
