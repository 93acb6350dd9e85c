"""join object by object: tuples of the latest samples of several streams about the same object.

[DyKnow10 Def. 5.11] for the samples of each object by themselves. engine/units/synchronization.py
feeds with it a transformation whose inputs stand in several streams ([Introspection15 §4.3]).
tests/definitions/streams/keyed_join_definition.py is its slow twin.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from ..input_queues import NOTHING_KNOWN
from ..key_numbering import Numbering, Numbers
from ..latest_by_key import Latest
from ..sample import Column, SampleBatch, Times, concatenate
from ..stream_rules import Rules
from ..time_arithmetic import leaving
from ..tuples import Rows, TupleBatch
from .join import Joining

KEY: Final = "#key"
"""The column in which a key waits with its sample: no field that is declared is called so."""


class KeyedJoin(Joining):
    """A tuple for an object at each of its samples, once every input has one for it.

    An input is *keyed* (a key says which object a sample is of) or *constant* (about one object
    for all). For each object o, at each available time t at which a keyed input has a sample of
    o, the tuple takes of each keyed input last_avail of the samples of o, of each constant one
    last_avail; there is none while an input lacks one. A constant input's sample alone makes no
    tuple. Where no input is keyed all are of one object, which is Def. 5.11 once all inputs are
    there. A keyed sample whose key is no_value is left out, and counted in ``keyless``.

    Tuples leave in order of t, those of one t in the order of the inputs that they came by. A
    tuple is available at t (by `UNIQUE_TIMES` at the least free time from t on); it is valid at the
    greatest of its samples' valid times.

    Law: for any batches, watermarks and interleaving the tuples given are those of the
    definition with t ≤ `known`. An input that has not begun (no sample, watermark or end) holds
    back the others. After an end a push continues the input, if it comes after what was given.

    Cost: O(n log n) numpy a push, and a dict look-up a keyed sample, n the samples decided by it;
    O(n) where they are of one input; the number of objects does not matter. Memory: the latest
    sample of each object and input, a dict entry an object, and what other inputs are behind;
    nothing else of the history. An object is never forgotten.
    """

    def __init__(self, keyed: Sequence[bool], rules: Rules | None = None) -> None:
        super().__init__(len(keyed))
        self._rules = Rules() if rules is None else rules
        self.keyless = 0
        """Samples without a key that were left out, of those available by `known`."""
        self._is_keyed = tuple(keyed)
        # An input that brings tuples about. Where none is keyed each does, for object 0.
        self._brings = self._is_keyed if any(keyed) else (True,) * len(keyed)
        self._latest = [Latest() for _ in keyed]
        self._objects = Numbering()
        self._left = NOTHING_KNOWN

    @property
    def reached(self) -> int:
        """All later tuples are available after it; a move may have put it beyond what is known."""
        return max(self._done, self._left)

    @property
    def retained(self) -> int:
        """Number of kept samples: those that wait, and the latest of each object and input."""
        return sum(map(len, self._latest)) + sum(input.waiting for input in self._inputs)

    def push(self, input: int, batch: SampleBatch, keys: Column | None = None) -> TupleBatch | None:
        """Samples of ``input`` in order; the tuples they decide, None for none.

        ``keys`` are the integer keys of a keyed input, None of a constant one. Raises `ValueError`
        where available times decrease; then nothing is taken.
        """
        if (keys is not None) is not self._is_keyed[input]:
            raise ValueError(f"input {input} is {'keyed' if keys is None else 'constant'}")
        if keys is not None:
            if KEY in batch.columns or len(keys) != len(batch):
                raise ValueError(f"each sample has a key, and no field is called {KEY!r}")
            batch = SampleBatch(batch.available, batch.valid, {**batch.columns, KEY: keys})
        self._inputs[input].push(batch, self._done)
        return self._proceed()

    def _proceed(self) -> TupleBatch | None:
        parts = self._reach()
        if parts is None:
            return None
        news = {i: self._news(i, concatenate(own)) for i, own in enumerate(parts) if own}
        news = {i: new for i, new in news.items() if len(new.batch)}
        # `has` needs room for objects numbered just now, and for object 0 of a constant input.
        for latest in self._latest:
            latest.reserve(max(1, len(self._objects)))
        # Tuples read the latest samples of before, so the new ones are put afterwards.
        made = self._tuples(news)
        for i, new in news.items():
            self._latest[i].put(new.objects, new.batch)
        return made

    def _news(self, input: int, batch: SampleBatch) -> _News:
        """Samples with the numbers of their objects; without those that have no key."""
        if not self._is_keyed[input]:
            return _News(batch, np.zeros(len(batch), np.int64))
        keys = batch.columns[KEY]
        if keys.null is not None and bool(keys.null.any()):
            self.keyless += int(np.count_nonzero(keys.null))
            batch = batch.take(~keys.null)
        columns = {name: column for name, column in batch.columns.items() if name != KEY}
        numbers = self._objects.of(batch.columns[KEY].values)
        return _News(SampleBatch(batch.available, batch.valid, columns), numbers)

    def _tuples(self, news: Mapping[int, _News]) -> TupleBatch | None:
        moments = self._moments({i: new for i, new in news.items() if self._brings[i]})
        if moments is None:
            return None
        for i, new in news.items():
            # A constant input brings no tuple about: each moment takes its last sample by then.
            if not self._brings[i]:
                moments.rows[i] = np.searchsorted(new.batch.available, moments.times, "right") - 1
        moments = self._complete(moments)
        available = leaving(moments.times, self._left, self._rules.gap)
        if not len(available):
            return None
        # `leaving` stops at the end of 64-bit time: the other tuples have no available time.
        if len(available) < len(moments.times):
            moments = moments.take(np.arange(len(available)))
        self._left = int(available[-1])
        batches, rows = [], []
        for i, latest in enumerate(self._latest):
            batch, row = _samples(moments, i, self._numbers(i, moments), latest, news.get(i))
            batches.append(batch)
            rows.append(row)
        valid = batches[0].valid[rows[0]]
        for batch, row in zip(batches[1:], rows[1:], strict=True):
            valid = np.maximum(valid, batch.valid[row])
        return TupleBatch(available, valid, tuple(batches), tuple(rows))

    def _numbers(self, input: int, moments: _Moments) -> Numbers:
        """Where `Latest` keeps the samples of input ``input`` for the objects of the moments."""
        return moments.objects if self._is_keyed[input] else np.zeros_like(moments.objects)

    def _complete(self, moments: _Moments) -> _Moments:
        """The moments at which each input has a sample."""
        checks = []
        for i, latest in enumerate(self._latest):
            row = moments.rows.get(i)
            if row is None:
                checks.append(latest.has(self._numbers(i, moments)))
            elif not bool((there := row >= 0).all()):
                checks.append(there | latest.has(self._numbers(i, moments)))
        if not checks:
            return moments
        complete = checks[0] if len(checks) == 1 else np.logical_and.reduce(checks)
        return moments if bool(complete.all()) else moments.take(np.flatnonzero(complete))

    def _moments(self, news: Mapping[int, _News]) -> _Moments | None:
        if not news:
            return None
        if len(news) == 1:
            ((input, new),) = news.items()
            times = new.batch.available
            # Without two samples of one instant each is a moment by itself.
            if bool((times[1:] > times[:-1]).all()):
                return _Moments(times, new.objects, {input: np.arange(len(times))})
        times = np.concatenate([new.batch.available for new in news.values()])
        objects = np.concatenate([new.objects for new in news.values()])
        counts = [len(new.batch) for new in news.values()]
        origin = np.repeat(np.arange(len(counts)), counts)
        row = np.concatenate([np.arange(count) for count in counts])

        # By (time, input): runs in order, which numpy's stable sort merges fast. Then by object,
        # where it counts 16-bit numbers instead of comparing.
        by_time = np.argsort(times, kind="stable")
        short = np.uint16 if len(self._objects) <= 2**16 else np.int64
        by_object = np.argsort(objects[by_time].astype(short), kind="stable")
        order = by_time[by_object]
        times, objects, origin, row = times[order], objects[order], origin[order], row[order]

        is_other = objects[1:] != objects[:-1]
        is_later = is_other | (times[1:] != times[:-1])
        edge = np.ones(1, np.bool_)
        first = np.flatnonzero(np.concatenate((edge, is_later)))
        last = np.flatnonzero(np.concatenate((is_later, edge)))
        places = np.arange(len(times))
        of_object = np.maximum.accumulate(np.where(np.concatenate((edge, is_other)), places, 0))
        rows = {}
        for k, input in enumerate(news):
            # The last sample of an instant counts, so the last place of each moment is read.
            place = np.maximum.accumulate(np.where(origin == k, places, -1))[last]
            # An earlier place belongs to another object: then the latest sample of before counts.
            rows[input] = np.where(place >= of_object[last], row[place], -1)
        # Back into the order of (time, input): by the place of the first of equal time there.
        moment = np.full(len(times), -1)
        moment[by_object[first]] = np.arange(len(first))
        return _Moments(times[last], objects[last], rows).take(moment[moment >= 0])


@dataclass(frozen=True, slots=True, eq=False)
class _News:
    """Samples of one input that are decided now, with the numbers of their objects, ``(n,)``."""

    batch: SampleBatch
    objects: Numbers


@dataclass(frozen=True, slots=True, eq=False)
class _Moments:
    """When which object has a sample: times and numbers of objects, shape ``(n,)``. ``rows`` says
    for inputs with news which of them stands then, -1 for none."""

    times: Times
    objects: Numbers
    rows: dict[int, Rows]

    def take(self, chosen: Rows) -> _Moments:
        rows = {input: row[chosen] for input, row in self.rows.items()}
        return _Moments(self.times[chosen], self.objects[chosen], rows)


def _samples(
    moments: _Moments, input: int, numbers: Numbers, latest: Latest, new: _News | None
) -> tuple[SampleBatch, Rows]:
    """A batch with the sample of ``input`` at each of the moments, and which row of it that is."""
    row = moments.rows.get(input)
    if row is None or new is None:
        return latest.take(numbers), np.arange(len(numbers))
    is_old = row < 0
    if not bool(is_old.any()):
        return new.batch, row
    kept = latest.take(numbers[is_old])
    return concatenate([kept, new.batch]), np.where(is_old, np.cumsum(is_old) - 1, row + len(kept))
