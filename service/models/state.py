"""JSON models of the service's state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

from pydantic import BaseModel, Field

from ...continuous.estimation.costs import OperatorCost
from ...continuous.estimation.estimates import Way
from ...engine.back_test import Trial
from ...engine.planning.explanations import Explanation
from ...matching.plan import Node
from ...matching.render import steps
from ...streams.time import format_time
from .events import StepModel


class OntologyModel(BaseModel):
    """A loaded ontology; its name is its IRI for FROM and GRAPH."""

    name: str


class ViolationModel(BaseModel):
    """A violation of a shape: the node, the property (if it concerns one), and the reason."""

    node: str
    path: str | None
    message: str


class OntologyReportModel(BaseModel):
    """Whether the ontologies and the live stream space are well-formed."""

    conforms: bool
    violations: list[ViolationModel]


class WaitingModel(BaseModel):
    """A command that an earlier run accepted and this one cannot execute now."""

    kind: str = Field(description="stream, annotation, template, transformation, ontology, command")
    name: str = Field(description="the name that DELETE removes; a command has none to remove")
    reason: str


class LoadModel(BaseModel):
    """What the process takes of the machine."""

    memory: int = Field(description="bytes of memory")
    memory_limit: int | None = Field(description="bytes that it may take; null: no limit")
    processor: float = Field(description="seconds of processor time since the start")
    loop_lag: float = Field(description="seconds by which the event loop was late, the last time")
    units_behind: int = Field(description="units with a backlog of windows")
    log_waiting: int | None = Field(
        description="commands that wait to be written to the log; null without a data directory"
    )


class StatusModel(BaseModel):
    """An overview of the service."""

    version: str
    epoch: str = Field(description="the epoch of the numbers in event ids")
    started: str
    now: str
    streams: int
    templates: int
    requests: int = Field(description="number of running event requests")
    queries: int = Field(description="number of registered continuous queries")
    clients: int = Field(description="number of event-stream clients")
    accepted: int = Field(description="samples accepted since the start")
    load: LoadModel
    starting: list[str] = Field(
        description="what the start still does, with how far it is; until then it is not ready"
    )
    waiting: list[WaitingModel] = Field(
        description="commands that an earlier run accepted and this one cannot execute now; their "
        "own lists have waiting requests, subscriptions and queries"
    )


class FindingModel(BaseModel):
    """Something that is wrong or soon will be, with the place and the remedy."""

    level: Literal["bad", "warn"] = Field(description="bad: results are missing; warn: some may be")
    what: str
    detail: str
    hint: str = Field(description="what to do; may be empty")
    kind: Literal["service", "stream", "unit", "request", "transformation"]
    name: str = Field(description="the name or id of the thing concerned; empty for the service")
    stream: str | None = Field(description="the stream that shows it")


class LogLineModel(BaseModel):
    """A line of the service's log."""

    time: str
    level: str
    event: str
    values: dict[str, str] = Field(description="its further members, without tokens")


class HttpRequestModel(BaseModel):
    """An answered HTTP request."""

    time: str = Field(description="when it began")
    id: str = Field(description="its `X-Request-Id`, as in the log")
    method: str
    path: str = Field(description="without the query")
    route: str | None = Field(description="the path of its route; null: none has this path")
    status: int
    milliseconds: float = Field(description="until the answer began")
    size: int = Field(description="bytes of the answer's body as sent, compressed or not")
    problem: str | None = Field(description="the type of the problem, of an error")


class LogModel(BaseModel):
    """The log of a data directory. A position is the number of a command, from 1."""

    segments: int = Field(description="its files")
    bytes: int
    first: int = Field(description="position of the oldest command in it")
    last: int = Field(description="position of the newest command")
    replayed: int = Field(description="commands after the checkpoint, which a start would replay")
    waiting: int = Field(description="executed commands that are not on the disk yet")
    waiting_bytes: int


class CheckpointModel(BaseModel):
    """The newest checkpoint: the state after the command at ``position``."""

    position: int
    bytes: int
    written: str
    age: float = Field(description="seconds since it was written")


class JournalModel(BaseModel):
    """What a data directory holds."""

    recording: bool = Field(description="false: there is no data directory, and all is in memory")
    log: LogModel | None
    checkpoint: CheckpointModel | None = Field(description="null also before the first one")
    free: int | None = Field(description="free bytes of its disk")
    failing: list[str] = Field(description="why the log or a checkpoint cannot be written")


class SettingModel(BaseModel):
    """A setting of the service."""

    name: str
    value: str = Field(description="as text; a secret is hidden")
    is_default: bool


class SortModel(BaseModel):
    """A sort of objects; ``parents`` are the sorts right above it."""

    name: str
    parents: list[str]


class FeatureModel(BaseModel):
    """A feature of the ontology."""

    name: str
    unit: str | None = Field(description="the unit of plain numbers")
    domain: str | None = Field(description="the narrowest sort that has it, if stated")
    arity: int | None
    doc: str | None = Field(description="the ontology's comment")


class VocabularyModel(BaseModel):
    """The names that annotations, requests and queries may use, shortened with prefixes."""

    sorts: list[SortModel]
    features: list[FeatureModel]
    events: list[str]
    prefixes: dict[str, str]


class HealthModel(BaseModel):
    """``ok``; ``degraded``: it works, but some units failed; ``starting`` and ``failing``, with the
    reasons."""

    status: str
    reason: str | None = None
    reasons: list[str] = Field(default=[], description="the single reasons")


class StageModel(BaseModel):
    """A stage of an explanation: its title, and its text."""

    title: str
    text: str


class CostModel(BaseModel):
    """What an operator costs a window."""

    rows: float | None = Field(description="rows out; null where it makes none")
    nanoseconds: float = Field(description="its own time; 0 within another operator")


class OperatorModel(BaseModel):
    """An operator of a query's plan, before its inputs, which are one deeper."""

    depth: int
    operator: str
    way: Way = Field(description="how it is computed")
    estimated: CostModel
    measured: CostModel | None = Field(description="null where it was not measured")

    @classmethod
    def of(cls, cost: OperatorCost) -> OperatorModel:
        estimate, measured = cost.estimate, cost.measured
        return cls(
            depth=cost.depth,
            operator=cost.text,
            way=estimate.way,
            estimated=CostModel(rows=estimate.rows, nanoseconds=estimate.nanoseconds),
            measured=None
            if measured is None
            else CostModel(rows=measured.rows, nanoseconds=measured.nanoseconds),
        )


class TrialModel(BaseModel):
    """What a query or request would have given on the samples that are kept."""

    since: str | None = Field(description="available time of the first sample; null without one")
    until: str | None = Field(description="the latest available time that was read")
    samples: int = Field(description="of the streams that it reads")
    results: int = Field(description="samples of its stream: how often it would have fired")
    first: str | None = Field(description="the earliest valid time of a result")
    last: str | None
    complete: bool = Field(description="false: the time was over before all was read, or it failed")
    failure: str | None = Field(description="why it could not start, or ended")

    @classmethod
    def of(cls, trial: Trial) -> TrialModel:
        def shown(time: int | None) -> str | None:
            return None if time is None else format_time(time)

        return cls(
            since=shown(trial.since),
            until=shown(trial.until),
            samples=trial.samples,
            results=trial.results,
            first=shown(trial.first),
            last=shown(trial.last),
            complete=trial.is_complete,
            failure=trial.failure,
        )

    def __str__(self) -> str:
        if self.until is None:
            return f"not tried: {self.failure or 'no sample is kept'}"
        found = f"{self.samples:,} samples from {self.since} to {self.until}: "
        if self.results:
            found += (
                f"{self.results:,} results,\nthe first at {self.first}, the last at {self.last}"
            )
        else:
            found += "no result"
        if self.failure is not None:
            return f"{found}\nthen it failed: {self.failure}"
        return found if self.complete else f"{found}\nthen the time was over"


class ExplainModel(BaseModel):
    """The stages of a query, template, request or match."""

    text: str = Field(description="the whole explanation, for reading")
    found: bool = Field(description="whether there is a plan for all that is needed")
    missing: list[str] = Field(description="what a plan would need; empty if there is one")
    stages: list[StageModel] = Field(description="the same by stages")
    plan: list[StepModel] = Field(
        description="for each needed feature the plan, and what else was considered"
    )
    operators: list[OperatorModel] = Field(
        default=[],
        description="of a query that columns evaluate by itself: its plan, with costs a window",
    )
    tried: TrialModel | None = Field(
        default=None, description="with `since`: what it would have given on what is kept"
    )

    @classmethod
    def of(cls, explanation: Explanation, cost: Callable[[Node], float]) -> ExplainModel:
        return cls(
            text=explanation.text,
            found=explanation.found,
            missing=list(explanation.missing),
            stages=[StageModel(title=title, text=text) for title, text in explanation.stages],
            plan=[StepModel.of(steps(match, cost)) for match in explanation.matches],
            operators=[OperatorModel.of(cost) for cost in explanation.operators],
        )
