"""The static side of a continuous query: the closed ontology, or static files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from pathlib import Path

from pyoxigraph import BlankNode, NamedNode, Quad, Store, Triple

from ..rdf.dictionary import Term
from ..rdf.namespaces import RDF_TYPE, RDFS

_SUB_CLASS = NamedNode(RDFS + "subClassOf")


class Background:
    """All triples of a store, whatever graph they are in, read as one set.

    ``store`` may be a function, where another store takes its place with another version.
    ``version`` changes whenever the store does: what is derived from the store (scans, sorts) is
    kept per version. Cost: a scan is one index look-up of Oxigraph and a Python object a triple.
    """

    def __init__(
        self,
        store: Store | Callable[[], Store] | None = None,
        version: Callable[[], int] | None = None,
    ) -> None:
        known = Store() if store is None else store
        self._store = known if callable(known) else lambda: known
        self._version = version or (lambda: 0)
        self._sorts_version: int | None = None
        self._sorts: dict[str, frozenset[str]] = {}

    @classmethod
    def from_files(cls, paths: Iterable[str | Path]) -> Background:
        """The triples of RDF files; the format is told by the file's suffix."""
        store = Store()
        for path in paths:
            store.bulk_load(path=str(path))
        return cls(store)

    @property
    def store(self) -> Store:
        """The store as it is now."""
        return self._store()

    @property
    def version(self) -> int:
        return self._version()

    def scan(
        self, subject: Term | None, predicate: NamedNode, object: Term | None
    ) -> list[tuple[Term, Term]]:
        """The distinct (subject, object) pairs of ``predicate`` that match; None matches all."""
        if subject is not None and not isinstance(subject, NamedNode | BlankNode):
            return []
        quads = self.store.quads_for_pattern(subject, predicate, object, None)
        found = dict.fromkeys((quad.subject, quad.object) for quad in quads)
        # A quoted triple is no term of a stream.
        return [(s, o) for s, o in found if not isinstance(s, Triple) and not isinstance(o, Triple)]

    def has(self, predicate: NamedNode) -> bool:
        """Whether any static triple has this predicate."""
        return (
            next(iter(self.store.quads_for_pattern(None, predicate, None, None)), None) is not None
        )

    def supersorts(self, sort: str) -> frozenset[str]:
        """``sort`` and everything it is a sub-sort of, by rdfs:subClassOf."""
        version = self.version
        if version != self._sorts_version:
            self._sorts_version, self._sorts = version, {}
        found = self._sorts.get(sort)
        if found is None:
            reached, waiting = {sort}, [sort]
            while waiting:
                for _, above in self.scan(NamedNode(waiting.pop()), _SUB_CLASS, None):
                    if isinstance(above, NamedNode) and above.value not in reached:
                        reached.add(above.value)
                        waiting.append(above.value)
            found = self._sorts[sort] = frozenset(reached)
        return found

    def copy(
        self, predicates: Collection[NamedNode] | None, classes: Collection[NamedNode] | None
    ) -> list[Quad]:
        """The triples with these predicates, of rdf:type only these classes; None is any.

        As quads of the default graph, for a store that holds one window.
        """
        if predicates is None:
            return [
                Quad(quad.subject, quad.predicate, quad.object)
                for quad in self.store.quads_for_pattern(None, None, None, None)
            ]
        quads: list[Quad] = []
        for predicate in predicates:
            wanted: Iterable[NamedNode | None] = [None]
            if predicate == RDF_TYPE and classes is not None:
                wanted = classes
            for object in wanted:
                quads.extend(
                    Quad(quad.subject, quad.predicate, quad.object)
                    for quad in self.store.quads_for_pattern(None, predicate, object, None)
                )
        return quads
