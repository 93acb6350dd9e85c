"""Matches with repetition under any match are those of their definition, in its order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pattern_cuts import check_parts, found_in
from pattern_data import KINDS, S, sequence
from pattern_definition import Row, Step
from pattern_drawing import rows_of
from pattern_run_definition import any_matches
from pattern_run_drawing import RunDrawing

from dyknow.reasoning.patterns.plans.network import ContradictoryTimes
from dyknow.reasoning.patterns.plans.plan import (
    Aggregate,
    Condition,
    Constant,
    Function,
    PatternPlan,
    Selection,
)
from dyknow.reasoning.patterns.plans.rows import Rows
from dyknow.reasoning.patterns.sequences.repeated_rows import RepeatedRows
from dyknow.reasoning.patterns.sequences.search_loop import SEARCHED

SEEDS = st.integers(0, 2**32)
ANY = (Selection.ANY_MATCH,)


def check(plan: PatternPlan, steps: list[Step], draw: Random) -> int:
    wanted = any_matches(plan, steps)
    try:
        running = RepeatedRows(plan, capacity=8)
    except ContradictoryTimes:
        assert not wanted
        return 0
    check_parts(lambda: RepeatedRows(plan, capacity=8), running, wanted, steps, draw)
    return len(wanted)


@settings(deadline=None, max_examples=500)
@given(SEEDS)
def test_repetition(seed: int) -> None:
    case = RunDrawing(seed, selections=ANY)
    steps = case.steps(case.random.randint(1, 9), case.random.choice([8, 20, 40]))
    check(case.plan, steps, case.random)


@settings(deadline=None, max_examples=60)
@given(SEEDS)
def test_rows_that_are_forgotten(seed: int) -> None:
    """Over many times the span of a match, at a small capacity."""
    case = RunDrawing(seed, selections=ANY, most_elements=3)
    plan = replace(case.plan, within=4)
    check(plan, case.steps(60, 150, objects=2), case.random)


@settings(deadline=None, max_examples=80)
@given(SEEDS, st.integers(0, 3))
def test_a_limit_of_matches(seed: int, most: int) -> None:
    """Of each row as many are made as the limit allows, and each row cut short is counted."""
    case = RunDrawing(seed, selections=ANY)
    plan = replace(case.plan, probes=(), max_matches=most)
    steps = [each for each in case.steps(9, 20) if isinstance(each, Row)]
    wanted = any_matches(plan, steps)
    try:
        running = RepeatedRows(plan, capacity=8)
    except ContradictoryTimes:
        return
    found = found_in(running.push(rows_of(steps)))
    keys = [(each.rows, each.decided, each.outputs) for each in wanted]
    assert all(each in keys for each in found)
    last = [each.step for each in wanted]
    assert len(found) == sum(min(most, last.count(step)) for step in set(last))
    assert running.counters.cut_short == sum(last.count(step) > most for step in set(last))


def test_a_search_ends() -> None:
    """A search that finds nothing among 2^60 sequences is cut short."""
    nothing = Condition("<", Aggregate(Function.SUM, 0, "v"), Constant(0))
    plan = sequence("A+C", conditions=(nothing,), max_matches=1)
    kind = np.array([*[0] * 60, 2])
    ends = np.arange(len(kind)) * S
    ones = np.ones(len(kind), np.int64)
    running = RepeatedRows(plan)
    found = running.push(Rows(KINDS, kind, ends, ends, {"x": ones, "y": ones, "v": ones * 1.0}))
    assert len(found) == 0
    assert running.counters.cut_short == 1
    assert running.counters.candidates <= 2 * SEARCHED


@pytest.mark.usefixtures("interpreted")
@pytest.mark.parametrize("law", [test_repetition])
def test_loops_that_are_not_compiled(law: Callable[[int], None]) -> None:
    for seed in range(12):
        law.hypothesis.inner_test(seed)  # type: ignore[attr-defined]
