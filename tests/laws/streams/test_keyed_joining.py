"""join object by object against its definition, however inputs are cut and mixed."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from keyed_join_definition import keyed_join

from dyknow.streams.joins.join import Join
from dyknow.streams.joins.keyed_join import KEY, KeyedJoin
from dyknow.streams.key_numbering import Numbering, paired
from dyknow.streams.sample import Column, FieldType, SampleBatch
from dyknow.streams.string_pool import StringPool

LIMITS = settings(deadline=None, max_examples=200)
LEAST, GREATEST = -(2**63), 2**63 - 1
SMALL = st.integers(-3, 14)
EDGES = st.integers(LEAST, LEAST + 5) | st.integers(GREATEST - 5, GREATEST) | st.integers(-3, 3)
KEYS = st.none() | st.sampled_from([0, 1, 2, -7, 2**62])


@st.composite
def worlds(draw, times=SMALL, most=8):
    """(streams, keyed): each stream [(available, valid, key)]."""
    keyed = draw(st.lists(st.booleans(), min_size=1, max_size=4))
    streams = [
        [
            (a, draw(times), draw(KEYS) if each else None)
            for a in sorted(draw(st.lists(times, max_size=most)))
        ]
        for each in keyed
    ]
    return streams, keyed


@st.composite
def feedings(draw, streams, with_pauses):
    """One way to tell ``streams``: [(input, "push" | "advance" | "end" | "resume", what)], ends
    included. A pause is an end that is taken back."""
    queues = []
    for stream in streams:
        cuts = draw(st.lists(st.integers(0, len(stream)), max_size=4))
        bounds = sorted({0, len(stream), *cuts})
        told = []
        for low, high in pairwise(bounds):
            if draw(st.booleans()):
                floor = stream[low - 1][0] if low else LEAST
                told.append(("advance", draw(st.integers(floor, stream[low][0]))))
            if with_pauses and draw(st.booleans()):
                told += [("end", None), ("resume", None)]
            told.append(("push", (low, high)))
        if draw(st.booleans()):
            told.append(
                ("advance", draw(st.integers(stream[-1][0] if stream else LEAST, GREATEST)))
            )
        queues.append([*told, ("end", None)])
    steps = []
    while any(queues):
        i = draw(st.sampled_from([k for k, queue in enumerate(queues) if queue]))
        steps.append((i, *queues[i].pop(0)))
    return steps


class Told:
    """A world that is told to a join; samples that come too late are left out, and noted."""

    def __init__(self, streams, keyed):
        self.streams, self.keyed = streams, keyed
        self.join = KeyedJoin(keyed)
        self.pools = [StringPool() for _ in streams]
        self.accepted = [set() for _ in streams]
        self.late = 0
        self.given = []

    def batch(self, i, rows):
        """Samples that say which they are, as an integer and as text, one of three has no value."""
        times = np.array([self.streams[i][k][:2] for k in rows], np.int64).reshape(-1, 2)
        null = np.array([k % 3 == 0 for k in rows], np.bool_)
        texts = self.pools[i].encode([str(k) for k in rows])
        columns = {
            "n": Column(FieldType.INTEGER, np.array(rows, np.int64)),
            "text": Column(FieldType.STRING, texts, null if null.any() else None, self.pools[i]),
        }
        return SampleBatch(times[:, 0].copy(), times[:, 1].copy(), columns)

    def keys(self, i, rows):
        if not self.keyed[i]:
            return None
        keys = [self.streams[i][k][2] for k in rows]
        null = np.array([key is None for key in keys], np.bool_)
        values = np.array([99 if key is None else key for key in keys], np.int64)
        return Column(FieldType.INTEGER, values, null if null.any() else None)

    def push(self, i, low, high):
        decided = self.join.decided(i)
        rows = [k for k in range(low, high) if self.streams[i][k][0] > decided]
        self.late += high - low - len(rows)
        if high > low and len(rows) < high - low:
            refused = range(low, high)
            with pytest.raises(ValueError, match="available times of an input do not decrease"):
                self.join.push(i, self.batch(i, refused), self.keys(i, refused))
        self.accepted[i].update(rows)
        self.take(self.join.push(i, self.batch(i, rows), self.keys(i, rows)))

    def tell(self, i, what, content):
        match what:
            case "push":
                self.push(i, *content)
            case "advance":
                self.take(self.join.advance(i, content))
            case "resume":
                self.join.resume(i)
            case _:
                self.take(self.join.end(i))

    def take(self, tuples):
        if tuples is None:
            return
        assert len(tuples)
        names = [tuples.column(i, "n").tolist() for i in range(len(self.streams))]
        for i, own in enumerate(names):
            assert KEY not in tuples.inputs[i].columns
            assert tuples.column(i, "text").tolist() == [str(k) if k % 3 else None for k in own]
            assert tuples.times(i, "available").tolist() == [self.streams[i][k][0] for k in own]
        self.given += zip(
            tuples.available.tolist(), tuples.valid.tolist(), zip(*names, strict=True), strict=True
        )

    def expected(self, known):
        """What the definition gives up to ``known``, of the samples that did not come too late."""
        if known is None:
            return []
        chosen = [sorted(rows) for rows in self.accepted]
        streams = [
            [stream[k] for k in rows] for stream, rows in zip(self.streams, chosen, strict=True)
        ]
        return [
            (t, valid, tuple(own[k] for own, k in zip(chosen, rows, strict=True)))
            for t, valid, rows in keyed_join(streams, self.keyed)
            if t <= known
        ]

    def keyless(self, known):
        return sum(
            self.streams[i][k][2] is None and self.streams[i][k][0] <= known
            for i, rows in enumerate(self.accepted)
            for k in rows
            if self.keyed[i]
        )


@pytest.mark.parametrize("times", [SMALL, EDGES], ids=["small", "edges"])
@LIMITS
@given(st.data())
def test_it_is_the_definition_however_it_is_fed(times, data):
    streams, keyed = data.draw(worlds(times))
    told = Told(streams, keyed)
    for step in data.draw(feedings(streams, with_pauses=False)):
        told.tell(*step)
        known = told.join.known
        assert told.given == told.expected(known)
        if known is not None:
            assert told.join.keyless == told.keyless(known)
            assert told.join.reached >= max((a for a, _, _ in told.given), default=LEAST - 1)
    assert told.late == 0
    whole = keyed_join(streams, keyed)
    assert told.given == whole
    assert [a for a, _, _ in whole] == sorted(a for a, _, _ in whole)


@LIMITS
@given(st.data())
def test_inputs_that_end_may_go_on(data):
    """What comes too late then is refused; of all else the tuples are those of the definition."""
    streams, keyed = data.draw(worlds())
    told = Told(streams, keyed)
    for step in data.draw(feedings(streams, with_pauses=True)):
        before = list(told.given)
        told.tell(*step)
        assert told.given[: len(before)] == before
        known = told.join.known
        assert told.given == told.expected(None if known is None else max(known, told.join._done))
    assert told.given == told.expected(GREATEST)


@LIMITS
@given(st.data())
def test_it_keeps_the_latest_sample_of_each_object_and_what_waits(data):
    streams, keyed = data.draw(worlds())
    told = Told(streams, keyed)
    for step in data.draw(feedings(streams, with_pauses=False)):
        told.tell(*step)
        known = told.join.known
        latest, waiting = set(), 0
        for i, rows in enumerate(told.accepted):
            for k in rows:
                a, _, key = streams[i][k]
                if known is None or a > known:
                    waiting += 1
                elif key is not None or not keyed[i]:
                    latest.add((i, key))
        assert told.join.retained == len(latest) + waiting


@LIMITS
@given(st.data())
def test_of_one_object_it_is_join_once_all_inputs_are_there(data):
    streams, _ = data.draw(worlds())
    inputs = [[(a, v, 5) for a, v, _ in stream] for stream in streams]
    told = Told(inputs, data.draw(st.sampled_from([[True], [False]])) * len(inputs))
    plain, tuples = Join(len(inputs)), []
    for i, what, content in data.draw(feedings(inputs, with_pauses=False)):
        told.tell(i, what, content)
        match what:
            case "push":
                made = plain.push(i, told.batch(i, range(*content)))
            case "advance":
                made = plain.advance(i, content)
            case _:
                made = plain.end(i)
        if made is not None:
            whole = made.take(np.logical_and.reduce([row >= 0 for row in made.rows]))
            if len(whole):
                columns = [whole.column(i, "n").tolist() for i in range(len(inputs))]
                tuples += zip(whole.available.tolist(), zip(*columns, strict=True), strict=True)
    assert [(a, rows) for a, _, rows in told.given] == tuples


def test_many_objects_at_once_are_the_same_as_few():
    """The arrays' growth and the two ways of sorting matter only with many objects."""
    random = np.random.default_rng(3)
    count, objects = 150_000, 70_000
    keys = [random.integers(0, objects, count) for _ in range(2)]
    times = [np.sort(random.choice(4 * count, count, replace=False)) for _ in range(2)]

    def given(size):
        join, made = KeyedJoin([True, True]), []
        for start in range(0, count, size):
            for i in range(2):
                part = slice(start, start + size)
                values = {"n": Column(FieldType.INTEGER, np.arange(count)[part])}
                batch = SampleBatch(times[i][part], times[i][part], values)
                made.append(join.push(i, batch, Column(FieldType.INTEGER, keys[i][part])))
        made += [join.end(i) for i in range(2)]
        told = [one for one in made if one is not None]
        return [
            np.concatenate(arrays)
            for arrays in zip(
                *[
                    (m.available, m.valid, m.column(0, "n").values, m.column(1, "n").values)
                    for m in told
                ],
                strict=True,
            )
        ]

    whole = given(count)
    assert len(whole[0]) > count
    assert np.array_equal(keys[0][whole[2]], keys[1][whole[3]])
    for size in (7_000, 401):
        for a, b in zip(whole, given(size), strict=True):
            np.testing.assert_array_equal(a, b)


def test_objects_of_one_time_stand_in_the_order_of_the_first_input_that_each_came_by():
    world = [[(5, 5, 1)], [(1, 1, 1), (5, 5, 2)], [(2, 2, 2), (5, 5, 1)]]
    told = Told([[(0, 0, 2), *world[0]], *world[1:]], [True] * 3)
    for i in range(3):
        told.push(i, 0, 2)
        told.tell(i, "advance", 6)
    assert told.given == [(5, 5, (1, 0, 1)), (5, 5, (0, 1, 0))]


def test_what_is_kept_is_a_copy():
    """No batch stays in memory because one of its samples is the latest."""
    join = KeyedJoin([True, False])
    values = np.arange(1000)
    batch = SampleBatch(values, values, {"n": Column(FieldType.INTEGER, values)})
    join.push(0, batch, Column(FieldType.INTEGER, values % 3))
    join.push(1, batch)
    for i in range(2):
        join.end(i)
    for latest in join._latest:
        kept = latest._rows
        assert kept is not None
        for array in (kept.available, kept.valid, kept.columns["n"].values):
            assert array.base is None
            assert len(array) < 20
    assert join.retained == 4


def test_tuples_stay_as_they_were_given():
    join = KeyedJoin([True, False])
    one = np.ones(1, np.int64)

    def batch(time, value):
        return SampleBatch(one * time, one * time, {"n": Column(FieldType.INTEGER, one * value)})

    def push(time, constant, keyed):
        join.push(1, batch(time, constant))
        join.push(0, batch(time, keyed), Column(FieldType.INTEGER, one))
        join.advance(1, time + 1)
        return join.advance(0, time + 1)

    push(1, 10, 1)
    first = push(2, 20, 2)
    push(3, 30, 3)
    assert first.column(0, "n").tolist() == [2]
    assert first.column(1, "n").tolist() == [20]


def test_it_refuses_what_it_cannot_take():
    join = KeyedJoin([True, False])
    one = np.ones(1, np.int64)
    batch = SampleBatch(one, one, {"n": Column(FieldType.INTEGER, one)})
    key = Column(FieldType.INTEGER, one)
    with pytest.raises(ValueError, match="is keyed"):
        join.push(0, batch)
    with pytest.raises(ValueError, match="is constant"):
        join.push(1, batch, key)
    with pytest.raises(ValueError, match=KEY):
        join.push(0, SampleBatch(one, one, {KEY: key}), key)
    with pytest.raises(ValueError, match="at least one input"):
        KeyedJoin([])


@LIMITS
@given(st.data())
def test_numbers_are_equal_where_keys_are(data):
    """However many come at once, and whether they lie close together or not."""
    numbering, seen = Numbering(), {}
    random = np.random.default_rng(data.draw(st.integers(0, 99)))
    for _ in range(data.draw(st.integers(1, 6))):
        low, high = data.draw(st.sampled_from([(0, 9), (0, 2000), (0, 10**6), (-9, 9), (5, 2**62)]))
        keys = random.integers(low, high, data.draw(st.sampled_from([0, 1, 5, 40, 300])))
        for key, number in zip(keys.tolist(), numbering.of(keys).tolist(), strict=True):
            assert seen.setdefault(key, len(seen)) == number
    assert len(numbering) == len(seen)


def test_a_negative_key_is_no_place_from_the_end():
    numbering = Numbering()
    assert numbering.of(np.arange(50)).tolist() == [*range(50)]
    assert numbering.of(np.arange(-50, 50)).tolist() == [*range(50, 100), *range(50)]
    assert numbering.of(np.arange(-50, 100)).tolist() == [
        *range(50, 100),
        *range(50),
        *range(100, 150),
    ]


def test_pairs_have_keys_of_their_own():
    ends = np.array([0, 1, 2**31 - 1], np.int64)
    keys = paired(np.repeat(ends, 3), np.tile(ends, 3))
    assert len(set(keys.tolist())) == 9
    assert keys.min() == 0
