"""Fluent streams: a stream as its samples with bounded history ([DyKnow10 Def. 5.4-5.8]).

`FluentStream` answers for current and historic values from sorted columns; `Definition` in
tests/laws is its slow twin, straight from the paper's set notation.
"""

from __future__ import annotations

from bisect import bisect_left
from typing import Final

import numpy as np

from .runs import FIRST, Runs
from .runs import Retention as Retention
from .runs import Segment as Segment
from .sample import FieldType, SampleBatch, Times, widened
from .sample import Schema as Schema
from .string_pool import Ghosts, StringPool
from .time import TIME_MAX, TIME_MIN

_TEXTS: Final = 4096
"""Texts of a field up to which a search for forgotten ones does not pay."""
_SHARE: Final = 2
"""Texts per kept sample up to which it does not pay, either."""
_CHARACTERS: Final = 4 << 20
"""Characters of texts above which a search pays, if they are more than `_SHARE` times those of the
last search."""
_AGAIN: Final = 0.5
"""Share of the texts of a field that came again after it had forgotten them, from which on it does
not pay to forget them."""
_TRIES: Final = 4
"""How often `find_places` searches again when pools changed meanwhile."""


class FluentStream(Runs):
    """Samples ordered by available time, those of one instant by sequence number; the last ones
    kept.

    Contract: `append` takes only what continues the order (`StreamGenerator` sees to that).
    Numbers of samples are ``first``, ``first + 1`` … over the life of the stream, gap-free.

    Cost: `last_avail`, `prev` and `since` O(log n + answer); `most_recent_at` O(runs + rows of the
    runs whose valid times straddle the one asked for); the others O(runs + answer).
    """

    def __init__(
        self,
        schema: Schema,
        retention: Retention | None = None,
        pools: dict[str, StringPool] | None = None,
        first: int = 1,
    ) -> None:
        super().__init__(schema, retention or Retention(), pools, first)
        self._looked_for: dict[str, int] = {}
        """Characters of the texts of a field after the last search for forgotten ones."""
        self._least: dict[str, int] = {}
        """Texts of a field up to which it forgets none, since they come again; `_TEXTS` else."""
        self._ghosts: dict[str, Ghosts] = {}

    @property
    def retention(self) -> Retention:
        """How much is kept. A smaller retention forgets samples at once."""
        return self._retention

    @retention.setter
    def retention(self, retention: Retention) -> None:
        # Texts that were worth keeping may not be so under another retention.
        self._looked_for.clear()
        self._least.clear()
        self._keep(retention)

    def go_on(self, batch: SampleBatch, first: int, complete_since: int | None = None) -> None:
        """Take over the history of another stream that kept ``batch``, whose first sample has
        number ``first``. Without ``complete_since`` (`complete_since`) the oldest instant counts as
        whole. Contract: this one is unused."""
        if first > self._first:
            # The valid times of samples before ``first`` are not known, so they may be any.
            self._gone_valid = TIME_MIN, TIME_MAX
            if complete_since is None and len(batch):
                complete_since = int(batch.available[0])
            self._gone_available = TIME_MIN if complete_since is None else complete_since - 1
        self._first = self._next = first
        self.append(batch)

    def widen(self, schema: Schema) -> None:
        """Give the stream the fields of ``schema``; samples kept so far have no_value in new ones.

        Contract: ``schema`` has every field of the stream. Cost: O(kept samples x new fields).
        """
        for field in schema.fields:
            if field.type is FieldType.STRING:
                self.pools.setdefault(field.name, StringPool())
        self.schema = schema
        # New fields change the bytes of each sample.
        self._last_sums = None
        for i, run in enumerate(self._runs):
            batch = widened(run.batch, schema, self.pools)
            self._runs[i] = run._replace(batch=batch, weight=None)

    def forget_texts(self, held: SampleBatch | None = None) -> SampleBatch | None:
        """Give text fields new pools without the texts that no kept sample has, if most are of that
        kind. ``held``: samples elsewhere with such texts; returns them in the codes of the pools.
        Contract: codes of this stream exist in batches only.

        Texts that come again stay: a reader pays some 4 µs for each text of a new pool, which is
        most of the work where many objects report in turn. A field then has up to twice as many
        texts as come again.

        Cost: O(1), and O(kept samples) once for as many new texts.
        """
        samples = len(self) + (0 if held is None else len(held))
        lost = {
            name: pool
            for name, pool in self.pools.items()
            if self._has_lost(name, pool, samples) and not self._come_again(name, pool)
        }
        if not lost:
            return held
        # Batches that others keep still read from the old pool, so it must not change.
        for name in lost:
            self.pools[name] = StringPool()
        for i, run in enumerate(self._runs):
            self._runs[i] = run._replace(batch=self.encoded(run.batch))
        held = None if held is None else self.encoded(held)
        for name, pool in lost.items():
            self._looked_for[name] = self.pools[name].characters
            self._ghosts.setdefault(name, Ghosts()).add(pool, self.pools[name])
        return held

    def _has_lost(self, name: str, pool: StringPool, samples: int) -> bool:
        """Whether most texts of a field may be gone, by their number or by what they take."""
        least = max(_TEXTS, self._least.get(name, _TEXTS))
        if len(pool) > least and len(pool) > _SHARE * samples:
            return True
        return pool.characters > max(_CHARACTERS, _SHARE * self._looked_for.get(name, 0))

    def _come_again(self, name: str, pool: StringPool) -> bool:
        """Whether most texts of a field had been forgotten before. Then it keeps twice as many."""
        ghosts = self._ghosts.get(name)
        if ghosts is None or ghosts.share(pool) < _AGAIN:
            self._least.pop(name, None)
            return False
        # Readers would read these texts again and again, so the field may have twice as many.
        self._least[name] = 2 * len(pool)
        self._looked_for[name] = pool.characters
        return True

    def encoded(self, batch: SampleBatch) -> SampleBatch:
        """``batch`` with its texts in the codes of this stream's pools. Cost: O(columns) where they
        are; else O(n log n), Python per distinct text."""
        columns = batch.columns
        if all(column.pool is self.pools.get(name) for name, column in columns.items()):
            return batch
        found = {
            name: column
            if column.pool is None
            # A field without a pool takes that of its first batch, whose codes stay as they are.
            else column.recoded(self.pools.setdefault(name, column.pool))
            for name, column in columns.items()
        }
        return SampleBatch(batch.available, batch.valid, found)

    def find_places(self, batch: SampleBatch) -> None:
        """Find the codes that the texts of ``batch`` have or will have in this stream, so that
        `encoded` is quick right after it.

        Contract: the pools of ``batch`` are its own, without other texts. May run in another thread
        than that of the stream: it changes nothing else (law: tests/laws/converters).
        """
        # Other batches may add texts meanwhile. After some tries `encoded` does the work itself.
        for _ in range(_TRIES):
            lacking = [
                (column.pool, self.pools[name])
                for name, column in batch.columns.items()
                if column.pool is not None
                and name in self.pools
                and not column.pool.has_place(self.pools[name])
            ]
            for own, pool in lacking:
                own.find_place(pool)
            if not lacking:
                return

    def number_at(self, time: int) -> int:
        """The number of the first kept sample available at ``time`` or later; that of the next
        sample where there is none. Cost: O(log n)."""
        return self._number(time, "left")

    def available_from(self, time: int) -> int:
        """The available time of the first kept sample at ``time`` or later, else ``time``."""
        number = self.number_at(time)
        return max(self._part(number, number + 1).available.tolist(), default=time)

    def all(self) -> SampleBatch:
        """The whole kept history as one batch."""
        return self._part(self._first, self._next)

    def avail(self, time: int) -> SampleBatch:
        """Def. 5.5 avail(f, t): the kept samples with available time ≤ ``time``."""
        return self._part(self._first, self._number(time, "right"))

    def last_avail(self, time: int) -> SampleBatch:
        """Def. 5.5 last_avail(f, t): a batch of one, or empty for no_sample. Of an instant the
        sample with the greatest number.
        """
        end = self._number(time, "right")
        return self._part(end - 1, end)

    def before(self, time: int, query_time: int) -> SampleBatch:
        """Def. 5.6 before(f, t, t_q): available by ``query_time``, valid at or before ``time``."""
        known = self.avail(query_time)
        return known.take(known.valid <= time)

    def most_recent_at(self, time: int, query_time: int) -> SampleBatch:
        """Def. 5.6 most_recent_at(f, t, t_q): a batch of one, or empty for no_sample.

        Of the samples known at ``query_time`` with the greatest valid time ≤ ``time``, the one
        that became available last.
        """
        found: int | None = None
        best = 0
        end = self._number(query_time, "right")
        if end == self._first:
            return self._part(0, 0)
        # From the newest to the oldest: of equal valid times the first one met is the answer.
        for run in reversed(self._runs[: bisect_left(self._runs, end, key=FIRST)]):
            if run.low > time or (found is not None and run.high <= best):
                continue
            # The oldest run may begin with samples that retention has forgotten.
            start = max(0, self._first - run.first)
            valid = run.batch.valid[start : end - run.first]
            if run.high > time:
                rows = np.flatnonzero(valid <= time)
                if not len(rows):
                    continue
                valid = valid[rows]
            else:
                rows = None
            greatest = int(valid.max())
            if found is None or greatest > best:
                row = int(np.flatnonzero(valid == greatest)[-1])
                found = run.first + start + (row if rows is None else int(rows[row]))
                best = greatest
                # No valid time can be greater, and older runs lose where valid times are equal.
                if best == time:
                    break
        return self._part(0, 0) if found is None else self._part(found, found + 1)

    def prev(self, available: int) -> SampleBatch:
        """Def. 5.7 prev(f, s): the last sample before those available at ``available``.

        A batch of one, or empty for no_sample.
        """
        end = self._number(available, "left")
        return self._part(end - 1, end)

    def availtimes(self) -> Times:
        """Def. 5.8 availtimes(f): the available times of the kept samples, each once,
        increasing.
        """
        times = [run.batch.available for run in self._runs]
        if not times:
            return np.empty(0, np.int64)
        times[0] = times[0][self._first - self._runs[0].first :]
        return np.unique(np.concatenate(times))

    def newest(self, count: int) -> SampleBatch:
        """The last ``count`` kept samples (all, if fewer are kept)."""
        return self._part(self._next - count, self._next)

    def between(
        self, start: int | None, end: int | None, *, most: int | None = None, newest: bool = False
    ) -> SampleBatch:
        """The kept samples with available time in the closed interval; None is unbounded. At
        ``most`` the ``newest`` of them; or the oldest and the rest of their last instant, so that
        the next piece begins after it."""
        first = self._first if start is None else self._number(start, "left")
        after = self._next if end is None else self._number(end, "right")
        if most is not None and newest:
            first = max(first, after - most)
        elif most is not None and after - first > most:
            (last,) = self._part(first + most - 1, first + most).available.tolist()
            after = self._number(last, "right")
        return self._part(first, after)

    def number_before(self, time: int) -> int:
        """The number of the last sample available before ``time``; of one before all that are kept,
        that of the one before these."""
        return self._number(time, "left") - 1


def join_availtimes(*streams: FluentStream) -> Times:
    """Def. 5.8 availtimes({f1 … fn}): the union of the available times, increasing."""
    if not streams:
        return np.empty(0, np.int64)
    return np.unique(np.concatenate([stream.availtimes() for stream in streams]))
