"""What is kept of a stream while its texts get other codes: the same is said."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

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
