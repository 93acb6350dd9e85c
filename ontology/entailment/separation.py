"""Splits an ontology in two: hierarchies, which bit sets close, and the rest, which owlrl closes.

owlrl matches every triple with every rule in each of its rounds. A chain of 100 classes entails
5,000 triples, which take it seconds. A class or property that only takes part in a hierarchy is a
premise of few rules, and their conclusions follow from the closed hierarchies (`hierarchy`):

| rule of OWL 2 RL | conclusion |
|---|---|
| scm-sco, scm-spo, scm-eqc, scm-eqp | sub-classes, sub-properties, equivalences |
| cax-sco, cax-eqc | types |
| prp-spo1, prp-eqp | triples of super-properties |
| scm-dom1, scm-dom2, scm-rng1, scm-rng2, prp-dom, prp-rng | domains, ranges, and types of them |
| eq-rep-s, eq-rep-o | what is said of individuals that are the same |

`Separation` removes such *plain* nodes from the input of owlrl; one deputy represents all plain
nodes with the same statements. `Separation.merge_closure` adds the conclusions. `closure` calls it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Set
from functools import cached_property
from typing import Final, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from ...rdf.namespaces import OWL, RDF, RDF_TYPE, RDFS
from . import deep_hierarchies
from .deep_hierarchies import is_standard, marks_of
from .hierarchy import (
    OF_CLASSES,
    OF_PROPERTIES,
    Hierarchy,
    Inclusion,
    Node,
    edges,
)
from .rules import DOMAIN, RANGE, Rules

PredicateObject: TypeAlias = tuple[NamedNode, NamedNode | BlankNode | Literal | Triple]
"""A predicate and an object."""

_HIERARCHICAL: Final = (*OF_CLASSES, *OF_PROPERTIES)
_ENDS: Final = (DOMAIN, RANGE)
_SAME_AS: Final = NamedNode(OWL + "sameAs")
_CLASS: Final = NamedNode(OWL + "Class")
_THING: Final = NamedNode(OWL + "Thing")
_REMARKS: Final = frozenset(RDFS + name for name in ("label", "comment", "seeAlso", "isDefinedBy"))
_PLAIN_KINDS: Final = frozenset(
    {
        *(RDFS + name for name in ("Class", "Resource")),
        *(OWL + name for name in ("Class", "ObjectProperty", "DatatypeProperty", "Thing")),
        OWL + "AnnotationProperty",
        RDF + "Property",
    }
)
"""Standard types that make a node a premise of no rule beyond those above."""


class Separation:
    """``asserted`` in two parts: `rest` is the input of owlrl, `plain` are the nodes missing in it.

    Law (tests/laws/ontology/test_ontology.py): `merge_closure` of owlrl's closure of `rest` is
    owlrl's closure of ``asserted`` without noise, or None.
    """

    def __init__(self, asserted: Set[Triple]) -> None:
        self._asserted = asserted
        self._classes = Hierarchy([*edges(asserted, OF_CLASSES), *_under_thing(asserted)])
        self._properties = Hierarchy(edges(asserted, OF_PROPERTIES))
        self._remarks = _remarks(asserted)
        self.plain = self._plain()
        self._deputies: dict[Node, list[Node]] = {}
        """Each deputy, and the plain nodes that it represents."""
        self.rest = self._rest() if self.plain else asserted

    # -- the input of owlrl --------------------------------------------------------------------

    def _plain(self) -> frozenset[Node]:
        """Return the nodes of hierarchies that are no premise of other rules."""
        classes = {node for node in self._classes if isinstance(node, NamedNode)}
        properties = {node for node in self._properties if isinstance(node, NamedNode)}
        premises: set[object] = {node for node in classes | properties if is_standard(node)}
        premises |= classes & properties
        for triple in self._asserted:
            premises.update(self._premises(triple, classes, properties))
        return frozenset((classes | properties) - premises)

    def _premises(
        self, triple: Triple, classes: set[NamedNode], properties: set[NamedNode]
    ) -> tuple[object, ...]:
        """Return the nodes of a triple that it makes premises of other rules."""
        subject, predicate, object = triple.subject, triple.predicate, triple.object
        if isinstance(object, Triple) or predicate in properties:
            return subject, predicate, object
        if predicate in _HIERARCHICAL:
            return (subject,) if isinstance(object, Literal) else ()
        if predicate == RDF_TYPE:
            is_kind = not is_standard(object) or object.value in _PLAIN_KINDS
            return ((object,) if object in properties else ()) if is_kind else (subject,)
        if predicate in _ENDS and not isinstance(object, Literal):
            return tuple(
                node
                for node, others in ((subject, classes), (object, properties))
                if node in others
            )
        return () if predicate in self._remarks else (subject, object)

    def _rest(self) -> frozenset[Triple]:
        rest: set[Triple] = set()
        sayings: dict[Node, set[PredicateObject]] = defaultdict(set)
        for triple in self._asserted:
            subject, predicate, object = triple.subject, triple.predicate, triple.object
            assert not isinstance(subject, Triple)
            if predicate in self._remarks and {subject, object} & self.plain:
                continue
            if predicate in _HIERARCHICAL and {subject, object} & self.plain:
                continue
            visible = (
                self._classes_for_owlrl(object) if predicate in (RDF_TYPE, *_ENDS) else [object]
            )
            if subject not in self.plain:
                rest.update(Triple(subject, predicate, each) for each in visible)
            elif predicate not in _ENDS:
                sayings[subject].update((predicate, each) for each in visible)
        rest.update(self._shortcuts())
        by_statements: dict[frozenset[PredicateObject], list[Node]] = defaultdict(list)
        for node in sorted(self.plain, key=str):
            by_statements[frozenset(sayings.get(node, ()))].append(node)
        for statements, nodes in by_statements.items():
            self._deputies[nodes[0]] = nodes
            rest.update(Triple(nodes[0], predicate, object) for predicate, object in statements)
        return frozenset(rest)

    def _classes_for_owlrl(
        self, kind: NamedNode | BlankNode | Literal | Triple
    ) -> Iterable[NamedNode | BlankNode | Literal | Triple]:
        """Return ``kind``, or the classes above it that are in the input of owlrl."""
        if kind not in self.plain:
            return [kind]
        assert isinstance(kind, NamedNode)
        return [above for above in self._classes.above(kind) if above not in self.plain]

    def _shortcuts(self) -> Iterable[Triple]:
        """Yield edges that replace paths over plain nodes between two other nodes."""
        hierarchies = ((self._classes, OF_CLASSES[0]), (self._properties, OF_PROPERTIES[0]))
        for hierarchy, inclusion in hierarchies:
            for node in hierarchy:
                if node in self.plain:
                    continue
                above = hierarchy[node]
                if above & self.plain:
                    yield from (Triple(node, inclusion, a) for a in above if a not in self.plain)
        visible = [property for property in self._properties if property not in self.plain]
        for triple in self._asserted:
            if triple.predicate in _ENDS and triple.subject in self.plain:
                for lower in visible:
                    if triple.subject in self._properties[lower]:
                        for kind in self._classes_for_owlrl(triple.object):
                            yield Triple(lower, triple.predicate, kind)

    # -- conclusions ---------------------------------------------------------------------------

    def merge_closure(self, entailed: Iterable[Triple]) -> set[Triple] | None:
        """Return the whole closure, where ``entailed`` is owlrl's closure of `rest` without noise.

        None: plain nodes turned out to be premises of other rules, so owlrl needs the whole input.
        """
        triples = set(self._asserted)
        same: dict[object, set[Node]] = defaultdict(set)
        for triple in entailed:
            if triple.predicate == _SAME_AS and self.plain:
                if {triple.subject, triple.object} & self._terms:
                    return None
                if isinstance(triple.object, NamedNode | BlankNode):
                    same[triple.subject].add(triple.object)
            if triple.object in self._deputies:
                return None
            nodes = self._deputies.get(triple.subject)  # type: ignore[arg-type]
            if nodes is None:
                triples.add(triple)
            elif self._is_harmless(triple, nodes):
                triples.update(Triple(n, triple.predicate, triple.object) for n in nodes)
            else:
                return None
        if same:
            triples.update(self._replaced(same))
        return triples | self._following(triples)

    @cached_property
    def _terms(self) -> frozenset[object]:
        """What stands in a hierarchy, or is a domain or range: where two of them are the same, more
        follows than `_replaced`."""
        ends = (triple.object for triple in self._asserted if triple.predicate in _ENDS)
        return frozenset([*self._classes, *self._properties, *ends])

    def _replaced(self, same: Mapping[object, Set[Node]]) -> Iterable[Triple]:
        """What owlrl has not seen, said of all that are the ``same`` (rules eq-rep-s, eq-rep-o)."""
        for triple in self._asserted - self.rest:
            for subject in (triple.subject, *same.get(triple.subject, ())):
                for object in (triple.object, *same.get(triple.object, ())):
                    yield Triple(subject, triple.predicate, object)

    def _is_harmless(self, triple: Triple, nodes: Iterable[Node]) -> bool:
        """Return whether the triple leaves ``nodes`` plain if it holds for each of them."""
        kind = triple.object
        if triple.predicate == RDF_TYPE:
            return not is_standard(kind) or kind.value in _PLAIN_KINDS  # type: ignore[union-attr]
        if triple.predicate in _HIERARCHICAL:
            # Otherwise `rest` lacked some of the classes above the nodes.
            return all(kind in self._classes.above(node) for node in nodes)
        return triple in self._asserted

    def _following(self, triples: set[Triple]) -> set[Triple]:
        """Return the triples that the closed hierarchies add."""
        classes = Hierarchy(edges(triples, OF_CLASSES))
        properties = Hierarchy(edges(triples, OF_PROPERTIES))
        found = _hierarchical(classes, triples, OF_CLASSES)
        found |= _hierarchical(properties, triples, OF_PROPERTIES)
        for end in _ENDS:
            found |= _ends(triples, end, classes, properties)
        rules = Rules(triples)
        for triple in triples:
            found |= rules.entail(triple)
        return found


def _under_thing(asserted: Set[Triple]) -> list[tuple[Node, Node]]:
    """Return edges from each owl:Class to owl:Thing (rule scm-cls)."""
    return [
        (t.subject, _THING)
        for t in asserted
        if t.predicate == RDF_TYPE and t.object == _CLASS and not isinstance(t.subject, Triple)
    ]


def _remarks(asserted: Set[Triple]) -> frozenset[NamedNode]:
    """Return the predicates without consequences: no triple describes them."""
    used = {t.predicate for t in asserted}
    described = {t.subject for t in asserted} | {t.object for t in asserted}
    return frozenset(
        p for p in used if p not in described and (p.value in _REMARKS or not is_standard(p))
    )


def _hierarchical(hierarchy: Hierarchy[Node], stated: Set[Triple], kind: Inclusion) -> set[Triple]:
    """Return the pairs of a hierarchy, or marks if there are too many pairs."""
    inclusion, equivalence = kind
    if hierarchy.pairs > deep_hierarchies.MOST_PAIRS:
        return set(marks_of(hierarchy, stated, kind))
    found: set[Triple] = set()
    for node in hierarchy:
        above = hierarchy[node]
        found.update(Triple(node, inclusion, other) for other in above)
        if node in above:
            found.update(
                Triple(node, equivalence, other) for other in above if node in hierarchy[other]
            )
    return found


def _ends(
    triples: Set[Triple], end: NamedNode, classes: Hierarchy[Node], properties: Hierarchy[Node]
) -> set[Triple]:
    """Return the domains or ranges of each property: those of all properties above it, and the
    classes above those.

    Rules scm-dom1, scm-dom2, scm-rng1 and scm-rng2.
    """
    direct: dict[Node, set[Node]] = defaultdict(set)
    for triple in triples:
        kind = triple.object
        if triple.predicate == end and not isinstance(kind, Literal | Triple):
            assert not isinstance(triple.subject, Triple)
            direct[triple.subject] |= {kind} | classes.above(kind)
    stated = frozenset(direct)
    return {
        Triple(property, end, kind)
        for property in {*direct, *properties}
        for above in stated & (properties.above(property) | {property})
        for kind in direct[above]
    }
