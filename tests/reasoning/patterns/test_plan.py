"""What a plan is refused for, how it prints, and what its times imply."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dyknow.reasoning.patterns.plans.network import (
    INFINITE,
    ContradictoryTimes,
    UnboundedRetention,
    minimal_network,
)
from dyknow.reasoning.patterns.plans.plan import (
    OWN,
    Aggregate,
    Arithmetic,
    Between,
    Bound,
    Column,
    ColumnType,
    Condition,
    Constant,
    CountProbe,
    Element,
    EqualHulls,
    Function,
    Listed,
    Output,
    PatternPlan,
    PlanError,
    Point,
    Position,
    Same,
    Selection,
    StateProbe,
    Time,
    Trend,
    Value,
)
from dyknow.reasoning.patterns.plans.printer import print_network, print_plan

S = 10**9
COLUMNS = (Column("tag", ColumnType.KEY), Column("price", ColumnType.NUMBER))
A, B, C = (Element(name, (name.upper(),)) for name in "abc")


def sequence(*elements: Element, within: int | None = 10 * S, **more: object) -> PatternPlan:
    """``SEQ(…)`` with one tag."""
    steps = range(len(elements) - 1)
    between = tuple(Between(Point(i), Point(i + 1, is_start=True), 1) for i in steps)
    same = tuple(Same(i, "tag", i + 1, "tag") for i in steps)
    return PatternPlan(COLUMNS, elements, between, same, within=within, **more)


def test_a_plan_prints():
    a = replace(A, conditions=(Condition(">", Value(OWN, "price"), Constant(5)),), is_kleene=True)
    mean = Aggregate(Function.AVG, 0, "price", is_before=True)
    hidden = CountProbe(
        Element("n", ("D", "E")),
        Bound(Point(0), 1),
        Bound(Point(1, is_start=True), -1),
        same=(Same(OWN, "tag", 0, "tag"),),
        conditions=(Condition("<", Value(OWN, "price"), Value(1, "price")),),
    )
    state = StateProbe(
        Element("p", ("P",)), Bound(Point(1)), (), (Condition("=", Value(OWN, "tag"), Constant(7)),)
    )
    plan = sequence(
        a,
        B,
        conditions=(
            Condition(">", Value(0, "price"), Value(0, "price", Position.PREVIOUS)),
            Condition(">=", Value(0, "price"), Arithmetic("*", mean, Constant(1.5))),
        ),
        probes=(hidden, state),
        selection=Selection.NEXT_MATCH,
        hulls=(EqualHulls((0,), (1,)),),
        outputs=(Output("prices", Listed(0, "price")), Output("start", Time((0, 1), True))),
    )
    assert print_plan(plan).splitlines() == [
        "columns tag: key, price: number",
        "event a+: A where a.price > 5",
        "event b: B",
        "time start of b - a in [1ns, oo)",
        "same a.tag = b.tag",
        "where a[i].price > a[i-1].price",
        "where a[i].price >= (avg(a[..i-1].price) * 1.5)",
        "hull(a) = hull(b)",
        "probe number of (n: D | E) at [a + 1ns, start of b - 1ns], n.tag = a.tag,"
        " n.price < b.price in [0, 0]",
        "probe last (p: P) up to b: p.tag = 7",
        "select skip_till_next_match",
        "within 10s",
        "rows are instants, distinct",
        "return a[].price as prices",
        "return start(a, b) as start",
    ]


def test_a_network_prints():
    assert print_network(minimal_network(sequence(A, B, C))).splitlines() == [
        "b - a in [1ns, 9999999999ns]",
        "c - a in [2ns, 10s]",
        "c - b in [1ns, 9999999999ns]",
        "a is kept for 10s",
        "b is kept for 9999999999ns",
        "c is kept for 0ns",
        "c comes last: a by a.tag = c.tag; b by b.tag = a.tag",
    ]


def test_every_event_may_come_last_without_order():
    network = minimal_network(sequence(A, B, C))
    assert network.triggers() == (2,)
    assert network.triggers(is_ordered=False) == (0, 1, 2)


def test_the_join_follows_shared_variables_and_narrow_windows():
    plan = PatternPlan(
        COLUMNS,
        (A, B, C, Element("d", ("D",))),
        (
            Between(Point(0), Point(1), 0, 9 * S),
            Between(Point(1), Point(2), 0, 5 * S),
            Between(Point(2), Point(3), 0, 1 * S),
        ),
        (Same(0, "tag", 3, "tag"),),
    )
    order = minimal_network(plan).join_order(3)
    assert [each.element for each in order] == [0, 2, 1]
    assert order[0].keys == (Same(0, "tag", 3, "tag"),)
    assert order[1].keys == ()


def test_a_cycle_of_three_names_its_events():
    plan = PatternPlan(
        COLUMNS,
        (A, B, C, Element("d", ("D",))),
        (
            Between(Point(0), Point(1), 5, 9),
            Between(Point(1), Point(2), 5, 9),
            Between(Point(0), Point(2), 0, 9),
            Between(Point(0), Point(3), 0, 9),
        ),
    )
    with pytest.raises(ContradictoryTimes, match="the times of a, b and c contradict") as error:
        minimal_network(plan)
    assert error.value.elements == (0, 1, 2)


def test_an_event_that_is_before_itself():
    plan = PatternPlan(COLUMNS, (A, B), (Between(Point(0), Point(0), 1, 9),))
    with pytest.raises(ContradictoryTimes, match="the times of a contradict themselves"):
        minimal_network(plan)


def test_a_pattern_without_an_end_is_refused():
    network = minimal_network(sequence(A, B, C, within=None))
    with pytest.raises(UnboundedRetention, match="each a would be kept for ever") as error:
        _ = network.retention
    assert error.value.elements == (0,)
    assert "WITHIN" in error.value.hint


def test_a_probe_of_an_unbounded_interval_is_refused():
    counted = CountProbe(
        Element("n", ("D",)), Bound(Point(0, is_start=True)), Bound(Point(0)), same=()
    )
    plan = PatternPlan(COLUMNS, (A,), probes=(counted,), has_intervals=True)
    with pytest.raises(UnboundedRetention, match="rows of n would be kept for ever"):
        minimal_network(plan).probe_retention(counted)


def test_probes_keep_rows_until_the_last_is_answered():
    early = CountProbe(Element("n", ("D",)), Bound(Point(0), -3), Bound(Point(0), -1))
    late = CountProbe(Element("m", ("D",)), Bound(Point(1), 1), Bound(Point(1), 20))
    plan = PatternPlan(COLUMNS, (A, B), (Between(Point(0), Point(1), 1, 10),), probes=(early, late))
    network = minimal_network(plan)
    assert network.probe_retention(early) == 10 + 20 + 3
    assert network.probe_retention(late) == 20 - 1


def test_unlimited_times_stay_unlimited():
    network = minimal_network(sequence(A, B, within=None))
    assert network.greatest[0][1] == INFINITE
    assert network.greatest[1][0] == -1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"elements": ()}, "a pattern has no event"),
        ({"elements": (A,) * 17}, "a pattern has 17 events"),
        ({"elements": (A, replace(B, is_kleene=True))}, r"b\+ has exponentially many matches"),
        ({"within": -1}, "cannot last less than nothing"),
        ({"within": INFINITE}, "is longer than 36 years"),
        ({"selection": Selection.PARTITION_CONTIGUITY}, "has no partition"),
        ({"same": (Same(0, "price", 1, "tag"),)}, "the column price is no key"),
        ({"same": (Same(0, "id", 1, "tag"),)}, "there is no column id; the columns are tag, price"),
        ({"same": (Same(0, "tag", 2, "tag"),)}, "there is no event 2 here"),
        ({"conditions": (Condition("~", Constant(1), Constant(1)),)}, "~ is no comparison"),
        (
            {"conditions": (Condition("=", Value(0, "tag", Position.LAST), Constant(1)),)},
            "a is one event",
        ),
        (
            {"outputs": (Output("n", Aggregate(Function.COUNT, 0, None)),)},
            "a is one event",
        ),
        (
            {"probes": (CountProbe(replace(A, is_kleene=True), Bound(Point(0)), Bound(Point(1))),)},
            "counted, and not taken again",
        ),
        (
            {
                "probes": (
                    CountProbe(
                        A, Bound(Point(0)), Bound(Point(1)), same=(Same(0, "tag", 1, "tag"),)
                    ),
                )
            },
            "a key of a must equal one of an event",
        ),
        ({"trends": (Trend("n", Function.COUNT, 5, "tag"),)}, "there is no event 5"),
    ],
)
def test_refusals(change: dict[str, object], message: str):
    with pytest.raises(PlanError, match=message):
        minimal_network(replace(sequence(A, B), **change))
