"""What a monitor reports over samples is what states and progression by their definitions give,
however the samples are cut into batches."""

from __future__ import annotations

from collections import Counter
from random import Random

import numpy as np
import pytest
from formula_drawing import OBJECTS, FormulaDrawing
from monitoring_definition import MonitoringDefinition, TickedStates, Verdict
from state_cases import NARROW, WIDE, StateCase
from state_definition import LEAST, Sample

from dyknow.languages.mtl.ast import Interval, Report, Temporal
from dyknow.languages.mtl.checked import (
    And,
    Atom,
    CheckedMonitor,
    Constant,
    Kind,
    Not,
    ObjectConstant,
    ObjectVariable,
    Or,
    Previous,
    Quantified,
    Reading,
    Truth,
    Within,
)
from dyknow.reasoning.mtl.formulas import bound_sorts, parts_of, readings_of
from dyknow.reasoning.mtl.monitoring import Monitoring, Reported
from dyknow.reasoning.mtl.nodes import term_of
from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    Duration,
    SynchronizationPolicy,
)


class Case(FormulaDrawing, StateCase):
    """A random monitor, and samples for it."""

    def __init__(self, seed: int) -> None:
        super().__init__(seed)
        draw = self.random
        self.is_alone = draw.random() < 0.4
        count = 1 if self.is_alone else draw.choice([0, 1, 1, 2])
        self.parameters = tuple((f"x{i}", self.sort()) for i in range(count))
        names = [name for name, _ in self.parameters]
        while not self.is_read(formula := self.whole(names)):
            pass
        self.formula_drawn = formula
        self.wider = draw.choice([{NARROW: (WIDE,)}, {}])
        self.period = None if self.is_alone else draw.choice([None, 1, 3])
        start = draw.choice([None, None, None, 0, 2])
        self.duration = Duration(start, draw.choice([None, None, None, 9, 20]))
        self.delay = draw.choice([None, None, 0, 2, 5])
        self.approximation = draw.choice([*Approximation])
        self.present_for = draw.choice([None, None, 0, 4])
        self.report = draw.choice([*Report])
        self.once = draw.random() < 0.15
        sources = draw.choice([1, 2, 2, 3])
        self.streams = [self.stream(source) for source in range(sources)]
        self.ended = self.ends(draw)
        self.after = 1 + self.latest
        self.ticks = self.drawn_ticks()
        last = [each[-1].available if each else LEAST for each in self.streams]
        waited = [t for t, end in zip(last, self.ended, strict=True) if end is None]
        self.watermark = max([min(waited, default=self.after), *self.ticks])
        self.moment = self.watermark + draw.choice([0, 7]) if None not in self.ended else None

    def whole(self, names: list[str]):
        depth = self.random.choice([1, 2, 2, 3])
        if self.is_alone or self.random.random() < 0.6:
            return self.formula(depth, names)
        inner = self.formula(depth, [*names, "y"])
        return Quantified(self.random.random() < 0.5, "y", self.sort(), inner)

    def sort(self) -> str:
        return self.random.choice([WIDE, NARROW])

    def atom(self, scope: list[str]):
        draw = self.random
        if self.is_alone:
            if draw.random() < 0.1:
                return super().atom(scope)
            reading = self.reading("pq"[draw.random() < 0.4], [ObjectVariable(scope[0])])
        elif scope and draw.random() < 0.2:
            sides = [ObjectVariable(draw.choice(scope)), ObjectConstant(draw.choice(OBJECTS))]
            reading = self.reading("near", draw.sample(sides, 2))
        else:
            return super().atom(scope)
        return Atom("=", reading, Constant(True, Kind.TRUTH))

    def reading(self, name: str, arguments) -> Reading:
        return Reading(f"urn:{name}", tuple(arguments), Kind.TRUTH, None)

    def is_read(self, formula) -> bool:
        """Whether each variable is read, so that samples name its objects; in a case that is alone
        whether there are states of each object."""
        arguments = [a for reading in readings_of(formula) for a in reading.arguments]
        bound = bound_sorts(formula)
        named = {a.name for a in arguments if isinstance(a, ObjectVariable)}
        self.sorts = {**dict(self.parameters), **bound}
        self.terms = sorted({term_of(reading, self.sorts) for reading in readings_of(formula)})
        if not self.terms or not self.sorts.keys() <= named:
            return False
        own = all(r.arguments == (ObjectVariable("x0"),) for r in readings_of(formula))
        return not self.is_alone or (own and not bound)

    def stream(self, source: int) -> list[Sample]:
        draw = self.random
        terms = draw.sample(self.terms, draw.randint(1, len(self.terms)))
        available = draw.choice([0, 0, 1, 3])
        delays = draw.choice([[0], [0, 0, 1], [0, 1, 2, 4, 7], [0, 0, 1, -1, -3]])
        truth = draw.choice([0.1, 0.5, 0.9])
        samples = []
        for _ in range(draw.choice([0, 1, 4, 12, 20])):
            term = draw.choice(terms)
            iris = tuple(a[1:-1] if a.startswith("<") else draw.choice(OBJECTS) for a in term[1])
            valid = available - draw.choice(delays)
            samples.append(Sample(source, term, available, valid, iris, draw.random() < truth))
            available += draw.choice([0, 0, 1, 1, 2, 5])
        return samples

    def drawn_ticks(self) -> list[int]:
        """Moments that the clock brings, not the samples."""
        instants = sorted({s.available for each in self.streams for s in each})
        free = [
            t
            for t in range(2, self.after + 15)
            if not any(t - 1 <= i < t for i in instants) and any(i < t for i in instants)
        ]
        count = min(len(free), self.random.choice([0, 0, 1, 3]))
        return sorted(self.random.sample(free, count))

    @property
    def monitor(self) -> CheckedMonitor:
        return CheckedMonitor(
            "m",
            self.parameters,
            self.formula_drawn,
            self.policy,
            self.report,
            self.once,
            self.present_for,
        )

    @property
    def has_own_states(self) -> bool:
        own = (ObjectVariable("x0"),)
        waiting = [self.formula_drawn]
        for node in waiting:
            waiting += parts_of(node)
        return (
            self.period is None
            and len(self.parameters) == 1
            and not bound_sorts(self.formula_drawn)
            and all(r.arguments == own for r in readings_of(self.formula_drawn))
        )

    @property
    def definition(self) -> MonitoringDefinition:
        states = self.states_by(TickedStates, ticks=self.ticks)
        return MonitoringDefinition(self.monitor, states, self.has_own_states, self.moment)


class Playing:
    """Delivers the samples of a case in random pieces, with random watermarks, and all of its
    ticks."""

    def __init__(self, case: Case, cuts: int) -> None:
        self.case = case
        self.random = Random(cuts)
        self.monitoring = Monitoring(case.monitor, len(case.streams), case.wider)
        assert self.monitoring.terms == tuple(case.terms)
        assert self.monitoring.has_own_states == case.has_own_states
        self.found: list[Verdict] = []
        self.is_over = False
        """Then a unit ends its stream."""
        self._given = [0] * len(case.streams)
        self._ended: set[int] = set()
        self._watermark = LEAST

    def play(self) -> None:
        case = self.case
        for tick in case.ticks:
            self._until(tick)
            self._advance(tick, by_clock=True)
        self._until(case.after)
        if self._watermark < case.watermark:
            self._advance(case.watermark)
        if case.moment is not None and not self.is_over:
            if self.random.random() < 0.5:
                # Nothing is left of it.
                self._take(self.monitoring.advance(case.watermark))
            self._take(self.monitoring.finish(case.moment))

    def _until(self, limit: int) -> None:
        """Deliver all samples that are available before ``limit``."""
        sources = range(len(self.case.streams))
        for _ in range(self.random.choice([0, 1, 3, 9, 30])):
            self._deliver(self.random.choice(sources), self.random.choice([0, 1, 1, 2, 5]), limit)
            waited = [self._last(source) for source in sources if source not in self._ended]
            most = min([*waited, limit])
            least = self._watermark + 1
            if self.random.random() < 0.5 and waited and least <= most:
                instants = {s.available for each in self.case.streams for s in each}
                choices = [t for t in instants if least <= t <= most]
                self._advance(self.random.choice([*choices, most]))
        for source in self.random.sample(sources, len(sources)):
            self._deliver(source, 99, limit)
            self._end(source)

    def _last(self, source: int) -> int:
        given = self._given[source]
        return self.case.streams[source][given - 1].available if given else LEAST

    def _deliver(self, source: int, count: int, limit: int) -> None:
        given = self._given[source]
        part = self.case.streams[source][given : given + count]
        part = [s for s in part if s.available < limit]
        self._given[source] += len(part)
        if part:
            times = (np.array([getattr(s, n) for s in part]) for n in ("available", "valid"))
            self.monitoring.came(source, *times)
            for term in {s.term: None for s in part}:
                self._add(source, term, [s for s in part if s.term == term])
        if self.random.random() < 0.5:
            self._end(source)

    def _end(self, source: int) -> None:
        is_last = self._given[source] == len(self.case.streams[source])
        end = self.case.ended[source]
        if is_last and end is not None:
            self.monitoring.ended(source, end)
            self._ended.add(source)

    def _add(self, source: int, term, part: list[Sample]) -> None:
        variables = [i for i, sort in enumerate(term[1]) if not sort.startswith("<")]
        place = self.monitoring.place
        places = [
            [place(term, v, sample.objects[i]) for v, i in enumerate(variables)] for sample in part
        ]
        self.monitoring.add(
            source,
            term,
            np.array([s.available for s in part]),
            np.array([s.valid for s in part]),
            np.array(places, np.int64).reshape(len(part), len(variables)),
            np.array([s.value for s in part], np.bool_),
        )

    def _advance(self, watermark: int, *, by_clock: bool = False) -> None:
        self._watermark = watermark
        if not self.is_over:
            self._take(self.monitoring.advance(watermark, by_clock=by_clock))
            self.is_over = self.monitoring.is_over

    def _take(self, found: Reported) -> None:
        times = found.available, found.valid, found.value, found.decided, found.last
        columns = [column.tolist() for column in times]
        assert found.objects.shape == (len(self.case.parameters), len(found))
        for i, (available, valid, value, decided, last) in enumerate(zip(*columns, strict=True)):
            objects = tuple(found.objects[:, i])
            self.found.append(Verdict(available, objects, valid, value, decided, last))


def compared(seed: int) -> Counter[str]:
    """Compare two plays of a case with the definition; count what is in it."""
    case = Case(seed)
    definition = case.definition
    expected = definition.reported()
    states = sum(len(each.states()) for each in definition.timelines())
    if case.moment is not None:
        states += sum(len(each.last_states(case.moment)) for each in definition.timelines())
    late = len(definition.states.late(definition.states.before_watermark()))
    for cuts in (seed, seed + 1_000_000):
        played = Playing(case, cuts)
        played.play()
        assert played.found == expected, (seed, cuts)
        assert len({(v.objects, v.start) for v in played.found}) == len(played.found), seed
        if not played.is_over:
            assert played.monitoring.states == states, seed
            assert played.monitoring.late == late, seed
    kinds = [case.report, *(["once"] if case.once else [])]
    kinds += ["own"] if case.has_own_states else []
    kinds += ["ticks"] if any(v.available in case.ticks for v in expected) else []
    kinds += [f"{len(case.parameters)} parameters"]
    kinds += ["grid"] if case.period is not None else []
    kinds += ["quantified"] if bound_sorts(case.formula_drawn) else []
    kinds += ["ended"] if any(v.available == case.moment for v in expected) else []
    kinds += ["long runs"] if any(v.last > v.start for v in expected) else []
    values = {f"verdict {v.value}" for v in expected}
    return Counter({str(kind): bool(expected) for kind in (*kinds, *values)}, all=len(expected))


CONTENTS = (
    *map(str, Report),
    "once",
    "own",
    "ticks",
    "0 parameters",
    "1 parameters",
    "2 parameters",
    "grid",
    "quantified",
    "ended",
    "long runs",
    *(f"verdict {value}" for value in (1, 0, -1)),
)


@pytest.mark.parametrize("block", range(8))
def test_monitoring(block: int) -> None:
    found: Counter[str] = Counter()
    for seed in range(block * 150, block * 150 + 150):
        found += compared(seed)
    assert found["all"] > 500, found
    assert all(found[each] > 5 for each in CONTENTS), found


def rows_told(formula, report: Report, rows, *, once: bool = False) -> list[tuple]:
    """What samples (time, object, p) give, each by itself, and their end: (available, object,
    start, value, last)."""
    policy = SynchronizationPolicy(AnyChange(), 0)
    monitor = CheckedMonitor("m", (("x0", WIDE),), formula, policy, report, once, None)
    monitoring = Monitoring(monitor, 1)
    found = []
    (term,) = monitoring.terms
    for time, name, value in rows:
        times, places = np.array([time]), np.array([[monitoring.place(term, 0, name)]])
        monitoring.came(0, times, times)
        monitoring.add(0, term, times, times, places, np.array([value]))
        found.append(monitoring.advance(time))
        if monitoring.is_over:
            break
    else:
        monitoring.ended(0, rows[-1][0])
        found += [monitoring.advance(rows[-1][0] + 1), monitoring.finish(rows[-1][0])]
    return [
        told
        for each in found
        for told in zip(
            each.available.tolist(),
            *each.objects,
            each.valid.tolist(),
            each.value.tolist(),
            each.last.tolist(),
            strict=True,
        )
    ]


P = Atom(
    "=",
    Reading("urn:p", (ObjectVariable("x0"),), Kind.TRUTH, None),
    Constant(True, Kind.TRUTH),
)


def test_changes_before_the_first_state() -> None:
    rows = [(1, "a", True), (3, "b", False), (4, "a", False)]
    told = [told[1:] for told in rows_told(P, Report.CHANGES, rows)]
    assert sorted(told) == [("a", 1, 1, 1), ("a", 4, 0, 4), ("b", 3, 0, 3)]


def test_a_run_that_is_open_at_the_end_is_available_then() -> None:
    rows = [(1, "a", True), (1, "b", True), (4, "a", True), (5, "b", False)]
    assert rows_told(P, Report.CHANGES, rows) == [
        (5, "b", 1, 1, 1),
        (5, "a", 1, 1, 4),
        (5, "b", 5, 0, 5),
    ]


def test_a_run_is_known_with_those_before_it() -> None:
    never = Within(Temporal.EVENTUALLY, Interval(0, 9), Truth(False))
    rows = [(1, "a", True), (2, "a", False), (3, "a", False), (12, "a", False)]
    formula = Or(And(P, never), And(Not(P), Previous(P)))
    assert rows_told(formula, Report.CHANGES, rows) == [
        (12, "a", 1, 0, 1),
        (12, "a", 2, 1, 2),
        (12, "a", 3, 0, 12),
    ]


def test_a_run_is_known_with_its_starts() -> None:
    """The first start is decided at 12, the second one at once."""
    never = Within(Temporal.EVENTUALLY, Interval(0, 9), Truth(False))
    rows = [(1, "a", True), (2, "a", False), (3, "a", False), (12, "a", False)]
    formula = Or(And(P, never), And(Not(P), Previous(Previous(P))))
    assert rows_told(formula, Report.CHANGES, rows) == [
        (12, "a", 1, 0, 2),
        (12, "a", 3, 1, 3),
        (12, "a", 12, 0, 12),
    ]


def test_a_single_start_is_a_run() -> None:
    rows = [(1, "a", True), (2, "a", False), (5, "b", False), (6, "b", True)]
    assert rows_told(P, Report.CHANGES, rows, once=True) == [(1, "a", 1, 1, 1), (5, "b", 5, 0, 5)]


def test_each_object_has_a_single_start() -> None:
    rows = [(1, "a", True), (2, "a", False), (5, "b", False), (6, "b", True)]
    assert rows_told(P, Report.VERDICTS, rows, once=True) == [(1, "a", 1, 1, 1), (5, "b", 5, 0, 5)]
