"""The ontology: Oxigraph store, closure, vocabulary, live stream space (SPEC §2, DESIGN §4).

One `Ontology` owns its store. Changes are made one at a time and whole; queries see the state
before or after one. The graphs are listed in `graphs` and explained in docs/ontology.md.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from pyoxigraph import (
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    Store,
    Triple,
)

from ..rdf.dictionary import Term
from ..rdf.namespaces import OWL
from . import graphs
from .answers import rows_of, serialized
from .closure import cached_closure, closure_key
from .closure_queries import QueryResults, answer
from .entailment import Change, Entailments, Rules
from .errors import OntologyError
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
from .query_guard import check_user_query
from .reading import TextFormat
from .reasoning import DIRECT, Reasoning
from .registrations import Registrations
from .shipped_files import shipped_ontologies, text_hash
from .static_side import StaticSide
from .successor import CONCEPTS, Successor, build_successor
from .units import UnitError
from .validation import ShaclReport, validate
from .vocabulary import Vocabulary

_IMPORTS = NamedNode(OWL + "imports")

_PIECE = 250
"""Triples of the live stream space that are brought into the store in one go: some 10 ms."""
_MOST_PENDING = 10_000
"""So many may wait to be brought in; whoever changes more brings some of them in."""


@dataclass(frozen=True, slots=True)
class PreparedOntology:
    """An ontology that is read and reasoned about, and not loaded yet: ``hashes`` are those of all
    texts that are loaded with it, ``implied`` is what they entail together. ``successor``: what
    takes the place of a store in memory."""

    graph: NamedNode
    triples: frozenset[Triple]
    hashes: dict[str, str]
    implied: frozenset[Triple]
    successor: Successor | None


class Ontology:
    """The loaded ontologies with what they entail, and the live stream space.

    Contract: every change is kept when the call returns (flushed, if the store is on disk), except
    `mirror`, whose graph is rebuilt by the engine at each start. A change that is refused leaves
    everything as it was. `version` grows with each change of ontologies, templates, annotations
    and declarations, not with the stream space. Any thread may call.
    """

    def __init__(self, store: Store, path: Path | None) -> None:
        """Use `open`."""
        self._quads = QuadStore(store, path)
        self._pending: OrderedDict[Triple, bool] = OrderedDict()
        """Triples of the live stream space that are not in the store yet: whether they come or go.
        Added to by those who tell of changes, who take back what is as it was."""
        self._applying: dict[Triple, bool] = {}
        """Those of them that are being brought in."""
        self._pending_lock = threading.Lock()
        """Of these two: had for a look-up a triple. Who takes some has `lock`, too, so that in a
        copy of the process it is free."""
        self.path = path
        self.version = 0
        self._lock = threading.RLock()
        self._static = StaticSide(self._quads)
        self._start()

    @classmethod
    def open(cls, path: Path | None = None) -> Ontology:
        """The ontology kept in the folder ``path``, or a new one in memory.

        Ontologies that come with the program are loaded if they are new or have changed. Raises
        `OntologyError` if another process has the store open or it cannot be read. Cost: a closure
        (about 0.4 s) unless the folder holds it already.
        """
        if path is None:
            return cls(Store(), None)
        return cls(open_store(path), path)

    @classmethod
    def open_copy(cls, path: Path) -> Ontology:
        """One in memory with what the folder ``path`` keeps, which stays as it is. Raises
        `OntologyError`."""
        on_disk = open_store(path)
        store = Store()
        store.extend(on_disk)
        return cls(store, None)

    @classmethod
    def from_quads(cls, quads: bytes) -> Ontology:
        """One in memory with these N-Quads, of `quads`."""
        return cls(store_of(quads), None)

    @property
    def store(self) -> Store:
        """All there is. Treat it as read-only. Cost: what `mirror` was told of and is not there."""
        self._apply_pending()
        return self._quads.store

    @property
    def lock(self) -> AbstractContextManager[object]:
        """Who changes it has this, whichever thread that is: whoever copies the process must, too.
        Others have it for some milliseconds, but 2 s a million quads where a large store is made
        anew (`churn`)."""
        return self._lock

    @property
    def static_store(self) -> Store:
        """The same, but that the live stream space may be as it was a moment ago."""
        return self._quads.store

    def quads(self) -> bytes:
        """All there is as N-Quads, sorted."""
        with self._lock:
            return quads_of(self.store)

    def __getstate__(self) -> dict[str, Any]:
        """As it is copied, if it is in memory: the lock is each one's own. The store is for who
        copies (engine/durability/checkpoint)."""
        assert self.path is None
        self._apply_pending()
        state = dict(self.__dict__)
        del state["_lock"], state["_pending_lock"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, _lock=threading.RLock(), _pending_lock=threading.Lock())

    # -- ontologies -------------------------------------------------------------------------

    def load(self, text: str, *, name: str, format: TextFormat = "turtle") -> None:
        """Adds the ontology ``text`` as ``name``, or replaces the one of that name.

        ``name`` is an absolute IRI or a short name; it is what FROM calls the ontology. Imports
        are not followed (`imports` lists them). Raises `OntologyError` with line and column for a
        text that cannot be read, contradicts the others, or gives a feature an unknown unit.
        Cost: a closure of all loaded ontologies.
        """
        self.install(self.prepare(text, name=name, format=format))

    def prepare(
        self, text: str, *, name: str, format: TextFormat = "turtle", reasoning: Reasoning = DIRECT
    ) -> PreparedOntology:
        """All of `load` that takes time: nothing has changed when it returns. Any thread may call;
        raises as `load`, and what ``reasoning`` raises."""
        graph = _ontology_graph(name)
        triples = reasoning.read(text, format, graph)
        # Nobody waits for what is read here: where ontologies change meanwhile, `install` refuses.
        hashes = {**self._hashes(), graph.value: text_hash(f"{format}\n{text}")}
        asserted = self._asserted({graph: triples}, hashes)
        kept_closure = self._kept_closure(closure_key(hashes))
        implied = reasoning.entailed(asserted) if kept_closure is None else kept_closure
        successor = None
        if self.path is None:
            try:
                successor = self._successor(graph, triples, hashes, (asserted, implied))
            except UnitError as error:
                raise OntologyError(str(error)) from error
        return PreparedOntology(graph, triples, hashes, implied, successor)

    def _successor(
        self,
        graph: NamedNode,
        triples: frozenset[Triple],
        hashes: dict[str, str],
        stated_and_implied: tuple[frozenset[Triple], frozenset[Triple]],
    ) -> Successor:
        # First, as it may raise: an iterator of a store must not be in a frame that an error keeps,
        # since it may be dropped only where it was made.
        vocabulary = Vocabulary.from_triples(chain(*stated_and_implied))
        with self._lock:
            # A store's iterator goes on with what there was when it was made.
            now = self._quads.store.quads_for_pattern(None, None, None, None)
            held = (self._concepts.asserted, self._live.asserted)
            position = self._quads.position
        replaced = {graph: triples, graphs.CATALOG: _catalog(hashes)}
        return build_successor(position, now, replaced, stated_and_implied, held, vocabulary)

    def install(self, prepared: PreparedOntology) -> None:
        """Load what was prepared. Raises `OntologyError` if it contradicts the vocabulary, or other
        ontologies were loaded since."""
        with self._lock:
            graph = prepared.graph.value
            if {**self._hashes(), graph: prepared.hashes[graph]} != prepared.hashes:
                raise OntologyError(
                    "another ontology was loaded meanwhile", hint="load this one again"
                )
            if not self._adopt(prepared.successor):
                self._reload({prepared.graph: prepared.triples}, prepared.hashes, prepared.implied)

    def _adopt(self, successor: Successor | None) -> bool:
        """Go on with ``successor``; False where too much has changed since it was made. Cost: as
        much as has changed."""
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
        """What the schema of the loaded ontologies says of single triples: another object when an
        ontology was loaded."""
        return self._live.rules

    def ontologies(self) -> tuple[str, ...]:
        """The IRIs of the loaded ontologies' graphs."""
        return tuple(sorted(self._hashes()))

    @property
    def number(self) -> int:
        """How many ontologies are loaded. Cost: O(ontologies)."""
        return len(self._hashes())

    def imports(self) -> tuple[str, ...]:
        """What the loaded ontologies import; it was not fetched. Load it by `load` if needed."""
        quads = self._quads.store.quads_for_pattern(None, _IMPORTS, None, DefaultGraph())
        return tuple(sorted({q.object.value for q in quads if isinstance(q.object, NamedNode)}))

    def has_ontology(self, iri: str) -> bool:
        """True if a loaded ontology has this name: then ``FROM <iri>`` means it."""
        return iri in self._hashes()

    def closed_store(self) -> Store:
        """The static side of continuous queries, in the default graph of a store of its own.

        Loaded ontologies, templates and all that is entailed; not the live stream space. It is
        another store, or has other triples, when `version` has changed. Treat it as read-only.
        """
        with self._lock:
            return self._static.store(self._static_triples)

    def _static_triples(self) -> frozenset[Triple]:
        return self._ontology_triples() | self._concepts.asserted | self._concepts.current

    # -- what people registered ---------------------------------------------------------------

    @property
    def registered(self) -> Registrations:
        """Templates, annotations, declared streams and so on, as texts."""
        return Registrations(self)

    def about(
        self, subject: NamedNode | None, predicate: NamedNode, graph: NamedNode
    ) -> Iterator[Quad]:
        """What a graph says by ``predicate``, of ``subject`` or of all."""
        return self._quads.about(subject, predicate, graph)

    def replace_triples(self, graph: NamedNode, subject: NamedNode, triples: set[Triple]) -> None:
        """Makes ``triples`` all that ``graph`` says of ``subject``."""
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
        """The same of what nothing follows from and no continuous query reads: to them the
        ontology is as it was, and they need not look at it anew."""
        with self._lock:
            before = {quad.triple for quad in self._quads.about(subject, None, graph)}
            self._quads.apply({graph: difference(frozenset(before), frozenset(triples))})
            self._quads.flush()

    # -- the live stream space ---------------------------------------------------------------

    def mirror(self, added: Iterable[Triple], removed: Iterable[Triple]) -> None:
        """Changes the live stream space; what it entails follows (`entailment`).

        A triple in both is there afterwards. Whoever asks sees it; it is brought into the store
        when somebody does, or by `apply_pending_piece`: what comes and goes in between leaves nothing, and a
        large change is made in pieces. Not flushed: the graph is emptied when the store is opened.
        Cost: O(changed triples).
        """
        with self._pending_lock:
            for triples, there in ((removed, False), (added, True)):
                for triple in triples:
                    self._pending.pop(triple, None)
                    will_be = self._applying.get(triple)
                    if (self._live.is_asserted(triple) if will_be is None else will_be) != there:
                        self._pending[triple] = there
        if len(self._pending) > _MOST_PENDING:
            self.apply_pending_piece()

    def apply_pending_piece(self) -> None:
        """Bring some of what `mirror` was told of into the store, if nobody else is at it."""
        if self._pending and self._lock.acquire(blocking=False):
            try:
                self._apply_pending_piece()
            finally:
                self._lock.release()

    def _apply_pending(self) -> None:
        while self._pending:
            # Others may have the lock in between.
            with self._lock:
                self._apply_pending_piece()

    def _apply_pending_piece(self) -> None:
        changed: tuple[list[Triple], list[Triple]] = ([], [])
        with self._pending_lock:
            # Those first that came first: of the last ones some are about to go again.
            for _ in range(min(_PIECE, len(self._pending))):
                triple, there = self._pending.popitem(last=False)
                self._applying[triple] = there
                changed[there].append(triple)
        try:
            held, implied = self._live.update(changed[True], changed[False])
        finally:
            with self._pending_lock:
                self._applying.clear()
        self._quads.apply({graphs.STREAM_SPACE: held, graphs.STREAM_SPACE_ENTAILMENTS: implied})

    # -- questions ----------------------------------------------------------------------------

    def query(self, sparql: str) -> QueryResults:
        """The answer over everything: ontologies, entailments, templates, live stream space.

        Raises `QueryRefused` (`check_user_query`). Solutions must be consumed in the thread that
        called. There is no deadline: who serves strangers runs this in a process of its own.
        """
        check_user_query(sparql)
        return answer(self.store, sparql)

    def changes_since(self, position: int | None) -> StoreChanges:
        """What a copy of the store lacks that was made or brought up to date at ``position``; None:
        one that has nothing. Cost: O(changes), or a dump of the store, for which nobody waits."""
        self._apply_pending()
        with self._lock:
            dump = self._quads.replica_changes(position)
        return dump()

    def query_rows(self, sparql: str) -> tuple[tuple[str, ...], list[tuple[Term | None, ...]]]:
        """Variables and rows of a SELECT; None is unbound. `QueryRefused` for another form."""
        return rows_of(self.query(sparql))

    def query_serialized(self, sparql: str, accept_format: str) -> bytes:
        """The answer as bytes. Formats: json, xml, csv, tsv for SELECT and ASK; turtle, ntriples,
        jsonld, rdfxml for CONSTRUCT and DESCRIBE. `QueryRefused` if the two do not go together.
        """
        return serialized(self.query(sparql), accept_format)

    def validate(self) -> ShaclReport:
        """Whether the stream space is well-formed by shapes.ttl."""
        quads = self.store.quads_for_pattern(None, None, None, DefaultGraph())
        return validate(quad.triple for quad in quads)

    # -- inside -------------------------------------------------------------------------------

    def _start(self) -> None:
        """Loads what comes with the program, reuses the kept closure, empties the live graphs."""
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

    def _asserted(
        self, new: dict[NamedNode, frozenset[Triple]], hashes: dict[str, str]
    ) -> frozenset[Triple]:
        loaded = {NamedNode(iri): self._quads.graph(NamedNode(iri)) for iri in hashes} | new
        return frozenset().union(*loaded.values())

    def _kept_closure(self, key: str) -> frozenset[Triple] | None:
        """What the ontologies entail, if it was computed from these."""
        is_kept = Triple(graphs.ENTAILMENTS, graphs.CLOSED, Literal(key)) in self._quads.graph(
            graphs.CATALOG
        )
        return self._quads.graph(graphs.ENTAILMENTS) if is_kept else None

    def _reload(
        self,
        new: dict[NamedNode, frozenset[Triple]],
        hashes: dict[str, str],
        implied: frozenset[Triple] | None = None,
    ) -> None:
        """Replaces the graphs ``new`` and all that follows from the ontologies."""
        asserted = self._asserted(new, hashes)
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
        self.vocabulary = self._base.with_events(self.registered.templates(), self.version)

    def _hashes(self) -> dict[str, str]:
        quads = self._quads.store.quads_for_pattern(None, graphs.LOADED, None, graphs.CATALOG)
        return {subject_of(q): text_of(q) for q in quads}

    def _ontology_triples(self) -> frozenset[Triple]:
        names = [NamedNode(iri) for iri in self._hashes()]
        return frozenset().union(*map(self._quads.graph, [*names, graphs.ENTAILMENTS]))

    def _concept_triples(self) -> frozenset[Triple]:
        return frozenset().union(*map(self._quads.graph, CONCEPTS))


def _catalog(hashes: dict[str, str]) -> frozenset[Triple]:
    """Which ontologies are loaded, and of which the closure is."""
    loaded = {Triple(NamedNode(g), graphs.LOADED, Literal(h)) for g, h in hashes.items()}
    closed = Triple(graphs.ENTAILMENTS, graphs.CLOSED, Literal(closure_key(hashes)))
    return frozenset(loaded | {closed})


def _ontology_graph(name: str) -> NamedNode:
    try:
        graph = graphs.ontology_graph(name)
    except ValueError as error:
        raise OntologyError(f"{name!r} is no name for an ontology: {error}") from error
    if graph in graphs.SYSTEM:
        raise OntologyError(f"the name {name} is the system's own")
    return graph
