"""Parses text to KPL declarations ([DyKnow10 §5.2], SPEC §1). The grammar is `kpl.lark`.

Names are not resolved here; `check` does that.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Set as AbstractSet
from typing import Final

from lark import Token, Tree
from lark.exceptions import UnexpectedInput

from ...streams.policies.policy import Approximation, Order
from ...streams.sample import LONGEST_NAME
from ..errors import LanguageError, Span
from ..hints import did_you_mean, or_list
from ..syntax import (
    TERMINALS,
    check_names,
    expected_hint,
    grammar,
    span_of,
    syntax_error,
    tokens,
    trees,
    unquoted,
)
from ..text_cache import TextCache
from . import ast

_STARTS: Final = ("start", "policy_text", "label_text")
_LONGEST_LABEL: Final = 5 * LONGEST_NAME
_DECLARATIONS: Final = ("source", "compunit", "strmgen", "stream", "sort", "foreach", "sink")
_DECLARING: Final = frozenset(word.upper() for word in _DECLARATIONS)
_CONSTRAINING: Final = frozenset({"ANY", "SAMPLE", "MAX", "FROM", "TO", "STRICT", "NO", "USE"})
_BEGINNINGS: Final = frozenset({"monotone", *(word.lower() for word in _CONSTRAINING)})
_CONSTRAINTS: Final = (
    "a constraint is `any update`, `any change`, `sample every t`, `max delay t`, `from a to b`, "
    "`any order`, `monotone order`, `strict order`, `no approximation` or `use most recent`"
)

_TERMS: Final = "a term is a label, `pos[car1]`, or one with a policy: `pos[car1] with any change`"
_BLOCK: Final = "a `foreach` contains generators, `strmgen speed[car] = …`, and ends with `}`"
_FOR_EACH_OBJECT: Final = {
    "source_decl": "declare the source before it: one serves the streams of every object",
    "compunit_decl": "declare the computational unit before it: one serves every object",
    "sort_decl": "declare the sort before it",
    "stream_decl": "a stream has one name: declare `strmgen speed[car] = …`, whose label varies",
    "sink_decl": "a sink has one name: give it `aggregate(speed[car] foreach car in cars)`",
    "foreach_decl": "declare generators of two objects with `aggregate(… foreach … in …)` in one",
}


@TextCache
def parse_kpl(source: str) -> ast.Specification:
    """Parse the declarations of a KPL text, in order; ``#`` and ``//`` start comments.

    Raises `LanguageError` for a text that the grammar refuses; the caret marks the first wrong
    token. The last texts are cached: the service parses a text in another thread first, then the
    engine finds it.
    """
    nodes = trees(_parse(source, "start"))
    reader = _Reader(source)
    unit = None
    if nodes and nodes[0].data == "unit_decl":
        unit = reader.name(tokens(nodes.pop(0), "NAME")[0])
    return ast.Specification(unit, tuple(map(reader.declaration, nodes)))


def parse_constraints(source: str) -> tuple[ast.Constraint, ...]:
    """Parse the constraints of a single policy: ``sample every 200, max delay 50``; may be none."""
    return _Reader(source).constraints(trees(_parse(source, "policy_text")))


def parse_label_term(source: str) -> ast.LabelTerm:
    """Parse a single label: ``pos[car1]``."""
    return _Reader(source).label(trees(_parse(source, "label_text"))[0])


def read_constraint(tree: Tree[Token], source: str) -> ast.Constraint:
    """Read the node of a constraint, also of another grammar with KPL's names of them."""
    return _Reader(source).constraint(tree)


def _parse(source: str, start: str) -> Tree[Token]:
    try:
        tree = grammar("kpl/kpl.lark", *_STARTS).parse(source, start=start)
    except UnexpectedInput as error:
        history = getattr(error, "token_history", None)
        before = history[-1] if history else None
        if before is not None and before.type == "NAME" and before in ast.KEYWORDS:
            # The parser took the keyword for a name and failed at the next word.
            raise _keyword_error(before, source) from None

        def hint(found: str, expected: AbstractSet[str]) -> str:
            if before is not None and before.type == "WITH" and found in ("", ")", *_DECLARATIONS):
                return "a constraint follows `with`; without one leave `with` out"
            return _syntax_hint(found, expected)

        raise syntax_error(error, source, hint) from None
    check_names(tree, source)
    return tree


def _syntax_hint(found: str, expected: AbstractSet[str]) -> str:
    declaring = bool(expected >= _DECLARING)
    if found == "unit" and declaring:
        return "`unit` is allowed once, before all declarations"
    if found == "." and declaring:
        return "nothing ends a declaration: leave the full stop out"
    if found.lower() in _BEGINNINGS and "WITH" in expected:
        return f"a policy begins with `with`: write `with {found} …`"
    if declaring and "RBRACE" in expected:
        return _BLOCK
    words = {name.lower() for name in expected if name not in TERMINALS}
    meant = did_you_mean(found, words) if found.isidentifier() else ""
    if meant:
        return meant
    if expected >= _CONSTRAINING:
        return _TERMS if "NAME" in expected else _CONSTRAINTS
    if expected in ({"NAME"}, {"NAME", "PREFIXED"}):
        return "a name is a letter or `_`, then letters, digits and `_`"
    if declaring and expected <= {*_DECLARING, "UNIT", "$END"}:
        return f"a declaration begins with {or_list([f'`{word}`' for word in _DECLARATIONS])}"
    return expected_hint(expected)


def _keyword_error(token: Token, source: str, quoted: bool = False) -> LanguageError:
    hint = f"choose another name, `{token}_1` for example"
    if quoted:
        hint = f'an object of this name is written in quotes: `"{token}"`'
    elif token in _DECLARATIONS:
        hint += "; if a declaration begins here, a name is missing before it"
    return LanguageError(
        f"`{token}` is a keyword of KPL and not allowed as a name", source, span_of(token), hint
    )


class _Reader:
    """Converts trees of the grammar to the AST."""

    def __init__(self, source: str) -> None:
        self._source = source

    def name(self, token: Token) -> ast.Name:
        if token in ast.KEYWORDS:
            raise _keyword_error(token, self._source)
        return ast.Name(str(token), span_of(token))

    def object(self, token: Token) -> ast.Name:
        span = span_of(token)
        if token.type != "STRING":
            if token in ast.KEYWORDS:
                raise _keyword_error(token, self._source, quoted=True)
            return ast.Name(str(token), span)
        return ast.Name(unquoted(token, self._source), span)

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
                return self.strmgen(tree)
            case "stream_decl":
                return ast.Stream(names[0], self.term(parts[0], parts[1:]), span)
            case "foreach_decl":
                return self.foreach(tree, names[0])
            case "sink_decl":
                return ast.Sink(names[0], self.sink_inputs(parts[0]), span)
            case _:
                (value,) = parts
                if value.data == "symbol":
                    return ast.Sort(names[0], self.symbol(value), span)
                fields = tuple(
                    (self.name(tokens(field, "NAME")[0]), self.symbol(trees(field)[0]))
                    for field in trees(value)
                )
                return ast.Sort(names[0], fields, span)

    def strmgen(self, tree: Tree[Token]) -> ast.Strmgen:
        label, *arguments = trees(tree)
        name, span = self.name(tokens(tree, "NAME")[0]), span_of(tree)
        if not arguments:
            return ast.Strmgen(self.label(label), name, (), (), None, span)
        items, last = self.split(arguments[0])
        if last is not None and last.data == "mediated":
            mediation = self.mediation(items, last)
            return ast.Strmgen(self.label(label), name, (), (), mediation, span)
        is_timed = last is not None and last.data == "timed"
        synchronization = self.constraints(trees(last)) if last is not None else ()
        terms = self.terms(items)
        return ast.Strmgen(self.label(label), name, terms, synchronization, None, span, is_timed)

    def mediation(self, items: list[Tree[Token]], tree: Tree[Token]) -> ast.Mediation:
        pattern = self.one_term(items, "the pattern of a mediation")
        members = self.one_term(trees(trees(tree)[0]), "the term that names the objects")
        variable = self.name(tokens(tree, "NAME")[0])
        return ast.Mediation(pattern, variable, members, span_of(tree))

    def foreach(self, tree: Tree[Token], variable: ast.Name) -> ast.Foreach:
        label, *policy, block = trees(tree)
        generators = []
        for node in trees(block):
            if node.data != "strmgen_decl":
                raise LanguageError(
                    "a `foreach` declares generators only",
                    self._source,
                    span_of(tokens(node)[0]),
                    _FOR_EACH_OBJECT[str(node.data)],
                )
            generators.append(self.strmgen(node))
        members = self.term(label, policy)
        return ast.Foreach(variable, members, tuple(generators), span_of(tree))

    def sink_inputs(self, tree: Tree[Token]) -> tuple[ast.StreamTerm, ...]:
        items, last = self.split(tree)
        if last is not None:
            raise LanguageError(
                "the inputs of a sink are streams only",
                self._source,
                span_of(last),
                "declare a generator, `strmgen LABEL = …`, and name its label here",
            )
        return self.terms(items)

    def label(self, tree: Tree[Token]) -> ast.LabelTerm:
        symbol, *objects = trees(tree)
        named = tokens(objects[0]) if objects else []
        found = ast.LabelTerm(self.symbol(symbol), tuple(map(self.object, named)), span_of(tree))
        if found.span.end - found.span.start > _LONGEST_LABEL:
            raise LanguageError(
                f"a label has at most {_LONGEST_LABEL} characters",
                self._source,
                found.span,
                "declare several streams, each of some of its objects",
            )
        return found

    def split(self, tree: Tree[Token]) -> tuple[list[Tree[Token]], Tree[Token] | None]:
        """Split arguments into terms with constraints, and the clause after them."""
        nodes = trees(tree)
        last = nodes.pop() if nodes[-1].data in ("synchronized", "mediated", "timed") else None
        return nodes, last

    def term(self, label: Tree[Token], policy: Iterable[Tree[Token]]) -> ast.StreamTerm:
        constraints = self.constraints(policy)
        span = span_of(label)
        end = constraints[-1].span.end if constraints else span.end
        return ast.StreamTerm(self.label(label), constraints, Span(span.start, end))

    def terms(self, nodes: Iterable[Tree[Token]]) -> tuple[ast.StreamTerm, ...]:
        """Give each term all its constraints: a constraint belongs to the term before it, if that
        has one already."""
        groups: list[list[Tree[Token]]] = []
        for node in nodes:
            if node.data == "term":
                groups.append(trees(node))
            elif groups and len(groups[-1]) > 1:
                groups[-1].append(node)
            else:
                span = span_of(node)
                words = self._source[span.start : span.end]
                raise LanguageError(
                    "this constraint belongs to no term",
                    self._source,
                    span,
                    f"a policy begins with `with`: write `label with {words}`",
                )
        return tuple(self.term(label, policy) for label, *policy in groups)

    def one_term(self, nodes: Iterable[Tree[Token]], what: str) -> ast.StreamTerm:
        term, *more = self.terms(nodes)
        if more:
            raise LanguageError(
                f"{what} is a single term", self._source, more[0].span, "leave this one out"
            )
        return term

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
            case "change_by":
                return ast.Change("change by", None, span, str(tokens(tree, "NUMBER")[0]))
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
