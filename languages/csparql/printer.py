"""Prints a query in its dialect, as text for the papers' engine ([Events14 §V.C]).

Law: ``parse_query(format_query(q))`` has the meaning of ``q``. The text contains the query's
streams and the template's arguments. A parameter outside of the head is replaced by its term; one
in the head stays a variable and gets a VALUES row.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from typing import Final, assert_never

from ...rdf.namespaces import XSD
from ...sparql.ast import Query, variables_of
from ...sparql.scope import head_variables
from ...sparql.terms import short_text
from ...sparql.tokens import IRI, STRING, Kind, Token
from ...streams.time import SECOND, format_duration, format_time
from ..errors import LanguageError, Span
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
from .body import Part, parts_of
from .clauses import ClauseReader
from .parser import read

_DIGITS = re.compile("[0-9]+")
_FIT_CACHE: dict[bytes, bool] = {}
"""Keyed by a digest: a thousand texts of 64 KiB would need 64 MB."""
_MOST_CACHED = 1_000
"""The number of cached results of `_fits`."""
MOST_READ = 200
"""The greatest number of tokens of a text that `_fits` parses."""
# It starts where white space starts: a start at each blank of a long run would cost quadratic time.
_BLANK_LINES: Final = r"(?<![ \t])[ \t]*(?:\r?\n[ \t]*)*\r?\n"
_LINES: Final = re.compile(
    rf"""
    (?P<lines>{_BLANK_LINES})
  | \#(?:[^\r\n\ \t]|[\ \t]+(?=[^\r\n\ \t]))*    # without the white space at its end
  | {STRING} | {IRI}
  | \\.                                         # in a name: a quote or # that begins nothing
    """,
    re.VERBOSE | re.DOTALL,
)


@dataclass(frozen=True, slots=True)
class Edit:
    """A replacement of ``text[start:end]``; an insertion if both are equal."""

    start: int
    end: int
    text: str


@dataclass(frozen=True, slots=True)
class _Text:
    """The source of a query, its SPARQL with the other clauses blanked out, and its parts."""

    sparql: str
    tokens: Sequence[Token]
    body: Query
    where: Span

    @classmethod
    def of(cls, query: ContinuousQuery) -> _Text:
        reader, found, body = read(query.source)
        assert body.where is not None, "parse_query refuses a text without WHERE"
        ours = found.ours
        tokens = [t for t in reader.tokens if not any(s.start <= t.start < s.end for s in ours)]
        return cls(_blank(query.source, ours), tokens, body, body.where.span)

    def apply(self, edits: Sequence[Edit], start: int, end: int) -> str:
        """Apply the disjoint edits within a range of the SPARQL; insertions at one place keep their
        order."""
        return _apply_edits(self.sparql, edits, start, end)


def _apply_edits(text: str, edits: Sequence[Edit], start: int, end: int) -> str:
    parts: list[str] = []
    position = start
    for edit in sorted(edits, key=lambda edit: (edit.start, edit.end)):
        if start <= edit.start < end:
            parts += (text[position : edit.start], edit.text)
            position = edit.end
    return "".join([*parts, text[position:end]])


def format_query(query: ContinuousQuery) -> str:
    """Return valid C-SPARQL or RSP-QL text of the query with its bindings and streams."""
    text = _Text.of(query)
    terms = {
        variable.value: short_text(term, query.prefixes)
        for variable, term in query.bindings.items()
    }
    head_names = head_variables(text.body).keys() | query.window_variables
    replaced = {name: term for name, term in terms.items() if name not in head_names}
    rows = {name: term for name, term in terms.items() if name in head_names}
    edits = _binding_edits(text, rows, replaced)
    if replaced and (len(text.tokens) > MOST_READ or not _fits(query, edits, replaced)):
        # Some places of a variable allow no term (a projection, f:timestamp).
        edits, replaced = _binding_edits(text, terms, {}), {}
    return _assemble(query, text, [*edits, *_window_edits(text)], replaced)


def _fits(query: ContinuousQuery, edits: Sequence[Edit], terms: Mapping[str, str]) -> bool:
    """Return whether the text with the edits still parses. Terms of one form fit alike, so few of a
    template's many instances need parsing."""
    kinds = tuple((name, _DIGITS.sub("0", _kind(text))) for name, text in sorted(terms.items()))
    description = repr((query.source, sorted(query.prefixes.items()), kinds))
    key = blake2b(description.encode(), digest_size=16).digest()
    if key not in _FIT_CACHE:
        if len(_FIT_CACHE) >= _MOST_CACHED:
            _FIT_CACHE.clear()
        _FIT_CACHE[key] = _is_query(query, edits)
    return _FIT_CACHE[key]


def _kind(text: str) -> str:
    """Return the form of a term: without the name in an IRI and the text of a string."""
    if text.startswith("<"):
        return "<>"
    if text.startswith(("'", '"')):
        return text[0] + text[text.rindex(text[0]) :]
    return text.partition(":")[0] + ":" if ":" in text else text


def _is_query(query: ContinuousQuery, edits: Sequence[Edit]) -> bool:
    try:
        ClauseReader(_apply_edits(query.source, edits, 0, len(query.source))).read()
    except LanguageError:
        return False
    return True


def _binding_edits(text: _Text, rows: Mapping[str, str], replaced: Mapping[str, str]) -> list[Edit]:
    edits = [
        Edit(token.start, token.end, replaced[token.text[1:]])
        for token in text.tokens
        if token.start >= text.where.start
        and token.kind is Kind.VARIABLE
        and token.text[1:] in replaced
    ]
    if rows:
        for part in parts_of(text.body):
            edits += _row_edits(part, rows, is_top=part.group.span == text.where)
        if text.body.is_short:
            # The short form allows no VALUES.
            pattern = text.sparql[text.where.start : text.where.end]
            place = text.body.span.start + len("CONSTRUCT")
            edits.append(Edit(place, place, f" {pattern}"))
    return edits


def _row_edits(part: Part, rows: Mapping[str, str], *, is_top: bool) -> list[Edit]:
    """Insert a VALUES row into a group that uses a parameter, and a group key where a sub-query
    groups."""
    edits: list[Edit] = []
    names = list(rows) if is_top else part.parameters(list(rows))
    if names:
        head = " ".join(f"?{name}" for name in names)
        row = " ".join(rows[name] for name in names)
        place = part.group.span.start + 1
        edits.append(Edit(place, place, f" VALUES ({head}) {{ ({row}) }}"))
    select = part.select
    if select is not None and select.is_aggregated:
        used, present = variables_of(select), variables_of(select.keys)
        keys = " ".join(f"?{name}" for name in rows if name in used and name not in present)
        if keys and select.grouped is not None:
            edits.append(Edit(select.grouped.end, select.grouped.end, f" {keys}"))
        elif keys:
            edits.append(Edit(part.group.span.end, part.group.span.end, f" GROUP BY {keys}"))
    return edits


def _window_edits(text: _Text) -> list[Edit]:
    """Write WINDOW in capitals."""
    words = (token for token in text.tokens if token.is_word("WINDOW"))
    return [Edit(token.start, token.end, "WINDOW") for token in words]


def _assemble(
    query: ContinuousQuery, text: _Text, edits: Sequence[Edit], replaced: Mapping[str, str]
) -> str:
    """Join header, head, FROM clauses, WHERE and modifiers, AGGREGATE and WINDOW, each on its
    lines."""
    start, where = text.body.span.start, text.where
    lines = _register(query)
    prologue = compact(_prefix_lines(query, text) + text.apply(edits, 0, start))
    lines += [prologue] if prologue else []
    before = [t for t in text.tokens if t.start < where.start][-1]
    end = before.start if before.is_word("WHERE") else where.start
    lines.append(_head(query, text, edits, end))
    lines += [f"FROM <{iri}>" for iri in query.static]
    lines += [f"FROM NAMED <{iri}>" for iri in query.static_named]
    lines += [f"{_from(query, clause)} {_window(clause.window, query)}" for clause in query.streams]
    lines.append("WHERE " + text.apply(edits, where.start, where.end))
    modifiers = compact(text.apply(edits, where.end, len(text.sparql)))
    lines += [modifiers] if modifiers else []
    if query.aggregations:
        lines.append(_aggregate(query, replaced))
    if query.window is not None and not query.streams:
        lines.append(f"WINDOW {_window(query.window, query)}")
    return "\n".join(lines) + "\n"


def _prefix_lines(query: ContinuousQuery, text: _Text) -> str:
    """Return PREFIX lines for the shared prefixes that the query uses without a declaration."""
    pairs = zip(text.tokens, text.tokens[1:], strict=False)
    declared = {name.text[:-1] for word, name in pairs if word.is_word("PREFIX")}
    used = query.prefixes.items()
    return "".join(f"PREFIX {name}: <{iri}>\n" for name, iri in used if name not in declared)


def _register(query: ContinuousQuery) -> list[str]:
    """Return the REGISTER line; none for a query without a name."""
    if not query.name:
        return []
    name = f"<{query.name}>" if ":" in query.name else query.name
    word = "STREAM" if query.produces_stream else "QUERY"
    if _registers_operator(query):
        word = query.operator
    every = "" if query.every is None else f" COMPUTE EVERY {_duration(query.every, query)}"
    return [f"REGISTER {word} {name}{every} AS"]


def _registers_operator(query: ContinuousQuery) -> bool:
    """Return whether REGISTER states the stream operator, as RSP-QL does for registered streams."""
    return query.dialect is Dialect.RSP_QL and bool(query.name) and query.produces_stream


def _head(query: ContinuousQuery, text: _Text, edits: Sequence[Edit], end: int) -> str:
    """Return the form and the rest of the head before WHERE, without the gap of a blanked
    operator."""
    tokens = [token for token in text.tokens if token.start >= text.body.span.start]
    operator = ""
    if query.operator is not StreamOperator.RSTREAM and not _registers_operator(query):
        operator = f" {query.operator}"
    form, after = tokens[0], tokens[1]
    gap = _one_space(text.sparql[form.end : after.start])
    closed = [Edit(form.end, after.start, gap)]
    if after.is_word("DISTINCT", "REDUCED"):
        gap = _one_space(text.sparql[after.end : tokens[2].start])
        closed.append(Edit(after.end, tokens[2].start, gap))
    return compact(
        text.apply([Edit(form.end, form.end, operator), *edits, *closed], text.body.span.start, end)
    )


def _one_space(gap: str) -> str:
    return re.sub(r"[ \t]+", " ", gap)


def _from(query: ContinuousQuery, clause: StreamClause) -> str:
    if clause.name is not None:
        return f"FROM NAMED WINDOW <{clause.name}> ON <{clause.iri}>"
    # FROM WINDOW keeps the dialect, and allows a stream twice.
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
    """Return ``5s``; in RSP-QL ``PT5S``."""
    if query.dialect is Dialect.C_SPARQL:
        return format_duration(nanoseconds)
    seconds, fraction = divmod(nanoseconds, SECOND)
    digits = f".{fraction:09d}".rstrip("0").rstrip(".")
    return f"PT{seconds}{digits}S"


def _aggregate(query: ContinuousQuery, replaced: Mapping[str, str]) -> str:
    parts = [
        f"(?{a.alias.value}, {a.function}, {{?{a.argument.value}}})" for a in query.aggregations
    ]
    tokens = read(query.source)[0].tokens
    for _, span in query.aggregate_filters:
        text, position = "", span.start
        for token in tokens:
            if span.start <= token.start < span.end and token.kind is Kind.VARIABLE:
                name = replaced.get(token.text[1:], token.text)
                text += query.source[position : token.start] + name
                position = token.end
        parts.append(f"FILTER {text}{query.source[position : span.end]}")
    return f"AGGREGATE {{{' '.join(parts)}}}"


def _blank(source: str, spans: Sequence[Span]) -> str:
    """Replace the characters of ``spans`` by spaces; line ends and offsets stay."""
    blanks = [Edit(s.start, s.end, re.sub(r"[^\r\n]", " ", source[s.start : s.end])) for s in spans]
    return _apply_edits(source, blanks, 0, len(source))


def compact(text: str) -> str:
    """Remove the blank lines that blanked clauses leave; literals stay unchanged.

    The text must be valid for the tokenizer. Cost: linear, and less than tokenizing.
    """
    return _LINES.sub(lambda found: found[0] if found["lines"] is None else "\n", text).strip()
