"""The graphs of a store as sets of triples, and the default graph, which is their merge.

It numbers the changes and keeps the last ones, for replicas in other processes (`replicas`). An
in-memory store is replaced now and then (`churn`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Set
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from pyoxigraph import (
    BlankNode,
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    RdfFormat,
    Store,
    Triple,
    parse,
)

from . import graphs
from .churn import Churn
from .entailment.rules import Change
from .errors import OntologyError
from .replicas import ChangeLog, as_nquads

Changes: TypeAlias = dict[NamedNode, Change]
"""The change of each graph."""


@dataclass(frozen=True, slots=True)
class StoreChanges:
    """The changes that a replica lacks, as N-Quads; ``dump`` replaces all its data."""

    position: int
    dump: bytes | None
    added: bytes
    removed: bytes


class QuadStore:
    """A store whose default graph is the merge of its named graphs, without the catalog. Not
    thread-safe: a writer holds a lock of its own."""

    def __init__(self, store: Store, path: Path | None) -> None:
        self.store = store
        """All quads. Treat it as read-only."""
        self.path = path
        self._churn = Churn()
        self._log = ChangeLog()

    @property
    def position(self) -> int:
        """The number of changes so far."""
        return self._log.position

    def graph(self, graph: NamedNode) -> frozenset[Triple]:
        """Return all triples of a graph."""
        quads = self.store.quads_for_pattern(None, None, None, graph)
        return frozenset(quad.triple for quad in quads)

    def names(self) -> list[str]:
        """Return the IRIs of the graphs that contain triples, sorted. Cost: a look-up a graph."""
        # The store also lists graphs from which all triples were removed.
        return sorted(
            graph.value
            for graph in self.store.named_graphs()
            if isinstance(graph, NamedNode)
            and next(self.store.quads_for_pattern(None, None, None, graph), None) is not None
        )

    def about(
        self, subject: NamedNode | None, predicate: NamedNode | None, graph: NamedNode
    ) -> Iterator[Quad]:
        """Yield the quads of a graph with ``subject`` and ``predicate``; None matches all."""
        return self.store.quads_for_pattern(subject, predicate, None, graph)

    def apply(self, changes: Changes) -> None:
        """Write changes of named graphs, and the resulting change of the default graph.

        A triple leaves the default graph when no named graph contains it.
        """
        added = {
            Quad(t.subject, t.predicate, t.object, g) for g, c in changes.items() for t in c.added
        }
        removed = {
            Quad(t.subject, t.predicate, t.object, g) for g, c in changes.items() for t in c.removed
        }
        merged = {q.triple for q in added if q.graph_name != graphs.CATALOG}
        left = {q.triple for q in removed if q.graph_name != graphs.CATALOG} - merged
        added |= {Quad(t.subject, t.predicate, t.object) for t in merged}
        removed |= {
            Quad(t.subject, t.predicate, t.object) for t in left if not self._elsewhere(t, removed)
        }
        if not added and not removed:
            return
        self._churn.note(added, removed)
        self._log.note(added, removed)
        if not removed:
            self.store.extend(added)  # all at once, without parsing a text
        elif any(_has_blank(quad) for quad in removed | added):
            # DELETE DATA allows no blank nodes, so these quads change one by one. Additions come
            # first, so that a quad that stays is never missing.
            self.store.extend(added)
            for quad in removed:
                self.store.remove(quad)
        else:
            self.store.update(
                f"DELETE DATA {{ {_data(removed)} }} ; INSERT DATA {{ {_data(added)} }}"
            )
        # Bounds the memory of an in-memory store.
        if self.path is None:
            self.store = self._churn.replace_if_due(self.store)

    def _elsewhere(self, triple: Triple, removed: set[Quad]) -> bool:
        holders = self.store.quads_for_pattern(
            triple.subject, triple.predicate, triple.object, None
        )
        return any(
            quad not in removed and quad.graph_name not in (DefaultGraph(), graphs.CATALOG)
            for quad in holders
        )

    def flush(self) -> None:
        """Make all changes durable, if the store is on disk."""
        if self.path is not None:
            self.store.flush()

    def replace_store(self, store: Store, changes: Changes) -> None:
        """Replace the store by ``store``, then apply ``changes``. Replicas start anew."""
        self.store, self._churn = store, Churn()
        self.apply(changes)
        self._log.reset()

    def changes_since(self, position: int) -> tuple[Set[Quad], Set[Quad]] | None:
        """Return the quads added and removed since ``position``; None if the log does not reach
        back."""
        return self._log.since(position)

    def replica_changes(self, position: int | None) -> Callable[[], StoreChanges]:
        """Return a function that encodes the changes a replica lacks. Calling it may take long; the
        store may change meanwhile."""
        store, position_now = self.store, self._log.position
        changes = None if position is None else self._log.since(position)
        if changes is not None:
            added, removed = changes
            return lambda: StoreChanges(position_now, None, as_nquads(added), as_nquads(removed))

        def full_dump() -> StoreChanges:
            # The dump may include later changes, which the replica then gets twice: harmless, since
            # a store is a set.
            dumped = store.dump(format=RdfFormat.N_QUADS)
            assert dumped is not None  # None only with an output file
            return StoreChanges(position_now, dumped, b"", b"")

        return full_dump


def quads_of(store: Store) -> bytes:
    """Return a store as sorted N-Quads: a line for each quad, blank nodes by their names."""
    return b"".join(sorted(f"{quad} .\n".encode() for quad in store))


def store_of(quads: bytes) -> Store:
    """Return an in-memory store from the output of `quads_of`."""
    store = Store()
    store.extend(parse(quads, RdfFormat.N_QUADS))
    return store


def open_store(path: Path) -> Store:
    """Open the store in a folder. Raises `OntologyError` if another process has opened it, or it is
    broken."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        return Store(path)
    except OSError as error:
        reason = "is in use by another process" if "lock" in str(error).lower() else "is broken"
        raise OntologyError(
            f"the store {path} {reason}: {error}",
            hint="stop the other process, or name another data folder",
        ) from error


def difference(before: frozenset[Triple], then: frozenset[Triple]) -> Change:
    """Return the change from one set of triples to another."""
    return Change(then - before, before - then)


def _has_blank(quad: Quad) -> bool:
    return isinstance(quad.subject, BlankNode) or isinstance(quad.object, BlankNode)


def _data(quads: Iterable[Quad]) -> str:
    """Return quads as SPARQL's QuadData."""
    parts = []
    for quad in quads:
        triple = f"{quad.subject} {quad.predicate} {quad.object} ."
        is_named = isinstance(quad.graph_name, NamedNode)
        parts.append(f"GRAPH {quad.graph_name} {{ {triple} }}" if is_named else triple)
    return "\n".join(parts)


def subject_of(quad: Quad) -> str:
    """Return the IRI of the quad's subject."""
    assert isinstance(quad.subject, NamedNode)
    return quad.subject.value


def text_of(quad: Quad) -> str:
    """Return the text of the quad's object."""
    assert isinstance(quad.object, Literal)
    return quad.object.value
