"""Questions about a stream's past: the definition's answer over all samples, or `Forgotten`
([DyKnow10 Def. 5.5-5.7], SPEC §1)."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow.streams import past_queries
from dyknow.streams.history import FluentStream, Retention
from dyknow.streams.past_queries import Forgotten
from dyknow.streams.sample import (
    Field,
    FieldType,
    SampleBatch,
    Schema,
    batch_from_rows,
)

SCHEMA = Schema((Field("v", FieldType.INTEGER),))
SMALL = st.integers(-3, 12)
TIMES = st.integers(-(2**63), 2**63 - 1)


def make(samples: list[tuple[int, int, int]]) -> SampleBatch:
    return batch_from_rows(SCHEMA, [(t, v, {"v": i}) for t, v, i in samples])


@st.composite
def lives(draw: st.DrawFn) -> tuple[list[tuple[int, int, int]], FluentStream]:
    """All samples that a stream ever had, and the stream, which keeps the last ones."""
    available = sorted(draw(st.sets(SMALL | TIMES, max_size=40)))
    in_order = draw(st.booleans())
    valid = draw(st.lists(SMALL, min_size=len(available), max_size=len(available)))
    valid = sorted(valid) if in_order else valid
    samples = [(t, v, i) for i, (t, v) in enumerate(zip(available, valid, strict=True))]
    cuts = sorted(draw(st.lists(st.integers(0, len(samples)), max_size=6)))
    stream = FluentStream(SCHEMA, Retention(draw(st.integers(1, 50))))
    for start, end in zip([0, *cuts], [*cuts, len(samples)], strict=True):
        stream.append(make(samples[start:end]))
        if draw(st.booleans()):
            stream.retention = Retention(draw(st.integers(1, 50)))
    return samples, stream


def told(batch: SampleBatch) -> list[tuple[int, int, object]]:
    return [(available, valid, values["v"]) for available, valid, values in batch.rows()]


Life = tuple[list[tuple[int, int, int]], FluentStream]


@given(lives(), SMALL, SMALL | TIMES, SMALL, SMALL)
def test_what_is_not_refused_is_the_definition(
    life: Life, time: int, known: int, low: int, high: int
) -> None:
    samples, stream = life
    avail = [s for s in samples if s[0] <= known]
    before = [s for s in avail if s[1] <= time]
    most_recent = [s for s in before if s[1] == max(other[1] for other in before)]
    in_time = [s for s in samples if low <= s[0] <= high]
    cases: list[tuple[Callable[[], SampleBatch], list[tuple[int, int, int]]]] = [
        (lambda: past_queries.most_recent_at(stream, time, known), most_recent[-1:]),
        (lambda: past_queries.before(stream, time, known), before),
        (lambda: past_queries.before(stream, time, known, most=2), before[-2:]),
        (lambda: past_queries.prev(stream, known), [s for s in samples if s[0] < known][-1:]),
        (lambda: past_queries.last_avail(stream, known), avail[-1:]),
        (lambda: past_queries.between(stream, low, high), in_time),
        (
            lambda: past_queries.between(stream, None, None, low, high),
            [s for s in samples if low <= s[1] <= high],
        ),
        (
            lambda: past_queries.between(stream, low, high, time, None, most=2),
            [s for s in in_time if s[1] >= time][:2],
        ),
    ]
    for ask, wanted in cases:
        assert answer(ask, samples, stream) in (wanted, REFUSED)


REFUSED: list[tuple[int, int, object]] = [(0, 0, "refused")]


def answer(
    ask: Callable[[], SampleBatch], samples: list[tuple[int, int, int]], stream: FluentStream
) -> list[tuple[int, int, object]]:
    """What is answered; refused are only questions to a stream that has forgotten something."""
    if len(stream) == len(samples):
        return told(ask())
    try:
        return told(ask())
    except Forgotten:
        return REFUSED


@given(lives(), SMALL, SMALL)
def test_what_the_kept_samples_decide_is_answered(life: Life, time: int, known: int) -> None:
    """Nothing is refused without need: where valid times are in order, all that is as late as what
    is kept; and what was available since then."""
    samples, stream = life
    if not samples:
        return
    kept = told(stream.all())
    if known >= kept[0][0]:
        assert told(past_queries.last_avail(stream, known))
        past_queries.between(stream, known, None)
    if known > kept[0][0]:
        assert told(past_queries.prev(stream, known))
    gone = samples[: len(samples) - len(kept)]
    if all(s[1] <= kept[0][1] for s in gone) and time >= kept[0][1]:
        assert told(past_queries.most_recent_at(stream, time))
    if all(s[1] > time for s in gone):
        assert told(past_queries.before(stream, time)) == [s for s in samples if s[1] <= time]


def test_another_sample_than_the_definition_is_refused() -> None:
    """What `at=` answered before: the only sample kept, instead of the forgotten one."""
    stream = FluentStream(SCHEMA, Retention(1))
    for sample in ((10, 5, 1), (11, 3, 2)):
        stream.append(make([sample]))
    assert told(stream.most_recent_at(6, 20)) == [(11, 3, 2)]
    with pytest.raises(Forgotten, match=r"1970-01-01T00:00:00\.000000011Z"):
        past_queries.most_recent_at(stream, 6, 20)
    assert told(past_queries.most_recent_at(stream, 3, 20)) == [(11, 3, 2)]


def test_a_stream_that_goes_on_knows_nothing_of_forgotten_valid_times() -> None:
    stream = FluentStream(SCHEMA)
    stream.go_on(make([(10, 10, 1)]), 5)
    with pytest.raises(Forgotten):
        past_queries.most_recent_at(stream, 20)
    assert told(past_queries.last_avail(stream, 20)) == [(10, 10, 1)]
    whole = FluentStream(SCHEMA)
    whole.go_on(make([(10, 10, 1)]), 1)
    assert told(past_queries.most_recent_at(whole, 20)) == [(10, 10, 1)]
