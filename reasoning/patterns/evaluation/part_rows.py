"""Evaluations of rows that fall into parts, each with its own time (SPEC §8).

Requests for one object each share an evaluation so: a part has the rows of one of them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ....streams.sample import Times
from ....streams.time import TIME_MAX, TIME_MIN
from ..plans.rows import Matches
from .all_rows import AllRows
from .evaluator import Evaluator
from .store import DECISIONS, WATERMARKS

Integers = NDArray[np.int64]


class InParts(Evaluator):
    """An evaluation of a plan whose rows fall into parts, each with its own time.

    A subclass has an argument ``part``: the column of keys that numbers the part of a row.
    Contract: all elements and probes of the plan have it equal.

    Law (tests/laws/reasoning/patterns/test_pattern_parts.py): the matches of a part are those of an
    evaluation of its own over its rows and watermarks, in the same order. The limits are those of
    all parts together, except of those for one row or key.

    Cost: as without parts, and O(matches that wait) a batch. Memory: 16 bytes for each part.
    """

    def make_room_for(self, parts: int) -> None:
        """Take rows of parts below ``parts`` from now on."""
        times = self._store.times
        more = parts - times.shape[1]
        if more > 0:
            more = max(more, times.shape[1])
            new = np.full((2, more), TIME_MIN, np.int64)
            self._store.times = np.concatenate([times, new], axis=1)

    def advance_parts(self, watermarks: Times) -> Matches:
        """Promise that no row of part p ends before ``watermarks[p]`` any more; return what that
        decides."""
        own = self._store.times[WATERMARKS, : len(watermarks)]
        np.maximum(own, watermarks, out=own)
        return self._decided()

    def advance(self, watermark: int) -> Matches:
        """Promise the same of all parts."""
        return self.advance_parts(np.full(self._store.times.shape[1], watermark, np.int64))

    def drop_part(self, part: int) -> None:
        """Forget the rows and matches of a part. Contract: no row of it comes any more."""
        store, waiting = self._store, self._waiting
        store.times[WATERMARKS, part] = TIME_MAX
        waiting.take_where(store.table[waiting.rows[:, 0], store.part_word] == part)

    def watermark_of(self, part: int) -> int:
        """The time (ns) before which no row of a part comes any more."""
        return int(self._store.times[WATERMARKS, part])

    def pending_of(self, part: int) -> int:
        """The number of matches of a part that wait."""
        parts = self._store.table[self._waiting.rows[:, 0], self._store.part_word]
        return int(np.count_nonzero(parts == part))

    def _pass_time(self) -> bool:
        times = self._store.times
        times[DECISIONS] = times[WATERMARKS]
        return len(self._waiting) > 0

    def _take_due(self) -> tuple[Integers, Integers]:
        store, waiting = self._store, self._waiting
        parts = store.table[waiting.rows[:, 0], store.part_word]
        return waiting.take_where(waiting.dues <= store.times[WATERMARKS, parts])


class PartRows(InParts, AllRows):
    """The same of each part; see `InParts`."""
