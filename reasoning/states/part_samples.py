"""The samples that the states of parts may need, and the times of states to come, in compiled loops.

Each part has a list for each term, of samples in order of valid time, then of arrival; and one of
the times at which states are to leave. All are in one array:

``samples``  int64 (lists, fields, places): a sample or time is at a place; the terms' lists come
             first, that of times is the last
``ends``     int64 (lists, parts, 2): the first and last place of each part's list, or -1
``control``  int64 (lists, fields): `FREE`, `USED`, `LIVE`
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import JIT, Kernel
from ...streams.sample import Times
from ...streams.time import TIME_MIN
from .part_departures import Parts
from .states import Term

VALID, AVAILABLE, NEXT, BEFORE = range(4)
FIELDS: Final = 4
FIRST, LAST = range(2)
# The first place that is free, or -1; the places used by now; the samples.
FREE, USED, LIVE = range(3)
CONTROLS: Final = 3
SMALLEST: Final = 16


class PartSamples:
    """Samples of terms of one object each; an object is a part, by its number.

    Cost: O(1) for each new sample and state where samples of a part come in order of valid time,
    however many parts there are. Memory: 32 bytes a sample, up to twice, and its value.
    """

    def __init__(self, terms: Sequence[Term], *, has_times: bool) -> None:
        """``has_times``: whether there are states at the valid times of samples."""
        self._lists = {term: number for number, term in enumerate(terms)}
        count = len(terms) + 1
        self._has_times = has_times
        self._waiting: list[list[tuple[int, Times, Times, Parts, NDArray[Any]]]] = [
            [] for _ in terms
        ]
        """Samples that are not before the watermark: source, available, valid, part, value."""
        self._values: list[NDArray[Any]] = [np.zeros(SMALLEST) for _ in terms]
        """The values of samples, by their places."""
        self._samples = np.zeros((count, FIELDS, SMALLEST), np.int64)
        self._ends = np.full((count, 0, 2), -1, np.int64)
        self._control = np.zeros((count, CONTROLS), np.int64)
        self._control[:, FREE] = -1
        self._pending = np.zeros(SMALLEST, np.int64)
        """Parts with times of states to come."""
        self._is_pending = np.zeros(0, np.uint8)
        self._pending_count = 0

    def __len__(self) -> int:
        waiting = sum(len(each[1]) for rows in self._waiting for each in rows)
        return int(self._control[:-1, LIVE].sum()) + waiting

    def make_room_for(self, parts: int) -> None:
        """Let there be so many parts."""
        more = parts - self._ends.shape[1]
        ends = np.full((len(self._ends), more, 2), -1, np.int64)
        self._ends = np.concatenate([self._ends, ends], axis=1)
        self._is_pending = np.concatenate([self._is_pending, np.zeros(more, np.uint8)])

    def add(
        self, term: Term, source: int, available: Times, valid: Times, part: Parts,
        values: NDArray[Any],
    ) -> None:  # fmt: skip
        """Take samples of a term from a stream, in order of available time."""
        self._waiting[self._lists[term]].append((source, available, valid, part, values))

    def enter(self, watermark: int) -> tuple[Times, Times, Parts] | None:
        """Let the samples in that are available before ``watermark``; return their available and
        valid times and parts, or None if there are none."""
        new = []
        for number, waiting in enumerate(self._waiting):
            if waiting:
                due = self._take_due(number, watermark)
                if due is not None:
                    available, valid, part, values = due
                    places = self._entered(number, available, valid, part)
                    self._put_values(number, places, values)
                    new.append((available, valid, part))
        if len(new) < 2:
            return new[0] if new else None
        available, valid, part = (np.concatenate(each) for each in zip(*new, strict=True))
        return available, valid, part
