"""What has come of a match is a partial match until the rest comes, and the rest comes in the
windows that it gives. Under the strategies that select the next row, partial matches are runs."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from random import Random

from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pattern_definition import Row, Watermark, matches
from pattern_drawing import PatternDrawing, rows_of
from pattern_run_definition import Binding, Definition
from pattern_run_drawing import RunDrawing

from dyknow.reasoning.patterns.evaluation.all_rows import AllRows
from dyknow.reasoning.patterns.plans.network import (
    ContradictoryTimes,
    UnboundedRetention,
    minimal_network,
)
from dyknow.reasoning.patterns.plans.plan import Between, Point
from dyknow.reasoning.patterns.recognition.partial import partial_matches, partial_runs
from dyknow.reasoning.patterns.sequences.next_rows import NextRows
from dyknow.reasoning.patterns.sequences.run_packing import sequence_network


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
        tuple(sorted((e, row.number) for e, row in each.rows)): each.pending for each in found.found
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
        ((element, row),) = partial.rows
        (pending,) = partial.pending
        assert pending.element == 1 - element
        kind = plan.elements[pending.element].kinds[0]
        for time in {pending.earliest, pending.latest or pending.earliest + 5}:
            last = Row(99, kind, time, time, dict(row.values))
            whole = matches(plan, [*steps, last, Watermark(time + 1)])
            assert {row.number, 99} in [set(each.rows) for each in whole]


class OpenRuns(Definition):
    """The runs that lack an element when all rows have come."""

    def open(self) -> Iterator[Binding]:
        for place, row in enumerate(self.rows):
            begun = self.taken(Binding({}, {}), 0, row)
            yield from self.open_from(begun, self.rows[place + 1 :]) if begun else ()

    def open_from(self, run: Binding, rest: list[Row]) -> Iterator[Binding]:
        e = max(run.rows)
        if e == self.last:
            return
        for place, row in enumerate(rest):
            take = self.taken(run, e, row) if self.plan.elements[e].is_kleene else None
            go = self.taken(run, e + 1, row) if self.is_complete(run, e) else None
            for more in (take, go):
                if more is not None:
                    yield from self.open_from(more, rest[place + 1 :])
            if take or go or self.breaks(run, row):
                return
        yield run


def key(run: Binding) -> tuple[tuple[int, int], ...]:
    """The numbers of the first and last row of each element."""
    rows = [(e, rows[place].number) for e, rows in sorted(run.rows.items()) for place in (0, -1)]
    return tuple(dict.fromkeys(rows))


@settings(deadline=None, max_examples=600)
@given(st.integers(0, 2**32))
def test_partial_matches_of_runs(seed: int) -> None:
    """They are the open runs by definition, without some that have lasted too long; each match was
    one, and the first rows of its other elements come in their windows."""
    case = RunDrawing(seed)
    draw, plan = case.random, case.plan
    kleene = [e for e in range(len(plan.elements) - 1) if plan.elements[e].is_kleene]
    if kleene and draw.random() < 0.5:
        # The next element soon after the last row of a repeated one, which may go on.
        soon = Between(Point(kleene[0]), Point(kleene[0] + 1, True), 1, draw.randint(1, 4))
        plan = replace(plan, between=(*plan.between, soon))
    steps = [step for step in case.steps(draw.randint(2, 14), 20) if isinstance(step, Row)]
    try:
        running = NextRows(plan, capacity=8)
    except ContradictoryTimes:
        return
    came = draw.randint(1, len(steps))
    running.push(rows_of(steps[:came]))
    now = running.watermark
    found = partial_runs(sequence_network(plan), running.begun(), now, 10**6)
    assert not found.has_more
    pending = {tuple((e, row.number) for e, row in each.rows): each.pending for each in found.found}
    assert len(pending) == len(found.found)
    assert pending.keys() <= set(map(key, OpenRuns(plan, steps[:came]).open()))
    whole = Definition(plan, steps)
    for place, row in enumerate(whole.rows):
        begun = whole.taken(Binding({}, {}), 0, row)
        for match in whole.of_run(begun, whole.rows[place + 1 :]) if begun else ():
            parts = {e: tuple(r for r in rows if r.number < came) for e, rows in match.rows.items()}
            own = Binding({e: rows for e, rows in parts.items() if rows}, {})
            if not 0 < len(own.rows) < len(match.rows):
                continue
            windows = {each.element: each for each in pending[key(own)]}
            assert windows.keys() == match.rows.keys() - own.rows.keys()
            for element, window in windows.items():
                assert window.earliest <= match.rows[element][0].end
                assert match.rows[element][0].end <= (window.latest or math.inf)
