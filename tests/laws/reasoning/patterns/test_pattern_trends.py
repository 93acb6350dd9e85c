"""Aggregates over all matches are those of their definition, however the rows are cut."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pattern_cuts import check_parts
from pattern_data import KINDS, S, batches, data, sequence
from pattern_definition import Step
from pattern_run_drawing import TrendDrawing
from trend_definition import trends

from dyknow.reasoning.patterns.evaluation.evaluator import Evaluator
from dyknow.reasoning.patterns.plans.network import ContradictoryTimes
from dyknow.reasoning.patterns.plans.plan import Function, PatternPlan, Trend
from dyknow.reasoning.patterns.plans.rows import Matches, Rows
from dyknow.reasoning.patterns.recognition.choice import evaluator_of
from dyknow.reasoning.patterns.sequences.trend_products import TrendProducts
from dyknow.reasoning.patterns.sequences.trend_sums import TrendSums
from dyknow.reasoning.patterns.sequences.trends import Trends

SEEDS = st.integers(0, 2**32)


def check(plan: PatternPlan, steps: list[Step], draw: Random) -> int:
    wanted = trends(plan, steps)
    try:
        ways: list[Evaluator] = [TrendSums(plan, capacity=8), evaluator_of(plan, capacity=8)]
    except ContradictoryTimes:
        assert not wanted
        return 0
    for running in ways:
        way = type(running)
        check_parts(partial(way, plan, capacity=8), running, wanted, steps, draw)
    return len(wanted)


@settings(deadline=None, max_examples=600)
@given(SEEDS)
def test_trends(seed: int) -> None:
    case = TrendDrawing(seed)
    steps = case.steps(case.random.randint(1, 11), case.random.choice([8, 20, 40]))
    check(case.plan, steps, case.random)


@settings(deadline=None, max_examples=60)
@given(SEEDS)
def test_rows_that_are_forgotten(seed: int) -> None:
    """Over many times the span of a match, at a small capacity."""
    case = TrendDrawing(seed)
    plan = replace(case.plan, within=4)
    check(plan, case.steps(80, 160, objects=2), case.random)


@pytest.mark.parametrize("way", [TrendProducts, TrendSums])
@pytest.mark.parametrize("repeats", [40, 60, 61, 64, 200])
def test_large_numbers(repeats: int, way: type[Trends]) -> None:
    """Numbers of trends are exact below 2^62, and rounded from there on."""
    found, running = _repeated(way, repeats)
    numbers = 2**repeats - 1, repeats * 2 ** (repeats - 1)
    for name, number in zip("nb", numbers, strict=True):
        column = found.outputs[name]
        if number < 2**62:
            assert column.dtype == np.int64
            assert column.tolist() == [number]
        else:
            assert column.tolist() == [pytest.approx(float(number), rel=1e-12)]
    assert found.outputs["s"].tolist() == [pytest.approx(float(numbers[1]), rel=1e-12)]
    assert running.counters.rounded == sum(number >= 2**62 for number in numbers)


@pytest.mark.parametrize("way", [TrendProducts, TrendSums])
def test_infinite_numbers(way: type[Trends]) -> None:
    """Beyond floats, numbers are infinite and sums are missing; the least value stays."""
    found, running = _repeated(way, 1100)
    assert [found.outputs[name].tolist() for name in "nb"] == [[math.inf]] * 2
    assert math.isnan(found.outputs["s"][0])
    assert found.outputs["m"].tolist() == [1.0]
    assert running.counters.rounded == 2


def _repeated(way: type[Trends], repeats: int) -> tuple[Matches, Trends]:
    """SEQ(A, B+, C) over one A, a number of B and one C."""
    trends = (
        Trend("n", Function.COUNT),
        Trend("b", Function.COUNT, 1),
        Trend("s", Function.SUM, 1, "v"),
        Trend("m", Function.MIN, 1, "v"),
    )
    kind = np.array([0, *[1] * repeats, 2])
    ends = np.arange(len(kind)) * S
    ones = np.ones(len(kind), np.int64)
    running = way(sequence("AB+C", trends=trends, within=10_000 * S))
    columns = {"x": ones, "y": ones, "v": ones * 1.0}
    return running.push(Rows(KINDS, kind, ends, ends, columns)), running


@pytest.mark.parametrize("way", [TrendProducts, TrendSums])
def test_memory_does_not_grow(way: type[Trends]) -> None:
    """What a window has passed is forgotten, as are the windows of keys that come no more."""
    rows = data(20_000, 10)
    rows = replace(rows, columns={**rows.columns, "x": np.arange(20_000) // 20})
    running = way(sequence("AB+C", trends=(Trend("n", Function.COUNT),), within=100 * S))
    sizes = []
    for part in batches(rows, 50):
        running.push(part)
        sizes.append(running.size)
    assert max(sizes[100:]) < 1.5 * max(sizes[:100])
    assert running.counters.matches > 1000


@pytest.mark.usefixtures("interpreted")
@pytest.mark.parametrize("law", [test_trends])
def test_loops_that_are_not_compiled(law: Callable[[int], None]) -> None:
    for seed in range(12):
        law.hypothesis.inner_test(seed)  # type: ignore[attr-defined]
