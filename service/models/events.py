"""JSON models of templates, requests for events, and plans."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, StringConstraints

from ...engine.durability.accepted_commands import WaitingCommand
from ...engine.durability.commands import RequestEvent
from ...engine.model import views
from ...engine.planning.explanations import unit_view
from ...engine.units.base import ComputationalUnit
from ...streams.time import SECOND
from .parts import Body, Name, Since, Strategy


class TemplateModel(BaseModel):
    """An event template."""

    name: str = Field(description="the IRI of the event concept")
    local_name: str
    parameters: list[str]
    source: str
    etag: str

    @classmethod
    def of(cls, view: views.TemplateView) -> TemplateModel:
        return cls(
            name=view.name,
            local_name=view.local_name,
            parameters=list(view.parameters),
            source=view.source,
            etag=view.etag,
        )


class EventIn(Body):
    """A request for an event. An argument is text: ``?o``, ``dyknow:UAV``, ``100``."""

    event: Name
    arguments: list[Annotated[str, StringConstraints(max_length=8192)]] = Field(
        default_factory=list, max_length=100
    )
    strategy: Strategy = "fast"
    since: Since = "now"


class UnitModel(BaseModel):
    """A computational unit of a plan."""

    name: str
    transformation: str
    inputs: list[str]
    output: str
    parameters: dict[str, str]
    users: int

    @classmethod
    def of(cls, view: views.UnitView) -> UnitModel:
        return cls(
            name=view.name,
            transformation=view.transformation,
            inputs=list(view.inputs),
            output=view.output,
            parameters=dict(view.parameters),
            users=view.users,
        )


class RunningUnitModel(UnitModel):
    """A running unit with its counters."""

    busy: float = Field(description="seconds that it has worked")
    windows: int = Field(description="evaluated windows")
    overruns: int = Field(description="windows without a result, which exceeded a limit")
    late: int = Field(description="samples that arrived too late for it")
    errors: int
    lag: float | None = Field(description="seconds that its output is behind its inputs")
    failure: str | None = Field(description="why it was stopped")

    @classmethod
    def running(cls, unit: ComputationalUnit) -> RunningUnitModel:
        """Return the model of a unit of the engine."""
        return cls(
            **UnitModel.of(unit_view(unit)).model_dump(),
            busy=unit.busy / SECOND,
            windows=unit.windows,
            overruns=unit.overruns,
            late=unit.late,
            errors=unit.counters.errors,
            lag=None if unit.lag is None else unit.lag / SECOND,
            failure=unit.failure,
        )


class PlanModel(BaseModel):
    """The plan that answers a request."""

    text: str = Field(description="the plan as a tree, for reading")
    streams: list[str]
    units: list[UnitModel]
    query: str = Field(description="the continuous query as C-SPARQL text")

    @classmethod
    def of(cls, view: views.PlanView) -> PlanModel:
        units = [UnitModel.of(unit) for unit in view.units]
        return cls(text=view.text, streams=list(view.streams), units=units, query=view.query)


class EventModel(BaseModel):
    """A request for an event; ``events`` sends its samples. A waiting request has no stream."""

    id: str
    event: str
    arguments: list[str]
    strategy: str
    since: str = Field(description="as requested; a duration as the time that it stands for")
    state: Literal["running", "failed", "waiting"] = Field(
        description="failed: the unit that answers it was stopped, and no more samples come; "
        "waiting: an earlier run accepted it, and this one cannot start it"
    )
    failure: str | None = Field(description="why it failed or waits")
    stream: str | None
    position: str | None = Field(
        description="id of the stream's last sample before the request: follow with since=position"
    )
    waits_for: list[str] = Field(
        description="streams without samples that are not idle: no window closes before they begin"
    )
    held_back_by: list[str] = Field(
        description="the streams with the least watermark: the next window closes when they go on, "
        "end, or become idle"
    )
    late: int = Field(description="samples that came too late for their windows")
    events: str | None
    plan: PlanModel | None
    empty: str | None = Field(None, description="why the stream has no sample yet")

    @classmethod
    def waiting(cls, waiting: WaitingCommand) -> EventModel:
        """Return the model of a waiting request."""
        command = waiting.command
        assert isinstance(command, RequestEvent)
        return cls(
            id=waiting.key.name,
            event=command.event if command.text is None else command.text,
            arguments=list(command.arguments),
            strategy=command.strategy,
            since=command.since,
            state="waiting",
            failure=waiting.reason,
            stream=None,
            position=None,
            waits_for=[],
            held_back_by=[],
            late=0,
            events=None,
            plan=None,
            empty=None,
        )

    @classmethod
    def of(cls, view: views.EventView, epoch: str) -> EventModel:
        return cls(
            id=view.id,
            event=view.event,
            arguments=list(view.arguments),
            strategy=view.strategy,
            since=view.since,
            state="running" if view.failure is None else "failed",
            failure=view.failure,
            stream=view.stream,
            position=f"{epoch}-{view.position}",
            waits_for=list(view.waits_for),
            held_back_by=list(view.held_back_by),
            late=view.late,
            events=f"/streams/{view.stream}/events",
            plan=PlanModel.of(view.plan),
            empty=view.empty,
        )
