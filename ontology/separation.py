"""An ontology in two parts: hierarchies that bit sets close, and the rest, which owlrl closes.

owlrl compares every triple with every rule in each of its rounds; a chain of 100 classes makes
5,000 triples of it, which take seconds. A class or property of a hierarchy alone is a premise of
few rules, and their conclusions follow from the hierarchies' closure (`hierarchy`):

| rule of OWL 2 RL | conclusion |
|---|---|
| scm-sco, scm-spo, scm-eqc, scm-eqp | sub-classes, sub-properties, equivalences |
| cax-sco, cax-eqc | types |
| prp-spo1, prp-eqp | triples of super-properties |
| scm-dom1, scm-dom2, scm-rng1, scm-rng2, prp-dom, prp-rng | domains, ranges, and types of them |

So `Separation` keeps such *plain* nodes from owlrl, with one deputy for those that say the same of
themselves, and `Separation.merge_closure` adds what follows. `closure` calls it.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Set
from typing import Final, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from ..rdf.namespaces import OWL, RDF, RDF_TYPE, RDFS
from . import deep_hierarchies
from .deep_hierarchies import is_standard, marks_of
from .entailment import DOMAIN, RANGE, Rules
from .hierarchy import (
    OF_CLASSES,
    OF_PROPERTIES,
    Hierarchy,
    Inclusion,
    Node,
    edges,
)

PredicateObject: TypeAlias = tuple[NamedNode, NamedNode | BlankNode | Literal | Triple]
"""A predicate and an object."""

_HIERARCHICAL: Final = (*OF_CLASSES, *OF_PROPERTIES)
_ENDS: Final = (DOMAIN, RANGE)
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
"""Standard types that make a node no premise of a rule beyond those above."""


class Separation:
    """``asserted`` in two parts: `rest` is for owlrl, `plain` are the nodes that it lacks.

    Law (tests/laws/ontology/test_ontology.py): owlrl's closure of ``asserted`` is `merge_closure` of its
    closure of `rest`, but for noise, where `merge_closure` gives an answer.
    """

    def __init__(self, asserted: Set[Triple]) -> None:
        self._asserted = asserted
        self._classes = Hierarchy([*edges(asserted, OF_CLASSES), *_under_thing(asserted)])
        self._properties = Hierarchy(edges(asserted, OF_PROPERTIES))
        self._remarks = _remarks(asserted)
        self.plain = self._plain()
        self._deputies: dict[Node, list[Node]] = {}
        """Those that owlrl sees, and for whom else they stand."""
        self.rest = self._rest() if self.plain else asserted

    # -- what owlrl need not see ---------------------------------------------------------------

    def _plain(self) -> frozenset[Node]:
        """The nodes of hierarchies of which nothing is said that other rules ask for."""
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
        """The nodes of a triple that are more by it than nodes of a hierarchy."""
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
            visible = self._seen(object) if predicate in (RDF_TYPE, *_ENDS) else [object]
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

    def _seen(
        self, kind: NamedNode | BlankNode | Literal | Triple
    ) -> Iterable[NamedNode | BlankNode | Literal | Triple]:
        """``kind``, or the classes above it that owlrl sees."""
        if kind not in self.plain:
            return [kind]
        assert isinstance(kind, NamedNode)
        return [above for above in self._classes.above(kind) if above not in self.plain]

    def _shortcuts(self) -> Iterable[Triple]:
        """What leads from a node that owlrl sees over plain ones to another."""
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
                        for kind in self._seen(triple.object):
                            yield Triple(lower, triple.predicate, kind)

    # -- what follows --------------------------------------------------------------------------

    def merge_closure(self, entailed: Iterable[Triple]) -> set[Triple] | None:
        """All that follows, where ``entailed`` is what owlrl says of `rest`, noise left out.

        None: plain nodes are premises of other rules after all, so that owlrl has to see them.
        """
        triples = set(self._asserted)
        for triple in entailed:
            if triple.predicate.value == OWL + "sameAs" and self.plain:
                return None
            if triple.object in self._deputies:
                return None
            nodes = self._deputies.get(triple.subject)  # type: ignore[arg-type]
            if nodes is None:
                triples.add(triple)
            elif self._is_harmless(triple, nodes):
                triples.update(Triple(n, triple.predicate, triple.object) for n in nodes)
            else:
                return None
        return triples | self._following(triples)

    def _is_harmless(self, triple: Triple, nodes: Iterable[Node]) -> bool:
        """Whether it makes no plain node a premise of other rules, where it holds of ``nodes``."""
        kind = triple.object
        if triple.predicate == RDF_TYPE:
            return not is_standard(kind) or kind.value in _PLAIN_KINDS  # type: ignore[union-attr]
        if triple.predicate in _HIERARCHICAL:
            # Else owlrl has seen less than what is above the nodes.
            return all(kind in self._classes.above(node) for node in nodes)
        return triple in self._asserted

    def _following(self, triples: set[Triple]) -> set[Triple]:
        """What the closure of the hierarchies adds."""
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
    """What is a class is within owl:Thing (rule scm-cls)."""
    return [
        (t.subject, _THING)
        for t in asserted
        if t.predicate == RDF_TYPE and t.object == _CLASS and not isinstance(t.subject, Triple)
    ]


def _remarks(asserted: Set[Triple]) -> frozenset[NamedNode]:
    """The predicates from which nothing follows: nothing is said of them."""
    used = {t.predicate for t in asserted}
    described = {t.subject for t in asserted} | {t.object for t in asserted}
    return frozenset(
        p for p in used if p not in described and (p.value in _REMARKS or not is_standard(p))
    )


def _hierarchical(hierarchy: Hierarchy[Node], stated: Set[Triple], kind: Inclusion) -> set[Triple]:
    """The pairs of a hierarchy, or marks where they are too many."""
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
    """Domains or ranges of each property: those of all that is above it, and what is above those.

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
