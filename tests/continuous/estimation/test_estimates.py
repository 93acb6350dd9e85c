"""Estimates against numbers computed by hand."""

from __future__ import annotations

import pytest
from pyoxigraph import Literal, NamedNode, Quad, Store

from dyknow.continuous.algebra.expressions import Call, Const, Var
from dyknow.continuous.algebra.options import Options
from dyknow.continuous.algebra.plan import (
    START,
    STOP,
    Aggregate,
    Aggregation,
    Closure,
    Distinct,
    Filter,
    Join,
    LeftJoin,
    Minus,
    Plan,
    Project,
    Scan,
    Slice,
    TypeScan,
    Union,
    Values,
)
from dyknow.continuous.columns.relation import TermValues
from dyknow.continuous.estimation.cardinality import Sizes, passing
from dyknow.continuous.estimation.estimates import COST, Way, estimate
from dyknow.continuous.estimation.input_rates import Flow, PredicateRate, Traffic
from dyknow.continuous.estimation.pattern_sizes import Known, Size
from dyknow.continuous.evaluation.evaluator import ContinuousEvaluator
from dyknow.continuous.incremental.aggregate_shape import Shape, shape_of
from dyknow.continuous.operators.background import Background
from dyknow.continuous.operators.sources import StaticSide
from dyknow.continuous.windows.grid import schedule
from dyknow.languages.csparql import parse_query
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import RDF_TYPE
from dyknow.rdf.terms_to_columns import from_terms

D = "http://d.example/"
X = D + "x"
SPEED, LIMIT, KIND = (NamedNode(D + name) for name in ("speed", "limit", "kind"))
SECOND = 10**9
WINDOW = "[RANGE 5s STEP 1s]"


def thing(i: int) -> NamedNode:
    return NamedNode(f"{D}o{i}")


def known(flow: Flow | None = None, window: str = WINDOW, *, distinct: bool = False) -> Known:
    """Fifty limits, ten kinds of five each; of stream ``X`` what is given."""
    store = Store()
    for i in range(50):
        store.add(Quad(thing(i), LIMIT, Literal(i)))
        store.add(Quad(thing(i), KIND, NamedNode(f"{D}k{i % 10}")))
    query = parse_query(f"SELECT * FROM STREAM <{X}> {window} WHERE {{ ?s ?p ?o }}")
    static = StaticSide(Background(store), TermValues(TermDictionary()))
    flows = {} if flow is None else {X: flow}
    return Known(schedule(query, [X], Options()), static, flows, distinct)


def rows(plan: Plan, data: Known | None = None) -> float:
    return Sizes(data or known()).of(plan).rows


S, V, L, K = Var("o"), Var("v"), Var("l"), Var("k")
SPEEDS, LIMITS, KINDS = Scan(S, SPEED, V), Scan(S, LIMIT, L), Scan(S, KIND, K)


def test_where_nothing_is_known_a_thousand_samples_a_second_of_a_hundred_subjects() -> None:
    size = Sizes(known()).of(SPEEDS)
    assert size == Size(5000.0, {"o": 100.0, "v": 10.0})


def test_a_rate_is_multiplied_with_the_length_of_the_window() -> None:
    assert rows(SPEEDS, known(Flow(20))) == 100
    assert rows(SPEEDS, known(Flow(20), "[RANGE 1m STEP 1s]")) == 1200
    assert rows(SPEEDS, known(Flow(20), "[TRIPLES 7]")) == 7
    assert rows(SPEEDS, known(Flow(20), "[LANDMARK STEP 1s]")) == 20 * 3600
    assert rows(SPEEDS, known(Flow(20, seconds=9.0), "[LANDMARK STEP 1s]")) == 180


def test_what_is_counted_by_predicate_is_of_that_predicate() -> None:
    flow = Flow(30, 4, {SPEED.value: PredicateRate(20, 4), KIND.value: PredicateRate(10, 2, 5)})
    assert rows(SPEEDS, known(flow)) == 100
    assert rows(Scan(thing_at(0), SPEED, V), known(flow)) == 25
    # What the static side has comes to it.
    assert rows(KINDS, known(flow)) == 50 + 50
    assert rows(LIMITS, known(flow)) == 50
    # Under set semantics no more than all pairs.
    assert rows(KINDS, known(flow, distinct=True)) == 50 + 10


def test_a_pattern_that_the_static_side_has_is_not_the_one_the_stream_is_for() -> None:
    assert rows(LIMITS) == 50
    assert rows(Scan(S, KIND, Const(NamedNode(D + "k3")))) == 5
    assert rows(TypeScan(S, Const(NamedNode(D + "Car")))) == 100


def thing_at(i: int) -> Const:
    return Const(thing(i))


def test_joins() -> None:
    # 5000 · 50 / max(100, 50)
    assert rows(Join((SPEEDS, LIMITS))) == 2500
    # Then 2500 · 50 / max(50, 50)
    assert rows(Join((SPEEDS, LIMITS, KINDS))) == 2500
    # Nothing shared: each with each.
    assert rows(Join((LIMITS, Scan(Var("other"), KIND, K)))) == 2500
    assert rows(Join(())) == 1
    # 50 kinds, ten of them different, with themselves: 50 · 50 / 10
    assert rows(Join((KINDS, Scan(Var("other"), KIND, K)))) == 250


def test_optional_union_minus() -> None:
    few = Values(("o",), tuple((thing(i),) for i in range(10)))
    assert rows(LeftJoin(LIMITS, few, None)) == 50
    assert rows(LeftJoin(few, KINDS, None)) == 10
    assert rows(Union((LIMITS, few))) == 60
    assert rows(Minus(LIMITS, few)) == 40
    assert rows(Minus(few, LIMITS)) == 0
    assert rows(Minus(LIMITS, Scan(Var("other"), KIND, K))) == 50


def test_groups_distinct_and_slices() -> None:
    count = (Aggregation("n", "COUNT", None),)
    assert rows(Aggregate(("k",), count, KINDS, implicit=False)) == 10
    assert rows(Aggregate(("o", "k"), count, KINDS, implicit=False)) == 50
    assert rows(Aggregate((), count, KINDS, implicit=True)) == 1
    assert rows(Distinct(Project(("k",), KINDS))) == 10
    assert rows(Slice(45, 20, KINDS)) == 5
    assert rows(Slice(60, None, KINDS)) == 0


def test_closures() -> None:
    step = Scan(Var(START), KIND, Var(STOP))
    a, b = Var("a"), Var("b")
    assert rows(Closure(a, b, step, zero=False, more=True)) == 100
    assert rows(Closure(a, b, step, zero=True, more=False)) == 50 + 60
    assert rows(Closure(thing_at(1), b, step, zero=False, more=True)) == 2


@pytest.mark.parametrize(
    ("condition", "share"),
    [
        (Call("=", (K, Const(NamedNode(D + "k1")))), 1 / 10),
        (Call("!=", (K, Const(NamedNode(D + "k1")))), 9 / 10),
        (Call("=", (S, K)), 1 / 50),
        (Call("=", (Call("STR", (S,)), Const(Literal("a")))), 1 / 10),
        (Call("<", (K, Const(Literal(1)))), 1 / 3),
        (Call("!", (Call("<", (K, Const(Literal(1)))),)), 2 / 3),
        (Call("REGEX", (K, Const(Literal("a")))), 1 / 2),
        (Call("&&", (Call("<", (K, K)), Call("<", (K, K)))), 1 / 9),
        (Call("||", (Call("<", (K, K)), Call("<", (K, K)))), 5 / 9),
        (Const(Literal(value=False)), 0),
    ],
)
def test_selectivities(condition, share) -> None:
    assert passing(condition, Sizes(known()).of(KINDS)) == pytest.approx(share)
    assert rows(Filter(condition, KINDS)) == pytest.approx(50 * share)


def test_times_are_a_constant_and_one_a_row() -> None:
    plan = Filter(Call("<", (L, Const(Literal(9)))), LIMITS)
    found = estimate(plan, known())
    call, row = COST["Filter"]
    assert found[id(plan)].nanoseconds == pytest.approx(call + row * (50 + 50 / 3))
    assert found[id(plan)].way is Way.COLUMNS


def test_what_a_compiled_loop_does_has_no_time_of_its_own() -> None:
    plan = Join((SPEEDS, LIMITS))
    found = estimate(plan, known(), served=[plan])
    call, row = COST["COMPILED"]
    assert found[id(plan)].nanoseconds == pytest.approx(call + row * (5000 + 50 + 2500))
    assert (found[id(SPEEDS)].rows, found[id(SPEEDS)].nanoseconds) == (5000, 0)
    assert found[id(SPEEDS)].way is Way.WITHIN


def test_what_is_folded_are_the_rows_of_a_step() -> None:
    scan = Scan(S, SPEED, V)
    inner = Filter(Call(">", (V, Const(Literal(1)))), scan)
    plan = Aggregate(("o",), (Aggregation("a", "AVG", V),), inner, implicit=False)
    data = known()
    shape = shape_of(plan, data.static)
    assert isinstance(shape, Shape)
    found = estimate(plan, data, shape)
    assert (found[id(scan)].rows, found[id(scan)].way) == (1000, Way.FOLDED)
    assert (found[id(plan)].rows, found[id(plan)].way) == (100, Way.INCREMENTAL)
    assert found[id(inner)].rows is None
    call, row = COST["INCREMENTAL"]
    assert found[id(plan)].nanoseconds == pytest.approx(call + row * 100)


def test_traffic_is_counted_by_predicate() -> None:
    traffic, dictionary = Traffic(), TermDictionary()
    for second in range(5):
        data = [
            (second * SECOND, thing(i), predicate, value)
            for i in range(4)
            for predicate, value in ((SPEED, Literal(1.5)), (KIND, thing(9)), (RDF_TYPE, thing(8)))
            if predicate != KIND or i < 2
        ]
        assert (traffic.flow() is None) == (second < 2)
        traffic.add(from_terms(data, dictionary))
    flow = traffic.flow()
    assert flow is not None
    assert (flow.rate, flow.subjects, flow.seconds) == (10.0, 4, 4.0)
    assert flow.predicates == {
        SPEED.value: PredicateRate(4.0, 4),
        KIND.value: PredicateRate(2.0, 2, 1),
        RDF_TYPE.value: PredicateRate(4.0, 4, 1),
    }
    assert str(flow) == "10 samples a second of 4 subjects"


def test_a_flow_says_what_of_it_is_assumed() -> None:
    assert str(Flow()) == "1,000 samples a second of 100 subjects (assumed)"
    assert str(Flow(2.5)) == "2.5 samples a second of 100 subjects (the subjects are assumed)"
    assert str(Flow(None, 7)) == "1,000 samples a second (assumed) of 7 subjects"


def test_the_table_fits_a_terminal() -> None:
    long = " + ".join(["?v"] * 60)
    text = (
        f"SELECT (SUM({long}) AS ?n) FROM STREAM <{X}> {WINDOW} WHERE {{ ?o <{SPEED.value}> ?v }}"
    )
    evaluator = ContinuousEvaluator(parse_query(text), TermDictionary(), Background(), [X])
    table = evaluator.explain().partition("\ncosts ")[2].partition("\n  together")[0]
    assert "…" in table
    assert max(map(len, table.splitlines())) <= 100
