"""Fewer samples for slow readers: what the definitions give, sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dyknow.streams.downsampling import (
    MAXIMUM,
    MINIMUM,
    downsampled,
    name_clash,
    newest_of_each,
    object_numbers,
)
from dyknow.streams.history import FluentStream
from dyknow.streams.sample import Field, FieldType, Schema, Value, batch_from_rows

SCHEMA = Schema(
    (
        Field("id", FieldType.STRING),
        Field("part", FieldType.INTEGER),
        Field("v", FieldType.FLOAT),
        Field("n", FieldType.INTEGER),
        Field("on", FieldType.BOOLEAN),
        Field("text", FieldType.STRING),
    )
)
NAMES = st.sampled_from(["a", "b", "c", None])
Row = tuple[int, int, dict[str, Value]]
values = st.fixed_dictionaries(
    {
        "id": NAMES,
        "part": st.sampled_from([0, -7, 2**62, None]),
        "v": st.none() | st.floats(-3, 3),
        "n": st.none() | st.sampled_from([-(2**63), 2**63 - 1, 0, 1, 2]),
        "on": st.none() | st.booleans(),
        "text": st.none() | st.text(max_size=2),
    }
)
times = st.integers(-12, 12) | st.sampled_from([-(2**63), 2**63 - 1])


@st.composite
def histories(draw: st.DrawFn) -> list[Row]:
    drawn = draw(st.lists(st.tuples(times, times, values), max_size=30))
    available = sorted(time for time, _, _ in drawn)
    return [(time, valid, row) for time, (_, valid, row) in zip(available, drawn, strict=True)]


keys = st.sampled_from([(), ("id",), ("part",), ("id", "part"), ("id", "part", "text")])


def by_definition(rows: list[Row], keys: tuple[str, ...], every: int) -> list[Row]:
    """Straight from the docstring of `downsampled`: a dict of groups, and Python's min and max."""
    groups: dict[tuple[int, tuple[Value, ...]], list[int]] = {}
    for i, (_, valid, row) in enumerate(rows):
        groups.setdefault((valid // every, tuple(row[key] for key in keys)), []).append(i)
    found = []
    for (interval, _), members in groups.items():
        last = max(members, key=lambda i: (rows[i][1], i))
        told: dict[str, Any] = {}
        for name, value in rows[last][2].items():
            told[name] = value
            if name in ("v", "n", "part") and name not in keys:
                there = [rows[i][2][name] for i in members if rows[i][2][name] is not None]
                told[name + MINIMUM] = min(there, default=None)  # type: ignore[type-var]
                told[name + MAXIMUM] = max(there, default=None)  # type: ignore[type-var]
        found.append((interval, last, (rows[last][0], rows[last][1], told)))
    return [row for _, _, row in sorted(found, key=lambda each: each[:2])]


@settings(deadline=None)
@given(
    histories(),
    keys,
    st.sampled_from([1, 3, 10, 2**63 - 1]),
    st.integers(0, 30),
    st.integers(1, 10),
)
@example([], ("id",), 3, 0, 1)
def test_each_interval_of_each_object_has_its_last_sample_and_extremes(
    rows: list[Row], keys: tuple[str, ...], every: int, cut: int, most: int
) -> None:
    stream = FluentStream(SCHEMA)
    for part in (rows[:cut], rows[cut:]):
        stream.append(batch_from_rows(SCHEMA, part))
    found = downsampled(stream.all(), keys, every)
    whole = by_definition(rows, keys, every)
    assert list(found.rows()) == whole
    newest = downsampled(stream.all(), keys, every, most=most, newest=True)
    assert list(newest.rows()) == whole[-most:]
    oldest = downsampled(stream.all(), keys, every, most=most)
    ends = {valid // every for _, valid, _ in whole[:most]}
    assert list(oldest.rows()) == [each for each in whole if each[1] // every in ends]


@settings(deadline=None)
@given(histories(), keys)
def test_the_newest_of_each_object_stands_for_its_samples(
    rows: list[Row], keys: tuple[str, ...]
) -> None:
    batch = batch_from_rows(SCHEMA, rows)
    names = [tuple(row[key] for key in keys) for _, _, row in rows]
    last = {name: row for row, name in enumerate(names)}
    found, counts = newest_of_each(object_numbers(batch, keys))
    assert found.tolist() == sorted(last.values())
    assert counts.tolist() == [names.count(names[row]) for row in found.tolist()]


@settings(deadline=None)
@given(histories(), st.integers(0, 30), st.data())
def test_samples_are_found_by_their_numbers(rows: list[Row], cut: int, data: st.DataObject) -> None:
    stream = FluentStream(SCHEMA, first=5)
    for part in (rows[:cut], rows[cut:]):
        stream.append(batch_from_rows(SCHEMA, part))
    if not rows:
        return
    numbers = data.draw(st.sets(st.integers(5, len(rows) + 4), min_size=1).map(sorted))
    found = stream.at(np.array(numbers))
    assert list(found.rows()) == [rows[number - 5] for number in numbers]


@pytest.mark.parametrize(
    ("names", "keys", "clash"),
    [("v v_min", (), "v_min"), ("v v_max", ("v",), None), ("v w_min", (), None)],
)
def test_a_name_that_would_be_there_twice_is_found(
    names: str, keys: tuple[str, ...], clash: str | None
) -> None:
    schema = Schema(tuple(Field(name, FieldType.FLOAT) for name in names.split()))
    assert name_clash(batch_from_rows(schema, []), keys) == clash
