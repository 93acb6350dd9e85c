"""A formula over samples of several objects, each by itself: the verdicts of one, and when they are
available, are those of a monitor of its own samples, with its values in the formula."""

from __future__ import annotations

import pickle
from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from formula_drawing import OBJECTS, SORT, OneObjectDrawing, filled

from dyknow.languages.mtl.ast import Report
from dyknow.languages.mtl.checked import (
    CheckedMonitor,
    Constant,
    Kind,
    ObjectConstant,
)
from dyknow.reasoning.mtl import evaluator
from dyknow.reasoning.mtl.formulas import is_of_one_object, readings_of
from dyknow.reasoning.mtl.monitoring import Monitoring, Reported
from dyknow.reasoning.mtl.part_monitoring import PartMonitoring
from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    Duration,
    SampleEvery,
    SynchronizationPolicy,
)

STREAMS = 2


class Drawing(OneObjectDrawing):
    """Random monitors of one object."""

    def monitor(self) -> CheckedMonitor:
        draw = self.random
        while True:
            formula = self.formula(draw.choice([1, 2, 3]), ["x"])
            monitor = CheckedMonitor(
                "m", (("x", SORT),), formula, self.policy(), Report.VERDICTS, False, None
            )
            if is_of_one_object(monitor) and readings_of(formula):
                break
        report = draw.choice([*Report])
        once = monitor.policy.period is None and draw.random() < 0.3
        robustness = draw.random() < 0.2 and report is not Report.CHANGES
        return replace(
            monitor,
            report=report,
            once=once,
            robustness=robustness,
            present_for=draw.choice([None, None, 0, 4]),
        )

    def policy(self) -> SynchronizationPolicy:
        draw = self.random
        period = draw.choice([None, 1, 2, 3])
        return SynchronizationPolicy(
            AnyChange() if period is None else SampleEvery(period),
            draw.choice([None, None, 0, 2, 5]),
            Duration(draw.choice([None, None, 0, 2]), draw.choice([None, None, 9, 20])),
            approximation=draw.choice([*Approximation]),
        )


def told(found: Reported) -> list[tuple[Any, ...]]:
    columns = [found.available, found.valid, found.decided, found.last, found.value, found.witness]
    if found.robustness is not None:
        columns.append(np.nan_to_num(found.robustness, nan=0.5))
    return list(zip(*(column.tolist() for column in columns), strict=True))


class Play:
    """Samples and time for parts together, and for each part alone."""

    def __init__(self, seed: int) -> None:
        drawing = Drawing(seed)
        self.draw = drawing.random
        self.monitor = drawing.monitor()
        self.terms = Monitoring(self.monitor, STREAMS).terms
        self.shared = PartMonitoring(self.monitor, STREAMS)
        self.alone: list[Monitoring] = []
        self.objects: list[str] = []
        self.found: list[list[Any]] = []
        self.wanted: list[list[Any]] = []
        self.gone: set[int] = set()
        self.now, self.watermark = [0] * STREAMS, 0

    def play(self) -> None:
        draw = self.draw
        for _ in range(draw.randint(6, 40)):
            there = [part for part in range(len(self.alone)) if part not in self.gone]
            what = draw.random()
            if what < 0.12 or not there:
                self.enter()
            elif what < 0.14:
                part = draw.choice(there)
                self.shared.end_part(part)
                self.gone.add(part)
            elif what < 0.6:
                self.send(draw.randrange(STREAMS), there)
            else:
                idle = [s for s in range(STREAMS) if draw.random() < 0.15]
                self.shared.set_idle(idle)
                for each in self.alone:
                    each.set_idle(idle)
                later = draw.choice([min(self.now), max(self.now), max(self.now) + 2])
                self.watermark = max(self.watermark, later)
                self.advance(by_clock=draw.random() < 0.2)
            if draw.random() < 0.05:
                self.shared = pickle.loads(pickle.dumps(self.shared))
        end = max(*self.now, self.watermark)
        for stream in range(STREAMS):
            self.shared.ended(stream, end)
            for each in self.alone:
                each.ended(stream, end)
        self.watermark = end + 1
        self.advance(by_clock=False)
        self.take(self.shared.finish(end))
        for part, each in enumerate(self.alone):
            self.wanted[part] += told(each.finish(end))
        self.check()

    def enter(self) -> None:
        draw = self.draw
        object = draw.choice(OBJECTS)
        values = {
            "wanted": Constant(draw.random() < 0.5, Kind.TRUTH),
            "o": ObjectConstant(draw.choice(OBJECTS)),
        }
        assert self.shared.add_part(object, values) == len(self.alone)
        own = replace(self.monitor, formula=filled(self.monitor.formula, values))
        self.alone.append(Monitoring(own, STREAMS))
        self.objects.append(object)
        self.found.append([])
        self.wanted.append([])

    def send(self, stream: int, there: list[int]) -> None:
        draw = self.draw
        count = draw.randint(1, 8)
        steps = np.array([draw.choice([0, 1, 1, 2, 4]) for _ in range(count)], np.int64)
        available = max(self.now[stream], self.watermark) + np.cumsum(steps)
        self.now[stream] = int(available[-1])
        delays = draw.choice([[0], [0, 0, 1], [0, 1, 5, -2]])
        valid = available - np.array([draw.choice(delays) for _ in range(count)])
        part = np.array([draw.choice(there) for _ in range(count)])
        values = np.array([draw.random() < 0.5 for _ in range(count)])
        # A sample may have no value.
        term = np.array([draw.randrange(-1, len(self.terms)) for _ in range(count)])
        self.shared.came_in_parts(stream, available, valid, part)
        for p in set(part.tolist()):
            self.alone[p].came(stream, available[part == p], valid[part == p])
        for i, each in enumerate(self.terms):
            mine = term == i
            rows = available[mine], valid[mine], part[mine, None], values[mine]
            self.shared.add(stream, each, *rows)
            for p in set(part[mine].tolist()):
                own = mine & (part == p)
                names = np.full((int(own.sum()), 1), self.alone[p].place(each, 0, self.objects[p]))
                times = available[own], valid[own]
                self.alone[p].add(stream, each, *times, names, values[own])

    def advance(self, *, by_clock: bool) -> None:
        self.take(self.shared.advance(self.watermark, by_clock=by_clock))
        for part, each in enumerate(self.alone):
            self.wanted[part] += told(each.advance(self.watermark, by_clock=by_clock))
        self.check()

    def take(self, found: Reported) -> None:
        for part, row in zip(found.objects[0].tolist(), told(found), strict=True):
            assert part not in self.gone
            self.found[part].append(row)

    def check(self) -> None:
        for part, mine in enumerate(self.found):
            if part in self.gone:
                assert mine == self.wanted[part][: len(mine)]
                continue
            assert mine == self.wanted[part]
            alone, here = self.alone[part], self.shared.part(part)
            assert (here.states, here.grid) == (alone.states, alone.grid)
            assert (here.verdicts, here.has_open) == (alone.verdicts, alone.has_open)
            assert self.shared.late_of[part] == alone.late


def compared(seed: int) -> Counter[str]:
    case = Play(seed)
    case.play()
    monitor, found = case.monitor, sum(map(len, case.found))
    kinds = [str(monitor.report), *(["once"] if monitor.once else [])]
    kinds += ["grid"] if monitor.policy.period is not None else []
    kinds += ["delay"] if monitor.policy.max_delay is not None else []
    kinds += ["robust"] if monitor.robustness else []
    return Counter(dict.fromkeys(kinds, found), all=found)


@pytest.mark.parametrize("block", range(6))
def test_each_object_has_its_own_verdicts(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The evaluator cuts batches, too."""
    monkeypatch.setattr(evaluator, "CELLS", evaluator.CELLS if block % 2 else 4)
    found: Counter[str] = Counter()
    for seed in range(block * 80, block * 80 + 80):
        found += compared(seed)
    for kind in (*map(str, Report), "once", "grid", "delay", "robust"):
        assert found[kind], kind
