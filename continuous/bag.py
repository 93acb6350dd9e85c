"""The bag on Oxigraph: a query text in which equal triples of a window count each.

A store is a set of quads. So the n-th of equal triples stands in the n-th *copy graph* too, and a
triple pattern P of the query becomes ``GRAPH ?g {P}`` with a variable of its own: it matches once
a copy. `oxigraph` fills the copies; the default graph holds each triple once.

What counts solutions as a set anyway stays as it is, on the default graph: ``?x a Sort`` (a set of
facts, docs/semantics.md), FILTER with EXISTS, MINUS, and the paths ``p*``, ``p+`` and ``p?``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from pyoxigraph import NamedNode

from ..languages.csparql.shape import constraint_end, query_shape
from ..languages.csparql.tokens import Kind, Token, closing
from ..rdf.namespaces import RDF_TYPE
from .unsupported import Unsupported

HIDDEN = "dyknow_copy_"
"""Variables of copy graphs begin with this; ``SELECT *`` would show them."""
_TERMS = (Kind.IRI, Kind.PREFIXED, Kind.VARIABLE, Kind.BLANK, Kind.NUMBER, Kind.STRING)


def copy_graph(number: int) -> NamedNode:
    """The graph of the ``number``-th (from 0) of equal triples."""
    return NamedNode(f"urn:dyknow:copy:{number}")


def counting(sparql: str) -> str:
    """The query with each triple pattern asked of the copy graphs.

    Raises `Unsupported` for what this does not cover: GRAPH, other paths, collections and ``[]``,
    DISTINCT over ``*``. Cost: one pass over the tokens.
    """
    shape = query_shape(sparql)
    if shape is None or not shape.has_where:
        raise Unsupported("a query without WHERE")
    if shape.is_short_construct:
        # A graph of triples as they are: there is nothing to count.
        return sparql
    for before, token in pairwise(shape.tokens):
        if before.is_word("DISTINCT", "REDUCED") and token.is_mark("*"):
            raise Unsupported("DISTINCT over *")
    reader = _Rewriter(sparql, shape.tokens)
    place = shape.tokens[shape.where_open].start
    end = shape.tokens[shape.where_close].end
    return sparql[:place] + reader.group(shape.where_open) + sparql[end:]


class _Rewriter:
    def __init__(self, sparql: str, tokens: Sequence[Token]) -> None:
        self.sparql = sparql
        self.tokens = tokens
        self.patterns = 0
        self.prefixes = {
            name.text[:-1]: iri.text[1:-1]
            for word, name, iri in zip(tokens, tokens[1:], tokens[2:], strict=False)
            if word.is_word("PREFIX") and name.kind is Kind.PREFIXED
        }

    def group(self, open: int) -> str:
        """The group whose brace is ``tokens[open]``, rewritten."""
        close = closing(self.tokens, open)
        return "{ " + " ".join(self.parts(open + 1, close)) + " }"

    def parts(self, at: int, close: int) -> Iterator[str]:
        tokens = self.tokens
        while at < close:
            token = tokens[at]
            if token.is_word("GRAPH", "SERVICE"):
                raise Unsupported(token.text.upper())
            if token.is_word("SELECT"):
                where = at
                while not tokens[where].is_mark("{"):
                    where = closing(tokens, where) if tokens[where].is_mark("(") else where
                    where += 1
                yield self.text(at, where)
                yield self.group(where)
                yield self.text(closing(tokens, where) + 1, close)
                return
            end = self.opaque_end(at)
            if end is not None:
                yield self.text(at, end)
                at = end
            elif token.is_mark("{"):
                yield self.group(at)
                at = closing(tokens, at) + 1
            elif token.is_mark(".") or token.is_word("UNION", "OPTIONAL"):
                # A pattern's dot is written with the pattern.
                if not token.is_mark("."):
                    yield token.text
                at += 1
            else:
                end = at
                while end < close and not self.ends_block(end):
                    end += 1
                yield from self.block(at, end)
                at = end

    def opaque_end(self, at: int) -> int | None:
        """Where a part ends that stays as it is; None if ``tokens[at]`` begins none."""
        tokens = self.tokens
        if tokens[at].is_word("FILTER"):
            return constraint_end(tokens, at + 1)
        if tokens[at].is_word("BIND", "MINUS"):
            return closing(tokens, at + 1) + 1
        if tokens[at].is_word("VALUES"):
            data = at + 1
            if tokens[data].is_mark("("):
                data = closing(tokens, data)
            return closing(tokens, data + 1) + 1
        return None

    def ends_block(self, at: int) -> bool:
        token = self.tokens[at]
        return token.is_mark(".", "{", "}") or token.is_word(
            "FILTER", "BIND", "MINUS", "VALUES", "OPTIONAL", "UNION", "GRAPH", "SERVICE"
        )

    def block(self, at: int, end: int) -> Iterator[str]:
        """``s p o, o2; p2 o3`` as one pattern each."""
        subject, at = self.term(at, end)
        while at < end:
            verb, at = at, self.verb_end(at)
            counts = self.counts(self.tokens[verb:at])
            predicate = self.text(verb, at)
            while True:
                object, at = self.term(at, end)
                yield self.pattern(f"{subject} {predicate} {object}", counts)
                if at < end and self.tokens[at].is_mark(","):
                    at += 1
                    continue
                break
            while at < end and self.tokens[at].is_mark(";"):
                at += 1

    def verb_end(self, at: int) -> int:
        """The index after the predicate or path at ``at`` (SPARQL 1.1 [88]-[96])."""
        tokens = self.tokens
        while True:
            while tokens[at].is_mark("^", "!"):
                at += 1
            at = closing(tokens, at) + 1 if tokens[at].is_mark("(") else at + 1
            if tokens[at].is_mark("*", "+", "?") and not self.is_sign(at):
                at += 1
            if not tokens[at].is_mark("/", "|"):
                return at
            at += 1

    def is_sign(self, at: int) -> bool:
        """Whether a plus belongs to the number after it."""
        number = self.tokens[at + 1]
        return number.kind is Kind.NUMBER and number.start == self.tokens[at].end

    def counts(self, verb: Sequence[Token]) -> bool:
        """Whether a pattern with this predicate matches once a copy."""
        first = verb[0]
        if len(verb) == 1 and (first.kind in _TERMS or first.text == "a"):
            return first.text != "a" and not self.is_type(first)
        if len(verb) == 2 and first.kind in _TERMS and verb[1].is_mark("*", "+", "?"):
            return False
        raise Unsupported("a property path")

    def is_type(self, token: Token) -> bool:
        if token.kind is not Kind.PREFIXED:
            return token.text == f"<{RDF_TYPE.value}>"
        prefix, _, local = token.text.partition(":")
        return self.prefixes.get(prefix, "") + local == RDF_TYPE.value

    def pattern(self, text: str, counts: bool) -> str:
        if not counts:
            return f"{text} ."
        self.patterns += 1
        return f"GRAPH ?{HIDDEN}{self.patterns} {{ {text} }}"

    def term(self, at: int, end: int) -> tuple[str, int]:
        """The term at ``at``, and where it ends. A blank node is a variable that nobody sees."""
        start = at
        token = self.tokens[at]
        if token.is_mark("+", "-"):
            at += 1
        elif not (token.kind in _TERMS or token.is_word("TRUE", "FALSE")):
            raise Unsupported(f"`{token.text}` in a pattern")
        at += 1
        if token.kind is Kind.BLANK:
            return f"?{HIDDEN}{token.text[2:].replace('.', '_').replace('-', '_')}_", at
        if at < end and self.tokens[at].kind is Kind.LANGUAGE:
            at += 1
        elif at < end and self.tokens[at].is_mark("^^"):
            at += 2
        return self.text(start, at), at

    def text(self, at: int, end: int) -> str:
        """The tokens from ``at`` to before ``end`` as they were written."""
        if at >= end:
            return ""
        return self.sparql[self.tokens[at].start : self.tokens[end - 1].end]
