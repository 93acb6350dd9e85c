"""What the ontology's schema says of stream triples (SPEC §4, "What is entailed in windows").

The rules are those on single triples (`ontology.entailment`): sub-properties, inverse and symmetric
properties, equivalences, domains and ranges, sub-classes. Transitivity, property chains and
owl:sameAs hold in the static side only. `window_schedule` adds the rows that are made here to those
that come, so that every way to evaluate a query sees them; docs/explanation/semantics.md has the
table.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ...ontology.entailment import Consequences, Rules
from ...ontology.hierarchy import Node
from ...ontology.units import Conversion
from ...rdf.dictionary import HeldTerms, TermTable
from ...rdf.namespaces import RDF_TYPE, XSD, shorten
from ...rdf.timed import Kind, ObjectColumn, TripleRows, make_literal
from ..algebra.expressions import Const
from ..algebra.plan import AnyScan, Closure, Plan, Scan, TypeScan, walk
from ..columns.relation import TermValues
from ..values.literals import Sort
from .background import Background


@dataclass(frozen=True, slots=True)
class Asked:
    """The predicates and the classes that a query asks for; None: any."""

    predicates: frozenset[NamedNode] | None = None
    classes: frozenset[NamedNode] | None = None

    @classmethod
    def by(cls, plan: Plan) -> Asked:
        """What the patterns of a logical plan ask for."""
        predicates: set[NamedNode] = set()
        classes: set[NamedNode] = set()
        any_class = False
        for node in walk(plan):
            match node:
                case AnyScan() | Closure(zero=True):
                    return cls()
                case Scan():
                    predicates.add(node.predicate)
                case TypeScan(_, Const(NamedNode() as sort)):
                    classes.add(sort)
                case TypeScan():
                    any_class = True
        return cls(frozenset(predicates), None if any_class else frozenset(classes))

    def among(self, predicates: Iterable[NamedNode]) -> list[NamedNode]:
        """Those of ``predicates`` that are asked for, by name."""
        asked = self.predicates
        return sorted((p for p in predicates if asked is None or p in asked), key=str)

    def wants(self, kinds: Iterable[Node]) -> bool:
        """Whether one of these classes is asked for."""
        return any(self.classes is None or kind in self.classes for kind in kinds)


@dataclass(frozen=True, slots=True, eq=False)
class _Effect:
    """What follows from the triples of one predicate: ids of predicates from subject to object,
    with the change of unit, and back; ids of the narrowest classes of subject and of object."""

    along: tuple[tuple[int, Conversion | None], ...]
    back: tuple[int, ...]
    subject: tuple[int, ...]
    object: tuple[int, ...]
    named: HeldTerms
    """Holds the ids."""


class StreamEntailment(TermTable):
    """The rows that the schema entails of rows, as far as a query asks for them.

    Law (tests/laws/continuous/test_entailment.py): with these rows a window holds, of each stream
    triple, each triple once that the schema and this triple alone entail. Facts of rdf:type come as
    rows without objects, whose sort says them. What is entailed is decided when a row comes.

    Cost: nothing where the schema says nothing; a look-up a column; a table that shares the
    columns an entailed predicate; a pass over the objects for inverses and ranges. Memory: an
    entry a predicate that was met.
    """

    def __init__(
        self, background: Background, terms: TermValues, asks: Callable[[], Asked]
    ) -> None:
        """``asks`` gives what is asked for, when it is needed first."""
        self._background = background
        self._terms = terms
        self._asks = asks
        self._rules = Rules(())
        self._effects: dict[int, _Effect | None] = {}
        """By predicate's id; None where nothing follows that is asked for."""
        terms.dictionary.follow(self)

    @cached_property
    def asked(self) -> Asked:
        """The predicates and classes for which rows are made."""
        return self._asks()

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        self._effects = {id: effect for id, effect in self._effects.items() if not freed[id]}

    def of(self, tables: Sequence[TripleRows]) -> list[TripleRows]:
        """What follows from these rows, without them."""
        rules = self._background.rules
        if rules is not self._rules:
            self._rules, self._effects = rules, {}
        if rules.is_empty:
            return []
        rdf_type = self._terms.dictionary.find(RDF_TYPE)
        found: list[TripleRows] = []
        for table in tables:
            for predicate, column in table.objects.items():
                if predicate == rdf_type:
                    found += self._wider(table, column)
                    continue
                if predicate not in self._effects:
                    self._effects[predicate] = self._effect(predicate)
                effect = self._effects[predicate]
                if effect is not None:
                    found += self._follow(effect, predicate, table, column)
        return [rows for rows in found if len(rows)]

    def tells_of_objects(self, features: Collection[str]) -> bool:
        """Whether streams of these features (IRIs), or of what is a case of them, entail something
        that is asked for of the objects of their triples, not of their subjects."""
        rules = self._background.rules
        wanted = {NamedNode(feature) for feature in features}
        return any(
            self.asked.among(found.back)
            # Literals are of datatypes, and nothing is said of them.
            or any(not kind.value.startswith(XSD) for kind in self._kinds(found.object))
            for found in map(rules.consequences, rules.properties)
            if found.along & wanted
        )

    def described(self) -> Iterator[str]:
        """What is entailed of streams for the query, for people."""
        for predicate in sorted(self._background.rules.properties, key=str):
            found = self._background.rules.consequences(predicate)
            name, subject, object = shorten(predicate.value), "?s", "?o"
            told = [
                *(f"{subject} {shorten(p.value)} {object}" for p in self._along(predicate, found)),
                *(f"{object} {shorten(p.value)} {subject}" for p in self.asked.among(found.back)),
                *(f"{subject} a {shorten(kind.value)}" for kind in self._kinds(found.subject)),
                *(f"{object} a {shorten(kind.value)}" for kind in self._kinds(found.object)),
            ]
            if told:
                yield f"{subject} {name} {object} entails {', '.join(told)}"

    def _along(self, predicate: NamedNode, found: Consequences) -> list[NamedNode]:
        return self.asked.among(found.along - {predicate})

    def _kinds(self, kinds: frozenset[Node]) -> list[NamedNode]:
        """The narrowest of the classes, none if nobody asks for any; of equivalent ones the first
        by name."""
        if not self.asked.wants(kinds):
            return []
        found: list[NamedNode] = []
        above = self._background.rules.above
        for kind in sorted((k for k in kinds if isinstance(k, NamedNode)), key=str):
            narrower = any(kind in above(k) and k not in above(kind) for k in kinds)
            if not narrower and not any(kind in above(k) for k in found):
                found.append(kind)
        return found

    def _effect(self, id: int) -> _Effect | None:
        dictionary = self._terms.dictionary
        predicate = dictionary.term(id)
        assert isinstance(predicate, NamedNode)
        found = self._rules.consequences(predicate)
        groups = (
            self._along(predicate, found),
            self.asked.among(found.back),
            self._kinds(found.subject),
            self._kinds(found.object),
        )
        if not any(groups):
            return None
        named = HeldTerms(dictionary, [term for group in groups for term in group])
        ids = iter(named.ids.tolist())
        along, back, subject, object = (tuple(next(ids) for _ in group) for group in groups)
        changes = [self._background.conversion(predicate.value, p.value) for p in groups[0]]
        return _Effect(tuple(zip(along, changes, strict=True)), back, subject, object, named)

    def _follow(
        self, effect: _Effect, predicate: int, table: TripleRows, column: ObjectColumn
    ) -> Iterator[TripleRows]:
        if column.null is not None:
            there = np.flatnonzero(~column.null)
            table, column = table.take(there), column.take(there)
            column = ObjectColumn(column.kind, column.values)
        time, valid, subject, sort = table.time, table.valid, table.subject, table.sort
        for super, change in effect.along:
            yield TripleRows(time, valid, subject, {super: _changed(column, change, self._terms)})
        for kind in effect.subject:
            if not self._is_known(sort, kind):
                yield TripleRows(time, valid, subject, {}, kind)
        if column.kind is not Kind.TERM or not (effect.back or effect.object):
            return
        # A literal is no subject in RDF, so nothing is said of it.
        nodes = np.flatnonzero(self._terms.sorts(column.values) == Sort.NODE)
        time, valid, subject = time[nodes], valid[nodes], subject[nodes]
        objects = column.values[nodes]
        same = {predicate, *(super for super, _ in effect.along)}
        for inverse in effect.back:
            # What is turned into itself is one triple, not two.
            turned = np.flatnonzero(objects != subject) if inverse in same else slice(None)
            back = ObjectColumn(Kind.TERM, subject[turned])
            yield TripleRows(time[turned], valid[turned], objects[turned], {inverse: back})
        for kind in effect.object:
            yield TripleRows(time, valid, objects, {}, kind)

    def _is_known(self, sort: int | None, kind: int) -> bool:
        """Whether the annotation of rows says as much already."""
        if sort is None:
            return False
        known, wanted = self._terms.dictionary.term(sort), self._terms.dictionary.term(kind)
        return known == wanted or (
            isinstance(known, NamedNode) and wanted in self._rules.above(known)
        )

    def _wider(self, table: TripleRows, column: ObjectColumn) -> Iterator[TripleRows]:
        """Types that a stream tells: rows of a sort say those above it too."""
        if column.kind is not Kind.TERM:
            return
        there = np.flatnonzero(column.present)
        for id in np.unique(column.values[there]).tolist():
            kind = self._terms.dictionary.term(id)
            if isinstance(kind, NamedNode) and self.asked.wants(self._rules.above(kind)):
                rows = table.take(there[column.values[there] == id])
                yield TripleRows(rows.time, rows.valid, rows.subject, {}, id)


_CHANGED: Final = {
    Sort.INTEGER: Kind.DOUBLE,
    Sort.LONG_INTEGER: Kind.DOUBLE,
    Sort.DECIMAL: Kind.DECIMAL,
    Sort.LONG_DECIMAL: Kind.DECIMAL,
    Sort.FLOAT: Kind.FLOAT,
    Sort.DOUBLE: Kind.DOUBLE,
}
"""What numbers become in another unit."""


def _changed(column: ObjectColumn, change: Conversion | None, terms: TermValues) -> ObjectColumn:
    """Numbers in another unit: integers become doubles, what is no number stays."""
    if change is None or change.is_identity:
        return column
    if column.kind.is_number:
        kind = _CHANGED[Sort(column.kind)]
        return ObjectColumn(kind, change.apply(column.values))
    if column.kind is not Kind.TERM:
        return column
    distinct, places = np.unique(column.values, return_inverse=True)
    changed = distinct.copy()
    for at, sort in enumerate(terms.sorts(distinct).tolist()):
        changed_kind = _CHANGED.get(Sort(sort))
        if changed_kind is not None:
            number = terms.dictionary.term(int(distinct[at]))
            value = change.apply(np.array(float(number.value)))
            changed[at] = terms.dictionary.transient_id(make_literal(changed_kind, value))
    return ObjectColumn(Kind.TERM, changed[places])
