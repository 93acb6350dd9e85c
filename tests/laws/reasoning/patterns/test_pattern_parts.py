"""Rows that fall into parts, each with its own time: the matches of a part are those of an
evaluation of its own, in the same order, and so are its partial matches."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pattern_cuts import found_in
from pattern_definition import Row, Watermark
from pattern_drawing import PatternDrawing, parted, rows_of
from pattern_run_drawing import RunDrawing, TrendDrawing

from dyknow.reasoning.patterns.evaluation.all_rows import AllRows
from dyknow.reasoning.patterns.evaluation.evaluator import Evaluator
from dyknow.reasoning.patterns.evaluation.part_rows import InParts, PartRows
from dyknow.reasoning.patterns.plans.by_object import within_part
from dyknow.reasoning.patterns.plans.network import (
    ContradictoryTimes,
    UnboundedRetention,
    minimal_network,
)
from dyknow.reasoning.patterns.plans.plan import Selection
from dyknow.reasoning.patterns.plans.rows import Matches, Rows
from dyknow.reasoning.patterns.recognition.choice import evaluator_of
from dyknow.reasoning.patterns.recognition.partial import partial_matches, partial_runs
from dyknow.reasoning.patterns.sequences.next_rows import NextRows
from dyknow.reasoning.patterns.sequences.run_packing import sequence_network

PARTS = 3
PART = "part"


def rows_with_parts(rows: list[tuple[int, Row]]) -> Rows:
    found = rows_of([row for _, row in rows])
    return replace(found, columns={**found.columns, PART: np.array([p for p, _ in rows])})


@settings(deadline=None, max_examples=600)
@given(st.integers(0, 2**32), st.booleans())
def test_a_part_is_an_evaluation_of_its_own(seed: int, is_ordered: bool) -> None:
    case = PatternDrawing(seed, is_ordered=is_ordered, most_elements=3)
    plan, draw = case.plan, Random(seed)
    if draw.random() < 0.5:
        plan = replace(plan, within=4)
    compare(
        case,
        draw,
        lambda: AllRows(plan, is_ordered=is_ordered, capacity=8),
        lambda: PartRows(parted(plan, PART, PART), part=PART, is_ordered=is_ordered, capacity=8),
    )


@settings(deadline=None, max_examples=400)
@given(st.integers(0, 2**32))
def test_runs_of_a_part_are_those_of_its_own(seed: int) -> None:
    compare_sequences(RunDrawing(seed, most_elements=3), Random(seed))


@settings(deadline=None, max_examples=300)
@given(st.integers(0, 2**32))
def test_repetition_of_a_part_is_that_of_its_own(seed: int) -> None:
    any_match = (Selection.ANY_MATCH,)
    case = RunDrawing(seed, selections=any_match, most_elements=3)
    compare_sequences(case, Random(seed), most=8)


@settings(deadline=None, max_examples=300)
@given(st.integers(0, 2**32))
def test_trends_of_a_part_are_those_of_its_own(seed: int) -> None:
    compare_sequences(TrendDrawing(seed), Random(seed))


def compare_sequences(case: PatternDrawing, draw: Random, most: int = 20) -> None:
    plan = case.plan
    if draw.random() < 0.5:
        plan = replace(plan, within=4)
    compare(
        case,
        draw,
        lambda: evaluator_of(plan, capacity=8),
        lambda: evaluator_of(parted(plan, PART, PART), capacity=8, part=PART),
        most,
    )


def partials_of(evaluator: Evaluator, part: int) -> list:
    """The partial matches of a part in some order: their rows without numbers, and the windows."""
    in_parts = isinstance(evaluator, InParts)
    now = evaluator.watermark_of(part) if in_parts else evaluator.watermark
    match evaluator:
        case NextRows():
            network = sequence_network(evaluator.plan)
            found = partial_runs(network, evaluator.begun(part), now, 10**6)
        case AllRows():
            plan = within_part(evaluator.plan, PART) if in_parts else evaluator.plan
            network = minimal_network(plan)
            found = partial_matches(network, evaluator.rows(part), now, 10**6)
        case _:
            return []

    def told(row) -> tuple:
        values = {name: value for name, value in row.values.items() if name != PART}
        return row.start, row.end, sorted(values.items())

    return sorted(
        ([(element, told(row)) for element, row in each.rows] for each in found.found), key=str
    ) + sorted(map(str, (each.pending for each in found.found)))


def compare(
    case: PatternDrawing,
    draw: Random,
    own: Callable[[], Evaluator],
    shared: Callable[[], InParts],
    most: int = 20,
) -> None:
    try:
        alone = [own() for _ in range(PARTS)]
        running = shared()
    except (UnboundedRetention, ContradictoryTimes):
        assume(False)
    wanted: list[list] = [[] for _ in range(PARTS)]
    found: list[list] = [[] for _ in range(PARTS)]

    def take(result: Matches) -> None:
        # The numbers of rows are those of all parts.
        place = list(result.outputs).index(PART)
        for _, decided, outputs in found_in(result):
            found[outputs[place]].append((decided, (*outputs[:place], *outputs[place + 1 :])))

    def note(part: int, result: Matches) -> None:
        wanted[part] += [(decided, outputs) for _, decided, outputs in found_in(result)]

    # The parts are at different times.
    steps = [case.steps(draw.randint(1, most), draw.choice([8, 40])) for _ in range(PARTS)]
    known = 0
    batch: list[tuple[int, Row]] = []
    watermarks = np.full(PARTS, -(2**63), np.int64)
    while any(steps):
        part = draw.choice([i for i in range(PARTS) if steps[i]])
        step = steps[part].pop(0)
        if part >= known:
            known = part + 1
            running.make_room_for(known)
        if isinstance(step, Watermark):
            take(running.push(rows_with_parts(batch)))
            batch = []
            note(part, alone[part].advance(step.time))
            watermarks[part] = max(watermarks[part], step.time)
            take(running.advance_parts(watermarks[:known]))
        else:
            note(part, alone[part].push(rows_of([step])))
            batch.append((part, step))
            if draw.random() < 0.3:
                take(running.push(rows_with_parts(batch)))
                batch = []
        if not batch and draw.random() < 0.3:
            for part in range(known):
                assert partials_of(running, part) == partials_of(alone[part], 0)
        if draw.random() < 0.1:
            state = running.state()
            running = shared()
            running.restore(state)
    take(running.push(rows_with_parts(batch)))
    assert running.pending == sum(each.pending for each in alone)
    take(running.end())
    for part in range(PARTS):
        note(part, alone[part].end())
    assert found == wanted
    assert running.counters.late == sum(each.counters.late for each in alone)
