"""What has come of a match is a partial match until the rest comes, and the rest comes in the
windows that it gives."""

from __future__ import annotations

import math
from dataclasses import replace
from random import Random

from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pattern_definition import Row, Watermark, matches
from pattern_drawing import PatternDrawing, rows_of

from dyknow.reasoning.patterns.evaluation.all_rows import AllRows
from dyknow.reasoning.patterns.plans.network import (
    ContradictoryTimes,
    UnboundedRetention,
    minimal_network,
)
from dyknow.reasoning.patterns.recognition.partial import partial_matches


@settings(deadline=None, max_examples=400)
@given(st.integers(0, 2**32))
def test_each_match_was_partial(seed: int) -> None:
    draw = Random(seed)
    case = PatternDrawing(seed, most_elements=3)
    steps = [each for each in case.steps(draw.randint(2, 10), 20) if isinstance(each, Row)]
    try:
        running = AllRows(case.plan, capacity=8)
    except UnboundedRetention:
        assume(False)
    except ContradictoryTimes:
        return
    came = draw.randint(1, len(steps))
    running.push(rows_of(steps[:came]))
    now = max(row.end for row in steps[:came])
    found = partial_matches(minimal_network(case.plan), running.rows(), now, 10**6)
    assert not found.has_more
    pending = {
        tuple(sorted((e, row.number) for e, row in each.bound.items())): each.pending
        for each in found.found
    }
    assert len(pending) == len(found.found)
    end = max(row.end for row in steps)
    by_number = {row.number: row for row in steps}
    for match in matches(case.plan, [*steps, Watermark(end + 100)]):
        own = [(e, number) for e, number in enumerate(match.rows) if number < came]
        if not 0 < len(own) < len(match.rows):
            continue
        windows = {each.element: each for each in pending[tuple(own)]}
        for element, number in enumerate(match.rows):
            if number >= came:
                window, time = windows.pop(element), by_number[number].end
                assert window.earliest <= time <= (window.latest or math.inf)
        assert not windows


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 2**32))
def test_a_partial_match_can_be_completed(seed: int) -> None:
    """Of two events with nothing asked but their times: rows at the ends of the windows do."""
    draw = Random(seed)
    case = PatternDrawing(seed, most_elements=2)
    assume(case.count == 2)
    plan = replace(
        case.plan,
        elements=tuple(replace(each, conditions=()) for each in case.plan.elements),
        same=(),
        conditions=(),
        probes=(),
        hulls=(),
        has_intervals=False,
    )
    steps = [each for each in case.steps(draw.randint(1, 6), 10) if isinstance(each, Row)]
    try:
        running = AllRows(plan, capacity=8)
    except (UnboundedRetention, ContradictoryTimes):
        assume(False)
    running.push(rows_of(steps))
    now = max(row.end for row in steps)
    for partial in partial_matches(minimal_network(plan), running.rows(), now, 9).found:
        ((element, row),) = partial.bound.items()
        (pending,) = partial.pending
        assert pending.element == 1 - element
        kind = plan.elements[pending.element].kinds[0]
        for time in {pending.earliest, pending.latest or pending.earliest + 5}:
            last = Row(99, kind, time, time, dict(row.values))
            whole = matches(plan, [*steps, last, Watermark(time + 1)])
            assert {row.number, 99} in [set(each.rows) for each in whole]
