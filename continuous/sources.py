"""Where triples come from: the static side, encoded once a version, and the content of a window."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ..rdf.dictionary import NO_TERM
from ..rdf.namespaces import RDF_TYPE
from ..rdf.timed import Kind, ObjectColumn, TripleRows, split_term
from .background import Background
from .columns import Relation, TermValues, concatenate, first_rows, key_codes, term_column
from .expressions import Const
from .logical import Plan, Scan, TypeScan
from .relational import Pairs, pairs_of


class StaticSide:
    """The background's triples in columns: each scan made once a version of the background."""

    def __init__(self, background: Background, terms: TermValues) -> None:
        self.background = background
        self.terms = terms
        self._version: int | None = None
        self._pairs: dict[Scan | TypeScan, Pairs] = {}

    def pairs(self, scan: Scan | TypeScan) -> Pairs:
        """The static triples that ``scan`` selects, each once."""
        version = self.background.version
        if version != self._version:
            self._version, self._pairs = version, {}
        found = self._pairs.get(scan)
        if found is None:
            predicate = RDF_TYPE if isinstance(scan, TypeScan) else scan.predicate
            object = scan.sort if isinstance(scan, TypeScan) else scan.object
            rows = self.background.scan(
                scan.subject.term if isinstance(scan.subject, Const) else None,
                predicate,
                object.term if isinstance(object, Const) else None,
            )
            dictionary = self.terms.dictionary
            subjects = dictionary.ids(subject for subject, _ in rows)
            if isinstance(object, Const):
                kind, value = split_term(object.term, dictionary)
                objects = ObjectColumn(kind, np.full(len(rows), value, kind.dtype))
            else:
                objects = term_column([object for _, object in rows], dictionary)
            found = self._pairs[scan] = (ObjectColumn(Kind.TERM, subjects), objects)
        return found

    def supersorts(self, sort: int) -> frozenset[str]:
        """The sort with this id and all it is a sub-sort of."""
        term = self.terms.dictionary.term(sort)
        return (
            self.background.supersorts(term.value) if isinstance(term, NamedNode) else frozenset()
        )

    def sort_holds(self, sort: int | None, wanted: str) -> bool:
        """Whether rows annotated with ``sort`` tell that their subjects are of sort ``wanted``."""
        return sort is not None and wanted in self.supersorts(sort)


class WindowSource:
    """The leaves of a plan over the content of one window (and the static side).

    Under set semantics equal triples of the window and the static side count once. Facts of
    `TypeScan` are a set under either semantics.
    """

    def __init__(self, tables: Sequence[TripleRows], static: StaticSide, *, distinct: bool) -> None:
        self.tables = tables
        self.static = static
        self.distinct = distinct

    def ready(self, plan: Plan) -> Relation | None:
        return None

    def pairs(self, scan: Scan | TypeScan) -> Pairs:
        terms = self.static.terms
        static = self.static.pairs(scan)
        if isinstance(scan, Scan):
            predicate = terms.dictionary.find(scan.predicate)
            pairs = pairs_of(self.tables, predicate, static, terms)
            return distinct_pairs(pairs, terms) if self.distinct else pairs
        told = pairs_of(self.tables, terms.dictionary.find(RDF_TYPE), static, terms)
        return distinct_pairs(_joined([told, *self._annotated(scan)], terms), terms)

    def _annotated(self, scan: TypeScan) -> Iterable[Pairs]:
        """What the annotation of the rows says: ``every UAV`` makes each subject a UAV."""
        dictionary = self.static.terms.dictionary
        by_sort: dict[int, list[NDArray[np.int32]]] = {}
        for table in self.tables:
            if table.sort is not None:
                by_sort.setdefault(table.sort, []).append(table.subject)
        for sort, parts in sorted(by_sort.items()):
            subjects = distinct_ids(parts, len(dictionary))
            for name in sorted(self.static.supersorts(sort)):
                term = NamedNode(name)
                if isinstance(scan.sort, Const) and scan.sort.term != term:
                    continue
                objects = np.full(len(subjects), dictionary.id(term), np.int32)
                yield ObjectColumn(Kind.TERM, subjects), ObjectColumn(Kind.TERM, objects)


def distinct_ids(parts: Sequence[NDArray[np.int32]], size: int) -> NDArray[np.int32]:
    """The distinct ids below ``size`` in ``parts``, ascending: O(ids + size), no sort."""
    seen = np.zeros(size, np.bool_)
    for part in parts:
        seen[part] = True
    return np.flatnonzero(seen).astype(np.int32)


def distinct_pairs(pairs: Pairs, terms: TermValues) -> Pairs:
    """Each (subject, object) once, where it first stands."""
    if len(pairs[0]) < 2:
        return pairs
    rows = first_rows(key_codes([[pairs[0]], [pairs[1]]], terms.dictionary)[0])
    return pairs[0].take(rows), pairs[1].take(rows)


def _joined(parts: Sequence[Pairs], terms: TermValues) -> Pairs:
    kept = [part for part in parts if len(part[0])]
    if not kept:
        nothing = ObjectColumn(Kind.TERM, np.full(0, NO_TERM, np.int32))
        return nothing, nothing
    dictionary = terms.dictionary
    subjects = concatenate([part[0] for part in kept], dictionary)
    return subjects, concatenate([part[1] for part in kept], dictionary)
