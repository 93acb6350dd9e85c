"""When the rows of a pattern leave, for parts that each have their own time (SPEC §1, §8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import Kernel
from ...streams.sample import Times
from ...streams.time import TIME_MAX, TIME_MIN

Parts = NDArray[np.int64]
_CLOCK: Final = -1
"""In place of a source: the clock has brought the watermark."""


@dataclass(frozen=True, slots=True, eq=False)
class PartSteps:
    """The steps of all parts, each as in `departures.Steps`, in order of part and moment.

    Those of part p are ``first[p] .. first[p + 1] - 1``. ``before``, ``latest``: the time that each
    part had reached before, and has reached now; shape ``(parts,)``.
    """

    first: NDArray[np.int64]
    moment: Times
    reached: Times
    before: Times
    latest: Times

    def reaching(self, part: Parts, times: Times) -> Times:
        """When the parts reach these times. Contract: as for `departures.Steps.reaching`, and each
        of these parts has a step."""
        place = search(self.first, self.reached, part, times)
        return self.moment[np.minimum(place, self.first[part + 1] - 1)]

    def left(self, part: Parts, due: Times) -> Times:
        """When the states of these times leave. Contract: as for `departures.Steps.left`."""
        return self.moment[search(self.first, self.reached, part, due + 1)]

    def reached_before(self, part: Parts, available: Times) -> Times:
        """The time that each part had reached when samples of these available times came."""
        place = search(self.first, self.moment, part, available)
        is_first = place == self.first[part]
        known = self.reached[place - 1] if len(self.reached) else self.before[part]
        return np.where(is_first, self.before[part], known)


def search(first: NDArray[np.int64], times: Times, part: Parts, wanted: Times) -> NDArray[np.int64]:
    """Return the first place of each part at which ``times`` are as late as wanted; the places of
    part p are ``first[p] .. first[p + 1] - 1``. Cost: O(n log m)."""
    found = np.empty(len(part), np.int64)
    given = (np.ascontiguousarray(each) for each in (first, times, part, wanted))
    _search.run(*given, found, size=len(part))
    return found


class PartDepartures:
    """The time reached by each part of the samples of ``sources`` streams, numbered from 0.

    Law (tests/laws/reasoning/test_part_departures.py): the steps of a part are those that
    `Departures` makes of its own samples, without a maximal delay. Cost: a sort of the new samples,
    and with the clock O(parts). Memory: 25 bytes for each source and part.
    """

    def __init__(self, sources: int, lateness: Sequence[int] = ()) -> None:
        self._lateness = np.array(tuple(lateness) or (0,) * sources, np.int64)
        self._waiting: list[list[tuple[Times, Times, Parts]]] = [[] for _ in range(sources)]
        """The samples of each stream (available, valid, part) that are not before the watermark."""
        self._count = 0
        self._newest = np.empty((sources, 0), np.int64)
        self._greatest = np.empty((sources, 0), np.int64)
        self._has_ended = np.empty((sources, 0), np.bool_)
        self._reached = np.empty(0, np.int64)
        self._ends = np.full(sources, TIME_MIN, np.int64)
        """When each stream ended last."""
        self._over = np.zeros(sources, np.bool_)
        """Whether each stream has ended, and had no sample since."""
        self.idle: frozenset[int] = frozenset()
        """Streams that have fallen silent, and are not waited for meanwhile."""

    def add_part(self) -> int:
        """Return the number of a new part, without samples."""
        if self._count == len(self._reached):
            more, sources = max(16, self._count), len(self._lateness)
            times = np.full((sources, more), TIME_MIN, np.int64)
            self._newest = np.concatenate([self._newest, times], axis=1)
            self._greatest = np.concatenate([self._greatest, times], axis=1)
            ended = np.zeros((sources, more), np.bool_)
            self._has_ended = np.concatenate([self._has_ended, ended], axis=1)
            self._reached = np.concatenate([self._reached, np.full(more, TIME_MIN, np.int64)])
        self._has_ended[:, self._count] = self._over
        self._count += 1
        return self._count - 1

    def add(self, source: int, available: Times, valid: Times, part: Parts) -> None:
        """Take samples of a stream, in order of available time."""
        self._has_ended[source, part] = False
        self._waiting[source].append((available, valid, part))

    def resume(self, source: int) -> None:
        """A stream goes on after its end: parts that are new wait for it."""
        self._over[source] = False

    def end(self, source: int, moment: int) -> None:
        """Wait for a stream no longer after the available time ``moment``, when it ended."""
        self._ends[source], self._over[source] = moment, True
        self._has_ended[source] = True

    def advance(self, watermark: int, *, by_clock: bool) -> PartSteps:
        """Return the steps at the instants before ``watermark``; ``by_clock`` also the one there.
        Contract: every sample available before it was added."""
        count = self._count
        due, rests = [], []
        for stream, waiting in enumerate(self._waiting):
            mine, rest = _split(waiting, watermark)
            due.append((np.full(len(mine[0]), stream, np.int64), *mine))
            rests.append(rest)
        self._waiting = [[rest] if len(rest[0]) else [] for rest in rests]
        if by_clock:
            clock = np.arange(count, dtype=np.int64)
            now = np.full(count, watermark, np.int64)
            due.append((np.full(count, _CLOCK, np.int64), now, now, clock))
        columns = [np.concatenate(each) for each in zip(*due, strict=True)]
        order = np.lexsort((columns[0], columns[1], columns[3]))
        source, available, valid, part = (each[order] for each in columns)
        newest, ceiling = self._newest[:, :count], np.full(count, TIME_MAX, np.int64)
        is_sample = source != _CLOCK
        place = source[is_sample], part[is_sample]
        np.maximum.at(newest, place, available[is_sample])
        silent = self._has_ended[:, :count].copy()
        silent[list(self.idle)] = True
        if silent.any():
            greatest = self._greatest[:, :count].copy()
            np.maximum.at(greatest, place, valid[is_sample])
            # The last rows leave at the end of all streams.
            ceiling = np.where(silent.all(axis=0), greatest.max(axis=0), TIME_MAX)
        last = np.where(self._has_ended[:, :count], self._ends[:, None], newest)
        for each, rest in enumerate(rests):
            silent[each, rest[2]] = False
        before = self._reached[:count].copy()
        steps = np.empty((3, len(part)), np.int64)
        latest = before.copy()
        made = int(
            _advance.run(
                source,
                available,
                valid,
                part,
                self._lateness,
                self._greatest,
                silent,
                last,
                ceiling,
                latest,
                steps,
                size=len(part),
            )
        )
        self._reached[:count] = latest
        of, moment, reached = (np.ascontiguousarray(each) for each in steps[:, :made])
        first = np.searchsorted(of, np.arange(count + 1))
        return PartSteps(first, moment, reached, before, latest)


def _split(
    parts: list[tuple[Times, Times, Parts]], watermark: int
) -> tuple[tuple[Times, Times, Parts], tuple[Times, Times, Parts]]:
    """The samples available before ``watermark``, and the others."""
    none = np.empty(0, np.int64)
    if not parts:
        return (none, none, none), (none, none, none)
    available, valid, part = (np.concatenate(each) for each in zip(*parts, strict=True))
    cut = int(np.searchsorted(available, watermark, "left"))
    return (available[:cut], valid[:cut], part[:cut]), (available[cut:], valid[cut:], part[cut:])


def _advance_loop(
    source: Any,
    available: Any,
    valid: Any,
    part: Any,
    lateness: Any,
    greatest: Any,
    silent: Any,
    last: Any,
    ceiling: Any,
    latest: Any,
    steps: Any,
) -> Any:
    """Make a step of each instant of a part; ``latest`` gets the last time that each reached.
    Return the number of steps."""
    made, i, count = 0, 0, part.shape[0]
    while i < count:
        p, moment = part[i], available[i]
        while i < count and part[i] == p and available[i] == moment:
            if source[i] >= 0:
                greatest[source[i], p] = max(greatest[source[i], p], valid[i])
            i += 1
        reached = TIME_MAX
        for s in range(lateness.shape[0]):
            if silent[s, p] and moment > last[s, p]:
                continue
            known = greatest[s, p]
            known = TIME_MIN if known < TIME_MIN + lateness[s] else known - lateness[s]
            reached = min(reached, known)
        reached = max(min(reached, ceiling[p]), latest[p])
        steps[0, made], steps[1, made], steps[2, made] = p, moment, reached
        latest[p] = reached
        made += 1
    return made


def _search_loop(first: Any, times: Any, part: Any, wanted: Any, found: Any) -> None:
    for i in range(part.shape[0]):
        low, high = first[part[i]], first[part[i] + 1]
        while low < high:
            middle = (low + high) >> 1
            if times[middle] < wanted[i]:
                low = middle + 1
            else:
                high = middle
        found[i] = low


def _advance_signature() -> Any:
    from numba import types

    row, table, truths = types.int64[::1], types.int64[:, ::1], types.boolean[:, ::1]
    return types.int64(row, row, row, row, row, table, truths, table, row, row, table)


def _search_signature() -> Any:
    from numba import types

    row = types.int64[::1]
    times = types.Array(types.int64, 1, "C", readonly=True)
    return types.void(row, times, row, times, row)


_advance = Kernel(_advance_loop, _advance_signature)
_search = Kernel(_search_loop, _search_signature)
