"""The ontology as it will be once another text is loaded, made beside the one that is in use.

All that takes time in proportion to the ontologies is made here, in another thread than the one
that everybody waits for: the vocabulary, the rules, what they entail, and the store with all of
it. Taking it (`ontology.Ontology.take`) takes as long as what has changed meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Set
from dataclasses import dataclass
from itertools import chain, islice
from typing import Final, TypeVar

from pyoxigraph import DefaultGraph, NamedNode, Quad, Store, Triple

from . import graphs
from .entailment import Change, Entailments, Rules
from .vocabulary import Vocabulary

T = TypeVar("T")

_PIECE: Final = 500
"""So many quads are put into a store in one go: no other thread has a turn meanwhile."""
CONCEPTS: Final = (
    graphs.TEMPLATES,
    graphs.ANNOTATIONS,
    graphs.DECLARATIONS,
    graphs.TRANSFORMATIONS,
    graphs.KPL,
    graphs.SPECIFICATIONS,
)
"""The graphs whose entailments are `graphs.CONCEPT_ENTAILMENTS`."""
_DERIVED: Final = (
    graphs.ENTAILMENTS,
    graphs.CONCEPT_ENTAILMENTS,
    graphs.STREAM_SPACE_ENTAILMENTS,
)


@dataclass(frozen=True, slots=True)
class Successor:
    """Made of what there was at ``position`` of the change log. ``static`` is what
    `ontology.Ontology.closed_store` will give."""

    position: int
    vocabulary: Vocabulary
    concepts: Entailments
    live: Entailments
    store: Store
    static: Store

    def follow(self, added: Set[Quad], removed: Set[Quad]) -> dict[NamedNode, Change]:
        """The changes of graphs to be made to ``store``, as these quads came and went since.

        ``static`` is brought up to date. Cost: O(changes).
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
    held: tuple[Set[Triple], Set[Triple]],
    vocabulary: Vocabulary,
) -> Successor:
    """``now`` are the quads at ``position``, ``replaced`` the graphs that become others, the
    catalog among them. ``entailed``: what is asserted by the ontologies, and what they entail;
    ``held``: the concepts' triples and the live stream space's at ``position``; ``vocabulary``:
    what ``entailed`` defines. Any thread may call.
    """
    asserted, implied = entailed
    rules = Rules(chain(asserted, implied))
    concepts, live = (Entailments(rules, triples) for triples in held)
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
    """What came and what went, of each named graph."""
    found: dict[NamedNode, tuple[list[Triple], list[Triple]]] = {}
    for quads, place in ((added, 0), (removed, 1)):
        for quad in quads:
            if isinstance(quad.graph_name, NamedNode):
                found.setdefault(quad.graph_name, ([], []))[place].append(quad.triple)
    return found
