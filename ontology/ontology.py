"""The ontology: Oxigraph store, closure, vocabulary, live stream space (SPEC §2, DESIGN §4).

One `Ontology` owns its store. Changes are made one at a time and whole; queries see the state
before or after one. The graphs are listed in `graphs` and explained in docs/ontology.md.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

from pyoxigraph import (
    BlankNode,
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    QueryResultsFormat,
    QuerySolutions,
    QueryTriples,
    RdfFormat,
    Store,
    Triple,
    parse,
    serialize,
)

from ..rdf.dictionary import Term
from ..rdf.namespaces import OWL, RDF_TYPE, STREAM_SPACE
from . import graphs
from .churn import Churn
from .closure import closure_key, entailed
from .closure_queries import QueryResults, answer
from .entailment import Change, Entailments, Rules
from .errors import OntologyError, QueryRefused
from .query_guard import check_user_query
from .reading import TextFormat
from .reasoning import DIRECT, Reasoning
from .replicas import ChangeLog, as_nquads
from .shipped import shipped_ontologies, text_hash
from .successor import CONCEPTS, Successor, succeed
from .units import UnitError
from .validation import ShaclReport, validate
from .vocabulary import Vocabulary

_Changes: TypeAlias = dict[NamedNode, Change]

_HAS_TEMPLATE = NamedNode(STREAM_SPACE + "hasTemplate")
_HAS_NAME = NamedNode(STREAM_SPACE + "hasName")
_HAS_TEXT = NamedNode(STREAM_SPACE + "hasText")
_EVENT = NamedNode(STREAM_SPACE + "Event")
_EVENT_TEMPLATE = NamedNode(STREAM_SPACE + "EventTemplate")
_ANNOTATION = NamedNode(STREAM_SPACE + "Annotation")
_SPECIFICATION = NamedNode(STREAM_SPACE + "Specification")
_IMPORTS = NamedNode(OWL + "imports")

_NOT_STATIC = (
    DefaultGraph(),
    graphs.CATALOG,
    graphs.QUERIES,
    graphs.STREAM_SPACE,
    graphs.STREAM_SPACE_ENTAILMENTS,
)
"""Graphs that continuous queries do not read."""
_PIECE = 250
"""Triples of the live stream space that are brought into the store in one go: some 10 ms."""
_MOST_AWAITED = 10_000
"""So many may wait to be brought in; whoever changes more brings some of them in."""
_TABLES = {
    "json": QueryResultsFormat.JSON,
    "xml": QueryResultsFormat.XML,
    "csv": QueryResultsFormat.CSV,
    "tsv": QueryResultsFormat.TSV,
}
_GRAPHS = {
    "turtle": RdfFormat.TURTLE,
    "ntriples": RdfFormat.N_TRIPLES,
    "jsonld": RdfFormat.JSON_LD,
    "rdfxml": RdfFormat.RDF_XML,
}


@dataclass(frozen=True, slots=True)
class StoreChanges:
    """What a copy of the store lacks, as N-Quads; ``whole`` replaces all that it has."""

    position: int
    whole: bytes | None
    added: bytes
    removed: bytes


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
        self._store = store
        self._awaited: OrderedDict[Triple, bool] = OrderedDict()
        """Triples of the live stream space that are not in the store yet: whether they come or go.
        Added to by those who tell of changes, who take back what is as it was."""
        self._arriving: dict[Triple, bool] = {}
        """Those of them that are being brought in."""
        self._telling = threading.Lock()
        """Of these two: had for a look-up a triple. Who takes some has `lock`, too, so that in a
        copy of the process it is free."""
        self.path = path
        self.version = 0
        self._lock = threading.RLock()
        self._churn = Churn()
        self._closed: Store | None = None
        self._closed_churn = Churn()
        self._log = ChangeLog()
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
        return cls(_opened(path), path)

    @classmethod
    def copied(cls, path: Path) -> Ontology:
        """One in memory with what the folder ``path`` keeps, which stays as it is. Raises
        `OntologyError`."""
        kept = _opened(path)
        store = Store()
        store.extend(kept)
        return cls(store, None)

    @classmethod
    def of_quads(cls, quads: bytes) -> Ontology:
        """One in memory with these N-Quads, of `quads`."""
        return cls(store_of(quads), None)

    @property
    def store(self) -> Store:
        """All there is. Treat it as read-only. Cost: what `mirror` was told of and is not there."""
        self._bring_in()
        return self._store

    @property
    def lock(self) -> AbstractContextManager[object]:
        """Who changes it has this, whichever thread that is: whoever copies the process must, too.
        Others have it for some milliseconds, but 2 s a million quads where a large store is made
        anew (`churn`)."""
        return self._lock

    @property
    def static_store(self) -> Store:
        """The same, but that the live stream space may be as it was a moment ago."""
        return self._store

    def quads(self) -> bytes:
        """All there is as N-Quads, sorted."""
        with self._lock:
            return quads_of(self.store)

    def __getstate__(self) -> dict[str, Any]:
        """As it is copied, if it is in memory: the lock is each one's own. The store is for who
        copies (engine/durability/checkpoint)."""
        assert self.path is None
        self._bring_in()
        kept = dict(self.__dict__)
        del kept["_lock"], kept["_telling"], kept["_closed"]
        return kept

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__dict__.update(kept, _lock=threading.RLock(), _telling=threading.Lock(), _closed=None)

    # -- ontologies -------------------------------------------------------------------------

    def load(self, text: str, *, name: str, format: TextFormat = "turtle") -> None:
        """Adds the ontology ``text`` as ``name``, or replaces the one of that name.

        ``name`` is an absolute IRI or a short name; it is what FROM calls the ontology. Imports
        are not followed (`imports` lists them). Raises `OntologyError` with line and column for a
        text that cannot be read, contradicts the others, or gives a feature an unknown unit.
        Cost: a closure of all loaded ontologies.
        """
        self.take(self.prepare(text, name=name, format=format))

    def prepare(
        self, text: str, *, name: str, format: TextFormat = "turtle", reasoning: Reasoning = DIRECT
    ) -> PreparedOntology:
        """All of `load` that takes time: nothing has changed when it returns. Any thread may call;
        raises as `load`, and what ``reasoning`` raises."""
        graph = _ontology_graph(name)
        triples = reasoning.read(text, format, graph)
        # Nobody waits for what is read here: where ontologies change meanwhile, `take` refuses.
        hashes = {**self._hashes(), graph.value: text_hash(f"{format}\n{text}")}
        asserted = self._asserted({graph: triples}, hashes)
        known = self._kept_closure(closure_key(hashes))
        implied = reasoning.entailed(asserted) if known is None else known
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
        entailed: tuple[frozenset[Triple], frozenset[Triple]],
    ) -> Successor:
        # First, as it may raise: an iterator of a store must not be in a frame that an error keeps,
        # since it may be dropped only where it was made.
        vocabulary = Vocabulary.from_triples(chain(*entailed))
        with self._lock:
            # A store's iterator goes on with what there was when it was made.
            now = self._store.quads_for_pattern(None, None, None, None)
            held = (self._concepts.held, self._live.held)
            position = self._log.position
        replaced = {graph: triples, graphs.CATALOG: _catalog(hashes)}
        return succeed(position, now, replaced, entailed, held, vocabulary)

    def take(self, prepared: PreparedOntology) -> None:
        """Load what was prepared. Raises `OntologyError` if it contradicts the vocabulary, or other
        ontologies were loaded since."""
        with self._lock:
            graph = prepared.graph.value
            if {**self._hashes(), graph: prepared.hashes[graph]} != prepared.hashes:
                raise OntologyError(
                    "another ontology was loaded meanwhile", hint="load this one again"
                )
            if not self._taken_over(prepared.successor):
                self._reload({prepared.graph: prepared.triples}, prepared.hashes, prepared.implied)

    def _taken_over(self, successor: Successor | None) -> bool:
        """Go on with ``successor``; False where too much has changed since it was made. Cost: as
        much as has changed."""
        missed = None if successor is None else self._log.since(successor.position)
        if successor is None or missed is None:
            return False
        changes = successor.follow(*missed)
        self._store, self._churn = successor.store, Churn()
        self._apply(changes)
        self._log.forget()
        self._concepts, self._live, self._base = (
            successor.concepts,
            successor.live,
            successor.vocabulary,
        )
        self._changed()
        self._closed, self._closed_churn = successor.static, Churn()
        self._follow_statically(
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
        quads = self._store.quads_for_pattern(None, _IMPORTS, None, DefaultGraph())
        return tuple(sorted({q.object.value for q in quads if isinstance(q.object, NamedNode)}))

    def static_graph(self, iri: str) -> bool:
        """True if a loaded ontology has this name: then ``FROM <iri>`` means it."""
        return iri in self._hashes()

    def closed_store(self) -> Store:
        """The static side of continuous queries, in the default graph of a store of its own.

        Loaded ontologies, templates and all that is entailed; not the live stream space. It is
        another store, or has other triples, when `version` has changed. Treat it as read-only.
        """
        with self._lock:
            if self._closed is None:
                store = Store()
                static = self._ontology_triples() | self._concepts.held | self._concepts.current
                store.extend(Quad(t.subject, t.predicate, t.object) for t in static)
                self._closed, self._closed_churn = store, Churn()
            return self._closed

    def _follow_statically(self, *changes: Change) -> None:
        """Bring `closed_store` up to date: these changes of concepts, and of what they entail, are
        in the store already."""
        if self._closed is None:
            return
        for change in changes:
            self._closed.extend(Quad(t.subject, t.predicate, t.object) for t in change.added)
            for triple in change.removed:
                if not self._is_static(triple):
                    self._closed.remove(Quad(triple.subject, triple.predicate, triple.object))
            self._closed_churn.note(change.added, change.removed)
        self._closed = self._closed_churn.over(self._closed)

    def _is_static(self, triple: Triple) -> bool:
        quads = self._store.quads_for_pattern(triple.subject, triple.predicate, triple.object, None)
        return any(quad.graph_name not in _NOT_STATIC for quad in quads)

    # -- templates, annotations, declared streams --------------------------------------------

    def set_template(self, event: str, source: str) -> None:
        """Makes ``event`` (an IRI) an event concept with this template text, or replaces it."""
        concept = _iri(event)
        kept = {
            Triple(concept, RDF_TYPE, _EVENT),
            Triple(concept, RDF_TYPE, _EVENT_TEMPLATE),
            Triple(concept, _HAS_TEMPLATE, Literal(source)),
        }
        self._keep(graphs.TEMPLATES, concept, kept)

    def remove_template(self, event: str) -> None:
        """Removes the event concept's template, and the concept. KeyError if there is none."""
        if event not in self.templates():
            raise KeyError(event)
        self._keep(graphs.TEMPLATES, _iri(event), set())

    def templates(self) -> dict[str, str]:
        """Event concept IRI -> template text."""
        quads = self._store.quads_for_pattern(None, _HAS_TEMPLATE, None, graphs.TEMPLATES)
        return {_subject(q): _text(q) for q in sorted(quads, key=str)}

    def set_annotation(self, subject_name: str, source: str) -> None:
        """Keeps the SSL text of the stream, source or unit of this name."""
        node = graphs.annotation_node(subject_name)
        self._keep(graphs.ANNOTATIONS, node, _named_text(node, _ANNOTATION, subject_name, source))

    def remove_annotation(self, subject_name: str) -> None:
        """Forgets the SSL text. KeyError if there is none."""
        if subject_name not in self.annotations():
            raise KeyError(subject_name)
        self._keep(graphs.ANNOTATIONS, graphs.annotation_node(subject_name), set())

    def annotations(self) -> dict[str, str]:
        """Name of the stream, source or unit -> SSL text."""
        return self._named_texts(graphs.ANNOTATIONS)

    def set_stream(self, name: str, declaration_json: str) -> None:
        """Keeps the declaration of a stream."""
        node = graphs.declaration_node(name)
        kept = _named_text(node, _SPECIFICATION, name, declaration_json)
        self._keep(graphs.DECLARATIONS, node, kept)

    def remove_stream(self, name: str) -> None:
        """Forgets the declaration. KeyError if there is none."""
        if name not in self.streams():
            raise KeyError(name)
        self._keep(graphs.DECLARATIONS, graphs.declaration_node(name), set())

    def streams(self) -> dict[str, str]:
        """Name of a declared stream -> its declaration as JSON text."""
        return self._named_texts(graphs.DECLARATIONS)

    def set_transformation(self, name: str, description_json: str) -> None:
        """Keeps the description of a transformation."""
        node = graphs.transformation_node(name)
        kept = _named_text(node, _SPECIFICATION, name, description_json)
        self._keep(graphs.TRANSFORMATIONS, node, kept)

    def remove_transformation(self, name: str) -> None:
        """Forgets the description. KeyError if there is none."""
        if name not in self.transformations():
            raise KeyError(name)
        self._keep(graphs.TRANSFORMATIONS, graphs.transformation_node(name), set())

    def transformations(self) -> dict[str, str]:
        """Name of a registered transformation -> its description as JSON text."""
        return self._named_texts(graphs.TRANSFORMATIONS)

    def set_query(self, name: str, registration_json: str) -> None:
        """Keeps the registration of a continuous query."""
        node = graphs.query_node(name)
        self._keep_aside(
            graphs.QUERIES, node, _named_text(node, _SPECIFICATION, name, registration_json)
        )

    def remove_query(self, name: str) -> None:
        """Forgets the registration, if there is one."""
        self._keep_aside(graphs.QUERIES, graphs.query_node(name), set())

    def queries(self) -> dict[str, str]:
        """Name of a registered continuous query -> its registration as JSON text."""
        return self._named_texts(graphs.QUERIES)

    def set_kpl(self, text: str) -> None:
        """Keeps all KPL declarations; empty text forgets them."""
        node = graphs.KPL
        kept = _named_text(node, _SPECIFICATION, "KPL", text) if text else set()
        self._keep(graphs.KPL, node, kept)

    def kpl(self) -> str:
        """The KPL declarations; empty if there are none."""
        return self._named_texts(graphs.KPL).get("KPL", "")

    def set_specifications(self, text: str) -> None:
        """Keeps what specifications inserted, as one text; empty text forgets it."""
        node = graphs.SPECIFICATIONS
        kept = _named_text(node, _SPECIFICATION, "specifications", text) if text else set()
        self._keep(graphs.SPECIFICATIONS, node, kept)

    def specifications(self) -> str:
        """What specifications inserted; empty if nothing."""
        return self._named_texts(graphs.SPECIFICATIONS).get("specifications", "")

    # -- the live stream space ---------------------------------------------------------------

    def mirror(self, added: Iterable[Triple], removed: Iterable[Triple]) -> None:
        """Changes the live stream space; what it entails follows (`entailment`).

        A triple in both is there afterwards. Whoever asks sees it; it is brought into the store
        when somebody does, or by `advance`: what comes and goes in between leaves nothing, and a
        large change is made in pieces. Not flushed: the graph is emptied when the store is opened.
        Cost: O(changed triples).
        """
        with self._telling:
            for triples, there in ((removed, False), (added, True)):
                for triple in triples:
                    self._awaited.pop(triple, None)
                    will_be = self._arriving.get(triple)
                    if (self._live.holds(triple) if will_be is None else will_be) != there:
                        self._awaited[triple] = there
        if len(self._awaited) > _MOST_AWAITED:
            self.advance()

    def advance(self) -> None:
        """Bring some of what `mirror` was told of into the store, if nobody else is at it."""
        if self._awaited and self._lock.acquire(blocking=False):
            try:
                self._bring_in_some()
            finally:
                self._lock.release()

    def _bring_in(self) -> None:
        while self._awaited:
            # Others may have the lock in between.
            with self._lock:
                self._bring_in_some()

    def _bring_in_some(self) -> None:
        changed: tuple[list[Triple], list[Triple]] = ([], [])
        with self._telling:
            # Those first that came first: of the last ones some are about to go again.
            for _ in range(min(_PIECE, len(self._awaited))):
                triple, there = self._awaited.popitem(last=False)
                self._arriving[triple] = there
                changed[there].append(triple)
        try:
            held, implied = self._live.update(changed[True], changed[False])
        finally:
            with self._telling:
                self._arriving.clear()
        self._apply({graphs.STREAM_SPACE: held, graphs.STREAM_SPACE_ENTAILMENTS: implied})

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
        self._bring_in()
        with self._lock:
            store, now = self._store, self._log.position
            found = None if position is None else self._log.since(position)
        if found is None:
            # It may have some of what comes next, which the copy is told once more: no harm.
            whole = store.dump(format=RdfFormat.N_QUADS)
            return StoreChanges(now, _bytes(whole), b"", b"")
        came, went = found
        return StoreChanges(now, None, as_nquads(came), as_nquads(went))

    def query_rows(self, sparql: str) -> tuple[tuple[str, ...], list[tuple[Term | None, ...]]]:
        """Variables and rows of a SELECT; None is unbound. `QueryRefused` for another form."""
        results = self.query(sparql)
        if not isinstance(results, QuerySolutions):
            raise QueryRefused("a table is wanted, so the query must be a SELECT", 1, 1)
        variables = tuple(variable.value for variable in results.variables)
        return variables, [tuple(_rdf11(term) for term in solution) for solution in results]

    def query_serialized(self, sparql: str, accept_format: str) -> bytes:
        """The answer as bytes. Formats: json, xml, csv, tsv for SELECT and ASK; turtle, ntriples,
        jsonld, rdfxml for CONSTRUCT and DESCRIBE. `QueryRefused` if the two do not go together.
        """
        results = self.query(sparql)
        known: Iterable[str]
        if isinstance(results, QueryTriples):
            known = _GRAPHS
            if accept_format in _GRAPHS:
                return _bytes(serialize(results, format=_GRAPHS[accept_format]))
        else:
            known = _TABLES
            if accept_format in _TABLES:
                return _bytes(results.serialize(format=_TABLES[accept_format]))
        raise QueryRefused(
            f"the answer to this query cannot be given as {accept_format}",
            1,
            1,
            f"ask for {', '.join(known)}",
        )

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
            graph: Change(frozenset(), self._graph(graph))
            for graph in (graphs.STREAM_SPACE, graphs.STREAM_SPACE_ENTAILMENTS)
        }
        self._apply(emptied)
        self._reload(new, hashes)

    def _asserted(
        self, new: dict[NamedNode, frozenset[Triple]], hashes: dict[str, str]
    ) -> frozenset[Triple]:
        loaded = {NamedNode(iri): self._graph(NamedNode(iri)) for iri in hashes} | new
        return frozenset().union(*loaded.values())

    def _kept_closure(self, key: str) -> frozenset[Triple] | None:
        """What the ontologies entail, if it was computed from these."""
        is_kept = Triple(graphs.ENTAILMENTS, graphs.CLOSED, Literal(key)) in self._graph(
            graphs.CATALOG
        )
        return self._graph(graphs.ENTAILMENTS) if is_kept else None

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
            implied = entailed(asserted)
        try:
            vocabulary = Vocabulary.from_triples(asserted | implied)
        except UnitError as error:
            raise OntologyError(str(error)) from error
        rules = Rules(asserted | implied)
        concepts = Entailments(rules, self._concept_triples())
        live = Entailments(rules, self._live.held)
        wanted = {
            **new,
            graphs.ENTAILMENTS: implied,
            graphs.CONCEPT_ENTAILMENTS: concepts.current,
            graphs.STREAM_SPACE_ENTAILMENTS: live.current,
            graphs.CATALOG: _catalog(hashes),
        }
        self._apply({graph: _change(self._graph(graph), then) for graph, then in wanted.items()})
        self._flush()
        self._concepts, self._live, self._base = concepts, live, vocabulary
        self._closed = None
        self._changed()

    def _keep(self, graph: NamedNode, subject: NamedNode, triples: set[Triple]) -> None:
        """Makes ``triples`` all that ``graph`` says of ``subject``."""
        with self._lock:
            before = {q.triple for q in self._store.quads_for_pattern(subject, None, None, graph)}
            change = _change(frozenset(before), frozenset(triples))
            _, implied = self._concepts.update(change.added, change.removed)
            self._apply({graph: change, graphs.CONCEPT_ENTAILMENTS: implied})
            self._flush()
            self._follow_statically(change, implied)
            self._changed()

    def _keep_aside(self, graph: NamedNode, subject: NamedNode, triples: set[Triple]) -> None:
        """The same of what nothing follows from and no continuous query reads: to them the
        ontology is as it was, and they need not look at it anew."""
        with self._lock:
            before = {q.triple for q in self._store.quads_for_pattern(subject, None, None, graph)}
            self._apply({graph: _change(frozenset(before), frozenset(triples))})
            self._flush()

    def _changed(self) -> None:
        self.version += 1
        self.vocabulary = self._base.with_events(self.templates(), self.version)

    def _apply(self, changes: _Changes) -> None:
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
            self._store.extend(added)  # all at once, and without a text to be parsed
        elif any(_has_blank(quad) for quad in removed | added):
            # SPARQL's DELETE DATA names no blank nodes, so these go one after the other: what
            # comes first, so that nothing that stays is missing in between.
            self._store.extend(added)
            for quad in removed:
                self._store.remove(quad)
        else:
            self._store.update(
                f"DELETE DATA {{ {_data(removed)} }} ; INSERT DATA {{ {_data(added)} }}"
            )
        # A store in memory does not grow by what came and went.
        if self.path is None:
            self._store = self._churn.over(self._store)

    def _elsewhere(self, triple: Triple, removed: set[Quad]) -> bool:
        holders = self._store.quads_for_pattern(
            triple.subject, triple.predicate, triple.object, None
        )
        return any(
            quad not in removed and quad.graph_name not in (DefaultGraph(), graphs.CATALOG)
            for quad in holders
        )

    def _flush(self) -> None:
        if self.path is not None:
            self._store.flush()

    def _hashes(self) -> dict[str, str]:
        quads = self._store.quads_for_pattern(None, graphs.LOADED, None, graphs.CATALOG)
        return {_subject(q): _text(q) for q in quads}

    def _graph(self, graph: NamedNode) -> frozenset[Triple]:
        quads = self._store.quads_for_pattern(None, None, None, graph)
        return frozenset(quad.triple for quad in quads)

    def _ontology_triples(self) -> frozenset[Triple]:
        names = [NamedNode(iri) for iri in self._hashes()]
        return frozenset().union(*map(self._graph, [*names, graphs.ENTAILMENTS]))

    def _concept_triples(self) -> frozenset[Triple]:
        return frozenset().union(*map(self._graph, CONCEPTS))

    def _named_texts(self, graph: NamedNode) -> dict[str, str]:
        names = self._store.quads_for_pattern(None, _HAS_NAME, None, graph)
        found = {}
        for quad in sorted(names, key=str):
            for text in self._store.quads_for_pattern(quad.subject, _HAS_TEXT, None, graph):
                found[_text(quad)] = _text(text)
        return found


def _catalog(hashes: dict[str, str]) -> frozenset[Triple]:
    """Which ontologies are loaded, and of which the closure is."""
    loaded = {Triple(NamedNode(g), graphs.LOADED, Literal(h)) for g, h in hashes.items()}
    closed = Triple(graphs.ENTAILMENTS, graphs.CLOSED, Literal(closure_key(hashes)))
    return frozenset(loaded | {closed})


def quads_of(store: Store) -> bytes:
    """All of a store as N-Quads, sorted: each quad a line, blank nodes by their names."""
    return b"".join(sorted(f"{quad} .\n".encode() for quad in store))


def store_of(quads: bytes) -> Store:
    """The inverse of `quads_of`: one in memory."""
    store = Store()
    store.extend(parse(quads, RdfFormat.N_QUADS))
    return store


def _opened(path: Path) -> Store:
    try:
        path.mkdir(parents=True, exist_ok=True)
        return Store(path)
    except OSError as error:
        reason = "is in use by another process" if "lock" in str(error).lower() else "is broken"
        raise OntologyError(
            f"the store {path} {reason}: {error}",
            hint="stop the other process, or name another data folder",
        ) from error


def _ontology_graph(name: str) -> NamedNode:
    try:
        graph = graphs.ontology_graph(name)
    except ValueError as error:
        raise OntologyError(f"{name!r} is no name for an ontology: {error}") from error
    if graph in graphs.SYSTEM:
        raise OntologyError(f"the name {name} is the system's own")
    return graph


def _iri(text: str) -> NamedNode:
    try:
        return NamedNode(text)
    except ValueError as error:
        raise OntologyError(f"{text!r} is no IRI: {error}") from error


def _named_text(node: NamedNode, kind: NamedNode, name: str, text: str) -> set[Triple]:
    return {
        Triple(node, RDF_TYPE, kind),
        Triple(node, _HAS_NAME, Literal(name)),
        Triple(node, _HAS_TEXT, Literal(text)),
    }


def _change(before: frozenset[Triple], then: frozenset[Triple]) -> Change:
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


def _subject(quad: Quad) -> str:
    assert isinstance(quad.subject, NamedNode)
    return quad.subject.value


def _text(quad: Quad) -> str:
    assert isinstance(quad.object, Literal)
    return quad.object.value


def _rdf11(term: object) -> Term | None:
    assert term is None or isinstance(term, NamedNode | BlankNode | Literal)
    return term


def _bytes(data: bytes | None) -> bytes:
    assert data is not None  # None only if an output file is given
    return data
