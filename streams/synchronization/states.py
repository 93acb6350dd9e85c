"""State synchronization (SPEC §1): when states leave, and of which samples they are made.

`States` holds what every kind has in common. `GridStates` and `ChangeStates` say for which times
there are states, which leave in order of their times. `CompleteStates` leave in the order in which
they become complete. `Synchronization` chooses one of the three.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from heapq import heappop, heappush
from typing import Any, Final

import numpy as np

from ..input_queues import NOTHING_KNOWN
from ..jit import JIT, Kernel
from ..most_recent import most_recent_rows
from ..policies.policy import Approximation, Constraint, Duration, SynchronizationPolicy
from ..sample import Mask, SampleBatch, Times
from ..time import TIME_MAX, TIME_MIN
from ..time_arithmetic import later, leaving
from ..tuples import Rows

NONE: Final[Times] = np.empty(0, np.int64)
CHUNK: Final = 65_536
"""The greatest number of states in one batch."""
COMPILED: Final = 512
"""The number of states from which on the compiled loop pays."""
Made = tuple[Times, Times, tuple[Rows, ...], Mask]
"""Available times, valid times, a row of each input's table, and whether every input was in."""
LateRows = tuple[int, Rows, Constraint]
"""An input, rows of its table, and what they are late for."""


class InputSamples:
    """The samples of one input: what earlier runs kept, and from row ``first_new`` on new ones,
    whose times are ``available`` and ``valid``.

    ``reached`` and ``newest`` are the greatest valid times without and with the new samples. States
    do not wait for the input from the moment ``ended`` on (None: it goes on).
    """

    __slots__ = (
        "_by_valid",
        "available",
        "ended",
        "first_new",
        "is_monotone",
        "newest",
        "reached",
        "table",
        "valid",
    )

    def __init__(
        self,
        table: SampleBatch,
        first_new: int,
        reached: int,
        newest: int,
        is_monotone: bool,
        ended: int | None,
    ) -> None:
        self.table, self.first_new = table, first_new
        self.reached, self.newest = reached, newest
        self.is_monotone, self.ended = is_monotone, ended
        self.available, self.valid = table.available[first_new:], table.valid[first_new:]
        self._by_valid: tuple[Rows, Times, Times] | None = None

    def without_news(self) -> InputSamples:
        """The same samples, none of which counts as new any more."""
        count, newest = len(self.table), self.newest
        return InputSamples(self.table, count, newest, newest, self.is_monotone, self.ended)

    @property
    def by_valid(self) -> tuple[Rows, Times, Times]:
        """All rows in order of valid, then available time, and these two times of each."""
        if self._by_valid is None:
            table = self.table
            rows = np.lexsort((table.available, table.valid))
            self._by_valid = rows, table.valid[rows], table.available[rows]
        return self._by_valid

    def delay(self, times: Times, moment: Times, complete: Mask) -> None:
        """Raise each ``moment`` to the one at which this input has what the state for each of
        ``times``, which increase, asks of it. Clear ``complete`` where that is not known yet.

        Cost: O(m log n) for m times; where valid times are in no order also O(n log n) once.
        """
        if self.is_monotone:
            # Earlier samples satisfy the states up to ``reached``, at moments that are over.
            known = up_to(times, self.reached)
            count = max(known, up_to(times, self.newest))
            if count > known:
                own = self.available[np.searchsorted(self.valid, times[known:count], "left")]
                np.maximum(moment[known:count], own, out=moment[known:count])
            if self.ended is None:
                complete[count:] = False
            else:
                np.maximum(moment[count:], self.ended, out=moment[count:])
            return
        _, valid, available = self.by_valid
        if not len(valid):
            own, has = moment, np.zeros(len(times), np.bool_)
        else:
            # Of equal valid times the first sample to arrive completes the state.
            place = np.minimum(np.searchsorted(valid, times, "left"), len(valid) - 1)
            own, has = available[place], valid[place] == times
        if self.ended is None:
            complete &= has
        else:
            # States wait for an input until the moment after its last promise, not longer.
            own = np.where(has, own, self.ended)
        np.maximum(moment, own, out=moment)

    def most_recent(self, times: Times, known: Times, exact: bool) -> Rows:
        """The most recent row at each of ``times`` among those available by ``known``, -1 for none;
        with ``exact`` only if it is valid then. ``times`` and ``known`` do not decrease."""
        table = self.table
        if self.is_monotone:
            # Neither time decreases, so the last row that is known and valid by then is the one.
            by_then = np.searchsorted(table.available, known, "right")
            rows = np.minimum(by_then, np.searchsorted(table.valid, times, "right")) - 1
        else:
            order = self.by_valid[0]
            rows = most_recent_rows(table.available, table.valid, times, known, order)
        if exact and len(table):
            return np.where((rows >= 0) & (table.valid[rows] == times), rows, -1)
        return rows


class News:
    """The new samples of all inputs, one input after the other."""

    __slots__ = ("_inputs", "available", "valid")

    def __init__(self, inputs: Sequence[InputSamples]) -> None:
        self._inputs = inputs
        self.available = np.concatenate([one.available for one in inputs])
        self.valid = np.concatenate([one.valid for one in inputs])

    def of_inputs(self, rows: Rows, constraint: Constraint) -> list[LateRows]:
        """``rows``, which increase, as rows of the inputs' tables."""
        late: list[LateRows] = []
        start = 0
        for i, one in enumerate(self._inputs):
            end = start + len(one.valid)
            own = rows[np.searchsorted(rows, start) : np.searchsorted(rows, end)]
            if len(own):
                late.append((i, own - start + one.first_new, constraint))
            start = end
        return late


class States(ABC):
    """The states of several inputs; see `Synchronization` for the rules.

    Law: what `run` gives does not depend on how the samples were cut into runs. Cost: O(m log n)
    numpy for m states over n samples; where an input's valid times are in no order also O(n log n).
    """

    def __init__(self, policy: SynchronizationPolicy) -> None:
        self._delay, self._duration = policy.max_delay, policy.duration
        self._exact = policy.approximation is Approximation.NONE
        self._left = NOTHING_KNOWN
        """When the last state left."""

    @property
    @abstractmethod
    def pending(self) -> int:
        """How many states wait."""

    @abstractmethod
    def run(self, inputs: Sequence[InputSamples], until: int) -> tuple[list[Made], list[LateRows]]:
        """All states that leave by ``until``, up to which the inputs are known, and the new samples
        that came too late for a state."""

    @abstractmethod
    def finish(self, inputs: Sequence[InputSamples]) -> tuple[list[Made], int]:
        """The states that leave after the end, and how many never leave."""

    @abstractmethod
    def of_use(self, one: InputSamples) -> SampleBatch:
        """The samples that a state to come may use."""


class OrderedStates(States):
    """States that leave in order of their times: L = max(c, L_before + 1)."""

    def __init__(self, policy: SynchronizationPolicy) -> None:
        super().__init__(policy)
        self._last = self._done = NOTHING_KNOWN
        """The time of the last state; the moment up to which all that leave have been given."""

    @property
    @abstractmethod
    def floor(self) -> int:
        """The least time that a later state may be for."""

    def of_use(self, one: InputSamples) -> SampleBatch:
        prune = of_use_in_order if one.is_monotone else of_use_in_any_order
        return prune(one, self.floor, self._duration.last)

    def _leave(
        self,
        times: Times,
        inputs: Sequence[InputSamples],
        until: int,
        begins: Times | None = None,
    ) -> tuple[list[Made], Times]:
        """The states for ``times``, which increase, that leave by ``until``, and the times of those
        that wait. With ``begins`` there is no state that begins after a later one has left."""
        if not len(times):
            return [], times
        moment, complete = completion(times, inputs)
        if self._delay is None:
            # Without a deadline the first incomplete state holds back all later ones.
            count = len(times) if complete.all() else int(np.argmin(complete))
            due = moment[:count]
        else:
            due = later(times, self._delay)
            np.minimum(due, moment, out=due, where=complete)
        if begins is not None and len(times) > 1:
            begin = timely_states(begins, due, self._left)
            if begin is not None:
                times, moment, due = times[begin], moment[begin], due[begin]
                complete = complete[begin]
        leaves = leaving(due, self._left)
        going = int(leaves.searchsorted(until, "right"))
        made: list[Made] = []
        for start in range(0, going, CHUNK):
            rows = slice(start, min(start + CHUNK, going))
            at, valid = leaves[rows], times[rows]
            # The values are those known when the state leaves, not when it is complete.
            chosen = tuple(one.most_recent(valid, at, self._exact) for one in inputs)
            # A state that left at its deadline stays incomplete, even if its samples came later.
            made.append((at, valid, chosen, complete[rows] & (moment[rows] <= at)))
        if going:
            self._left, self._last = int(leaves[going - 1]), int(times[going - 1])
        return made, times[going:]


def completion(times: Times, inputs: Sequence[InputSamples]) -> tuple[Times, Mask]:
    """When the state for each of ``times``, which increase, is complete, and whether that is known.

    The moment has no meaning where it is not known, and where it lies before the new samples.
    """
    moment = np.full(len(times), TIME_MIN)
    complete = np.ones(len(times), np.bool_)
    for one in inputs:
        if not (one.is_monotone or complete.any()):
            break
        one.delay(times, moment, complete)
    return moment, complete


def timely_states(begins: Times, due: Times, left: int) -> Mask | None:
    """Which states, in order of their times, begin before a later one has left; None for all.

    A state begins with the first sample for its time. It leaves when it is due and those before it
    that had begun have left; ``left`` is when the last one left. Cost: O(m) numpy for m states,
    with some that may not be timely O(m log m) in a compiled loop.
    """
    earliest = np.minimum.accumulate(due[::-1])[::-1]
    # If no later state is due before an earlier one begins, none can have left by then.
    if left >= TIME_MAX or bool((begins[:-1] <= earliest[1:]).all()):
        return None
    order = np.argsort(begins, kind="stable")
    timely = np.ones(len(begins), np.bool_)
    loop = mark_late if JIT and len(begins) >= COMPILED else mark_late.py_func
    loop(order, begins[order], due, left + 1, timely)
    return timely


def _mark_late(order: Any, begins: Any, due: Any, soonest: int, timely: Any) -> None:
    """Clear ``timely`` of each state, an index into ``due``, that begins after a later one has
    left. ``order`` are the states in order of ``begins``; none leaves before ``soonest``."""
    # Numba infers the type of this empty list from `order`.
    waiting = [order[0] for _ in range(0)]
    last = -1
    for event in range(len(order)):
        while len(waiting) > 0:
            leaves = max(due[waiting[0]], soonest)
            if leaves >= begins[event]:
                break
            soonest, last = leaves + 1, heappop(waiting)
        state = order[event]
        if state > last:
            heappush(waiting, state)
        else:
            timely[state] = False


def _signature() -> Any:
    from numba import types

    times = types.int64[::1]
    return types.void(times, times, times, types.int64, types.boolean[::1])


mark_late = Kernel(_mark_late, _signature)


def within(duration: Duration, valid: Times) -> Mask:
    """Which of ``valid`` are in the duration."""
    return (valid >= duration.first) & (valid <= duration.last)


def up_to(times: Times, time: int) -> int:
    """How many of ``times``, which do not decrease, are at or before ``time``."""
    return int(times.searchsorted(time, "right")) if time >= TIME_MIN else 0


def of_use_in_order(one: InputSamples, floor: int, last: int) -> SampleBatch:
    """The last sample of each valid time up to ``last``, from the last one valid at ``floor`` or
    before on; valid times do not decrease."""
    table, valid = one.table, one.table.valid
    start, stop = 0, len(valid)
    if floor >= TIME_MIN:
        # The last sample valid by the floor stays: it may be the most recent one there.
        start = max(0, int(valid.searchsorted(floor, "right")) - 1)
    if stop and valid[-1] > last:
        stop = max(start, int(valid.searchsorted(last, "right")))
    if stop - start > 1:
        # All of these are available when a later state leaves: of equal times the last one counts.
        repeated = valid[start + 1 : stop] == valid[start : stop - 1]
        if bool(repeated.any()):
            return table.take(np.append(np.flatnonzero(~repeated) + start, stop - 1))
    # Indices, not a slice: a view would keep the whole table in memory.
    return table if stop - start == len(valid) else table.take(np.arange(start, stop))


def of_use_in_any_order(one: InputSamples, floor: int, last: int) -> SampleBatch:
    """The same where valid times may decrease; in order of available time."""
    rows, valid, _ = one.by_valid
    final = np.ones(len(valid), np.bool_)
    final[:-1] = valid[1:] != valid[:-1]
    past = up_to(valid, floor)
    final[: max(0, past - 1)] = False
    final &= valid <= last
    return one.table if bool(final.all()) else one.table.take(np.sort(rows[final]))
