"""The compiled join of patterns, its plain twin and joins of columns give the same solutions."""

from __future__ import annotations

from collections import Counter
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode, Quad, Store

from dyknow.continuous.algebra.options import Options
from dyknow.continuous.evaluation import execution
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.continuous.pattern_join import (
    solver,
    static_rows,
    window_rows,
)
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import RDF_TYPE, RDFS, XSD
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.rdf.timed import TimedTriples, TripleRows

D = "http://d.example/"
X, Y = D + "x", D + "y"
SUB_CLASS = NamedNode(RDFS + "subClassOf")


def node(name: str) -> NamedNode:
    return NamedNode(D + name)


def number(text: str, kind: str) -> Literal:
    return Literal(text, datatype=NamedNode(XSD + kind))


NODES = [node(f"n{i}") for i in range(3)]
OBJECTS = [
    *NODES,
    BlankNode("b"),
    Literal(1),
    Literal(2),
    Literal(1.0),
    Literal(2.5),
    Literal(-3.5),
    number("1", "decimal"),
    number("2.2", "decimal"),
    # Spelled in another way, and a decimal that no float64 is.
    number("02", "int"),
    number("0.12345678901234567890", "decimal"),
    Literal("one"),
    Literal("one", language="en"),
    Literal(True),
    number("2020-01-01", "date"),
]
PREDICATES = [node("p"), node("q"), RDF_TYPE]
SORTS = [None, None, node("Sub"), node("Top")]

element = st.tuples(
    st.sampled_from([X, X, Y]),
    st.integers(1, 7),
    st.sampled_from([*NODES, *NODES, BlankNode("b")]),
    st.sampled_from([*PREDICATES[:2], *PREDICATES]),
    st.one_of(st.sampled_from(OBJECTS[:8]), st.sampled_from(OBJECTS)),
    st.sampled_from(SORTS),
)
position = st.sampled_from(["?a", "?b", "?c"])
subject = st.one_of(position, position, position, position, st.sampled_from(NODES).map(str))
constant = st.sampled_from([o for o in OBJECTS if not isinstance(o, BlankNode)]).map(str)
object = st.one_of(position, position, position, position, position, constant)
pattern = st.one_of(
    st.tuples(subject, st.sampled_from([str(node("p")), str(node("q"))]), object),
    st.tuples(subject, st.just("a"), st.one_of(position, st.sampled_from([str(node("Top"))]))),
).map(" ".join)
operand = st.one_of(position, st.sampled_from(["1", "2", "2.2", "1e0", "-4", "true", "'one'", "0"]))
arithmetic = st.one_of(
    operand, st.tuples(operand, st.sampled_from("+-*/"), operand).map(lambda t: f"({' '.join(t)})")
)
comparison = st.tuples(
    arithmetic, st.sampled_from(["=", "!=", "<", "<=", ">", ">="]), arithmetic
).map(" ".join)
condition = st.one_of(
    comparison,
    comparison,
    st.tuples(comparison, st.sampled_from(["&&", "||"]), comparison).map(
        lambda t: f"({' '.join(t)})"
    ),
    comparison.map(lambda c: f"!({c})"),
)


@st.composite
def bodies(draw) -> str:
    parts = draw(st.lists(pattern, min_size=1, max_size=3))
    names = {word for part in parts for word in part.split() if word.startswith("?")}
    filters = draw(st.lists(condition, max_size=1))
    if not names:
        filters = []
    body = " . ".join(parts) + " . " + " ".join(f"FILTER ({one})" for one in filters)
    if draw(st.booleans()):
        optional = draw(st.lists(pattern, min_size=1, max_size=2))
        body += f" OPTIONAL {{ {' . '.join(optional)} }}"
    return body


def background_store(triples) -> Store:
    store = Store()
    store.add(Quad(node("Sub"), SUB_CLASS, node("Top")))
    store.extend(Quad(s, p, o) for s, p, o in triples)
    return store


WINDOWS = f"FROM STREAM <{X}> [RANGE 4ns STEP 2ns] FROM STREAM <{Y}> [RANGE 6ns STEP 2ns]"


def solutions(
    body: str, elements: list, static: list, options: Options, windows=WINDOWS, cuts=(), told=None
) -> list:
    """The windows' ends and solutions. The elements come in as many pushes as ``cuts`` says, each
    with a watermark; at the cut ``told`` a static triple more is known."""
    query = parse_query(f"SELECT * {windows} WHERE {{ {body} }}")
    dictionary = TermDictionary()
    store = background_store(static)
    # Two versions that anybody can tell: the second has more.
    version = [0]
    known = Background(store, lambda: version[0])
    evaluator = ContinuousEvaluator(query, dictionary, known, [X, Y], options)
    results = []
    bounds = [-(10**9), *cuts, 10**9]
    for number, (low, high) in enumerate(pairwise(bounds)):
        for name in (X, Y):
            for sort in SORTS[1:]:
                rows = [
                    (t, s, p, o)
                    for i, t, s, p, o, k in elements
                    if i == name and k == sort and low < t <= high
                ]
                id = None if sort is None else dictionary.id(sort)
                tables = tuple(
                    TripleRows(table.time, table.valid, table.subject, table.objects, sort=id)
                    for table in from_terms(rows, dictionary).tables
                )
                evaluator.push(name, TimedTriples(dictionary, tables))
        if high < 10**9:
            for name in (X, Y):
                results += evaluator.advance(name, high + 1)
        if number == told:
            store.add(Quad(NODES[0], PREDICATES[0], NODES[1]))
            store.add(Quad(NODES[1], RDF_TYPE, node("Top")))
            store.add(Quad(node("Top"), SUB_CLASS, node("All")))
            version[0] += 1
    for name in (X, Y):
        results += evaluator.end(name)
    return [
        (
            result.end,
            Counter(
                tuple(sorted((k, str(v)) for k, v in row.items()))
                for row in result.solutions.rows()
            ),
        )
        for result in results
    ]


_LOOPS = (
    (window_rows, "append_pending"),
    (window_rows, "select_rows"),
    (window_rows, "pack"),
    (window_rows, "link"),
    (static_rows, "link"),
    (solver, "match"),
)


@settings(deadline=None, max_examples=200)
@given(
    bodies(),
    st.lists(element, min_size=8, max_size=30),
    st.lists(
        st.tuples(st.sampled_from(NODES), st.sampled_from(PREDICATES), st.sampled_from(OBJECTS)),
        max_size=8,
    ),
    st.sampled_from([Options("bag"), Options("set"), Options("bag", "[)", 1)]),
)
def test_three_ways_to_join_patterns_agree(body, elements, static, options) -> None:
    found = solutions(body, elements, static, options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(execution, "JIT", False)
        assert solutions(body, elements, static, options) == found
    with pytest.MonkeyPatch.context() as patch:
        for module, name in _LOOPS:
            patch.setattr(module, name, getattr(module, name).py_func)
        assert solutions(body, elements, static, options) == found


moving = st.lists(
    st.tuples(
        st.sampled_from([X, X, Y]),
        st.integers(1, 24),
        st.sampled_from(NODES),
        st.sampled_from([*PREDICATES[:2], *PREDICATES]),
        st.sampled_from(OBJECTS[:6]),
        st.sampled_from(SORTS),
    ),
    min_size=30,
    max_size=90,
)


@settings(deadline=None, max_examples=150)
@given(
    bodies(),
    moving,
    st.lists(
        st.tuples(st.sampled_from(NODES), st.sampled_from(PREDICATES), st.sampled_from(NODES)),
        max_size=4,
    ),
    st.sampled_from([Options("bag"), Options("set")]),
    st.sampled_from(
        [
            WINDOWS,
            f"FROM STREAM <{X}> [RANGE 8ns STEP 1ns] FROM STREAM <{Y}> [RANGE 8ns STEP 1ns]",
            f"FROM STREAM <{X}> [RANGE 12ns STEP 1ns] FROM STREAM <{Y}> [RANGE 3ns STEP 3ns]",
            f"FROM STREAM <{X}> [LANDMARK STEP 2ns] FROM STREAM <{Y}> [RANGE 2ns STEP 4ns]",
        ]
    ),
    st.sets(st.integers(1, 24), max_size=6).map(sorted),
    st.one_of(st.none(), st.integers(0, 3)),
    # Rows that there is room for, solutions that there is room for, and that are kept a row.
    st.sampled_from([(512, 256, 4), (1, 1, 4), (4, 2, 0)]),
)
def test_what_is_kept_of_a_window_is_what_the_next_one_has(
    body, elements, static, options, windows, cuts, told, room
) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(execution, "JIT", False)
        anew = solutions(body, elements, static, options, windows, cuts, told)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(window_rows, "_LEAST", room[0])
        patch.setattr(solver, "_FIRST_CAPACITY", room[1])
        patch.setattr(solver, "_MOST", room[2])
        assert solutions(body, elements, static, options, windows, cuts, told) == anew
        if told is None:
            assert solutions(body, elements, static, options, windows) == anew


def test_a_join_larger_than_expected_is_found_whole() -> None:
    elements = [(X, 1, NODES[0], node("p"), Literal(i), None) for i in range(40)]
    ((_, counted), *_) = solutions(
        f"?a {node('p')} ?b . ?a {node('p')} ?c", elements, [], Options()
    )
    assert sum(counted.values()) == 1600


def test_rows_that_have_left_are_forgotten() -> None:
    dictionary = TermDictionary()
    query = parse_query(
        f"SELECT * FROM STREAM <{X}> [RANGE 4ns STEP 2ns] WHERE {{ ?a {node('p')} ?b }}"
    )
    evaluator = ContinuousEvaluator(query, dictionary, Background(), [X])
    solver = evaluator._solver.execution.patterns
    if solver is None:
        pytest.skip("without compiled loops columns keep the rows")
    for time in range(1, 3000):
        evaluator.push(X, from_terms([(time, NODES[0], node("p"), NODES[1])], dictionary))
        evaluator.advance(X, time)
    assert solver.rows.count < 1000
