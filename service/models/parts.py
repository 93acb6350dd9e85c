"""What several models share: names, durations, strategies, and how they are told."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints

from ...matching.strategy import Kind
from ...streams.sample import LONGEST_NAME
from ...streams.time import format_duration, format_time, parse_duration


class Body(BaseModel):
    """What a client sends: a member that is not known is refused."""

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
"""Of one feature: each of them may stand for parts of it, and all combinations are looked at."""
Name = Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_NAME)]
Quality = Annotated[
    float, Field(ge=0, le=1, allow_inf_nan=False, description="how good it is, 0 to 1")
]
BEGINNING = (
    "where the answer begins: now, with what comes; start, with all that the streams keep; a time, "
    "ISO-8601 or integer nanoseconds, or a duration such as 30s before the newest sample of all "
    "streams that are read, with what was available then or later: 410 where some is forgotten"
)
Since = Annotated[str, Field(max_length=64, description=BEGINNING, examples=["start", "30s"])]
"""Checked by the engine."""
Strategy = Annotated[
    str,
    Field(
        max_length=200,
        description="how a plan is chosen: fast, cost, cost:subscribers=0.1, quality, "
        "weighted:cost=1,quality=10",
        json_schema_extra={"pattern": f"^({'|'.join(Kind)})(:.*)?$"},
        examples=["fast"],
    ),
]
"""Checked by the engine, which names the strategies there are."""


def schema_of(model: type[BaseModel]) -> dict[str, Any]:
    """What OpenAPI says of a body that a route reads itself; `app` adds the model."""
    return {"$ref": f"#/components/schemas/{model.__name__}"}


def text_schema(description: str, example: str) -> dict[str, Any]:
    """What OpenAPI says of a body that is plain text."""
    return {"schema": {"type": "string", "description": description}, "example": example}


def iso(time: int | None) -> str | None:
    """A time (ns) as ISO-8601."""
    return None if time is None else format_time(time)


def signed(duration: int) -> str:
    """A duration (ns) that may be less than nothing, as text."""
    return format_duration(duration) if duration >= 0 else f"-{format_duration(-duration)}"
