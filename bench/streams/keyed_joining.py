"""join object by object: what it does a second, against numpy by hand, and for how long.

Run by ``python bench/streams/keyed_joining.py``. One process, one core, best of several runs. One
float a sample, whose whole part is the object; two inputs, with or without a third about one object
for all, come in turns, a batch each. Both give the tuples' times and the value of each input
(compared first); numpy by hand gets the batches of all inputs at once, has a table of as many
objects as there are, and knows that each sample has a key, that no two come at one time and nothing
too late.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from measure import Arrays, Program, Round, Row, Samples, batch_of, part, print_table

from dyknow.streams.joins.keyed_join import KeyedJoin
from dyknow.streams.sample import Column, FieldType
from dyknow.streams.tuples import TupleBatch

OBJECTS = (1, 100, 10_000)


def inputs(keyed: tuple[bool, ...], objects: int) -> Callable[[int], Round]:
    """Each object once, so that there is a sample of each to look up, and then at random."""

    def make(count: int) -> Round:
        random = np.random.default_rng(7)
        made: list[Samples] = []
        for i, each in enumerate(keyed):
            available = np.arange(count) * 10 + i
            own = random.integers(0, objects, count)
            own[:objects] = np.arange(objects)[:count]
            value = random.uniform(0, 0.9, count) + (own if each else 0)
            made.append((available, available - random.integers(0, 40, count), value))
        return tuple(made)

    return make


def by_hand(keyed: tuple[bool, ...], objects: int) -> Program:
    """By object and time; each input's place is carried on within an object, or the table's."""

    def run(rounds: Iterable[Round]) -> Iterator[Arrays]:
        count = len(keyed)
        latest = np.full((count, objects if any(keyed) else 1), np.nan)
        valids = np.zeros(latest.shape, np.int64)
        held: list[Samples] = []
        for samples in rounds:
            whole = [
                tuple(map(np.concatenate, zip(old, new, strict=True))) if held else new
                for old, new in zip(held or samples, samples, strict=True)
            ]
            known = min(int(one[0][-1]) for one in whole)
            cuts = [int(np.searchsorted(one[0], known, "right")) for one in whole]
            news = [part(one, 0, cut) for one, cut in zip(whole, cuts, strict=True)]
            held = [part(one, cut, None) for one, cut in zip(whole, cuts, strict=True)]
            own = [i for i in range(count) if keyed[i]]
            times, valid, value = (np.concatenate([news[i][k] for i in own]) for k in range(3))
            origin = np.repeat(own, [cuts[i] for i in own])
            key = value.astype(np.int64)
            order = np.lexsort((times, key))
            key, sorted_origin = key[order], origin[order]
            places = np.arange(len(key))
            begins = np.concatenate((np.ones(1, bool), key[1:] != key[:-1]))
            begin = np.maximum.accumulate(np.where(begins, places, 0))
            # Back in the order of time: where each stands among those by object.
            moment = np.argsort(times[order], kind="stable")
            at, objects_at = times[order][moment], key[moment]
            greatest, values = np.full(len(at), -(10**9)), []
            for i in range(count):
                if keyed[i]:
                    place = np.maximum.accumulate(np.where(sorted_origin == i, places, -1))
                    row = np.where(place >= begin, order[np.maximum(place, 0)], -1)[moment]
                    new, new_valid = value[row], valid[row]
                    there = objects_at
                else:
                    row = np.searchsorted(news[i][0], at, "right") - 1
                    if not cuts[i]:
                        values.append(np.full(len(at), latest[i, 0]))
                        greatest = np.maximum(greatest, valids[i, 0])
                        continue
                    new, new_valid = news[i][2][row], news[i][1][row]
                    there = np.zeros(len(at), np.int64)
                values.append(np.where(row < 0, latest[i, there], new))
                greatest = np.maximum(greatest, np.where(row < 0, valids[i, there], new_valid))
            for i in range(count):
                there = news[i][2].astype(np.int64) if keyed[i] else np.zeros(cuts[i], np.int64)
                latest[i, there], valids[i, there] = news[i][2], news[i][1]
            whole_tuples = ~np.isnan(np.add.reduce(values))
            yield at[whole_tuples], greatest[whole_tuples], *(one[whole_tuples] for one in values)

    return run


def joined(keyed: tuple[bool, ...]) -> Program:
    def run(rounds: Iterable[Round]) -> Iterator[Arrays]:
        join = KeyedJoin(keyed)
        for samples in rounds:
            for i, one in enumerate(samples):
                keys = Column(FieldType.INTEGER, one[2].astype(np.int64)) if keyed[i] else None
                made = join.push(i, batch_of(one), keys)
                if made is not None:
                    yield arrays(made)

    return run


def arrays(made: TupleBatch) -> Arrays:
    values = [made.column(i, "value").values for i in range(len(made.inputs))]
    return made.available, made.valid, *values


ROWS = tuple(
    Row(
        f"{sum(keyed)} keyed{', 1 constant' * (not all(keyed))}; {objects:,} objects",
        joined(keyed),
        by_hand(keyed, objects),
        inputs(keyed, objects),
        scale=4 if objects > 1_000 else 1,  # so that most samples come after the first of each,
    )
    for keyed in ((True, True), (True, True, False))
    for objects in OBJECTS
)


if __name__ == "__main__":
    sys.exit(0 if print_table("object by object, samples in", ROWS, times=3) else 1)
