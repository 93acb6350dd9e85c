"""How a plan is evaluated, and which plans are refused."""

from __future__ import annotations

from dataclasses import replace

import pytest
from pattern_data import S, batches, data, sequence

from dyknow.reasoning.patterns.evaluation.all_rows import AllRows
from dyknow.reasoning.patterns.plans.network import UnboundedRetention
from dyknow.reasoning.patterns.plans.plan import (
    OWN,
    Aggregate,
    Bound,
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
    Selection,
    Time,
    Trend,
    Value,
)
from dyknow.reasoning.patterns.recognition.choice import evaluator_of
from dyknow.reasoning.patterns.sequences.next_rows import NextRows
from dyknow.reasoning.patterns.sequences.repeated_rows import RepeatedRows
from dyknow.reasoning.patterns.sequences.trend_products import TrendProducts
from dyknow.reasoning.patterns.sequences.trend_sums import TrendSums

COUNT = (Trend("n", Function.COUNT),)
NEXT = Selection.NEXT_MATCH
RISING = Condition(">", Value(1, "v"), Value(1, "v", Position.PREVIOUS))
MEAN_BEFORE = Aggregate(Function.AVG, 1, "v", is_before=True)


@pytest.mark.parametrize(
    ("plan", "kind"),
    [
        (sequence("ABC"), AllRows),
        (sequence("ABC", selection=NEXT), NextRows),
        (sequence("AB+C", selection=Selection.PARTITION_CONTIGUITY), NextRows),
        (sequence("AB+C", selection=Selection.STRICT_CONTIGUITY), NextRows),
        (sequence("AB+C", max_matches=5), RepeatedRows),
        (sequence("AB+C", trends=COUNT), TrendProducts),
        (sequence("AB+C", trends=COUNT, conditions=(RISING,)), TrendSums),
        (replace(sequence("AB+C", trends=COUNT), has_intervals=True), TrendSums),
    ],
)
def test_the_evaluator_of_a_plan(plan: PatternPlan, kind: type) -> None:
    running = evaluator_of(plan)
    assert type(running) is kind
    assert "evaluated by" in running.explain()


def test_only_a_join_takes_rows_in_any_order() -> None:
    assert isinstance(evaluator_of(sequence("ABC"), is_ordered=False), AllRows)
    with pytest.raises(PlanError, match="only known of rows in order"):
        evaluator_of(sequence("ABC", selection=NEXT), is_ordered=False)


NEXT_KLEENE = sequence("AB+C", selection=NEXT)
TRENDS = sequence("AB+C", trends=COUNT)
ABSENT = CountProbe(
    Element("d", ("D",)),
    Bound(Point(0), 1),
    Bound(Point(2), -1),
    conditions=(Condition("<", Value(OWN, "v"), Value(1, "v")),),
)


@pytest.mark.parametrize(
    ("plan", "change", "message"),
    [
        (
            NEXT_KLEENE,
            {"conditions": (Condition("<", Value(2, "v"), Value(1, "v", Position.PREVIOUS)),)},
            r"b\[i-1\] has no place in a condition on what comes after b\[i\]",
        ),
        (
            NEXT_KLEENE,
            {"conditions": (Condition("<", Value(1, "v", Position.LAST), MEAN_BEFORE),)},
            r"b\[i-1\] has no place",
        ),
        (NEXT_KLEENE, {"probes": (ABSENT,)}, r"b has several rows; write b\[1\]"),
        (NEXT_KLEENE, {"outputs": (Output("v", Value(1, "v")),)}, "b has several rows"),
        (NEXT_KLEENE, {"outputs": (Output("v", MEAN_BEFORE),)}, "b has several rows"),
        (NEXT_KLEENE, {"outputs": (Output("v", Listed(0, "v")),)}, "a is one event"),
        (NEXT_KLEENE, {"hulls": (EqualHulls((0,), (1,)),)}, "do not last for the same time"),
        (NEXT_KLEENE, {"trends": COUNT}, "evaluated as trends"),
        (TRENDS, {"probes": (replace(ABSENT, conditions=()),)}, "know nothing of d; list"),
        (
            TRENDS,
            {"conditions": (Condition("<", Value(0, "v"), Value(2, "v")),)},
            "a condition on a and c reads others",
        ),
        (
            TRENDS,
            {"conditions": (Condition("<", Value(0, "v"), Value(1, "v")),)},
            "a condition on a and b reads others",
        ),
        (
            TRENDS,
            {"conditions": (Condition("<", Constant(0), Aggregate(Function.SUM, 1, "v")),)},
            "a condition on b reads others",
        ),
        (TRENDS, {"outputs": (Output("v", Value(0, "v")),)}, "v is no value of c"),
        (TRENDS, {"outputs": (Output("t", Time((1,))),)}, "t is no value of c"),
    ],
)
def test_refusals(plan: PatternPlan, change: dict[str, object], message: str) -> None:
    with pytest.raises(PlanError, match=message):
        evaluator_of(replace(plan, **change))


@pytest.mark.parametrize("plan", [NEXT_KLEENE, TRENDS, sequence("AB+C", max_matches=5)])
def test_a_pattern_without_an_end_is_refused(plan: PatternPlan) -> None:
    with pytest.raises(UnboundedRetention, match="each a would be kept for ever"):
        evaluator_of(replace(plan, within=None))


def test_trends_count_the_matches_that_a_search_lists() -> None:
    """COUNT(*) of each row is the number of matches listed for it."""
    rows = data(5_000, 100)
    listing = evaluator_of(sequence("AB+C", within=300 * S, max_matches=100_000))
    listed = [listing.push(part) for part in batches(rows, 500)]
    last = [end for part in listed for end in part.decided.tolist()]
    counting = evaluator_of(sequence("AB+C", within=300 * S, trends=COUNT))
    for part in batches(rows, 500):
        found = counting.push(part)
        for end, number in zip(found.decided.tolist(), found.outputs["n"].tolist(), strict=True):
            assert last.count(end) == number
    assert counting.counters.matches == len(set(last)) > 50
    assert listing.counters.cut_short == 0
