"""Patterns over samples of several objects, each by itself: the results of one, and when they are
available, are those of a recognition of its own samples."""

from __future__ import annotations

import pickle
from dataclasses import replace
from random import Random
from typing import Any

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pattern_definition import Row
from pattern_drawing import KINDS, PatternDrawing, parted, rows_of

from dyknow.reasoning.patterns.plans.by_object import PART, PatternByObject
from dyknow.reasoning.patterns.plans.network import ContradictoryTimes, UnboundedRetention
from dyknow.reasoning.patterns.plans.plan import (
    NO_VALUE,
    Output,
    PatternPlan,
    Time,
)
from dyknow.reasoning.patterns.plans.query import Argument, Keys, PatternQuery, Source
from dyknow.reasoning.patterns.recognition.part_recognition import PartRecognition
from dyknow.reasoning.patterns.recognition.recognition import Recognition, Recognized

STREAMS = 2
COLUMN = "whose"


def query_of(plan: PatternPlan) -> PatternQuery:
    every = tuple(range(len(plan.elements)))
    times = Output("start", Time(every, True)), Output("end", Time(every))
    sources = tuple(Source(kind, f"http://x/{kind}", (Argument(),), ()) for kind in KINDS)
    return PatternQuery("", sources, (replace(plan, outputs=(*plan.outputs, *times)),), ())


def told(found: Recognized) -> list[tuple[Any, ...]]:
    outputs = {name: column for name, column in found.outputs.items() if name != PART}
    columns = [found.available, found.valid, *outputs.values()]
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return [tuple(None if x == NO_VALUE or x != x else x for x in row) for row in rows]


@settings(deadline=None, max_examples=400)
@given(st.integers(0, 2**32), st.booleans())
def test_each_object_has_its_own_results(seed: int, is_ordered: bool) -> None:
    case = PatternDrawing(seed, is_ordered=is_ordered, most_elements=3)
    draw = Random(seed)
    lateness = [draw.choice([0, 0, 3]) for _ in range(STREAMS)]
    pattern = PatternByObject(query_of(parted(case.plan, COLUMN, PART)), COLUMN, ())
    keys = Keys()
    try:
        shared = PartRecognition(pattern, STREAMS, keys, lateness=lateness)
        own = query_of(case.plan)
        Recognition(own, STREAMS, keys, lateness=lateness)
    except (UnboundedRetention, ContradictoryTimes):
        assume(False)
    alone: list[Recognition] = []
    wanted: list[list[Any]] = []
    found: list[list[Any]] = []
    gone: set[int] = set()

    def take(result: Recognized) -> None:
        for part, row in zip(result.outputs[PART].tolist(), told(result), strict=True):
            assert part not in gone
            found[part].append(row)

    now, watermark = [0] * STREAMS, 0
    for _ in range(draw.randint(4, 40)):
        what = draw.random()
        there = [p for p in range(len(alone)) if p not in gone]
        if what < 0.1 or not there:
            assert shared.add_part() == len(alone)
            alone.append(Recognition(own, STREAMS, keys, lateness=lateness))
            wanted.append([])
            found.append([])
        elif what < 0.12:
            part = draw.choice(there)
            shared.end_part(part)
            gone.add(part)
        elif what < 0.6:
            stream, count = draw.randrange(STREAMS), draw.randint(1, 6)
            steps = np.array([draw.choice([0, 1, 3]) for _ in range(count)], np.int64)
            available = max(now[stream], watermark) + np.cumsum(steps)
            now[stream] = int(available[-1])
            drawn = [each for each in case.steps(4 * count, 20) if isinstance(each, Row)][:count]
            assume(len(drawn) == count)
            rows = []
            for row, at in zip(drawn, available.tolist(), strict=True):
                end = at - draw.choice([0, 0, 0, 2, 5])
                rows.append(replace(row, start=end - (row.end - row.start), end=end))
            part = np.array([draw.choice(there) for _ in range(count)])
            send(shared, stream, available, rows, part)
            for p in set(part.tolist()):
                mine = [i for i in range(count) if part[i] == p]
                send(alone[p], stream, available[mine], [rows[i] for i in mine], None)
        else:
            idle = [s for s in range(STREAMS) if draw.random() < 0.15]
            watermark = max(watermark, draw.choice([min(now), max(now), max(now) + 2]))
            by_clock = draw.random() < 0.2
            shared.set_idle(idle)
            take(shared.advance(watermark, by_clock=by_clock))
            for part, each in enumerate(alone):
                each.set_idle(idle)
                wanted[part] += told(each.advance(watermark, by_clock=by_clock))
        if draw.random() < 0.05:
            shared = pickle.loads(pickle.dumps(shared))
        check(found, wanted, gone)
    end = max(*now, watermark)
    for stream in range(STREAMS):
        shared.ended(stream, end)
        for each in alone:
            each.ended(stream, end)
    take(shared.advance(end + 1))
    take(shared.finish(end))
    for part, each in enumerate(alone):
        wanted[part] += [*told(each.advance(end + 1)), *told(each.finish(end))]
    check(found, wanted, gone)
    late = [each.late for each in alone]
    assert [late[p] for p in range(len(alone)) if p not in gone] == [
        int(shared.late_of[p]) for p in range(len(alone)) if p not in gone
    ]


def check(found: list[list[Any]], wanted: list[list[Any]], gone: set[int]) -> None:
    for part, mine in enumerate(found):
        if part in gone:
            assert mine == wanted[part][: len(mine)]
        else:
            assert mine == wanted[part]


def send(
    running: Recognition,
    stream: int,
    available: Any,
    rows: list[Row],
    part: Any,
) -> None:
    valid = np.array([row.end for row in rows])
    if part is None:
        running.came(stream, available, valid)
    else:
        assert isinstance(running, PartRecognition)
        running.came_in_parts(stream, available, valid, part)
    for kind in KINDS:
        own = np.array([i for i, row in enumerate(rows) if row.kind == kind], np.int64)
        if len(own):
            made = rows_of([rows[i] for i in own])
            columns = dict(made.columns) | ({} if part is None else {COLUMN: part[own]})
            running.add(stream, kind, own, available[own], made.start, made.end, columns)
