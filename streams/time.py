"""Time points and durations: signed 64-bit nanoseconds since the Unix epoch (SPEC §1).

Every room counts in these integers; text appears only at the edges, and here is the one place
that converts. Intervals of policies are closed, windows are half-open ``(t - RANGE, t]``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from datetime import UTC, datetime

Clock = Callable[[], int]
"""Anything that tells the time now, in ns. Only the service owns a real one; tests move theirs."""

NANOSECOND = 1
MICROSECOND = 1_000
MILLISECOND = 1_000_000
SECOND = 1_000_000_000
MINUTE = 60 * SECOND
HOUR = 60 * MINUTE
DAY = 24 * HOUR

TIME_MIN = -(2**63)
TIME_MAX = 2**63 - 1
FOREVER = TIME_MAX
"""A duration without end: `oo`."""

_UNITS = {
    "ns": NANOSECOND,
    "us": MICROSECOND,
    "ms": MILLISECOND,
    "s": SECOND,
    "m": MINUTE,
    "min": MINUTE,
    "h": HOUR,
    "d": DAY,
}
_DURATION = re.compile(r"\s*(\d+)(?:\.(\d+))?\s*(ns|us|ms|s|min|m|h|d)\s*\Z")
_ISO_DURATION = re.compile(
    r"\s*P(?:(\d+)D)?(?:T(?:(\d+)H)?(?:(\d+)M)?(?:(\d+)(?:\.(\d{1,9}))?S)?)?\s*\Z"
)
_ISO_TIME = re.compile(
    r"\s*(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d(?::\d\d)?)(?:[.,](\d{1,9})(\d*))?"
    r"\s*(Z|z|[+-]([01]\d|2[0-3]):?[0-5]\d)?\s*\Z",
    re.ASCII,
)
_MOST_DIGITS = 25
"""More digits than any number of nanoseconds has, even with zeros and a sign before it."""
_INTEGER = re.compile(r"\s*[+-]?\d+\s*\Z", re.ASCII)
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def parse_time(value: str | int, *, cut: bool = False) -> int:
    """A time point in ns from an ISO-8601 text (UTC when no offset is given) or an integer in ns.

    Raises ``ValueError`` with the reason when the text is no time, outside 64 bits, or finer than a
    nanosecond; with ``cut`` the latter is the nanosecond that it lies in.
    """
    if isinstance(value, bool):
        raise ValueError("a time is an ISO-8601 text or an integer in nanoseconds, not a boolean")
    if isinstance(value, int):
        return _within(value)
    match = _ISO_TIME.match(value)
    if match is None:
        raise ValueError(
            f"{_shown(value)} is no time: write ISO-8601 such as 2021-10-07T19:12:53.5Z, "
            "or an integer in nanoseconds since 1970"
        )
    day, clock, fraction, finer, offset, _ = match.groups()
    if finer and finer.strip("0") and not cut:
        raise ValueError(
            f"{_shown(value)} is finer than a nanosecond: a second has at most nine digits"
        )
    zone = "+00:00" if offset in (None, "Z", "z") else offset
    try:
        moment = datetime.fromisoformat(f"{day}T{clock}{zone}")
    except ValueError as error:  # such as: month must be in 1..12
        raise ValueError(f"{_shown(value)} is no time: {error}") from None
    since = moment - _EPOCH
    seconds = since.days * 86_400 + since.seconds
    return _within(seconds * SECOND + int((fraction or "0").ljust(9, "0")))


def read_time(text: str) -> int:
    """`parse_time` of a text that people write, where an integer (ns) is a text too."""
    if len(text) > _MOST_DIGITS and _INTEGER.match(text):
        raise ValueError(f"{_shown(text.strip())} {_OUTSIDE}")
    return parse_time(int(text) if _INTEGER.match(text) else text)


def format_time(time: int) -> str:
    """ISO-8601 in UTC with just the digits needed: ``2021-10-07T19:12:53.5Z``.

    The inverse of `parse_time` for every time from year 1678 to 2262, which is all of 64 bits.
    """
    seconds, fraction = divmod(time, SECOND)
    days, rest = divmod(seconds, 86_400)
    moment = datetime.fromordinal(_EPOCH.toordinal() + days)
    text = (
        f"{moment.year:04d}-{moment.month:02d}-{moment.day:02d}"
        f"T{rest // 3600:02d}:{rest // 60 % 60:02d}:{rest % 60:02d}"
    )
    digits = f"{fraction:09d}".rstrip("0")
    return f"{text}.{digits}Z" if digits else f"{text}Z"


def parse_iso_duration(text: str) -> int:
    """A duration in ns from ISO-8601 ``PT5S`` alone, as an ``xsd:duration`` is written; raises as
    `parse_duration` does."""
    if not text.upper().startswith("P"):
        raise ValueError(f"{text!r} is no duration")
    return parse_duration(text.upper())


def parse_duration(text: str) -> int:
    """A duration in ns from ``5s``, ``100 ms``, ``1.5h`` or ISO-8601 ``PT5S``.

    Raises ``ValueError`` with the reason; finer than a nanosecond is an error, never rounded.
    """
    match = _DURATION.match(text)
    if match is not None:
        whole, fraction, unit = match.groups()
        scale = _UNITS[unit]
        total = int(whole) * scale
        if fraction:
            part, rest = divmod(int(fraction) * scale, 10 ** len(fraction))
            if rest:
                raise ValueError(f"{text!r} is finer than a nanosecond")
            total += part
        return _within(total)
    match = _ISO_DURATION.match(text)
    if match is None or not any(match.groups()):
        raise ValueError(f"{text!r} is no duration: write 5s, 100ms, 1h or PT5S")
    days, hours, minutes, seconds, fraction = match.groups()
    total = int(days or 0) * DAY + int(hours or 0) * HOUR + int(minutes or 0) * MINUTE
    total += int(seconds or 0) * SECOND + int((fraction or "0").ljust(9, "0"))
    return _within(total)


def format_duration(duration: int) -> str:
    """The shortest of ``5s``, ``100ms``, ``2h`` … that is exact. Inverse of `parse_duration`."""
    for unit in ("d", "h", "m", "s", "ms", "us"):
        if duration and duration % _UNITS[unit] == 0:
            return f"{duration // _UNITS[unit]}{unit}"
    return f"{duration}ns"


_OUTSIDE = "is outside signed 64-bit nanoseconds (years 1678 to 2262)"


def _within(time: int) -> int:
    if not TIME_MIN <= time <= TIME_MAX:
        # Python writes no number of thousands of digits.
        raise ValueError(f"{time if time.bit_length() < 100 else 'the number'} {_OUTSIDE}")
    return time


def _shown(text: str) -> str:
    return repr(text if len(text) <= 80 else f"{text[:80]}…")
