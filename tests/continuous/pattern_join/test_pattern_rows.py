"""Rows that joins of patterns keep: chains stay short, and nothing depends on the cut."""

from __future__ import annotations

import numpy as np
import pytest
from pyoxigraph import Literal, NamedNode, Store

from dyknow.continuous.algebra.options import Options
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.continuous.pattern_join.row_kernels import (
    BY_OBJECT,
    BY_SUBJECT,
    BY_TRIPLE,
    HIGH,
    LINKS,
    LOW,
    PLACE,
    SUBJECT,
    WAYS,
)
from dyknow.continuous.pattern_join.window_rows import PatternRows
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import XSD
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows
from dyknow.streams.jit import JIT

D = "http://d.example/"
X, Y = D + "x", D + "y"
COUNT = 3_000

if not JIT:
    pytest.skip("without compiled loops columns keep the rows", allow_module_level=True)


def node(name: str) -> NamedNode:
    return NamedNode(D + name)


P, Q, UAV = node("p"), node("q"), node("UAV")


def evaluator(query: str, dictionary: TermDictionary, inputs=(X,), **options) -> tuple:
    made = ContinuousEvaluator(
        parse_query(query), dictionary, Background(Store()), list(inputs), Options(**options)
    )
    return made, made._solver.execution.patterns.rows


def rows_of(dictionary, times, subjects, columns, sort=None) -> TimedTriples:
    times, subjects = np.asarray(times, np.int64), np.asarray(subjects, np.int32)
    return TimedTriples(dictionary, (TripleRows(times, times, subjects, columns, sort),))


KEYS = {
    BY_SUBJECT: [PLACE, SUBJECT],
    BY_OBJECT: [PLACE, LOW, HIGH],
    BY_TRIPLE: [PLACE, SUBJECT, LOW, HIGH],
}
"""What rows of a chain that belong together agree in: the place has the slot, and the kind."""


def longest(rows: PatternRows) -> int:
    """How many different things share a bucket at most."""
    table = rows.rows[: rows.count]
    most = 0
    for way, key in KEYS.items():
        start = rows.sizes[WAYS + way]
        for head in rows.heads[start : start + rows.sizes[way]]:
            met, at = set(), head
            while at >= 0:
                met.add(tuple(table[at, key].tolist()))
                at = table[at, LINKS + way]
            most = max(most, len(met))
    return most


NUMBERS = {
    "ids beside those of subjects": lambda d: d.ids(node(f"o{i}") for i in range(COUNT)),
    "small integers": lambda d: np.arange(COUNT),
    "nanoseconds": lambda d: 1_700_000_000 * 10**9 + np.arange(COUNT) * 10**6,
    "doubles": lambda d: np.arange(COUNT) * 0.5,
}


@pytest.mark.parametrize("name", NUMBERS)
def test_triples_that_count_once_are_found_in_a_few_steps(name: str) -> None:
    dictionary = TermDictionary()
    query = f"SELECT ?a FROM STREAM <{X}> [RANGE 9s STEP 9s] WHERE {{ ?a {P} ?b }}"
    made, rows = evaluator(query, dictionary, semantics="set")
    subjects = dictionary.ids(node(f"s{i}") for i in range(COUNT))
    values = NUMBERS[name](dictionary)
    kinds = {np.dtype(np.int32): Kind.TERM, np.dtype(np.int64): Kind.INTEGER}
    column = ObjectColumn(kinds.get(values.dtype, Kind.DOUBLE), values)
    made.push(X, rows_of(dictionary, np.ones(COUNT), subjects, {dictionary.id(P): column}))
    (result,) = made.end(X)
    assert len(result.solutions) == COUNT
    assert longest(rows) <= 12


def test_facts_of_sorts_are_found_in_a_few_steps() -> None:
    dictionary = TermDictionary()
    query = f"SELECT ?a FROM STREAM <{X}> [RANGE 9s STEP 9s] WHERE {{ ?a a {UAV} . ?a {P} ?b }}"
    made, rows = evaluator(query, dictionary)
    subjects = dictionary.ids(node(f"s{i}") for i in range(COUNT))
    columns = {dictionary.id(P): ObjectColumn(Kind.INTEGER, np.arange(COUNT))}
    made.push(X, rows_of(dictionary, np.ones(COUNT), subjects, columns, sort=dictionary.id(UAV)))
    (result,) = made.end(X)
    assert len(result.solutions) == COUNT
    assert longest(rows) <= 12


def test_a_predicate_that_begins_late_has_short_chains() -> None:
    dictionary = TermDictionary()
    query = f"SELECT ?a FROM STREAM <{X}> [RANGE 9s STEP 1s] WHERE {{ ?a {P} ?b . ?b {Q} ?c }}"
    made, rows = evaluator(query, dictionary)
    nodes = dictionary.ids(node(f"s{i}") for i in range(COUNT))
    column = {name: {dictionary.id(name): ObjectColumn(Kind.TERM, nodes)} for name in (P, Q)}
    for second, name in enumerate((P, P, Q), 1):
        times = np.full(COUNT, second * 10**9 - 1)
        made.push(X, rows_of(dictionary, times, nodes, column[name]))
        made.advance(X, second * 10**9 + 1)
        assert longest(rows) <= 12


def test_a_slot_of_a_short_window_looks_no_further_than_that() -> None:
    # The long window keeps its rows, so those that have left the short one stay between them.
    dictionary = TermDictionary()
    windows = f"FROM STREAM <{X}> [RANGE 3600s STEP 1s] FROM STREAM <{Y}> [RANGE 1s STEP 1s]"
    query = f"SELECT ?b {windows} WHERE {{ ?a {P} ?b . ?a {Q} ?c }}"
    made, rows = evaluator(query, dictionary, (X, Y))
    many = [(1, node(f"s{i}"), P, Literal(i)) for i in range(1_000)]
    made.push(X, from_terms(many, dictionary))
    for second in range(1, 50):
        said = [(second * 10**9, node("s1"), Q, Literal(i)) for i in range(10)]
        made.push(Y, from_terms(said, dictionary))
        made.advance(X, second * 10**9 + 1)
        assert [len(r.solutions) for r in made.advance(Y, second * 10**9 + 1)] == [10]
    (slot,) = (number for one, number in rows.slots.items() if one.predicate == Q)
    assert rows.count - rows.floors[slot] <= 10


def test_what_waited_is_let_go() -> None:
    dictionary = TermDictionary()
    query = f"SELECT ?a FROM STREAM <{X}> [RANGE 1s STEP 1s] WHERE {{ ?a {P} ?b }}"
    made, rows = evaluator(query, dictionary)
    for second, count in ((1, 100_000), (2, 1), (3, 1)):
        values = ObjectColumn(Kind.INTEGER, np.arange(count))
        times, subjects = np.full(count, second * 10**9), np.zeros(count)
        dictionary.id(node("a"))
        made.push(X, rows_of(dictionary, times, subjects, {dictionary.id(P): values}))
        made.advance(X, second * 10**9 + 1)
    assert sum(part.nbytes for part in rows._pending) < 100_000
    assert rows.rows.nbytes < 100_000


def test_rows_of_a_sort_are_kept_only_where_somebody_asks_for_it() -> None:
    dictionary = TermDictionary()
    query = f"SELECT ?a FROM STREAM <{X}> [RANGE 9s STEP 1s] WHERE {{ ?a {P} ?b }}"
    made, rows = evaluator(query, dictionary)
    values = {dictionary.id(P): ObjectColumn(Kind.INTEGER, np.arange(10))}
    sort = dictionary.id(UAV)
    made.push(X, rows_of(dictionary, np.ones(10), np.full(10, sort), values, sort))
    made.advance(X, 10**9 + 1)
    assert rows.count == 10


@pytest.mark.parametrize("head", ["(SAMPLE(?a) AS ?n)", "(GROUP_CONCAT(STR(?a)) AS ?n)"])
def test_facts_of_sorts_of_one_moment_stand_by_their_streams(head: str) -> None:
    windows = f"FROM STREAM <{X}> [RANGE 2s STEP 2s] FROM STREAM <{Y}> [RANGE 2s STEP 2s]"
    query = f"SELECT {head} {windows} WHERE {{ ?a a {UAV} }}"
    found = []
    for order in ((X, Y), (Y, X)):
        dictionary = TermDictionary()
        subjects = {X: dictionary.id(node("a")), Y: dictionary.id(node("b"))}
        sort = dictionary.id(UAV)
        made, _ = evaluator(query, dictionary, (X, Y))
        for name in order:
            column = {dictionary.id(P): ObjectColumn(Kind.INTEGER, np.array([1]))}
            made.push(name, rows_of(dictionary, [5], [subjects[name]], column, sort))
        found.append([r.solutions.rows() for name in (X, Y) for r in made.end(name)])
    assert found[0] == found[1]


def test_another_spelling_stands_where_its_value_does_however_it_came() -> None:
    query = (
        f"SELECT (GROUP_CONCAT(STR(?a)) AS ?n) FROM STREAM <{X}> [RANGE 9s STEP 9s]"
        f" WHERE {{ ?a {P} ?x . ?a {P} ?y }}"
    )
    found = []
    for cuts in ([2], [1, 1]):
        dictionary = TermDictionary()
        a, b = dictionary.id(node("a")), dictionary.id(node("b"))
        odd = dictionary.id(Literal("2.50", datatype=NamedNode(XSD + "decimal")))
        made, _ = evaluator(query, dictionary)
        times = np.array([10**9, 2 * 10**9], np.int64)
        numbers = ObjectColumn(Kind.DECIMAL, np.array([2.5, 3.5]))
        spelled = ObjectColumn(Kind.TERM, np.full(2, odd, np.int32))
        tables = [
            TripleRows(times, times, np.full(2, subject, np.int32), {dictionary.id(P): column})
            for subject, column in ((a, numbers), (b, spelled))
        ]
        for count in cuts:
            made.push(X, TimedTriples(dictionary, tuple(tables[:count])))
            del tables[:count]
        found.append([r.solutions.rows() for r in made.end(X)])
    assert found[0] == found[1]
