"""The static side of continuous queries: the default graph of a store of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Final

from pyoxigraph import DefaultGraph, Quad, Store, Triple

from . import graphs
from .churn import Churn
from .entailment.rules import Change
from .quad_store import QuadStore

_NOT_STATIC: Final = (
    DefaultGraph(),
    graphs.CATALOG,
    graphs.QUERIES,
    graphs.STREAM_SPACE,
    graphs.STREAM_SPACE_ENTAILMENTS,
)
"""Graphs that continuous queries do not read."""


class StaticSide:
    """The triples of the graphs ``quads`` that continuous queries read. It is built on first use
    and follows the changes from then on. Callers hold the ontology's lock."""

    def __init__(self, quads: QuadStore) -> None:
        self._quads = quads
        self._store: Store | None = None
        self._churn = Churn()

    def store(self, triples: Callable[[], Iterable[Triple]]) -> Store:
        """Return the store; build it from ``triples`` if there is none."""
        if self._store is None:
            store = Store()
            store.extend(map(_in_default_graph, triples()))
            self.replace_store(store)
            return store
        return self._store

    def replace_store(self, store: Store | None) -> None:
        """Replace the store by ``store``; None: the next use builds one."""
        self._store, self._churn = store, Churn()

    def follow(self, *changes: Change) -> None:
        """Follow changes that the graphs already contain."""
        if self._store is None:
            return
        for change in changes:
            self._store.extend(map(_in_default_graph, change.added))
            for triple in change.removed:
                # Another static graph may contain it too.
                if not self._is_static(triple):
                    self._store.remove(_in_default_graph(triple))
            self._churn.note(change.added, change.removed)
        self._store = self._churn.replace_if_due(self._store)

    def _is_static(self, triple: Triple) -> bool:
        pattern = (triple.subject, triple.predicate, triple.object)
        quads = self._quads.store.quads_for_pattern(*pattern, None)
        return any(quad.graph_name not in _NOT_STATIC for quad in quads)

    def __getstate__(self) -> dict[str, object]:
        """Return the state for a copy, without the store, which can be rebuilt."""
        return {**self.__dict__, "_store": None}


def _in_default_graph(triple: Triple) -> Quad:
    return Quad(triple.subject, triple.predicate, triple.object)
