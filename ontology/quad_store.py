"""The graphs of a store as sets of triples, and the default graph, which is their merge.

Changes are numbered and the last ones are kept, for copies in other processes (`replicas`). A store
in memory goes on in another one now and then (`churn`).
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
from .entailment import Change
from .errors import OntologyError
from .replicas import ChangeLog, as_nquads

Changes: TypeAlias = dict[NamedNode, Change]
"""What comes to graphs, and goes."""


@dataclass(frozen=True, slots=True)
class StoreChanges:
    """What a copy of the store lacks, as N-Quads; ``whole`` replaces all that it has."""

    position: int
    whole: bytes | None
    added: bytes
    removed: bytes


class QuadStore:
    """A store whose default graph holds what any of its named graphs holds but the catalog. Who
    changes it has a lock of its own."""

    def __init__(self, store: Store, path: Path | None) -> None:
        self.store = store
        """All there is. Treat it as read-only."""
        self.path = path
        self._churn = Churn()
        self._log = ChangeLog()

    @property
    def position(self) -> int:
        """How many changes there were."""
        return self._log.position

    def graph(self, graph: NamedNode) -> frozenset[Triple]:
        """All that one graph says."""
        quads = self.store.quads_for_pattern(None, None, None, graph)
        return frozenset(quad.triple for quad in quads)

    def about(
        self, subject: NamedNode | None, predicate: NamedNode | None, graph: NamedNode
    ) -> Iterator[Quad]:
        """What a graph says of ``subject`` by ``predicate``; None: of all, by any."""
        return self.store.quads_for_pattern(subject, predicate, None, graph)

    def apply(self, changes: Changes) -> None:
        """Writes changes of named graphs and of the default graph, which is their merge.

        A triple leaves the default graph when no named graph holds it any more.
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
            self.store.extend(added)  # all at once, and without a text to be parsed
        elif any(_has_blank(quad) for quad in removed | added):
            # SPARQL's DELETE DATA names no blank nodes, so these go one after the other: what
            # comes first, so that nothing that stays is missing in between.
            self.store.extend(added)
            for quad in removed:
                self.store.remove(quad)
        else:
            self.store.update(
                f"DELETE DATA {{ {_data(removed)} }} ; INSERT DATA {{ {_data(added)} }}"
            )
        # A store in memory does not grow by what came and went.
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
        """What was changed survives from now on, if the store is on disk."""
        if self.path is not None:
            self.store.flush()

    def replace_store(self, store: Store, changes: Changes) -> None:
        """``store`` takes the place of this one, and then ``changes`` are made. Copies start
        anew."""
        self.store, self._churn = store, Churn()
        self.apply(changes)
        self._log.reset()

    def changes_since(self, position: int) -> tuple[Set[Quad], Set[Quad]] | None:
        """What came and went since; None where that is not known any more."""
        return self._log.since(position)

    def replica_changes(self, position: int | None) -> Callable[[], StoreChanges]:
        """What a copy lacks, see `StoreChanges`: what is returned tells it, and takes as long as
        that takes, in which the store may change."""
        store, position_now = self.store, self._log.position
        changes = None if position is None else self._log.since(position)
        if changes is not None:
            added, removed = changes
            return lambda: StoreChanges(position_now, None, as_nquads(added), as_nquads(removed))

        def full_dump() -> StoreChanges:
            # It may have some of what comes next, which the copy is told once more: no harm.
            dumped = store.dump(format=RdfFormat.N_QUADS)
            assert dumped is not None  # None only if an output file is given
            return StoreChanges(position_now, dumped, b"", b"")

        return full_dump


def quads_of(store: Store) -> bytes:
    """All of a store as N-Quads, sorted: each quad a line, blank nodes by their names."""
    return b"".join(sorted(f"{quad} .\n".encode() for quad in store))


def store_of(quads: bytes) -> Store:
    """The inverse of `quads_of`: one in memory."""
    store = Store()
    store.extend(parse(quads, RdfFormat.N_QUADS))
    return store


def open_store(path: Path) -> Store:
    """The store in a folder. Raises `OntologyError` if another process has it, or it is broken."""
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
    """What makes the one of the other."""
    return Change(then - before, before - then)


def _has_blank(quad: Quad) -> bool:
    return isinstance(quad.subject, BlankNode) or isinstance(quad.object, BlankNode)


def _data(quads: Iterable[Quad]) -> str:
    """Quads as SPARQL's QuadData."""
    parts = []
    for quad in quads:
        triple = f"{quad.subject} {quad.predicate} {quad.object} ."
        is_named = isinstance(quad.graph_name, NamedNode)
        parts.append(f"GRAPH {quad.graph_name} {{ {triple} }}" if is_named else triple)
    return "\n".join(parts)


def subject_of(quad: Quad) -> str:
    """The IRI of its subject."""
    assert isinstance(quad.subject, NamedNode)
    return quad.subject.value


def text_of(quad: Quad) -> str:
    """The text of its object."""
    assert isinstance(quad.object, Literal)
    return quad.object.value
