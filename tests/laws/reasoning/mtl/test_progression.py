"""Verdicts by moments are those of progression: the value, and the state that decides it, however
the states are cut into batches."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from formula_drawing import OBJECTS, SORT, TERMS, FormulaDrawing
from progression_definition import END, Progression, TooLarge, Trace, bindings, bound_all
from witness_definition import Witness

from dyknow.languages.mtl.ast import Interval, Report, Temporal
from dyknow.languages.mtl.checked import (
    Atom,
    CheckedMonitor,
    Constant,
    Kind,
    ObjectVariable,
    Previous,
    Reading,
    Within,
)
from dyknow.reasoning.mtl import evaluator
from dyknow.reasoning.mtl.evaluator import MonitorEvaluator, TooManyStates
from dyknow.reasoning.states.states import States, Values
from dyknow.streams.policies.policy import SynchronizationPolicy
from dyknow.streams.time import TIME_MIN

MOST_STEPS = 150_000
"""Of the definition for one monitor. Some formulas grow with each state: a minute for 60 states."""


class Drawing(FormulaDrawing):
    """Random formulas, traces and cuts, from one seed."""

    def trace(self, count: int) -> tuple[Trace, dict]:
        valid = list(
            itertools.accumulate(self.random.choice([1, 1, 1, 2, 4, 9]) for _ in range(count))
        )
        slack = self.random.choice([0, 0, 1, 3])
        # Known is at most what the next state allows.
        horizon = [
            min(t + slack, (following or t + 99) - 1)
            for t, following in zip(valid, [*valid[1:], None], strict=True)
        ]
        comes = self.random.random() < 0.5
        present = [
            {SORT: [o for o in OBJECTS if not comes or self.random.random() < 0.7]} for _ in valid
        ]
        unknown = self.random.choice([0, 0, 0.1, 0.4])
        truth = self.random.choice([0.1, 0.5, 0.9])
        table = {}
        for name, arity in TERMS:
            for objects in itertools.product(OBJECTS, repeat=arity):
                for i in range(count):
                    is_there = all(o in present[i][SORT] for o in objects)
                    value = self.random.random() < truth
                    is_known = is_there and self.random.random() >= unknown
                    table[f"urn:{name}", objects, i] = value if is_known else None

        def value(reading, i):
            return table[reading.feature, tuple(a.iri for a in reading.arguments), i]

        return Trace(valid, horizon, value, present), table

    def cuts(self, count: int) -> list[slice]:
        places = sorted({0, count, *self.random.sample(range(count), self.random.randrange(count))})
        return [slice(a, b) for a, b in itertools.pairwise(places)]


def states_of(trace: Trace, table: dict, part: slice, objects: list[str]) -> States:
    rows = range(len(trace.valid))[part]
    values = {}
    for name, arity in TERMS:
        shape = (len(rows), *(len(objects) for _ in range(arity)))
        own, known = np.zeros(shape, np.bool_), np.zeros(shape, np.bool_)
        for at, i in enumerate(rows):
            for places in itertools.product(range(len(objects)), repeat=arity):
                found = table[f"urn:{name}", tuple(objects[p] for p in places), i]
                known[(at, *places)] = found is not None
                own[(at, *places)] = bool(found)
        values[f"urn:{name}", (SORT,) * arity] = Values(own, known)
    there = [[o in trace.present[i][SORT] for o in objects] for i in rows]
    present = np.array(there, np.bool_).reshape(len(rows), len(objects))
    valid, horizon = (np.array(each[part], np.int64) for each in (trace.valid, trace.horizon))
    return States(valid, horizon, {SORT: objects}, {SORT: present}, values)


class LongPast(Drawing):
    """Formulas whose past often has no end."""

    def interval(self) -> Interval:
        if self.random.random() < 0.6:
            return Interval(self.random.choice([0, 0, 1, 3]), None)
        return super().interval()

    def formula(self, depth: int, scope: list[str]):
        found = super().formula(depth, scope)
        if isinstance(found, Within) and not found.operator.is_past and self.random.random() < 0.7:
            is_dual = found.operator is Temporal.ALWAYS
            operator = Temporal.HISTORICALLY if is_dual else Temporal.ONCE
            return Within(operator, found.interval, found.operand)
        return found


def compared(seed: int, count: int, depth: int, drawing: type[Drawing] = Drawing) -> int:
    """Compare the verdicts of a random monitor with their definition; return how many there are, 0
    where the definition takes too long."""
    draw = drawing(seed)
    parameters = tuple((f"x{i}", SORT) for i in range(draw.random.choice([0, 1, 1, 2])))
    formula = draw.formula(depth, [name for name, _ in parameters])
    trace, table = draw.trace(count)
    ends = draw.random.random() < 0.7
    once = draw.random.random() < 0.1
    monitor = CheckedMonitor(
        "m", parameters, formula, SynchronizationPolicy(), Report.VERDICTS, once, None
    )
    running = MonitorEvaluator(monitor)
    found, witnesses = {}, {}
    before = -1
    seen = 1 if draw.random.random() < 0.3 else len(OBJECTS)

    def take(verdicts, last):
        for row in range(len(verdicts)):
            start = trace.valid.index(verdicts.start_time[row])
            decided = trace.valid.index(verdicts.decided_time[row])
            assert before < decided <= last or decided == last
            key = tuple(OBJECTS[i] for i in verdicts.binding[row]), start
            assert key not in found
            found[key] = int(verdicts.value[row]), decided
            witnesses[key] = int(verdicts.witness_time[row])

    for part in draw.cuts(count):
        # New objects get places at the end; they are absent before.
        there = [o for i in range(part.stop) for o in trace.present[i][SORT]]
        seen = max(seen, *(OBJECTS.index(o) + 1 for o in there)) if there else seen
        take(running.push(states_of(trace, table, part, OBJECTS[:seen])), part.stop - 1)
        before = part.stop - 1
    # What the states decide before the end is known does not change then.
    before_end = Progression(replace(trace, horizon=list(trace.horizon)), MOST_STEPS)
    if ends:
        trace.horizon[-1] = END
        take(running.end(), count - 1)
    progression = Progression(trace, MOST_STEPS)
    witness, witness_before = Witness(progression), Witness(before_end)

    def witness_time(closed, start, value):
        known = witness if before_end.verdict(closed, start) is None else witness_before
        state = None if value < 0 else known.of(closed, start, bool(value))
        return TIME_MIN if state is None else trace.valid[state]

    expected = {}
    try:
        for start in range(1 if once else count):
            for objects in bindings(trace.present[start], parameters):
                closed = bound_all(formula, parameters, objects)
                verdict = progression.verdict(closed, start)
                if verdict is not None:
                    expected[objects, start] = verdict
                    if count < 20 or not start % 20:  # in long traces it takes long to define
                        time = witness_time(closed, start, verdict[0])
                        witnessed = witnesses.get((objects, start), time)
                        assert witnessed == time, f"seed {seed}: {closed}"
    except TooLarge:
        return 0
    assert found == expected, f"seed {seed}: {formula}"
    if ends:
        assert len(found) == sum(
            len(list(bindings(trace.present[start], parameters)))
            for start in range(1 if once else count)
        )
    return len(found)


@pytest.mark.parametrize("block", range(12))
def test_short_traces(block: int) -> None:
    depth = 3 + block % 2
    total = sum(compared(seed, 9, depth) for seed in range(block * 50, block * 50 + 50))
    assert total > 200


@pytest.mark.parametrize("block", range(4))
def test_long_traces(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Faults of what is kept show only after many states. Batches are cut by the evaluator, too."""
    monkeypatch.setattr(evaluator, "CELLS", evaluator.CELLS if block % 2 else 4)
    counts = [compared(seed, 150, 2 + block % 3) for seed in range(block * 18, block * 18 + 18)]
    assert sum(counts) > 3_000
    assert counts.count(0) < 3


@pytest.mark.parametrize("block", range(4))
def test_long_past(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a past without end some states are remembered."""
    monkeypatch.setattr(evaluator, "CELLS", evaluator.CELLS if block % 2 else 4)
    seeds = range(block * 60, block * 60 + 15)
    assert sum(compared(seed, 40, 2 + block % 3, LongPast) for seed in seeds) > 300


@pytest.mark.parametrize("operator", [Temporal.ONCE, Temporal.HISTORICALLY])
def test_a_past_without_end_needs_two_states_of_an_object(operator: Temporal) -> None:
    draw = Drawing(1)
    atom = draw.atom(["x"])
    while not isinstance(atom.left, Reading) or atom.left.feature != "urn:p":
        atom = draw.atom(["x"])
    formula = Within(operator, Interval(2, None), atom)
    monitor = CheckedMonitor(
        "m", (("x", SORT),), formula, SynchronizationPolicy(), Report.VERDICTS, False, None
    )
    running = MonitorEvaluator(monitor)
    trace, table = draw.trace(400)
    for start in range(0, 400, 20):
        running.push(states_of(trace, table, slice(start, start + 20), OBJECTS))
        assert running.pending <= 2 + 2 * len(OBJECTS)


def test_the_past_of_an_object_that_comes_later_is_unknown() -> None:
    reading = Reading("urn:p", (ObjectVariable("x"),), Kind.TRUTH, None)
    atom = Atom("=", reading, Constant(True, Kind.TRUTH))
    formula = Within(Temporal.ONCE, Interval(2, None), atom)
    monitor = CheckedMonitor(
        "m", (("x", SORT),), formula, SynchronizationPolicy(), Report.VERDICTS, False, None
    )
    running = MonitorEvaluator(monitor)

    def verdicts(time: int, objects: list[str]) -> list[int]:
        here = np.ones((1, len(objects)), np.bool_)
        values = {("urn:p", (SORT,)): Values(~here, here)}
        at = np.array([time])
        return running.push(States(at, at, {SORT: objects}, {SORT: here}, values)).value.tolist()

    # It is false at each state; those before an object came are unknown.
    assert [verdicts(time, OBJECTS[:1]) for time in range(5)] == [[0]] * 5
    assert [verdicts(time, OBJECTS[:2]) for time in range(5, 9)] == [[0, -1]] * 4


def test_states_that_a_past_interval_without_end_keeps_are_limited() -> None:
    draw = Drawing(1)
    formula = Within(Temporal.ONCE, Interval(0, None), Previous(draw.atom([])))
    monitor = CheckedMonitor(
        "m", (), formula, SynchronizationPolicy(), Report.VERDICTS, False, None
    )
    running = MonitorEvaluator(monitor, limit=10)
    trace, table = draw.trace(12)
    running.push(states_of(trace, table, slice(0, 10), OBJECTS))
    with pytest.raises(TooManyStates, match="more than 10 states"):
        running.push(states_of(trace, table, slice(10, 12), OBJECTS))
    assert running.pending == 10
