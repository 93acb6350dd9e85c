"""The rows of a recording in order of time, sorted in bounded memory (SPEC §1).

A recording without available times gets them from its valid times in the order of its rows
(`recording`). Rows that step back in time would then become available together, with the greatest
time before them, and fall into one window. Rows with available times of their own keep them, and
may be late. `dyknow replay` and `dyknow run` sort first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np

from ...streams.sample import SampleBatch, Times, concatenate
from ..csv_table import CHUNK
from .recording import Recording

RUN: Final = 1_000_000
"""Rows that are held at once: a table of k runs is read k times."""
RUNS: Final = 10
"""A longer table is sorted only on demand."""


@dataclass(frozen=True, slots=True, eq=False)
class TimeOrder:
    """A recording in the order in which its rows are taken.

    ``out_of_order`` counts the rows with a time before the greatest of the rows above, in the
    original order; ``is_sorted`` tells whether ``recording`` has another order.
    """

    recording: Recording
    out_of_order: int = 0
    is_sorted: bool = False

    @property
    def note(self) -> str | None:
        """A message for the user about rows out of order; None if all are in order."""
        if not self.out_of_order:
            return None
        said = f"{self.out_of_order:,} of {self.recording.rows:,} rows were out of order"
        if self.is_sorted:
            return f"sorted: {said}"
        effect = self.recording.out_of_order_effect
        return f"not sorted: {said}, and {effect}: sort the recording with --sort"


def in_time_order(recording: Recording, sort: bool | None = None) -> TimeOrder:
    """Count the rows out of order, and sort all rows by available time (valid time if the recording
    has no other); rows of one time keep their order.

    ``sort`` False only counts, True sorts any table, None sorts tables up to `RUNS` runs.

    Cost: one more pass over the recording; sorting adds one per run, O(n log n). Memory: 16 bytes a
    row, and one run of rows.
    """
    parts = list(recording.available_times())
    times = np.concatenate(parts) if parts else np.empty(0, np.int64)
    if not len(times):
        return TimeOrder(recording)
    highest = np.maximum.accumulate(times)
    out_of_order = int(np.count_nonzero(times < highest))
    if not out_of_order or sort is False or (sort is None and len(times) > RUN * RUNS):
        return TimeOrder(recording, out_of_order)
    place = np.empty(len(times), np.int64)
    place[np.argsort(times, kind="stable")] = np.arange(len(times))
    read = partial(_read_sorted, recording.read, place)
    sorted_ = replace(recording, read=read, read_times=None)
    return TimeOrder(sorted_, out_of_order, is_sorted=True)


def by_valid_time(recording: Recording) -> Recording:
    """Return the recording without its available times: each row is available when it is valid."""
    if not recording.has_available:
        return recording

    def read() -> Iterator[SampleBatch]:
        for batch in recording.read():
            yield batch.with_available(batch.valid)

    return replace(recording, read=read, read_times=None, has_available=False)


def _read_sorted(read: Callable[[], Iterator[SampleBatch]], place: Times) -> Iterator[SampleBatch]:
    """The rows of ``read``, each at its ``place``, in chunks."""
    for first in range(0, len(place), RUN):
        run = _run(read, place, first)
        for start in range(0, len(run), CHUNK):
            yield run.take(slice(start, start + CHUNK))


def _run(read: Callable[[], Iterator[SampleBatch]], place: Times, first: int) -> SampleBatch:
    """The rows of places ``first`` to ``first + RUN``, in order."""
    parts, places, row = [], [], 0
    for batch in read():
        own = place[row : row + len(batch)]
        row += len(batch)
        inside = (own >= first) & (own < first + RUN)
        if bool(inside.any()):
            parts.append(batch.take(np.flatnonzero(inside)))
            places.append(own[inside])
    return concatenate(parts).take(np.argsort(np.concatenate(places)))
