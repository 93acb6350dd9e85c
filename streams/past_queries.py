"""Questions about a stream's past that retention may have made unanswerable
([DyKnow10 Def. 5.5-5.7], SPEC §1).

Each function returns the answer of the definition over all samples that the stream ever had, or
raises `Forgotten` where the answer depends on forgotten samples. Called by
service/routes/samples; tests/laws/streams/test_past_queries.py compares with the definitions.
"""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass

from .history import FluentStream
from .sample import SampleBatch
from .time import (
    TIME_MAX,
    TIME_MIN,
    format_duration,
    format_time,
    parse_duration,
    read_time,
)


@dataclass(frozen=True, slots=True)
class Moment:
    """Where a part of a stream's past begins: at a ``time`` (ns), or so long ``before`` (ns) its
    newest sample; included."""

    time: int = TIME_MIN
    before: int | None = None

    @classmethod
    def parse(cls, text: str) -> Moment | None:
        """A time as `read_time` has it, or a duration such as ``30s``; None for neither."""
        with suppress(ValueError):
            return cls(before=parse_duration(text))
        with suppress(ValueError):
            return cls(read_time(text))
        return None

    def __str__(self) -> str:
        return format_time(self.time) if self.before is None else format_duration(self.before)

    def among(self, streams: Iterable[FluentStream]) -> Moment:
        """The same as a time: a duration counts from the newest sample of all ``streams``, whose
        past has their own time, as that of a recording is not the clock's."""
        if self.before is None:
            return self
        known = [stream.last_available for stream in streams]
        last = max((each for each in known if each is not None), default=TIME_MIN)
        return Moment(max(last - self.before, TIME_MIN))

    def check(self, stream: FluentStream) -> None:
        """Raises `Forgotten` if ``stream`` may have forgotten samples available from this time on.
        Contract: it is a time, see `among`."""
        check_reach(stream, self.time)


class Forgotten(LookupError):
    """The answer depends on samples that the stream no longer keeps.

    ``oldest`` is the available time (ns) of the oldest instant of which all samples are kept.
    """

    def __init__(self, stream: FluentStream) -> None:
        self.oldest = stream.first_available
        if self.oldest is not None and self.oldest < stream.complete_since:
            self.oldest = stream.available_from(stream.complete_since)
        since = "no sample" if self.oldest is None else f"samples since {format_time(self.oldest)}"
        super().__init__(f"the answer depends on forgotten samples: the stream keeps {since}")


def most_recent_at(stream: FluentStream, time: int, known: int = TIME_MAX) -> SampleBatch:
    """Def. 5.6: of the samples available by ``known`` the one with the greatest valid time up to
    ``time``; a batch of one, or empty for no_sample."""
    found = stream.most_recent_at(time, known)
    # A forgotten sample is the answer only if its valid time is later than that of the one found.
    least = TIME_MIN if not len(found) else int(found.valid[0]) + 1
    _need_valid(stream, least, time)
    return found


def before(
    stream: FluentStream, time: int, known: int = TIME_MAX, *, most: int | None = None
) -> SampleBatch:
    """Def. 5.6: the samples available by ``known`` that are valid at or before ``time``; at
    ``most`` the newest of them.

    Forgotten samples stand before all kept ones. So the answer depends on them only where fewer
    than ``most`` kept samples belong to it and one of the forgotten may be valid by ``time``.
    """
    found = stream.before(time, known)
    if most is None or len(found) < most:
        _need_valid(stream, TIME_MIN, time)
        return found
    return found.take(slice(len(found) - most, None))


def prev(stream: FluentStream, available: int) -> SampleBatch:
    """Def. 5.7: the last sample that was available before ``available``."""
    found = stream.prev(available)
    if not len(found) and stream.forgotten_valid is not None:
        raise Forgotten(stream)
    return found


def last_avail(stream: FluentStream, time: int) -> SampleBatch:
    """Def. 5.5: the last sample that was available by ``time``."""
    found = stream.last_avail(time)
    if not len(found) and stream.forgotten_valid is not None:
        raise Forgotten(stream)
    return found


def between(
    stream: FluentStream,
    start: int | None,
    end: int | None,
    valid_from: int | None = None,
    valid_to: int | None = None,
    *,
    most: int | None = None,
) -> SampleBatch:
    """The samples available from ``start`` to ``end`` and valid from ``valid_from`` to
    ``valid_to``, bounds included. None is unbounded: without ``start`` from the oldest sample kept.

    At ``most`` the newest of them; with ``start`` or ``valid_from`` the oldest.
    """
    newest = start is None and valid_from is None
    if start is not None or end is not None:
        check_reach(stream, TIME_MAX if start is None else start, end)
    if valid_from is None and valid_to is None:
        return stream.between(start, end, most=most, newest=newest)
    low = TIME_MIN if valid_from is None else valid_from
    high = TIME_MAX if valid_to is None else valid_to
    if start is None:
        _need_valid(stream, low, high)
    found = stream.between(start, end)
    found = found.take((found.valid >= low) & (found.valid <= high))
    return found if most is None else at_most(found, most, newest=newest)


def at_most(
    batch: SampleBatch, most: int, *, newest: bool, whole_instant: bool = False
) -> SampleBatch:
    """The ``newest`` samples of a batch; or the oldest, with ``whole_instant`` also the rest of
    their last instant."""
    if len(batch) <= most:
        return batch
    if newest:
        return batch.take(slice(len(batch) - most, None))
    if whole_instant:
        most = int(batch.available.searchsorted(batch.available[most - 1], "right"))
    return batch.take(slice(0, most))


def number_since(stream: FluentStream, since: Moment) -> int:
    """The number of the first sample available since then."""
    begin = since.among([stream])
    begin.check(stream)
    return stream.number_at(begin.time)


def check_reach(stream: FluentStream, start: int, end: int | None = None) -> None:
    """Raises `Forgotten` if the stream has forgotten samples available from ``start`` on, or all
    that were available by ``end``."""
    oldest = stream.first_available
    if stream.forgotten_valid is None or oldest is None:
        return
    if start < stream.complete_since or (end is not None and end < oldest):
        raise Forgotten(stream)


def _need_valid(stream: FluentStream, low: int, high: int) -> None:
    """Raises `Forgotten` if a forgotten sample may be valid from ``low`` to ``high``."""
    forgotten = stream.forgotten_valid
    if forgotten is not None and forgotten[0] <= high and forgotten[1] >= low:
        raise Forgotten(stream)
