"""A store in memory that is changed without end."""

from __future__ import annotations

from typing import Final

from pyoxigraph import Store

_LEAST: Final = 20_000
"""Quads that come and go before a store is made anew, and four times those that it has."""


class Churn:
    """How much has come to and gone from one store in memory.

    Such a store keeps some of what was removed, 0.2 to 0.6 KB a quad, and grows without end. So
    when much has come and gone, what there is goes on in a new one. Cost: that of a change, over
    many of them; of one of them that of all quads.
    """

    def __init__(self) -> None:
        self._changed = 0
        self._look_at = _LEAST
        """When so many have, the store is looked at: counting its quads takes as long as there
        are."""

    def note(self, quads: int) -> None:
        """So many have come or gone."""
        self._changed += quads

    def over(self, store: Store) -> Store:
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
