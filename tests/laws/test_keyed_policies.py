"""The law of policies that hold for each object by itself: what is sent and dropped of an object is
what `adapt` gives for a stream of this object alone (SPEC §1, Policies)."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
from policies_drawn import policies

from dyknow.streams.adaptation import Dropped
from dyknow.streams.adapting import adapt
from dyknow.streams.keyed_adapting import KeyedAdapting
from dyknow.streams.policy import Policy
from dyknow.streams.sample import Field, FieldType, SampleBatch, Schema, batch_from_rows
from dyknow.streams.strings import StringPool
from dyknow.streams.time import TIME_MIN

SCHEMA = Schema(
    (
        Field("id", FieldType.STRING),
        Field("part", FieldType.INTEGER),
        Field("x", FieldType.INTEGER),
    )
)
Row = tuple[int, int, str | None, int | None, int]


@st.composite
def streams(draw: st.DrawFn) -> list[Row]:
    times = sorted(draw(st.sets(st.integers(0, 40), max_size=20)))
    return [
        (
            time,
            draw(st.one_of(st.integers(-2, 42), st.just(time), st.integers(time - 6, time))),
            draw(st.sampled_from(["a", "b", None])),
            draw(st.sampled_from([1, 1, 7, None])),
            draw(st.integers(0, 3)),
        )
        for time in times
    ]


def batch_of(rows: list[Row], pool: StringPool) -> SampleBatch:
    named = [(ta, tv, {"id": id, "part": part, "x": x}) for ta, tv, id, part, x in rows]
    return batch_from_rows(SCHEMA, named, {"id": pool})


def told(batches: list[SampleBatch]) -> list[Row]:
    return [
        (ta, tv, v["id"], v["part"], v["x"])  # type: ignore[misc]
        for batch in batches
        for ta, tv, v in batch.rows()
    ]


def alone(policy: Policy, rows: list[Row], last: int) -> tuple[list[Row], list[Row]]:
    """What is sent and dropped of one object, all at once; time passes until ``last``, when the
    last sample of any object comes."""
    dropped: list[SampleBatch] = []
    adaptation = adapt(policy, lambda each: dropped.append(each.batch))
    batch = batch_of(rows, StringPool())
    sent = adaptation.push(batch) + adaptation.advance(last) + adaptation.end()
    return told(sent), told(dropped)


@settings(deadline=None, max_examples=300)
@given(streams(), policies(), st.lists(st.integers(0, 4), max_size=20), st.booleans())
def test_each_object_is_adapted_by_itself(
    rows: list[Row], policy: Policy, cuts: list[int], by_both: bool
) -> None:
    dropped: list[SampleBatch] = []

    def drop(each: Dropped) -> None:
        dropped.append(each.batch)

    adaptation = KeyedAdapting(policy, ["id", "part"] if by_both else ["id"], drop)
    sent: list[Row] = []
    known, rest = TIME_MIN, rows
    for cut in [*cuts, len(rows)]:
        # Codes of texts may be others in each batch.
        piece, rest = rest[:cut], rest[cut:]
        given = adaptation.push(batch_of(piece, StringPool(["x"] * (cut % 2))))
        if piece:
            known = piece[-1][0]
        if cut == 0 and rest:
            known = rest[0][0]
            given += adaptation.advance(known)
        found = told(given)
        sent += found
        assert sent == sorted(sent, key=lambda row: row[0])
    sent += told(adaptation.end())
    objects = {(row[2], row[3] if by_both else 0) for row in rows}
    received = sent_number = 0
    for object in objects:
        own = [row for row in rows if (row[2], row[3] if by_both else 0) == object]
        wanted, refused = alone(policy, own, rows[-1][0])
        assert [r for r in sent if (r[2], r[3] if by_both else 0) == object] == wanted
        mine = [r for r in told(dropped) if (r[2], r[3] if by_both else 0) == object]
        assert sorted(mine, key=repr) == sorted(refused, key=repr)
        received += len(own)
        sent_number += len(wanted)
    counters = adaptation.counters
    assert (counters.received, counters.sent) == (received, sent_number)
    assert sum(counters.dropped.values()) == len(told(dropped))
