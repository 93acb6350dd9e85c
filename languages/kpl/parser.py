"""Text to KPL declarations ([DyKnow10 §5.2], SPEC §1). The grammar is `kpl.lark`.

Names are not resolved here; `check` does that.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from functools import cache
from importlib import resources
from typing import Final

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedInput

from ...streams.policy import Approximation, Order
from ..errors import LanguageError, Span
from ..syntax import expected_hint, span_of, syntax_error, tokens, trees
from . import ast

KEYWORDS: Final = frozenset(
    [
        *("any", "approximation", "change", "compunit", "delay", "every", "from", "max"),
        *("monotone", "most", "no", "oo", "order", "recent", "sample", "source", "stream"),
        *("strict", "strmgen", "to", "update", "use", "with"),
    ]
)
"""Def. 5.12: no symbol is called like these. Our `unit` and `sort` are free as names."""

_EXPECTED: Final = {
    "NAME": "a name",
    "PREFIXED": "a name",
    "NUMBER": "a time",
    "TIME_POINT": "a time",
    "EQUAL": "`=`",
    "LPAR": "`(`",
    "RPAR": "`)`",
    "LSQB": "`[`",
    "RSQB": "`]`",
    "COMMA": "`,`",
    "SEMICOLON": "`;`",
    "$END": "the end",
}
_DECLARING: Final = frozenset({"SOURCE", "COMPUNIT", "STRMGEN", "STREAM", "SORT"})
_CONSTRAINING: Final = frozenset({"ANY", "SAMPLE", "MAX", "FROM", "TO", "STRICT", "NO", "USE"})
_BEGINNINGS: Final = frozenset({"monotone", *(word.lower() for word in _CONSTRAINING)})
_CONSTRAINTS: Final = (
    "a constraint is `any update`, `any change`, `sample every t`, `max delay t`, `from a to b`, "
    "`any order`, `monotone order`, `strict order`, `no approximation` or `use most recent`"
)


@cache
def _grammar() -> Lark:
    text = resources.files(__package__).joinpath("kpl.lark").read_text(encoding="utf-8")
    starts = ["start", "policy_text", "label_text"]
    return Lark(text, start=starts, parser="lalr", lexer="contextual", propagate_positions=True)


def parse_kpl(source: str) -> ast.Specification:
    """The declarations of a KPL text, in order; ``#`` and ``//`` start comments.

    Raises `LanguageError` for a text that the grammar refuses; the caret stands under the first
    thing that cannot be there.
    """
    nodes = trees(_parse(source, "start"))
    reader = _Reader(source)
    unit = None
    if nodes and nodes[0].data == "unit_decl":
        unit = reader.name(tokens(nodes.pop(0), "NAME")[0])
    return ast.Specification(unit, tuple(map(reader.declaration, nodes)))


def parse_constraints(source: str) -> tuple[ast.Constraint, ...]:
    """The constraints of a policy by itself: ``sample every 200, max delay 50``; may be none."""
    return _Reader(source).constraints(trees(_parse(source, "policy_text")))


def parse_label_term(source: str) -> ast.LabelTerm:
    """A label by itself: ``pos[car1]``."""
    return _Reader(source).label(trees(_parse(source, "label_text"))[0])


def _parse(source: str, start: str) -> Tree[Token]:
    try:
        return _grammar().parse(source, start=start)
    except UnexpectedInput as error:
        raise syntax_error(error, source, _syntax_hint) from None


def _syntax_hint(found: str, expected: AbstractSet[str]) -> str:
    declaring = bool(expected >= _DECLARING)
    if found == "unit" and declaring:
        return "`unit` stands once, before every declaration"
    if found == "." and declaring:
        return "nothing ends a declaration: leave the full stop out"
    if found.lower() in _BEGINNINGS and "WITH" in expected:
        return f"a policy begins with `with`: write `with {found} …`"
    if expected >= _CONSTRAINING:
        return _CONSTRAINTS
    if expected in ({"NAME"}, {"NAME", "PREFIXED"}):
        return "a name is a letter or `_`, then letters, digits and `_`"
    if declaring and expected <= {*_DECLARING, "UNIT", "$END"}:
        return "a declaration begins with `source`, `compunit`, `strmgen`, `stream` or `sort`"
    return expected_hint(expected, _EXPECTED)


class _Reader:
    """Trees of the grammar to the AST."""

    def __init__(self, source: str) -> None:
        self._source = source

    def name(self, token: Token) -> ast.Name:
        span = span_of(token)
        if token in KEYWORDS:
            raise LanguageError(
                f"`{token}` is a keyword of KPL, so nothing is called that",
                self._source,
                span,
                f"choose another name, `{token}_1` for example",
            )
        return ast.Name(str(token), span)

    def symbol(self, tree: Tree[Token]) -> ast.Name:
        return self.name(tokens(tree)[0])

    def declaration(self, tree: Tree[Token]) -> ast.Declaration:
        parts = trees(tree)
        names = [self.name(token) for token in tokens(tree, "NAME", "PREFIXED")]
        span = span_of(tree)
        match tree.data:
            case "source_decl":
                return ast.Source(names[0], names[1], span)
            case "compunit_decl":
                return ast.Compunit(names[0], names[1], tuple(map(self.symbol, parts)), span)
            case "strmgen_decl":
                label = self.label(parts[0])
                if len(parts) == 1:
                    return ast.Strmgen(label, names[0], (), (), span)
                terms, synchronization = self.arguments(trees(parts[1]))
                return ast.Strmgen(label, names[0], terms, synchronization, span)
            case "stream_decl":
                policy = self.constraints(parts[1:])
                start = span_of(parts[0]).start
                term = ast.StreamTerm(self.label(parts[0]), policy, Span(start, span.end))
                return ast.Stream(names[0], term, span)
            case _:
                (value,) = parts
                if value.data == "symbol":
                    return ast.Sort(names[0], self.symbol(value), span)
                fields = tuple(
                    (self.name(tokens(field, "NAME")[0]), self.symbol(trees(field)[0]))
                    for field in trees(value)
                )
                return ast.Sort(names[0], fields, span)

    def label(self, tree: Tree[Token]) -> ast.LabelTerm:
        symbol, *objects = trees(tree)
        named = tokens(objects[0], "NAME") if objects else []
        return ast.LabelTerm(self.symbol(symbol), tuple(map(self.name, named)), span_of(tree))

    def arguments(
        self, nodes: list[Tree[Token]]
    ) -> tuple[tuple[ast.StreamTerm, ...], tuple[ast.Constraint, ...]]:
        """Terms with all their constraints, and the constraints after ``;``."""
        terms: list[ast.StreamTerm] = []
        synchronization: tuple[ast.Constraint, ...] = ()
        for node in nodes:
            if node.data == "synchronized":
                synchronization = self.constraints(trees(node))
            elif node.data == "term":
                label, *policy = trees(node)
                term = ast.StreamTerm(self.label(label), self.constraints(policy), span_of(node))
                terms.append(term)
            else:
                constraint = self.constraint(node)
                last = terms.pop() if terms else None
                if last is None or not last.policy:
                    words = self._source[constraint.span.start : constraint.span.end]
                    raise LanguageError(
                        "a constraint stands here without a term that it belongs to",
                        self._source,
                        constraint.span,
                        f"a policy begins with `with`: write `label with {words}`",
                    )
                span = Span(last.span.start, constraint.span.end)
                terms.append(ast.StreamTerm(last.label, (*last.policy, constraint), span))
        return tuple(terms), synchronization

    def constraints(self, nodes: Iterable[Tree[Token]]) -> tuple[ast.Constraint, ...]:
        return tuple(map(self.constraint, nodes))

    def constraint(self, tree: Tree[Token]) -> ast.Constraint:
        span = span_of(tree)
        times = [self.time(node) for node in trees(tree)]
        to_oo = bool(tokens(tree, "OO"))
        match tree.data:
            case "any_update":
                return ast.Change("any update", None, span)
            case "any_change":
                return ast.Change("any change", None, span)
            case "sample_every":
                return ast.Change("sample every", times[0], span)
            case "max_delay":
                return ast.Delay(times[0] if times else None, span)
            case "from_to":
                return ast.Duration(times[0], times[1] if len(times) > 1 else None, to_oo, span)
            case "to":
                return ast.Duration(None, times[0] if times else None, to_oo, span)
            case "any_order" | "monotone_order" | "strict_order":
                return ast.Ordering(Order(tree.data.replace("_", " ")), span)
            case _:
                return ast.Approximating(Approximation(tree.data.replace("_", " ")), span)

    def time(self, tree: Tree[Token]) -> ast.Time:
        token = tokens(tree)[0]
        return ast.Time(str(token), span_of(token))
