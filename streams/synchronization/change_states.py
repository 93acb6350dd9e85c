"""States at the inputs' own valid times, in order of these times (SPEC §1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..joins.join import distinct
from ..policies.policy import Constraint, SynchronizationPolicy
from ..sample import Mask, Times
from ..time import TIME_MAX, TIME_MIN
from ..time_arithmetic import later
from .states import NONE, InputSamples, LateRows, Made, News, OrderedStates, up_to, within


class ChangeStates(OrderedStates):
    """A state at every distinct valid time of a sample that comes within the delay; see
    `Synchronization`. Without a delay all inputs are monotone.

    Where no valid times decrease, what is valid earlier has come before, so that every such time
    gets its state. In any order a state may begin too late: see `timely_states`.
    Memory: the times of the states that wait.
    """

    def __init__(self, policy: SynchronizationPolicy) -> None:
        super().__init__(policy)
        self._waiting: Times = NONE
        """The times of the states that wait, which increase."""

    @property
    def floor(self) -> int:
        first = max(self._last, self._duration.first)
        if self._delay is None:
            return first
        # A later sample that keeps the delay is valid after ``_done - delay``, as is its state.
        least = int(self._waiting[0]) if len(self._waiting) else TIME_MAX
        return max(first, min(least, self._done + 1 - self._delay))

    @property
    def pending(self) -> int:
        return len(self._waiting)

    def run(self, inputs: Sequence[InputSamples], until: int) -> tuple[list[Made], list[LateRows]]:
        last, news = self._last, News(inputs)
        inside = within(self._duration, news.valid)
        over = self._over(news, inside)
        # A sample after the deadline of its state begins none: that state should have left.
        begins = self._begin(inputs, news, inside if over is None else inside & ~over)
        # Later states cannot leave yet, so their completion is not computed.
        count = self._reached(inputs, until)
        if begins is not None:
            begins = begins[:count]
        made, waiting = self._leave(self._waiting[:count], inputs, until, begins)
        self._waiting = np.concatenate([waiting, self._waiting[count:]])
        self._done = max(self._done, until)
        late: list[LateRows] = []
        if over is not None:
            late += news.of_inputs(np.flatnonzero(over), Constraint.DELAY)
        after = self._after(news, last, made)
        if after is not None:
            # Each sample is reported once, and a missed deadline is the reason that counts.
            if over is not None:
                after &= ~over
            # Without approximation no state could have used a sample outside the duration.
            if self._exact:
                after &= inside
            late += news.of_inputs(np.flatnonzero(after), Constraint.AVAILABLE)
        return made, late

    def finish(self, inputs: Sequence[InputSamples]) -> tuple[list[Made], int]:
        made, waiting = self._leave(self._waiting, inputs, TIME_MAX)
        self._waiting = NONE
        return made, len(waiting)

    def _over(self, news: News, inside: Mask) -> Mask | None:
        """Which new samples in the duration came after the deadline of their state; None for
        none."""
        if self._delay is None:
            return None
        over: Mask = news.available > later(news.valid, self._delay)
        if not over.any():
            return None
        over &= inside
        return over

    def _begin(self, inputs: Sequence[InputSamples], news: News, timely: Mask) -> Times | None:
        """Add the states that ``timely`` new samples begin to those that wait. If inputs are in any
        order: the moment at which each begins, `TIME_MIN` for an earlier one."""
        # States leave in order of their times, so none begins for an earlier time.
        timely = timely & (news.valid > self._last)
        times = np.concatenate([self._waiting, news.valid[timely]])
        if all(one.is_monotone for one in inputs):
            self._waiting = distinct(times)
            return None
        earlier = np.full(len(self._waiting), TIME_MIN)
        begins = np.concatenate([earlier, news.available[timely]])
        # The first sample of a time begins its state.
        order = np.lexsort((begins, times))
        times = times[order]
        first = np.ones(len(times), np.bool_)
        np.not_equal(times[1:], times[:-1], out=first[1:])
        self._waiting = times[first]
        return begins[order[first]]

    def _reached(self, inputs: Sequence[InputSamples], until: int) -> int:
        """How many of the waiting states may leave by ``until``: not one whose deadline is later
        and whose time an input has not reached."""
        least = min((one.newest for one in inputs if one.ended is None), default=TIME_MAX)
        if self._delay is not None:
            # Sums of times stop at the end of 64 bits.
            least = TIME_MAX if until >= TIME_MAX else max(least, until - self._delay)
        return up_to(self._waiting, least)

    def _after(self, news: News, last: int, made: Sequence[Made]) -> Mask | None:
        """Which new samples came after a state for their time or a later one had left; None for
        none. The last state before ``made`` was for ``last``."""
        valid = news.valid
        if not len(valid) or valid.min() > self._last:
            return None
        after: Mask = valid <= last if last >= TIME_MIN else np.zeros(len(valid), np.bool_)
        for leaves, times, _, _ in made:
            # A state that leaves at the moment of the arrival still uses the sample.
            gone = np.searchsorted(leaves, news.available, "left")
            after |= (gone > 0) & (valid <= times[gone - 1])
        return after
