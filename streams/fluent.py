"""Fluent streams: a stream as its samples with bounded history ([DyKnow10 Def. 5.4-5.8]).

`FluentStream` answers for current and historic values from sorted columns; `Definition` in
tests/laws is its slow twin, straight from the paper's set notation.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from .sample import SampleBatch, Times, concatenate, empty_batch
from .sample import Schema as Schema
from .strings import StringPool


@dataclass(frozen=True, slots=True)
class Retention:
    """How much history a stream keeps: at most ``samples``, at most ``age`` ns of available time.

    ``age`` None keeps any age. History is dropped in whole batches: never less is kept than asked
    for, at most one batch more.
    """

    samples: int = 100_000
    age: int | None = None


@dataclass(frozen=True, slots=True)
class Segment:
    """A batch in a stream's history; ``first`` is its first sample's number (from 1)."""

    first: int
    batch: SampleBatch

    @property
    def last(self) -> int:
        return self.first + len(self.batch) - 1


class FluentStream:
    """Samples ordered by available time, unique and strictly increasing, the last ones kept.

    Contract: `append` takes only what continues the order (`StreamGenerator` sees to that).
    Numbers of samples are 1, 2, 3 … over the life of the stream, gap-free.

    Cost: append O(1) a batch; `since` and `newest` O(answer); `between` O(batches kept + answer);
    the others put the whole history together, O(batches kept + samples kept). Memory: `Retention`.
    """

    def __init__(
        self,
        schema: Schema,
        retention: Retention | None = None,
        pools: dict[str, StringPool] | None = None,
    ) -> None:
        self.schema = schema
        self.retention = retention or Retention()
        self.pools = pools if pools is not None else {}
        self._segments: deque[Segment] = deque()
        self._kept = 0
        self._next = 1
        self._last_available: int | None = None

    def __len__(self) -> int:
        """How many samples are kept."""
        return self._kept

    @property
    def last_number(self) -> int:
        """The number of the newest sample ever appended; 0 before the first."""
        return self._next - 1

    @property
    def first_number(self) -> int:
        """The number of the oldest sample kept; one past the newest when none is."""
        return self._segments[0].first if self._segments else self._next

    @property
    def last_available(self) -> int | None:
        """The greatest available time ever appended, None before the first sample."""
        return self._last_available

    def append(self, batch: SampleBatch) -> Segment | None:
        """Continue the stream; returns where the batch went, None if it was empty."""
        if not len(batch):
            return None
        available = batch.available
        if (self._last_available is not None and available[0] <= self._last_available) or (
            len(available) > 1 and not bool(np.all(available[1:] > available[:-1]))
        ):
            raise ValueError("available times of a stream are unique and increasing (Def. 4.1)")
        segment = Segment(self._next, batch)
        self._segments.append(segment)
        self._next += len(batch)
        self._kept += len(batch)
        self._last_available = int(available[-1])
        self._drop()
        return segment

    def since(self, number: int, limit: int | None = None) -> list[Segment]:
        """The kept segments from sample ``number`` on, the first one cut to begin there."""
        found: list[Segment] = []
        count = 0
        for segment in self._from(number):
            cut = max(0, number - segment.first)
            part = segment if cut == 0 else Segment(number, segment.batch.take(slice(cut, None)))
            found.append(part)
            count += len(part.batch)
            if limit is not None and count >= limit:
                break
        return found

    def all(self) -> SampleBatch:
        """The whole kept history as one batch."""
        if not self._segments:
            return empty_batch(self.schema, self.pools)
        return concatenate([segment.batch for segment in self._segments])

    def avail(self, time: int) -> SampleBatch:
        """Def. 5.5 avail(f, t): the kept samples with available time ≤ ``time``."""
        history = self.all()
        return history.take(slice(0, int(np.searchsorted(history.available, time, "right"))))

    def last_avail(self, time: int) -> SampleBatch:
        """Def. 5.5 last_avail(f, t): a batch of one, or empty for no_sample."""
        known = self.avail(time)
        return known.take(slice(max(0, len(known) - 1), None))

    def before(self, time: int, query_time: int) -> SampleBatch:
        """Def. 5.6 before(f, t, t_q): available by ``query_time``, valid at or before ``time``."""
        known = self.avail(query_time)
        return known.take(known.valid <= time)

    def most_recent_at(self, time: int, query_time: int) -> SampleBatch:
        """Def. 5.6 most_recent_at(f, t, t_q): a batch of one, or empty for no_sample.

        Of the samples known at ``query_time`` with the greatest valid time ≤ ``time``, the one
        that became available last.
        """
        candidates = self.before(time, query_time)
        if not len(candidates):
            return candidates
        newest = np.flatnonzero(candidates.valid == candidates.valid.max())[-1]
        return candidates.take(slice(int(newest), int(newest) + 1))

    def prev(self, available: int) -> SampleBatch:
        """Def. 5.7 prev(f, s): the sample before the one available at ``available``.

        A batch of one, or empty for no_sample.
        """
        history = self.all()
        index = int(np.searchsorted(history.available, available, "left"))
        return history.take(slice(max(0, index - 1), index))

    def availtimes(self) -> Times:
        """Def. 5.8 availtimes(f): the available times of the kept samples, increasing."""
        return self.all().available

    def newest(self, count: int) -> SampleBatch:
        """The last ``count`` kept samples (all, if fewer are kept)."""
        segments = self.since(self.last_number - count + 1)
        if not segments:
            return empty_batch(self.schema, self.pools)
        return concatenate([segment.batch for segment in segments])

    def between(self, start: int | None, end: int | None) -> SampleBatch:
        """The kept samples with available time in the closed interval; None is unbounded."""
        # Only what overlaps is put together: a history of single samples is many segments.
        held = [
            segment.batch
            for segment in self._segments
            if (start is None or segment.batch.available[-1] >= start)
            and (end is None or segment.batch.available[0] <= end)
        ]
        if not held:
            return empty_batch(self.schema, self.pools)
        history = concatenate(held)
        low = 0 if start is None else int(np.searchsorted(history.available, start, "left"))
        high = len(history)
        if end is not None:
            high = int(np.searchsorted(history.available, end, "right"))
        return history.take(slice(low, high))

    def _from(self, number: int) -> list[Segment]:
        """The segments that hold sample ``number`` and later ones, found from the newest end."""
        found: list[Segment] = []
        for segment in reversed(self._segments):
            if segment.last < number:
                break
            found.append(segment)
        found.reverse()
        return found

    def _drop(self) -> None:
        kept = self.retention
        while len(self._segments) > 1:
            oldest = self._segments[0]
            too_many = self._kept - len(oldest.batch) >= kept.samples
            too_old = (
                kept.age is not None
                and self._last_available is not None
                and int(oldest.batch.available[-1]) < self._last_available - kept.age
            )
            if not (too_many or too_old):
                return
            self._segments.popleft()
            self._kept -= len(oldest.batch)


def join_availtimes(*streams: FluentStream) -> Times:
    """Def. 5.8 availtimes({f1 … fn}): the union of the available times, increasing."""
    if not streams:
        return np.empty(0, np.int64)
    return np.unique(np.concatenate([stream.availtimes() for stream in streams]))
