"""Verdicts from tables of bits are those by moments, in the same order and with the same witnesses,
however the states are cut into batches, and whichever objects come."""

from __future__ import annotations

import itertools
import pickle

import numpy as np
import pytest
from formula_drawing import SORT, FormulaDrawing

from dyknow.languages.mtl.ast import Interval, Report, Temporal
from dyknow.languages.mtl.checked import CheckedMonitor, Or, Within
from dyknow.reasoning.mtl.bits import evaluator as sliced_evaluator
from dyknow.reasoning.mtl.bits.evaluator import SlicedEvaluator, is_sliced
from dyknow.reasoning.mtl.evaluator import MonitorEvaluator, TooManyStates, Verdicts
from dyknow.reasoning.states.states import States, Values
from dyknow.streams.jit import JIT
from dyknow.streams.policies.policy import SynchronizationPolicy

pytestmark = pytest.mark.skipif(not JIT, reason="tables of bits need compiled loops")


class Drawing(FormulaDrawing):
    """Random monitors, and states of many objects, from one seed."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        self.numbers = np.random.default_rng(seed)

    def monitor(self, depth: int) -> CheckedMonitor:
        """One whose verdicts can be had from tables of bits."""
        while True:
            parameters = tuple((f"x{i}", SORT) for i in range(self.random.choice([0, 1, 1])))
            monitor = CheckedMonitor(
                "m",
                parameters,
                self.formula(depth, [name for name, _ in parameters]),
                SynchronizationPolicy(),
                self.random.choice([Report.VERDICTS, Report.VIOLATIONS]),
                self.random.random() < 0.1,
                None,
            )
            if is_sliced(monitor):
                return monitor

    def states(self, count: int, objects: int) -> States:
        """States at irregular times. Some objects come late, or go for a while."""
        valid = np.cumsum(self.numbers.choice([1, 1, 1, 2, 4, 9], count))
        following = np.append(valid[1:], valid[-1] + 99)
        horizon = np.minimum(valid + self.random.choice([0, 0, 1, 3]), following - 1)
        came = np.sort(self.numbers.integers(0, self.random.choice([1, count, count]), objects))
        present = np.arange(count)[:, None] >= came
        if self.random.random() < 0.5:
            present &= self.numbers.random((count, objects)) < 0.8
        unknown, truth = self.random.choice([0, 0, 0, 0.02]), self.random.choice([0.05, 0.5, 0.95])

        def values(shape: tuple[int, ...], there: np.ndarray | bool) -> Values:
            known = there & (self.numbers.random(shape) >= unknown)
            return Values(self.numbers.random(shape) < truth, known)

        table = {
            ("urn:p", (SORT,)): values(present.shape, present),
            ("urn:q", (SORT,)): values(present.shape, present),
            ("urn:r", ()): values((count,), True),
            ("urn:near", (SORT, SORT)): values(
                (count, objects, objects), present[:, :, None] & present[:, None, :]
            ),
        }
        names = [f"urn:o{i}" for i in range(objects)]
        return States(valid, horizon, {SORT: names}, {SORT: present}, table)

    def cuts(self, count: int) -> list[slice]:
        places = sorted({0, count, *self.random.sample(range(count), self.random.randrange(count))})
        return [slice(a, b) for a, b in itertools.pairwise(places)]


def columns_of(states: States, count: int) -> States:
    """The states of the first objects."""
    values = {}
    for term, each in states.values.items():
        places = (slice(None), *(slice(count) for _ in term[1]))
        values[term] = Values(each.values[places], each.known[places])
    present = {sort: there[:, :count] for sort, there in states.present.items()}
    names = {sort: each[:count] for sort, each in states.objects.items()}
    return States(states.valid, states.horizon, names, present, values)


def rows_of(found: Verdicts, report: Report) -> list[tuple]:
    columns = (
        found.start_time, found.decided_time, found.left, found.value, found.witness_time,
        *found.binding.T,
    )  # fmt: skip
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return [row for row in rows if report is Report.VERDICTS or row[3] == 0]


def counts_of(found: Verdicts) -> dict[int, int]:
    return {
        value: int((found.value == value).sum()) + found.unreported.get(value, 0)
        for value in (-1, 0, 1)
    }


def compared(seed: int, count: int, objects: int, depth: int) -> int:
    draw = Drawing(seed)
    monitor = draw.monitor(depth)
    states = draw.states(count, objects)
    moments, bits = MonitorEvaluator(monitor), SlicedEvaluator(monitor)
    seen, verdicts = 0, 0

    def same(a: Verdicts, b: Verdicts) -> None:
        nonlocal verdicts
        place = f"seed {seed}: {monitor}"
        assert rows_of(b, monitor.report) == rows_of(a, monitor.report), place
        assert counts_of(b) == counts_of(a), place
        assert bits.is_open == moments.is_open, place
        assert (bits.settled() == moments.settled()).all(), place
        assert bits.pending <= moments.pending, place
        verdicts += len(a)

    for cut in draw.cuts(count):
        there = np.flatnonzero(states.present[SORT][cut].any(axis=0))
        seen = max(seen, 1, *(there + 1)) if len(there) else max(seen, 1)
        part = columns_of(states.take(cut), seen)
        same(moments.push(part), bits.push(part))
        if draw.random.random() < 0.2:
            bits = pickle.loads(pickle.dumps(bits))  # as a checkpoint does
        if draw.random.random() < 0.3:
            # The horizon goes on without a state.
            last = cut.stop - 1
            most = int(states.valid[last + 1]) - 1 if cut.stop < count else 2**40
            reached = min(int(states.horizon[last]) + draw.random.randrange(4), most)
            same(moments.advance(reached), bits.advance(reached))
    if draw.random.random() < 0.7:
        same(moments.end(), bits.end())
    return verdicts


@pytest.mark.parametrize("block", range(6))
def test_short_traces(block: int) -> None:
    seeds = range(block * 50, block * 50 + 50)
    assert sum(compared(seed, 9, 3, 3) for seed in seeds) > 200


@pytest.mark.parametrize("block", range(4))
def test_long_traces(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rows are moved to the front again and again."""
    monkeypatch.setattr(sliced_evaluator, "ROWS", 4 if block % 2 else sliced_evaluator.ROWS)
    monkeypatch.setattr(sliced_evaluator, "CELLS", 8 if block % 2 else sliced_evaluator.CELLS)
    seeds = range(10_000 + block * 12, 10_000 + block * 12 + 12)
    assert sum(compared(seed, 150, 4, 2) for seed in seeds) > 300


@pytest.mark.parametrize("block", range(4))
def test_many_objects(block: int) -> None:
    """Objects fill several words, and need more of them as they come."""
    seeds = range(20_000 + block * 8, 20_000 + block * 8 + 8)
    assert sum(compared(seed, 40, 150, 2) for seed in seeds) > 3_000


@pytest.mark.parametrize("report", [Report.VERDICTS, Report.VIOLATIONS])
def test_that_of_two_parts_the_last_one_has_the_witness(report: Report) -> None:
    """Where both parts of a disjunction have to fail, some objects wait for one, some for the
    other."""
    draw = Drawing(3)
    parts = [Within(Temporal.ALWAYS, Interval(0, end), draw.atom(["x0"])) for end in (4, 9)]
    monitor = CheckedMonitor(
        "m", (("x0", SORT),), Or(*parts), SynchronizationPolicy(), report, False, None
    )
    states = draw.states(80, 100)
    found = SlicedEvaluator(monitor).push(states)
    assert len(found) > 50
    assert rows_of(found, report) == rows_of(MonitorEvaluator(monitor).push(states), report)


def test_that_verdicts_need_more_room_than_there_is() -> None:
    """All verdicts of a state leave together, however many they are."""
    draw = Drawing(1)
    formula = Within(Temporal.EVENTUALLY, Interval(0, 30), draw.atom(["x0"]))
    monitor = CheckedMonitor(
        "m", (("x0", SORT),), formula, SynchronizationPolicy(), Report.VERDICTS, False, None
    )
    states = draw.states(60, 100)
    moments, bits = MonitorEvaluator(monitor), SlicedEvaluator(monitor)
    for part in (states.take(slice(0, 1)), states.take(slice(1, 60))):
        assert rows_of(bits.push(part), Report.VERDICTS) == rows_of(
            moments.push(part), Report.VERDICTS
        )


def test_states_of_an_interval_without_end_are_limited() -> None:
    draw = Drawing(2)
    formula = Within(Temporal.EVENTUALLY, Interval(0, None), draw.atom([]))
    never = Or(formula, formula)
    monitor = CheckedMonitor("m", (), never, SynchronizationPolicy(), Report.VERDICTS, False, None)
    states = draw.states(200, 1)
    nothing = {
        term: Values(each.values & False, each.known | True) for term, each in states.values.items()
    }
    states = States(states.valid, states.horizon, states.objects, states.present, nothing)
    running = SlicedEvaluator(monitor, limit=100)
    running.push(states.take(slice(0, 100)))
    with pytest.raises(TooManyStates, match="more than 100 states"):
        running.push(states.take(slice(100, 200)))


@pytest.mark.usefixtures("interpreted")
def test_loops_that_are_not_compiled() -> None:
    assert sum(compared(seed, 9, 3, 3) for seed in range(30_000, 30_040)) > 200
    assert sum(compared(seed, 9, 70, 2) for seed in range(30_040, 30_050)) > 200
