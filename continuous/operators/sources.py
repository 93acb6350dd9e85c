"""Where triples come from: the static side, encoded once a version, and the content of windows."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ...rdf.dictionary import NO_TERM
from ...rdf.namespaces import RDF_TYPE
from ...rdf.timed import Kind, ObjectColumn, TripleRows, split_term
from ..algebra.expressions import Const, Var
from ..algebra.plan import AnyScan, Plan, Scan, TypeScan
from ..columns.relation import (
    Pairs,
    Relation,
    TermValues,
    as_terms,
    concatenate,
    first_rows,
    key_codes,
    term_column,
)
from .background import Background
from .executor import OBJECT, PREDICATE, SUBJECT, pairs_of
from .profile import Profile


class StaticSide:
    """The background's triples in columns: each scan made once a version of the background, and
    its terms held as long."""

    def __init__(self, background: Background, terms: TermValues) -> None:
        self.background = background
        self.terms = terms
        terms.dictionary.hold(self)
        self._version: int | None = None
        self._pairs: dict[Scan | TypeScan, Pairs] = {}
        self._triples: dict[str, Relation] = {}

    def pairs(self, scan: Scan | TypeScan) -> Pairs:
        """The static triples that ``scan`` selects, each once."""
        self._follow()
        found = self._pairs.get(scan)
        if found is None:
            predicate = RDF_TYPE if isinstance(scan, TypeScan) else scan.predicate
            object = scan.sort if isinstance(scan, TypeScan) else scan.object
            rows = self.background.scan(
                scan.subject.term if isinstance(scan.subject, Const) else None,
                predicate,
                object.term if isinstance(object, Const) else None,
                scan.graph,
            )
            dictionary = self.terms.dictionary
            subjects = dictionary.transient_ids(subject for subject, _ in rows)
            if isinstance(object, Const):
                kind, value = split_term(object.term, dictionary.transient_id)
                objects = ObjectColumn(kind, np.full(len(rows), value, kind.dtype))
            else:
                objects = term_column([object for _, object in rows], dictionary.transient_id)
            found = self._pairs[scan] = (ObjectColumn(Kind.TERM, subjects), objects)
        return found

    def triples(self, graph: str) -> Relation:
        """All static triples of a graph but those of rdf:type, each once."""
        self._follow()
        found = self._triples.get(graph)
        if found is None:
            rows = [row for row in self.background.triples(graph) if row[1] != RDF_TYPE]
            dictionary = self.terms.dictionary
            columns = {
                SUBJECT: ObjectColumn(Kind.TERM, dictionary.transient_ids(s for s, _, _ in rows)),
                PREDICATE: ObjectColumn(Kind.TERM, dictionary.transient_ids(p for _, p, _ in rows)),
                OBJECT: term_column([o for _, _, o in rows], dictionary.transient_id),
            }
            found = self._triples[graph] = Relation(columns, len(rows))
        return found

    def held_ids(self) -> Iterator[NDArray[np.int32]]:
        """See `dictionary.Holder`."""
        for pair in list(self._pairs.values()):
            yield from (column.held_ids for column in pair)
        for relation in list(self._triples.values()):
            yield from (column.held_ids for column in relation.columns.values())

    def _follow(self) -> None:
        version = self.background.version
        if version != self._version:
            self._version, self._pairs, self._triples = version, {}, {}

    def supersorts(self, sort: int) -> frozenset[str]:
        """The sort with this id and all it is a sub-sort of."""
        term = self.terms.dictionary.term(sort)
        return (
            self.background.supersorts(term.value) if isinstance(term, NamedNode) else frozenset()
        )

    def sort_holds(self, sort: int | None, wanted: str) -> bool:
        """Whether rows annotated with ``sort`` tell that their subjects are of sort ``wanted``."""
        return sort is not None and wanted in self.supersorts(sort)


class WindowSource(ABC):
    """The leaves of a plan over the content of windows, by graph, and the static side.

    ``windows`` are the graphs that are windows: nothing static is in them. Under set semantics
    equal triples of a graph count once. Facts of `TypeScan` are a set under either semantics.
    """

    def __init__(
        self, static: StaticSide, windows: Sequence[str], distinct: bool, profile: Profile | None
    ) -> None:
        self.static = static
        self.windows = frozenset(windows)
        self.distinct = distinct
        self.profile = profile

    @abstractmethod
    def tables(self, graph: str) -> Sequence[TripleRows]:
        """The rows of a graph's windows."""

    @abstractmethod
    def ready(self, plan: Plan) -> Relation | None:
        """The solutions of ``plan`` if they are at hand already."""

    def pairs(self, scan: Scan | TypeScan) -> Pairs:
        terms = self.static.terms
        tables = self.tables(scan.graph)
        static = None if scan.graph in self.windows else self.static.pairs(scan)
        if isinstance(scan, Scan):
            predicate = terms.dictionary.find(scan.predicate)
            pairs = pairs_of(tables, predicate, static, terms)
            return distinct_pairs(pairs, terms) if self.distinct else pairs
        told = pairs_of(tables, terms.dictionary.find(RDF_TYPE), static, terms)
        return distinct_pairs(_joined([told, *self._annotated(scan, tables)], terms), terms)

    def matches(self, scan: Scan | AnyScan) -> Relation:
        """Triples with predicates and times. Cost: a column a predicate of the windows."""
        terms = self.static.terms
        parts = list(self._told(scan))
        if scan.graph not in self.windows:
            parts.append(self._static(scan))
        if isinstance(scan, AnyScan):
            parts.append(self._types(scan.graph))
        names = [SUBJECT, PREDICATE, OBJECT, *sorted(scan.times.names)]
        columns = {
            name: concatenate([_column(part, name) for part in parts], terms.dictionary)
            for name in names
            if parts
        }
        found = Relation(
            columns or {name: _nothing() for name in names}, sum(p.rows for p in parts)
        )
        return self._once(found, scan) if self.distinct else found

    def nodes(self, graph: str) -> ObjectColumn:
        found = self.matches(AnyScan(Var("s"), Var("p"), Var("o"), graph))
        dictionary = self.static.terms.dictionary
        ends = [as_terms(found.columns[name], dictionary).values for name in (SUBJECT, OBJECT)]
        return ObjectColumn(Kind.TERM, ids_in_order(ends, len(dictionary)))

    def _told(self, scan: Scan | AnyScan) -> Iterator[Relation]:
        """The triples of the windows: a relation a column; those of rdf:type are facts instead."""
        dictionary = self.static.terms.dictionary
        rdf_type = dictionary.find(RDF_TYPE)
        wanted = dictionary.find(scan.predicate) if isinstance(scan, Scan) else None
        for table in self.tables(scan.graph):
            for predicate, column in table.objects.items():
                if predicate == rdf_type or wanted not in (None, predicate):
                    continue
                rows = np.flatnonzero(column.present)
                columns = {
                    SUBJECT: ObjectColumn(Kind.TERM, table.subject[rows]),
                    PREDICATE: _constant(predicate, len(rows)),
                    OBJECT: ObjectColumn(column.kind, column.values[rows]),
                }
                for name, times in (
                    (scan.times.available, table.time),
                    (scan.times.valid, table.valid),
                ):
                    if name is not None:
                        columns[name] = ObjectColumn(Kind.INTEGER, times[rows])
                yield Relation(columns, len(rows))

    def _static(self, scan: Scan | AnyScan) -> Relation:
        if isinstance(scan, AnyScan):
            return self.static.triples(scan.graph)
        subjects, objects = self.static.pairs(Scan(Var("s"), scan.predicate, Var("o"), scan.graph))
        predicate = self.static.terms.dictionary.transient_id(scan.predicate)
        columns = {SUBJECT: subjects, PREDICATE: _constant(predicate, len(subjects))}
        return Relation({**columns, OBJECT: objects}, len(subjects))

    def _types(self, graph: str) -> Relation:
        subjects, sorts = self.pairs(TypeScan(Var("s"), Var("o"), graph))
        predicate = _constant(self.static.terms.dictionary.id(RDF_TYPE), len(subjects))
        return Relation({SUBJECT: subjects, PREDICATE: predicate, OBJECT: sorts}, len(subjects))

    def _once(self, found: Relation, scan: Scan | AnyScan) -> Relation:
        """Each triple once, where it first stands, with the times of its latest element."""
        if found.rows < 2:
            return found
        keys = [[found.columns[name]] for name in (SUBJECT, PREDICATE, OBJECT)]
        codes = key_codes(keys, self.static.terms.dictionary)[0]
        if not scan.times.names:
            return found.take(first_rows(codes))
        deciding = scan.times.available or scan.times.valid
        assert deciding is not None
        column = found.columns[deciding]
        latest = np.where(column.present, column.values, np.iinfo(np.int64).min)
        order = np.lexsort((-np.arange(found.rows), latest, codes))
        last = np.append(codes[order][1:] != codes[order][:-1], True)
        return found.take(np.sort(order[last]))

    def _annotated(self, scan: TypeScan, tables: Sequence[TripleRows]) -> Iterable[Pairs]:
        """What the annotation of the rows says: ``every UAV`` makes each subject a UAV."""
        dictionary = self.static.terms.dictionary
        by_sort: dict[int, list[NDArray[np.int32]]] = {}
        for table in tables:
            if table.sort is not None:
                by_sort.setdefault(table.sort, []).append(table.subject)
        # By name: ids depend on how the input was cut.
        for sort, parts in sorted(by_sort.items(), key=lambda item: str(dictionary.term(item[0]))):
            subjects = ids_in_order(parts, len(dictionary))
            for name in sorted(self.static.supersorts(sort)):
                term = NamedNode(name)
                if isinstance(scan.sort, Const) and scan.sort.term != term:
                    continue
                objects = np.full(len(subjects), dictionary.transient_id(term), np.int32)
                yield ObjectColumn(Kind.TERM, subjects), ObjectColumn(Kind.TERM, objects)


class EmptyWindows(WindowSource):
    """The leaves of a plan over windows that hold nothing: the static side alone."""

    def tables(self, graph: str) -> Sequence[TripleRows]:
        return ()

    def ready(self, plan: Plan) -> None:
        return None


def distinct_ids(parts: Sequence[NDArray[np.int32]], size: int) -> NDArray[np.int32]:
    """The distinct ids below ``size`` in ``parts``, ascending: O(ids + size), no sort."""
    seen = np.zeros(size, np.bool_)
    for part in parts:
        seen[part] = True
    return np.flatnonzero(seen).astype(np.int32)


def ids_in_order(parts: Sequence[NDArray[np.int32]], size: int) -> NDArray[np.int32]:
    """The distinct ids below ``size`` in ``parts``, as they are met: O(ids), no sort.

    What others see the order of is ordered so: by id it would depend on what was forgotten when.
    """
    ids = np.concatenate(parts)
    rows = np.arange(len(ids), dtype=np.int32)
    place = np.empty(size, np.int32)
    place[ids[::-1]] = rows[::-1]
    once: NDArray[np.int32] = ids[place[ids] == rows]
    return once


def distinct_pairs(pairs: Pairs, terms: TermValues) -> Pairs:
    """Each (subject, object) once, where it first stands."""
    if len(pairs[0]) < 2:
        return pairs
    rows = first_rows(key_codes([[pairs[0]], [pairs[1]]], terms.dictionary)[0])
    return pairs[0].take(rows), pairs[1].take(rows)


def _joined(parts: Sequence[Pairs], terms: TermValues) -> Pairs:
    kept = [part for part in parts if len(part[0])]
    if not kept:
        return _nothing(), _nothing()
    dictionary = terms.dictionary
    subjects = concatenate([part[0] for part in kept], dictionary)
    return subjects, concatenate([part[1] for part in kept], dictionary)


def _nothing() -> ObjectColumn:
    return ObjectColumn(Kind.TERM, np.full(0, NO_TERM, np.int32))


def _constant(id: int, rows: int) -> ObjectColumn:
    return ObjectColumn(Kind.TERM, np.full(rows, id, np.int32))


def _column(part: Relation, name: str) -> ObjectColumn:
    """A column of a part; times of what has none are null."""
    found = part.columns.get(name)
    if found is not None:
        return found
    nothing = np.zeros(part.rows, np.int64)
    return ObjectColumn(Kind.INTEGER, nothing, np.ones(part.rows, np.bool_))
