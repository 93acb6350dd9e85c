"""Fluent streams and generators against their definitions ([DyKnow10 Def. 5.5-5.8], SPEC §1)."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.streams.generator import StreamGenerator
from dyknow.streams.history import FluentStream, Retention, join_availtimes
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows

LIMITS = settings(deadline=None, max_examples=150)
SCHEMA = Schema((Field("v", FieldType.INTEGER),))
NO_SAMPLE = None


def make(samples):
    return batch_from_rows(SCHEMA, [(a, v, {"v": value}) for a, v, value in samples])


def samples_of(batch):
    return [(a, v, values["v"]) for a, v, values in batch.rows()]


class Definition:
    """Def. 5.5-5.8 word for word, over a set of samples (t_a, t_v, v), where v is the sequence
    number: (t_a, v) is the unique available time of the paper (SPEC §1).
    """

    def __init__(self, samples):
        self.samples = set(samples)

    def avail(self, t):
        return {s for s in self.samples if s[0] <= t}

    def last_avail(self, t):
        return max(self.avail(t), key=lambda s: (s[0], s[2]), default=NO_SAMPLE)

    def before(self, t, tq):
        return {s for s in self.avail(tq) if s[1] <= t}

    def most_recent_at(self, t, tq):
        before = self.before(t, tq)
        newest = {s for s in before if all(other[1] <= s[1] for other in before)}
        return Definition(newest).last_avail(tq)

    def prev(self, sample):
        earlier = {s for s in self.samples if s[0] < sample[0]}
        return max(earlier, key=lambda s: (s[0], s[2]), default=NO_SAMPLE)

    def availtimes(self):
        return {s[0] for s in self.samples}


TIMES = st.integers(-5, 20) | st.integers(-(2**63), 2**63 - 1)


@st.composite
def streams(draw):
    """Samples of a fluent stream and the batches it was appended in."""
    available = sorted(draw(st.lists(TIMES, max_size=12)))
    samples = [(t, draw(TIMES), i) for i, t in enumerate(available)]
    cuts = sorted(draw(st.lists(st.integers(0, len(samples)), max_size=4)))
    stream = FluentStream(SCHEMA)
    for start, end in zip([0, *cuts], [*cuts, len(samples)], strict=True):
        stream.append(make(samples[start:end]))
    return samples, stream


def in_order(samples):
    return sorted(samples, key=lambda s: (s[0], s[2]))


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
    assert samples_of(stream.between(None, tq)) == in_order(defined.avail(tq))


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
    st.lists(st.integers(1, 4) | st.integers(30, 70), max_size=12),
    st.integers(1, 12) | st.integers(60, 200),
    st.none() | st.integers(0, 40) | st.integers(100, 400),
    st.integers(1, 9),
)
@LIMITS
def test_retention_keeps_what_is_asked_for_and_the_newest_batch(sizes, most, age, step):
    stream = FluentStream(SCHEMA, Retention(most, age))
    every, time = [], 0
    for size in sizes:
        batch = [(time + i * step, 0, i) for i in range(size)]
        time += size * step
        stream.append(make(batch))
        every.extend(batch)
        young = [s for s in every if age is None or s[0] >= every[-1][0] - age]
        wanted = max(min(len(young), most), size)
        assert samples_of(stream.all()) == every[len(every) - wanted :]
        assert len(stream) == wanted
        assert stream.last_number == len(every)
        assert stream.first_number == len(every) - wanted + 1
        assert stream.first_available == every[-wanted][0]


TEXTS = Schema(
    (
        Field("v", FieldType.INTEGER),
        Field("is", FieldType.BOOLEAN),
        Field("a", FieldType.STRING),
        Field("b", FieldType.STRING),
    )
)
SOME_TEXT = st.none() | st.sampled_from(["", "a", "é", "aé" * 50, "x" * 400, "x" * 5_000])
ROWS = st.lists(st.tuples(SOME_TEXT, SOME_TEXT), max_size=40)


def bytes_of(values):
    """What docs/reference/streams.md says of the bytes of a sample."""
    texts = [value or "" for value in (values["a"], values["b"])]
    return 16 + 8 + 1 + sum(128 + len(t) * (1 if t.isascii() else 4) for t in texts)


@given(
    st.lists(ROWS, max_size=8),
    st.integers(1, 30),
    st.none() | st.integers(0, 60),
    st.integers(1, 1_000) | st.integers(1, 60_000),
    st.data(),
)
@LIMITS
def test_retention_by_bytes(batches, most, age, size, data):
    """Also where it is told later that less is kept, and texts are forgotten."""
    kept = Retention(data.draw(st.sampled_from([most, 10_000])), age, size)
    generator = StreamGenerator("s", TEXTS, retention=kept)
    stream = generator.stream
    every, time = [], 0
    for number, batch in enumerate(batches):
        rows = [
            (time + i, 0, {"v": time, "is": None if i % 3 else True, "a": a, "b": b})
            for i, (a, b) in enumerate(batch)
        ]
        time += len(batch)
        # Each has pools of its own, as it has when it comes.
        generator.offer(batch_from_rows(TEXTS, rows))
        every.extend(rows)
        asked = newest(every, kept)
        wanted = max(asked, len(rows))
        assert list(stream.all().rows()) == every[len(every) - len(stream) :]
        if rows:
            assert len(stream) == wanted
        if number % 3 == 2:
            kept = Retention(data.draw(st.integers(1, 30)), age, data.draw(st.integers(1, 9_000)))
            there = len(stream)
            stream.retention = kept
            # The newest sample stays, and what has gone does not come back.
            assert len(stream) == min(max(newest(every, kept), 1), there)
            every = every[len(every) - len(stream) :]


def newest(rows, kept):
    """How many of the newest no limit forbids."""
    count, size = 0, 0
    for available, _, values in reversed(rows):
        size += bytes_of(values)
        old = kept.age is not None and available < rows[-1][0] - kept.age
        if count == kept.samples or size > kept.bytes or old:
            break
        count += 1
    return count


@given(st.lists(ROWS, max_size=8), st.integers(1, 60_000))
@LIMITS
def test_history_by_bytes_does_not_depend_on_how_it_was_cut(batches, size):
    rows = [row for batch in batches for row in batch]
    samples = [(i, 0, {"v": i, "is": True, "a": a, "b": b}) for i, (a, b) in enumerate(rows)]
    cut, whole = (FluentStream(TEXTS, Retention(bytes=size)) for _ in range(2))
    at = 0
    for batch in batches:
        cut.append(cut.encoded(batch_from_rows(TEXTS, samples[at : at + len(batch)])))
        at += len(batch)
    for sample in samples:
        whole.append(whole.encoded(batch_from_rows(TEXTS, [sample])))
    # The newest batch is always there as a whole.
    asked = newest(samples, Retention(bytes=size))
    last = next((len(batch) for batch in reversed(batches) if batch), 0)
    for stream, least in (cut, last), (whole, min(last, 1)):
        assert list(stream.all().rows()) == samples[len(samples) - max(asked, least) :]


@st.composite
def long_streams(draw):
    """Histories of many batches, mostly of single samples, with the valid times of all sorts."""
    sizes = draw(st.lists(st.sampled_from([1] * 6 + [2, 31, 33, 150]), max_size=120))
    count = sum(sizes)
    random = np.random.default_rng(draw(st.integers(0, 2**32)))
    noise = draw(st.sampled_from([0, 3, 500]))
    available = np.cumsum(random.integers(draw(st.integers(0, 1)), 4, count))
    valid = available - random.integers(0, noise + 1, count)
    samples = [(int(a), int(v), i) for i, (a, v) in enumerate(zip(available, valid, strict=True))]
    kept = Retention(draw(st.sampled_from([40, 300, 100_000])), draw(st.sampled_from([None, 200])))
    stream, at, handed = FluentStream(SCHEMA, kept), 0, []
    for size in sizes:
        stream.append(make(samples[at : at + size]))
        at += size
        if size == 33:
            handed.append((stream.all(), samples[stream.first_number - 1 : at]))
    return samples[stream.first_number - 1 :], stream, handed


@given(
    long_streams(), st.lists(st.tuples(st.integers(-3, 1500), st.integers(-3, 1500)), max_size=9)
)
@settings(deadline=None, max_examples=40)
def test_long_histories_answer_as_defined_however_they_were_put_together(drawn, times):
    samples, stream, handed = drawn
    defined = Definition(samples)
    assert samples_of(stream.all()) == samples
    assert stream.availtimes().tolist() == sorted({s[0] for s in samples})
    for batch, then in handed:  # what was handed out never changes
        assert samples_of(batch) == then
    for t, tq in times:
        assert one(stream.last_avail(t)) == defined.last_avail(t)
        assert samples_of(stream.avail(t)) == in_order(defined.avail(t))
        assert set(samples_of(stream.before(t, tq))) == defined.before(t, tq)
        assert one(stream.most_recent_at(t, tq)) == defined.most_recent_at(t, tq)
        assert one(stream.prev(t)) == defined.prev((t,))
        assert samples_of(stream.between(t, tq)) == [s for s in samples if t <= s[0] <= tq]
        found = stream.since(t, max(1, tq))
        first = max(t, stream.first_number)
        got = [s for part in found for s in samples_of(part.batch)]
        wanted = samples[first - stream.first_number :]
        assert got == wanted[: len(got)]
        assert len(got) >= min(len(wanted), max(1, tq))
        assert [n for p in found for n in range(p.first, p.last + 1)] == list(
            range(first, first + len(got))
        )
        newest = samples_of(stream.newest(max(0, tq)))
        assert newest == samples[max(0, len(samples) - max(0, tq)) :]


class Recorder:
    """A receiver that checks the watermark's promise on every call."""

    knows_codes = False

    def __init__(self):
        self.samples = []
        self.watermark = None
        self.ends = 0

    def receive(self, source, batch):
        for available, valid, values in batch.rows():
            sample = (available, valid, *values.values())
            assert not self.samples or sample[0] >= self.samples[-1][0]
            assert self.watermark is None or sample[0] >= self.watermark
            self.samples.append(sample)

    def advance(self, source, watermark):
        assert self.watermark is None or watermark > self.watermark
        self.watermark = watermark

    def resumed(self, source):
        pass

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
        elif sample in (*self.stream, *self.pending):
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
        self.stream.extend(sorted(due, key=lambda s: s[0]))
        self.watermark = watermark if self.watermark is None else max(self.watermark, watermark)

    def end(self):
        self.stream.extend(sorted(self.pending, key=lambda s: s[0]))
        self.pending = []
        if self.stream:
            last = self.stream[-1][0]
            self.watermark = last if self.watermark is None else max(self.watermark, last)


MIXED = Schema((Field("x", FieldType.FLOAT), Field("name", FieldType.STRING)))
STEPS = st.lists(
    st.one_of(
        st.lists(
            st.tuples(
                st.integers(0, 25) | st.sampled_from([-(2**63), -(2**63) + 2]),
                st.integers(0, 1),
                st.sampled_from([0.0, -0.0, 1.5, None]),
                st.sampled_from(["a", "b", None]),
            ),
            max_size=6,
        ),
        st.tuples(st.just("advance"), st.integers(0, 25)),
        st.just("end"),
    ),
    max_size=6,
)


@given(STEPS, st.integers(0, 8), st.sampled_from([1, 3, 100]))
@LIMITS
def test_a_generator_equals_its_sample_by_sample_definition(steps, lateness, kept):
    generator = StreamGenerator("s", MIXED, lateness=lateness, retention=Retention(kept))
    defined, recorder, number = OneByOne(lateness), Recorder(), 0
    generator.subscribe(recorder)
    for step in steps:
        match step:
            case "end":
                generator.end()
                defined.end()
            case ("advance", int(watermark)):
                generator.advance(watermark)
                defined.promise(watermark)
            case samples:
                rows = [(a, v, {"x": x, "name": name}) for a, v, x, name in samples]
                number += len(rows)
                # Each batch has a pool of its own, as it has when it comes.
                assert generator.offer(batch_from_rows(MIXED, rows)) == len(samples)
                for sample in samples:
                    defined.offer(sample)
        counters = generator.counters
        assert recorder.samples == defined.stream
        history = [(a, v, *values.values()) for a, v, values in generator.stream.all().rows()]
        assert history == defined.stream[len(defined.stream) - len(history) :]
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
        before = len(recorder.samples)
        generator.offer(make([(7, 0, i) for i in range(count)]), now)
        taken += count
        if count:
            assert generator.stream.last_available >= now
            # The whole batch is one instant, after those of all batches before it.
            assert {s[0] for s in recorder.samples[before:]} == {generator.stream.last_available}
            assert not before or recorder.samples[before - 1][0] < recorder.samples[before][0]
            assert generator.watermark == generator.stream.last_available + 1
    assert generator.counters.used == taken == len(recorder.samples)
