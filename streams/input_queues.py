"""The inputs of a process with several: samples that wait, and the time up to which all is known.

Each input brings batches in order of available time, watermarks and the end. After a batch all is
known up to before its last available time, at which more may come; after a watermark ``w`` up to
``w - 1``; after the end for ever. `Join` and `Synchronization` proceed to the least of these times.
So their results do not depend on how pushes to different inputs interleave.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from .sample import SampleBatch
from .time import TIME_MAX, TIME_MIN

NOTHING_KNOWN = TIME_MIN - 1
"""Known up to before every time."""


class Input:
    """One input: samples that came and wait until the other inputs have got as far.

    All is known up to ``known``. The end leaves it as it was, and ``ended_at`` is the first moment
    after it. A push after the end continues the input. Cost: O(1) a push; `take`
    O(batches taken). Memory: what waits.
    """

    __slots__ = ("_last", "_waiting", "begun", "ended_at", "known", "like")

    def __init__(self) -> None:
        self.begun = False
        self.known = NOTHING_KNOWN
        self.ended_at: int | None = None
        self.like: SampleBatch | None = None
        self._last = NOTHING_KNOWN
        self._waiting: deque[SampleBatch] = deque()

    @property
    def waiting(self) -> int:
        """How many samples wait."""
        return sum(len(batch) for batch in self._waiting)

    def push(self, batch: SampleBatch, after: int = NOTHING_KNOWN) -> None:
        """Take the next samples. An empty batch only brings the fields.

        Raises `ValueError`, and takes nothing, where a sample is available at or before what is
        known of this input or at or before ``after``, up to which the process has given its output.
        """
        if self.like is None:
            # Indices, not a slice: a view would keep the first batch in memory for ever.
            self.like = batch.take(np.arange(0))
        if not len(batch):
            return
        first = int(batch.available[0])
        if first <= self.known or first <= after:
            raise ValueError(
                f"a sample available at {first} comes after what was known up to "
                f"{max(self.known, after)}: available times of an input do not decrease (Def. 4.1)"
            )
        self._waiting.append(batch)
        self.begun = True
        self._last = int(batch.available[-1])
        self.known = max(self.known, self._last - 1)
        self.ended_at = None

    def advance(self, watermark: int) -> None:
        """Every later sample has an available time ≥ ``watermark``."""
        self.begun = True
        if self.ended_at is None:
            self.known = max(self.known, watermark - 1)

    def resume(self) -> None:
        """Continue after the end: other inputs wait for it again."""
        self.ended_at = None

    def end(self) -> None:
        """No sample follows, unless a later push continues the input."""
        self.begun = True
        if self.ended_at is None:
            self.known = max(self.known, self._last)
            self.ended_at = self.known + 1

    def take(self, known: int) -> list[SampleBatch]:
        """Remove and return the waiting samples available by ``known``, in order."""
        waiting = self._waiting
        taken: list[SampleBatch] = []
        while waiting:
            batch = waiting[0]
            if int(batch.available[-1]) <= known:
                taken.append(waiting.popleft())
                continue
            if int(batch.available[0]) <= known:
                cut = int(np.searchsorted(batch.available, known, "right"))
                taken.append(batch.take(slice(0, cut)))
                waiting[0] = batch.take(slice(cut, None))
            break
        return taken

    def empty(self) -> SampleBatch:
        """An empty batch with the input's fields, if a batch has brought them."""
        if self.like is None:
            none = np.empty(0, np.int64)
            return SampleBatch(none, none, {})
        return self.like


def known_of(inputs: Sequence[Input]) -> int | None:
    """Up to when all inputs are known; None before all have begun, TIME_MAX when all have ended."""
    least = TIME_MAX
    for input in inputs:
        if not input.begun:
            return None
        if input.ended_at is None and input.known < least:
            least = input.known
    return least
