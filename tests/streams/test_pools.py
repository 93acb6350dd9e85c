"""What is kept of a stream while its texts get other codes: the same is said."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from dyknow.streams.history import FluentStream, Retention
from dyknow.streams.key_numbering import TextNumbering
from dyknow.streams.latest_by_key import Latest
from dyknow.streams.sample import (
    Field,
    FieldType,
    SampleBatch,
    Schema,
    batch_from_rows,
    concatenate,
)
from dyknow.streams.string_pool import StringPool

SCHEMA = Schema((Field("name", FieldType.STRING), Field("v", FieldType.INTEGER)))
names = st.none() | st.sampled_from(["a", "b", "c", "d", "e"])
batches = st.lists(
    st.tuples(st.booleans(), st.lists(st.tuples(st.integers(0, 40), names), min_size=1)),
    min_size=1,
    max_size=6,
)


def made(rows: list[tuple[int, str | None]], start: int, pool: StringPool) -> SampleBatch:
    samples = [(start + i, start + i, {"name": name, "v": v}) for i, (v, name) in enumerate(rows)]
    return batch_from_rows(SCHEMA, samples, {"name": pool})


def cut(given_batches: list[tuple[bool, list[tuple[int, str | None]]]]) -> list[SampleBatch]:
    """Batches of a stream, whose pool is another one before some of them."""
    pool, start, found = StringPool(["before"]), 0, []
    for is_new, rows in given_batches:
        pool = StringPool() if is_new else pool
        found.append(made(rows, start, pool))
        start += len(rows)
    return found


@given(batches)
def test_batches_of_several_pools_are_one_in_the_last(given_batches) -> None:
    parts = cut(given_batches)
    whole = concatenate(parts)
    assert list(whole.rows()) == [row for part in parts for row in part.rows()]
    assert whole.columns["name"].pool is parts[-1].columns["name"].pool


@given(batches)
def test_the_latest_of_each_object_says_the_same(given_batches) -> None:
    latest, last = Latest(), {}
    for batch in cut(given_batches):
        numbers = batch.columns["v"].values
        latest.reserve(41)
        latest.put(numbers, batch)
        last.update(zip(numbers.tolist(), batch.rows(), strict=True))
        known = np.array(sorted(last), np.int64)
        assert list(latest.take(known).rows()) == [last[number] for number in sorted(last)]


@given(batches)
def test_a_text_has_one_number_in_all_pools(given_batches) -> None:
    numbering, known = TextNumbering(), {}
    for batch in cut(given_batches):
        column = batch.columns["name"].take(batch.columns["name"].present)
        assert column.pool is not None
        for text, number in zip(
            column.tolist(), numbering.of(column.values, column.pool), strict=True
        ):
            assert known.setdefault(text, int(number)) == number
    assert sorted(known.values()) == list(range(len(known)))


def renewed(stream: FluentStream, texts: Iterable[str], size: int) -> int:
    """How often the field got a new pool while samples with these texts came, ``size`` a batch."""
    found, given = 0, iter(texts)
    while part := list(islice(given, size)):
        pool = stream.pools.setdefault("name", StringPool())
        time = 0 if stream.last_available is None else stream.last_available
        stream.append(made([(0, text) for text in part], time + 1, pool))
        stream.forget_texts()
        found += stream.pools["name"] is not pool
    return found


def turns(objects: int, count: int) -> list[str]:
    return [f"uav{i}" for _ in range(count) for i in range(objects)]


def test_texts_that_come_again_are_not_forgotten() -> None:
    """20,000 objects report in turn, and the history has the last thousand samples."""
    stream = FluentStream(SCHEMA, Retention(1_000))
    assert renewed(stream, turns(20_000, 3), 1_000) >= 3
    assert renewed(stream, turns(20_000, 3), 1_000) == 0
    assert len(stream.pools["name"]) <= 40_000


def test_texts_that_never_come_again_are_forgotten_afterwards() -> None:
    stream = FluentStream(SCHEMA, Retention(1_000))
    renewed(stream, turns(10_000, 4), 1_000)
    assert renewed(stream, (f"once{i}" for i in range(100_000)), 1_000) >= 10
    assert len(stream.pools["name"]) <= 6_000


def test_kept_texts_are_none_that_come_again() -> None:
    """A new pool has them from the beginning, and they were never forgotten."""
    stream = FluentStream(SCHEMA, Retention(10_000))
    renewed(stream, (f"once{i}" for i in range(200_000)), 1_000)
    assert len(stream.pools["name"]) <= 21_000
