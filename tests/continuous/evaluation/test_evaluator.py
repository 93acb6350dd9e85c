"""Windows, watermarks, reports, heads and what goes to Oxigraph."""

from __future__ import annotations

import numpy as np
import pytest
from pyoxigraph import Literal, NamedNode, Quad, Store, Variable

from dyknow.continuous.algebra.options import Options
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.operators.background import Background
from dyknow.languages.csparql import bind, parse_query
from dyknow.ontology.units import Conversion
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW, RDF_TYPE, RDFS, XSD
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows

S = 10**9
X, Y = DYKNOW + "x.trdf", DYKNOW + "y.trdf"
FROM_X = f"FROM STREAM <{X}> [RANGE 5s STEP 1s]"
SPEED, ALTITUDE = NamedNode(DYKNOW + "speed"), NamedNode(DYKNOW + "altitude")
UAV, RMAX = NamedNode(DYKNOW + "UAV"), NamedNode(DYKNOW + "RMAX")
ONE, TWO = NamedNode(DYKNOW + "uav1"), NamedNode(DYKNOW + "uav2")


class Run:
    """An evaluator with its dictionary, fed with plain tuples."""

    def __init__(self, body: str, inputs=(X,), options=None, background=None) -> None:
        self.dictionary = TermDictionary()
        text = f"PREFIX dyknow: <{DYKNOW}> PREFIX xsd: <{XSD}> REGISTER QUERY q AS {body}"
        self.evaluator = ContinuousEvaluator(
            parse_query(text), self.dictionary, background or Background(), inputs, options
        )

    def push(self, *rows, input=X) -> None:
        self.evaluator.push(input, from_terms(rows, self.dictionary))

    def rows(self, results) -> list:
        return [(r.end, r.solutions.rows()) for r in results]


def average(options=None, **more) -> Run:
    return Run(
        f"SELECT ?o (AVG(?v) AS ?a) {FROM_X} WHERE {{ ?o dyknow:speed ?v }} GROUP BY ?o",
        options=options,
        **more,
    )


def test_a_window_closes_when_the_watermark_has_passed_its_end() -> None:
    run = average()
    run.push((1 * S, ONE, SPEED, Literal(2.0)))
    assert run.evaluator.next_end() == 1 * S
    assert run.evaluator.advance(X, 1 * S) == []
    (result,) = run.evaluator.advance(X, 1 * S + 1)
    assert (result.start, result.end) == (-4 * S, 1 * S)
    assert run.evaluator.next_end() == 2 * S


def test_a_window_is_open_at_its_start_and_closed_at_its_end() -> None:
    run = average()
    run.push((0, ONE, SPEED, Literal(2.0)), (5 * S, ONE, SPEED, Literal(4.0)))
    values = [row[0]["a"].value for _, row in run.rows(run.evaluator.end(X))]
    assert values == ["2"] * 5 + ["4"] * 5


def test_the_other_bounds_take_the_start_and_leave_the_end() -> None:
    run = average(Options(bounds="[)"))
    run.push((0, ONE, SPEED, Literal(2.0)), (5 * S, ONE, SPEED, Literal(4.0)))
    found = run.rows(run.evaluator.end(X))
    assert [end // S for end, _ in found] == list(range(1, 11))
    assert [row[0]["a"].value for _, row in found] == ["2"] * 5 + ["4"] * 5


def test_a_long_gap_is_skipped_not_stepped_through() -> None:
    run = average()
    run.push((0, ONE, SPEED, Literal(2.0)), (10**9 * S, ONE, SPEED, Literal(4.0)))
    ends = [r.end // S for r in run.evaluator.end(X)]
    assert ends == [0, 1, 2, 3, 4, *(10**9 + k for k in range(5))]


def test_windows_without_content_give_no_result() -> None:
    body = "SELECT (COUNT(*) AS ?n) FROM STREAM <%s> [RANGE 1s STEP 5s] WHERE {?o dyknow:speed ?v}"
    run = Run(body % X)
    run.push((2 * S, ONE, SPEED, Literal(1)), (10 * S, ONE, ALTITUDE, Literal(1)))
    assert run.rows(run.evaluator.end(X)) == [(10 * S, [{"n": Literal(0)}])]


def test_rows_behind_the_watermark_are_dropped_and_counted() -> None:
    run = average()
    run.push((3 * S, ONE, SPEED, Literal(2.0)))
    run.evaluator.advance(X, 3 * S)
    run.push((2 * S, ONE, SPEED, Literal(9.0)))
    assert run.evaluator.late == 1
    assert run.rows(run.evaluator.end(X))[0][1][0]["a"] == Literal(2.0)


def test_rows_without_a_triple_are_no_content() -> None:
    run = average()
    times = np.array([S], np.int64)
    column = ObjectColumn(Kind.DOUBLE, np.zeros(1), np.ones(1, np.bool_))
    ids = np.array([run.dictionary.id(ONE)], np.int32)
    rows = TripleRows(times, times, ids, {run.dictionary.id(SPEED): column})
    run.evaluator.push(X, TimedTriples(run.dictionary, (rows,)))
    assert run.evaluator.end(X) == []


def test_an_input_that_has_not_begun_holds_the_others_back() -> None:
    run = average(inputs=(X, Y))
    run.push((1 * S, ONE, SPEED, Literal(2.0)))
    assert run.evaluator.advance(X, 9 * S) == []
    assert [r.end // S for r in run.evaluator.advance(Y, 4 * S)] == [1, 2, 3]
    assert [r.end // S for r in run.evaluator.end(Y)] == [4, 5]


def test_an_input_that_ends_without_a_word_holds_nobody_back() -> None:
    run = average(inputs=(X, Y))
    run.push((1 * S, ONE, SPEED, Literal(2.0)))
    assert run.evaluator.advance(X, 3 * S) == []
    assert [r.end // S for r in run.evaluator.end(Y)] == [1, 2]


def test_an_input_that_goes_on_has_the_windows_that_closed_meanwhile() -> None:
    run = average(Options(report="close"))
    run.push((S, ONE, SPEED, Literal(2.0)))
    run.evaluator.end(X)
    assert run.evaluator.advance(X, 9 * S + 1) == []
    run.evaluator.resume(X)
    assert [r.end // S for r in run.evaluator.advance(X, 9 * S + 1)] == [6, 7, 8, 9]


def test_each_stream_has_its_own_window() -> None:
    run = Run(
        f"SELECT ?o ?v ?w FROM STREAM <{X}> [RANGE 1s STEP 1s] FROM STREAM <{Y}> "
        "[RANGE 10s STEP 2s] WHERE { ?o dyknow:speed ?v . ?o dyknow:altitude ?w }",
        inputs=(X, Y),
    )
    run.push((1 * S, ONE, ALTITUDE, Literal(7)), input=Y)
    run.push((2 * S, ONE, SPEED, Literal(1)), (3 * S, ONE, SPEED, Literal(2)))
    found = run.rows([*run.evaluator.end(X), *run.evaluator.end(Y)])
    # y's window that ends at 2 s is the latest one also at 3 s.
    assert [(end // S, len(rows)) for end, rows in found][:3] == [(2, 1), (3, 1), (4, 0)]


def test_a_query_without_any_window_is_refused() -> None:
    with pytest.raises(ValueError, match="no window"):
        Run("SELECT ?o WHERE { ?o dyknow:speed ?v }")


def test_sorts_of_rows_count_as_types_with_their_supersorts() -> None:
    store = Store()
    store.add(Quad(RMAX, NamedNode(RDFS + "subClassOf"), UAV))
    body = f"SELECT ?o (AVG(?v) AS ?a) {FROM_X} WHERE {{ ?o a dyknow:UAV; dyknow:speed ?v }} "
    run = Run(body + "GROUP BY ?o", background=Background(store))
    for sort, subject in ((RMAX, ONE), (None, TWO)):
        (table,) = from_terms([(S, subject, SPEED, Literal(3.0))], run.dictionary).tables
        id = None if sort is None else run.dictionary.id(sort)
        rows = TripleRows(table.time, table.valid, table.subject, table.objects, sort=id)
        run.evaluator.push(X, TimedTriples(run.dictionary, (rows,)))
    assert {row[0]["o"] for _, row in run.rows(run.evaluator.end(X))} == {ONE}


def test_numbers_of_a_sub_feature_are_in_the_unit_of_the_feature() -> None:
    """However a column holds them; what is no number stays what it is."""
    store, knots = Store(), NamedNode(DYKNOW + "knots")
    store.add(Quad(knots, NamedNode(RDFS + "subPropertyOf"), SPEED))
    background = Background(store, conversion=lambda source, target: Conversion(2.0))
    run = Run(f"SELECT ?v {FROM_X} WHERE {{ ?o dyknow:speed ?v }}", background=background)
    decimal, double = NamedNode(XSD + "decimal"), NamedNode(XSD + "double")
    mixed = [Literal(1), Literal("1.50", datatype=decimal), Literal(2.5), Literal("fast")]
    run.push(*((S, ONE, knots, value) for value in mixed))
    rows = run.rows(run.evaluator.end(X))[0][1]
    expected = {
        Literal("2", datatype=double),
        Literal("3", datatype=decimal),
        Literal("5", datatype=double),
        Literal("fast"),
    }
    assert {row["v"] for row in rows} == expected
    (plain,) = from_terms([(S, ONE, knots, Literal(1))], run.dictionary).tables
    ids = np.array([run.dictionary.id(value) for value in (mixed[0], mixed[1])], np.int32)
    two = plain.take(np.array([0, 0]))
    objects = {run.dictionary.id(knots): ObjectColumn(Kind.TERM, ids)}
    rows = TripleRows(two.time, two.valid, two.subject, objects)
    found = TimedTriples(run.dictionary, tuple(run.evaluator._windows.entailment.of([rows])))
    assert {o.value for *_, o in found} == {"2", "3"}


def test_a_change_of_the_static_side_is_seen_by_its_version() -> None:
    store, version = Store(), [0]
    body = f"SELECT ?o (AVG(?v) AS ?a) {FROM_X} WHERE {{ ?o a dyknow:UAV; dyknow:speed ?v }} "
    run = Run(body + "GROUP BY ?o", background=Background(store, lambda: version[0]))
    run.push((S, ONE, SPEED, Literal(1.0)))
    assert run.rows(run.evaluator.advance(X, S + 1)) == [(S, [])]
    store.add(Quad(ONE, RDF_TYPE, UAV))
    version[0] = 1
    assert len(run.rows(run.evaluator.advance(X, 2 * S + 1))[0][1]) == 1


def test_duplicates_count_in_a_bag_and_not_in_a_set() -> None:
    rows = [(S, ONE, SPEED, Literal(1.0))] * 2 + [(S, ONE, SPEED, Literal(4.0))]
    for semantics, value in (("bag", "2"), ("set", "2.5")):
        run = average(Options(semantics))
        run.push(*rows)
        assert run.rows(run.evaluator.end(X))[0][1][0]["a"].value == value


def test_an_average_of_integers_is_a_decimal_and_a_sum_stays_exact() -> None:
    run = Run(f"SELECT (AVG(?v) AS ?a) (SUM(?v) AS ?s) {FROM_X} WHERE {{ ?o dyknow:speed ?v }}")
    run.push((S, ONE, SPEED, Literal(2**62)), (S, TWO, SPEED, Literal(2**62 + 1)))
    row = run.rows(run.evaluator.end(X))[0][1][0]
    assert row["s"] == Literal(str(2**63 + 1), datatype=NamedNode(XSD + "integer"))
    assert row["a"].datatype.value == XSD + "decimal"


def test_a_value_that_is_no_number_makes_a_sum_an_error() -> None:
    run = average()
    run.push((S, ONE, SPEED, Literal(2.0)), (S, ONE, SPEED, Literal("fast")))
    assert run.rows(run.evaluator.end(X))[0][1] == [{"o": ONE}]


def test_kinds_that_columns_cannot_compare_go_to_oxigraph_for_that_window() -> None:
    run = Run(
        f"SELECT ?o {FROM_X} WHERE {{ ?o dyknow:speed ?v FILTER(?v < '2020-01-02'^^xsd:date) }}"
    )
    run.push((S, ONE, SPEED, Literal("2020-01-01", datatype=NamedNode(XSD + "date"))))
    assert run.rows(run.evaluator.end(X))[0][1] == [{"o": ONE}]


def test_what_the_plan_cannot_say_goes_to_oxigraph_and_explain_says_so() -> None:
    store = Store()
    store.add(Quad(ONE, ALTITUDE, Literal(9)))
    body = (
        f"DESCRIBE ?o {FROM_X} WHERE {{ ?o dyknow:speed ?v OPTIONAL {{ ?o dyknow:altitude ?w }} }}"
    )
    run = Run(body, background=Background(store))
    assert "on Oxigraph, a fresh store a window, because of the form DESCRIBE" in (
        run.evaluator.explain()
    )
    run.push((S, ONE, SPEED, Literal(2.0)), (S, TWO, SPEED, Literal(2.0)))
    described = [(s, p) for _, s, p, _ in run.evaluator.end(X)[0].triples]
    assert sorted(described, key=str) == [(ONE, ALTITUDE), (ONE, SPEED), (TWO, SPEED)]


def test_construct_gives_a_graph_at_the_end_of_the_window() -> None:
    run = Run(
        f"CONSTRUCT {{ ?o dyknow:seen true . ?v dyknow:of ?o }} {FROM_X} "
        "WHERE { ?o dyknow:speed ?v }"
    )
    run.push((S, ONE, SPEED, Literal(2.0)), (S, ONE, SPEED, Literal(3.0)))
    (result, *_) = run.evaluator.end(X)
    seen = NamedNode(DYKNOW + "seen")
    assert list(result.triples) == [(S, ONE, seen, Literal(True))]


def test_a_construct_about_each_group_gives_wide_rows() -> None:
    run = Run(
        f"CONSTRUCT {{ ?o dyknow:speed ?a ; dyknow:count ?n }} {FROM_X} WHERE {{ "
        "{ SELECT ?o (AVG(?v) AS ?a) (COUNT(*) AS ?n) WHERE { ?o dyknow:speed ?v } GROUP BY ?o } }"
    )
    run.push((S, ONE, SPEED, Literal(2.0)), (S, TWO, SPEED, Literal(3.0)))
    (table,) = run.evaluator.end(X)[0].triples.tables
    assert (len(table), len(table.objects)) == (2, 2)


def test_subjects_that_left_the_window_are_forgotten() -> None:
    run = average()
    subjects = [NamedNode(f"{DYKNOW}o{i}") for i in range(9000)]
    for second in range(90):
        those = subjects[100 * second : 100 * (second + 1)]
        run.push(*((second * S, o, SPEED, Literal(2.0)) for o in (ONE, *those)))
        results = run.evaluator.advance(X, second * S + 1)
        count = 1 + 100 * min(second + 1, 5)
        assert [len(r.solutions) for r in results] == [count]
    incremental = run.evaluator._solver.execution.incremental
    assert incremental is not None
    assert incremental.groups.used < 1200
    assert len(incremental.groups.members) < 5000


def test_a_variable_that_the_query_assigns_is_not_bound() -> None:
    text = (
        f"PREFIX dyknow: <{DYKNOW}> REGISTER QUERY q AS SELECT ?w {FROM_X} "
        "WHERE { ?o dyknow:speed ?v BIND (1 AS ?w) }"
    )
    with pytest.raises(ValueError, match="assigns"):
        bind(parse_query(text), {Variable("w"): Literal(2)})


@pytest.mark.parametrize("window", ["RANGE 4ns STEP 4ns", "TRIPLES 3 STEP 1"])
def test_groups_stand_in_one_order_however_the_input_is_cut(window: str) -> None:
    """A predicate of the query got its id between two pushes, or after one: then the groups of
    ?p stood in another order."""
    first, second, asked = (NamedNode(DYKNOW + name) for name in ("z", "b", "k"))
    rows = [(1, ONE, first, Literal(1)), *((5, ONE, p, Literal(2)) for p in (second, asked, first))]
    orders = []
    for cut in (0, 1):
        run = Run(
            f"SELECT ?p (COUNT(*) AS ?n) FROM STREAM <{X}> [{window}] "
            "WHERE { ?s dyknow:k ?w . ?t ?p ?v } GROUP BY ?p"
        )
        for part in (rows[:cut], rows[cut:]):
            run.push(*part)
        result = run.evaluator.end(X)[-1]
        orders.append([row["p"] for row in result.solutions.rows()])
    assert orders[0] == orders[1] == [second, asked, first]
