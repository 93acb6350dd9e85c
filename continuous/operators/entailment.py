"""The triples that the ontology's schema entails from stream triples (SPEC §4, "What is entailed in
windows").

The rules are those on single triples (`ontology.entailment.rules`): sub-properties, inverse and
symmetric properties, equivalences, domains and ranges, sub-classes. Transitivity, property chains
and owl:sameAs hold in the static side only. `window_schedule` adds the entailed rows to the pushed
ones, so every way to evaluate a query reads them; docs/explanation/semantics.md has the table.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ...ontology.entailment.hierarchy import Node
from ...ontology.entailment.rules import Consequences, Rules
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
class PatternNeeds:
    """The predicates and the classes that a query reads; None: any."""

    predicates: frozenset[NamedNode] | None = None
    classes: frozenset[NamedNode] | None = None

    @classmethod
    def of(cls, plan: Plan) -> PatternNeeds:
        """Collect them from the patterns of a logical plan."""
        predicates: set[NamedNode] = set()
        classes: set[NamedNode] = set()
        any_class = False
        for node in walk(plan):
            match node:
                # `p*` relates each node of a graph to itself, so it reads all predicates.
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
        """Return those of ``predicates`` that the query reads, by name."""
        read = self.predicates
        return sorted((p for p in predicates if read is None or p in read), key=str)

    def wants(self, kinds: Iterable[Node]) -> bool:
        """Whether the query reads one of these classes."""
        return any(self.classes is None or kind in self.classes for kind in kinds)


@dataclass(frozen=True, slots=True, eq=False)
class _Effect:
    """The consequences of the triples of one predicate: ids of predicates from subject to object
    with the conversion of units, ids of inverse predicates, and ids of the narrowest classes of
    subject and object."""

    along: tuple[tuple[int, Conversion | None], ...]
    back: tuple[int, ...]
    subject: tuple[int, ...]
    object: tuple[int, ...]
    named: HeldTerms
    """Keeps the ids in the dictionary."""


class StreamEntailment(TermTable):
    """The rows that the schema entails from rows, as far as a query reads them.

    Law (tests/laws/continuous/test_entailment.py): with these rows a window contains, for each
    stream triple, every triple that the schema and this triple alone entail, once. Facts of
    rdf:type come as rows without objects: their sort states the fact. The schema at the arrival of
    a row decides.

    Cost: nothing without a schema; else a look-up per column, a table per entailed predicate (it
    shares the columns), and a pass over the objects for inverses and ranges. Memory: an entry per
    predicate.
    """

    def __init__(
        self, background: Background, terms: TermValues, find_needs: Callable[[], PatternNeeds]
    ) -> None:
        """``find_needs`` computes what the query reads, on first use."""
        self._background = background
        self._terms = terms
        self._find_needs = find_needs
        self._rules = Rules(())
        self._effects: dict[int, _Effect | None] = {}
        """By predicate id; None if there are no consequences that the query reads."""
        terms.dictionary.follow(self)

    @cached_property
    def needs(self) -> PatternNeeds:
        """What the query reads: only such rows are entailed."""
        return self._find_needs()

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        self._effects = {id: effect for id, effect in self._effects.items() if not freed[id]}

    def of(self, tables: Sequence[TripleRows]) -> list[TripleRows]:
        """Return the rows that these rows entail, without the rows themselves."""
        rules = self._background.rules
        if rules is not self._rules:
            # Another schema gives other effects; rows that came before keep theirs.
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

    def entails_of_objects(self, features: Collection[str]) -> bool:
        """Whether streams of these features (IRIs) or of their sub-properties entail triples about
        the objects of their triples, not their subjects, that the query reads."""
        rules = self._background.rules
        wanted = {NamedNode(feature) for feature in features}
        return any(
            self.needs.among(found.back)
            # Ranges that are datatypes entail nothing about literals.
            or any(not kind.value.startswith(XSD) for kind in self._kinds(found.object))
            for found in map(rules.consequences, rules.properties)
            if found.along & wanted
        )

    def describe(self) -> Iterator[str]:
        """Yield a line for `explain` per predicate with consequences."""
        for predicate in sorted(self._background.rules.properties, key=str):
            found = self._background.rules.consequences(predicate)
            name, subject, object = shorten(predicate.value), "?s", "?o"
            consequences = [
                *(f"{subject} {shorten(p.value)} {object}" for p in self._along(predicate, found)),
                *(f"{object} {shorten(p.value)} {subject}" for p in self.needs.among(found.back)),
                *(f"{subject} a {shorten(kind.value)}" for kind in self._kinds(found.subject)),
                *(f"{object} a {shorten(kind.value)}" for kind in self._kinds(found.object)),
            ]
            if consequences:
                yield f"{subject} {name} {object} entails {', '.join(consequences)}"

    def _along(self, predicate: NamedNode, found: Consequences) -> list[NamedNode]:
        # The row itself states its own predicate.
        return self.needs.among(found.along - {predicate})

    def _kinds(self, kinds: frozenset[Node]) -> list[NamedNode]:
        """Return the narrowest of the classes, or none if the query reads none of them. Of
        equivalent classes the first by name stands for all."""
        if not self.needs.wants(kinds):
            return []
        # A sort stands for the sorts above it, so the narrowest ones state all.
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
            self.needs.among(found.back),
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
        # RDF has no triples about literals.
        nodes = np.flatnonzero(self._terms.sorts(column.values) == Sort.NODE)
        time, valid, subject = time[nodes], valid[nodes], subject[nodes]
        objects = column.values[nodes]
        same = {predicate, *(super for super, _ in effect.along)}
        for inverse in effect.back:
            # The inverse of a triple (a, p, a) is itself: add it once, not twice.
            turned = np.flatnonzero(objects != subject) if inverse in same else slice(None)
            back = ObjectColumn(Kind.TERM, subject[turned])
            yield TripleRows(time[turned], valid[turned], objects[turned], {inverse: back})
        for kind in effect.object:
            yield TripleRows(time, valid, objects, {}, kind)

    def _is_known(self, sort: int | None, kind: int) -> bool:
        """Whether the rows' annotation implies the class already."""
        if sort is None:
            return False
        annotated, wanted = self._terms.dictionary.term(sort), self._terms.dictionary.term(kind)
        return annotated == wanted or (
            isinstance(annotated, NamedNode) and wanted in self._rules.above(annotated)
        )

    def _wider(self, table: TripleRows, column: ObjectColumn) -> Iterator[TripleRows]:
        """Yield rows with a sort for a stream's own rdf:type triples: they imply wider sorts."""
        if column.kind is not Kind.TERM:
            return
        there = np.flatnonzero(column.present)
        for id in np.unique(column.values[there]).tolist():
            kind = self._terms.dictionary.term(id)
            if isinstance(kind, NamedNode) and self.needs.wants(self._rules.above(kind)):
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
"""The kinds of numbers after a conversion of units."""


def _changed(column: ObjectColumn, change: Conversion | None, terms: TermValues) -> ObjectColumn:
    """Convert numbers to another unit. Integers become doubles; other terms stay."""
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
