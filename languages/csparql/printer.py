"""A query back to text in its dialect: what the papers' engine would be given ([Events14 §V.C]).

Law: ``parse_query(format_query(q))`` means what ``q`` means. The streams are filled in, and the
template's arguments are visible: a parameter that is not in the head is replaced by its term,
one of the head stays a variable and gets a VALUES row.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from hashlib import blake2b
from typing import assert_never

from ...rdf.namespaces import XSD
from ...streams.time import SECOND, format_duration, format_time
from ..errors import LanguageError
from .ast import (
    ContinuousQuery,
    CountWindow,
    Dialect,
    LandmarkWindow,
    StreamClause,
    StreamOperator,
    TimeWindow,
    Window,
)
from .body import Edit, apply_edits, groups_of, prefix_lines, template_edit, values_edits
from .functions import check_functions
from .groups import WINDOW
from .shape import Shape, query_shape
from .syntax import check_syntax
from .terms import short_text
from .tokens import Kind, compact, tokenize

_DIGITS = re.compile("[0-9]+")
_FITTING: dict[bytes, bool] = {}
"""By a digest: of texts of 64 KiB these would be as many bytes, a thousand times."""
_REMEMBERED = 1_000
"""Of so many ways to fill in a text it is remembered whether it can be read."""
MOST_READ = 200
"""A text of more tokens is not read for that: it takes up to a millisecond each."""


def format_query(query: ContinuousQuery) -> str:
    """Valid C-SPARQL or RSP-QL text of the query with its bindings and streams."""
    shape = query_shape(query.sparql)
    assert shape is not None, "parse_query refuses a text without WHERE"
    terms = {
        variable.value: short_text(term, query.prefixes)
        for variable, term in query.bindings.items()
    }
    head = shape.head_variables()
    kept = head.keys() | query.window_variables
    replaced = {name: text for name, text in terms.items() if name not in kept}
    rows = {name: text for name, text in terms.items() if name in kept}
    edits = _binding_edits(query.sparql, shape, rows, replaced)
    if replaced and (len(shape.tokens) > MOST_READ or not _fits(query, edits, replaced)):
        # A term cannot stand in every place of a variable (a projection, f:timestamp).
        edits = _binding_edits(query.sparql, shape, terms, {})
    body = apply_edits(query.sparql, [*edits, *_window_edits(query, shape)])
    return _assembled(query, body, replaced)


def _fits(query: ContinuousQuery, edits: Sequence[Edit], terms: Mapping[str, str]) -> bool:
    """Whether the terms can stand where the edits put them. Terms that are written alike fit
    alike: of the many instances of a template few have to be read."""
    kinds = tuple((name, _DIGITS.sub("0", _kind(text))) for name, text in sorted(terms.items()))
    told = repr((query.sparql, sorted(query.prefixes.items()), kinds))
    key = blake2b(told.encode(), digest_size=16).digest()
    if key not in _FITTING:
        if len(_FITTING) >= _REMEMBERED:
            _FITTING.clear()
        _FITTING[key] = _is_sparql(apply_edits(query.sparql, edits), query)
    return _FITTING[key]


def _kind(text: str) -> str:
    """A term with what may be anything taken out: the name in an IRI, the text of a string."""
    if text.startswith("<"):
        return "<>"
    if text.startswith(("'", '"')):
        return text[0] + text[text.rindex(text[0]) :]
    return text.partition(":")[0] + ":" if ":" in text else text


def _is_sparql(text: str, query: ContinuousQuery) -> bool:
    try:
        check_syntax(text, text)
        check_functions(text, query.prefixes, "", text)
    except LanguageError:
        return False
    return True


def _binding_edits(
    sparql: str, shape: Shape, rows: Mapping[str, str], replaced: Mapping[str, str]
) -> list[Edit]:
    edits = [
        Edit(token.start, token.end, replaced[token.text[1:]])
        for token in shape.tokens[shape.where_open :]
        if token.kind is Kind.VARIABLE and token.text[1:] in replaced
    ]
    if rows:
        edits += values_edits(shape, groups_of(sparql), rows, list(rows))
        if shape.is_short_construct:
            edits.append(template_edit(sparql, shape))
    return edits


def _window_edits(query: ContinuousQuery, shape: Shape) -> list[Edit]:
    """GRAPH back to WINDOW where the source has it."""
    return [
        Edit(token.start, token.start + len(WINDOW), WINDOW)
        for token in shape.tokens
        if token.is_word("GRAPH")
        and query.source[token.start : token.start + len(WINDOW)].upper() == WINDOW
    ]


def _assembled(query: ContinuousQuery, body: str, replaced: Mapping[str, str]) -> str:
    """Header, head, FROM clauses, WHERE and modifiers, AGGREGATE, WINDOW, each on its lines."""
    shape = query_shape(body)
    assert shape is not None
    tokens = shape.tokens
    lines = _register(query)
    prologue = compact(prefix_lines(query) + body[: tokens[shape.start].start])
    where = shape.where_open
    if where and tokens[where - 1].is_word("WHERE"):
        where -= 1
    lines += [prologue] if prologue else []
    lines.append(_head(query, body, shape, tokens[where].start))
    lines += [f"FROM <{iri}>" for iri in query.static]
    lines += [f"FROM NAMED <{iri}>" for iri in query.static_named]
    lines += [f"{_from(query, clause)} {_window(clause.window, query)}" for clause in query.streams]
    lines.append("WHERE " + body[tokens[shape.where_open].start : tokens[shape.where_close].end])
    modifiers = compact(body[tokens[shape.where_close].end :])
    lines += [modifiers] if modifiers else []
    if query.aggregations:
        lines.append(_aggregate(query, replaced))
    if query.window is not None and not query.streams:
        lines.append(f"WINDOW {_window(query.window, query)}")
    return "\n".join(lines) + "\n"


def _register(query: ContinuousQuery) -> list[str]:
    """The line of REGISTER, none for a query without a name."""
    if not query.name:
        return []
    name = f"<{query.name}>" if ":" in query.name else query.name
    word = "STREAM" if query.produces_stream else "QUERY"
    if _registers_operator(query):
        word = query.operator
    every = "" if query.every is None else f" COMPUTE EVERY {_duration(query.every, query)}"
    return [f"REGISTER {word} {name}{every} AS"]


def _registers_operator(query: ContinuousQuery) -> bool:
    """RSP-QL says what goes on in REGISTER, unless nothing is registered as a stream."""
    return query.dialect is Dialect.RSP_QL and bool(query.name) and query.produces_stream


def _head(query: ContinuousQuery, body: str, shape: Shape, end: int) -> str:
    """The form and what stands before WHERE; the gaps that a blanked operator left are closed."""
    tokens = shape.tokens
    form = tokens[shape.start]
    after = tokens[shape.start + 1]
    operator = ""
    if query.operator is not StreamOperator.RSTREAM and not _registers_operator(query):
        operator = f" {query.operator}"
    edits = [Edit(form.end, after.start, operator + _closed(body[form.end : after.start]))]
    if after.is_word("DISTINCT", "REDUCED"):
        next = tokens[shape.start + 2]
        edits.append(Edit(after.end, next.start, _closed(body[after.end : next.start])))
    return compact(apply_edits(body[:end], edits)[form.start :])


def _closed(gap: str) -> str:
    return re.sub(r"[ \t]+", " ", gap)


def _from(query: ContinuousQuery, clause: StreamClause) -> str:
    if clause.name is not None:
        return f"FROM NAMED WINDOW <{clause.name}> ON <{clause.iri}>"
    # FROM WINDOW keeps the dialect, and may name a stream twice.
    words = "FROM WINDOW ON" if query.dialect is Dialect.RSP_QL else "FROM STREAM"
    return f"{words} <{clause.iri}>"


def _window(window: Window, query: ContinuousQuery) -> str:
    match window:
        case TimeWindow():
            return f"[RANGE {_duration(window.range, query)} STEP {_duration(window.step, query)}]"
        case CountWindow():
            word = "ELEMENTS" if query.dialect is Dialect.RSP_QL else "TRIPLES"
            return f"[{word} {window.size} STEP {window.step}]"
        case LandmarkWindow():
            start = ""
            if window.start is not None:
                used = query.prefixes.get("xsd") == XSD
                datatype = "xsd:dateTime" if used else f"<{XSD}dateTime>"
                start = f' "{format_time(window.start)}"^^{datatype}'
            return f"[LANDMARK{start} STEP {_duration(window.step, query)}]"
        case _:
            assert_never(window)


def _duration(nanoseconds: int, query: ContinuousQuery) -> str:
    """``5s``; in RSP-QL ``PT5S``."""
    if query.dialect is Dialect.C_SPARQL:
        return format_duration(nanoseconds)
    seconds, fraction = divmod(nanoseconds, SECOND)
    digits = f".{fraction:09d}".rstrip("0").rstrip(".")
    return f"PT{seconds}{digits}S"


def _aggregate(query: ContinuousQuery, replaced: Mapping[str, str]) -> str:
    parts = [
        f"(?{a.alias.value}, {a.function}, {{?{a.argument.value}}})" for a in query.aggregations
    ]
    for text, _ in query.aggregate_filters:
        edits = [
            Edit(token.start, token.end, replaced[token.text[1:]])
            for token in tokenize(text)
            if token.kind is Kind.VARIABLE and token.text[1:] in replaced
        ]
        parts.append(f"FILTER {apply_edits(text, edits)}")
    return f"AGGREGATE {{{' '.join(parts)}}}"
