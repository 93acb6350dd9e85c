"""A recording in parts: cut by time, moved in time, due at its pace."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.converters.wire import Incoming
from dyknow.service.replay import ROWS, Part, Span, play, span
from dyknow.streams.sample import Field, FieldType, SampleBatch, Schema, batch_from_rows
from dyknow.streams.time import MILLISECOND, SECOND

SCHEMA = Schema((Field("n", FieldType.INTEGER),))


def recording(times: list[int], size: int = 7) -> list[Incoming]:
    rows = [(time, time - 5, {"n": n}) for n, time in enumerate(times)]
    return [
        Incoming(batch_from_rows(SCHEMA, rows[i : i + size]), False)
        for i in range(0, len(rows), size)
    ]


def numbers(parts: list[Part]) -> list[int]:
    return [n for part in parts for n in part.batch.columns["n"].values.tolist()]


def test_span() -> None:
    assert span([]) is None
    assert span(recording([30, 10, 20])) == Span(10, 30)
    assert Span(10, 30).period == 20 + SECOND


def test_at_full_speed_all_is_due_at_once() -> None:
    times = list(range(0, (ROWS + 10) * SECOND, SECOND))
    parts = list(play(recording(times, len(times)), 0))
    assert [len(part.batch) for part in parts] == [ROWS, 10]
    assert {part.due for part in parts} == {0}


def test_a_part_is_due_when_its_last_sample_is() -> None:
    times = [100 * SECOND + i * 40 * MILLISECOND for i in range(6)]  # 0 .. 200 ms
    parts = list(play(recording(times), times[0], speed=1.0))
    assert [len(part.batch) for part in parts] == [3, 2, 1]
    assert [part.due for part in parts] == [80 * MILLISECOND, 160 * MILLISECOND, 200 * MILLISECOND]
    twice = list(play(recording(times), times[0], speed=2.0))
    assert twice[-1].due == 100 * MILLISECOND


def test_both_times_are_moved() -> None:
    part = next(play(recording([10, 20]), 10, shift=1000))
    assert part.batch.available.tolist() == [1010, 1020]
    assert part.batch.valid.tolist() == [1005, 1015]


@given(
    st.lists(st.integers(0, 10 * SECOND), min_size=1, max_size=60).map(sorted),
    st.sampled_from([None, 0.5, 1.0, 10.0]),
    st.integers(1, 20),
)
@settings(deadline=None, max_examples=60)
def test_nothing_is_lost_or_out_of_order(times: list[int], speed: float | None, size: int) -> None:
    parts = list(play(recording(times, size), times[0], speed=speed))
    assert numbers(parts) == list(range(len(times)))
    assert all(a.due <= b.due for a, b in pairwise(parts))
    assert all(len(part.batch) for part in parts)


def test_batches_are_views_not_copies() -> None:
    batch: SampleBatch = recording([1, 2, 3])[0].batch
    part = next(play([Incoming(batch, False)], 1))
    assert np.shares_memory(part.batch.columns["n"].values, batch.columns["n"].values)
