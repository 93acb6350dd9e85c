"""The static side of a continuous query: the closed ontology, or static files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Final

from pyoxigraph import BlankNode, NamedNode, Quad, Store, Triple

from ...ontology.entailment.deep_hierarchies import MARKERS, missing_pairs
from ...ontology.entailment.rules import SCHEMA, SYMMETRIC, Rules
from ...ontology.units import Conversion
from ...rdf.dictionary import Term
from ...rdf.namespaces import RDF_TYPE, shorten
from ..columns.budget import BudgetExceeded

MOST_MISSING: Final = 200_000
"""The limit of pairs that deep hierarchies add to one pattern; each is a Python object (2 µs)."""


class Background:
    """The triples of a store, merged into one graph, and its named graphs.

    ``default``: the IRIs of the graphs that form the default graph; None: all graphs. ``store`` may
    be a function, if a new version replaces the store object. ``version`` changes whenever the
    store does: scans are cached per version. ``rules`` returns the schema's rules on single
    triples; None: derive them from the default graph. ``conversion``: the conversion between the
    units of two features. Cost: a scan is one index look-up of Oxigraph and a Python object per
    triple.
    """

    def __init__(
        self,
        store: Store | Callable[[], Store] | None = None,
        version: Callable[[], int] | None = None,
        default: Collection[str] | None = None,
        rules: Callable[[], Rules] | None = None,
        conversion: Callable[[str, str], Conversion | None] | None = None,
    ) -> None:
        fixed = Store() if store is None else store
        self._store = fixed if callable(fixed) else lambda: fixed
        self._version = version or (lambda: 0)
        self._default = None if default is None else tuple(map(NamedNode, default))
        self._rules = rules
        self._own_rules: tuple[int, Rules] | None = None
        """The rules of the schema in the store, and the store's version."""
        self._supersorts: tuple[Rules | None, dict[str, frozenset[str]]] = None, {}
        """Results of `supersorts`, with the rules that gave them."""
        self.conversion = conversion or _unchanged

    @classmethod
    def from_files(
        cls,
        files: Iterable[str | Path] | Mapping[str, str | Path],
        default: Collection[str] | None = None,
    ) -> Background:
        """Read RDF files; the suffix determines the format. Each file of a mapping becomes the
        graph of its IRI."""
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
        """The current store."""
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
        """Return the distinct (subject, object) pairs of ``predicate`` that match; None matches all
        terms.

        Raises `BudgetExceeded` if a deep hierarchy adds more than `MOST_MISSING` pairs; so do
        `triples` and `copy`."""
        if subject is not None and not isinstance(subject, NamedNode | BlankNode):
            return []
        quads = self._quads(subject, predicate, object, graph)
        found = dict.fromkeys((quad.subject, quad.object) for quad in quads)
        # A quoted triple cannot be a term of a stream.
        return [(s, o) for s, o in found if not isinstance(s, Triple) and not isinstance(o, Triple)]

    def triples(self, graph: str = "") -> list[tuple[Term, NamedNode, Term]]:
        """Return all distinct triples of a graph ("": the default graph)."""
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
        """The rules of the schema on single triples; a new object after each possible change of the
        schema."""
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
        """Return ``sort`` and all sorts above it."""
        rules = self.rules
        if rules is not self._supersorts[0]:
            self._supersorts = rules, {}
        known = self._supersorts[1]
        if sort not in known:
            above = (kind for kind in rules.above(NamedNode(sort)) if isinstance(kind, NamedNode))
            known[sort] = frozenset({sort, *(kind.value for kind in above)})
        return known[sort]

    def copy(
        self, predicates: Collection[NamedNode] | None, classes: Collection[NamedNode] | None
    ) -> list[Quad]:
        """Return the triples of the default graph with these predicates, and of rdf:type only those
        with these classes; None: all. They are quads of the default graph, ready for a store that
        holds one window.
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
    """There are no units."""


def _base(path: str | Path) -> str:
    """Return the base of a file's relative IRIs."""
    return Path(path).absolute().as_uri()
