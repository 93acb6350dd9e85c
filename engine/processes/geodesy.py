"""Speed from coordinates: great-circle distance over time, for many objects at once.

The computational unit of the scenario in [Events14 §V.C] ("transforms coordinate features to
speed features"). A speed at a sample is the great-circle distance from an earlier sample of the
same object, divided by the difference of their *valid* times.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...streams.time import SECOND

EARTH_RADIUS = 6_371_008.8
"""Mean radius of the WGS-84 ellipsoid, in metres."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Mask = NDArray[np.bool_]


def great_circle(
    latitude_a: Floats, longitude_a: Floats, latitude_b: Floats, longitude_b: Floats
) -> Floats:
    """Return distances in metres between points in degrees, elementwise (haversine, a sphere).

    Within 0.6 % of the ellipsoid; exact to rounding for points close together and antipodal.
    """
    phi_a, phi_b = np.radians(latitude_a), np.radians(latitude_b)
    half_phi = (phi_b - phi_a) / 2
    half_lambda = np.radians(longitude_b - longitude_a) / 2
    h = np.sin(half_phi) ** 2 + np.cos(phi_a) * np.cos(phi_b) * np.sin(half_lambda) ** 2
    metres: Floats = 2 * EARTH_RADIUS * np.arcsin(np.sqrt(np.clip(h, 0.0, 1.0)))
    return metres


@dataclass(frozen=True, slots=True, eq=False)
class _Track:
    """Samples sorted by (object, valid time); all shape ``(n,)``.

    ``since`` is the valid time at which the sample's position was first reported.
    """

    objects: Ints
    valid: Ints
    latitude: Floats
    longitude: Floats
    since: Ints
    fix: Mask

    def take(self, rows: Mask) -> _Track:
        return _Track(
            self.objects[rows],
            self.valid[rows],
            self.latitude[rows],
            self.longitude[rows],
            self.since[rows],
            self.fix[rows],
        )


_NO_INTS = np.empty(0, np.int64)
_NO_FLOATS = np.empty(0, np.float64)
_NO_MASK = np.empty(0, np.bool_)


class SpeedFromCoordinates:
    """Speed in m/s from latitude and longitude in degrees, with state ([DyKnow10 Def. 5.10]).

    A sample is a *fix* of its object if it is later (in valid time) than all earlier samples of the
    object, and its position is new: it differs from the one before, or has not changed for at least
    ``max_gap``. (Receivers repeat the last known position until they have a new one; a repeated
    position is not a speed of zero.) The speed at a fix is its distance from the oldest fix within
    ``baseline`` before it, over the time between. Without one, it is that from the fix just before,
    if that is at most ``max_gap`` older. Other samples have no speed.

    A longer baseline averages out the jitter of positions, but delays turns and sprints by half of
    it. ``baseline`` 0 gives plain differences of neighbours. Both in ns.

    Law: the output does not depend on batch cuts. It equals that of the sample-by-sample definition
    in tests/engine/processes/test_geodesy.py.

    Cost: O(n log n) numpy a batch, n = new samples + fixes within the baseline. Memory: the fixes
    of each object's last baseline, at least one sample an object.
    """

    def __init__(self, baseline: int = 6 * SECOND, max_gap: int = 30 * SECOND) -> None:
        if baseline < 0 or max_gap <= 0:
            raise ValueError("baseline must not be negative, max_gap must be positive")
        self.baseline = baseline
        self.max_gap = max_gap
        self._known = _Track(_NO_INTS, _NO_INTS, _NO_FLOATS, _NO_FLOATS, _NO_INTS, _NO_MASK)

    def __call__(
        self, objects: Ints, valid: Ints, latitude: Floats, longitude: Floats
    ) -> tuple[Floats, Mask]:
        """Return speeds in m/s and the mask of samples that have one, both shape ``(n,)``.

        ``objects`` are integer keys; the samples are in order of available time.
        """
        rows, place = self._merge(objects, valid, latitude, longitude)
        fixes, fix_place = rows.take(rows.fix), place[rows.fix]
        partner = self._partners(fixes)
        here = np.flatnonzero((partner >= 0) & (fix_place >= 0))
        there = partner[here]
        metres = great_circle(
            fixes.latitude[there],
            fixes.longitude[there],
            fixes.latitude[here],
            fixes.longitude[here],
        )
        seconds = _elapsed(fixes.valid[there], fixes.valid[here]).astype(np.float64) / SECOND
        speeds, present = np.zeros(len(objects)), np.zeros(len(objects), np.bool_)
        speeds[fix_place[here]] = metres / seconds
        present[fix_place[here]] = True
        self._known = rows.take(self._still_needed(rows))
        return speeds, present

    def _merge(
        self, objects: Ints, valid: Ints, latitude: Floats, longitude: Floats
    ) -> tuple[_Track, Ints]:
        """Merge known and new samples by object and time, without those that are late in valid
        time. Return for each row also its index among the new samples, negative for a known one."""
        known = self._known
        # A stable sort by object keeps the known samples before the new ones of the object.
        order = np.argsort(np.concatenate((known.objects, objects)), kind="stable")
        rows = _Track(
            np.concatenate((known.objects, objects))[order],
            np.concatenate((known.valid, valid))[order],
            np.concatenate((known.latitude, latitude))[order],
            np.concatenate((known.longitude, longitude))[order],
            np.concatenate((known.since, valid))[order],
            np.concatenate((known.fix, np.zeros(len(objects), np.bool_)))[order],
        )
        place = order - len(known.objects)
        later = _later_than_all_before(rows.objects, rows.valid) | (place < 0)
        rows, place = rows.take(later), place[later]
        since = _since(rows, place)
        is_new = (since == rows.valid) | (_elapsed(since, rows.valid) >= np.uint64(self.max_gap))
        fix = np.where(place < 0, rows.fix, is_new)
        return replace(rows, since=since, fix=fix), place

    def _still_needed(self, rows: _Track) -> Mask:
        """Return the rows that later samples may refer to: each object's last sample, its last fix,
        and its fixes within the baseline."""
        last = _last_of_each(rows.objects)
        end = rows.valid[last][np.cumsum(last) - last]
        recent = rows.fix & (_elapsed(rows.valid, end) <= np.uint64(self.baseline))
        last_fix = np.zeros(len(last), np.bool_)
        last_fix[rows.fix] = _last_of_each(rows.objects[rows.fix])
        return last | recent | last_fix

    def _partners(self, rows: _Track) -> Ints:
        """Return for each fix the index of the fix to measure from, or -1."""
        count = len(rows.objects)
        index = np.arange(count)
        first = np.ones(count, np.bool_)
        first[1:] = rows.objects[1:] != rows.objects[:-1]
        start = np.maximum.accumulate(np.where(first, index, 0))
        # Binary search, all rows at once: the first fix of the object within the baseline.
        low, high = start.copy(), index.copy()
        while bool((low < high).any()):
            middle = (low + high) // 2
            near = _elapsed(rows.valid[middle], rows.valid) <= np.uint64(self.baseline)
            searching = low < high
            high = np.where(searching & near, middle, high)
            low = np.where(searching & ~near, middle + 1, low)
        before = index - 1
        gap_ok = np.zeros(count, np.bool_)
        inner = ~first
        gap_ok[inner] = _elapsed(rows.valid[before[inner]], rows.valid[inner]) <= np.uint64(
            self.max_gap
        )
        return np.where(low < index, low, np.where(gap_ok, before, -1))


def _since(rows: _Track, place: Ints) -> Ints:
    """Return when each row's position was first reported: its own time if the position is new, else
    that of the row before it."""
    same = np.zeros(len(rows.objects), np.bool_)
    same[1:] = (
        (rows.objects[1:] == rows.objects[:-1])
        & (rows.latitude[1:] == rows.latitude[:-1])
        & (rows.longitude[1:] == rows.longitude[:-1])
    )
    inherits = same & (place >= 0)
    source = np.maximum.accumulate(np.where(inherits, 0, np.arange(len(inherits))))
    since: Ints = rows.since[source]
    return since


def _last_of_each(objects: Ints) -> Mask:
    """Return a mask of the last row of each object, for rows grouped by object."""
    last = np.ones(len(objects), np.bool_)
    last[:-1] = objects[1:] != objects[:-1]
    return last


def _elapsed(earlier: Ints, later: Ints) -> NDArray[np.uint64]:
    """Return ``later - earlier``, which is not negative: uint64 holds it where int64 overflows."""
    return later.astype(np.uint64) - earlier.astype(np.uint64)


def _later_than_all_before(objects: Ints, valid: Ints) -> NDArray[np.bool_]:
    """Return a mask of the rows whose valid time is greater than all before them in their group,
    for rows grouped by object."""
    count = len(objects)
    if not count:
        return np.zeros(0, np.bool_)
    first = np.ones(count, np.bool_)
    first[1:] = objects[1:] != objects[:-1]
    # Ranks plus an offset for each group, so that one running maximum restarts in each group.
    _, rank = np.unique(valid, return_inverse=True)
    lifted = rank + (np.cumsum(first) - 1) * (int(rank.max()) + 1)
    greatest = np.maximum.accumulate(lifted)
    later = np.ones(count, np.bool_)
    later[1:] = lifted[1:] > greatest[:-1]
    return later | first
