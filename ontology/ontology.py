"""The ontology: Oxigraph store, closure, vocabulary, live stream space (SPEC §2, DESIGN §4).

One `Ontology` owns its store. It makes one change at a time; a query sees the state before or after
a change. `graphs` lists the graphs, and docs/reference/ontology.md explains them.

The class is long: it is the face of the room, and all its methods need the one store and its lock.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator, Set
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cache
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyoxigraph import (
    BlankNode,
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    QuerySolutions,
    RdfFormat,
    Store,
    Triple,
    serialize,
)

from ..rdf.dictionary import Term
from ..rdf.namespaces import OWL, PREFIXES
from . import graphs
from .entailment.closure import cached_closure, shipped_closure
from .entailment.closure_key import closure_key
from .entailment.closure_queries import QueryResults, answer
from .entailment.rules import Change, Entailments, Rules
from .errors import OntologyError, QueryRefused
from .quad_store import (
    QuadStore,
    StoreChanges,
    difference,
    open_store,
    quads_of,
    store_of,
    subject_of,
    text_of,
)
from .reasoning import DIRECT, Reasoning
from .registrations import Registrations
from .shipped_files import shipped_ontologies, text_hash
from .static_side import StaticSide
from .successor import CONCEPTS, Successor, build_successor
from .texts.reading import TextFormat
from .units import UnitError
from .vocabulary import Vocabulary

if TYPE_CHECKING:
    from .validation import ShaclReport

_IMPORTS = NamedNode(OWL + "imports")

_PIECE = 250
"""Triples of the live stream space that one step writes to the store: some 10 ms."""
_MOST_PENDING = 10_000
"""The greatest number of pending triples. A caller that adds more applies some of them itself:
back-pressure."""


@dataclass(frozen=True, slots=True)
class PreparedOntology:
    """An ontology that is parsed and closed, but not installed yet; or one that is to be removed,
    without triples. ``hashes`` are those of all texts that will be loaded then, ``implied`` are the
    triples that they entail together. ``successor`` replaces an in-memory store. ``lost`` are the
    terms that a removal takes away or changes."""

    graph: NamedNode
    triples: frozenset[Triple]
    hashes: dict[str, str]
    implied: frozenset[Triple]
    successor: Successor | None
    lost: frozenset[str] = frozenset()


class Ontology:
    """The loaded ontologies with their entailments, and the live stream space.

    Contract: each change is flushed before the call returns if the store is on disk. `mirror` is
    the exception: the engine rebuilds its graph at each start. A refused change leaves everything
    as it was. `version` grows with each change of ontologies, templates, annotations and
    declarations, not with the stream space. All methods are thread-safe.
    """

    def __init__(self, store: Store, path: Path | None, like: Ontology | None = None) -> None:
        """Use `open`, `open_copy` or `from_quads`. ``like``: has the content of ``store``."""
        self._quads = QuadStore(store, path)
        self._pending: OrderedDict[Triple, bool] = OrderedDict()
        """Triples of the live stream space that are not in the store yet, in order; True adds,
        False removes. `mirror` appends; a change that reverts a pending one removes it."""
        self._applying: dict[Triple, bool] = {}
        """The pending triples that `_apply_pending_piece` is writing."""
        self._pending_lock = threading.Lock()
        """Guards these two, for a dict look-up at a time. A thread that takes pending triples also
        holds `lock`. A process forked while `lock` is held therefore finds this lock free."""
        self.path = path
        self.version = 0
        self._lock = threading.RLock()
        self._static = StaticSide(self._quads)
        self._live: Entailments
        self._concepts: Entailments
        self._base: Vocabulary
        if like is None:
            self._start()
        else:
            rules = like._live.rules
            self._live, self._concepts = Entailments(rules), Entailments(rules)
            self._base = like._base
            self._bump_version()

    @classmethod
    def open(cls, path: Path | None = None) -> Ontology:
        """Return the ontology in the folder ``path``, or a new one in memory.

        It loads the shipped ontologies that are new or have changed. Raises `OntologyError` if
        another process has opened the store or the store is broken. Cost: a closure, unless the
        folder or the package contains it.
        """
        if path is not None:
            return cls(open_store(path), path)
        shipped = _shipped()
        store = Store()
        store.extend(shipped.static_store)
        return cls(store, None, like=shipped)

    @classmethod
    def open_copy(cls, path: Path) -> Ontology:
        """Return an in-memory copy of the folder ``path``, which stays unchanged. Raises
        `OntologyError`."""
        on_disk = open_store(path)
        store = Store()
        store.extend(on_disk)
        return cls(store, None)

    @classmethod
    def from_quads(cls, quads: bytes) -> Ontology:
        """Return an in-memory ontology from the N-Quads of `quads`."""
        return cls(store_of(quads), None)

    @property
    def store(self) -> Store:
        """The store with all pending changes applied. Treat it as read-only. Cost: that of the
        pending changes."""
        self._apply_pending()
        return self._quads.store

    @property
    def lock(self) -> AbstractContextManager[object]:
        """The lock of every change. A thread that copies the process must hold it too. Changes hold
        it for some milliseconds, but for 2 s per million quads when they replace a large store
        (`churn`)."""
        return self._lock

    @property
    def static_store(self) -> Store:
        """The store, possibly without the latest changes of the live stream space."""
        return self._quads.store

    def quads(self) -> bytes:
        """Return all quads as sorted N-Quads."""
        with self._lock:
            return quads_of(self.store)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state of an in-memory ontology for a copy. Each copy has its own locks; the
        copier handles the store (engine/durability/checkpoint)."""
        assert self.path is None
        self._apply_pending()
        state = dict(self.__dict__)
        del state["_lock"], state["_pending_lock"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _lock=threading.RLock(), _pending_lock=threading.Lock())

    # -- ontologies -------------------------------------------------------------------------

    def load(self, text: str, *, name: str, format: TextFormat = "turtle") -> None:
        """Add the ontology ``text`` as ``name``, or replace the one of that name.

        ``name`` is an absolute IRI or a short name; FROM uses it too. Imports are not followed
        (`imports` lists them). Raises `OntologyError` with line and column for a malformed text, a
        contradiction with the other ontologies, or a feature with an unknown unit. Cost: a closure
        of all loaded ontologies.
        """
        self.install(self.prepare(text, name=name, format=format))

    def prepare(
        self, text: str, *, name: str, format: TextFormat = "turtle", reasoning: Reasoning = DIRECT
    ) -> PreparedOntology:
        """Do the slow part of `load` without changing anything. Thread-safe. Raises the errors of
        `load` and those of ``reasoning``."""
        graph = _ontology_graph(name)
        triples = reasoning.read(text, format, graph)
        # Reads without the lock: if the ontologies change meanwhile, `install` refuses.
        hashes = {**self._hashes(), graph.value: text_hash(f"{format}\n{text}")}
        return self._prepared(graph, triples, hashes, reasoning)

    def prepare_removal(self, name: str, *, reasoning: Reasoning = DIRECT) -> PreparedOntology:
        """Do the slow part of removing the loaded ontology ``name`` without changing anything;
        `install` does the rest. Thread-safe. Raises the errors of ``reasoning``."""
        graph = _ontology_graph(name)
        return self._prepared(graph, frozenset(), _without(self._hashes(), graph), reasoning)

    def _prepared(
        self,
        graph: NamedNode,
        triples: frozenset[Triple],
        hashes: dict[str, str],
        reasoning: Reasoning,
    ) -> PreparedOntology:
        asserted = self._asserted_triples({graph: triples}, hashes)
        kept_closure = self._kept_closure(closure_key(hashes))
        implied = reasoning.entail(asserted) if kept_closure is None else kept_closure
        is_removed = graph.value not in hashes
        successor, lost = None, frozenset[str]()
        if self.path is None or is_removed:
            # This may raise, so it comes before `_successor`, whose iterator a traceback would
            # keep: only the thread that made an iterator may drop it.
            try:
                vocabulary = Vocabulary.from_triples(chain(asserted, implied))
            except UnitError as error:
                raise OntologyError(str(error)) from error
            if is_removed:
                described = self._quads.graph(graph)
                named = {t.subject.value for t in described if isinstance(t.subject, NamedNode)}
                lost = frozenset(iri for iri in named if not self._base.agrees(vocabulary, iri))
            if self.path is None:
                successor = self._successor(graph, triples, hashes, (asserted, implied), vocabulary)
        return PreparedOntology(graph, triples, hashes, implied, successor, lost)

    def _successor(
        self,
        graph: NamedNode,
        triples: frozenset[Triple],
        hashes: dict[str, str],
        stated_and_implied: tuple[frozenset[Triple], frozenset[Triple]],
        vocabulary: Vocabulary,
    ) -> Successor:
        with self._lock:
            # The iterator reads a snapshot: the store as it is now.
            now = self._quads.store.quads_for_pattern(None, None, None, None)
            asserted = (self._concepts.asserted, self._live.asserted)
            position = self._quads.position
        replaced = {graph: triples, graphs.CATALOG: _catalog(hashes)}
        return build_successor(position, now, replaced, stated_and_implied, asserted, vocabulary)

    def install(self, prepared: PreparedOntology) -> None:
        """Install a prepared ontology, or remove it. Raises `OntologyError` if it contradicts the
        vocabulary, or if other ontologies were loaded or removed since."""
        with self._lock:
            graph = prepared.graph
            if _without(self._hashes(), graph) != _without(prepared.hashes, graph):
                raise OntologyError(
                    "another ontology was loaded or removed meanwhile",
                    hint="send the request again",
                )
            if not self._adopt(prepared.successor):
                self._reload({prepared.graph: prepared.triples}, prepared.hashes, prepared.implied)

    def _adopt(self, successor: Successor | None) -> bool:
        """Replace the store by ``successor``. Returns False if too much has changed since it was
        built. Cost: that of the changes since."""
        missed = None if successor is None else self._quads.changes_since(successor.position)
        if successor is None or missed is None:
            return False
        changes = successor.follow(*missed)
        self._quads.replace_store(successor.store, changes)
        self._concepts, self._live, self._base = (
            successor.concepts,
            successor.live,
            successor.vocabulary,
        )
        self._bump_version()
        self._static.replace_store(successor.static)
        self._static.follow(
            *(changes[g] for g in (*CONCEPTS, graphs.CONCEPT_ENTAILMENTS) if g in changes)
        )
        return True

    @property
    def rules(self) -> Rules:
        """The rules of the loaded ontologies' schema; a new object after each load."""
        return self._live.rules

    def ontologies(self) -> tuple[str, ...]:
        """Return the IRIs of the loaded ontologies' graphs, sorted."""
        return tuple(sorted(self._hashes()))

    @property
    def number(self) -> int:
        """The number of loaded ontologies. Cost: linear in it."""
        return len(self._hashes())

    def named_graphs(self) -> list[str]:
        """Return the IRIs of the graphs that contain triples, sorted, possibly without a graph of
        the live stream space whose first triples are pending. Cost: a look-up a graph."""
        return self._quads.names()

    def imports(self) -> tuple[str, ...]:
        """Return the IRIs that the loaded ontologies import. Nothing was fetched; `load`
        adds them."""
        quads = self._quads.store.quads_for_pattern(None, _IMPORTS, None, DefaultGraph())
        return tuple(sorted({q.object.value for q in quads if isinstance(q.object, NamedNode)}))

    def has_ontology(self, iri: str) -> bool:
        """Return whether a loaded ontology has this name, so that ``FROM <iri>`` means it."""
        return iri in self._hashes()

    def loaded(self, name: str) -> NamedNode | None:
        """Return the graph of the loaded ontology ``name``, an IRI or a short name; None if there
        is none."""
        try:
            graph = graphs.ontology_graph(name)
        except ValueError:
            return None
        return graph if self.has_ontology(graph.value) else None

    def ontologies_naming(self, terms: Set[str], graph: NamedNode) -> tuple[str, ...]:
        """Return the loaded ontologies, except that of ``graph``, that refer to a term which none
        of them describes. Cost: the triples that name a term."""
        others = {NamedNode(iri) for iri in self._hashes()} - {graph}
        found: set[NamedNode] = set()
        for node in map(NamedNode, terms):
            if not self._graphs_with(others, node, None, None):
                found |= self._graphs_with(others, None, node, None)
                found |= self._graphs_with(others, None, None, node)
        return tuple(sorted(each.value for each in found))

    def _graphs_with(
        self,
        among: Set[NamedNode],
        subject: NamedNode | None,
        predicate: NamedNode | None,
        object: NamedNode | None,
    ) -> set[NamedNode]:
        """Return those of some graphs that have a triple of this pattern."""
        quads = self._quads.store.quads_for_pattern(subject, predicate, object)
        names = (quad.graph_name for quad in quads)
        return {name for name in names if isinstance(name, NamedNode) and name in among}

    def turtle(self, graph: NamedNode) -> str:
        """Return the triples of a loaded ontology as Turtle, by subject. Comments of the loaded
        text are not kept."""
        triples = sorted(self._quads.graph(graph), key=str)
        # Turtle is UTF-8.
        text = serialize(triples, format=RdfFormat.TURTLE, prefixes=PREFIXES)
        assert text is not None
        return text.decode()

    def closed_store(self) -> Store:
        """Return the static side of continuous queries: the default graph of a store of its own.

        It contains the loaded ontologies, templates and all entailments, but not the live stream
        space. Treat it as read-only. A new `version` means another store or other triples.
        """
        with self._lock:
            return self._static.store(self._static_triples)

    def _static_triples(self) -> frozenset[Triple]:
        return self._ontology_triples() | self._concepts.asserted | self._concepts.current

    # -- registrations -------------------------------------------------------------------------

    @property
    def registered(self) -> Registrations:
        """The texts of templates, annotations, declared streams and so on."""
        return Registrations(self)

    def about(
        self, subject: NamedNode | None, predicate: NamedNode, graph: NamedNode
    ) -> Iterator[Quad]:
        """Yield the quads of a graph with ``predicate``, of ``subject`` or of all subjects."""
        return self._quads.about(subject, predicate, graph)

    def replace_triples(self, graph: NamedNode, subject: NamedNode, triples: set[Triple]) -> None:
        """Replace all triples of ``subject`` in ``graph`` by ``triples``, and update their
        entailments."""
        with self._lock:
            before = {quad.triple for quad in self._quads.about(subject, None, graph)}
            change = difference(frozenset(before), frozenset(triples))
            _, implied = self._concepts.update(change.added, change.removed)
            self._quads.apply({graph: change, graphs.CONCEPT_ENTAILMENTS: implied})
            self._quads.flush()
            self._static.follow(change, implied)
            self._bump_version()

    def replace_unread_triples(
        self, graph: NamedNode, subject: NamedNode, triples: set[Triple]
    ) -> None:
        """Do the same for a graph that no rule and no continuous query reads. `version` stays, so
        no query looks at the ontology again."""
        with self._lock:
            before = {quad.triple for quad in self._quads.about(subject, None, graph)}
            self._quads.apply({graph: difference(frozenset(before), frozenset(triples))})
            self._quads.flush()

    # -- the live stream space ---------------------------------------------------------------

    def mirror(self, added: Iterable[Triple], removed: Iterable[Triple]) -> None:
        """Change the live stream space; `entailment.rules` maintain its entailments.

        A triple in both arguments stays. `store` and every query include the change. It is written
        at the next read or by `apply_pending_piece`: a triple that comes and goes in between is
        never written, and a large change is written in pieces. Nothing is flushed, since opening a
        store empties the graph. Cost: O(changed triples).
        """
        with self._pending_lock:
            for triples, exists in ((removed, False), (added, True)):
                for triple in triples:
                    self._pending.pop(triple, None)
                    will_be = self._applying.get(triple)
                    if (self._live.is_asserted(triple) if will_be is None else will_be) != exists:
                        self._pending[triple] = exists
        if len(self._pending) > _MOST_PENDING:
            self.apply_pending_piece()

    def apply_pending_piece(self) -> None:
        """Write some pending triples to the store, unless another thread holds the lock."""
        if self._pending and self._lock.acquire(blocking=False):
            try:
                self._apply_pending_piece()
            finally:
                self._lock.release()

    def _apply_pending(self) -> None:
        while self._pending:
            # Releases the lock between two pieces, so that other threads get turns.
            with self._lock:
                self._apply_pending_piece()

    def _apply_pending_piece(self) -> None:
        changed: tuple[list[Triple], list[Triple]] = ([], [])
        with self._pending_lock:
            # Oldest first: some of the latest are about to be reverted.
            for _ in range(min(_PIECE, len(self._pending))):
                triple, exists = self._pending.popitem(last=False)
                # Until it is in `_live`, `mirror` compares with this.
                self._applying[triple] = exists
                changed[exists].append(triple)
        try:
            asserted, implied = self._live.update(changed[True], changed[False])
        finally:
            with self._pending_lock:
                self._applying.clear()
        self._quads.apply({graphs.STREAM_SPACE: asserted, graphs.STREAM_SPACE_ENTAILMENTS: implied})

    # -- queries ------------------------------------------------------------------------------

    def query(self, sparql: str) -> QueryResults:
        """Evaluate a query over ontologies, entailments, templates and the live stream space.

        Raises `QueryRefused` (`query_guard`). The calling thread must consume the solutions.
        There is no deadline: the service runs the queries of strangers in another process.
        """
        return answer(self.store, sparql)

    def changes_since(self, position: int | None) -> StoreChanges:
        """Return the changes that a replica at ``position`` lacks; None: a replica without data.
        Cost: O(changes), or a dump of the store, made without the lock."""
        self._apply_pending()
        with self._lock:
            dump = self._quads.replica_changes(position)
        return dump()

    def query_rows(self, sparql: str) -> tuple[tuple[str, ...], list[tuple[Term | None, ...]]]:
        """Evaluate a SELECT to variables and rows; None is unbound. Raises `QueryRefused` for other
        forms."""
        results = self.query(sparql)
        if not isinstance(results, QuerySolutions):
            raise QueryRefused("a table needs a SELECT query", 1, 1)
        variables = tuple(variable.value for variable in results.variables)
        return variables, [tuple(map(_rdf11, solution)) for solution in results]

    def validate(self) -> ShaclReport:
        """Check the stream space against the shapes of shapes.ttl."""
        # Imported here: pyshacl and rdflib take half a second, and only interactive requests need
        # them.
        from .validation import validate

        pattern = None, None, None, DefaultGraph()
        # A list: the import of pySHACL leaves its callers' frames in a cycle. Another thread may
        # collect them, and pyoxigraph reports an error if that drops an iterator of the store.
        return validate([quad.triple for quad in self.store.quads_for_pattern(*pattern)])

    # -- internals ----------------------------------------------------------------------------

    def _start(self) -> None:
        """Load the shipped ontologies, reuse the stored closure, and empty the live graphs."""
        hashes = self._hashes()
        new = {}
        for ontology in shipped_ontologies():
            digest = text_hash(ontology.text())
            if hashes.get(ontology.graph.value) != digest:
                new[ontology.graph] = ontology.triples()
                hashes[ontology.graph.value] = digest
        self._live = Entailments(Rules(()))
        self._concepts = Entailments(Rules(()))
        emptied = {
            graph: Change(frozenset(), self._quads.graph(graph))
            for graph in (graphs.STREAM_SPACE, graphs.STREAM_SPACE_ENTAILMENTS)
        }
        self._quads.apply(emptied)
        self._reload(new, hashes)

    def _asserted_triples(
        self, new: dict[NamedNode, frozenset[Triple]], hashes: dict[str, str]
    ) -> frozenset[Triple]:
        loaded = {NamedNode(iri): self._quads.graph(NamedNode(iri)) for iri in hashes} | new
        return frozenset().union(*loaded.values())

    def _kept_closure(self, key: str) -> frozenset[Triple] | None:
        """Return the closure with this key: the stored one, or that of the shipped ontologies."""
        is_kept = Triple(graphs.ENTAILMENTS, graphs.CLOSED, Literal(key)) in self._quads.graph(
            graphs.CATALOG
        )
        return self._quads.graph(graphs.ENTAILMENTS) if is_kept else shipped_closure(key)

    def _reload(
        self,
        new: dict[NamedNode, frozenset[Triple]],
        hashes: dict[str, str],
        implied: frozenset[Triple] | None = None,
    ) -> None:
        """Replace the graphs ``new`` and everything derived from the ontologies."""
        asserted = self._asserted_triples(new, hashes)
        key = closure_key(hashes)
        if implied is None:
            implied = self._kept_closure(key)
        if implied is None:
            implied = cached_closure(asserted)
        try:
            vocabulary = Vocabulary.from_triples(asserted | implied)
        except UnitError as error:
            raise OntologyError(str(error)) from error
        rules = Rules(asserted | implied)
        concepts = Entailments(rules, self._concept_triples())
        live = Entailments(rules, self._live.asserted)
        wanted = {
            **new,
            graphs.ENTAILMENTS: implied,
            graphs.CONCEPT_ENTAILMENTS: concepts.current,
            graphs.STREAM_SPACE_ENTAILMENTS: live.current,
            graphs.CATALOG: _catalog(hashes),
        }
        now = {graph: self._quads.graph(graph) for graph in wanted}
        self._quads.apply({graph: difference(now[graph], then) for graph, then in wanted.items()})
        self._quads.flush()
        self._concepts, self._live, self._base = concepts, live, vocabulary
        self._static.replace_store(None)
        self._bump_version()

    def _bump_version(self) -> None:
        self.version += 1
        self.vocabulary = self._base.with_events(self.registered.templates, self.version)

    def _hashes(self) -> dict[str, str]:
        quads = self._quads.store.quads_for_pattern(None, graphs.LOADED, None, graphs.CATALOG)
        return {subject_of(q): text_of(q) for q in quads}

    def _ontology_triples(self) -> frozenset[Triple]:
        names = [NamedNode(iri) for iri in self._hashes()]
        return frozenset().union(*map(self._quads.graph, [*names, graphs.ENTAILMENTS]))

    def _concept_triples(self) -> frozenset[Triple]:
        return frozenset().union(*map(self._quads.graph, CONCEPTS))


@cache
def _shipped() -> Ontology:
    """The shipped ontologies, for the ontologies in memory that start with them."""
    return Ontology(Store(), None)


def _rdf11(term: object) -> Term | None:
    assert term is None or isinstance(term, NamedNode | BlankNode | Literal)
    return term


def _catalog(hashes: dict[str, str]) -> frozenset[Triple]:
    """Return the triples of the catalog: the loaded ontologies, and the key of the closure."""
    loaded = {Triple(NamedNode(g), graphs.LOADED, Literal(h)) for g, h in hashes.items()}
    closed = Triple(graphs.ENTAILMENTS, graphs.CLOSED, Literal(closure_key(hashes)))
    return frozenset(loaded | {closed})


def _without(hashes: dict[str, str], graph: NamedNode) -> dict[str, str]:
    return {iri: digest for iri, digest in hashes.items() if iri != graph.value}


def _ontology_graph(name: str) -> NamedNode:
    try:
        graph = graphs.ontology_graph(name)
    except ValueError as error:
        raise OntologyError(f"{name!r} is not a name for an ontology: {error}") from error
    if graph in graphs.SYSTEM:
        raise OntologyError(f"the name {name} is reserved")
    return graph
