"""Matches of runs are those of their definition, in its order, however the rows are cut."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pattern_cuts import check_parts, found_in, parts_of
from pattern_definition import Row, Step
from pattern_drawing import rows_of
from pattern_run_definition import run_matches
from pattern_run_drawing import RunDrawing

from dyknow.reasoning.patterns.plans.limits import Limits
from dyknow.reasoning.patterns.plans.network import ContradictoryTimes
from dyknow.reasoning.patterns.plans.plan import PatternPlan
from dyknow.reasoning.patterns.sequences.next_rows import NextRows

SEEDS = st.integers(0, 2**32)


def check(plan: PatternPlan, steps: list[Step], draw: Random) -> int:
    wanted = run_matches(plan, steps)
    try:
        running = NextRows(plan, capacity=8)
    except ContradictoryTimes:
        assert not wanted
        return 0
    check_parts(lambda: NextRows(plan, capacity=8), running, wanted, steps, draw)
    return len(wanted)


@settings(deadline=None, max_examples=1500)
@given(SEEDS)
def test_runs(seed: int) -> None:
    case = RunDrawing(seed)
    steps = case.steps(case.random.randint(1, 14), case.random.choice([8, 20, 40]))
    check(case.plan, steps, case.random)


@settings(deadline=None, max_examples=100)
@given(SEEDS)
def test_runs_that_are_forgotten(seed: int) -> None:
    """Over many times the span of a match, at a small capacity."""
    case = RunDrawing(seed, most_elements=3)
    plan = replace(case.plan, within=5)
    check(plan, case.steps(80, 200, objects=3), case.random)


@settings(deadline=None, max_examples=100)
@given(SEEDS, st.integers(0, 4), st.integers(0, 2))
def test_losses_are_counted(seed: int, runs: int, most: int) -> None:
    """With limits on runs and on the matches of a row, matches are some of those wanted; if any is
    missing, a counter says why."""
    case = RunDrawing(seed)
    plan = replace(case.plan, probes=())
    steps = case.steps(20, 40)
    wanted = {each.rows for each in run_matches(plan, steps)}
    try:
        running = NextRows(plan, capacity=8, limits=Limits(runs=runs, matches=most))
    except ContradictoryTimes:
        return
    found = set()
    for _, part in parts_of(steps, case.random):
        result = running.advance(part) if isinstance(part, int) else running.push(rows_of(part))
        found |= {each[0] for each in found_in(result)}
    assert found <= wanted
    counters = running.counters
    assert found == wanted or counters.unstarted + counters.cut_short > 0


def test_memory_does_not_grow() -> None:
    """Rows, runs and nodes that no match can use any more are forgotten."""
    case = next(
        each
        for each in map(RunDrawing, range(1000))
        if each.count == 3 and each.kleene and each.plan.probes and each.plan.within == 12
    )
    rows = [each for each in case.steps(6_000, 20_000, objects=8) if isinstance(each, Row)]
    whole = found_in(NextRows(case.plan).push(rows_of(rows)))
    running = NextRows(case.plan, capacity=8)
    parts = [running.push(rows_of(rows[i : i + 7])) for i in range(0, len(rows), 7)]
    assert [each for part in parts for each in found_in(part)] == whole
    assert running.kept < 500
    assert running.size < 100_000


@pytest.mark.parametrize("seed", range(3))
def test_the_drawing_has_matches(seed: int) -> None:
    """The laws above see matches: of random cases a fair share has some."""
    rich = 0
    for each in range(60):
        case = RunDrawing(1000 * seed + each)
        rich += bool(run_matches(case.plan, case.steps(12, 20)))
    assert rich >= 12


@pytest.mark.usefixtures("interpreted")
@pytest.mark.parametrize("law", [test_runs, test_runs_that_are_forgotten])
def test_loops_that_are_not_compiled(law: Callable[[int], None]) -> None:
    for seed in range(12):
        law.hypothesis.inner_test(seed)  # type: ignore[attr-defined]
