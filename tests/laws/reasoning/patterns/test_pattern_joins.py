"""Matches of a plan are those of its definition, in its order, however the rows are cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pattern_cuts import check_parts, found_in, parts_of
from pattern_definition import Row, Step, matches
from pattern_drawing import PatternDrawing, rows_of

from dyknow.reasoning.patterns.evaluation.all_rows import AllRows
from dyknow.reasoning.patterns.plans.limits import Limits
from dyknow.reasoning.patterns.plans.network import ContradictoryTimes, UnboundedRetention
from dyknow.reasoning.patterns.plans.plan import PatternPlan

SEEDS = st.integers(0, 2**32)


def evaluator(plan: PatternPlan, **options: object) -> AllRows:
    try:
        return AllRows(plan, **options)
    except UnboundedRetention:
        assume(False)
        raise


def check(plan: PatternPlan, steps: list[Step], draw: Random, *, is_ordered: bool = True) -> int:
    wanted = matches(plan, steps, is_ordered=is_ordered)
    try:
        running = evaluator(plan, is_ordered=is_ordered, capacity=8)
    except ContradictoryTimes:
        assert not wanted
        return 0

    def make() -> AllRows:
        return AllRows(plan, is_ordered=is_ordered, capacity=8)

    check_parts(make, running, wanted, steps, draw)
    return len(wanted)


@settings(deadline=None, max_examples=1500)
@given(SEEDS)
def test_rows_in_order(seed: int) -> None:
    case = PatternDrawing(seed)
    steps = case.steps(case.random.randint(1, 13), case.random.choice([8, 20, 40]))
    check(case.plan, steps, case.random)


@settings(deadline=None, max_examples=800)
@given(SEEDS)
def test_rows_in_any_order(seed: int) -> None:
    """Each element may come last; nothing waits."""
    case = PatternDrawing(seed, is_ordered=False)
    steps = case.steps(case.random.randint(1, 12), case.random.choice([8, 20, 40]))
    check(case.plan, steps, case.random, is_ordered=False)


@settings(deadline=None, max_examples=80)
@given(SEEDS)
def test_rows_that_are_forgotten(seed: int) -> None:
    """Over many times the span of a match, at a small capacity."""
    case = PatternDrawing(seed, most_elements=3, is_ordered=seed % 3 > 0)
    plan = replace(case.plan, within=4)
    steps = case.steps(60, 200, objects=3)
    check(plan, steps, case.random, is_ordered=case.is_ordered)


@settings(deadline=None, max_examples=80)
@given(SEEDS, st.integers(0, 3))
def test_a_limit_of_matches(seed: int, most: int) -> None:
    """Of each row as many are made as the limit allows, and each row cut short is counted."""
    case = PatternDrawing(seed)
    plan = replace(case.plan, probes=(), max_matches=most)
    steps = [each for each in case.steps(12, 20) if isinstance(each, Row)]
    wanted = matches(plan, steps)
    try:
        running = evaluator(plan, capacity=8)
    except ContradictoryTimes:
        return
    found = [each[0] for each in found_in(running.push(rows_of(steps)))]
    rows = [each.rows for each in wanted]
    assert len(found) == len(set(found))
    assert set(found) <= set(rows)
    last = [max(each) for each in rows]
    assert sorted(map(max, found)) == sorted(
        number for number in set(last) for _ in range(min(most, last.count(number)))
    )
    assert running.counters.cut_short == sum(last.count(number) > most for number in set(last))


@settings(deadline=None, max_examples=80)
@given(SEEDS)
def test_losses_are_counted(seed: int) -> None:
    """With limits on what is kept, matches are some of those wanted; if any is missing, a counter
    says why."""
    case = PatternDrawing(seed)
    plan = replace(case.plan, probes=())
    steps = case.steps(40, 80)
    wanted = {each.rows for each in matches(plan, steps)}
    limits = Limits(case.random.choice([4, 1000]), case.random.choice([2, 1000]))
    try:
        running = evaluator(plan, capacity=8, limits=limits)
    except ContradictoryTimes:
        return
    found = set()
    for _, part in parts_of(steps, case.random):
        result = running.advance(part) if isinstance(part, int) else running.push(rows_of(part))
        found |= {each[0] for each in found_in(result)}
    assert found <= wanted
    counters = running.counters
    assert found == wanted or counters.unstored + counters.crowded > 0


def test_a_large_push_is_taken_in_parts() -> None:
    """Nothing depends on the size of a batch, nor on the capacity."""
    case = next(
        each
        for each in map(PatternDrawing, range(1000))
        if each.plan.within == 8 and each.count == 3 and each.plan.probes
    )
    rows = [each for each in case.steps(10_000, 30_000, objects=8) if isinstance(each, Row)]
    whole = found_in(AllRows(case.plan).push(rows_of(rows)))
    running = AllRows(case.plan, capacity=8)
    parts = [running.push(rows_of(rows[i : i + 7])) for i in range(0, len(rows), 7)]
    assert [each for part in parts for each in found_in(part)] == whole
    assert running.kept < 500


@pytest.mark.parametrize("seed", range(5))
def test_the_drawing_has_matches(seed: int) -> None:
    """The laws above see matches: of random cases a fair share has some."""
    rich = 0
    for each in range(60):
        case = PatternDrawing(1000 * seed + each)
        rich += bool(matches(case.plan, case.steps(10, 20)))
    assert rich >= 15


@pytest.mark.usefixtures("interpreted")
@pytest.mark.parametrize("law", [test_rows_in_any_order, test_rows_that_are_forgotten])
def test_loops_that_are_not_compiled(law: Callable[[int], None]) -> None:
    for seed in range(12):
        law.hypothesis.inner_test(seed)  # type: ignore[attr-defined]
