"""The time that units work, by a stopwatch that the test moves."""

from __future__ import annotations

import itertools

import pytest
from feeding import feed
from hypothesis import given
from hypothesis import strategies as st

from dyknow.engine.engine import Engine
from dyknow.engine.units.work_time import BusyTime

QUERY = """REGISTER QUERY speeds AS SELECT ?o ?v
FROM STREAM <http://www.ida.liu.se/dyknow/s5.trdf> [RANGE 1s STEP 1s]
WHERE { ?o <http://www.ida.liu.se/dyknow/speed> ?v }"""


class Unit:
    def __init__(self) -> None:
        self.busy = 0


works = st.recursive(
    st.tuples(st.integers(0, 3), st.integers(0, 9), st.just(())),
    lambda inner: st.tuples(st.integers(0, 3), st.integers(0, 9), st.lists(inner, max_size=3)),
)


@given(st.lists(works, max_size=5))
def test_own_times_add_up_whoever_sets_whom_to_work(all_works: list) -> None:
    units = [Unit() for _ in range(4)]
    own = [0] * 4
    now = 0

    def stopwatch() -> int:
        return now

    measure = BusyTime(stopwatch)

    def do(work: tuple) -> None:
        unit, takes, inner = work

        def really() -> None:
            nonlocal now
            now += takes
            own[unit] += takes
            for one in inner:
                do(one)

        measure.run(units[unit], really)

    for work in all_works:
        do(work)
    assert [unit.busy for unit in units] == own
    assert sum(own) == now


def test_a_work_that_fails_is_measured_too() -> None:
    now = 0

    def fail() -> None:
        nonlocal now
        now += 7
        raise ValueError

    unit, measure = Unit(), BusyTime(lambda: now)
    for _ in range(2):
        try:
            measure.run(unit, fail)
        except ValueError:
            continue
    assert unit.busy == 14


@pytest.mark.parametrize("measured", [True, False])
def test_units_of_an_engine_tell_time_and_windows(measured: bool) -> None:
    moments = itertools.count()
    engine = Engine(epoch="e1", stopwatch=(lambda: next(moments)) if measured else None)
    engine.annotate("stream s5 contains speed(UAV) = spd for every UAV = id")
    engine.queries.register(QUERY)
    feed(engine, "s5", [(second, {"id": "a", "spd": 1.0}) for second in range(1, 6)])
    engine.end("s5")
    (unit,) = engine.units()
    assert unit.windows >= 5
    assert (unit.busy > 0) == measured
