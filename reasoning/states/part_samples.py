"""The samples that states of parts may need, and the times of states to come, in compiled loops.

Each part has a list for each term, of samples in order of valid time, then of arrival; and one of
the times at which states are to leave. All are in one array:

``samples``  int64 (lists, fields, places): a sample or time is at a place; the terms' lists come
             first, that of times is the last
``ends``     int64 (lists, parts, fields): the first and last place of each part's list, or -1;
             where the last sample was put in, and in which step that was
``control``  int64 (lists, fields): see below
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import Kernel
from ...streams.sample import Times
from ...streams.time import TIME_MAX, TIME_MIN
from .kept_samples import Rows, WaitingSamples
from .part_departures import Parts
from .states import Term

VALID, AVAILABLE, NEXT, BEFORE = range(4)
FIELDS: Final = 4
FIRST, LAST, RECENT, STEP_OF = range(4)
# The first place that is free, or -1; the places used by now; the samples; parts with times; the
# number of the last step, in which samples or times were put in.
FREE, USED, LIVE, PENDING, STEP = range(5)
CONTROLS: Final = 5
SMALLEST: Final = 16
ROOMY: Final = 1024
"""So many places stay, however few are used."""


class PartSamples:
    """Samples of terms of one object each, and times of states to come; an object is a part, by its
    number.

    Cost: O(1) for each new sample and state, however many parts there are, where samples come in
    order of valid time; otherwise a sort of the new ones, and a walk over those of the part that
    are valid later, once for all new ones. Memory: for each list 32 bytes a place, and a value: as
    many places as the longest list has had samples at once, up to twice; an eighth of them is in
    use, or there are few.
    """

    def __init__(self, terms: Sequence[Term], last: int = TIME_MAX) -> None:
        """``last``: the time (ns) of the last state that there may be."""
        self._last = last
        self._lists = {term: number for number, term in enumerate(terms)}
        self._waiting = [WaitingSamples(1) for _ in terms]
        """By lists; the places of samples are their parts."""
        self._values: list[NDArray[Any]] = [np.zeros(0) for _ in terms]
        """The values of samples, by their places."""
        count = len(terms) + 1
        self._samples = np.zeros((count, FIELDS, SMALLEST), np.int64)
        self._ends = np.full((count, 0, 4), -1, np.int64)
        self._control = np.zeros((count, CONTROLS), np.int64)
        self._control[:, FREE] = -1
        self._pending = np.zeros((2, 0), np.int64)
        """Parts with times; for each part whether it is among these."""

    def __len__(self) -> int:
        return int(self._control[:-1, LIVE].sum()) + sum(map(len, self._waiting))

    def make_room_for(self, parts: int) -> None:
        """Let there be so many parts."""
        more = parts - self._ends.shape[1]
        ends = np.full((len(self._ends), more, 4), -1, np.int64)
        self._ends = np.concatenate([self._ends, ends], axis=1)
        self._pending = np.concatenate([self._pending, np.zeros((2, more), np.int64)], axis=1)

    def add(
        self, term: Term, source: int, available: Times, valid: Times, part: Parts,
        values: NDArray[Any],
    ) -> None:  # fmt: skip
        """Take samples of a term from a stream, in order of available time."""
        rows = Rows(available, valid, part.reshape(-1, 1), values)
        self._waiting[self._lists[term]].add(source, rows)

    def enter(self, watermark: int) -> tuple[Times, Times, Parts] | None:
        """Let the samples in that are available before ``watermark``; return their available and
        valid times and parts; None: there are none."""
        self._shrink()
        new = []
        for number, waiting in enumerate(self._waiting):
            rows = waiting.take(watermark)
            if len(rows.valid):
                new.append((rows.available, rows.valid, rows.places[:, 0]))
                if np.count_nonzero(rows.valid > self._last):
                    # They count for no state.
                    rows = rows.take(rows.valid <= self._last)
                self._put(number, rows)
        if len(new) < 2:
            return new[0] if new else None
        available, valid, part = (np.concatenate(each) for each in zip(*new, strict=True))
        return available, valid, part

    def add_times(self, part: Parts, valid: Times) -> None:
        """Take times at which states of parts are to leave; each once."""
        self._make_places(len(self._waiting), len(valid))
        if (order := _order(valid)) is not None:
            part, valid = part[order], valid[order]
        arrays = self._samples, self._ends, self._control, self._pending
        _add_times.run(part, valid, *arrays, size=len(part))

    def due(self, limits: Times | None) -> tuple[Times, Parts]:
        """Remove the times before the limit of their part, or before that of all (one limit); None:
        all times. Return them in order of parts and time."""
        most = int(self._control[-1, LIVE])
        due, part = np.empty((2, most), np.int64)
        if most:
            arrays = self._samples, self._ends, self._control, self._pending
            is_all = int(limits is None)
            given = np.empty(1, np.int64) if limits is None else np.ascontiguousarray(limits)
            count = int(_due.run(given, is_all, *arrays, due, part, size=most))
            due, part = due[:count], part[:count]
        if np.count_nonzero(part[1:] < part[:-1]):
            order = np.argsort(part, kind="stable")
            due, part = due[order], part[order]
        return due, part

    def at(
        self, due: Times, left: Times, part: Parts
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The samples that stand for each term at states, which leave at ``left``: their places
        (`values`) and valid times (`TIME_MIN`: none); shape ``(terms, n)``. Of a part's samples
        that are valid at a state, and available when it leaves, it is the newest by valid time,
        then by arrival. Forgets the samples that no later state needs. Contract: states are in
        order of parts and time."""
        found = np.empty((2, len(self._waiting), len(due)), np.int64)
        given = (np.ascontiguousarray(each) for each in (due, left, part))
        _at.run(*given, self._samples, self._ends, self._control, found, size=len(due))
        return found[0], found[1]

    def values(self, term: Term, places: NDArray[np.int64]) -> NDArray[Any]:
        """The values of samples of a term at these places. Contract: since `at` no sample came."""
        number = self._lists[term]
        known = self._values[number]
        return known[places[number]] if len(known) else np.zeros(places.shape[1])

    def drop(self, part: int) -> None:
        """Forget the samples and times of a part."""
        _drop.run(part, self._samples, self._ends, self._control, size=1)
        for waiting in self._waiting:
            waiting.drop(part)

    def _put(self, number: int, rows: Rows) -> None:
        """Put samples into the lists of a term."""
        self._make_places(number, len(rows.valid))
        if (order := _order(rows.valid)) is not None:
            rows = rows.take(order)
        values, places = rows.values, np.empty(len(rows.valid), np.int64)
        columns = rows.places[:, 0], rows.valid, rows.available
        given = (np.ascontiguousarray(each) for each in columns)
        arrays = self._samples, self._ends, self._control, places
        _put.run(number, *given, *arrays, size=len(places))
        known = self._values[number]
        if len(known) < self._samples.shape[2] or known.dtype != values.dtype:
            grown = np.zeros(self._samples.shape[2], values.dtype)
            grown[: len(known)] = known
            known = self._values[number] = grown
        known[places] = values

    def _make_places(self, number: int, more: int) -> None:
        """Let a list have places for so many more."""
        places = self._samples.shape[2]
        needed = int(self._control[number, LIVE]) + more
        if needed > places:
            grown = np.zeros((*self._samples.shape[:2], 2 * needed), np.int64)
            grown[:, :, :places] = self._samples
            self._samples = grown

    def _shrink(self) -> None:
        """Give places back that a large batch has needed."""
        places, live = self._samples.shape[2], int(self._control[:, LIVE].max())
        if places <= ROOMY or 8 * live >= places:
            return
        samples = np.zeros((*self._samples.shape[:2], max(ROOMY, 2 * live)), np.int64)
        moved = np.zeros((len(samples), live), np.int64)
        _pack.run(self._samples, samples, self._ends, self._control, moved, size=live)
        self._samples = samples
        for number, known in enumerate(self._values):
            kept = np.zeros(samples.shape[2], known.dtype)
            if len(known):
                count = int(self._control[number, LIVE])
                kept[:count] = known[moved[number, :count]]
            self._values[number] = kept


def _order(valid: Times) -> NDArray[np.int64] | None:
    """The order of valid times, then of arrival; None: they are in order."""
    if len(valid) < 2 or not np.count_nonzero(valid[1:] < valid[:-1]):
        return None
    return np.argsort(valid, kind="stable")


# -- compiled --------------------------------------------------------------------------------


def _place_before(number: Any, part: Any, valid: Any, samples: Any, ends: Any, step: Any) -> Any:
    """The last place in a list that is not valid later, or -1: from where the last one of this step
    was put in on, or from the end back."""
    place = ends[number, part, LAST]
    if place < 0 or samples[number, VALID, place] <= valid:
        return place
    recent = ends[number, part, RECENT]
    if ends[number, part, STEP_OF] == step and samples[number, VALID, recent] <= valid:
        place, after = recent, samples[number, NEXT, recent]
        while samples[number, VALID, after] <= valid:
            place, after = after, samples[number, NEXT, after]
        return place
    while place >= 0 and samples[number, VALID, place] > valid:
        place = samples[number, BEFORE, place]
    return place


def _insert(
    number: Any, part: Any, before: Any, valid: Any, available: Any, samples: Any, ends: Any,
    control: Any,
) -> Any:  # fmt: skip
    """Put a sample into a list, after the place ``before``; return its own."""
    place = control[number, FREE]
    if place >= 0:
        control[number, FREE] = samples[number, NEXT, place]
    else:
        place = control[number, USED]
        control[number, USED] += 1
    control[number, LIVE] += 1
    after = samples[number, NEXT, before] if before >= 0 else ends[number, part, FIRST]
    samples[number, VALID, place], samples[number, AVAILABLE, place] = valid, available
    samples[number, NEXT, place], samples[number, BEFORE, place] = after, before
    if before >= 0:
        samples[number, NEXT, before] = place
    else:
        ends[number, part, FIRST] = place
    if after >= 0:
        samples[number, BEFORE, after] = place
    else:
        ends[number, part, LAST] = place
    ends[number, part, RECENT], ends[number, part, STEP_OF] = place, control[number, STEP]
    return place


def _remove_first(number: Any, part: Any, samples: Any, ends: Any, control: Any) -> None:
    """Take the first sample out of a list that has one."""
    place = ends[number, part, FIRST]
    after = samples[number, NEXT, place]
    ends[number, part, FIRST] = after
    if after >= 0:
        samples[number, BEFORE, after] = -1
    else:
        ends[number, part, LAST] = -1
    samples[number, NEXT, place] = control[number, FREE]
    control[number, FREE] = place
    control[number, LIVE] -= 1


def _put_loop(
    number: Any, part: Any, valid: Any, available: Any, samples: Any, ends: Any, control: Any,
    places: Any,
) -> None:  # fmt: skip
    control[number, STEP] += 1
    for i in range(len(part)):
        before = _place_before(number, part[i], valid[i], samples, ends, control[number, STEP])
        places[i] = _insert(number, part[i], before, valid[i], available[i], samples, ends, control)


def _add_times_loop(
    part: Any, valid: Any, samples: Any, ends: Any, control: Any, pending: Any
) -> None:
    number = len(control) - 1
    control[number, STEP] += 1
    for i in range(len(part)):
        own = part[i]
        before = _place_before(number, own, valid[i], samples, ends, control[number, STEP])
        if before >= 0 and samples[number, VALID, before] == valid[i]:
            continue
        _insert(number, own, before, valid[i], 0, samples, ends, control)
        if not pending[1, own]:
            pending[1, own] = 1
            pending[0, control[number, PENDING]] = own
            control[number, PENDING] += 1


def _due_loop(
    limits: Any, is_all: Any, samples: Any, ends: Any, control: Any, pending: Any, due: Any,
    part: Any,
) -> Any:  # fmt: skip
    number, count, rest = len(control) - 1, 0, 0
    for k in range(control[number, PENDING]):
        own = pending[0, k]
        limit = limits[own] if len(limits) > 1 else limits[0]
        place = ends[number, own, FIRST]
        while place >= 0 and (is_all or samples[number, VALID, place] < limit):
            due[count], part[count] = samples[number, VALID, place], own
            count += 1
            _remove_first(number, own, samples, ends, control)
            place = ends[number, own, FIRST]
        if place >= 0:
            pending[0, rest] = own
            rest += 1
        else:
            pending[1, own] = 0
    control[number, PENDING] = rest
    return count


def _at_loop(
    due: Any, left: Any, part: Any, samples: Any, ends: Any, control: Any, found: Any
) -> None:
    for number in range(len(control) - 1):
        best = -1
        for i in range(len(due)):
            own = part[i]
            if i == 0 or part[i - 1] != own:
                best = -1
            place = samples[number, NEXT, best] if best >= 0 else ends[number, own, FIRST]
            while place >= 0 and samples[number, VALID, place] <= due[i]:
                if samples[number, AVAILABLE, place] <= left[i]:
                    best = place
                place = samples[number, NEXT, place]
            found[0, number, i] = best
            found[1, number, i] = samples[number, VALID, best] if best >= 0 else TIME_MIN
            # Those before the last state's sample are older, also for each later state.
            if best >= 0 and (i + 1 == len(due) or part[i + 1] != own):
                while ends[number, own, FIRST] != best:
                    _remove_first(number, own, samples, ends, control)


def _pack_loop(samples: Any, new: Any, ends: Any, control: Any, moved: Any) -> None:
    """Copy the lists to the first places of other arrays; ``moved`` gets where each was."""
    for number in range(len(control)):
        used = 0
        for part in range(ends.shape[1]):
            place = ends[number, part, FIRST]
            if place < 0:
                continue
            ends[number, part, FIRST] = used
            before = -1
            while place >= 0:
                new[number, VALID, used] = samples[number, VALID, place]
                new[number, AVAILABLE, used] = samples[number, AVAILABLE, place]
                new[number, BEFORE, used], new[number, NEXT, used] = before, -1
                if before >= 0:
                    new[number, NEXT, before] = used
                moved[number, used] = place
                before = used
                used += 1
                place = samples[number, NEXT, place]
            ends[number, part, LAST] = before
        control[number, USED], control[number, FREE] = used, -1


def _drop_loop(part: Any, samples: Any, ends: Any, control: Any) -> None:
    for number in range(len(control)):
        while ends[number, part, FIRST] >= 0:
            _remove_first(number, part, samples, ends, control)


def _types() -> tuple[Any, Any, Any, Any]:
    from numba import types

    return types, types.int64[::1], types.int64[:, ::1], types.int64[:, :, ::1]


def _put_signature() -> Any:
    types, row, table, cube = _types()
    times = types.Array(types.int64, 1, "C", readonly=True)
    return types.void(types.int64, row, times, times, cube, cube, table, row)


def _add_times_signature() -> Any:
    types, row, table, cube = _types()
    times = types.Array(types.int64, 1, "C", readonly=True)
    return types.void(row, times, cube, cube, table, table)


def _due_signature() -> Any:
    types, row, table, cube = _types()
    return types.int64(row, types.int64, cube, cube, table, table, row, row)


def _at_signature() -> Any:
    types, row, table, cube = _types()
    return types.void(row, row, row, cube, cube, table, cube)


def _pack_signature() -> Any:
    types, _, table, cube = _types()
    return types.void(cube, cube, cube, table, table)


def _drop_signature() -> Any:
    types, _, table, cube = _types()
    return types.void(types.int64, cube, cube, table)


_IN_LOOPS: Final = _place_before, _insert, _remove_first
_put = Kernel(_put_loop, _put_signature, allocates=False, calls=_IN_LOOPS)
_add_times = Kernel(_add_times_loop, _add_times_signature, allocates=False, calls=_IN_LOOPS)
_due = Kernel(_due_loop, _due_signature, allocates=False, calls=_IN_LOOPS)
_at = Kernel(_at_loop, _at_signature, allocates=False, calls=_IN_LOOPS)
_pack = Kernel(_pack_loop, _pack_signature, allocates=False)
_drop = Kernel(_drop_loop, _drop_signature, allocates=False, calls=_IN_LOOPS)
