"""A recording as a stream that comes again: cut by time, moved in time, due at its pace.

No clock and no sleep: `play` says when each part is due, the caller waits. Used by the command
line and the demonstration.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from ....converters.recordings.many_streams import in_order
from ....converters.recordings.recording import Recording
from ....converters.wire import Incoming
from ....streams.sample import SampleBatch
from ....streams.time import MILLISECOND, SECOND, TIME_MAX
from ....streams.time_arithmetic import earlier, later

ROWS = 5_000
"""A part has at most so many samples: a few hundred kB on the wire."""
FLUSH = 100 * MILLISECOND
"""At a pace, samples of one tenth of a second of waiting go out together."""
PAUSE = 31 * SECOND
"""Between two rounds of a recording: longer than the default ``max_gap`` of coordinatesToSpeed.
Objects jump from where the recording ends to where it begins; no speed spans the jump."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Samples that go out together ``due`` ns after the recording's begin (0 at full speed)."""

    due: int
    batch: SampleBatch


@dataclass(frozen=True, slots=True)
class Span:
    """First and last available time of a recording, in ns."""

    first: int
    last: int

    @property
    def period(self) -> int:
        """After this time the recording may begin again, a `PAUSE` after its last sample."""
        return self.last - self.first + PAUSE


def span(recording: Iterable[Incoming], latest: int = TIME_MAX) -> Span | None:
    """When the recording begins and ends, but for samples stamped after ``latest``; None if there
    are no others. Reads it once."""
    first = last = None
    for incoming in recording:
        times = incoming.batch.available
        times = times[times <= latest]
        if not len(times):
            continue
        low, high = int(times.min()), int(times.max())
        first = low if first is None else min(first, low)
        last = high if last is None else max(last, high)
    return None if first is None or last is None else Span(first, last)


def play(
    recording: Iterable[Incoming], begin: int, *, speed: float | None = None, shift: int = 0
) -> Iterator[Part]:
    """The recording in parts, in its own order.

    ``begin`` is its first available time, ``speed`` how many times faster than recorded (None: as
    fast as it is taken), ``shift`` (ns) is added to all its times. A part is due when its last
    sample is.
    """
    for incoming in recording:
        batch = moved(incoming.batch, shift)
        since = incoming.batch.available - begin
        for start, end in _cuts(since, speed):
            part = batch.take(slice(start, end))
            due = 0 if speed is None else int(since[start:end].max() / speed)
            yield Part(max(0, due), part)


def play_all(
    recordings: Mapping[str, Recording],
    begin: int,
    *,
    speed: float | None = None,
    shift: int = 0,
) -> Iterator[tuple[str, Part]]:
    """Recordings of several streams in parts, in order of time; one as `play` gives it.

    Arguments as for `play`; ``begin`` is the first available time of them all.
    """
    if len(recordings) == 1:
        name, recording = next(iter(recordings.items()))
        yield from ((name, part) for part in play(recording, begin, speed=speed, shift=shift))
        return
    step = 10 * SECOND if speed is None else max(1, int(FLUSH * min(speed, 100.0)))
    for name, incoming in in_order(recordings, step):
        for part in play([incoming], begin, speed=speed, shift=shift):
            yield name, part


def moved(batch: SampleBatch, shift: int) -> SampleBatch:
    """The same samples ``shift`` ns later, as far as time goes."""
    if shift == 0:
        return batch
    move = later if shift > 0 else earlier
    available, valid = (move(times, abs(shift)) for times in (batch.available, batch.valid))
    return SampleBatch(available, valid, batch.columns)


def _cuts(
    since: np.ndarray[tuple[int], np.dtype[np.int64]], speed: float | None
) -> list[tuple[int, int]]:
    """Where to cut: by rows, and by the tenths of a second in which samples are due."""
    edges = set(range(0, len(since), ROWS)) | {len(since)}
    if speed is not None:
        slots = np.floor(since / (FLUSH * speed)).astype(np.int64)
        edges |= set((np.flatnonzero(np.diff(slots)) + 1).tolist())
    ordered = sorted(edges)
    return list(itertools.pairwise(ordered))
