"""The steps of parts are those that each part's own samples make."""

from __future__ import annotations

import pickle
from random import Random

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.reasoning.states.departures import Departures
from dyknow.reasoning.states.part_departures import PartDepartures
from dyknow.streams.time import TIME_MAX


def test_what_is_reached_stays_reached():
    """However batches are cut, when a stream goes on that was not waited for meanwhile."""
    found = []
    for cuts in ([7], [5, 7]):
        running = Departures(None, 2)
        running.add(0, np.array([1, 4]), np.array([1, 4]))
        running.idle = frozenset({1})
        running.advance(5, by_clock=False)
        running.idle = frozenset()
        running.add(1, np.array([4, 6]), np.array([2, 3]))
        for cut in cuts:
            steps = running.advance(cut, by_clock=False)
        found.append(steps.reached_before(np.array([6])).tolist())
    assert found == [[4], [4]]


@settings(deadline=None, max_examples=400)
@given(st.integers(0, 2**32))
def test_a_part_departs_by_its_own_samples(seed: int) -> None:
    draw = Random(seed)
    sources, parts = draw.randint(1, 3), 0
    lateness = [draw.choice([0, 0, 3]) for _ in range(sources)]
    shared = PartDepartures(sources, lateness)
    alone: list[Departures] = []
    ended: dict[int, int] = {}
    now = [0] * sources
    watermark = 0
    for _ in range(draw.randint(2, 25)):
        what = draw.random()
        if what < 0.2 or not parts:
            assert shared.add_part() == parts
            parts += 1
            alone.append(Departures(None, sources, lateness))
            for source, moment in ended.items():
                alone[-1].end(source, moment)
        elif what < 0.6:
            source, count = draw.randrange(sources), draw.randint(1, 5)
            ended.pop(source, None)
            shared.resume(source)
            steps = [draw.choice([0, 1, 3]) for _ in range(count)]
            available = max(now[source], watermark) + np.cumsum(np.array(steps, np.int64))
            now[source] = int(available[-1])
            valid = available - np.array([draw.choice([0, 0, 1, 5]) for _ in range(count)])
            part = np.array([draw.randrange(parts) for _ in range(count)])
            shared.add(source, available, valid, part)
            for p in set(part.tolist()):
                alone[p].add(source, available[part == p], valid[part == p])
        elif what < 0.7:
            source, moment = draw.randrange(sources), max(*now, watermark)
            ended[source] = moment
            shared.end(source, moment)
            for each in alone:
                each.end(source, moment)
        else:
            shared.idle = frozenset(s for s in range(sources) if draw.random() < 0.2)
            watermark = max(watermark, draw.choice([min(now), max(now), max(now) + 3]))
            by_clock = draw.random() < 0.3
            found = shared.advance(watermark, by_clock=by_clock)
            for p, each in enumerate(alone):
                each.idle = shared.idle
                wanted = each.advance(watermark, by_clock=by_clock)
                own = slice(found.first[p], found.first[p + 1])
                assert found.moment[own].tolist() == wanted.moment.tolist()
                assert found.reached[own].tolist() == wanted.reached.tolist()
                assert (found.before[p], found.latest[p]) == (wanted.before, wanted.latest)
                times = np.arange(watermark + 4, dtype=np.int64)
                mine = np.full(len(times), p)
                assert (
                    found.reached_before(mine, times).tolist()
                    == wanted.reached_before(times).tolist()
                )
                if len(wanted.moment) and wanted.latest < TIME_MAX:
                    known = times[times <= wanted.latest]
                    assert (
                        found.reaching(mine[: len(known)], known).tolist()
                        == wanted.reaching(known).tolist()
                    )
        if draw.random() < 0.1:
            shared = pickle.loads(pickle.dumps(shared))
