"""What semantic matching is asked and answers, as JSON."""

from __future__ import annotations

from pydantic import BaseModel, Field

from ...engine.model import views
from .events import PlanModel
from .parts import MOST_ARGUMENTS, Body, Name, Strategy


class MatchIn(Body):
    """A wish for a feature, of the objects of a sort or of some objects."""

    feature: Name
    sort: Name | None = None
    objects: list[Name] = Field(
        default_factory=list,
        max_length=MOST_ARGUMENTS,
        description="the object; of an n-ary feature its further arguments after it",
    )
    strategy: Strategy = "fast"


class MatchModel(BaseModel):
    """What semantic matching found, and why; nothing was started."""

    feature: str
    target: str
    strategy: str
    found: bool
    plan: PlanModel | None
    alternatives: list[str]
    reasons: list[str]
    cost: float | None = Field(description="of the plan's units that do not run yet")
    quality: float | None = Field(description="of what the plan gives, 0 to 1")
    proven: bool = Field(description="whether the plan is proven to be the strategy's best")
    specification: str | None = Field(
        description="the plan as a specification in XML, as POST /specifications takes it; null "
        "without a plan, or where the plan has the query of an event"
    )

    @classmethod
    def of(cls, view: views.MatchView) -> MatchModel:
        return cls(
            feature=view.feature,
            target=view.target,
            strategy=view.strategy,
            found=view.found,
            plan=None if view.plan is None else PlanModel.of(view.plan),
            alternatives=list(view.alternatives),
            reasons=list(view.reasons),
            cost=view.cost,
            quality=view.quality,
            proven=view.proven,
            specification=view.specification,
        )
