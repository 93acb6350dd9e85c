"""Laws of windows in bulk through the engine: one pass over several windows changes no sample."""

from __future__ import annotations

import random
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
from commanding import REFUSALS, life, state
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dyknow.continuous.incremental import bulk_aggregation
from dyknow.continuous.windows import window_schedule
from dyknow.converters.ndjson import encode_ndjson
from dyknow.converters.wire import Incoming
from dyknow.engine.durability.commands import RegisterQuery, execute
from dyknow.engine.engine import Engine
from dyknow.engine.model.views import StreamDeclaration
from dyknow.streams.sample import Column, Field, FieldType, SampleBatch
from dyknow.streams.stream_rules import INSTANTS, UNIQUE_TIMES
from dyknow.streams.string_pool import StringPool

SPEED = "http://www.ida.liu.se/dyknow/speed"
STREAM = "FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf>"
FIELDS = (Field("id", FieldType.STRING), Field("v", FieldType.FLOAT))
BODY = "{ SELECT ?o (AVG(?v) AS ?a) (MAX(?v) AS ?m) WHERE { ?o a dyknow:UAV . ?o dyknow:speed ?v } "
"""The average and the greatest speed of each UAV."""
HEADS = (
    "SELECT ?o ?a ?m {window} WHERE {{ {body} }}",
    "SELECT ?a {window} WHERE {{ {body} }} ORDER BY DESC(?a) ?o",
    "CONSTRUCT {{ ?o dyknow:speed ?a ; dyknow:altitude ?m }} {window} WHERE {{ {body} }}",
    "CONSTRUCT {{ ?o dyknow:speed ?a . dyknow:all dyknow:speed ?m }} {window} WHERE {{ {body} }}",
    "CONSTRUCT {{ ?o dyknow:near dyknow:uav1 ; dyknow:speed ?x }} {window} "
    "WHERE {{ {body} BIND(IF(?a > 50, ?a, 'slow') AS ?x) }}",
)


@contextmanager
def at_most(windows: int) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(window_schedule, "MOST", windows)
        patch.setattr(window_schedule, "FEWEST", 2)
        patch.setattr(bulk_aggregation, "PASS", -(10**9))
        yield


def samples(found: list[tuple[int, int, float]]) -> SampleBatch:
    """Samples of (ms, object, speed), in order of time."""
    pool = StringPool()
    times = [ms * 10**6 + i for i, (ms, _, _) in enumerate(sorted(found))]
    ids = [pool.code(f"uav{each}") for _, each, _ in sorted(found)]
    speeds = [speed for *_, speed in sorted(found)]
    columns = {
        "id": Column(FieldType.STRING, np.array(ids, np.int32), None, pool),
        "v": Column(FieldType.FLOAT, np.array(speeds)),
    }
    moments = np.array(times, np.int64)
    return SampleBatch(moments, moments, columns)


@example(  # A row between two windows: its object has a group only from its first window on.
    HEADS[0],
    (2, 4),
    "",
    [(3_000, 1, 49.0), (5_000, 4, 49.0), (14_000, 0, 49.0), (15_000, 4, 49.0), (16_001, 4, 0.5)],
    [],
    INSTANTS,
)
@settings(deadline=None, max_examples=40)
@given(
    st.sampled_from(HEADS),
    st.sampled_from([(1, 1), (3, 1), (2, 4)]),
    st.sampled_from(["", "HAVING (AVG(?v) > 50)"]),
    st.lists(
        st.tuples(st.integers(0, 20_000), st.integers(0, 4), st.sampled_from([0.5, 49.0, 90.25])),
        min_size=1,
        max_size=80,
    ),
    st.lists(st.integers(1, 80), max_size=4),
    st.sampled_from([UNIQUE_TIMES, INSTANTS]),
)
def test_samples_and_counters_are_the_same(head, size, having, found, cuts, rules) -> None:
    window = f"{STREAM} [RANGE {size[0]}s STEP {size[1]}s]"
    text = head.format(window=window, body=BODY + f"GROUP BY ?o {having} }}")
    wanted = None
    for most in (1, 3, 512):
        with at_most(most):
            engine = Engine(rules=rules, epoch="e1")
            engine.declare(StreamDeclaration("s", FIELDS))
            engine.annotate("stream s contains speed(UAV) = v for every UAV = id")
            execute(engine, RegisterQuery(f"REGISTER QUERY q AS {text}"))
            batch = samples(found)
            places = sorted({0, len(batch), *(min(cut, len(batch)) for cut in cuts)})
            for start, stop in pairwise(places):
                engine.publish("s", Incoming(batch.take(slice(start, stop)), False), 0)
            engine.end("s")
            out = engine.generator("q").stream.all()
            now = [encode_ndjson(out), state(engine), engine.generator("q").counters]
        if wanted is None:
            wanted = now
        assert now == wanted


@settings(deadline=None, max_examples=15)
@given(st.integers(0, 2**32), st.integers(5, 60))
def test_a_life_in_bulk_is_a_life_one_by_one(seed, length) -> None:
    found = []
    for most in (1, 512):
        with at_most(most):
            engine = Engine(epoch="e1")
            for command in life(random.Random(seed), length):
                try:
                    execute(engine, command)
                except REFUSALS:
                    continue
            found.append(state(engine))
    assert found[0] == found[1]
