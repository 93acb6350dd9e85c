"""The static side of a continuous query: the closed ontology, or static files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from pyoxigraph import BlankNode, NamedNode, Quad, Store, Triple

from ...ontology.deep_hierarchies import MARKERS, missing_pairs
from ...ontology.entailment import SCHEMA, SYMMETRIC, Rules
from ...ontology.units import Conversion
from ...rdf.dictionary import Term
from ...rdf.namespaces import RDF_TYPE, shorten
from ..columns.budget import BudgetExceeded

MOST_MISSING: Final = 200_000
"""Pairs of deep hierarchies that one pattern may give: a Python object each, some 2 µs."""


class Background:
    """The triples of a store, read as one set, and its named graphs where a query names them.

    ``default`` are the graphs that make up the default graph, by IRI; None: all there are.
    ``store`` may be a function, where another store takes its place with another version.
    ``version`` changes whenever the store does: what is derived from the store (scans) is kept per
    version. ``rules`` gives what the schema says of single triples; None: the schema is that of the
    default graph. ``conversion``: how numbers of one feature become numbers of another.
    Cost: a scan is one index look-up of Oxigraph and a Python object a triple.
    """

    def __init__(
        self,
        store: Store | Callable[[], Store] | None = None,
        version: Callable[[], int] | None = None,
        default: Collection[str] | None = None,
        rules: Callable[[], Rules] | None = None,
        conversion: Callable[[str, str], Conversion | None] | None = None,
    ) -> None:
        known = Store() if store is None else store
        self._store = known if callable(known) else lambda: known
        self._version = version or (lambda: 0)
        self._default = None if default is None else tuple(map(NamedNode, default))
        self._rules = rules
        self._own_rules: tuple[int, Rules] | None = None
        """Made of this version of the store."""
        self.conversion = conversion or _unchanged

    @classmethod
    def from_files(
        cls,
        files: Iterable[str | Path] | Mapping[str, str | Path],
        default: Collection[str] | None = None,
    ) -> Background:
        """The triples of RDF files; the format is told by the file's suffix. Of a mapping, each
        file is the graph of its IRI."""
        store = Store()
        if isinstance(files, Mapping):
            for iri, path in files.items():
                store.bulk_load(path=str(path), base_iri=_base(path), to_graph=NamedNode(iri))
            return cls(store, default=default)
        for path in files:
            store.bulk_load(path=str(path), base_iri=_base(path))
        return cls(store)

    @property
    def store(self) -> Store:
        """The store as it is now."""
        return self._store()

    @property
    def version(self) -> int:
        return self._version()

    def scan(
        self,
        subject: Term | None,
        predicate: NamedNode,
        object: Term | None,
        graph: str = "",
    ) -> list[tuple[Term, Term]]:
        """The distinct (subject, object) pairs of ``predicate`` that match; None matches all.

        Raises `BudgetExceeded` where a deep hierarchy gives more than `MOST_MISSING`; so do
        `triples` and `copy`."""
        if subject is not None and not isinstance(subject, NamedNode | BlankNode):
            return []
        quads = self._quads(subject, predicate, object, graph)
        found = dict.fromkeys((quad.subject, quad.object) for quad in quads)
        # A quoted triple is no term of a stream.
        return [(s, o) for s, o in found if not isinstance(s, Triple) and not isinstance(o, Triple)]

    def triples(self, graph: str = "") -> list[tuple[Term, NamedNode, Term]]:
        """All distinct triples of a graph ("" is the default graph)."""
        quads = self._quads(None, None, None, graph)
        found = dict.fromkeys((quad.subject, quad.predicate, quad.object) for quad in quads)
        return [
            (s, p, o)
            for s, p, o in found
            if not isinstance(s, Triple) and not isinstance(o, Triple)
        ]

    def has(self, predicate: NamedNode) -> bool:
        """Whether any triple of the default graph has this predicate."""
        return next(self._quads(None, predicate, None, ""), None) is not None

    def _quads(
        self,
        subject: NamedNode | BlankNode | None,
        predicate: NamedNode | None,
        object: Term | None,
        graph: str,
    ) -> Iterator[Quad]:
        names: Iterable[NamedNode | None] = self._default or ()
        if graph:
            names = (NamedNode(graph),)
        elif self._default is None:
            names = (None,)
        store = self.store
        for name in names:
            for quad in store.quads_for_pattern(subject, predicate, object, name):
                if quad.predicate not in MARKERS:
                    yield quad
            missing = missing_pairs(store, subject, predicate, object, name)
            for number, (lower, inclusion, upper) in enumerate(missing):
                if number == MOST_MISSING:
                    raise BudgetExceeded(
                        f"the hierarchy of {shorten(inclusion.value)} gives more than "
                        f"{MOST_MISSING} pairs: ask from one term or to one"
                    )
                yield Quad(lower, inclusion, upper)

    @property
    def rules(self) -> Rules:
        """What the schema says of single triples: another object when the schema may have
        changed."""
        if self._rules is not None:
            return self._rules()
        version = self.version
        if self._own_rules is None or self._own_rules[0] != version:
            self._own_rules = version, Rules(quad.triple for quad in self._schema())
        return self._own_rules[1]

    def _schema(self) -> Iterator[Quad]:
        for predicate in SCHEMA:
            symmetric = SYMMETRIC if predicate == RDF_TYPE else None
            yield from self._quads(None, predicate, symmetric, "")

    def supersorts(self, sort: str) -> frozenset[str]:
        """``sort`` and everything it is a sub-sort of."""
        above = self.rules.above(NamedNode(sort))
        return frozenset({sort, *(kind.value for kind in above if isinstance(kind, NamedNode))})

    def copy(
        self, predicates: Collection[NamedNode] | None, classes: Collection[NamedNode] | None
    ) -> list[Quad]:
        """The triples of the default graph with these predicates, of rdf:type only these classes;
        None is any. As quads of the default graph, for a store that holds one window.
        """
        wanted: list[tuple[NamedNode | None, NamedNode | None]] = [(None, None)]
        if predicates is not None:
            wanted = [
                (predicate, object)
                for predicate in predicates
                for object in (
                    classes if predicate == RDF_TYPE and classes is not None else (None,)
                )
            ]
        return [
            Quad(quad.subject, quad.predicate, quad.object)
            for predicate, object in wanted
            for quad in self._quads(None, predicate, object, "")
        ]


def _unchanged(_source: str, _target: str) -> None:
    """No unit is known."""


def _base(path: str | Path) -> str:
    """What relative IRIs in a file are relative to."""
    return Path(path).absolute().as_uri()
