"""Speed from coordinates, against its definition sample by sample."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dyknow.engine.processes.geodesy import (
    EARTH_RADIUS,
    SpeedFromCoordinates,
    great_circle,
)
from dyknow.streams.time import SECOND


def distance(a, b):
    """Great-circle distance by the spherical law of cosines and chords: another formula."""

    def point(latitude, longitude):
        phi, lam = math.radians(latitude), math.radians(longitude)
        return (
            math.cos(phi) * math.cos(lam),
            math.cos(phi) * math.sin(lam),
            math.sin(phi),
        )

    chord = math.dist(point(*a), point(*b))
    return 2 * EARTH_RADIUS * math.asin(min(1.0, chord / 2))


class Definition:
    """The docstring of `SpeedFromCoordinates`, one sample at a time."""

    def __init__(self, baseline, max_gap):
        self.baseline, self.max_gap = baseline, max_gap
        self.seen = {}  # object -> [(valid, position, since, is_fix)]

    def sample(self, object, valid, position):
        past = self.seen.setdefault(object, [])
        if past and valid <= max(known[0] for known in past):
            return None
        news = not past or past[-1][1] != position
        since = valid if news else past[-1][2]
        is_fix = news or valid - since >= self.max_gap
        fixes = [(v, p) for v, p, _, fix in past if fix]
        past.append((valid, position, since, is_fix))
        if not is_fix:
            return None
        near = [(v, p) for v, p in fixes if valid - v <= self.baseline]
        if near:
            start, origin = near[0]
        elif fixes and valid - fixes[-1][0] <= self.max_gap:
            start, origin = fixes[-1]
        else:
            return None
        return distance(origin, position) / ((valid - start) / SECOND)


samples = st.lists(
    st.tuples(
        st.integers(0, 2),
        st.integers(0, 40),
        st.tuples(st.sampled_from([48.0, 48.01, 48.02]), st.sampled_from([2.0, 2.01])),
    ),
    max_size=40,
)


@given(samples, st.sampled_from([0, 3, 6]), st.sampled_from([5, 12]), st.data())
@settings(deadline=None, max_examples=200)
def test_speed_equals_its_definition_under_any_cut(rows, baseline, max_gap, data):
    unit = SpeedFromCoordinates(baseline * SECOND, max_gap * SECOND)
    definition = Definition(baseline * SECOND, max_gap * SECOND)
    got = []
    while rows:
        cut = data.draw(st.integers(1, len(rows)))
        batch, rows = rows[:cut], rows[cut:]
        objects = np.array([row[0] for row in batch], np.int64)
        valid = np.array([row[1] for row in batch], np.int64) * SECOND
        latitude = np.array([row[2][0] for row in batch])
        longitude = np.array([row[2][1] for row in batch])
        speeds, present = unit(objects, valid, latitude, longitude)
        for i, row in enumerate(batch):
            expected = definition.sample(row[0], row[1] * SECOND, row[2])
            got.append((expected, speeds[i] if present[i] else None))
    for expected, speed in got:
        assert (expected is None) == (speed is None)
        if expected is not None:
            assert math.isclose(speed, expected, rel_tol=1e-9, abs_tol=1e-6)


def test_great_circle_of_known_distances():
    quarter = math.pi / 2 * EARTH_RADIUS
    latitude = np.array([0.0, 0.0, 0.0, 90.0])
    longitude = np.array([0.0, 0.0, 0.0, 0.0])
    to_latitude = np.array([0.0, 90.0, 0.0, -90.0])
    to_longitude = np.array([90.0, 0.0, 0.0, 123.0])
    metres = great_circle(latitude, longitude, to_latitude, to_longitude)
    np.testing.assert_allclose(metres, [quarter, quarter, 0.0, 2 * quarter], rtol=1e-12)


def test_valid_times_at_the_ends_of_64_bits():
    unit = SpeedFromCoordinates()
    ends = np.array([-(2**63), 2**63 - 1], np.int64)
    speeds, present = unit(np.zeros(2, np.int64), ends, np.array([0.0, 1.0]), np.zeros(2))
    assert not present.any()
    assert np.isfinite(speeds).all()
