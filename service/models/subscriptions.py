"""JSON models of subscriptions to streams and to features."""

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
    """A subscription to a ``stream`` or to a ``feature``, with its policy and limits."""

    stream: Name | None = Field(None, description="a stream; excludes a feature")
    feature: Name | None = Field(None, description="a feature, of any streams that have it")
    sort: Name | None = Field(None, description="the feature of all objects of the sort")
    objects: list[Name] = Field(
        default_factory=list,
        max_length=MOST_ARGUMENTS,
        description="the feature of this object; for an n-ary feature its arguments in order",
    )
    strategy: Strategy = "fast"
    policy: str = Field(
        "",
        max_length=2000,
        description="constraints as after `with` in KPL; empty: the unchanged stream",
        examples=["sample every 1s, max delay 200"],
    )
    unit: Literal["ns", "us", "ms", "s"] = "ms"
    """The unit of the policy's integers."""
    since: Since = "now"
    staleness: Duration | None = Field(
        None, description="how long a source may be silent; null: five times its usual gap"
    )
    min_quality: Quality = Field(0.0, description="the least sufficient quality")
    hold_off: Duration = Field(
        2 * SECOND, description="how long a better source must exist before it is used"
    )


class AdaptiveModel(BaseModel):
    """The want and the state of a subscription to a feature."""

    want: str
    feature: str
    sort: str | None
    objects: list[str] = Field(description="its objects in order; empty: every object of the sort")
    strategy: str
    state: str = Field(
        description="running; stale: its source is silent, and there is no other; waiting: no "
        "stream gives the feature"
    )
    failure: str | None
    reads: list[str] = Field(description="its present streams and sources")
    missing: list[str] = Field(description="the missing parts of a plan, if it waits")
    staleness: str | None
    min_quality: float
    hold_off: str
    rematches: int = Field(description="number of switches that are kept")

    @classmethod
    def of(cls, view: views.AdaptiveView) -> AdaptiveModel:
        return cls(
            want=view.want,
            feature=view.feature,
            sort=view.sort,
            objects=list(view.objects),
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
    before: list[str] = Field(description="the streams and sources before the switch")
    after: list[str] = Field(description="the streams and sources after it")
    lost: bool = Field(
        description="whether the new source no longer had all samples after the last one"
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
    """A subscription; ``stream`` has its samples, and ``events`` sends them. A waiting subscription
    has no stream."""

    id: str
    source: str = Field(description="the stream; the feature, if one to a feature waits")
    policy: str = Field(description="as KPL, integers in ms; as written, if it waits")
    since: str = Field(description="as requested; a duration as the time that it stands for")
    state: Literal["running", "ended", "failed", "waiting"] = Field(
        description="ended: its stream has; failed: its source was stopped, and no more samples "
        "come; waiting: an earlier run accepted it, and this one cannot start it"
    )
    failure: str | None = Field(description="why it failed or waits")
    stream: str | None
    counters: dict[str, Any] = Field(description="counters of the samples under the policy")
    violations: str | None = Field(description="the stream of samples that violated the policy")
    events: str | None
    adaptive: AdaptiveModel | None = Field(description="only for a subscription to a feature")

    @classmethod
    def waiting(cls, waiting: WaitingCommand) -> SubscriptionModel:
        """Return the model of a waiting subscription."""
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
            state=view.state,  # type: ignore[arg-type]
            failure=view.failure,
            stream=view.stream,
            counters=dict(view.counters),
            violations=view.violations,
            events=f"/subscriptions/{view.id}/events",
            adaptive=None if view.adaptive is None else AdaptiveModel.of(view.adaptive),
        )
