"""RSP-QL's ``WINDOW <name> {…}``: a GRAPH with the triples of a named window (SPEC §5)."""

from __future__ import annotations

from dataclasses import dataclass

from ...sparql.cursor import Cursor
from ...sparql.tokens import Kind, Token
from ..hints import suggest_name
from .dataset import Dataset, Source


@dataclass(frozen=True, slots=True)
class NamedGroup:
    """``WINDOW name {…}`` or ``GRAPH name {…}``: its keyword and its name."""

    word: Token
    name: Token

    @property
    def is_window(self) -> bool:
        return self.word.is_word("WINDOW")

    @property
    def variable(self) -> str | None:
        return self.name.text[1:] if self.name.kind is Kind.VARIABLE else None


def check_groups(at: Cursor, groups: list[NamedGroup], dataset: Dataset) -> None:
    """Check that each WINDOW names a window, no GRAPH does, and no variable names both."""
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
            hint = suggest_name(name.text, named.values()) if named else _declare(name.text)
            raise at.error(f"the window `{name.text}` is not declared", name, hint)


def _declare(name: str) -> str:
    return f"write `FROM NAMED WINDOW {name} ON <stream> [RANGE PT5S STEP PT1S]` before WHERE"


def _check_variable(at: Cursor, name: Token, has_windows: bool, is_graph: bool) -> None:
    if is_graph:
        raise at.error(
            f"`{name.text}` names a window here and a graph elsewhere",
            name,
            "a window is not a graph: use two variables",
        )
    if not has_windows:
        raise at.error("the query has no named window", name, _declare(":w"))
