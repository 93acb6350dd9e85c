"""A store in memory that is changed without end."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from pyoxigraph import BlankNode, Literal, NamedNode, Quad, Store, Triple

_LEAST: Final = 20_000
"""Short quads that come and go before a store is made anew, and four times those that it has."""
_SHORT: Final = 512
"""Characters of a short one's subject and object."""


def weight(quads: Iterable[Quad | Triple]) -> int:
    """How many short quads or triples need as much memory: texts of templates and units stand in
    literals."""
    return sum(1 + (len(_text(q.subject)) + len(_text(q.object))) // _SHORT for q in quads)


def _text(term: NamedNode | BlankNode | Literal | Triple) -> str:
    return "" if isinstance(term, Triple) else term.value


class Churn:
    """How much has come to and gone from one store in memory.

    Such a store keeps some of what was removed, 0.2 to 0.6 KB a short quad, and grows without end.
    So when much has come and gone, what there is goes on in a new one. Cost: that of a change, over
    many of them; of one of them that of all quads.
    """

    def __init__(self) -> None:
        self._changed = 0
        self._look_at = _LEAST
        """When so much has, the store is looked at: counting its quads takes as long as there
        are."""

    def note(self, *quads: Iterable[Quad | Triple]) -> None:
        """These have come or gone."""
        self._changed += sum(map(weight, quads))

    def replace_if_due(self, store: Store) -> Store:
        """``store`` itself, or what takes its place from now on: another one with its quads."""
        if self._changed <= self._look_at:
            return store
        much = max(_LEAST, 4 * len(store))
        if self._changed <= much:
            self._look_at = much
            return store
        found = Store()
        found.extend(store)
        self._changed, self._look_at = 0, _LEAST
        return found
