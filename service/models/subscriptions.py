"""Subscriptions to streams and to features, as JSON."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from ...engine.durability.accepted_commands import WaitingCommand
from ...engine.durability.commands import Subscribe, SubscribeToFeature
from ...engine.model import views
from ...engine.requests.adaptive_subscription import Rematch
from ...streams.time import SECOND, format_duration, format_time
from .parts import MOST_ARGUMENTS, Body, Duration, Name, Quality, Since, Strategy


class SubscriptionIn(Body):
    """What is subscribed to, a ``stream`` or a ``feature``, and what it is to be like."""

    stream: Name | None = Field(None, description="a stream, and no feature")
    feature: Name | None = Field(None, description="a feature, whatever streams hold it")
    sort: Name | None = Field(None, description="the feature of every object of the sort")
    objects: list[Name] = Field(
        default_factory=list,
        max_length=MOST_ARGUMENTS,
        description="the feature of this object; of an n-ary feature its arguments",
    )
    strategy: Strategy = "fast"
    policy: str = Field(
        "",
        max_length=2000,
        description="constraints as after `with` in KPL; empty: the stream as it is",
        examples=["sample every 1s, max delay 200"],
    )
    unit: Literal["ns", "us", "ms", "s"] = "ms"
    """What integers of the policy are."""
    since: Since = "now"
    staleness: Duration | None = Field(
        None, description="so long a source may be silent; null: five times its usual gap"
    )
    min_quality: Quality = Field(0.0, description="the least quality that is good enough")
    hold_off: Duration = Field(
        2 * SECOND, description="so long a better source must have been there"
    )


class AdaptiveModel(BaseModel):
    """What a subscription to a feature is to, and how it is."""

    want: str
    strategy: str
    state: str = Field(
        description="running; stale: what it reads is silent, and there is nothing else; "
        "waiting: nothing gives what is wanted"
    )
    failure: str | None
    reads: list[str] = Field(description="the streams and sources behind it")
    missing: list[str] = Field(description="of one that waits: what would have to be there")
    staleness: str | None
    min_quality: float
    hold_off: str
    rematches: int = Field(description="how many switches are kept")

    @classmethod
    def of(cls, view: views.AdaptiveView) -> AdaptiveModel:
        return cls(
            want=view.want,
            strategy=view.strategy,
            state=view.state,
            failure=view.failure,
            reads=list(view.reads),
            missing=list(view.missing),
            staleness=None if view.staleness is None else format_duration(view.staleness),
            min_quality=view.quality,
            hold_off=format_duration(view.hold_off),
            rematches=view.rematches,
        )


class RematchModel(BaseModel):
    """A switch of a subscription to a feature, after sample ``position`` of its stream."""

    time: str
    position: int
    why: str
    before: list[str] = Field(description="the streams and sources that it read")
    after: list[str] = Field(description="and those that it reads from then on")
    lost: bool = Field(
        description="the new source had forgotten some of what followed the last sample"
    )

    @classmethod
    def of(cls, switch: Rematch) -> RematchModel:
        return cls(
            time=format_time(switch.time),
            position=switch.position,
            why=switch.why,
            before=list(switch.before),
            after=list(switch.after),
            lost=switch.lost,
        )


class SubscriptionModel(BaseModel):
    """A subscription; its samples come on ``stream``, and as events at ``events``. One that waits
    has no stream."""

    id: str
    source: str = Field(description="the stream; of one to a feature that waits, the feature")
    policy: str = Field(description="as KPL, integers in ms; of one that waits as it was written")
    since: str = Field(description="as asked for; a duration as the time that it means")
    state: Literal["running", "failed", "waiting"] = Field(
        description="failed: what feeds it was cut off, and nothing more comes; waiting: an "
        "earlier run has accepted it, and this one cannot start it"
    )
    failure: str | None = Field(description="why it has failed or waits")
    stream: str | None
    counters: dict[str, Any] = Field(description="what became of the samples under the policy")
    violations: str | None = Field(description="the stream of samples that were not passed on")
    events: str | None
    adaptive: AdaptiveModel | None = Field(description="of a subscription to a feature")

    @classmethod
    def waiting(cls, waiting: WaitingCommand) -> SubscriptionModel:
        """One that waits, as it was asked for."""
        command = waiting.command
        assert isinstance(command, Subscribe | SubscribeToFeature)
        return cls(
            id=waiting.key.name,
            source=command.stream if isinstance(command, Subscribe) else command.feature,
            policy=command.policy,
            since=command.since,
            state="waiting",
            failure=waiting.reason,
            stream=None,
            counters={},
            violations=None,
            events=None,
            adaptive=None,
        )

    @classmethod
    def of(cls, view: views.SubscriptionView) -> SubscriptionModel:
        return cls(
            id=view.id,
            source=view.source,
            policy=view.policy,
            since=view.since,
            state="running" if view.failure is None else "failed",
            failure=view.failure,
            stream=view.stream,
            counters=dict(view.counters),
            violations=view.violations,
            events=f"/subscriptions/{view.id}/events",
            adaptive=None if view.adaptive is None else AdaptiveModel.of(view.adaptive),
        )
