"""RSP-QL's ``WINDOW <name> {…}``: a GRAPH whose triples are those of a named window (SPEC §5).

SPARQL's parsers are given ``GRAPH  <name> {…}``, a word of the same length, so that offsets stay.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from ..errors import Span
from ..hints import near
from .ast import Form
from .cursor import Cursor
from .dataset import Dataset, Source
from .shape import Shape
from .tokens import Kind, Token

WINDOW: Final = "WINDOW"
_GRAPH: Final = "GRAPH".ljust(len(WINDOW))


@dataclass(frozen=True, slots=True)
class NamedGroup:
    """``WINDOW name {…}`` or ``GRAPH name {…}``: its keyword and its name."""

    word: Token
    name: Token

    @property
    def is_window(self) -> bool:
        return self.word.is_word(WINDOW)

    @property
    def variable(self) -> str | None:
        return self.name.text[1:] if self.name.kind is Kind.VARIABLE else None


def named_groups(at: Cursor, ours: list[Span]) -> list[NamedGroup]:
    """The WINDOW and GRAPH groups of a text outside our clauses.

    Raises `LanguageError` for a WINDOW that names nothing; a GRAPH without a name is left to the
    parser of SPARQL.
    """
    groups: list[NamedGroup] = []
    for index, token in enumerate(at.tokens):
        if not token.is_word(WINDOW, "GRAPH") or _is_in(token, ours):
            continue
        name = at.tokens[index + 1] if index + 1 < len(at.tokens) else None
        if name is not None and name.kind in (Kind.IRI, Kind.PREFIXED, Kind.VARIABLE):
            groups.append(NamedGroup(token, name))
        elif token.is_word(WINDOW) and name is not None and name.is_mark("["):
            raise at.error(
                "the WINDOW clause stands inside a group", token, "write it behind the last `}`"
            )
        elif token.is_word(WINDOW):
            raise at.error(
                "the name of a window is due after WINDOW", name, "write `WINDOW :w { … }`"
            )
    return groups


def _is_in(token: Token, spans: list[Span]) -> bool:
    return any(span.start <= token.start < span.end for span in spans)


def check_places(at: Cursor, groups: list[NamedGroup], shape: Shape) -> None:
    """What is constructed is one graph, so no WINDOW stands there."""
    where = shape.tokens[shape.where_open].start if shape.has_where else 0
    for group in groups:
        if shape.form is Form.CONSTRUCT and group.is_window and group.word.start < where:
            raise at.error(
                f"`WINDOW {group.name.text}` in what is constructed",
                group.word,
                "triples are constructed without a window: write it inside WHERE",
            )


def check_groups(at: Cursor, groups: list[NamedGroup], dataset: Dataset) -> None:
    """Each WINDOW names a window, each GRAPH none, and no variable stands for both."""
    named = {at.iri_of(s.name): s.name.text for s in dataset.of(Source.NAMED_WINDOW) if s.name}
    unnamed = {at.iri_of(s.name) for s in dataset.of(Source.WINDOW) if s.name}
    graph_variables = {group.variable for group in groups if not group.is_window}
    for group in groups:
        name = group.name
        if group.variable is not None:
            if group.is_window:
                _check_variable(at, name, bool(named), group.variable in graph_variables)
            continue
        iri = at.iri_of(name)
        if not group.is_window and iri in named:
            raise at.error(
                f"`{name.text}` is a window", group.word, f"write `WINDOW {name.text} {{ … }}`"
            )
        if group.is_window and iri in unnamed:
            raise at.error(
                f"the window `{name.text}` is part of the default graph",
                name,
                f"write `FROM NAMED WINDOW {name.text} ON …`, or leave `WINDOW {name.text}` out",
            )
        if group.is_window and iri not in named:
            hint = near(name.text, named.values()) if named else _declare(name.text)
            raise at.error(f"the window `{name.text}` is not declared", name, hint)


def _declare(name: str) -> str:
    return f"write `FROM NAMED WINDOW {name} ON <stream> [RANGE PT5S STEP PT1S]` before WHERE"


def _check_variable(at: Cursor, name: Token, has_windows: bool, is_graph: bool) -> None:
    if is_graph:
        raise at.error(
            f"`{name.text}` names a window here and a graph elsewhere",
            name,
            "no window is a graph: use two variables",
        )
    if not has_windows:
        raise at.error("the query has no named window", name, _declare(":w"))


def as_graphs(sparql: str, groups: list[NamedGroup]) -> str:
    """The text with ``GRAPH `` for each WINDOW; offsets stay."""
    for group in groups:
        if group.is_window:
            start, end = group.word.start, group.word.end
            sparql = sparql[:start] + _GRAPH + sparql[end:]
    return sparql
