"""Times in query parameters: ISO-8601, or integer nanoseconds since 1970."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query

from ...streams.time import read_time
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
