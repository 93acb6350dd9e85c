"""What is drawn is drawn again the same: windows may be computed again after a restart (P6)."""

import os
import subprocess
import sys

import pytest
from pyoxigraph import BlankNode, Literal, NamedNode

import dyknow

S = "urn:s"
HEAD = f"FROM STREAM <{S}> [RANGE 2s STEP 1s]"
TRIPLES = [
    (second * 10**9, NamedNode(f"urn:o{n}"), NamedNode("urn:p"), Literal(n))
    for second in range(1, 5)
    for n in range(3)
]


def windows(query):
    found = dyknow.evaluate(query, streams={S: TRIPLES})
    return [(window.end, window.solutions) for window in found]


@pytest.mark.parametrize("call", ["RAND()", "UUID()", "STRUUID()", 'CONCAT("x", STRUUID())'])
def test_each_row_and_window_has_another_value_and_each_time_the_same(call):
    query = f"SELECT ?o ({call} AS ?x) {HEAD} WHERE {{ ?o <urn:p> ?v }}"
    found = windows(query)
    assert found == windows(query)
    values = [row["x"] for _, rows in found for row in rows]
    assert len(set(values)) == len(values) > 10


def test_two_calls_of_a_row_and_two_queries_draw_apart():
    first = windows(f"SELECT ?o (RAND() AS ?x) (RAND() AS ?y) {HEAD} WHERE {{ ?o <urn:p> ?v }}")
    other = windows(f"SELECT ?o (RAND() AS ?z) {HEAD} WHERE {{ ?o <urn:p> ?v }}")
    values = [row["x"] for _, rows in first for row in rows]
    values += [row["y"] for _, rows in first for row in rows]
    values += [row["z"] for _, rows in other for row in rows]
    assert len(set(values)) == len(values)
    assert all(0 <= float(each.value) < 1 for each in values)
    assert 0.3 < sum(float(each.value) for each in values) / len(values) < 0.7


@pytest.mark.parametrize("call", ["UUID()", "BNODE()"])
@pytest.mark.parametrize(
    "other",
    [
        "FROM STREAM <urn:s> [RANGE 3s STEP 1s]",
        "FROM STREAM <urn:t> [RANGE 2s STEP 1s]",
        "REGISTER QUERY q AS",
    ],
)
def test_queries_of_other_windows_streams_or_names_draw_apart(call, other):
    body = f"SELECT ?o ({call} AS ?x) {{}} WHERE {{{{ ?o <urn:p> ?v }}}}"
    query = body.format(HEAD)
    another = f"{other} {query}" if "REGISTER" in other else body.format(other)
    made = []
    for text in (query, another):
        stream = "urn:t" if "<urn:t>" in text else "urn:s"
        found = dyknow.evaluate(text, streams={stream: TRIPLES})
        made.append({row["x"] for window in found for row in window.solutions})
    assert made[0]
    assert made[0].isdisjoint(made[1])


def test_rand_in_a_filter_draws_for_each_row():
    query = f"SELECT ?o {HEAD} WHERE {{ ?o <urn:p> ?v FILTER (RAND() < 0.5) }}"
    counts = [len(rows) for _, rows in windows(query)]
    assert windows(query) == windows(query)
    assert 0 < sum(counts) < 21


def test_what_only_oxigraph_evaluates_has_no_chance():
    query = f"SELECT ?o (RAND() AS ?x) (BNODE() AS ?b) {HEAD} WHERE {{ ?o <urn:p> ?v }}"
    with pytest.raises(ValueError, match="do not go together with BNODE"):
        windows(query)


def test_blank_nodes_that_a_query_makes_are_named_by_the_window():
    query = f"SELECT ?o (BNODE() AS ?b) {HEAD} WHERE {{ ?o <urn:p> ?v }}"
    found = windows(query)
    nodes = [row["b"] for _, rows in found for row in rows]
    assert found == windows(query)
    assert all(isinstance(node, BlankNode) for node in nodes)
    assert len(set(nodes)) == len(nodes) > 10


def test_blank_nodes_of_the_stream_keep_their_names():
    node = BlankNode("mine")
    query = f"SELECT ?o ?x (BNODE() AS ?b) {HEAD} WHERE {{ ?o <urn:p> ?x }}"
    triples = [(10**9, NamedNode("urn:o"), NamedNode("urn:p"), node)]
    (window, *_) = dyknow.evaluate(query, streams={S: triples})
    (row,) = window.solutions
    assert row["x"] == node != row["b"]


def test_another_process_draws_the_same():
    query = f"SELECT ?o (RAND() AS ?x) (UUID() AS ?y) {HEAD} WHERE {{ ?o <urn:p> ?v }}"
    text = (
        "from tests.continuous.algebra.test_chance import windows\n"
        f"for _, rows in windows({query!r}):\n"
        "    print([(row['x'].value, row['y'].value) for row in rows])"
    )
    said = [
        subprocess.run(
            [sys.executable, "-c", text],
            env={**os.environ, "PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
            text=True,
        ).stdout
        for seed in ("1", "2")
    ]
    assert said[0] == said[1]
    assert len(said[0]) > 500
