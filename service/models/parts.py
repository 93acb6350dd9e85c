"""Types that several models share: names, durations, strategies, and helpers for OpenAPI."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints

from ...matching.strategy import Kind
from ...streams.sample import LONGEST_NAME
from ...streams.time import format_duration, format_time, parse_duration


class Body(BaseModel):
    """A request body. An unknown member is an error, since it is mostly a misspelt one."""

    model_config = ConfigDict(extra="forbid")


def _duration(value: object) -> object:
    return parse_duration(value) if isinstance(value, str) else value


Duration = Annotated[
    int,
    BeforeValidator(_duration),
    Field(
        ge=0,
        lt=2**63,
        description="a text such as 5s, 100ms, PT5S, or an integer in nanoseconds",
        json_schema_extra={"type": ["integer", "string"]},
        examples=["5s"],
    ),
]
MOST_ARGUMENTS = 16
"""Arguments of one feature: each may stand for parts of it, and matching tries all combinations."""
Name = Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_NAME)]
Quality = Annotated[
    float, Field(ge=0, le=1, allow_inf_nan=False, description="the quality, 0 to 1")
]
BEGINNING = (
    "where the result begins. now: with the next samples; start: with the whole histories; a time, "
    "ISO-8601 or integer nanoseconds; a duration such as 30s before the newest sample of all "
    "streams that are read. 410: a stream no longer has all samples since then"
)
Since = Annotated[str, Field(max_length=64, description=BEGINNING, examples=["start", "30s"])]
"""The engine checks it."""
Strategy = Annotated[
    str,
    Field(
        max_length=200,
        description="the strategy: fast, cost, cost:subscribers=0.1, quality, "
        "weighted:cost=1,quality=10",
        json_schema_extra={"pattern": f"^({'|'.join(Kind)})(:.*)?$"},
        examples=["fast"],
    ),
]
"""The engine checks it, and lists the strategies in its error."""


def schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """Return the OpenAPI schema of a body that a route parses; `app` adds the model."""
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def text_schema(description: str, example: str) -> dict[str, Any]:
    """Return the OpenAPI schema of a body that is plain text."""
    return {"schema": {"type": "string", "description": description}, "example": example}


def iso(time: int | None) -> str | None:
    """Format a time (ns) as ISO-8601."""
    return None if time is None else format_time(time)


def signed(duration: int) -> str:
    """Format a duration (ns) that may be negative."""
    return format_duration(duration) if duration >= 0 else f"-{format_duration(-duration)}"
