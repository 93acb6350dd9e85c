"""Marks for hierarchies too deep to store all their pairs.

A chain of 2,000 classes has 2 million pairs, which cost a store 6 s and 800 MB. Above `MOST_PAIRS`
the graph of entailments therefore contains marks instead of pairs: triples with predicates of its
own. `closure_queries` and `continuous.operators.background` compute the same answers from them.
`separation` makes the marks. Law (tests/laws/ontology/test_deep_hierarchies.py): the answers equal
those over the pairs.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, TypeAlias

from pyoxigraph import BlankNode, DefaultGraph, Literal, NamedNode, Quad, Store, Triple

from ...rdf.namespaces import OWL, RDF, RDFS, XSD
from ..graphs import ENTAILMENTS
from .hierarchy import OF_CLASSES, OF_PROPERTIES, Hierarchy, Inclusion, Node

GraphName: TypeAlias = NamedNode | BlankNode | DefaultGraph | None

MOST_PAIRS: Final = 60_000
"""The greatest number of pairs of a hierarchy that the store contains (350 classes in a chain,
5,000 in a tree of depth 12)."""
STANDARD: Final = (RDF, RDFS, OWL, XSD)
_THING: Final = NamedNode(OWL + "Thing")


@dataclass(frozen=True, slots=True)
class Marks:
    """The predicates that mark one kind of hierarchy.

    ``lower`` links each node that has pairs of its own to itself. ``inclusion`` and ``equivalence``
    repeat the stored pairs, without those of a node with itself. ``component`` links each node of a
    cycle to the representative of the cycle.
    """

    kind: Inclusion
    lower: NamedNode
    inclusion: NamedNode
    equivalence: NamedNode
    component: NamedNode

    @property
    def predicates(self) -> tuple[NamedNode, ...]:
        return self.lower, self.inclusion, self.equivalence, self.component

    @classmethod
    def of(cls, kind: Inclusion, name: str) -> Marks:
        parts = ("lower", "inclusion", "equivalence", "component")
        return cls(kind, *(NamedNode(f"{ENTAILMENTS.value}#{name}-{part}") for part in parts))


MARKS: Final = (Marks.of(OF_CLASSES, "class"), Marks.of(OF_PROPERTIES, "property"))
MARKERS: Final = frozenset(predicate for marks in MARKS for predicate in marks.predicates)


def is_standard(term: object) -> bool:
    """Return whether it is a term of RDF, RDFS, OWL or XSD."""
    return isinstance(term, NamedNode) and term.value.startswith(STANDARD)


def marks_of(
    hierarchy: Hierarchy[Node], stored: Iterable[Triple], kind: Inclusion
) -> Iterator[Triple]:
    """Yield the marks of ``hierarchy``; ``stored`` are all other triples of the store."""
    (marks,) = (one for one in MARKS if one.kind == kind)
    own = dict(zip(kind, (marks.inclusion, marks.equivalence), strict=True))
    for triple in stored:
        predicate = own.get(triple.predicate)
        has_ends = not isinstance(triple.object, Literal | Triple)
        if predicate is not None and has_ends and triple.subject != triple.object:
            yield Triple(triple.subject, predicate, triple.object)
    for node in hierarchy:
        # Nodes above a standard term are noise, except above owl:Thing (`closure`).
        if not is_standard(node) or node == _THING:
            yield Triple(node, marks.lower, node)
    for members in hierarchy.components():
        if len(members) > 1:
            least = min(members, key=str)
            yield from (Triple(node, marks.component, least) for node in members)


def deep_kinds(store: Store) -> tuple[Marks, ...]:
    """Return the kinds of hierarchies of which ``store`` contains marks. Cost: two look-ups."""
    return tuple(
        marks
        for marks in MARKS
        if next(store.quads_for_pattern(None, marks.lower, None), None) is not None
    )


def missing_pairs(
    store: Store,
    subject: Node | None,
    predicate: NamedNode | None,
    object: Node | Literal | None,
    graph: GraphName,
) -> Iterator[tuple[Node, NamedNode, Node]]:
    """Yield the matching triples of deep hierarchies in ``graph`` that ``store`` does not contain.

    None matches everything. Cost: two look-ups if the store has no marks; else it builds the
    hierarchy, and one object for each pair.
    """
    for marks in deep_kinds(store):
        if predicate is None or predicate in marks.kind:
            yield from _missing_of(marks, store, subject, predicate, object, graph)


def _missing_of(
    marks: Marks,
    store: Store,
    subject: Node | None,
    predicate: NamedNode | None,
    object: Node | Literal | None,
    graph: GraphName,
) -> Iterator[tuple[Node, NamedNode, Node]]:
    def pairs(predicate: NamedNode) -> set[tuple[Node, Node]]:
        return set(map(_ends, store.quads_for_pattern(None, predicate, None, graph)))

    if isinstance(object, Literal):
        return
    stored = pairs(marks.inclusion), pairs(marks.equivalence)
    hierarchy = Hierarchy([*stored[0], *stored[1], *((upper, lower) for lower, upper in stored[1])])
    starts = {lower for lower, _ in pairs(marks.lower)}
    if subject is not None:
        starts &= {subject}
    elif object is not None:
        starts &= hierarchy.inverse().above(object)
    kinds = [number for number, one in enumerate(marks.kind) if predicate in (None, one)]
    for start in starts:
        above = hierarchy.above(start) - {start}
        for end in above if object is None else above & {object}:
            for number in kinds:
                is_pair = number == 0 or start in hierarchy.above(end)
                if is_pair and (start, end) not in stored[number]:
                    yield start, marks.kind[number], end


def _ends(quad: Quad) -> tuple[Node, Node]:
    assert not isinstance(quad.subject, Triple)
    assert not isinstance(quad.object, Literal | Triple)
    return quad.subject, quad.object
