"""Builds the next state of the ontology beside the current one, when a text is loaded.

Everything that takes time in proportion to the ontologies happens here, outside of the event loop's
thread: vocabulary, rules, entailments and the store. Installing it (`ontology.Ontology.install`)
takes as long as the changes since.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass
from itertools import chain, islice
from typing import Final, TypeVar

from pyoxigraph import DefaultGraph, NamedNode, Quad, Store, Triple

from . import graphs
from .entailment.rules import Change, Entailments, Rules
from .vocabulary import Vocabulary

T = TypeVar("T")

_PIECE: Final = 500
"""Quads added to a store at once: no other thread runs meanwhile."""
CONCEPTS: Final = (
    graphs.TEMPLATES,
    graphs.ANNOTATIONS,
    graphs.DECLARATIONS,
    graphs.TRANSFORMATIONS,
    graphs.KPL,
    graphs.SPECIFICATIONS,
)
"""The graphs whose entailments are in `graphs.CONCEPT_ENTAILMENTS`."""
_DERIVED: Final = (
    graphs.ENTAILMENTS,
    graphs.CONCEPT_ENTAILMENTS,
    graphs.STREAM_SPACE_ENTAILMENTS,
)


@dataclass(frozen=True, slots=True)
class Successor:
    """The next state, built from ``position`` of the change log. ``static`` is the store that
    `ontology.Ontology.closed_store` will return."""

    position: int
    vocabulary: Vocabulary
    concepts: Entailments
    live: Entailments
    store: Store
    static: Store

    def follow(self, added: Set[Quad], removed: Set[Quad]) -> dict[NamedNode, Change]:
        """Return the changes to apply to ``store``, given the quads added and removed since
        `position`.

        It also updates ``concepts`` and ``live``. Cost: O(changes).
        """
        changes: dict[NamedNode, Change] = {}
        for graph, (new, old) in _by_graph(added, removed).items():
            if graph not in _DERIVED:
                changes[graph] = Change(frozenset(new), frozenset(old))
        concept_changes = [changes[graph] for graph in CONCEPTS if graph in changes]
        _, changes[graphs.CONCEPT_ENTAILMENTS] = self.concepts.update(
            chain.from_iterable(change.added for change in concept_changes),
            chain.from_iterable(change.removed for change in concept_changes),
        )
        space = changes.get(graphs.STREAM_SPACE)
        if space is not None:
            _, changes[graphs.STREAM_SPACE_ENTAILMENTS] = self.live.update(
                space.added, space.removed
            )
        return changes


def build_successor(
    position: int,
    now: Iterator[Quad],
    replaced: Mapping[NamedNode, Set[Triple]],
    entailed: tuple[Set[Triple], Set[Triple]],
    asserted_triples: tuple[Set[Triple], Set[Triple]],
    vocabulary: Vocabulary,
) -> Successor:
    """Build the next state. Thread-safe.

    ``now`` are the quads at ``position``; ``replaced`` are the graphs that change, the catalog
    among them. ``entailed``: the asserted triples of the ontologies, and those that they entail.
    ``held``: the triples of the concepts and of the live stream space at ``position``.
    ``vocabulary``: that of ``entailed``.
    """
    asserted, implied = entailed
    rules = Rules(chain(asserted, implied))
    concepts, live = (Entailments(rules, triples) for triples in asserted_triples)
    wanted: dict[NamedNode, Iterable[Triple]] = {
        **replaced,
        graphs.ENTAILMENTS: implied,
        graphs.CONCEPT_ENTAILMENTS: concepts.current,
        graphs.STREAM_SPACE_ENTAILMENTS: live.current,
    }

    def quads() -> Iterator[Quad]:
        for quad in now:
            if quad.graph_name != DefaultGraph() and quad.graph_name not in wanted:
                yield quad
        for graph, triples in wanted.items():
            for triple in triples:
                yield Quad(triple.subject, triple.predicate, triple.object, graph)

    store = Store()
    for piece in _pieces(quads()):
        store.extend(piece)
        store.extend(
            Quad(quad.subject, quad.predicate, quad.object)
            for quad in piece
            if quad.graph_name != graphs.CATALOG
        )
    static = Store()
    for some in _pieces(chain(asserted, implied, concepts.asserted, concepts.current)):
        static.extend(Quad(t.subject, t.predicate, t.object) for t in some)
    return Successor(position, vocabulary, concepts, live, store, static)


def _pieces(items: Iterable[T]) -> Iterator[list[T]]:
    left = iter(items)
    while piece := list(islice(left, _PIECE)):
        yield piece


def _by_graph(
    added: Set[Quad], removed: Set[Quad]
) -> dict[NamedNode, tuple[list[Triple], list[Triple]]]:
    """Return the added and removed triples of each named graph."""
    found: dict[NamedNode, tuple[list[Triple], list[Triple]]] = {}
    for quads, place in ((added, 0), (removed, 1)):
        for quad in quads:
            if isinstance(quad.graph_name, NamedNode):
                found.setdefault(quad.graph_name, ([], []))[place].append(quad.triple)
    return found
