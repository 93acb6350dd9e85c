"""The sample that stands for a term at a state of a part is the newest by valid time, then by
arrival, of those that are valid then and have come when the state leaves."""

from __future__ import annotations

import pickle
from random import Random

import numpy as np
import pytest

from dyknow.reasoning.states import part_samples
from dyknow.reasoning.states.part_samples import PartSamples
from dyknow.streams.time import TIME_MIN

TERMS = (("urn:p", ("urn:S",)), ("urn:q", ("urn:S",)))
PARTS = 3


class Play:
    """Samples in any order of valid time, states, and what the definition says of them."""

    def __init__(self, seed: int) -> None:
        self.draw = Random(seed)
        self.samples = PartSamples(TERMS)
        self.samples.make_room_for(PARTS)
        self.come: list[list[tuple[int, int, int, float]]] = [[] for _ in TERMS]
        """Of each term the samples in order of arrival: available, valid, part, value."""
        self.now, self.reached = 0, [-1] * PARTS
        self.times: set[tuple[int, int]] = set()

    def add(self) -> None:
        draw = self.draw
        for number, term in enumerate(TERMS):
            count = draw.choice([0, 1, 1, 5, 40])
            available = np.sort([self.now + draw.randrange(3) for _ in range(count)])
            valid = available - np.array([draw.choice([0, 0, 1, 9, 30]) for _ in range(count)])
            part = np.array([draw.randrange(PARTS) for _ in range(count)])
            values = np.array([draw.random() for _ in range(count)])
            if count:
                columns = available.astype(np.int64), valid.astype(np.int64), part, values
                self.samples.add(term, 0, *columns)
                self.come[number] += zip(*(each.tolist() for each in columns), strict=True)
        self.now += 3
        entered = self.samples.enter(self.now)
        if entered is not None:
            _, valid, part = entered
            self.samples.add_times(part, valid)
            self.times |= set(zip(part.tolist(), valid.tolist(), strict=True))

    def leave(self) -> int:
        """Let states leave; return how many."""
        limits = np.array([self.draw.randrange(self.now + 2) for _ in range(PARTS)])
        due, part = self.samples.due(limits)
        told = list(zip(part.tolist(), due.tolist(), strict=True))
        wanted = sorted(each for each in self.times if each[1] < limits[each[0]])
        assert told == wanted
        self.times -= set(wanted)
        # A state of a time before the last one does not leave: its samples may be gone.
        rows = [i for i, (own, time) in enumerate(told) if time > self.reached[own]]
        due, part = due[rows], part[rows]
        if not len(due):
            return 0
        left = np.full(len(due), self.now)
        places, valid = self.samples.at(due, left, part)
        for number, term in enumerate(TERMS):
            values = self.samples.values(term, places)
            for i, (own, time) in enumerate(zip(part.tolist(), due.tolist(), strict=True)):
                self.reached[own] = time
                found = self.newest(number, own, time)
                if found is None:
                    assert valid[number, i] == TIME_MIN
                else:
                    assert (valid[number, i], values[i]) == (found[1], found[3])
        return len(due)

    def newest(self, number: int, part: int, time: int) -> tuple[int, int, int, float] | None:
        there = [each for each in self.come[number] if each[2] == part and each[1] <= time]
        return max(there, key=lambda each: (each[1], each[0], there.index(each)), default=None)


@pytest.mark.parametrize("roomy", [4, part_samples.ROOMY])
def test_the_newest_sample_counts(roomy: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part_samples, "ROOMY", roomy)
    states = 0
    for seed in range(150):
        play = Play(seed)
        for _ in range(play.draw.choice([3, 12])):
            play.add()
            if play.draw.random() < 0.7:
                states += play.leave()
            if play.draw.random() < 0.1:
                play.samples = pickle.loads(pickle.dumps(play.samples))  # as a checkpoint does
            if play.draw.random() < 0.05:
                part = play.draw.randrange(PARTS)
                play.samples.drop(part)
                play.come = [[each for each in of if each[2] != part] for of in play.come]
                play.times = {each for each in play.times if each[0] != part}
    assert states > 2_000


def test_places_are_given_back() -> None:
    samples = PartSamples(TERMS)
    samples.make_room_for(1)
    count = 10_000
    times, part = np.arange(count), np.zeros(count, np.int64)
    for term in TERMS:
        samples.add(term, 0, times, times, part, np.ones(count))
    samples.enter(count)
    samples.at(times, times, part)
    assert len(samples) == 2
    samples.enter(count)
    assert len(pickle.dumps(samples)) < 40 * 4 * part_samples.ROOMY
