"""The matches of a pattern over streams, and when they are available: as if each instant came by
itself, however the streams are cut and whichever delivers first."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from random import Random

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pattern_definition import Row, Step, Watermark, matches
from pattern_drawing import KINDS, PatternDrawing, rows_of

from dyknow.reasoning.patterns.plans.network import ContradictoryTimes, UnboundedRetention
from dyknow.reasoning.patterns.plans.plan import NO_VALUE, Output, PatternPlan, Time
from dyknow.reasoning.patterns.plans.query import Argument, Keys, PatternQuery, Source
from dyknow.reasoning.patterns.recognition.recognition import Recognition, Recognized, needs_order
from dyknow.streams.time import TIME_MAX, TIME_MIN

STREAMS = 2


@dataclass(frozen=True)
class Sent:
    """A row of a stream; ``place`` is its number there."""

    stream: int
    place: int
    available: int
    row: Row


Found = list[tuple[int, int, tuple[int | float | None, ...]]]


def query_of(case: PatternDrawing) -> PatternQuery:
    every = tuple(range(case.count))
    times = Output("start", Time(every, True)), Output("end", Time(every))
    plan = replace(case.plan, outputs=(*case.plan.outputs, *times))
    sources = tuple(Source(kind, f"http://x/{kind}", (Argument(),), ()) for kind in KINDS)
    return PatternQuery("", sources, (plan,), ())


def sent_in(draw: Random, case: PatternDrawing, count: int) -> list[Sent]:
    """Rows in order of available time; some were valid before earlier ones."""
    rows = [step for step in case.steps(count, 20) if isinstance(step, Row)]
    available, found = 0, []
    places = [0] * STREAMS
    for row in sorted(rows, key=lambda row: row.end):
        available += draw.choice([0, 0, 1, 1, 3])
        stream = draw.randrange(STREAMS)
        end = row.end - draw.choice([0, 0, 0, 0, 2, 5])
        start = end - (row.end - row.start)
        moved = replace(row, start=start, end=end)
        found.append(Sent(stream, places[stream], available, moved))
        places[stream] += 1
    return found


def expected(query: PatternQuery, sent: list[Sent], lateness: list[int]) -> tuple[Found, int]:
    """The matches by their definition, instant by instant, and the number of late rows."""
    is_ordered = needs_order(query)
    steps: list[Step] = []
    instants: list[int] = []
    greatest = [TIME_MIN] * STREAMS
    reached, late, queue = TIME_MIN, 0, []

    def take(rows: list[Sent], at: int) -> None:
        for each in rows:
            number = sum(isinstance(step, Row) for step in steps)
            steps.append(replace(each.row, number=number))
            instants.append(at)

    for at in sorted({each.available for each in sent}):
        new = sorted(
            (each for each in sent if each.available == at), key=lambda e: (e.stream, e.place)
        )
        kept = [each for each in new if each.row.end >= reached]
        late += len(new) - len(kept)
        for each in new:
            greatest[each.stream] = max(greatest[each.stream], each.row.end)
        if TIME_MIN not in greatest:
            passed = min(g - lag for g, lag in zip(greatest, lateness, strict=True))
            reached = max(reached, passed)
        if is_ordered:
            queue += kept
            take(in_order([each for each in queue if each.row.end <= reached]), at)
            queue = [each for each in queue if each.row.end > reached]
        else:
            take(kept, at)
        steps.append(Watermark(reached))
        instants.append(at)
    last = max(each.available for each in sent)
    take(in_order(queue), last)
    steps.append(Watermark(TIME_MAX))
    instants.append(last)
    (plan,) = query.plans
    found = matches(plan, steps, is_ordered=is_ordered)
    return [(instants[each.step], _end(plan, each.outputs), each.outputs) for each in found], late


def expected_by_delay(query: PatternQuery, sent: list[Sent], delay: int) -> tuple[Found, int]:
    """The same with a ``max_delay``: each time is over that long after it, whatever comes."""
    kept = [each for each in sent if each.row.end >= each.available - delay]
    last = max(each.available for each in sent)
    steps: list[Step] = []
    instants: list[int] = []

    def take(new: list[Step], at: int) -> None:
        for each in new:
            number = sum(isinstance(step, Row) for step in steps)
            steps.append(replace(each, number=number) if isinstance(each, Row) else each)
            instants.append(at)

    is_ordered = needs_order(query)
    if is_ordered:
        ends = [each.row.end for each in kept]
        for time in range(min(ends, default=0) - 50, last - delay + 1):
            own = in_order([each for each in kept if each.row.end == time])
            take([*(each.row for each in own), Watermark(time + 1)], time + delay)
        rest = in_order([each for each in kept if each.row.end + delay > last])
        take([each.row for each in rest], last)
    else:
        for each in sorted(kept, key=lambda each: (each.available, each.stream, each.place)):
            take([each.row], each.available)
    take([Watermark(TIME_MAX)], last)
    (plan,) = query.plans
    found = matches(plan, steps, is_ordered=is_ordered)
    results = [(instants[each.step], _end(plan, each.outputs), each.outputs) for each in found]
    return results, len(sent) - len(kept)


def in_order(rows: list[Sent]) -> list[Sent]:
    return sorted(rows, key=lambda each: (each.row.end, each.available, each.stream, each.place))


def _end(plan: PatternPlan, outputs: tuple[int | float | None, ...]) -> int:
    end = outputs[[output.name for output in plan.outputs].index("end")]
    assert isinstance(end, int)
    return end


def recognized(
    query: PatternQuery, sent: list[Sent], lateness: list[int], draw: Random
) -> tuple[Found, int]:
    """The matches found in some cuts, the streams by turns."""
    running = Recognition(query, STREAMS, Keys(), lateness=lateness)
    left = [[each for each in sent if each.stream == stream] for stream in range(STREAMS)]
    given = [TIME_MIN] * STREAMS
    end = max(each.available for each in sent)
    found: Found = []
    while any(left):
        stream = draw.choice([i for i in range(STREAMS) if left[i]])
        part = left[stream][: draw.randint(1, 5)]
        del left[stream][: len(part)]
        available = np.array([each.available for each in part])
        running.came(stream, available, np.array([each.row.end for each in part]))
        for kind in KINDS:
            own = np.array([i for i, each in enumerate(part) if each.row.kind == kind], np.int64)
            if len(own):
                rows = rows_of([part[i].row for i in own])
                times = np.array([part[i].available for i in own]), rows.start, rows.end
                running.add(stream, kind, own, *times, rows.columns)
        given[stream] = part[-1].available if left[stream] else TIME_MAX
        watermark = min(min(given), end + 1)
        if watermark > TIME_MIN:
            found += told(query, running.advance(watermark))
    for stream in range(STREAMS):
        running.ended(stream, end)
    found += told(query, running.advance(end + 1))
    return found + told(query, running.finish(end)), running.late


def told(query: PatternQuery, results: Recognized) -> Found:
    names = [output.name for output in query.plans[0].outputs]
    columns = [[_value(x) for x in results.outputs[name].tolist()] for name in names]
    rows = list(zip(*columns, strict=True))
    return list(zip(results.available.tolist(), results.valid.tolist(), rows, strict=True))


def _value(value: int | float) -> int | float | None:
    is_missing = value == NO_VALUE or (isinstance(value, float) and math.isnan(value))
    return None if is_missing else value


@settings(deadline=None, max_examples=400)
@given(st.integers(0, 2**32))
def test_matches_do_not_depend_on_cuts(seed: int) -> None:
    draw = Random(seed)
    case = PatternDrawing(seed, is_ordered=draw.random() < 0.6)
    query = query_of(case)
    sent = sent_in(draw, case, draw.randint(1, 14))
    lateness = [draw.choice([0, 0, 2]) for _ in range(STREAMS)]
    agree(query, sent, lateness, expected(query, sent, lateness), draw)


@settings(deadline=None, max_examples=600)
@given(st.integers(0, 2**32))
def test_a_max_delay(seed: int) -> None:
    draw = Random(seed)
    case = PatternDrawing(seed, is_ordered=draw.random() < 0.8)
    delay = draw.choice([0, 1, 1, 3, 8])
    query = replace(query_of(case), max_delay=delay)
    sent = sent_in(draw, case, draw.randint(4, 14))
    agree(query, sent, [0] * STREAMS, expected_by_delay(query, sent, delay), draw)


def agree(
    query: PatternQuery,
    sent: list[Sent],
    lateness: list[int],
    wanted: tuple[Found, int],
    draw: Random,
) -> None:
    """What is found in some cuts is what is wanted."""
    for _ in range(2):
        try:
            assert recognized(query, sent, lateness, draw) == wanted
        except UnboundedRetention:
            assume(False)
        except ContradictoryTimes:
            assert not wanted[0]
