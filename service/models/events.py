"""JSON models of templates, requests for events, and plans."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Literal

from pydantic import BaseModel, Field, StringConstraints

from ...engine.durability.accepted_commands import WaitingCommand
from ...engine.durability.commands import RequestEvent
from ...engine.model import views
from ...engine.planning.explanations import unit_view
from ...engine.units.base import ComputationalUnit
from ...matching.render import Step
from ...rdf.namespaces import shorten
from ...streams.time import SECOND
from ...templates.parameters import ParameterUse
from .parts import Body, Name, Since, Strategy


class ParameterModel(BaseModel):
    """A parameter of a template. A number or text may be compared with a feature."""

    name: str
    role: Literal["object", "sort", "feature", "number", "text", "duration"] = Field(
        description="what its argument is"
    )
    sort: str | None = Field(description="the sort of an object, where the template states one")
    feature: str | None = Field(description="the feature that is compared with it")
    unit: str | None = Field(description="the unit of the feature, and so of the argument")
    comparison: Literal["<", "<=", ">", ">=", "=", "!="] | None = Field(
        description="of the feature with the argument: `>` means above it"
    )
    aggregate: str | None = Field(description="the aggregate of the feature that is compared")
    default: str | None = Field(
        description="the argument of a request that leaves this one out; null: none may"
    )

    @classmethod
    def of(cls, use: ParameterUse) -> ParameterModel:
        members = asdict(use) | {"name": f"?{use.name}", "role": str(use.role)}
        for name in ("sort", "feature"):
            if members[name] is not None:
                members[name] = shorten(members[name])
        return cls.model_validate(members)


class TemplateModel(BaseModel):
    """An event template."""

    name: str = Field(description="the IRI of the event concept")
    local_name: str
    doc: str = Field(description="the comment at the beginning of its text")
    window: str | None = Field(description="the window of its query in words; null: a formula")
    parameters: list[str]
    uses: list[ParameterModel] = Field(description="what each parameter stands for, in order")
    source: str
    etag: str

    @classmethod
    def of(cls, view: views.TemplateView) -> TemplateModel:
        return cls(
            name=view.name,
            local_name=view.local_name,
            doc=view.doc,
            window=view.window,
            parameters=list(view.parameters),
            uses=[ParameterModel.of(use) for use in view.uses],
            source=view.source,
            etag=view.etag,
        )


class EventIn(Body):
    """A request for an event. An argument is text: ``?o``, ``dyknow:UAV``, ``100``. The last ones
    may name their parameters: ``?threshold = 100``. One with a default may be left out."""

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


class StepModel(BaseModel):
    """A part of a plan, or an alternative to it, with the parts that it rests on or lacks."""

    text: str
    verdict: str = Field(
        description="chosen, possible, not tried, failed; empty below a chosen part"
    )
    reason: str = Field(description="why it failed or is only possible; may be empty")
    stream: str | None = Field(description="the existing stream that it reads")
    transformation: str | None = Field(description="the transformation that it needs")
    cost: float | None = Field(
        description="what it adds to the cost of the plan; 0 if it runs, or stands above, too"
    )
    parts: list[StepModel]

    @classmethod
    def of(cls, step: Step) -> StepModel:
        return cls(
            text=step.text,
            verdict=step.verdict,
            reason=step.reason,
            stream=step.stream,
            transformation=step.transformation,
            cost=step.cost,
            parts=[cls.of(part) for part in step.parts],
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
    kind: Literal["QUERY", "MONITOR", "PATTERN"] | None = Field(
        description="what its template is: a MONITOR gives verdicts, a PATTERN matches; null: it "
        "waits"
    )
    since: str = Field(description="as requested; a duration as the time that it stands for")
    state: Literal["running", "ended", "failed", "waiting"] = Field(
        description="ended: all streams that it reads have ended; "
        "failed: the unit that answers it was stopped, and no more samples come; "
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
            kind=None,
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
            kind=view.kind,  # type: ignore[arg-type]
            since=view.since,
            state=view.state,  # type: ignore[arg-type]
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
