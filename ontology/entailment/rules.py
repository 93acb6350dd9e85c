"""Maintains the entailments of the live stream space, triple by triple.

owlrl needs a quarter of a second for a closure, but the stream space changes with each unit that
starts or stops. Each rule that concerns it has one instance triple as premise (OWL 2 RL prp-inv1/2,
prp-symp, prp-spo1, prp-eqp1/2, prp-dom, prp-rng, cax-sco, cax-eqc1/2). The entailments of a graph
are therefore the union of those of its triples. Counting the triples that entail each one keeps the
union right under removal.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Final, TypeAlias

from pyoxigraph import BlankNode, Literal, NamedNode, Triple

from ...rdf.namespaces import OWL, RDF_TYPE, RDFS
from .hierarchy import OF_CLASSES, OF_PROPERTIES, Hierarchy, Node, edges

DOMAIN: Final = NamedNode(RDFS + "domain")
RANGE: Final = NamedNode(RDFS + "range")
INVERSE: Final = NamedNode(OWL + "inverseOf")
SYMMETRIC: Final = NamedNode(OWL + "SymmetricProperty")
SCHEMA: Final = frozenset({*OF_CLASSES, *OF_PROPERTIES, DOMAIN, RANGE, INVERSE, RDF_TYPE})
"""The predicates of the schema triples that become rules."""


@dataclass(frozen=True, slots=True)
class Consequences:
    """The consequences of ``s p o``: predicates from s to o, predicates from o to s, classes of s
    and of o."""

    along: frozenset[NamedNode]
    back: frozenset[NamedNode]
    subject: frozenset[Node]
    object: frozenset[Node]


Kinds: TypeAlias = tuple[Node, frozenset[Node]]
"""A node and classes that it is an instance of."""


class Rules:
    """The schema of an ontology as rules on single triples.

    ``schema`` need not be closed. Cost of `entail`: a dict look-up and the triples that it makes.
    """

    def __init__(self, schema: Iterable[Triple]) -> None:
        schema_triples = [triple for triple in schema if triple.predicate in SCHEMA]
        self._classes = Hierarchy(edges(schema_triples, OF_CLASSES))
        self._properties = Hierarchy(edges(schema_triples, OF_PROPERTIES))
        self._inverses: dict[Node, set[Node]] = defaultdict(set)
        self._domains: dict[Node, set[Node]] = defaultdict(set)
        self._ranges: dict[Node, set[Node]] = defaultdict(set)
        self._known: dict[NamedNode, Consequences] = {}
        self._proper: dict[Node, frozenset[Node]] = {}
        for triple in schema_triples:
            self._add_axiom(triple)

    def _add_axiom(self, triple: Triple) -> None:
        subject, object = triple.subject, triple.object
        if isinstance(subject, Triple) or isinstance(object, Literal | Triple):
            return
        predicate = triple.predicate
        if predicate == INVERSE:
            self._inverses[subject].add(object)
            self._inverses[object].add(subject)
        elif predicate == DOMAIN:
            self._domains[subject].add(object)
        elif predicate == RANGE:
            self._ranges[subject].add(object)
        elif predicate == RDF_TYPE and object == SYMMETRIC:
            self._inverses[subject].add(subject)

    @property
    def is_empty(self) -> bool:
        """True if the rules derive nothing from any triple."""
        return not (self._classes or self.properties)

    @cached_property
    def properties(self) -> frozenset[NamedNode]:
        """The properties whose triples may be premises."""
        premises = (self._properties, self._inverses, self._domains, self._ranges)
        return frozenset(p for p in chain(*premises) if isinstance(p, NamedNode))

    def entail(self, triple: Triple) -> set[Triple]:
        """Return all triples that the rules derive from this one, without itself."""
        derived, kinds = self.derive(triple)
        derived.update(Triple(node, RDF_TYPE, c) for node, classes in kinds for c in classes)
        derived.discard(triple)
        return derived

    def derive(self, triple: Triple) -> tuple[set[Triple], tuple[Kinds, ...]]:
        """Return what `entail` derives, with the types of nodes as classes instead of triples: many
        triples imply the same type of a node. The classes of a type triple may include its own."""
        subject, object = triple.subject, triple.object
        assert not isinstance(subject, Triple)  # read_triples and mirror take RDF 1.1 only
        if triple.predicate == RDF_TYPE and isinstance(object, NamedNode | BlankNode):
            return set(), ((subject, self.above(object)),)
        rules = self.consequences(triple.predicate)
        derived = {Triple(subject, p, object) for p in rules.along if p != triple.predicate}
        # A literal cannot be the subject of a triple, so it gets no consequences.
        if isinstance(object, Literal | Triple):
            return derived, ((subject, rules.subject),)
        derived.update(Triple(object, p, subject) for p in rules.back)
        derived.discard(triple)
        return derived, ((subject, rules.subject), (object, rules.object))

    def above(self, kind: Node) -> frozenset[Node]:
        """Return the classes that contain ``kind``, without itself."""
        found = self._proper.get(kind)
        if found is None:
            found = self._proper[kind] = self._classes.above(kind) - {kind}
        return found

    def consequences(self, predicate: NamedNode) -> Consequences:
        """Return the consequences of a triple of ``predicate``."""
        found = self._known.get(predicate)
        if found is None:
            found = self._known[predicate] = self._derive(predicate)
        return found

    def _derive(self, predicate: NamedNode) -> Consequences:
        # A reached property holds along the triple (False) or backwards (True).
        reached: set[tuple[Node, bool]] = {(predicate, False)}
        todo: list[tuple[Node, bool]] = [(predicate, False)]
        while todo:
            property, turned = todo.pop()
            steps = {(p, turned) for p in self._properties.above(property)}
            steps |= {(p, not turned) for p in self._inverses.get(property, ())}
            todo.extend(steps - reached)
            reached |= steps
        along = frozenset(p for p, turned in reached if not turned)
        back = frozenset(p for p, turned in reached if turned)
        return Consequences(
            _named_nodes(along),
            _named_nodes(back),
            self._kinds(along, self._domains) | self._kinds(back, self._ranges),
            self._kinds(along, self._ranges) | self._kinds(back, self._domains),
        )

    def _kinds(self, properties: Iterable[Node], ends: Mapping[Node, set[Node]]) -> frozenset[Node]:
        direct = {c for p in properties for c in ends.get(p, ())}
        return frozenset(direct.union(*(self._classes.above(c) for c in direct)))


def _named_nodes(properties: Iterable[Node]) -> frozenset[NamedNode]:
    return frozenset(p for p in properties if isinstance(p, NamedNode))


@dataclass(frozen=True, slots=True)
class Change:
    """Added and removed triples; no triple is in both."""

    added: frozenset[Triple]
    removed: frozenset[Triple]


class Entailments:
    """The entailments of a changing set of asserted triples.

    Law: after any changes `current` equals the union of ``rules.entail(t)`` over the asserted
    triples. Cost of `update`: O(changed triples). Memory: each asserted and each entailed triple
    once.
    """

    def __init__(self, rules: Rules, triples: Iterable[Triple] = ()) -> None:
        self._rules = rules
        self._held: set[Triple] = set()
        self._count: Counter[Triple] = Counter()
        """For each entailed triple, the number of its reasons: asserted triples, and types of
        nodes."""
        self._kinds: Counter[Kinds] = Counter()
        """For each type of a node, the number of asserted triples that imply it."""
        self.update(triples, ())

    @property
    def rules(self) -> Rules:
        """The rules that derive the entailments."""
        return self._rules

    def is_asserted(self, triple: Triple) -> bool:
        """Return whether the triple is one of `asserted`. Cost: a look-up."""
        return triple in self._held

    @property
    def asserted(self) -> frozenset[Triple]:
        """The triples whose entailments this object maintains."""
        return frozenset(self._held)

    @property
    def current(self) -> frozenset[Triple]:
        """The entailed triples; a triple that is also asserted is among them."""
        return frozenset(self._count)

    def update(self, added: Iterable[Triple], removed: Iterable[Triple]) -> tuple[Change, Change]:
        """Add and remove asserted triples. Returns the change of `asserted` and the change of
        `current`.

        A triple in both arguments stays. Adding an asserted triple and removing an unknown one have
        no effect.
        """
        coming = set(added)
        going = (set(removed) - coming) & self._held
        coming -= self._held
        touched: dict[Triple, int] = {}
        # Additions come first: if a value is replaced, the types of its node stay.
        for triples, step in ((coming, 1), (going, -1)):
            for triple in triples:
                derived, kinds = self._rules.derive(triple)
                entails = [*derived]
                for each in kinds:
                    self._kinds[each] += step
                    if self._kinds[each] == (1 if step > 0 else 0):
                        node, classes = each
                        entails += (Triple(node, RDF_TYPE, c) for c in classes)
                    if not self._kinds[each]:
                        del self._kinds[each]
                for entailed in entails:
                    touched.setdefault(entailed, self._count[entailed])
                    self._count[entailed] += step
        self._held |= coming
        self._held -= going
        now_there = {t for t, before in touched.items() if before == 0 and self._count[t] > 0}
        now_gone = {t for t, before in touched.items() if before > 0 and self._count[t] == 0}
        for triple in touched:
            if self._count[triple] == 0:
                del self._count[triple]
        return (
            Change(frozenset(coming), frozenset(going)),
            Change(frozenset(now_there), frozenset(now_gone)),
        )
