"""Robustness is that of the definition: of each start once its intervals are over, however the
states are cut into batches; its sign is that of the verdict."""

from __future__ import annotations

import itertools
from collections import Counter
from math import inf, isnan

import numpy as np
import pytest
from formula_drawing import OBJECTS, SORT, TERMS, FormulaDrawing
from progression_definition import END, Progression, Trace, bindings, bound_all
from robustness_definition import Robustness

from dyknow.languages.mtl.ast import Report
from dyknow.languages.mtl.checked import (
    Atom,
    Calculation,
    CheckedMonitor,
    Constant,
    Kind,
    ObjectVariable,
    Reading,
)
from dyknow.reasoning.mtl.evaluator import MonitorEvaluator
from dyknow.reasoning.mtl.formulas import parts_of, reach_of
from dyknow.reasoning.mtl.nodes import OPERATORS
from dyknow.reasoning.states.states import States, Values
from dyknow.streams.policies.policy import SynchronizationPolicy
from dyknow.streams.time import SECOND, TIME_MAX, TIME_MIN


class Drawing(FormulaDrawing):
    """Formulas over numbers, and traces of them."""

    def atom(self, scope: list[str]):
        drawn = super().atom(scope)
        if not isinstance(drawn.left, Reading):
            return drawn
        operator = self.random.choice(["<", "<=", ">", ">=", "=", "!="])
        limit = Constant(float(self.random.choice([-2, 0, 1])), Kind.NUMBER)
        left = Reading(drawn.left.feature, drawn.left.arguments, Kind.NUMBER, None)
        if self.random.random() < 0.2:
            left = Calculation(self.random.choice("+-*"), left, Constant(2.0, Kind.NUMBER))
        # Infinite numbers meet each other, and have no distance.
        is_doubled = self.random.random() < 0.2
        twice = Calculation("*", left, Constant(2.0, Kind.NUMBER))
        sides = [left, twice if is_doubled else limit]
        if self.random.random() < 0.2:
            sides.reverse()
        return Atom(operator, *sides)

    def trace(self, count: int) -> Trace:
        draw = self.random
        valid = list(itertools.accumulate(draw.choice([1, 1, 1, 2, 4, 9]) for _ in range(count)))
        slack = draw.choice([0, 0, 1, 3])
        horizon = [
            min(t + slack, (following or t + 99) - 1)
            for t, following in zip(valid, [*valid[1:], None], strict=True)
        ]
        comes = draw.random() < 0.5
        present = [{SORT: [o for o in OBJECTS if not comes or draw.random() < 0.7]} for _ in valid]
        unknown = draw.choice([0, 0, 0.1, 0.4])
        self.table = {}
        for name, arity in TERMS:
            for objects in itertools.product(OBJECTS, repeat=arity):
                for i in range(count):
                    is_there = all(o in present[i][SORT] for o in objects)
                    is_known = is_there and draw.random() >= unknown
                    number = draw.choice([-4.0, -2.0, -0.5, 0.0, 1.0, 3.25, inf, -inf])
                    self.table[f"urn:{name}", objects, i] = number if is_known else None
        return Trace(valid, horizon, self.value, present)

    def value(self, reading, i):
        return self.table[reading.feature, tuple(a.iri for a in reading.arguments), i]

    def states(self, trace: Trace, part: slice) -> States:
        rows = range(len(trace.valid))[part]
        values = {}
        for name, arity in TERMS:
            found = [
                [self.table[f"urn:{name}", o, i] for o in itertools.product(OBJECTS, repeat=arity)]
                for i in rows
            ]
            shape = (len(rows), *(len(OBJECTS) for _ in range(arity)))
            numbers = [[0.0 if v is None else v for v in row] for row in found]
            known = [[v is not None for v in row] for row in found]
            values[f"urn:{name}", (SORT,) * arity] = Values(
                np.array(numbers).reshape(shape), np.array(known).reshape(shape)
            )
        present = [[o in trace.present[i][SORT] for o in OBJECTS] for i in rows]
        valid, horizon = (np.array(each[part], np.int64) for each in (trace.valid, trace.horizon))
        return States(valid, horizon, {SORT: tuple(OBJECTS)}, {SORT: np.array(present)}, values)

    def cuts(self, count: int) -> list[slice]:
        places = sorted({0, count, *self.random.sample(range(count), self.random.randrange(count))})
        return [slice(a, b) for a, b in itertools.pairwise(places)]


class Truths:
    """The trace as progression reads it: it knows atoms, not numbers."""

    def __init__(self, trace: Trace) -> None:
        self.margins = Robustness(trace)

    def replaced(self, f):
        """The formula with a reading of its own for each atom over numbers."""
        if isinstance(f, Atom) and f.operator in OPERATORS and not hasattr(f.left, "iri"):
            return Atom("=", f, Constant(True, Kind.TRUTH))
        if not parts_of(f) or isinstance(f, Atom):
            return f
        fields = {n: getattr(f, n) for n in f.__dataclass_fields__}
        changed = {
            n: self.replaced(v) if any(v is part for part in parts_of(f)) else v
            for n, v in fields.items()
        }
        return type(f)(**changed)

    def value(self, atom, i):
        a, b = (self.margins.value(side, i) for side in (atom.left, atom.right))
        return None if a is None or b is None else bool(OPERATORS[atom.operator](a, b))


def compared(seed: int, count: int, depth: int) -> Counter[str]:
    draw = Drawing(seed)
    parameters = tuple((f"x{i}", SORT) for i in range(draw.random.choice([0, 1, 1, 2])))
    formula = draw.formula(depth, [name for name, _ in parameters])
    trace = draw.trace(count)
    ends = draw.random.random() < 0.7
    monitor = CheckedMonitor(
        "m", parameters, formula, SynchronizationPolicy(), Report.VERDICTS, False, None,
        robustness=True,
    )  # fmt: skip
    evaluator = MonitorEvaluator(monitor)
    found = {}

    def take(verdicts):
        assert verdicts.robustness is None or len(verdicts.robustness) == len(verdicts)
        for row in range(len(verdicts)):
            names = tuple(OBJECTS[i] for i in verdicts.binding[row])
            key = names, trace.valid.index(verdicts.start_time[row])
            assert key not in found
            margin = float(verdicts.robustness[row])
            decided = trace.valid.index(verdicts.decided_time[row])
            found[key] = int(verdicts.value[row]), decided, margin

    for part in draw.cuts(count):
        take(evaluator.push(draw.states(trace, part)))
    if ends:
        trace.horizon[-1] = END
        take(evaluator.end())
    reach = reach_of(formula)
    horizon = list(itertools.accumulate(trace.horizon, max))
    truths = Truths(trace)
    progression = Progression(Trace(trace.valid, horizon, truths.value, trace.present))
    margins = Robustness(trace)
    told: Counter[str] = Counter()
    for start in range(count):
        over = [
            i
            for i in range(start, count)
            if horizon[i] == END or (reach is not None and horizon[i] >= trace.valid[start] + reach)
        ]
        for objects in bindings(trace.present[start], parameters):
            closed = bound_all(formula, parameters, objects)
            if not over:
                assert (objects, start) not in found
                continue
            value, decided, margin = found.pop((objects, start))
            low, high = (margins.of(closed, start, upper) for upper in (False, True))
            verdict = progression.verdict(truths.replaced(closed), start)
            assert verdict is not None
            assert (value, decided) == (verdict[0], max(verdict[1], over[0]))
            if value == -1:
                assert isnan(margin)
                assert low <= 0 <= high
            else:
                assert margin == (low if value == 1 else high), (seed, closed, start)
                assert margin >= 0 if value == 1 else margin <= 0
                assert str(margin) != "-0.0"
            told.update([str(value), "infinite" if abs(margin) == inf else "finite"])
            told["zero"] += margin == 0
    assert not found
    return told


@pytest.mark.parametrize("block", range(6))
def test_short_traces(block: int) -> None:
    told: Counter[str] = Counter()
    for seed in range(block * 40, block * 40 + 40):
        told += compared(seed, 8, 3)
    assert all(told[each] > 20 for each in ("1", "0", "-1", "finite", "infinite", "zero")), told


@pytest.mark.parametrize("block", range(2))
def test_long_traces(block: int) -> None:
    for seed in range(1_000 + block * 10, 1_010 + block * 10):
        compared(seed, 60, 2)


@pytest.mark.parametrize(("operator", "verdict"), [("<", 1), (">=", 0), ("=", 0), ("!=", 1)])
def test_times_at_both_ends_of_time(operator: str, verdict: int) -> None:
    feature = "urn:seen", (SORT,)
    seen = Reading(feature[0], (ObjectVariable("x"),), Kind.TIME, None)
    monitor = CheckedMonitor(
        "m", (("x", SORT),), Atom(operator, seen, Constant(TIME_MAX, Kind.TIME)),
        SynchronizationPolicy(), Report.VERDICTS, False, None, robustness=True,
    )  # fmt: skip
    there = np.ones((1, 1), np.bool_)
    time = np.zeros(1, np.int64)
    values = {feature: Values(np.full((1, 1), TIME_MIN, np.int64), there)}
    states = States(time, time, {SORT: (OBJECTS[0],)}, {SORT: there}, values)
    found = MonitorEvaluator(monitor).push(states)
    assert found.value.tolist() == [verdict]
    distance = (TIME_MAX - TIME_MIN) / SECOND
    assert found.robustness == pytest.approx([distance if verdict else -distance])
