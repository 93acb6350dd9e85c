"""join: tuples of the latest samples of several streams ([DyKnow10 Def. 5.11]).

join(f1 … fn) = {⟨t, t, [s1 … sn]⟩ | t ∈ availtimes({f1 … fn}), s_i = last_avail(f_i, t)}: one tuple
an instant, with the last sample of each input. It feeds computational units (Def. 5.34).
tests/definitions/streams/joint_definition.py is its slow twin.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from ..input_queues import NOTHING_KNOWN, Input, known_of
from ..sample import SampleBatch, Times, concatenate
from ..time import TIME_MAX
from ..tuples import Rows, TupleBatch


class Joining(ABC):
    """A join over inputs: what is known of all of them decides which tuples there are."""

    def __init__(self, count: int) -> None:
        if count < 1:
            raise ValueError("a join has at least one input (Def. 5.11)")
        self._inputs = [Input() for _ in range(count)]
        self._done = NOTHING_KNOWN

    @property
    def known(self) -> int | None:
        """Every tuple with t ≤ known has been given; None before all inputs have begun."""
        return known_of(self._inputs)

    def advance(self, input: int, watermark: int) -> TupleBatch | None:
        """Promise that later samples of ``input`` are available at ``watermark`` or later."""
        self._inputs[input].advance(watermark)
        return self._proceed()

    def decided(self, input: int) -> int:
        """A sample of ``input`` that is available by then comes too late: tuples were given
        without it, or it was promised not to come."""
        return max(self._inputs[input].known, self._done)

    def resume(self, input: int) -> None:
        """Continue ``input`` after its end: tuples wait for it again."""
        self._inputs[input].resume()

    def end(self, input: int) -> TupleBatch | None:
        """End ``input``: its last sample stays the latest from here on."""
        self._inputs[input].end()
        return self._proceed()

    def _reach(self) -> list[list[SampleBatch]] | None:
        """What each input brings that is decided now; None where nothing is."""
        known = known_of(self._inputs)
        if known is None or known <= self._done:
            return None
        parts = [input.take(known) for input in self._inputs]
        # All ended: what was given reaches as far as the last of them, so that one may continue.
        self._done = min(known, max(input.known for input in self._inputs))
        return parts

    @abstractmethod
    def _proceed(self) -> TupleBatch | None:
        """The tuples that are decided by now and were not given; None for none."""


class Join(Joining):
    """Def. 5.11 online: a tuple at each available time of any input, as soon as all are known.

    Law: for any batches, watermarks and interleaving the tuples given up to `known` are
    those of the definition. An input that has not begun (no sample, watermark or end) holds back
    the others. After an end a push continues the input, if it comes after what was given.

    Cost: O(n log n) numpy a push, n the samples decided by it. Memory: the last sample of each
    input and what other inputs are behind; nothing of the history.
    """

    def __init__(self, arity: int) -> None:
        super().__init__(arity)
        self._last: list[SampleBatch | None] = [None] * arity

    @property
    def retained(self) -> int:
        """Number of kept samples: those that wait, and the last of each input."""
        lasts = sum(last is not None for last in self._last)
        return lasts + sum(input.waiting for input in self._inputs)

    def push(self, input: int, batch: SampleBatch) -> TupleBatch | None:
        """Samples of ``input`` in order; the tuples they decide, None for none.

        Raises `ValueError` where available times decrease; then nothing is taken.
        """
        self._inputs[input].push(batch, self._done)
        return self._proceed()

    def _proceed(self) -> TupleBatch | None:
        parts = self._reach()
        if parts is None:
            return None
        news = [concatenate(own) if own else None for own in parts]
        arrivals = [new.available for new in news if new is not None]
        if not arrivals:
            return None
        times = union(arrivals)
        batches, rows = [], []
        for i, new in enumerate(news):
            last = self._last[i]
            if new is None:
                # An input without a sample so far is no_sample; the tuple is given all the same.
                batches.append(self._inputs[i].empty() if last is None else last)
                rows.append(np.full(len(times), -1 if last is None else 0, np.int64))
                continue
            batch = new
            # Only tuples before the first new sample take the last one of before.
            if last is not None and new.available[0] != times[0]:
                batch = concatenate([last, new])
            batches.append(batch)
            rows.append(_last_rows(batch.available, times))
            # Indices, not a slice: a view would keep the whole batch in memory.
            self._last[i] = new.take(np.array([len(new) - 1]))
        return TupleBatch(times, times, tuple(batches), tuple(rows))


class OneByOne(Joining):
    """What feeds a computational unit of a single input: a tuple for each sample, when it comes.

    With one input no instants have to meet, so each sample has a time of its own: its instant and
    its sequence number (SPEC §1). Cost: O(1) a push. Memory: nothing of the history.
    """

    def __init__(self) -> None:
        super().__init__(1)

    def push(self, input: int, batch: SampleBatch) -> TupleBatch | None:
        """As of `Join`."""
        self._inputs[input].push(batch, self._done)
        return self._proceed()

    def _proceed(self) -> TupleBatch | None:
        parts = self._inputs[0].take(TIME_MAX)
        if not parts:
            return None
        new = concatenate(parts)
        return TupleBatch(new.available, new.available, (new,), (np.arange(len(new)),))


def union(increasing: Sequence[Times]) -> Times:
    """The union of times that do not decrease, increasing. Cost: O(n log k) for k arrays."""
    times = increasing[0] if len(increasing) == 1 else np.concatenate(increasing)
    if len(increasing) == 1 and bool((times[1:] > times[:-1]).all()):
        return times
    return distinct(times)


def distinct(runs: Times) -> Times:
    """The times of some runs that do not decrease, each once, increasing."""
    # Runs in order are what numpy's stable sort merges fast.
    every = np.sort(runs, kind="stable")
    new = np.empty(len(every), np.bool_)
    new[:1] = True
    np.not_equal(every[1:], every[:-1], out=new[1:])
    return every[new]


def _last_rows(available: Times, times: Times) -> Rows:
    """last_avail at each of ``times`` as a row, -1 for no_sample."""
    # `union` returns the times of a lone input as they are: a tuple for each of its rows.
    if available is times:
        return np.arange(len(times))
    return np.searchsorted(available, times, "right") - 1
