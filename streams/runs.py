"""The kept samples of a stream in few batches, which `FluentStream` searches."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from operator import attrgetter
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .sample import TIMES_SIZE, SampleBatch, Schema, concatenate, empty_batch
from .string_pool import StringPool
from .time import TIME_MAX, TIME_MIN

_FAN: Final = 32
"""How many neighbouring runs of one size class become one of the next class."""


@dataclass(frozen=True, slots=True)
class Retention:
    """How much history a stream keeps: at most ``samples``, at most ``age`` ns of available time,
    at most ``bytes`` (`SampleBatch.sizes`).

    None for ``age`` or ``bytes`` keeps any. Law: with *asked* the number of newest samples that no
    limit forbids, ``max(asked, rows of the newest batch)`` samples are kept: never less than asked
    for, and the newest batch is always there as a whole.
    """

    samples: int = 100_000
    age: int | None = None
    bytes: int | None = None


@dataclass(frozen=True, slots=True)
class Segment:
    """Consecutive samples of a stream; ``first`` is the first one's number (from 1)."""

    first: int
    batch: SampleBatch

    @property
    def last(self) -> int:
        return self.first + len(self.batch) - 1


class _Run(NamedTuple):
    """Batches that were put together, with the bounds by which a search passes them over."""

    first: int
    """The number of the first sample."""
    batch: SampleBatch
    begin: int
    """The first available time, and the last."""
    end: int
    low: int
    """The least valid time, and the greatest."""
    high: int
    size: int
    """The size class: ``_FAN ** size`` to ``_FAN ** (size + 1) - 1`` samples."""
    place: int = 1
    """How many runs of this class stand here in a row, up to this one."""
    weight: int | None = None
    """Bytes of all its samples; None: not computed yet."""


FIRST = attrgetter("first")
_END = attrgetter("end")


class Runs:
    """The samples that a stream keeps, by number, in runs: batches that were put together.

    Neighbouring runs of like size are put together as the stream grows, so a history of n samples
    is O(log n) runs however it was cut, some hundreds at most, and a sample is copied O(log n)
    times. A run of more than an eighth of the retention is never made; one that came so is cut as
    soon as half of it is gone. Batches that were appended or handed out never change.

    Cost: `append` O(columns) amortized a batch, and O(runs) where the history is as many bytes as
    may be. Memory: `Retention`, and at most one run more.
    """

    def __init__(
        self,
        schema: Schema,
        retention: Retention,
        pools: dict[str, StringPool] | None,
        first: int,
    ) -> None:
        self.schema = schema
        self._retention = retention
        # Its own: which pool a field has changes, and others change theirs at other times.
        self.pools = dict(pools or {})
        self._runs: list[_Run] = []
        self._last_sums: tuple[int, int, NDArray[np.int64]] | None = None
        self._first = first
        self._next = first
        self._last_available: int | None = None
        self._gone_valid: tuple[int, int] | None = None
        """The least and the greatest valid time of samples in runs that are gone."""
        self._gone_available = TIME_MIN
        """The greatest available time of these samples."""

    def __len__(self) -> int:
        """How many samples are kept."""
        return self._next - self._first

    @property
    def last_number(self) -> int:
        """The number of the newest sample ever appended; before the first one less than its."""
        return self._next - 1

    @property
    def first_number(self) -> int:
        """The number of the oldest sample kept; one past the newest when none is."""
        return self._first

    @property
    def first_available(self) -> int | None:
        """The available time of the oldest sample kept, None when none is.

        Answers about earlier times may lack what was known then: history reaches back to here.
        """
        if not self._runs:
            return None
        oldest = self._runs[0]
        return int(oldest.batch.available[self._first - oldest.first])

    @property
    def last_available(self) -> int | None:
        """The greatest available time ever appended, None before the first sample."""
        return self._last_available

    @property
    def forgotten_valid(self) -> tuple[int, int] | None:
        """The least and the greatest valid time of all samples that retention has forgotten; None
        if there is none. Cost: O(samples of one run)."""
        # Retention forgets single samples but frees whole runs: the oldest may have forgotten ones.
        if self._runs and (gone := self._first - self._runs[0].first):
            valid = self._runs[0].batch.valid[:gone]
            return _span(self._gone_valid, int(valid.min()), int(valid.max()))
        return self._gone_valid

    @property
    def complete_since(self) -> int:
        """The least available time (ns) from which on no sample is forgotten, as retention may cut
        an instant; `TIME_MIN` if no sample is forgotten at all."""
        if self.forgotten_valid is None:
            return TIME_MIN
        gone = self._first - self._runs[0].first if self._runs else 0
        newest = int(self._runs[0].batch.available[gone - 1]) if gone else self._gone_available
        return min(newest + 1, TIME_MAX)

    def append(self, batch: SampleBatch) -> Segment | None:
        """Continue the stream; returns where the batch went, None if it was empty."""
        if not len(batch):
            return None
        available = batch.available
        if (self._last_available is not None and available[0] < self._last_available) or (
            len(available) > 1 and np.count_nonzero(available[1:] < available[:-1])
        ):
            raise ValueError("available times of a stream do not decrease (Def. 4.1)")
        number = self._next
        run = _run(number, batch)
        self._gather(run)
        self._next += len(batch)
        self._last_available = run.end
        self._drop(number)
        return Segment(number, batch)

    def since(self, number: int, limit: int | None = None) -> list[Segment]:
        """The kept samples from ``number`` on, in order, as segments.

        With ``limit`` the segments end with the one that reaches this number of samples.
        """
        found: list[Segment] = []
        number = max(number, self._first)
        end = self._next if limit is None else number + max(1, limit)
        for i in range(max(0, bisect_right(self._runs, number, key=FIRST) - 1), len(self._runs)):
            run = self._runs[i]
            if run.first >= end:
                break
            cut = max(0, number - run.first)
            if cut < len(run.batch):
                part = run.batch if cut == 0 else run.batch.take(slice(cut, None))
                found.append(Segment(run.first + cut, part))
        return found

    def at(self, numbers: NDArray[np.int64]) -> SampleBatch:
        """The samples with these numbers, which increase and are all kept; at least one.

        Cost: O(runs + numbers).
        """
        parts = []
        first, last = int(numbers[0]), int(numbers[-1])
        for segment in self.since(first, last + 1 - first):
            low, high = numbers.searchsorted((segment.first, segment.last + 1))
            if low < high:
                parts.append(segment.batch.take(numbers[low:high] - segment.first))
        return concatenate(parts)

    def _number(self, time: int, side: Literal["left", "right"]) -> int:
        """The number of the first sample available after ``time`` (``left``: at it or after)."""
        i = (bisect_left if side == "left" else bisect_right)(self._runs, time, key=_END)
        if i == len(self._runs):
            return self._next
        run = self._runs[i]
        # Within a run the time is one of 64 bits, which is all that numpy can search for.
        row = 0 if time < run.begin else int(run.batch.available.searchsorted(time, side))
        return max(self._first, run.first + row)

    def _part(self, start: int, end: int) -> SampleBatch:
        """The kept samples with ``start`` ≤ number < ``end``."""
        start = max(start, self._first)
        parts: list[SampleBatch] = []
        i = max(0, bisect_right(self._runs, start, key=FIRST) - 1)
        while start < end and i < len(self._runs):
            run = self._runs[i]
            rows = slice(start - run.first, end - run.first)
            whole = rows.start == 0 and rows.stop >= len(run.batch)
            parts.append(run.batch if whole else run.batch.take(rows))
            start = run.first + len(run.batch)
            i += 1
        return concatenate(parts) if parts else empty_batch(self.schema, self.pools)

    def _gather(self, run: _Run) -> None:
        """Add a run, put together with neighbours so that the runs stay few.

        Sizes fall from the oldest run to the newest, and fewer than ``_FAN`` runs in a row are of
        one class: a run that is smaller than the next one joins it, and a full row becomes one run
        of the next class. Where that would be too large for one run (`_joining`), as many join as
        may, and a new row begins with it. Such runs are large, so that there are few of them.
        """
        runs = self._runs
        runs.append(run)
        is_full = False
        while len(runs) > 1 and not is_full:
            before, last = runs[-2:]
            if before.size > last.size or (before.size == last.size and before.place + 1 < _FAN):
                break
            most = last.size if before.size == last.size else last.size - 1
            start, is_full = self._joining(most)
            parts = runs[start:]
            if len(parts) > 1:
                weights = [part.weight for part in parts]
                # Weighing is a pass over the rows, so it waits until a limit in bytes asks for it.
                weight = None if None in weights else sum(filter(None, weights))
                joined = _run(parts[0].first, concatenate([part.batch for part in parts]))
                runs[start:] = [joined._replace(weight=weight)]
        if len(runs) > 1 and runs[-2].size == runs[-1].size and not is_full:
            runs[-1] = runs[-1]._replace(place=runs[-2].place + 1)

    def _joining(self, most: int) -> tuple[int, bool]:
        """From which run on, of a class of at most ``most``, all go into one with the last; and
        whether more of them would be too much for one."""
        runs = self._runs
        start = len(runs) - 1
        rows = len(runs[start].batch)
        while start and runs[start - 1].size <= most:
            rows += len(runs[start - 1].batch)
            if rows > self._longest:
                break
            start -= 1
        heaviest = self._heaviest
        # The bound by the longest text mostly suffices, and needs no pass over the rows.
        if heaviest is not None and not self._fits(rows, heaviest):
            weight = self._weigh(len(runs) - 1)
            for i in reversed(range(start, len(runs) - 1)):
                weight += self._weigh(i)
                if weight > heaviest:
                    return i + 1, True
        return start, rows > self._longest

    @property
    def _longest(self) -> int:
        """No run of more samples is made here."""
        return max(_FAN, self._retention.samples // 8)

    @property
    def _heaviest(self) -> int | None:
        """No run of more bytes is made here; None: of any."""
        most = self._retention.bytes
        return None if most is None else most // 8

    def _weigh(self, place: int) -> int:
        """Bytes of all samples of a run. Cost: O(rows), once for each run."""
        run = self._runs[place]
        if run.weight is None:
            run = self._runs[place] = run._replace(weight=int(run.batch.sizes().sum()))
        assert run.weight is not None
        return run.weight

    def _fits(self, count: int, limit: int) -> bool:
        """Whether ``count`` samples have at most ``limit`` bytes even if each of their texts is the
        longest there is. Cost: O(fields)."""
        most = TIMES_SIZE
        for field in self.schema.fields:
            pool = self.pools.get(field.name)
            most += field.type.size if pool is None else pool.longest
        return count * most <= limit

    def _within(self, limit: int) -> int:
        """The least number from which on the samples have at most ``limit`` bytes. Cost: O(runs),
        and O(rows) once for each run."""
        for i in reversed(range(len(self._runs))):
            weight = self._weigh(i)
            if weight > limit:
                run = self._runs[i]
                fitting = int(self._sums(run).searchsorted(limit, "right"))
                return run.first + len(run.batch) - fitting
            limit -= weight
        return self._first

    def _sums(self, run: _Run) -> NDArray[np.int64]:
        """Bytes of the last samples of a run: of one, of two … Cached for the last run."""
        known, rows = self._last_sums, len(run.batch)
        # Batches never change, so the first number and the length identify a run.
        if known is None or known[:2] != (run.first, rows):
            known = self._last_sums = run.first, rows, np.cumsum(run.batch.sizes()[::-1])
        return known[2]

    def _keep(self, retention: Retention) -> None:
        """Apply ``retention`` from now on."""
        self._retention = retention
        if self._runs:
            self._drop(self._next - 1)
            # The rest of this run may stay for long.
            self._cut()

    def _drop(self, newest: int) -> None:
        """Forget what the retention does not ask for, up to the batch that begins at ``newest``."""
        kept, last = self._retention, self._last_available
        first = max(self._first, self._next - kept.samples)
        if kept.age is not None and last is not None:
            first = max(first, self._number(last - kept.age, "left"))
        most = kept.bytes
        if most is not None and first < newest and not self._fits(self._next - first, most):
            first = max(first, self._within(most))
        # The newest batch stays whole, even if it alone exceeds the retention.
        self._first = first = min(first, newest)
        gone = 0
        while gone + 1 < len(self._runs) and self._runs[gone + 1].first <= first:
            gone += 1
        if gone:
            for run in self._runs[:gone]:
                self._gone_valid = _span(self._gone_valid, run.low, run.high)
                self._gone_available = run.end
            del self._runs[:gone]
        oldest = self._runs[0]
        # A small run soon goes as a whole; a large one would keep forgotten samples for long.
        if 2 * (first - oldest.first) >= len(oldest.batch) and self._is_oldest_large():
            self._cut()

    def _is_oldest_large(self) -> bool:
        """Whether the oldest run is larger than those that are made here: it came so."""
        rows, heaviest = len(self._runs[0].batch), self._heaviest
        if rows > self._longest or heaviest is None:
            return rows > self._longest
        return not self._fits(rows, heaviest) and self._weigh(0) > heaviest

    def _cut(self) -> None:
        """Leave of the oldest run what is kept."""
        oldest = self._runs[0]
        if gone := self._first - oldest.first:
            # After the cut the times of these samples cannot be read any more.
            self._gone_valid = self.forgotten_valid
            self._gone_available = int(oldest.batch.available[gone - 1])
            # Indices, not a slice: a view would keep the whole run in memory.
            kept = oldest.batch.take(np.arange(gone, len(oldest.batch)))
            self._runs[0] = _run(self._first, kept)._replace(place=oldest.place)


def _span(known: tuple[int, int] | None, low: int, high: int) -> tuple[int, int]:
    return (low, high) if known is None else (min(known[0], low), max(known[1], high))


def _run(first: int, batch: SampleBatch) -> _Run:
    """A run of one batch; for a single sample, much cheaper than reductions over columns."""
    count = len(batch)
    begin = int(batch.available[0])
    if count == 1:
        valid = int(batch.valid[0])
        return _Run(first, batch, begin, begin, valid, valid, 0)
    return _Run(
        first,
        batch,
        begin,
        int(batch.available[-1]),
        int(batch.valid.min()),
        int(batch.valid.max()),
        (count.bit_length() - 1) // (_FAN.bit_length() - 1),
    )
