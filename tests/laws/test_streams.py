"""Fluent streams and generators against their definitions ([DyKnow10 Def. 5.5-5.8], SPEC §1)."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.streams.fluent import FluentStream, Retention, join_availtimes
from dyknow.streams.generator import StreamGenerator
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows

LIMITS = settings(deadline=None, max_examples=150)
SCHEMA = Schema((Field("v", FieldType.INTEGER),))
NO_SAMPLE = None


def make(samples):
    return batch_from_rows(SCHEMA, [(a, v, {"v": value}) for a, v, value in samples])


def samples_of(batch):
    return [(a, v, values["v"]) for a, v, values in batch.rows()]


class Definition:
    """Def. 5.5-5.8 word for word, over a set of samples (t_a, t_v, v)."""

    def __init__(self, samples):
        self.samples = set(samples)

    def avail(self, t):
        return {s for s in self.samples if s[0] <= t}

    def last_avail(self, t):
        return max(self.avail(t), key=lambda s: s[0], default=NO_SAMPLE)

    def before(self, t, tq):
        return {s for s in self.avail(tq) if s[1] <= t}

    def most_recent_at(self, t, tq):
        before = self.before(t, tq)
        newest = {s for s in before if all(other[1] <= s[1] for other in before)}
        return Definition(newest).last_avail(tq)

    def prev(self, sample):
        earlier = {s for s in self.samples if s[0] < sample[0]}
        return max(earlier, key=lambda s: s[0], default=NO_SAMPLE)

    def availtimes(self):
        return {s[0] for s in self.samples}


TIMES = st.integers(-5, 20) | st.integers(-(2**63), 2**63 - 1)


@st.composite
def streams(draw):
    """Samples of a fluent stream and the batches it was appended in."""
    available = sorted(draw(st.sets(TIMES, max_size=12)))
    samples = [(t, draw(TIMES), i) for i, t in enumerate(available)]
    cuts = sorted(draw(st.lists(st.integers(0, len(samples)), max_size=4)))
    stream = FluentStream(SCHEMA)
    for start, end in zip([0, *cuts], [*cuts, len(samples)], strict=True):
        stream.append(make(samples[start:end]))
    return samples, stream


def one(batch):
    assert len(batch) <= 1
    return samples_of(batch)[0] if len(batch) else NO_SAMPLE


@given(streams(), TIMES, TIMES)
@LIMITS
def test_a_fluent_stream_answers_as_defined(drawn, t, tq):
    samples, stream = drawn
    defined = Definition(samples)
    assert set(samples_of(stream.avail(t))) == defined.avail(t)
    assert one(stream.last_avail(t)) == defined.last_avail(t)
    assert set(samples_of(stream.before(t, tq))) == defined.before(t, tq)
    assert one(stream.most_recent_at(t, tq)) == defined.most_recent_at(t, tq)
    assert set(stream.availtimes().tolist()) == defined.availtimes()
    for sample in samples:
        assert one(stream.prev(sample[0])) == defined.prev(sample)
    expected = [s for s in samples if t <= s[0] <= tq]
    assert samples_of(stream.between(t, tq)) == expected
    assert samples_of(stream.between(None, tq)) == sorted(defined.avail(tq))


@given(streams(), streams())
@LIMITS
def test_availtimes_of_several_streams_is_the_union(one_stream, other):
    expected = Definition(one_stream[0]).availtimes() | Definition(other[0]).availtimes()
    assert join_availtimes(one_stream[1], other[1]).tolist() == sorted(expected)


@given(streams(), st.integers(1, 14), st.none() | st.integers(1, 14))
@LIMITS
def test_since_gives_every_kept_sample_from_its_number_on(drawn, number, limit):
    samples, stream = drawn
    found = stream.since(number, limit)
    numbers = [n for part in found for n in range(part.first, part.last + 1)]
    got = [s for part in found for s in samples_of(part.batch)]
    wanted = samples[number - 1 :]
    assert got == wanted[: len(got)]
    assert numbers == list(range(number, number + len(got)))
    assert len(got) >= min(len(wanted), len(wanted) if limit is None else limit)


@given(
    st.lists(st.integers(1, 4), max_size=10),
    st.integers(1, 12),
    st.none() | st.integers(0, 40),
    st.integers(1, 9),
)
@LIMITS
def test_retention_keeps_enough_and_at_most_a_batch_more(sizes, most, age, step):
    stream = FluentStream(SCHEMA, Retention(most, age))
    every, time = [], 0
    for size in sizes:
        batch = [(time + i * step, 0, i) for i in range(size)]
        time += size * step
        stream.append(make(batch))
        every.extend(batch)
    kept = samples_of(stream.all())
    assert kept == every[len(every) - len(kept) :]
    assert stream.last_number == len(every)
    assert stream.first_number == len(every) - len(kept) + 1
    young = [s for s in every if age is None or s[0] >= every[-1][0] - age]
    asked = min(len(young), most)
    assert asked <= len(kept) <= asked + max(sizes, default=0)


class Recorder:
    """A receiver that checks the watermark's promise on every call."""

    def __init__(self):
        self.samples = []
        self.watermark = None
        self.ends = 0

    def receive(self, source, batch):
        for sample in samples_of(batch):
            assert not self.samples or sample[0] > self.samples[-1][0]
            assert self.watermark is None or sample[0] >= self.watermark
            self.samples.append(sample)

    def advance(self, source, watermark):
        assert self.watermark is None or watermark > self.watermark
        self.watermark = watermark

    def ended(self, source):
        self.ends += 1


class OneByOne:
    """The definition of a generator whose samples bring their available times."""

    def __init__(self, lateness):
        self.lateness = lateness
        self.stream, self.pending = [], []
        self.greatest = self.watermark = None
        self.late = self.duplicate = 0

    def offer(self, sample):
        available = sample[0]
        horizon = -(2**63) if self.greatest is None else self.greatest - self.lateness
        promised = -(2**63) if self.watermark is None else self.watermark
        if available < max(horizon, promised):
            self.late += 1
        elif any(available == other[0] for other in (*self.stream, *self.pending)):
            self.duplicate += 1
        else:
            self.pending.append(sample)
            self.greatest = available if self.greatest is None else max(self.greatest, available)
        if self.greatest is not None:
            self.promise(max(-(2**63), self.greatest - self.lateness), closed=True)

    def promise(self, watermark, closed=False):
        """Release what nothing can overtake: up to a time that has been, or before a promise."""
        due = [s for s in self.pending if s[0] < watermark or (closed and s[0] == watermark)]
        self.pending = [s for s in self.pending if s not in due]
        self.stream.extend(sorted(due))
        self.watermark = watermark if self.watermark is None else max(self.watermark, watermark)

    def end(self):
        self.stream.extend(sorted(self.pending))
        self.pending = []
        if self.stream:
            last = self.stream[-1][0]
            self.watermark = last if self.watermark is None else max(self.watermark, last)


STEPS = st.lists(
    st.one_of(
        st.lists(st.integers(0, 25) | st.sampled_from([-(2**63), -(2**63) + 2]), max_size=6),
        st.tuples(st.just("advance"), st.integers(0, 25)),
        st.just("end"),
    ),
    max_size=6,
)


@given(STEPS, st.integers(0, 8))
@LIMITS
def test_a_generator_equals_its_sample_by_sample_definition(steps, lateness):
    generator = StreamGenerator("s", SCHEMA, lateness=lateness)
    defined, recorder, number = OneByOne(lateness), Recorder(), 0
    generator.subscribe(recorder)
    for step in steps:
        match step:
            case "end":
                generator.end()
                defined.end()
            case ("advance", watermark):
                generator.advance(watermark)
                defined.promise(watermark)
            case times:
                samples = [(t, 0, number + i) for i, t in enumerate(times)]
                number += len(times)
                assert generator.offer(make(samples)) == len(samples)
                for sample in samples:
                    defined.offer(sample)
        counters = generator.counters
        assert samples_of(generator.stream.all()) == defined.stream == recorder.samples
        assert generator.watermark == defined.watermark == recorder.watermark
        assert (counters.late, counters.duplicate) == (defined.late, defined.duplicate)
        assert (counters.used, counters.pending) == (len(defined.stream), len(defined.pending))
        assert (
            counters.accepted
            == number
            == (
                counters.used
                + counters.late
                + counters.duplicate
                + counters.expired
                + counters.pending
            )
        )
    generator.close()
    assert generator.counters.expired == len(defined.pending)


@given(
    st.lists(st.tuples(st.integers(0, 30), st.integers(0, 4), st.booleans()), max_size=8),
)
@LIMITS
def test_samples_stamped_on_arrival_are_never_late(offers):
    generator, recorder = StreamGenerator("s", SCHEMA), Recorder()
    generator.subscribe(recorder)
    taken = 0
    for now, count, tick in offers:
        if tick:
            generator.advance(now)
        generator.offer(make([(7, 0, i) for i in range(count)]), now)
        taken += count
        if count:
            assert generator.stream.last_available >= now
    assert generator.counters.used == taken == len(recorder.samples)
    assert np.all(np.diff(generator.stream.availtimes()) > 0)
