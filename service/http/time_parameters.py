"""Times in query parameters: ISO-8601, or integer nanoseconds since 1970; and durations: ``5s``."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query

from ...streams.time import format_duration, parse_duration, read_time
from .problems import Problem

Time = Annotated[str | None, Query(description="ISO-8601 or integer nanoseconds")]


def time_of(text: str | None, key: str) -> int | None:
    """The time (ns) in parameter ``key``. Raises a 400 `Problem` for a text that is no time."""
    if text is None:
        return None
    try:
        return read_time(text)
    except ValueError as error:
        raise Problem(
            400,
            "bad time",
            f"{key}: {error}",
            hint="in addresses + is %2B; times are from year 1678 to 2262",
        ) from error


def duration_of(text: str | None, key: str, least: int, most: int) -> int | None:
    """The duration (ns) in parameter ``key``. Raises a 400 `Problem` for a text that is none, or
    for one outside these bounds."""
    if text is None:
        return None
    hint = f"send one from {format_duration(least)} to {format_duration(most)}, such as 10s"
    try:
        duration = parse_duration(text)
    except ValueError as error:
        raise Problem(400, "bad duration", f"{key}: {error}", hint=hint) from error
    if not least <= duration <= most:
        detail = f"{key}: {text.strip()} is too {'short' if duration < least else 'long'}"
        raise Problem(400, "bad duration", detail, hint=hint)
    return duration
