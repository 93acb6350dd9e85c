"""A query back to C-SPARQL: what the papers' engine would be given ([Events14 §V.C]).

Law: ``parse_query(format_query(q))`` means what ``q`` means. The streams are filled in, and the
template's arguments are visible: a parameter that is not in the head is replaced by its term,
one of the head stays a variable and gets a VALUES row.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..errors import LanguageError
from .ast import ContinuousQuery, TimeWindow
from .body import Edit, apply_edits, prefix_lines, values_edits
from .shape import Shape, query_shape
from .syntax import check_syntax
from .terms import short_text
from .tokens import Kind, compact, tokenize

_UNITS = (
    ("d", 86_400_000_000_000),
    ("h", 3_600_000_000_000),
    ("m", 60_000_000_000),
    ("s", 1_000_000_000),
    ("ms", 1_000_000),
    ("us", 1_000),
    ("ns", 1),
)


def format_duration(nanoseconds: int) -> str:
    """The largest unit that gives a whole number: ``5s``, ``1500ms``."""
    unit, factor = next((u, f) for u, f in _UNITS if nanoseconds % f == 0)
    return f"{nanoseconds // factor}{unit}"


def format_query(query: ContinuousQuery) -> str:
    """Valid C-SPARQL text of the query with its bindings and streams."""
    shape = query_shape(query.sparql)
    assert shape is not None, "parse_query refuses a text without WHERE"
    terms = {
        variable.value: short_text(term, query.prefixes)
        for variable, term in query.bindings.items()
    }
    head = shape.head_variables()
    replaced = {name: text for name, text in terms.items() if name not in head}
    rows = {name: text for name, text in terms.items() if name in head}
    body = _bound_body(query.sparql, shape, rows, replaced)
    if replaced and not _is_sparql(body):
        # A term cannot stand in every place of a variable (a projection, a group key).
        body = _bound_body(query.sparql, shape, terms, {})
    return _assembled(query, body, replaced)


def _is_sparql(text: str) -> bool:
    try:
        check_syntax(text, text)
    except LanguageError:
        return False
    return True


def _bound_body(
    sparql: str, shape: Shape, rows: Mapping[str, str], replaced: Mapping[str, str]
) -> str:
    edits = [
        Edit(token.start, token.end, replaced[token.text[1:]])
        for token in shape.tokens[shape.where_open :]
        if token.kind is Kind.VARIABLE and token.text[1:] in replaced
    ]
    if rows:
        edits += values_edits(shape, rows, list(rows), always=True)
        if shape.is_short_construct:
            pattern = sparql[
                shape.tokens[shape.where_open].start : shape.tokens[shape.where_close].end
            ]
            end = shape.tokens[shape.start].end
            edits.append(Edit(end, end, f" {pattern}"))
    return apply_edits(sparql, edits)


def _assembled(query: ContinuousQuery, body: str, replaced: Mapping[str, str]) -> str:
    """Header, head, FROM clauses, WHERE and modifiers, AGGREGATE, WINDOW, each on its lines."""
    shape = query_shape(body)
    assert shape is not None
    tokens = shape.tokens
    word = "STREAM" if query.produces_stream else "QUERY"
    every = "" if query.every is None else f" COMPUTE EVERY {format_duration(query.every)}"
    lines = [f"REGISTER {word} {_name(query)}{every} AS"]
    prologue = compact(prefix_lines(query) + body[: tokens[shape.start].start])
    where = shape.where_open
    if where and tokens[where - 1].is_word("WHERE"):
        where -= 1
    lines += [prologue] if prologue else []
    lines.append(compact(body[tokens[shape.start].start : tokens[where].start]))
    lines += [f"FROM <{iri}>" for iri in query.static]
    lines += [f"FROM STREAM <{clause.iri}> {_window(clause.window)}" for clause in query.streams]
    lines.append("WHERE " + body[tokens[shape.where_open].start : tokens[shape.where_close].end])
    modifiers = compact(body[tokens[shape.where_close].end :])
    lines += [modifiers] if modifiers else []
    if query.aggregations:
        lines.append(_aggregate(query, replaced))
    if query.window is not None and not query.streams:
        lines.append(f"WINDOW {_window(query.window)}")
    return "\n".join(lines) + "\n"


def _name(query: ContinuousQuery) -> str:
    return f"<{query.name}>" if ":" in query.name else query.name


def _window(window: TimeWindow) -> str:
    return f"[RANGE {format_duration(window.range)} STEP {format_duration(window.step)}]"


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
