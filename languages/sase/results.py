"""Checks the results of SASE+ patterns (SPEC §8)."""

from __future__ import annotations

from typing import Final

from ...streams.sample import TIME_FIELDS
from . import ast
from .checked import CheckedPattern, is_over_matches
from .conditions import Conditions
from .parts import Parts

_RESERVED: Final = frozenset({"start", "end", *TIME_FIELDS})


class Results:
    """Checks results. All methods raise `LanguageError`."""

    def __init__(self, parts: Parts, conditions: Conditions) -> None:
        self._parts = parts
        self._conditions = conditions

    def check(self, checked: CheckedPattern) -> None:
        for item, leaf in checked.returned():
            self._conditions.check_leaf(leaf)
            if isinstance(leaf, ast.Attribute | ast.Aggregate):
                self._conditions.check_settled(leaf, "results are those of a whole match")
            if leaf is not item.term:
                self._conditions.check_no_list(leaf)
            if checked.is_over_matches:
                self._check_over_matches(item, leaf)
        named = [(each.name, each.defined_by.span) for each in checked.objects]
        named += [(self._name(item), item.span) for item in checked.text.items]
        for i, (name, span) in enumerate(named):
            if name in _RESERVED:
                raise self._parts.error(
                    f"each result has `{name}` already", span, "give it another name"
                )
            if name in (before for before, _ in named[:i]):
                raise self._parts.error(
                    f"two results have the name `{name}`", span, "give one another: `… AS name`"
                )

    def _name(self, item: ast.Item) -> str:
        name = result_name(item)
        if name is None:
            raise self._parts.error(
                "the result has no name", item.span, "name it: `a.x - b.x AS difference`"
            )
        return name

    def _check_over_matches(self, item: ast.Item, leaf: ast.Term) -> None:
        if is_over_matches(leaf):
            if leaf is not item.term:
                raise self._parts.error(
                    "an aggregate over all matches stands by itself",
                    item.span,
                    "calculate with it in a query that reads the results",
                )
            return
        last = self._parts.there[-1]
        is_of_last = isinstance(leaf, ast.Attribute) and leaf.part == last.name
        if isinstance(leaf, ast.Aggregate | ast.Attribute) and not (
            is_of_last and leaf.index in (ast.Index.ONE, ast.Index.LAST)
        ):
            name = f"{last.name}[{last.name}.LEN]" if last.is_kleene else last.name
            raise self._parts.error(
                "this is of one match, and other results are of all that end with an event",
                leaf.span,
                f"over all matches write `sum(a.x)`; of the event that ends them `{name}.x`",
            )


def objects_of(pattern: ast.Pattern) -> tuple[ast.Item, ...]:
    """What is returned if the text does not say it: the object of each part, by its name."""
    return tuple(
        ast.Item(
            ast.Attribute(
                part.name, ast.Index.ALL if part.is_kleene else ast.Index.ONE, "id", part.span
            ),
            part.name,
            part.span,
        )
        for part in pattern.parts
        if not part.is_negated
    )


def result_name(item: ast.Item) -> str | None:
    """The name of a result: that after AS, else of the attribute, else of the function."""
    if item.name is not None:
        return item.name
    match item.term:
        case ast.Attribute(_, _, name):
            return name
        case ast.Aggregate(function, _, _, name):
            return function if name is None else f"{function}_{name}"
        case ast.CountMatches():
            return "count"
        case _:
            return None
