"""The states of a formula are those of the definition, however the samples are cut into batches."""

from __future__ import annotations

import itertools
import random
from collections import Counter

import numpy as np
import pytest
from state_cases import NARROW, WIDE, StateCase
from state_definition import LEAST, Sample, State, StateDefinition

from dyknow.reasoning.states import state_maker
from dyknow.reasoning.states.departures import Departures
from dyknow.reasoning.states.kept_samples import Rows
from dyknow.reasoning.states.state_maker import MadeStates, StateMaker
from dyknow.streams.policies.policy import (
    Approximation,
    Duration,
)

TERMS = [
    ("urn:n", ()),
    ("urn:p", (NARROW,)),
    ("urn:q", (WIDE,)),
    ("urn:near", (NARROW, NARROW)),
    ("urn:near", (NARROW, WIDE)),
    ("urn:near", (NARROW, "<urn:a>")),
    ("urn:near", ("<urn:a>", WIDE)),
]
TEXT = TERMS[2]
OBJECTS = ["urn:a", "urn:b", "urn:c"]


class Drawing(StateCase):
    """A random case, from one seed."""

    def __init__(self, seed: int) -> None:
        draw = self.random = random.Random(seed)
        self.base = draw.choice([0, 0, 1_700_000_000_000_000_000])
        self.terms = draw.sample(TERMS, draw.choice([1, 1, 2, 3]))
        self.wider = draw.choice([{NARROW: (WIDE,)}, {NARROW: (WIDE,)}, {}])
        sources = draw.choice([1, 2, 2, 3])
        self.streams = [self.stream(source) for source in range(sources)]
        start = draw.choice([None, None, None, 0, 2])
        end = draw.choice([None, None, None, 6, 9])
        self.duration = Duration(*(None if t is None else self.base + t for t in (start, end)))
        self.delay = draw.choice([None, None, 0, 2, 5])
        self.period = draw.choice([None, 1, 3])
        self.approximation = draw.choice([*Approximation])
        self.present_for = draw.choice([None, None, 0, 4])
        self.ended = self.ends(draw)
        self.after = 1 + self.latest
        last = [each[-1].available if each else LEAST for each in self.streams]
        waited = [t for t, end in zip(last, self.ended, strict=True) if end is None]
        self.watermark = min(waited, default=self.after + draw.choice([0, 4]))

    def stream(self, source: int) -> list[Sample]:
        draw = self.random
        terms = draw.sample(self.terms, draw.randint(1, len(self.terms)))
        available = self.base + draw.choice([0, 0, 1, 3])
        delays = draw.choice([[0], [0, 0, 1], [0, 1, 2, 4, 7], [0, 0, 1, -1, -3]])
        samples = []
        for number in range(draw.choice([0, 1, 4, 8, 12, 16])):
            term = draw.choice(terms)
            iris = tuple(a[1:-1] if a.startswith("<") else draw.choice(OBJECTS) for a in term[1])
            valid = available - draw.choice(delays)
            value = 100 * source + number
            shown = str(value) if term == TEXT else value
            samples.append(Sample(source, term, available, valid, iris, shown))
            available += draw.choice([0, 0, 1, 1, 2, 5])
        return samples

    @property
    def definition(self) -> StateDefinition:
        return self.states_by(StateDefinition)


class Playing:
    """Delivers the samples of a case in random pieces, with random watermarks."""

    def __init__(self, case: Drawing, cuts: int) -> None:
        self.case = case
        self.random = random.Random(cuts)
        self.departures = Departures(case.policy.max_delay, len(case.streams))
        self.maker = StateMaker(
            case.terms, case.policy, present_for=case.present_for, wider=case.wider
        )
        self.states: list[State] = []
        self.objects = dict.fromkeys((WIDE, NARROW), ())
        self.horizon = LEAST
        self._given = [0] * len(case.streams)
        self._ended: set[int] = set()
        self._watermark = LEAST

    def play(self) -> None:
        """Up to the last watermark."""
        while self._watermark < self.case.watermark:
            source = self.random.randrange(len(self.case.streams))
            if source not in self._ended:
                self._deliver(source, self.random.choice([0, 1, 1, 2, 5, 99]))
            if self.random.random() < 0.5:
                self._advance()
        # Samples after the last watermark wait.
        for source in range(len(self.case.streams)):
            self._deliver(source, 99)

    def end(self, moment: int) -> None:
        for made in self.maker.end(moment):
            self._take(made)

    def _deliver(self, source: int, count: int) -> None:
        stream = self.case.streams[source]
        given = self._given[source]
        part = stream[given : given + count]
        self._given[source] += len(part)
        if part:
            times = (np.array([getattr(s, n) for s in part]) for n in ("available", "valid"))
            self.departures.add(source, *times)
            for term in {s.term: None for s in part}:
                self.maker.add(term, source, self._rows([s for s in part if s.term == term]))
        is_last = self._given[source] == len(stream)
        end = self.case.ended[source]
        if is_last and end is not None and self.random.random() < 0.7:
            self.departures.end(source, end)
            self.maker.ended(source, max([end, *(s.valid for s in stream)]))
            self._ended.add(source)

    def _rows(self, part: list[Sample]) -> Rows:
        arguments = part[0].term[1]
        places = [
            [
                self.maker.place(sort, iri)
                for sort, iri in zip(arguments, s.objects, strict=True)
                if not sort.startswith("<")
            ]
            for s in part
        ]
        return Rows(
            np.array([s.available for s in part]),
            np.array([s.valid for s in part]),
            np.array(places, np.int64).reshape(len(part), -1),
            np.array([s.value for s in part], object if part[0].term == TEXT else None),
        )

    def _advance(self) -> None:
        """To the least time at which a stream may go on, or to an instant before it."""
        case = self.case
        waited = [
            stream[given - 1].available if given else LEAST
            for source, (stream, given) in enumerate(zip(case.streams, self._given, strict=True))
            if source not in self._ended
        ]
        most = min(waited, default=case.watermark)
        instants = {s.available for each in case.streams for s in each}
        choices = [t for t in (*instants, most) if self._watermark < t <= most]
        if not choices:
            return
        self._watermark = self.random.choice([most, self.random.choice(sorted(choices))])
        steps = self.departures.advance(self._watermark, by_clock=False)
        for made in self.maker.advance(steps):
            self._take(made)
        if self.states:
            last = self.states[-1]
            samples = [s for each in case.streams for s in each]
            open_ = [s for s in samples if s.available > last.left or s.valid > last.valid]
            assert self.maker.retained <= len(open_) + len({(s.term, s.objects) for s in samples})

    def _take(self, made: MadeStates) -> None:
        states, period = made.states, self.case.period
        for sort, objects in states.objects.items():
            assert objects[: len(self.objects[sort])] == self.objects[sort]
            self.objects[sort] = objects
        times = (each.tolist() for each in (states.valid, states.horizon, made.left))
        for i, (valid, horizon, left) in enumerate(zip(*times, strict=True)):
            assert not self.states or self.horizon < valid
            assert horizon == valid if period is None else valid <= horizon < valid + period
            self.horizon = horizon
            present = {
                (sort, iri)
                for sort, there in states.present.items()
                for iri, is_there in zip(states.objects[sort], there[i], strict=True)
                if is_there
            }
            values = {}
            for term, found in states.values.items():
                choices = [[a[1:-1]] if a.startswith("<") else states.objects[a] for a in term[1]]
                cells = zip(found.values[i].flat, found.known[i].flat, strict=True)
                for iris, (value, known) in zip(itertools.product(*choices), cells, strict=True):
                    if known:
                        values[term, iris] = value
            self.states.append(State(valid, left, present, values))


def compared(seed: int) -> Counter[str]:
    """Compare two plays of a case with the definition; count what is in it."""
    case = Drawing(seed)
    definition = case.definition
    expected = definition.states()
    late = definition.late(definition.before_watermark())
    plays = [Playing(case, seed), Playing(case, seed + 1_000_000)]
    for played in plays:
        played.play()
        assert played.states == expected, seed
        assert played.maker.late == len(late), seed
    last = []
    if None not in case.ended:
        moment = case.watermark + case.random.choice([0, 7])
        last = definition.last_states(moment)
        for played in plays:
            played.end(moment)
            assert played.states == expected + last, seed
            assert played.maker.late == len(late), seed
    return Counter(contents(case, [*expected, *last]), late=len(late), last=len(last))


def contents(case: Drawing, states: list[State]) -> dict[str, int]:
    """How much is in the states of a case that could go wrong."""
    cells = {(s.term, s.objects) for each in case.streams for s in each}
    objects = {
        (sort, iri)
        for (_, arguments), iris in cells
        for sort, iri in zip(arguments, iris, strict=True)
        if not sort.startswith("<")
    }
    return {
        "states": len(states),
        "unknown": sum(len(cells - state.values.keys()) for state in states),
        "absent": sum(len(objects - state.present) for state in states),
        "wider": sum(len(state.present - objects) for state in states),
        "waiting": any(each and each[-1].available >= case.watermark for each in case.streams),
        "ended early": any(
            end is not None and each and each[-1].available < case.watermark - 1
            for each, end in zip(case.streams, case.ended, strict=True)
        ),
    }


@pytest.mark.parametrize("block", range(6))
def test_states(block: int, monkeypatch: pytest.MonkeyPatch) -> None:
    if block % 2:
        # A few states are made at once.
        monkeypatch.setattr(state_maker, "CELLS", 1 + block * 4)
    found: Counter[str] = Counter()
    for seed in range(block * 50, block * 50 + 50):
        found += compared(seed)
    assert found["states"] > 200, found
    assert all(
        found[each] > 5
        for each in ("unknown", "absent", "wider", "waiting", "ended early", "late", "last")
    ), found
