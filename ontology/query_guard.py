"""What a user's SPARQL text may ask for (DESIGN §4).

Checked before Oxigraph sees the text: its optimizer takes minutes over a path of a thousand steps,
and SERVICE and LOAD would reach out. The text is only split into tokens here; whether it is
SPARQL at all, Oxigraph's own parser says.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, TypeAlias
from typing import Literal as OneOf

from ..rdf.sparql import check_sparql
from .errors import QueryRefused
from .query_syntax import explained
from .turtle import ALL_PREFIXES

LONGEST_TEXT: Final = 8 * 1024
"""Bytes of UTF-8."""
DEEPEST: Final = 64
"""Brackets of any kind inside each other."""
MOST_PATTERNS: Final = 64
"""Triple patterns; each step of a property path counts as one."""

MOST_NEGATIONS: Final = 64
"""``!`` after each other: the parsers behind us recurse."""

QueryForm: TypeAlias = OneOf["select", "construct", "describe", "ask"]

_UPDATES: Final = frozenset(
    {"LOAD", "INSERT", "DELETE", "CLEAR", "DROP", "CREATE", "ADD", "MOVE", "COPY", "WITH"}
)
# After these words, terms up to the next closing bracket belong to no triple pattern.
_EXPRESSIONS: Final = frozenset({"FILTER", "BIND", "GRAPH"})
# After these, terms up to the next brace belong to none.
_CLAUSES: Final = frozenset(
    {"SELECT", "GROUP", "ORDER", "HAVING", "LIMIT", "OFFSET", "VALUES", "FROM", "DESCRIBE"}
)
_TERMS: Final = frozenset({"iri", "name", "variable", "string", "number", "blank"})

_TOKEN: Final = re.compile(
    r"(?P<comment>#[^\n]*)"
    r"|(?P<iri><[^<>\"{}|^`\\\x00-\x20]*>)"
    r'|(?P<string>"""(?:[^"\\]|\\.|"(?!""))*"""' + r"|'''(?:[^'\\]|\\.|'(?!''))*'''"
    r'|"(?:[^"\\\n\r]|\\.)*"' + r"|'(?:[^'\\\n\r]|\\.)*')"
    r"|(?P<blank>_:[\w][\w.-]*)"
    r"|(?P<name>(?:[^\W\d_][\w.-]*)?:(?:[\w:-]|%[0-9A-Fa-f]{2}|\\.|\.(?=[\w:.%\\-]))*)"
    r"|(?P<variable>[?$]\w+)"
    r"|(?P<language>@[A-Za-z]+(?:-[A-Za-z0-9]+)*)"
    r"|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)"
    r"|(?P<word>[^\W\d]\w*)"
    r"|(?P<space>\s+)"
    r"|(?P<mark>\^\^|.)",
    re.DOTALL,
)


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    text: str
    start: int


def check_user_query(text: str) -> None:
    """Returns if ``text`` is a SPARQL 1.1 query that may be evaluated.

    Raises `QueryRefused` with line, column and hint for SERVICE, LOAD and every update, for texts
    over 8 KiB, 64 levels of brackets or 64 triple patterns, and for syntax errors. The shared
    prefixes and ``:`` need no declaration. Cost: linear in the text, and one parse.
    """
    query_form(text)


def query_form(text: str) -> QueryForm:
    """Checks ``text`` like `check_user_query` and says what kind of answer it has."""
    form = check_bounds(text)
    if form is None:
        raise QueryRefused(
            "the text asks nothing: SELECT, ASK, CONSTRUCT or DESCRIBE is missing",
            1,
            1,
            "such as SELECT * { ?s ?p ?o } LIMIT 10",
        )
    try:
        check_sparql(text, ALL_PREFIXES)
    except SyntaxError as error:
        raise syntax_refusal(text, error) from error
    return form


def check_bounds(text: str) -> QueryForm | None:
    """What of `query_form` needs no parser: words, prefixes and sizes. What passes is small enough
    to be parsed, and may be no SPARQL. None where the text asks nothing. Cost: linear."""
    if len(text.encode("utf-8", "surrogatepass")) > LONGEST_TEXT:
        raise QueryRefused(f"the query has more than {LONGEST_TEXT} bytes", 1, 1)
    tokens = list(_tokens(text))
    _check_words(text, tokens)
    _check_prefixes(text, tokens)
    _check_size(text, tokens, MOST_PATTERNS)
    for token in tokens:
        word = token.text.lower() if token.kind == "word" else ""
        if word in ("select", "construct", "describe", "ask"):
            return word  # type: ignore[return-value]
    return None


def check_size(text: str, patterns: int) -> None:
    """Raises `QueryRefused` for a SPARQL text with more triple patterns than ``patterns``, brackets
    more than `DEEPEST` deep or more than `MOST_NEGATIONS` negations after each other. Steps and
    alternatives of property paths count as triple patterns."""
    tokens = list(_tokens(text))
    _check_size(text, tokens, patterns)
    for number, token in enumerate(t for t in tokens if _is_alternative(text, t)):
        if number >= patterns:
            raise _refusal(text, token, f"the query has more than {patterns} alternatives")


def _is_alternative(text: str, token: _Token) -> bool:
    around = text[max(0, token.start - 1) : token.start + 2]
    return token.text == "|" and "||" not in around


def _tokens(text: str) -> Iterator[_Token]:
    for match in _TOKEN.finditer(text):
        kind = match.lastgroup
        if kind is not None and kind not in ("comment", "space"):
            yield _Token(kind, match[0], match.start())


def _check_words(text: str, tokens: list[_Token]) -> None:
    for token in tokens:
        if token.kind != "word":
            continue
        word = token.text.upper()
        if word == "SERVICE":
            raise _refusal(
                text,
                token,
                "SERVICE is refused: nothing outside this service is asked",
                "load the data as an ontology, then ask for it here",
            )
        if word in _UPDATES:
            raise _refusal(
                text,
                token,
                f"{word} is refused: this is the place of queries, not of updates",
                "ontologies, templates and annotations have routes of their own",
            )


def _check_prefixes(text: str, tokens: list[_Token]) -> None:
    declared = set(ALL_PREFIXES)
    for before, token in zip([None, *tokens], tokens, strict=False):
        if token.kind != "name":
            continue
        prefix = token.text.partition(":")[0]
        if before is not None and before.kind == "word" and before.text.upper() == "PREFIX":
            declared.add(prefix)
        elif prefix not in declared:
            raise _refusal(
                text,
                token,
                f"the prefix {prefix}: is not declared",
                f"put PREFIX {prefix}: <...> before the query",
            )


@dataclass(slots=True)
class _Level:
    """Inside one bracket. ``idle``: the next term begins a triple pattern."""

    opener: str
    idle: bool
    expression: bool = False
    clause: bool = False
    data: bool = False


def _check_size(text: str, tokens: list[_Token], most: int) -> None:
    _check_negations(text, tokens)
    levels = [_Level("", idle=False, clause=True)]
    patterns = 0
    values = False
    previous: _Token | None = None
    for token in tokens:
        level = levels[-1]
        word = token.text.upper() if token.kind == "word" else ""
        if token.kind == "mark" and token.text in "{[(":
            if token.text != "{" and level.idle:
                patterns += 1
                level.idle = False
            levels.append(_Level(token.text, idle=token.text != "(", data=values or level.data))
            # VALUES (?a ?b) { … }: the table ends with its brace.
            values = values and token.text != "{"
            if len(levels) - 1 > DEEPEST:
                raise _refusal(text, token, f"brackets are nested more than {DEEPEST} deep")
        elif token.kind == "mark" and token.text in "}])":
            if len(levels) > 1:
                levels.pop()
            outer = levels[-1]
            # A group or an expression has ended; after a node's brackets the pattern goes on.
            if token.text == "}" or (token.text == ")" and outer.expression):
                outer.expression = False
                outer.clause = False
                outer.idle = outer.opener in ("{", "[")
        elif word in _EXPRESSIONS:
            level.idle, level.expression = False, True
        elif word in _CLAUSES:
            level.idle, level.clause = False, True
            values = word == "VALUES"
        elif token.kind == "mark" and token.text in ".;," and level.opener in ("{", "["):
            level.idle = not (level.expression or level.clause or level.data)
        elif token.kind in _TERMS or word in ("A", "TRUE", "FALSE"):
            if level.idle and not level.data:
                patterns += 1
                level.idle = False
            elif level.opener == "(" and not level.data and previous and previous.kind in _TERMS:
                patterns += 2  # a list: each member is two triples
        elif token.kind == "mark" and token.text == "/":
            patterns += 1
        if patterns > most:
            raise _refusal(text, token, f"the query has more than {most} triple patterns")
        previous = token


def _check_negations(text: str, tokens: list[_Token]) -> None:
    run = 0
    for token in tokens:
        run = run + 1 if token.text == "!" else 0
        if run > MOST_NEGATIONS:
            raise _refusal(text, token, f"more than {MOST_NEGATIONS} negations after each other")


def _refusal(text: str, token: _Token, message: str, hint: str = "") -> QueryRefused:
    line = text.count("\n", 0, token.start) + 1
    column = token.start - text.rfind("\n", 0, token.start)
    return QueryRefused(message, line, column, hint)


def syntax_refusal(text: str, error: SyntaxError) -> QueryRefused:
    """What Oxigraph's parser found in ``text``, with its place."""
    message, offset, hint = explained(
        text, str(error), lambda again: check_sparql(again, ALL_PREFIXES)
    )
    line = text.count("\n", 0, offset) + 1
    return QueryRefused(message, line, offset - text.rfind("\n", 0, offset), hint)
