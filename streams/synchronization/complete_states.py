"""States at the inputs' valid times, in order of completion (SPEC §1).

Where inputs may be in any order and ``max delay oo`` waits for ever, an incomplete state holds back
no complete one. When a state leaves depends on its own samples alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..input_queues import NOTHING_KNOWN
from ..joins.join import distinct
from ..policies.policy import Constraint, SynchronizationPolicy
from ..sample import Mask, SampleBatch, Times
from ..time import TIME_MAX
from ..time_arithmetic import leaving
from ..tuples import Rows
from .states import (
    CHUNK,
    NONE,
    InputSamples,
    LateRows,
    Made,
    News,
    States,
    completion,
    of_use_in_any_order,
    within,
)


class CompleteStates(States):
    """A state at every distinct valid time, once it is complete; see `Synchronization`.

    The state for t is complete at c_t. States leave in order of (c_t, t), each after the one
    before. A sample whose state has left is late.

    Memory: 16 bytes a state that waits, 8 bytes a state that has left: a sample may come for any
    time.
    """

    def __init__(self, policy: SynchronizationPolicy) -> None:
        super().__init__(policy)
        self._waiting: Times = NONE
        """The times of incomplete states, which increase."""
        self._ready: tuple[Times, Times] = (NONE, NONE)
        """c_t and t of complete states that have not left, in the order in which they will."""
        self._gone = _Times()

    @property
    def pending(self) -> int:
        return len(self._waiting) + len(self._ready[0])

    def run(self, inputs: Sequence[InputSamples], until: int) -> tuple[list[Made], list[LateRows]]:
        news = News(inputs)
        self._begin(inputs, news)
        made = self._leave(inputs, until)
        for _, times, _, _ in made:
            self._gone.add(times)
        return made, news.of_inputs(self._late(news, made), Constraint.AVAILABLE)

    def finish(self, inputs: Sequence[InputSamples]) -> tuple[list[Made], int]:
        made = self._leave(inputs, TIME_MAX)
        never = self.pending
        self._waiting, self._ready = NONE, (NONE, NONE)
        return made, never

    def of_use(self, one: InputSamples) -> SampleBatch:
        # A state may begin for any time, so no sample is too old to be of use.
        table = of_use_in_any_order(one, NOTHING_KNOWN, self._duration.last)
        # Without approximation a sample serves the state of its own time only, and goes with it.
        if self._exact:
            times = np.sort(np.concatenate([self._waiting, self._ready[1]]))
            return table.take(_is_in(table.valid, times))
        return table

    def _begin(self, inputs: Sequence[InputSamples], news: News) -> None:
        """Add the states that new samples begin; those that are complete now are ready."""
        begun = distinct(news.valid[within(self._duration, news.valid)])
        # A sample whose state has left is late; it begins no second one.
        known = self._gone.contain(begun) | _is_in(begun, np.sort(self._ready[1]))
        times = distinct(np.concatenate([self._waiting, begun[~known]]))
        moment, complete = completion(times, inputs)
        self._waiting = times[~complete]
        moment, times = moment[complete], times[complete]
        order = np.lexsort((times, moment))
        # A sample or an end of this run completes these, so they come after those that are ready.
        due, ready = self._ready
        self._ready = (
            np.concatenate([due, moment[order]]),
            np.concatenate([ready, times[order]]),
        )

    def _leave(self, inputs: Sequence[InputSamples], until: int) -> list[Made]:
        """The ready states that leave by ``until``."""
        due, times = self._ready
        leaves = leaving(due, self._left)
        going = int(leaves.searchsorted(until, "right"))
        made: list[Made] = []
        for start in range(0, going, CHUNK):
            rows = slice(start, min(start + CHUNK, going))
            at, valid = leaves[rows], times[rows]
            chosen = tuple(self._rows(one, valid, at) for one in inputs)
            made.append((at, valid, chosen, np.ones(len(at), np.bool_)))
        if going:
            self._left = int(leaves[going - 1])
            # These are copies, since views would keep the times of all earlier states in memory.
            self._ready = due[going:].copy(), times[going:].copy()
        return made

    def _rows(self, one: InputSamples, times: Times, leaves: Times) -> Rows:
        """The most recent row at each of ``times`` by ``leaves``, -1 for none."""
        if one.is_monotone:
            return one.most_recent(times, leaves, self._exact)
        order, valid, available = one.by_valid
        place = np.searchsorted(valid, times, "right") - 1
        # The few that came after the state had left are passed over one by one.
        while True:
            early = np.flatnonzero(place >= 0)
            early = early[available[place[early]] > leaves[early]]
            if not len(early):
                break
            place[early] -= 1
        found = place >= 0
        if self._exact:
            found[found] = valid[place[found]] == times[found]
        rows = np.full(len(times), -1, np.int64)
        rows[found] = order[place[found]]
        return rows

    def _late(self, news: News, made: Sequence[Made]) -> Rows:
        """The new samples that came after their own state had left."""
        after = self._gone.contain(news.valid)
        # States of this run are in `_gone` already, but the sample may have come before they left.
        for leaves, times, _, _ in made:
            order = np.argsort(times)
            place = order[np.minimum(np.searchsorted(times[order], news.valid), len(times) - 1)]
            here = times[place] == news.valid
            after[here] = news.available[here] > leaves[place[here]]
        return np.flatnonzero(after)


class _Times:
    """A growing set of times. Memory: 8 bytes a time; added at an amortized O(log n) each."""

    def __init__(self) -> None:
        self._parts: list[Times] = []
        """Each increases, and is longer than those after it together."""

    def add(self, times: Times) -> None:
        """Add times that are not in it."""
        new = np.sort(times)
        # Sizes at least double from part to part, so the parts are O(log n).
        while self._parts and len(self._parts[-1]) <= 2 * len(new):
            new = np.sort(np.concatenate([self._parts.pop(), new]))
        self._parts.append(new)

    def contain(self, times: Times) -> Mask:
        """Which of ``times`` are in it."""
        found = np.zeros(len(times), np.bool_)
        for part in self._parts:
            found |= _is_in(times, part)
        return found


def _is_in(times: Times, known: Times) -> Mask:
    """Which of ``times`` are among ``known``, which do not decrease."""
    if not len(known):
        return np.zeros(len(times), np.bool_)
    place = np.minimum(np.searchsorted(known, times), len(known) - 1)
    found: Mask = known[place] == times
    return found
