"""The states of a formula: the values of features of many objects at one valid time (SPEC §1,
§8)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from math import prod
from typing import Final

import numpy as np
from numpy.typing import NDArray

from ...streams.policies.policy import Approximation, SynchronizationPolicy
from ...streams.sample import Mask, Times
from ...streams.time import TIME_MAX, TIME_MIN
from ...streams.time_arithmetic import earlier, later
from .departures import Steps
from .kept_samples import KeptSamples, Rows
from .states import States, Term, Values

CELLS: Final = 1 << 22
"""Values of one feature in the states that are made at once."""
MOST_STATES: Final = 10_000_000
"""States that may leave at one time."""


class TooManyDue(Exception):
    """A policy makes more states than can be made. The message says what to do."""


@dataclass(frozen=True, slots=True, eq=False)
class MadeStates:
    """States that leave, and the available time (ns) at which each does. ``part``: the part of
    each, in order, where parts have states of their own."""

    states: States
    left: Times
    part: NDArray[np.int64] | None = None


class StateMaker:
    """Makes the states of ``terms`` under a policy.

    Under ``sample every`` a state stands at each point of the grid, which begins with the duration,
    or at the least valid time of the first instant; otherwise at each valid time of a sample that
    came until its state left. Its value of a feature of an object is that of the newest sample by
    valid time (then by available time) among those that came until the state left; without ``use
    most recent`` only if it is valid at the state's own time.

    An object is present from its first sample until the streams of its newest samples have ended,
    one of each feature (`ended`); under ``sample every`` while its last sample is less than a
    period old. ``present_for``: also while its last sample is at most so old.
    ``wider``: the sorts of the formula that include each sort of it.

    Law (tests/laws/reasoning): the states are those of the definition, however the samples are cut.
    Cost: O(states x objects) numpy for each term. Memory: a sample for each object, those valid
    later than the last state, and `CELLS` values.
    """

    def __init__(
        self,
        terms: Sequence[Term],
        policy: SynchronizationPolicy,
        *,
        present_for: int | None = None,
        wider: Mapping[str, Sequence[str]] | None = None,
        grid: int | None = None,
    ) -> None:
        """``grid``: a time (ns) of a grid that began earlier; it goes on at the first sample."""
        self._policy = policy
        self._phase = grid
        self._present_for = present_for
        last = policy.duration.last
        self._kept = {term: KeptSamples(len(variables_of(term)), last) for term in terms}
        sorts = dict.fromkeys(sort for term in terms for sort in variables_of(term))
        self._wider = {sort: tuple((wider or {}).get(sort, ())) for sort in sorts}
        self._names: dict[str, list[str]] = {}
        self._places: dict[str, dict[str, int]] = {}
        for sort in (*sorts, *(each for others in self._wider.values() for each in others)):
            self._names.setdefault(sort, [])
            self._places.setdefault(sort, {})
        self._next: int | None = policy.duration.start if policy.period is not None else None
        """The next time of the grid, once it has begun."""
        self._begun = TIME_MIN
        """The available time of the first instant, at which the grid begins without a duration."""
        self._candidates: Times = np.empty(0, np.int64)
        """Times at which states will leave, without a grid."""
        self._lives: dict[int, int] = {}
        """The number of each stream's present life: a stream that has ended may begin another."""
        self._ends: Times = np.empty(0, np.int64)
        """The valid time at which each life ended; `TIME_MAX`: it lasts."""
        self._greatest = TIME_MIN
        self.late = 0
        """Samples that came after the state of their valid time had left."""

    def place(self, sort: str, iri: str) -> int:
        """Return the place of an object among those of a sort."""
        places = self._places[sort]
        found = places.get(iri)
        if found is None:
            found = places[iri] = len(places)
            self._names[sort].append(iri)
            for other in self._wider.get(sort, ()):
                self.place(other, iri)
        return found

    @property
    def grid(self) -> int | None:
        """A time (ns) of the grid, once it has begun."""
        return self._next if self._policy.period is not None else None

    @property
    def retained(self) -> int:
        """The number of samples in memory."""
        return sum(len(kept) for kept in self._kept.values())

    def add(self, term: Term, source: int, rows: Rows) -> None:
        """Take samples of a term from a stream, in order of available time. Where samples of two
        streams are equal in both times, that of the greater ``source`` counts as newer."""
        if self._policy.period is None:
            rows = replace(rows, life=np.full(len(rows.valid), self._life(source)))
        self._kept[term].add(source, rows)

    def ended(self, source: int, time: int) -> None:
        """A stream has ended. Its objects were there up to the valid ``time``, which is not before
        those of its samples."""
        if source in self._lives:
            self._ends[self._lives[source]] = time

    def _life(self, source: int) -> int:
        """The number of a stream's present life."""
        life = self._lives.get(source)
        if life is None or self._ends[life] != TIME_MAX:
            life = self._lives[source] = len(self._ends)
            self._ends = np.append(self._ends, TIME_MAX)
        return life

    def advance(self, steps: Steps) -> Iterator[MadeStates]:
        """Make the states that leave at ``steps``; each step comes once. Consume it at once."""
        due = self._due(steps)
        # The first sample of a grid may be late for states of the grid that it begins.
        return self._states(due, np.maximum(steps.left(due), self._begun))

    def end(self, moment: int) -> Iterator[MadeStates]:
        """Make the last states at the end of all streams: those up to the last valid time. They
        leave at ``moment``. Contract: `advance` was called with steps after every sample."""
        period = self._policy.period
        if period is None:
            due, self._candidates = self._candidates, self._candidates[:0]
        else:
            due = self._grid(self._greatest)
        return self._states(due, np.full(len(due), moment, np.int64))

    def _due(self, steps: Steps) -> Times:
        """The times of the states that leave at ``steps``, in order."""
        self._enter(steps)
        reached = steps.latest
        if self._policy.period is not None:
            return self._grid(reached - 1) if reached > TIME_MIN else np.empty(0, np.int64)
        cut = int(np.searchsorted(self._candidates, reached, "left"))
        due, self._candidates = self._candidates[:cut], self._candidates[cut:]
        return due

    def _enter(self, steps: Steps) -> None:
        """Let the samples in that are available before the watermark."""
        new = [kept.enter(steps.watermark) for kept in self._kept.values()]
        available = np.concatenate([rows.available for rows in new])
        valid = np.concatenate([rows.valid for rows in new])
        if not len(valid):
            return
        self._greatest = max(self._greatest, int(valid.max()))
        reached = steps.reached_before(available)
        self.late += int(np.count_nonzero(reached > valid))
        if self._policy.period is None:
            duration = self._policy.duration
            in_time = (reached <= valid) & (valid >= duration.first) & (valid <= duration.last)
            self._candidates = np.union1d(self._candidates, valid[in_time])
        elif self._next is None:
            self._begun = int(available.min())
            first = int(valid[available == self._begun].min())
            period = self._policy.period
            self._next = first if self._phase is None else first + (self._phase - first) % period

    def _grid(self, last: int) -> Times:
        """The times of the grid up to ``last`` that have not left."""
        period = self._policy.period
        assert period is not None
        last = min(last, self._policy.duration.last)
        if self._next is None or self._next > last:
            return np.empty(0, np.int64)
        count = (last - self._next) // period + 1
        if count > MOST_STATES:
            raise TooManyDue(
                f"{count:,} states are due at once, and at most {MOST_STATES:,} may be; sample "
                "less often, or begin later with `from`"
            )
        due: Times = self._next + period * np.arange(count, dtype=np.int64)
        self._next += period * count
        return due

    def _states(self, due: Times, left: Times) -> Iterator[MadeStates]:
        """Make the states at ``due`` some at a time."""
        if not len(due):
            return
        sizes = [len(names) for names in self._names.values()]
        columns = [prod(len(self._names[s]) for s in variables_of(term)) for term in self._kept]
        step = max(1, CELLS // max([1, *sizes, *columns]))
        for start in range(0, len(due), step):
            part = slice(start, start + step)
            yield MadeStates(self._some(due[part], left[part]), left[part])

    def _some(self, due: Times, left: Times) -> States:
        period, count = self._policy.period, len(due)
        has_ended = period is None and bool((self._ends != TIME_MAX).any())
        last_valid, until = self._no_times(count), self._no_times(count) if has_ended else {}
        values: dict[Term, Values] = {}
        for term, kept in self._kept.items():
            sorts = variables_of(term)
            shape = tuple(len(self._names[sort]) for sort in sorts)
            ends = self._ends if has_ended else None
            found, valid, alive = kept.at(due, left, shape, ends)
            known = valid != TIME_MIN
            if self._policy.approximation is Approximation.NONE:
                known &= valid == due.reshape((-1,) + (1,) * len(shape))
            values[term] = Values(found, known)
            self._raise(last_valid, sorts, valid)
            if alive is not None:
                self._raise(until, sorts, alive)
        following = earlier(np.append(due[1:], TIME_MAX), 1)
        horizon = due if period is None else np.minimum(following, later(due, period - 1))
        return States(
            due,
            horizon,
            {sort: tuple(names) for sort, names in self._names.items()},
            {
                sort: present_at(times, due, period, self._present_for, until.get(sort))
                for sort, times in last_valid.items()
            },
            values,
        )

    def _no_times(self, states: int) -> dict[str, Times]:
        """For each sort a table of shape ``(states, objects)``, which has no time yet."""
        return {
            sort: np.full((states, len(names)), TIME_MIN, np.int64)
            for sort, names in self._names.items()
        }

    def _raise(self, tables: Mapping[str, Times], sorts: Sequence[str], times: Times) -> None:
        """Raise the times of objects to those of a term's arguments, which are of these sorts."""
        for axis, sort in enumerate(sorts, 1):
            others = tuple(i for i in range(1, times.ndim) if i != axis)
            newest = times.max(axis=others, initial=TIME_MIN) if others else times
            np.maximum(tables[sort], newest, out=tables[sort])
            for each in self._wider[sort]:
                places = [self._places[each][iri] for iri in self._names[sort]]
                mine = tables[each]
                mine[:, places] = np.maximum(mine[:, places], newest)


def present_at(
    last_valid: Times,
    due: Times,
    period: int | None,
    extended: int | None,
    until: Times | None = None,
) -> Mask:
    """Whether objects with these last valid times, of shape ``(states, objects)``, are there at the
    states ``due``: on a grid less than its ``period`` before, otherwise up to the times ``until``
    (None: for ever); or at most ``extended`` (ns) before."""
    is_known = last_valid != TIME_MIN
    if period is not None:
        found = last_valid > earlier(due, period)[:, None]
    elif until is not None:
        found = until >= due[:, None]
    else:
        return np.asarray(is_known)
    if extended is not None:
        found |= last_valid >= earlier(due, extended)[:, None]
    return np.asarray(found & is_known)


def variables_of(term: Term) -> tuple[str, ...]:
    """Return the sorts of the variable arguments of a term."""
    return tuple(sort for sort in term[1] if not sort.startswith("<"))
