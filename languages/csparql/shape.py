"""The shape of a SPARQL query on its tokens: head, WHERE group, modifiers, scopes of variables.

Rewriting (`body`) and checking (`parser`) both need to know where things stand, not what they
compute; so this is less than a parser, and works on offsets of the user's own text.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from ..remembered import remembered
from .ast import Form
from .tokens import Kind, Token, closing, tokenize

AGGREGATES: Final = ("COUNT", "SUM", "AVG", "MIN", "MAX", "SAMPLE", "GROUP_CONCAT")
_FORMS: Final = tuple(form.value for form in Form)
_MODIFIERS: Final = ("GROUP", "HAVING", "ORDER", "LIMIT", "OFFSET", "VALUES")


@dataclass(frozen=True, slots=True)
class Shape:
    """Where the parts of a (sub-)query stand; all are indexes into ``tokens``.

    ``start`` is the form keyword. The WHERE group is ``tokens[where_open]`` (its brace) to
    ``tokens[where_close]``; both are ``end`` where a DESCRIBE has none. ``end`` is exclusive.
    """

    tokens: tuple[Token, ...]
    form: Form
    start: int
    where_open: int
    where_close: int
    end: int

    @property
    def has_where(self) -> bool:
        return self.where_open < self.end

    @property
    def head(self) -> tuple[Token, ...]:
        """After the form keyword up to the WHERE group (without the word WHERE)."""
        head = self.tokens[self.start + 1 : self.where_open]
        return head[:-1] if head and head[-1].is_word("WHERE") else head

    @property
    def where(self) -> tuple[Token, ...]:
        """The tokens inside the WHERE group's braces."""
        return self.tokens[self.where_open + 1 : self.where_close]

    def modifier(self, word: str) -> tuple[Token, ...]:
        """The tokens of ``GROUP``, ``HAVING``, ``ORDER`` … from the keyword on; empty if none."""
        start = None
        for index in range(self.where_close + 1, self.end):
            token = self.tokens[index]
            if start is None:
                if token.is_word(word):
                    start = index
            elif token.is_word(*_MODIFIERS) and index > start:
                return self.tokens[start:index]
        return () if start is None else self.tokens[start : self.end]

    @property
    def is_short_construct(self) -> bool:
        """``CONSTRUCT WHERE { … }``: the pattern is the template too."""
        return self.form is Form.CONSTRUCT and not self.head

    @property
    def selects_all(self) -> bool:
        return any(token.is_mark("*") for token in self.head[:2]) and self.form in (
            Form.SELECT,
            Form.DESCRIBE,
        )

    @property
    def is_aggregated(self) -> bool:
        """True if the solutions are grouped: GROUP BY, HAVING or an aggregate in the head."""
        if self.modifier("GROUP") or self.modifier("HAVING"):
            return True
        head = self.head
        return self.form is Form.SELECT and any(
            token.is_word(*AGGREGATES) and after.is_mark("(") for token, after in pairwise(head)
        )

    def aliases(self) -> dict[str, tuple[Token, ...]]:
        """``(expression AS ?v)`` of a SELECT head: name -> the expression's tokens, in order."""
        found: dict[str, tuple[Token, ...]] = {}
        if self.form is not Form.SELECT:
            return found
        head = self.head
        index = 0
        while index < len(head):
            if head[index].is_mark("("):
                end = closing(head, index)
                if end - index >= 4 and head[end - 2].is_word("AS"):
                    found[_name(head[end - 1])] = head[index + 1 : end - 2]
                index = end
            index += 1
        return found

    def head_variables(self) -> dict[str, Token]:
        """Variables that the head uses and does not define, with their first token."""
        defined = self.aliases()
        found: dict[str, Token] = {}
        tokens: Sequence[Token] = self.where if self.is_short_construct else self.head
        for token in tokens:
            if token.kind is Kind.VARIABLE and _name(token) not in defined:
                found.setdefault(_name(token), token)
        return found


def _name(token: Token) -> str:
    return token.text[1:]


@remembered
def query_shape(sparql: str) -> Shape | None:
    """The shape of a whole query; None if it has no form keyword or no WHERE group."""
    tokens = tokenize(sparql)
    start = next((i for i, t in enumerate(tokens) if t.is_word(*_FORMS)), None)
    return None if start is None else read_shape(tokens, start, len(tokens))


def read_shape(tokens: tuple[Token, ...], start: int, end: int) -> Shape | None:
    """The shape of the (sub-)query in ``tokens[start:end]``."""
    form = Form(tokens[start].text.upper())
    index = start + 1
    if form is Form.CONSTRUCT and index < end and tokens[index].is_mark("{"):
        index = closing(tokens, index) + 1
    while index < end and not tokens[index].is_mark("{"):
        if tokens[index].is_mark("(", "["):
            index = closing(tokens, index)
        index += 1
    if index >= end:
        return Shape(tokens, form, start, end, end, end) if form is Form.DESCRIBE else None
    return Shape(tokens, form, start, index, closing(tokens, index), end)


@dataclass(frozen=True, slots=True)
class Group:
    """A group graph pattern: its braces, and the variables of its own tokens.

    ``names`` leaves out nested groups, which are groups of their own, but not EXISTS, which sees
    the solutions of the group it stands in. ``word`` is the keyword before the brace (OPTIONAL,
    MINUS, GRAPH …) or "". ``select`` is set where the group is a sub-query.
    """

    open: int
    close: int
    word: str
    names: frozenset[str]
    select: Shape | None


def groups(tokens: tuple[Token, ...], open: int) -> Iterator[Group]:
    """The group whose brace is ``tokens[open]`` and every group inside it, outermost first."""
    close = closing(tokens, open)
    word = _group_word(tokens, open)
    if tokens[open + 1].is_word("SELECT"):
        select = read_shape(tokens, open + 1, close)
        if select is not None:
            names = {
                _name(t)
                for i in (*range(open + 1, select.where_open), *range(select.where_close, close))
                if (t := tokens[i]).kind is Kind.VARIABLE
            }
            yield Group(open, close, word, frozenset(names), select)
            yield from groups(tokens, select.where_open)
            return
    names = set()
    nested: list[int] = []
    index = open + 1
    while index < close:
        token = tokens[index]
        if token.kind is Kind.VARIABLE:
            names.add(_name(token))
        elif token.is_mark("{") and _is_pattern(tokens, index):
            nested.append(index)
            index = closing(tokens, index)
        index += 1
    yield Group(open, close, word, frozenset(names), None)
    for start in nested:
        yield from groups(tokens, start)


def _group_word(tokens: Sequence[Token], open: int) -> str:
    before = tokens[open - 1] if open else None
    return before.text.upper() if before is not None and before.kind is Kind.WORD else ""


def _is_pattern(tokens: Sequence[Token], open: int) -> bool:
    """False for the data of VALUES and for EXISTS groups."""
    before = tokens[open - 1]
    if before.is_word("EXISTS"):
        return False
    if before.kind is Kind.VARIABLE:
        return not tokens[open - 2].is_word("VALUES")
    if before.is_mark(")"):
        index = open - 1
        while not tokens[index].is_mark("("):
            index -= 1
        return not tokens[index - 1].is_word("VALUES")
    return True


def bound_variables(tokens: tuple[Token, ...], open: int) -> set[str]:
    """Variables that the group's patterns may bind: not those in FILTER and MINUS only."""
    close = closing(tokens, open)
    index = open + 1
    if tokens[index].is_word("SELECT"):
        select = read_shape(tokens, index, close)
        if select is not None:
            if select.selects_all:
                return bound_variables(tokens, select.where_open)
            plain = _outside_brackets(select.head)
            return plain | set(select.aliases())
    found: set[str] = set()
    while index < close:
        token = tokens[index]
        if token.is_word("FILTER"):
            index = constraint_end(tokens, index + 1)
            continue
        if token.is_word("MINUS") and tokens[index + 1].is_mark("{"):
            index = closing(tokens, index + 1)
        elif token.is_word("BIND") and tokens[index + 1].is_mark("("):
            end = closing(tokens, index + 1)
            if tokens[end - 1].kind is Kind.VARIABLE:
                found.add(_name(tokens[end - 1]))
            index = end
        elif token.is_mark("{") and _is_pattern(tokens, index):
            found |= bound_variables(tokens, index)
            index = closing(tokens, index)
        elif token.kind is Kind.VARIABLE:
            found.add(_name(token))
        index += 1
    return found


def _outside_brackets(tokens: Sequence[Token]) -> set[str]:
    found: set[str] = set()
    index = 0
    while index < len(tokens):
        if tokens[index].is_mark("("):
            index = closing(tokens, index)
        elif tokens[index].kind is Kind.VARIABLE:
            found.add(_name(tokens[index]))
        index += 1
    return found


def constraint_end(tokens: Sequence[Token], index: int) -> int:
    """The index after the constraint at ``index``: ``(…)``, ``f(…)`` or ``[NOT] EXISTS {…}``."""
    while index < len(tokens) and not tokens[index].is_mark("(", "{"):
        if tokens[index].is_mark("}", ")", "]"):
            return index
        index += 1
    return closing(tokens, index) + 1 if index < len(tokens) else index
