"""JSON models of semantic matching."""

from __future__ import annotations

from pydantic import BaseModel, Field

from ...engine.model import views
from .events import PlanModel, StepModel
from .parts import MOST_ARGUMENTS, Body, Name, Strategy


class MatchIn(Body):
    """A wanted feature, of the objects of a sort or of some objects."""

    feature: Name
    sort: Name | None = None
    objects: list[Name] = Field(
        default_factory=list,
        max_length=MOST_ARGUMENTS,
        description="the object; for an n-ary feature its arguments in order",
    )
    strategy: Strategy = "fast"


class MatchModel(BaseModel):
    """The result of semantic matching, with reasons; nothing was started."""

    feature: str
    target: str
    strategy: str
    found: bool
    plan: PlanModel | None
    alternatives: list[str]
    reasons: list[str]
    cost: float | None = Field(description="cost of the plan's units that do not run yet")
    quality: float | None = Field(description="quality of the plan's output, 0 to 1")
    proven: bool = Field(description="whether the plan is proven to be the strategy's best")
    tree: StepModel = Field(description="the plan, and what else was considered")
    specification: str | None = Field(
        description="the plan as a specification in XML for POST /specifications; null without a "
        "plan, or if the plan contains the query of an event"
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
            tree=StepModel.of(view.tree),
            specification=view.specification,
        )
