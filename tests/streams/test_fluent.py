"""The numbers of [DyKnow10 Examples 5.2 and 5.3], and what a stream refuses."""

import pytest

from dyknow.streams import runs
from dyknow.streams.generator import StreamGenerator
from dyknow.streams.history import FluentStream, Retention, join_availtimes
from dyknow.streams.sample import (
    Field,
    FieldType,
    SampleError,
    Schema,
    batch_from_rows,
    concatenate,
)
from dyknow.streams.string_pool import StringPool

SCHEMA = Schema((Field("v", FieldType.STRING),))


def stream(*samples, retention=None):
    made = FluentStream(SCHEMA, retention, {"v": StringPool()})
    rows = [(a, v, {"v": value}) for a, v, value in samples]
    made.append(batch_from_rows(SCHEMA, rows, made.pools))
    return made


def samples(batch):
    return [(a, v, values["v"]) for a, v, values in batch.rows()]


def test_example_5_2_valid_time_stays_while_available_time_moves():
    received = stream((474, 471, "p"))
    same_computer, other_computer = stream((482, 471, "b")), stream((499, 471, "b"))
    assert samples(received.last_avail(474)) == [(474, 471, "p")]
    assert samples(received.last_avail(473)) == []
    assert samples(same_computer.most_recent_at(471, 482)) == [(482, 471, "b")]
    assert samples(other_computer.most_recent_at(471, 482)) == []


F1 = ((1, 1, "v1"), (3, 2, "v2"), (4, 5, "v3"))
F2 = ((2, 1, "v4"), (4, 1, "v5"), (5, 1, "v6"))


def test_example_5_3_fluent_streams():
    f1, f2 = stream(*F1), stream(*F2)
    assert samples(f1.avail(3)) == list(F1[:2])
    assert samples(f1.last_avail(3)) == [F1[1]]
    assert samples(f1.last_avail(0)) == []
    assert samples(f1.before(4, 4)) == list(F1[:2])
    assert samples(f1.most_recent_at(4, 4)) == [F1[1]]
    assert samples(f1.most_recent_at(5, 4)) == [F1[2]]
    assert samples(f1.most_recent_at(5, 3)) == [F1[1]]
    # Three samples for one valid time: the better estimate came last.
    assert [samples(f2.most_recent_at(1, t)) for t in (1, 2, 4, 5)] == [
        [],
        [F2[0]],
        [F2[1]],
        [F2[2]],
    ]
    assert [samples(f1.prev(s[0])) for s in F1] == [[], [F1[0]], [F1[1]]]
    assert f1.availtimes().tolist() == [1, 3, 4]
    assert join_availtimes(f1, f2).tolist() == [1, 2, 3, 4, 5]
    assert join_availtimes().tolist() == []


@pytest.mark.parametrize("times", [(3,), (7, 6)])
def test_available_times_do_not_decrease(times):
    made = stream(*F1)
    batch = batch_from_rows(SCHEMA, [(t, 0, {"v": "x"}) for t in times], made.pools)
    with pytest.raises(ValueError, match="do not decrease"):
        made.append(batch)
    assert samples(made.all()) == list(F1)


def test_samples_of_an_instant_stand_in_order_of_sequence():
    made = stream(*F1)
    rows = [(4, 6, {"v": "x"}), (4, 6, {"v": "y"}), (7, 1, {"v": "z"})]
    for row in rows:
        made.append(batch_from_rows(SCHEMA, [row], made.pools))
    assert samples(made.last_avail(4)) == [(4, 6, "y")]
    assert samples(made.most_recent_at(9, 4)) == [(4, 6, "y")]
    assert samples(made.prev(7)) == [(4, 6, "y")]
    assert samples(made.prev(4)) == [F1[1]]
    assert made.availtimes().tolist() == [1, 3, 4, 7]
    # A piece ends with its instant: the next one begins after that time.
    assert samples(made.between(4, None, most=1)) == [F1[2], (4, 6, "x"), (4, 6, "y")]
    assert samples(made.between(None, 4, most=2, newest=True)) == [(4, 6, "x"), (4, 6, "y")]


def test_numbers_go_on_when_history_is_dropped():
    pools = {"v": StringPool()}
    made = FluentStream(SCHEMA, Retention(samples=2), pools)
    for time in range(5):
        made.append(batch_from_rows(SCHEMA, [(time, time, {"v": None})], pools))
    assert (len(made), made.first_number, made.last_number) == (2, 4, 5)
    assert made.first_available == 3
    assert [n for part in made.since(1) for n in range(part.first, part.last + 1)] == [4, 5]
    assert made.since(6) == []
    assert made.append(made.all().take(slice(0, 0))) is None


def test_a_stream_that_never_spoke():
    made = FluentStream(SCHEMA)
    assert (len(made), made.first_number, made.last_number) == (0, 1, 0)
    assert made.last_available is None
    assert made.first_available is None
    assert len(made.all()) == len(made.most_recent_at(0, 0)) == len(made.prev(0)) == 0


@pytest.mark.parametrize(
    ("type", "value", "message"),
    [
        ("float", float("nan"), "must be finite"),
        ("float", float("inf"), "must be finite"),
        ("float", 10**400, "must be finite"),
        ("float", True, "is a float"),
        ("integer", 1.0, "is an integer"),
        ("integer", 2**63, "outside 64 bits"),
        ("boolean", 1, "is a boolean"),
        ("string", 1, "is a string"),
    ],
)
def test_an_ill_typed_value_names_row_and_field(type, value, message):
    schema = Schema((Field("x", FieldType(type)),))
    with pytest.raises(SampleError, match=message) as caught:
        batch_from_rows(schema, [(1, 1, {"x": None}), (2, 2, {"x": value})])
    assert (caught.value.row, caught.value.field) == (1, "x")


@pytest.mark.parametrize(
    ("values", "message"), [({}, "is missing"), ({"v": "a", "w": 1}, "is not declared")]
)
def test_missing_and_undeclared_fields_are_errors(values, message):
    with pytest.raises(SampleError, match=message):
        batch_from_rows(SCHEMA, [(1, 1, values)])


def test_newest_crosses_batches_and_begins_where_history_does():
    made = stream(*F1, retention=Retention(samples=4))
    for time in (6, 7, 8):
        made.append(batch_from_rows(SCHEMA, [(time, time, {"v": "w"})], made.pools))
    assert [a for a, _, _ in samples(made.newest(2))] == [7, 8]
    assert [a for a, _, _ in samples(made.newest(4))] == [4, 6, 7, 8]
    assert samples(made.newest(99)) == samples(made.all())
    assert samples(stream().newest(3)) == []


def test_between_takes_parts_of_batches():
    made = stream(*F1)
    for time in (6, 7, 8):
        made.append(batch_from_rows(SCHEMA, [(time, time, {"v": "w"})], made.pools))
    assert [a for a, _, _ in samples(made.between(3, 7))] == [3, 4, 6, 7]
    assert [a for a, _, _ in samples(made.between(5, 6))] == [6]
    assert samples(made.between(5, 5)) == samples(made.between(9, None)) == []
    for start, end in ((None, None), (3, 7), (None, 6), (4, None), (9, None)):
        every = samples(made.between(start, end))
        for most in (1, 2, 3, 100):
            assert samples(made.between(start, end, most=most)) == every[:most]
            assert samples(made.between(start, end, most=most, newest=True)) == every[-most:]


NUMBERS = Schema((Field("n", FieldType.INTEGER),))


@pytest.mark.parametrize(
    "sizes", [[1] * 5000, [1, 40] * 800, [3, 1, 1, 700] * 30, [1, 1, 2000] * 9]
)
def test_histories_of_many_batches_are_few_runs(sizes):
    made, at = FluentStream(NUMBERS, Retention(samples=10_000)), 0
    for size in sizes:
        rows = [(i, i, {"n": i}) for i in range(at, at + size)]
        made.append(batch_from_rows(NUMBERS, rows))
        at += size
        segments = made.since(made.first_number)
        # 31 of each size class below an eighth of the history, and what cannot grow any more:
        # of those, 32 in a row hold more than an eighth.
        assert len(segments) <= 2 * 31 + 9 * 32
        assert max(len(part.batch) for part in segments) <= max(1250, *sizes)
    assert made.all().columns["n"].values.tolist() == list(range(at - len(made), at))


LIGHT, HEAVY = 1, 9_000
OF_TWO_KINDS = {
    "heavy, then light": [HEAVY] * 32 + [LIGHT] * 8_000,
    "in turns": [HEAVY, LIGHT] * 2_000,
    "now and then": ([HEAVY] + [LIGHT] * 30) * 150,
    "in rows": ([HEAVY] * 33 + [LIGHT] * 200) * 20,
    "ever heavier": [1 + i % 3_000 for i in range(8_000)],
    "each an eighth": [120_000, *[LIGHT] * 40] * 60,
    "all heavy": [HEAVY] * 2_000,
}


@pytest.mark.parametrize("weights", OF_TWO_KINDS.values(), ids=OF_TWO_KINDS)
@pytest.mark.parametrize("size", [1, 7])
def test_histories_of_a_number_of_bytes_are_few_runs(monkeypatch, weights, size):
    """However heavy samples are beside others, and each is put together with others seldom."""
    copied = []

    def counted(batches):
        copied.append(sum(map(len, batches)))
        return concatenate(batches)

    monkeypatch.setattr(runs, "concatenate", counted)
    kept = Retention(bytes=1_000_000)
    made, at = FluentStream(SCHEMA, kept, {"v": StringPool()}), 0
    texts = []
    for weight in weights:
        texts += ["x" * weight] * size
        rows = [(i, i, {"v": "x" * weight}) for i in range(at, at + size)]
        made.append(batch_from_rows(SCHEMA, rows, made.pools))
        at += size
        assert len(made._runs) <= 2 * 31 + 9 * 32
    assert sum(copied) <= 6 * at
    monkeypatch.undo()
    assert made.all().columns["v"].tolist() == texts[at - len(made) :]


def test_of_a_large_batch_that_came_long_ago_what_is_kept_is_there():
    """Not all of it, as long as one of its samples is kept."""
    made = FluentStream(SCHEMA, Retention(bytes=100_000), {"v": StringPool()})
    rows = [(i, i, {"v": f"{i:0500}"}) for i in range(2_000)]
    made.append(batch_from_rows(SCHEMA, rows, made.pools))
    assert len(made) == 2_000
    for time in range(2_000, 2_020):
        made.append(batch_from_rows(SCHEMA, [(time, time, {"v": "x"})], made.pools))
    assert len(made) < 200
    assert sum(len(run.batch) for run in made._runs) < 2 * len(made)


def test_a_large_batch_is_not_copied():
    made = FluentStream(NUMBERS, Retention(samples=1000))
    rows = [(i, i, {"n": i}) for i in range(500)]
    large = batch_from_rows(NUMBERS, rows)
    made.append(large)
    for time in range(500, 540):
        made.append(batch_from_rows(NUMBERS, [(time, time, {"n": time})]))
    assert made.since(1)[0].batch is large


class Reader:
    knows_codes = True

    def receive(self, source, batch):
        self.batch = batch

    def advance(self, source, watermark):
        pass


def test_texts_that_nobody_has_any_more_are_forgotten():
    """Of a stream that nobody reads; who reads it may know them by their codes."""
    generator = StreamGenerator(
        "s",
        Schema((Field("name", FieldType.STRING),)),
        retention=Retention(50),
        pools={"name": StringPool()},
    )
    reader = Reader()
    sizes = []

    def say(first, last):
        for k in range(first, last):
            rows = [(k * 10 + i, 0, {"name": f"name {k} {i}"}) for i in range(10)]
            generator.offer(batch_from_rows(generator.schema, rows, generator.stream.pools))
            sizes.append(len(generator.stream.pools["name"]))

    say(0, 2_000)
    assert max(sizes) < 5_000
    assert [row[2]["name"] for row in generator.stream.all().rows()] == [
        f"name {k} {i}" for k in range(1_995, 2_000) for i in range(10)
    ]
    generator.subscribe(reader)
    pool = generator.stream.pools["name"]
    say(2_000, 3_000)
    assert generator.stream.pools["name"] is pool is reader.batch.columns["name"].pool
    generator.unsubscribe(reader)
    say(3_000, 3_001)
    assert len(generator.stream.pools["name"]) <= 60
