"""Result forms: make a table, triples or a boolean of solutions, in columns ([Events14 §V.A])."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, assert_never

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import BlankNode, NamedNode

from ...languages.object_cache import ObjectCache
from ...rdf.dictionary import Ids
from ...rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows, split_term
from ...streams.sample import Times
from ..algebra.expressions import Const, Var
from ..algebra.plan import Ask, Blank, Construct, Head, Select, TemplatePosition
from ..columns.relation import (
    Relation,
    TermValues,
    concatenate,
    first_rows,
    key_codes,
)
from ..values.literals import Sort
from .results import ResultBatch, Solutions, WindowResult

END: Final = "\0end"
"""The variable with the number of a row's window: 0, 1, 2 … in order of their ends. It is in the
solutions of several windows only (`evaluation.bulk_execution`)."""

_NODE: Final = int(Sort.NODE)
"""An array is compared with an integer five times as fast as with a member of an enumeration."""


def finish(head: Head, relation: Relation, start: int, end: int, terms: TermValues) -> WindowResult:
    """Return the result of the window ``start`` … ``end`` with these solutions."""
    match head:
        case Select(variables):
            columns = {name: relation.columns[name] for name in variables}
            solutions = Solutions(variables, columns, terms.dictionary, relation.rows)
            return WindowResult(start, end, solutions=solutions)
        case Ask():
            return WindowResult(start, end, answer=relation.rows > 0)
        case Construct():
            return WindowResult(start, end, triples=construct(head, relation, end, terms))
        case _:
            assert_never(head)


def finish_batch(
    head: Select | Construct,
    relation: Relation,
    windows: NDArray[np.int64],
    spans: Sequence[tuple[int, int]],
    terms: TermValues,
) -> ResultBatch:
    """Return the results of the windows with these ``spans``; row i of ``relation`` belongs to
    window ``windows[i]``, in ascending order."""
    starts, ends = zip(*spans, strict=True)
    if isinstance(head, Construct):
        times = np.array(ends, np.int64)[windows]
        return ResultBatch(starts, ends, triples=construct(head, relation, times, terms))
    columns = {name: relation.columns[name] for name in head.variables}
    solutions = Solutions(head.variables, columns, terms.dictionary, relation.rows)
    offsets = np.searchsorted(windows, np.arange(len(ends) + 1)).tolist()
    return ResultBatch(starts, ends, solutions=solutions, offsets=offsets)


def head_variables(head: Head) -> frozenset[str]:
    """Return the variables that the head uses."""
    match head:
        case Select(variables):
            return frozenset(variables)
        case Construct(template):
            places = (place for triple in template for place in triple)
            return frozenset(place.name for place in places if isinstance(place, Var))
        case Ask():
            return frozenset()
        case _:
            assert_never(head)


def construct(
    head: Construct, relation: Relation, time: int | Times, terms: TermValues
) -> TimedTriples:
    """Return the template's triples for all solutions, at τ = ``time`` (of each solution, in order,
    or of all). They are a graph: each triple occurs once at one τ.

    Ill-formed triples (an unbound variable, a literal as subject, no IRI as predicate) are omitted.
    A template about one subject gives wide rows if each solution has its own subject.
    """
    if not relation.rows:
        return TimedTriples(terms.dictionary, ())
    times = np.full(relation.rows, time, np.int64) if isinstance(time, int) else time
    wide = _wide(head, relation, times, terms)
    if wide is not None:
        return TimedTriples(terms.dictionary, (wide,) if len(wide) else ())
    found = instantiated(head, relation, times, terms)
    tables = []
    for id, parts in found.items():
        subject_ids = np.concatenate([part.subjects for part in parts])
        times_of = np.concatenate([times[part.rows] for part in parts])
        column = concatenate([part.objects for part in parts], terms.dictionary)
        if len(subject_ids) > 1 and (len(parts) > 1 or not parts[0].unique):
            keys = [[ObjectColumn(Kind.TERM, subject_ids)], [column]]
            if not isinstance(time, int):
                keys.append([ObjectColumn(Kind.INTEGER, times_of)])
            rows = first_rows(key_codes(keys, terms.dictionary)[0])
            rows = rows[np.argsort(times_of[rows], kind="stable")]
            subject_ids, column, times_of = subject_ids[rows], column.take(rows), times_of[rows]
        tables.append(TripleRows(times_of, times_of, subject_ids, {id: column}))
    return TimedTriples(terms.dictionary, tuple(table for table in tables if len(table)))


@dataclass(frozen=True, slots=True, eq=False)
class Instantiated:
    """The well-formed triples of one template triple and one predicate: the solutions (``rows``),
    subjects and objects. ``unique``: no two of them are equal."""

    rows: NDArray[np.int64]
    subjects: Ids
    objects: ObjectColumn
    unique: bool


def instantiated(
    head: Construct, relation: Relation, times: Times, terms: TermValues
) -> dict[int, list[Instantiated]]:
    """Return the well-formed triples of all solutions, by the id of the predicate."""
    found: dict[int, list[Instantiated]] = {}
    for template in head.template:
        subjects, objects = (_position(template[i], relation, times, terms) for i in (0, 2))
        if subjects is None or objects is None:
            continue
        keep = _nodes(subjects, terms) & objects.present
        named = {p.name for p in template if isinstance(p, Var)}
        unique = relation.key is not None and relation.key <= named | {END}
        if isinstance(template[1], Const):
            if isinstance(template[1].term, NamedNode):
                rows, id = np.flatnonzero(keep), terms.dictionary.transient_id(template[1].term)
                whole = ObjectColumn(objects.kind, objects.values[rows])
                part = Instantiated(rows, subjects.values[rows], whole, unique)
                found.setdefault(id, []).append(part)
            continue
        predicates = _position(template[1], relation, times, terms)
        if predicates is None:
            continue
        rows = np.flatnonzero(keep & _iris(predicates, terms))
        subjects, predicates, objects = (c.take(rows) for c in (subjects, predicates, objects))
        objects = ObjectColumn(objects.kind, objects.values)
        for id in predicates.values[first_rows(predicates.values)].tolist():
            at = np.flatnonzero(predicates.values == id)
            part = Instantiated(rows[at], subjects.values[at], objects.take(at), unique)
            found.setdefault(id, []).append(part)
    return found


def _wide(
    head: Construct, relation: Relation, times: Times, terms: TermValues
) -> TripleRows | None:
    """Return rows with all the template's objects, if each solution has its own subject."""
    subject = _only_subject(head)
    if subject is None or relation.key is None or relation.key - {END} != {subject}:
        return None
    column = relation.columns.get(subject)
    if column is None:
        return None
    keep = _nodes(column, terms)
    objects: dict[int, ObjectColumn] = {}
    for _, predicate, object in head.template:
        assert isinstance(predicate, Const)
        values = _position(object, relation, times, terms)
        if values is not None and isinstance(predicate.term, NamedNode):
            objects[terms.dictionary.transient_id(predicate.term)] = values
    if all(values.null is not None for values in objects.values()):
        keep &= np.any([values.present for values in objects.values()], axis=0)
    if np.count_nonzero(keep) == len(keep):
        return TripleRows(times, times, column.values, objects)
    objects = {id: each.take(keep) for id, each in objects.items()}
    return TripleRows(times[keep], times[keep], column.values[keep], objects)


@ObjectCache
def _only_subject(head: Construct) -> str | None:
    """Return the variable that is the subject of all triples of the template, if each has a
    constant predicate of its own; else None."""
    subjects = {subject for subject, _, _ in head.template}
    predicates = {predicate for _, predicate, _ in head.template}
    if len(subjects) != 1 or len(predicates) != len(head.template):
        return None
    subject = next(iter(subjects))
    named = all(isinstance(predicate, Const) for predicate in predicates)
    return subject.name if named and isinstance(subject, Var) else None


def _position(
    position: TemplatePosition, relation: Relation, times: Times, terms: TermValues
) -> ObjectColumn | None:
    if isinstance(position, Var):
        return relation.columns.get(position.name)
    if isinstance(position, Blank):
        # One node per solution. Its name contains the row, not a counter: it must not depend on
        # how the input is cut.
        nodes = (
            BlankNode(f"{position.label}t{time}r{row}".replace("-", "m"))
            for row, time in enumerate(times.tolist())
        )
        return ObjectColumn(Kind.TERM, terms.dictionary.transient_ids(nodes))
    kind, value = split_term(position.term, terms.dictionary.transient_id)
    return ObjectColumn(kind, np.full(relation.rows, value, kind.dtype))


def _nodes(column: ObjectColumn, terms: TermValues) -> NDArray[np.bool_]:
    """Whether a term may be a subject: an IRI or a blank node."""
    if column.kind is not Kind.TERM:
        return np.zeros(len(column), np.bool_)
    nodes = terms.sorts(column.values) == _NODE
    return nodes if column.null is None else np.asarray(nodes & ~column.null)


def _iris(column: ObjectColumn, terms: TermValues) -> NDArray[np.bool_]:
    keep = _nodes(column, terms)
    for id in np.unique(column.values[keep]).tolist():
        if not isinstance(terms.dictionary.term(id), NamedNode):
            keep &= column.values != id
    return keep
