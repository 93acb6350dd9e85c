"""Mediation (Def. 4.7) against its definition, however inputs are cut and mixed."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from mediation_definition import held, merged

from dyknow.streams.joins.mediation import Mediation
from dyknow.streams.sample import Column, FieldType, SampleBatch, SampleError
from dyknow.streams.stream_rules import UNIQUE_TIMES, Rules
from dyknow.streams.string_pool import StringPool

LIMITS = settings(deadline=None, max_examples=200)
LABELS = ("a", "b", "c")
TIMES = st.integers(0, 14)


def definition(members, streams):
    """Each sample of an object that is in the set last available then, in order.

    ``members``: [(time, set)], ``streams``: {label: [(time, value)]}."""
    return merged(
        (time, label, value)
        for label, samples in streams.items()
        for time, value in samples
        if label in held(members, time)
    )


@st.composite
def worlds(draw):
    times = sorted(draw(st.lists(TIMES, max_size=5)))
    members = [(t, draw(st.sets(st.sampled_from(LABELS)))) for t in times]
    streams = {
        label: [
            (t, draw(st.sampled_from("xyz"))) for t in sorted(draw(st.lists(TIMES, max_size=6)))
        ]
        for label in LABELS
    }
    return members, streams


@st.composite
def feedings(draw, members, streams):
    """One way to tell a world, the inputs mixed anyhow: [(input, samples, watermark or None)].

    Everything is told in the end, by watermarks or by ends.
    """
    queues = {}
    for name, samples in {"members": members, **streams}.items():
        rest, told = list(samples), []
        while rest:
            cut = draw(st.integers(1, len(rest)))
            if draw(st.booleans()):
                told.append(draw(st.integers(-1, rest[0][0])))
            told.append(rest[:cut])
            rest = rest[cut:]
        queues[name] = [*told, draw(st.sampled_from([None, 100]))]
    steps = []
    while queues:
        name = draw(st.sampled_from(sorted(queues)))
        steps.append((name, queues[name].pop(0)))
        if not queues[name]:
            del queues[name]
    return steps


def batch_of(samples, pool):
    times = np.array([t for t, _ in samples], np.int64)
    codes = pool.encode([value for _, value in samples])
    return SampleBatch(times, times, {"v": Column(FieldType.STRING, codes, None, pool)})


class World:
    """Streams with their past, which are attached when their object enters, as the unit does it."""

    def __init__(self):
        self.mediation = Mediation("object")
        # Each stream has a pool of its own, with codes of its own.
        self.pools = {label: StringPool("zyx"[i:]) for i, label in enumerate(LABELS)}
        self.past = {label: [] for label in LABELS}
        self.attached = set()

    def tell(self, name, what):
        mediation = self.mediation
        if name == "members":
            if what is None:
                mediation.end_members()
            elif isinstance(what, int):
                mediation.advance_members(what)
            else:
                mediation.push_members([t for t, _ in what], [tuple(s) for _, s in what])
                for label in sorted(mediation.wanted - self.attached):
                    self.attached.add(label)
                    mediation.attach(label)
                    for step in self.past[label]:
                        self.pass_on(label, step)
        else:
            self.past[name].append(what)
            if name in self.attached:
                self.pass_on(name, what)

    def pass_on(self, label, what):
        if what is None:
            self.mediation.end(label)
        elif isinstance(what, int):
            self.mediation.advance(label, what)
        else:
            self.mediation.push(label, batch_of(what, self.pools[label]))

    def take(self):
        made = self.mediation.take()
        self.attached &= self.mediation.wanted
        if made is None:
            return []
        texts = [made.columns[name].tolist() for name in ("object", "v")]
        return list(zip(made.available.tolist(), made.valid.tolist(), *texts, strict=True))


def run(steps):
    """Everything that is given, and after each step up to when all is decided, and how much."""
    world = World()
    given, stages = [], []
    for name, what in steps:
        world.tell(name, what)
        given += world.take()
        stages.append((world.mediation.done, len(given)))
    return given, stages


@st.composite
def fed_worlds(draw):
    """(members, streams, feeding)"""
    members, streams = draw(worlds())
    return members, streams, draw(feedings(members, streams))


SETS = [(0, {"a", "b"}), (0, set()), (0, {"a", "b"}), (1, set()), (1, set())]
"""An object that leaves and enters again within an instant."""
BEFORE = [(1, {"b"}), (1, set()), (1, {"b"})]
"""An object whose samples are available before it enters."""


def told(sets, size):
    """A world whose sets come after the samples, ``size`` at once."""
    samples = [(0, "x")] * 3
    steps = [("members", sets[i : i + size]) for i in range(0, len(sets), size)]
    ends = [(name, None) for name in (*LABELS, "members")]
    return sets, {"a": [], "b": samples, "c": []}, [("b", samples), *steps, *ends]


@LIMITS
@given(fed_worlds())
@example(told(SETS, 1))
@example(told(BEFORE, 3))
def test_it_gives_the_definition(world):
    members, streams, steps = world
    given, _ = run(steps)
    assert given == definition(members, streams)


@LIMITS
@given(fed_worlds())
@example(told(SETS, 1))
@example(told(BEFORE, 3))
def test_what_is_given_by_a_moment_is_all_there_is_by_then(world):
    _, _, steps = world
    given, stages = run(sorted(steps, key=lambda step: step[0] != "members"))
    for done, count in stages:
        assert all(time <= done for _, time, _, _ in given[:count])
        assert all(time > done for _, time, _, _ in given[count:])


def test_members_that_come_later_take_from_then_on():
    mediation = Mediation()
    mediation.attach("a")
    pool = StringPool()
    mediation.push_members([1], [("a",)])
    mediation.push("a", batch_of([(1, "x"), (2, "y"), (5, "z")], pool))
    first = mediation.take()
    assert first is None  # another set may come at 1
    mediation.advance_members(2)
    first = mediation.take()
    assert first is not None
    assert first.available.tolist() == [1]  # up to 1 the set is known
    mediation.push_members([4], [()])
    mediation.advance_members(5)
    second = mediation.take()
    assert second is not None
    assert second.available.tolist() == [2]  # 5 is not in the set any more
    mediation.advance_members(10)
    assert mediation.take() is None
    assert mediation.done == 9


def test_an_object_that_left_is_waited_for_up_to_then():
    mediation = Mediation("object")
    pool = StringPool()
    mediation.push_members([1], [("a", "b")])
    mediation.attach("a")
    mediation.attach("b")
    mediation.push("a", batch_of([(1, "x"), (7, "y")], pool))
    mediation.push_members([5], [("a",)])
    mediation.advance_members(20)
    assert mediation.take() is None  # b may have said something before 5
    mediation.advance("b", 5)
    mediation.advance("a", 8)
    made = mediation.take()
    assert made is not None
    assert made.available.tolist() == [1, 7]


def test_what_is_said_anew_is_not_said_twice():
    mediation = Mediation()
    pool = StringPool()
    mediation.push_members([1], [("a",)])
    mediation.attach("a")
    mediation.push("a", batch_of([(2, "x"), (9, "y")], pool))
    mediation.forget("a")
    mediation.attach("a")
    mediation.push("a", batch_of([(2, "x"), (8, "z")], pool))
    mediation.advance("a", 9)
    mediation.advance_members(20)
    made = mediation.take()
    assert made is not None
    assert made.available.tolist() == [2, 8]


@pytest.mark.parametrize("end", [-(2**63), 2**63 - 2])
def test_unique_times_at_the_ends_of_64_bits(end):
    mediation = Mediation(rules=Rules(UNIQUE_TIMES))
    pool = StringPool()
    mediation.push_members([end], [("a", "b")])
    for label in ("a", "b"):
        mediation.attach(label)
        mediation.push(label, batch_of([(end, label)], pool))
        mediation.end(label)
    mediation.end_members()
    made = mediation.take()
    assert made is not None
    assert made.available.tolist() == [end, end + 1]
    mediation.resume("a")
    mediation.push("a", batch_of([(2**63 - 1, "c")], pool))
    mediation.end("a")
    if end > 0:
        with pytest.raises(SampleError, match="end of 64-bit time"):
            mediation.take()
