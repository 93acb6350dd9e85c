"""Laws of adapting streams to policies: what is sent is a maximal satisfying substream
([DyKnow10 Def. 5.35]), however the input was cut into batches."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from policies_drawn import policies
from policy_definition import addable, extend, origins, satisfies

from dyknow.streams.policies.adaptation import REASONS, Adaptation, Dropped
from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    ChangeBy,
    Duration,
    Order,
    Policy,
    SampleEvery,
)
from dyknow.streams.policies.satisfaction import prove
from dyknow.streams.policies.select_adaptation import adapt
from dyknow.streams.sample import (
    Field,
    FieldType,
    SampleBatch,
    Schema,
    batch_from_rows,
)
from dyknow.streams.string_pool import StringPool
from dyknow.streams.time import TIME_MAX, TIME_MIN

SCHEMA = Schema((Field("x", FieldType.INTEGER), Field("name", FieldType.STRING)))
VALUES = [(1, "a"), (1, None), (2, "a"), (None, "b"), (4, "a"), (5, "b")]
LAWS = settings(deadline=None, max_examples=300)


@st.composite
def streams(draw: st.DrawFn, base: int = 0) -> list[tuple[int, int, object]]:
    """Few times, so that they meet: equal, decreasing and far-off valid times."""
    times = sorted(draw(st.lists(st.integers(0, 40), max_size=12)))
    valid = st.one_of(st.integers(-2, 42), st.sampled_from([0, 10, 20, 30, 40]))
    samples = []
    for time in times:
        tv = draw(st.one_of(valid, st.just(time), st.integers(time - 6, time)))
        samples.append((base + time, base + tv, draw(st.sampled_from(VALUES))))
    return samples


def batch_of(samples: list[tuple[int, int, object]], pool: StringPool) -> SampleBatch:
    rows = [(ta, tv, {"x": value[0], "name": value[1]}) for ta, tv, value in samples]
    return batch_from_rows(SCHEMA, rows, {"name": pool})


def rows_of(batches: list[SampleBatch]) -> list[tuple[int, int, object]]:
    return [
        (available, valid, (values["x"], values["name"]))
        for batch in batches
        for available, valid, values in batch.rows()
    ]


class Run:
    """A stream put through a policy; ``cuts`` say how it comes in."""

    def __init__(self, samples: list[tuple[int, int, object]], policy: Policy) -> None:
        self.drops: list[tuple[int, tuple[int, int, object], str]] = []
        self.pool = StringPool()
        self.samples = samples
        self.adaptation: Adaptation = adapt(policy, self.dropped)
        self.sent: list[tuple[int, int, object]] = []
        self.given: list[tuple[int, int, int]] = []
        """What was known after each step, the last time that was told, and how many samples had
        been given by then.
        """

    def dropped(self, told: Dropped) -> None:
        for at, row, reason in zip(
            told.at.tolist(), rows_of([told.batch]), told.reasons.tolist(), strict=True
        ):
            self.drops.append((at, row, REASONS[reason].value))

    def feed(self, cuts: list[int]) -> Run:
        """In pieces of the lengths ``cuts`` (0: a watermark as high as it may be), then the end."""
        rest = list(self.samples)
        for cut in cuts:
            if cut:
                piece, rest = rest[:cut], rest[cut:]
                self.sent += rows_of(self.adaptation.push(batch_of(piece, self.pool)))
                if piece:
                    self.given.append((piece[-1][0] - 1, piece[-1][0], len(self.sent)))
            elif rest:
                self.sent += rows_of(self.adaptation.advance(rest[0][0]))
                self.given.append((rest[0][0] - 1, rest[0][0], len(self.sent)))
        self.sent += rows_of(self.adaptation.push(batch_of(rest, self.pool)))
        self.sent += rows_of(self.adaptation.end())
        return self


def horizon(samples: list[tuple[int, int, object]], policy: Policy) -> int:
    """How far ``to oo`` goes at the end of a recording: until the last news is in the grid."""
    start, period = policy.duration.start, policy.period
    if not samples or start is None or period is None or policy.max_delay is None:
        return TIME_MIN
    last = max(max(tv, ta - policy.max_delay) for ta, tv, _ in samples)
    return start + max(0, -(-(last - start) // period)) * period


@LAWS
@given(st.data(), st.sampled_from([0, TIME_MIN + 50, TIME_MAX - 45]))
def test_output_is_a_maximal_satisfying_substream(data: st.DataObject, base: int) -> None:
    samples, policy = data.draw(streams(base)), data.draw(policies(base))
    run = Run(samples, policy).feed([])
    assert satisfies(run.sent, policy)
    whole = extend(samples, policy, horizon(samples, policy))
    if policy.approximation is Approximation.MOST_RECENT:
        assert run.sent == [s for s in whole if s[0] <= TIME_MAX]
        return
    assert origins(run.sent, whole) is not None
    assert addable(run.sent, [s for s in whole if s[0] <= TIME_MAX], policy) is None or (
        base > 0  # the end of time takes the moments that the definition would still have
    )


@LAWS
@given(st.data(), st.sampled_from([0, TIME_MIN + 50, TIME_MAX - 45]))
def test_cuts_do_not_matter(data: st.DataObject, base: int) -> None:
    samples, policy = data.draw(streams(base)), data.draw(policies(base))
    cuts = data.draw(st.lists(st.integers(0, 4), max_size=12))
    whole, cut = Run(samples, policy).feed([]), Run(samples, policy).feed(cuts)
    if policy.duration.to_oo and policy.approximation is Approximation.MOST_RECENT:
        # With no end, watermarks make the grid go on; what they add comes after all the news.
        assert cut.sent[: len(whole.sent)] == whole.sent
    else:
        assert cut.sent == whole.sent
        for known, last, given in cut.given:
            assert given >= sum(ta <= known for ta, _, _ in whole.sent)
            assert given <= sum(ta <= last for ta, _, _ in whole.sent)
    assert cut.drops == whole.drops
    assert cut.adaptation.counters.dropped == whole.adaptation.counters.dropped
    assert cut.drops == sorted(cut.drops, key=lambda drop: drop[0])


@LAWS
@given(st.data())
def test_every_sample_is_counted_once(data: st.DataObject) -> None:
    samples, policy = data.draw(streams()), data.draw(policies())
    run = Run(samples, policy)
    for sample in samples:
        run.sent += rows_of(run.adaptation.push(batch_of([sample], run.pool)))
        counters = run.adaptation.counters
        lost = sum(counters.dropped.values())
        assert counters.received == counters.kept + lost + counters.pending
    run.sent += rows_of(run.adaptation.end())
    counters = run.adaptation.counters
    assert counters.sent == len(run.sent)
    assert len(run.drops) == sum(counters.dropped.values())
    assert counters.pending == 0
    if policy.approximation is Approximation.NONE:
        assert counters.kept == counters.sent
        assert counters.approximated == 0


def test_state_does_not_grow_with_history() -> None:
    policies = [
        Policy(AnyChange(), order=Order.MONOTONE),
        Policy(order=Order.STRICT, max_delay=1_000),
        Policy(SampleEvery(10), max_delay=1_000),
        Policy(
            SampleEvery(7), 1_000, Duration(0, None, True), Order.ANY, Approximation.MOST_RECENT
        ),
    ]
    for policy in policies:
        adaptation = adapt(policy)
        held = 0
        for i in range(200):
            valid = np.arange(i * 10_000, (i + 1) * 10_000, 10, dtype=np.int64)
            adaptation.push(SampleBatch(valid + 5, valid, {}))
            held = max(held, adaptation.counters.pending)
        assert held <= 101


def test_the_last_instant_has_room_and_no_later_one_exists() -> None:
    """The delay reaches beyond the end of time."""
    policy, start, pool = Policy(max_delay=50, order=Order.MONOTONE), TIME_MAX - 45, StringPool()
    samples = [(start, start, (1, "a")), (start, start + 1, (1, "a"))]
    part = [(TIME_MAX, *samples[0][1:])]
    assert addable(part, samples, policy) == (TIME_MAX, *samples[1][1:])
    found = prove(batch_of(part, pool), batch_of(samples, pool), policy)
    assert found is not None
    assert f"valid at {start + 1} could be sent at {TIME_MAX}" in found.message


@LAWS
@given(st.data(), st.sampled_from([0, TIME_MIN + 50, TIME_MAX - 45]))
def test_proof_agrees_with_the_definition(data: st.DataObject, base: int) -> None:
    """On what was made, and on what was spoilt afterwards."""
    samples, policy = data.draw(streams(base)), data.draw(policies(base))
    run = Run(samples, policy).feed([])
    spoilt = list(run.sent)
    how = data.draw(st.sampled_from(["not", "less", "other", "later", "earlier", "some"]))
    if how == "some":
        keeps = data.draw(st.lists(st.booleans(), min_size=len(samples), max_size=len(samples)))
        spoilt = [sample for sample, keep in zip(samples, keeps, strict=True) if keep]
    elif spoilt and how != "not":
        row = data.draw(st.integers(0, len(spoilt) - 1))
        ta, tv, value = spoilt[row]
        match how:
            case "less":
                del spoilt[row]
            case "other":
                spoilt[row] = (ta, tv, (7, "z"))
            case "later":
                spoilt[row] = (min(ta + 1, TIME_MAX), tv, value)
            case "earlier":
                spoilt[row] = (max(ta - 1, TIME_MIN), tv, value)
    whole = [s for s in extend(samples, policy, horizon(samples, policy)) if s[0] <= TIME_MAX]
    expected = (
        satisfies(spoilt, policy)
        and origins(spoilt, whole) is not None
        and addable(spoilt, whole, policy) is None
    )
    found = prove(batch_of(spoilt, run.pool), batch_of(samples, run.pool), policy)
    if base > 0 and how == "not":
        return  # at the end of time there may be no moment left, see above
    assert (found is None) == expected, found


def test_an_instant_has_room_for_all_of_its_samples() -> None:
    """SPEC §1: samples of one instant differ by their sequence numbers."""
    sweeps = [(time, time, (x, None)) for time in (100, 200, 300) for x in range(10)]
    first, pool = sweeps[::10], StringPool()
    for policy in (
        Policy(max_delay=0),
        Policy(AnyChange(), max_delay=0),
        Policy(order=Order.MONOTONE, max_delay=0),
        Policy(ChangeBy(1)),
    ):
        assert prove(batch_of(sweeps, pool), batch_of(sweeps, pool), policy) is None
        for row in (0, 4, 9, 15, 29):
            left = [*sweeps[:row], *sweeps[row + 1 :]]
            found = prove(batch_of(left, pool), batch_of(sweeps, pool), policy)
            assert found is not None, (policy, row)
            assert (found.row, found.is_missing) == (row, True)
        assert prove(batch_of(first, pool), batch_of(sweeps, pool), policy) is not None


def test_no_sample_stands_before_its_place_in_its_instant() -> None:
    """Without a wait, the one valid at 3 came after the one valid at 5."""
    samples, pool = [(9, 5, (1, None)), (9, 3, (1, None))], StringPool()
    sent = batch_of(samples[:1], pool)
    assert prove(sent, batch_of(samples, pool), Policy(order=Order.MONOTONE)) is None
    found = prove(sent, batch_of(samples[::-1], pool), Policy(order=Order.MONOTONE))
    assert found is not None
    assert "valid at 3 could be sent at 9" in found.message
