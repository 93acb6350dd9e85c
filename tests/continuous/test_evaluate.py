"""Recorded streams through a query: order, lateness, laziness."""

from __future__ import annotations

from itertools import count, islice
from pathlib import Path

import pytest
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.evaluate import Explained, evaluate
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.terms_to_columns import from_terms

D = "http://d.example/"
X, Y = D + "x", D + "y"
WHO, P, Q = NamedNode(D + "o"), NamedNode(D + "p"), NamedNode(D + "q")


def counting(predicate: str, *streams: str) -> str:
    clauses = " ".join(f"FROM STREAM <{iri}> [RANGE 10ns STEP 10ns]" for iri in streams)
    return f"REGISTER QUERY q AS SELECT (COUNT(*) AS ?n) {clauses} WHERE {{ ?s <{predicate}> ?v }}"


def shown(windows) -> list[tuple[int, str]]:
    return [(w.end, w.solutions[0]["n"].value) for w in windows]


def test_a_collection_is_sorted_whole() -> None:
    data = [(t, WHO, P, Literal(t)) for t in (25, 1, 12, 3)]
    assert shown(evaluate(counting(D + "p", X), {X: data})) == [(10, "2"), (20, "1"), (30, "1")]


def test_an_iterator_is_read_only_as_far_as_the_next_window_needs() -> None:
    seen: list[int] = []

    def forever():
        for t in count(1):
            seen.append(t)
            yield t, WHO, P, Literal(t)

    windows = evaluate(counting(D + "p", X), {X: forever()})
    assert shown(islice(windows, 2)) == [(10, "10"), (20, "10")]
    assert len(seen) < 30


def test_late_elements_of_an_iterator_are_dropped_and_counted() -> None:
    times = [5, 30, 26, 24, 40]
    data = [(t, WHO, P, Literal(t)) for t in times]
    strict = list(evaluate(counting(D + "p", X), {X: iter(data)}))
    assert shown(strict) == [(10, "1"), (30, "1"), (40, "1")]
    assert strict[-1].late == 2
    lenient = list(evaluate(counting(D + "p", X), {X: iter(data)}, lateness=5))
    assert shown(lenient) == [(10, "1"), (30, "2"), (40, "1")]
    assert lenient[-1].late == 1


def test_late_elements_are_told_as_they_came() -> None:
    data = [(t, WHO, P, Literal(t)) for t in (5, 30, 26, 24, 40, 1)]
    late: list[object] = []
    windows = list(evaluate(counting(D + "p", X), {X: iter(data)}, lateness=5, late=late.append))
    assert late == [data[3], data[5]]
    assert windows[-1].late == 2
    list(evaluate(counting(D + "p", X), {X: data}, late=late.append))  # sorted: nothing is late
    assert len(late) == 2


def test_streams_are_merged_by_time() -> None:
    a = [(t, WHO, P, Literal(t)) for t in (1, 2, 25)]
    b = [(t, WHO, P, Literal(t)) for t in (9, 11)]
    for streams in ({X: iter(a), Y: iter(b)}, {X: a, Y: iter(b)}, {X: a, Y: b}):
        found = shown(evaluate(counting(D + "p", X, Y), streams))
        assert found == [(10, "3"), (20, "1"), (30, "1")]


@pytest.mark.parametrize("window", ["RANGE 10ns STEP 5ns", "TRIPLES 3 STEP 2"])
@pytest.mark.parametrize("size", [1, 3, 1000])
def test_where_a_collection_is_cut_changes_nothing(
    size: int, window: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dyknow.continuous.evaluate._CHUNK", size)
    a = [(t // 2, WHO, (P, Q)[t % 2], Literal(t % 3)) for t in range(1, 40)]
    b = [(t, WHO, P, NamedNode(f"{D}{t % 4}")) for t in (25, 7, 7, 31)]
    query = (
        f"SELECT ?v (COUNT(*) AS ?n) FROM STREAM <{X}> [{window}] FROM STREAM <{Y}> [{window}] "
        "WHERE { ?s ?p ?v } GROUP BY ?v"
    )
    ordered = sorted(b, key=lambda item: item[0])

    def windows(streams):
        return [
            (w.end, sorted(map(str, w.solutions)))  # type: ignore[arg-type]
            for w in evaluate(query, streams)
        ]

    assert windows({X: a, Y: b}) == windows({X: iter(a), Y: iter(ordered)})


def test_columns_are_taken_as_they_are() -> None:
    dictionary = TermDictionary()
    a = from_terms([(t, WHO, P, Literal(t)) for t in (12, 1)], dictionary)
    b = from_terms([(3, WHO, P, Literal(1.5))], TermDictionary())
    found = shown(evaluate(counting(D + "p", X, Y), {X: a, Y: b}))
    assert found == [(10, "2"), (20, "1")]


def test_static_files_origin_and_forms(tmp_path) -> None:
    path = tmp_path / "kb.ttl"
    path.write_text(f"<{WHO.value}> a <{D}Thing> .")
    head = f"FROM STREAM <{X}> [RANGE 10ns STEP 10ns] WHERE {{ ?s a <{D}Thing> ; <{D}p> ?v }}"
    data = [(1, WHO, P, Literal(7)), (1, Q, P, Literal(8))]
    (built,) = evaluate(
        f"REGISTER STREAM q AS CONSTRUCT {{ ?s <{Q.value}> ?v }} {head}",
        {X: data},
        static=[path],
        origin=3,
    )
    assert (built.end, built.solutions) == (3, [(WHO, Q, Literal(7))])
    (asked,) = evaluate(f"REGISTER QUERY q AS ASK {head}", {X: data}, static=[path])
    assert asked.solutions is True


def test_streams_must_be_those_that_the_query_reads():
    with pytest.raises(
        ValueError, match=r"does not read <http://d.example/y>; .* reads <http://d.example/x>"
    ):
        evaluate(counting(D + "p", X), {Y: []})


@pytest.mark.parametrize("wrong", [{"bounds": "x"}, {"semantics": "x"}])
def test_options_are_checked(wrong):
    with pytest.raises(ValueError, match="'x'"):
        evaluate(counting(D + "p", X), {X: []}, **wrong)


@pytest.mark.parametrize(
    "element",
    [
        ("2021-10-07T19:12:53Z", WHO, P, Literal(1)),
        (1, "dyknow:uav1", P, Literal(1)),
        (1, WHO, P, 1),
        (1, WHO, P),
        "a",
    ],
)
@pytest.mark.parametrize("kind", [list, iter])
def test_what_is_no_timed_triple_is_refused(element, kind):
    with pytest.raises(TypeError, match="a timed triple is"):
        list(evaluate(counting(D + "p", X), {X: kind([element])}))


@pytest.mark.parametrize("modifier", ["", "LIMIT 1"])
def test_the_pattern_of_a_short_construct_is_its_template(modifier) -> None:
    query = f"REGISTER QUERY q AS CONSTRUCT WHERE {{ ?s {P} ?v }} {modifier}"
    (window,) = evaluate(
        f"{query} WINDOW [RANGE 9ns STEP 9ns]",
        {X: [(1, WHO, P, Literal(5)), (2, WHO, Q, Literal(6))]},
    )
    assert window.solutions == [(WHO, P, Literal(5))]


def test_what_operators_cost_is_told_when_it_is_asked_for() -> None:
    ticks = count(0, 1000)
    explained = Explained(lambda: next(ticks))
    data = [(t, WHO, P, Literal(t)) for t in (1, 2, 12)]
    body = f"SELECT ?v FROM STREAM <{X}> [RANGE 10ns STEP 10ns] WHERE {{ ?s <{D}p> ?v }}"
    windows = evaluate(f"{body} ORDER BY ?v", {X: data}, explained=explained)
    assert [w.end for w in windows] == [10, 20]
    text = str(explained)
    table = text.partition("\ncosts a window")[2].splitlines()
    # Two triples from 1 ns to 12 ns, before the last: 1.8 of them in a window of 10 ns.
    assert table[1].startswith(f"  {X}: 181,818,182 samples a second of 1 subject")
    (order,) = (line.split() for line in table if "Order by" in line)
    assert order[4:6] == ["1.8", "12"]
    assert order[7:10] == ["1.5", "2", "µs"]


def test_what_operators_may_cost_is_told_before_anything_has_come() -> None:
    explained = Explained(lambda: 0, {X: 20})
    text = f"SELECT ?v FROM STREAM <{X}> [RANGE 10s STEP 10s] WHERE {{ ?s <{D}p> ?v }}"
    evaluate(text, {X: []}, explained=explained)
    assert f"{X}: 20 samples a second of 100 subjects (the subjects are assumed)" in str(explained)
    assert "measured" not in str(explained)
    scan = [line.split() for line in str(explained).splitlines() if " Scan " in line][-1]
    assert scan[4] == "200"


def test_graphs_are_given_by_name(tmp_path) -> None:
    one, two = tmp_path / "one.ttl", tmp_path / "two.ttl"
    one.write_text(f"<{WHO.value}> <{D}is> 1 .")
    two.write_text(f"<{WHO.value}> <{D}is> 2 .")
    static = {D + "g1": one, D + "g2": two}
    head = f"SELECT ?a ?b FROM <{D}g1> FROM NAMED <{D}g2>"
    window = f"FROM STREAM <{X}> [RANGE 10ns STEP 10ns]"
    body = f"WHERE {{ ?s <{D}p> ?v ; <{D}is> ?a GRAPH <{D}g2> {{ ?s <{D}is> ?b }} }}"
    data = [(1, WHO, P, Literal(7))]
    (found,) = evaluate(f"{head} {window} {body}", {X: data}, static=static)
    assert found.solutions == [{"a": Literal(1), "b": Literal(2)}]
    with pytest.raises(ValueError, match=r"names the graph <http://d\.example/g1>"):
        evaluate(f"{head} {window} {body}", {X: data}, static={D + "g2": two})
    with pytest.raises(ValueError, match="no graph with a name"):
        evaluate(f"{head} {window} {body}", {X: data}, static=[one])


def test_named_windows_over_one_stream_and_what_is_new() -> None:
    data = [(t, WHO, P, Literal(t)) for t in range(1, 7)]
    text = (
        f"REGISTER ISTREAM <{D}out> AS SELECT ?a ?b "
        f"FROM NAMED WINDOW <{D}w1> ON <{X}> [RANGE PT0.000000002S STEP PT0.000000002S] "
        f"FROM NAMED WINDOW <{D}w2> ON <{X}> [ELEMENTS 1] "
        f"WHERE {{ WINDOW <{D}w1> {{ ?s <{D}p> ?a }} WINDOW <{D}w2> {{ ?s <{D}p> ?b }} }}"
    )
    found = list(evaluate(text, {X: data}))
    rows = [[(r["a"].value, r["b"].value) for r in w.solutions] for w in found]
    assert rows[:3] == [
        [("1", "2"), ("2", "2")],
        [("3", "4"), ("4", "4")],
        [("5", "6"), ("6", "6")],
    ]


def test_what_is_absent_is_told_where_windows_close_anyway() -> None:
    data = [(1, WHO, P, Literal(1)), (35, WHO, P, Literal(1))]
    found = evaluate(counting(D + "p", X), {X: data}, report="close")
    assert shown(found) == [(10, "1"), (20, "0"), (30, "0"), (40, "1")]


@pytest.mark.parametrize("semantics", ["bag", "set"])
def test_an_aggregate_over_a_named_window_is_folded(semantics, tmp_path) -> None:
    path = tmp_path / "static.ttl"
    path.write_text(f"<{WHO.value}> <{D}p> 100 .")
    data = [(t, WHO, P, Literal(v)) for t, v in ((1, 2), (2, 2), (3, 5), (14, 7))]
    text = (
        f"SELECT ?s (SUM(?v) AS ?n) FROM NAMED WINDOW <{D}w> ON <{X}> [RANGE 10ns STEP 10ns] "
        f"WHERE {{ WINDOW <{D}w> {{ ?s <{D}p> ?v }} }} GROUP BY ?s"
    )
    explained = Explained(lambda: 0)
    found = list(evaluate(text, {X: data}, static=[path], semantics=semantics, explained=explained))
    # Nothing static is in a window with a name.
    assert shown(found) == [(10, "9" if semantics == "bag" else "7"), (20, "7")]
    assert "in columns, incrementally" in str(explained)


def test_the_schema_of_static_files_holds_of_stream_triples(tmp_path: Path) -> None:
    schema = tmp_path / "schema.ttl"
    schema.write_text(
        f"""@prefix d: <{D}> . @prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
        d:gs rdfs:subPropertyOf d:groundSpeed . d:groundSpeed rdfs:subPropertyOf d:speed .
        d:speed rdfs:domain d:Mover . d:Mover rdfs:subClassOf d:Thing .""",
        encoding="utf-8",
    )
    uav, stream = NamedNode(D + "uav1"), D + "s"
    text = f"""REGISTER QUERY q AS PREFIX d: <{D}> SELECT ?o ?v
        FROM STREAM <{stream}> [RANGE 1s STEP 1s] WHERE {{ ?o a d:Thing . ?o d:speed ?v }}"""
    said = [(10**9, uav, NamedNode(D + "gs"), Literal(5))]
    (window,) = evaluate(text, {stream: said}, static=[schema])
    assert window.solutions == [{"o": uav, "v": Literal(5)}]
    assert not next(iter(evaluate(text, {stream: said}))).solutions


@pytest.mark.parametrize("report", ["non-empty", "change", "close"])
def test_the_last_departure_is_told_under_every_report(report) -> None:
    """What leaves with the last content, after all inputs have ended."""
    data = [(1, NamedNode(D + "a"), NamedNode(D + "p"), Literal(1))]
    ends = {}
    for operator in ("ISTREAM", "DSTREAM"):
        query = (
            f"REGISTER QUERY q AS SELECT {operator} ?v FROM STREAM <{X}> [RANGE 2ns STEP 1ns] "
            f"WHERE {{ ?o <{D}p> ?v }}"
        )
        found = evaluate(query, {X: data}, report=report)
        ends[operator] = [window.end for window in found if len(window.solutions)]
    assert ends == {"ISTREAM": [1], "DSTREAM": [3]}
