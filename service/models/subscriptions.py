"""Subscriptions to streams and to features, as JSON."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from ...engine import views
from .parts import Body, Name


class SubscriptionIn(Body):
    """A stream, and what it is to be like."""

    stream: Name
    policy: str = Field(
        "",
        max_length=2000,
        description="constraints as after `with` in KPL; empty: the stream as it is",
        examples=["sample every 1s, max delay 200"],
    )
    unit: Literal["ns", "us", "ms", "s"] = "ms"
    """What integers of the policy are."""
    since: views.Since = views.Since.NOW
    """``start`` begins with the kept history of the stream."""


class SubscriptionModel(BaseModel):
    """A subscription; its samples come on ``stream``, and as events at ``events``."""

    id: str
    source: str
    policy: str = Field(description="as KPL, integers in ms")
    since: views.Since
    stream: str
    counters: dict[str, Any] = Field(description="what became of the samples under the policy")
    violations: str | None = Field(description="the stream of samples that were not passed on")
    events: str

    @classmethod
    def of(cls, view: views.SubscriptionView) -> SubscriptionModel:
        return cls(
            id=view.id,
            source=view.source,
            policy=view.policy,
            since=views.Since(view.since),
            stream=view.stream,
            counters=dict(view.counters),
            violations=view.violations,
            events=f"/subscriptions/{view.id}/events",
        )
