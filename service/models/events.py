"""Templates, requests for events and their plans, as JSON."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, Field, StringConstraints

from ...engine.durability.accepted_commands import WaitingCommand
from ...engine.durability.commands import RequestEvent
from ...engine.model import views
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


class PlanModel(BaseModel):
    """How a request is met."""

    text: str = Field(description="the plan as a tree, for people")
    streams: list[str]
    units: list[UnitModel]
    query: str = Field(description="the continuous query as C-SPARQL text")

    @classmethod
    def of(cls, view: views.PlanView) -> PlanModel:
        units = [UnitModel.of(unit) for unit in view.units]
        return cls(text=view.text, streams=list(view.streams), units=units, query=view.query)


class EventModel(BaseModel):
    """A request for an event; its samples come at ``events``. One that waits has no stream."""

    id: str
    event: str
    arguments: list[str]
    strategy: str
    since: str = Field(description="as asked for; a duration as the time that it means")
    state: Literal["running", "failed", "waiting"] = Field(
        description="failed: what answers it was cut off, and nothing more comes; waiting: an "
        "earlier run has accepted it, and this one cannot start it"
    )
    failure: str | None = Field(description="why it has failed or waits")
    stream: str | None
    position: str | None = Field(
        description="id of the stream's last sample before the request: follow with since=position"
    )
    waits_for: list[str] = Field(
        description="streams that have not begun and are not idle: nothing closes before"
    )
    held_back_by: list[str] = Field(
        description="the streams that are least far: the next window closes when they go on, end, "
        "or are idle"
    )
    late: int = Field(description="samples that came too late for their windows")
    events: str | None
    plan: PlanModel | None
    empty: str | None = Field(None, description="why the stream has no sample yet")

    @classmethod
    def waiting(cls, waiting: WaitingCommand) -> EventModel:
        """One that waits, as it was asked for."""
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
