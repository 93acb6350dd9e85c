"""The verdicts of parts in one compiled call are those by moments, with the same witnesses, however
the states are cut into batches."""

from __future__ import annotations

import pickle
from collections import Counter
from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from formula_drawing import OBJECTS, SORT, OneObjectDrawing, X, filled

from dyknow.languages.mtl.ast import Interval, Report, Temporal
from dyknow.languages.mtl.checked import (
    And,
    Atom,
    CheckedMonitor,
    Constant,
    Formula,
    Kind,
    Not,
    ObjectConstant,
    Or,
    Previous,
    Reading,
    Until,
    Within,
)
from dyknow.reasoning.mtl.evaluator import (
    MonitorEvaluator,
    TooManyStates,
    Verdicts,
    no_verdicts,
)
from dyknow.reasoning.mtl.formulas import is_of_one_object
from dyknow.reasoning.mtl.parts import evaluator as part_evaluator
from dyknow.reasoning.mtl.parts.evaluator import PartEvaluator
from dyknow.reasoning.states.states import States, Values
from dyknow.streams.policies.policy import SynchronizationPolicy
from dyknow.streams.time import TIME_MIN

PARTS = 4
NOTHING = no_verdicts(1)
TERMS = (("urn:p", (SORT,)), ("urn:q", (SORT,)), ("urn:n", (SORT,)))


class Drawing(OneObjectDrawing):
    """Random monitors of one object, and states of it, from one seed."""

    def __init__(self, seed: int, without_end: float) -> None:
        super().__init__(seed)
        self.numbers = np.random.default_rng(seed)
        self.without_end = without_end

    def interval(self) -> Interval:
        found = super().interval()
        return replace(found, end=None) if self.random.random() < self.without_end else found

    def atom(self, scope: list[str]) -> Atom:
        draw = self.random
        if draw.random() < 0.5:
            return super().atom(scope)
        reading = Reading("urn:n", (X,), Kind.NUMBER, None)
        limit = Constant(float(draw.randrange(5)), Kind.NUMBER)
        return Atom(draw.choice(["<", "<=", ">", ">=", "=", "!="]), reading, limit)

    def monitor(self, depth: int) -> CheckedMonitor:
        draw = self.random
        while True:
            monitor = CheckedMonitor(
                "m",
                (("x", SORT),),
                self.formula(depth, ["x"]),
                SynchronizationPolicy(),
                draw.choice([Report.VERDICTS, Report.VIOLATIONS]),
                draw.random() < 0.1,
                None,
                robustness=draw.random() < 0.3,
            )
            if is_of_one_object(monitor):
                return monitor

    def trace(self, count: int) -> States:
        """States of one object at irregular times, which is not there at some."""
        valid = np.cumsum(self.numbers.choice([1, 1, 1, 2, 4, 9], count))
        following = np.append(valid[1:], valid[-1] + 99)
        horizon = np.minimum(valid + self.random.choice([0, 0, 1, 3]), following - 1)
        truth, unknown = self.random.choice([0.05, 0.5, 0.95]), self.random.choice([0, 0, 0, 0.1])
        present = self.numbers.random((count, 1)) >= self.random.choice([0, 0, 0.3])
        values = {}
        for term in TERMS:
            known = self.numbers.random((count, 1)) >= unknown
            own = self.numbers.random((count, 1)) < truth
            if term == TERMS[2]:
                own = self.numbers.integers(0, 5, (count, 1)).astype(np.float64)
            values[term] = Values(own, known)
        return States(valid, horizon, {SORT: [""]}, {SORT: present}, values)


class NestedDrawing(Drawing):
    """Operators of time within one another: their parts are decided late, many at once, and in
    another order than that of the states."""

    def formula(self, depth: int, scope: list[str]) -> Formula:
        draw = self.random
        if not depth:
            return self.atom(scope)
        left = self.formula(depth - 1, scope)
        match draw.randrange(10):
            case 0:
                return Not(left)
            case 1:
                return Previous(left)
            case 2:
                return Or(left, self.formula(depth - 1, scope))
            case 3 | 4 | 5:
                return Within(draw.choice([*Temporal]), self.interval(), left)
            case _:
                right = self.formula(draw.randrange(depth), scope)
                return Until(draw.random() < 0.4, self.interval(), left, right)

    def interval(self) -> Interval:
        start = self.random.choice([0, 0, 1, 4])
        if self.random.random() < self.without_end:
            return Interval(start, None)
        return Interval(start, start + self.random.choice([0, 1, 2, 5, 20, 60]))


def joined(traces: list[States]) -> States:
    """The states of all traces."""
    return States(
        np.concatenate([each.valid for each in traces]),
        np.concatenate([each.horizon for each in traces]),
        {SORT: [""]},
        {SORT: np.concatenate([each.present[SORT] for each in traces])},
        {
            term: Values(
                np.concatenate([each.values[term].values for each in traces]),
                np.concatenate([each.values[term].known for each in traces]),
            )
            for term in TERMS
        },
    )


def rows_of(found: Verdicts, report: Report) -> list[tuple[int, ...]]:
    """Those that are reported."""
    columns = (
        found.start_time, found.decided_time, found.left, found.value,
        found.witness_time,
    )  # fmt: skip
    margins = [] if found.robustness is None else [np.nan_to_num(found.robustness, nan=0.5)]
    rows = zip(*(column.tolist() for column in (*columns, *margins)), strict=True)
    return [row for row in rows if report is Report.VERDICTS or row[3] == 0]


class Comparison:
    """The evaluator of parts, and for each part one of its own, over the same states."""

    def __init__(
        self,
        seed: int,
        count: int,
        depth: int,
        without_end: float,
        drawing: type[Drawing] = Drawing,
    ) -> None:
        self.draw = draw = drawing(seed, without_end)
        self.monitor = draw.monitor(depth)
        self.place = f"seed {seed}: {self.monitor}"
        self.compiled = PartEvaluator(self.monitor)
        self.moments: list[MonitorEvaluator] = []
        self.traces = [draw.trace(count) for _ in range(PARTS)]
        self.done = [0] * PARTS
        self.counts = [Counter[int]() for _ in range(PARTS)]
        for part in range(PARTS):
            values = {
                "x": ObjectConstant(OBJECTS[part % 2]),
                "o": ObjectConstant(OBJECTS[0]),
                "wanted": Constant(part != 2, Kind.TRUTH),
            }
            self.compiled.make_room_for(part + 1)
            self.compiled.set_values(part, values)
            own = replace(self.monitor, formula=filled(self.monitor.formula, values))
            self.moments.append(MonitorEvaluator(own))
            objects = {SORT: [OBJECTS[part % 2]]}
            self.traces[part] = replace(self.traces[part], objects=objects)

    def play(self) -> int:
        draw, count = self.draw.random, len(self.traces[0].valid)
        while min(self.done) < count:
            self.push(draw.choice([1, 1, 2, 5, 30]))
            if draw.random() < 0.2:
                self.compiled = pickle.loads(pickle.dumps(self.compiled))  # as a checkpoint does
            if draw.random() < 0.3:
                self.advance()
        if draw.random() < 0.7:
            self.same([each.end() for each in self.moments], self.compiled.end())
        return sum(map(Counter.total, self.counts))

    def push(self, most: int) -> None:
        taken, parts, found = [], [], []
        for part, trace in enumerate(self.traces):
            begin = self.done[part]
            count = min(self.draw.random.randrange(most + 1), len(trace.valid) - begin)
            if count:
                taken.append(trace.take(slice(begin, begin + count)))
                parts.append(np.full(count, part, np.int64))
                self.done[part] += count
                found.append(self.moments[part].push(taken[-1], taken[-1].valid + 1000))
            else:
                found.append(NOTHING)
        if taken:
            states = joined(taken)
            compiled = self.compiled.push(states, states.valid + 1000, np.concatenate(parts))
            self.same(found, compiled)

    def advance(self) -> None:
        """The horizons go on without a state."""
        reached = np.full(len(self.compiled.states_of), TIME_MIN)
        found = []
        for part, (trace, done) in enumerate(zip(self.traces, self.done, strict=True)):
            if 0 < done < len(trace.valid):
                most = int(trace.valid[done]) - 1
                last = int(trace.horizon[done - 1])
                reached[part] = min(last + self.draw.random.randrange(4), most)
            found.append(self.moments[part].advance(int(reached[part])))
        self.same(found, self.compiled.advance(reached))

    def same(self, a: list[Verdicts], b: Verdicts) -> None:
        report = self.monitor.report
        wanted = [(part, *row) for part, each in enumerate(a) for row in rows_of(each, report)]
        rows = list(zip(b.part.tolist(), rows_of(b, report), strict=True))
        assert [(part, *row) for part, row in rows] == wanted, self.place
        for part, (moments, each) in enumerate(zip(self.moments, a, strict=True)):
            self.counts[part].update(each.value.tolist())
            own = self.counts[part]
            assert self.compiled.verdicts_of(part) == {value: own[value] for value in (-1, 0, 1)}
            assert self.compiled.is_open_of(part) == moments.is_open, self.place
            assert self.compiled.states_of[part] == moments.seen
            if moments.seen:
                assert self.compiled.settled()[part] == moments.settled()[0], self.place
        assert self.compiled.is_open == any(each.is_open for each in self.moments)
        assert self.compiled.pending <= sum(each.pending for each in self.moments), self.place


@pytest.mark.parametrize("block", range(6))
def test_short_traces(block: int) -> None:
    seeds = range(block * 50, block * 50 + 50)
    assert sum(Comparison(seed, 9, 3, 0.1).play() for seed in seeds) > 1_000


@pytest.mark.parametrize("block", range(4))
def test_long_traces(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Places, rows and room are made again and again; parts of a batch are taken in turn."""
    monkeypatch.setattr(part_evaluator, "SMALLEST", 4 if block % 2 else part_evaluator.SMALLEST)
    monkeypatch.setattr(part_evaluator, "ROWS", 3 if block % 2 else part_evaluator.ROWS)
    seeds = range(10_000 + block * 12, 10_000 + block * 12 + 12)
    assert sum(Comparison(seed, 150, 2 + block % 3, 0.1).play() for seed in seeds) > 3_000


@pytest.mark.parametrize("block", range(6))
def test_nested_operators_of_time(block: int) -> None:
    seeds = range(40_000 + block * 20, 40_000 + block * 20 + 20)
    depth = 2 + block % 3
    assert sum(Comparison(each, 100, depth, 0.1, NestedDrawing).play() for each in seeds) > 2_000


def test_rows_that_one_state_decides_come_in_any_order() -> None:
    """One in a thousand such formulas shows it: these."""
    seeds = (214, 1_510, 1_601)
    assert sum(Comparison(each, 40, 3, 0.1, NestedDrawing).play() for each in seeds) > 100


@pytest.mark.parametrize("block", range(4))
def test_long_past(block: int) -> None:
    """Of a past without end some states are remembered."""
    seeds = range(20_000 + block * 15, 20_000 + block * 15 + 15)
    assert sum(Comparison(seed, 40, 2 + block % 3, 0.6).play() for seed in seeds) > 1_000


def test_states_of_an_interval_without_end_are_limited() -> None:
    draw = Drawing(1, 0)
    formula = Within(Temporal.ALWAYS, Interval(0, None), OneObjectDrawing.atom(draw, ["x"]))
    monitor = CheckedMonitor(
        "m", (("x", SORT),), formula, SynchronizationPolicy(), Report.VERDICTS, False, None
    )
    trace = draw.trace(12)
    nothing = {
        term: Values(np.ones_like(each.values), each.known | True)
        for term, each in trace.values.items()
    }
    present = {SORT: trace.present[SORT] | True}
    states = States(trace.valid, trace.horizon, trace.objects, present, nothing)
    running = PartEvaluator(monitor, limit=10)
    running.set_values(0, {"wanted": Constant(True, Kind.TRUTH)})
    running.push(states.take(slice(0, 10)))
    assert running.pending == 10
    with pytest.raises(TooManyStates, match="more than 10 states"):
        running.push(states.take(slice(10, 12)))


def test_a_formula_has_more_atoms_than_a_word() -> None:
    draw = Drawing(3, 0)
    trace = draw.trace(60)
    for place in (0, 30, 31, 69):
        parts = [
            Atom("<", Reading("urn:n", (X,), Kind.NUMBER, None), Constant(limit, Kind.NUMBER))
            for limit in [9.0] * 70
        ]
        parts[place] = replace(parts[place], right=Constant(3.0, Kind.NUMBER))
        formula = reduce(And, parts)
        monitor = CheckedMonitor(
            "m", (("x", SORT),), formula, SynchronizationPolicy(), Report.VERDICTS, False, None
        )
        found = PartEvaluator(monitor).push(trace)
        assert 0 < np.count_nonzero(found.value == 0) < len(found)
        wanted = MonitorEvaluator(monitor).push(trace)
        assert rows_of(found, Report.VERDICTS) == rows_of(wanted, Report.VERDICTS)


def test_a_witness_is_the_first_state_that_is_known_by_then() -> None:
    """At 2 s to 4 s it is q at 2 s; at 5 s it is known that p held from 0 s on."""
    p, q = (
        Atom("=", Reading(term, (X,), Kind.TRUTH, None), Constant(True, Kind.TRUTH))
        for term, _ in TERMS[:2]
    )
    formula = Within(
        Temporal.ONCE, Interval(0, 10), Or(Within(Temporal.ALWAYS, Interval(0, 5), p), q)
    )
    monitor = CheckedMonitor(
        "m", (("x", SORT),), formula, SynchronizationPolicy(), Report.VERDICTS, False, None
    )
    valid = np.arange(9)
    known = np.ones((9, 1), np.bool_)
    values = {TERMS[0]: Values(known, known), TERMS[1]: Values(valid[:, None] == 2, known)}
    states = States(valid, valid, {SORT: [""]}, {SORT: known}, values)
    found = PartEvaluator(monitor).push(states)
    by_start = dict(zip(found.start_time.tolist(), found.witness_time.tolist(), strict=True))
    assert by_start == {0: 0, 1: 0, 2: 2, 3: 2, 4: 2, 5: 0, 6: 0, 7: 0, 8: 0}


@pytest.mark.usefixtures("interpreted")
def test_loops_that_are_not_compiled() -> None:
    assert sum(Comparison(seed, 15, 3, 0.3).play() for seed in range(30_000, 30_040)) > 1_000
