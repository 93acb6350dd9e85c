"""What goes over the wire as JSON. Times are ISO-8601 in UTC, durations such as ``5s``."""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    field_validator,
)

from ..converters.wire import RESERVED
from ..engine import views
from ..languages.ssl.annotation import (
    CheckedAnnotation,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from ..rdf.namespaces import DYKNOW
from ..streams import fluent, sample
from ..streams.time import format_duration, format_time, parse_duration

Strategy = Literal["fast", "cost", "quality"]
_TYPES = {
    "double": "float",
    "number": "float",
    "int": "integer",
    "long": "integer",
    "bool": "boolean",
    "str": "string",
    "text": "string",
}


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid")


def _duration(value: object) -> object:
    return parse_duration(value) if isinstance(value, str) else value


def _type(value: object) -> object:
    return _TYPES.get(value, value) if isinstance(value, str) else value


def _fields(value: object) -> object:
    """A mapping of names to types says the same as a list of fields."""
    if isinstance(value, dict):
        return [{"name": name, "type": kind} for name, kind in value.items()]
    return value


def _retention(value: object) -> object:
    return {"samples": value} if isinstance(value, int) and not isinstance(value, bool) else value


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
Name = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class FieldModel(_Model):
    """A named value of a stream's samples."""

    name: Name
    type: Annotated[Literal["float", "integer", "boolean", "string"], BeforeValidator(_type)]


class RetentionModel(_Model):
    """How much history is kept: at least so many samples of at most such an age. What is beyond
    goes in whole batches, as they came."""

    samples: int | None = Field(default=None, gt=0, le=100_000_000)
    age: Duration | None = None


class StreamIn(_Model):
    """The declaration of a stream."""

    @field_validator("fields")
    @classmethod
    def _tell_apart(cls, fields: list[FieldModel]) -> list[FieldModel]:
        names = [field.name for field in fields]
        for name in names:
            if name in RESERVED:
                raise ValueError(f"a field cannot be called {name!r}: that is a sample's time")
            if names.count(name) > 1:
                raise ValueError(f"the field {name!r} is there twice")
        return fields

    fields: Annotated[list[FieldModel], BeforeValidator(_fields)] = Field(
        min_length=1,
        max_length=1000,
        description="a list of names and types; an object of name: type will do",
        examples=[[{"name": "id", "type": "string"}, {"name": "speed", "type": "float"}]],
    )
    lateness: Duration = Field(0, description="how far behind the newest a sample may be")
    retention: Annotated[RetentionModel, BeforeValidator(_retention)] = RetentionModel()
    namespace: str = Field(
        DYKNOW, min_length=1, description="where the objects of id fields have their names"
    )

    def declaration(self, name: str, samples: int) -> views.StreamDeclaration:
        """For the engine; ``samples`` is the history kept when the request does not say."""
        fields = tuple(sample.Field(f.name, sample.FieldType(f.type)) for f in self.fields)
        kept = fluent.Retention(self.retention.samples or samples, self.retention.age)
        return views.StreamDeclaration(name, fields, self.lateness, kept, self.namespace)


class CountersModel(BaseModel):
    """Where the samples went: accepted = used + late + duplicate + expired + pending."""

    accepted: int
    used: int
    late: int
    duplicate: int
    expired: int
    pending: int


class StreamModel(BaseModel):
    """A stream as it is now."""

    name: str
    fields: list[FieldModel]
    namespace: str
    lateness: str
    retention: dict[str, int | str | None]
    stamped: bool | None = Field(description="samples are stamped on arrival; null: none came yet")
    ended: bool
    counters: CountersModel
    kept: int = Field(description="samples in history")
    first: int = Field(description="number of the oldest sample kept")
    last: int = Field(description="number of the newest sample; 0 before the first")
    watermark: str | None
    first_available: str | None = Field(description="how far the kept history reaches")
    last_available: str | None
    last_valid: str | None
    rate: float = Field(description="samples a second of available time, lately")
    lag: str | None = Field(description="how far the stream is behind the clock")
    annotation: str | None = Field(description="the SSL text")
    producer: str | None = Field(description="the unit that makes the stream")
    subscribers: int
    samples: str
    events: str

    @classmethod
    def of(cls, view: views.StreamView) -> StreamModel:
        age = view.retention.age
        return cls(
            name=view.name,
            fields=[FieldModel(name=f.name, type=f.type.value) for f in view.fields],
            namespace=view.namespace,
            lateness=format_duration(view.lateness),
            retention={
                "samples": view.retention.samples,
                "age": None if age is None else format_duration(age),
            },
            stamped=view.stamped,
            ended=view.ended,
            counters=CountersModel(
                accepted=view.counters.accepted,
                used=view.counters.used,
                late=view.counters.late,
                duplicate=view.counters.duplicate,
                expired=view.counters.expired,
                pending=view.counters.pending,
            ),
            kept=view.samples_kept,
            first=view.first_number,
            last=view.last_number,
            watermark=_time(view.watermark),
            first_available=_time(view.first_available),
            last_available=_time(view.last_available),
            last_valid=_time(view.last_valid),
            rate=round(view.rate, 3),
            lag=None if view.lag is None else _signed(view.lag),
            annotation=view.annotation,
            producer=view.producer,
            subscribers=view.subscribers,
            samples=f"/streams/{view.name}/samples",
            events=f"/streams/{view.name}/events",
        )


class AcceptedModel(BaseModel):
    """How many samples were taken; a batch is taken whole or refused whole."""

    accepted: int


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


class EventIn(_Model):
    """A request for an event. An argument is text: ``?o``, ``dyknow:UAV``, ``100``."""

    event: Name
    arguments: list[Annotated[str, StringConstraints(max_length=8192)]] = Field(
        default_factory=list, max_length=100
    )
    strategy: Strategy = "fast"
    since: views.Since = views.Since.NOW
    """``start`` begins with the kept history of the streams that are read."""


class UnitModel(BaseModel):
    """A computational unit of a plan."""

    name: str
    transformation: str
    inputs: list[str]
    output: str
    parameters: dict[str, str]
    users: int


class PlanModel(BaseModel):
    """How a request is met."""

    text: str = Field(description="the plan as a tree, for people")
    streams: list[str]
    units: list[UnitModel]
    query: str = Field(description="the continuous query as C-SPARQL text")

    @classmethod
    def of(cls, view: views.PlanView) -> PlanModel:
        units = [
            UnitModel(
                name=unit.name,
                transformation=unit.transformation,
                inputs=list(unit.inputs),
                output=unit.output,
                parameters=dict(unit.parameters),
                users=unit.users,
            )
            for unit in view.units
        ]
        return cls(text=view.text, streams=list(view.streams), units=units, query=view.query)


class EventModel(BaseModel):
    """A running request for an event; its samples come at ``events``."""

    id: str
    event: str
    arguments: list[str]
    strategy: str
    since: views.Since
    stream: str
    position: str = Field(
        description="id of the stream's last sample before the request: follow with since=position"
    )
    waits_for: list[str]
    events: str
    plan: PlanModel

    @classmethod
    def of(cls, view: views.EventView, epoch: str) -> EventModel:
        return cls(
            id=view.id,
            event=view.event,
            arguments=list(view.arguments),
            strategy=view.strategy,
            since=views.Since(view.since),
            stream=view.stream,
            position=f"{epoch}-{view.position}",
            waits_for=list(view.waits_for),
            events=f"/streams/{view.stream}/events",
            plan=PlanModel.of(view.plan),
        )


class MatchIn(_Model):
    """A wish for a feature, of the objects of a sort or of some objects."""

    feature: Name
    sort: Name | None = None
    objects: list[Name] = Field(default_factory=list, max_length=1000)
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
        )


class SubscriptionIn(_Model):
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


class DeclarationModel(BaseModel):
    """A KPL declaration and what became of it."""

    name: str = Field(description="name, label, or `sort NAME`")
    kind: str = Field(description="the declaration's first word")
    text: str
    stream: str | None = Field(description="the stream that it makes or names")
    unit: str | None = Field(description="the process that makes the stream")
    uses: list[str]
    failure: str | None
    errors: int
    restarts: int
    last_error: str | None
    counters: dict[str, Any] = Field(
        description="what became of samples under its policy; which objects it has"
    )
    violations: str | None = Field(description="the stream of samples that were not passed on")

    @classmethod
    def of(cls, view: views.DeclarationView) -> DeclarationModel:
        given = {field.name: getattr(view, field.name) for field in fields(view)}
        return cls(**given | {"uses": list(view.uses), "counters": dict(view.counters)})


class OneDeclarationModel(DeclarationModel):
    """A declaration with what cannot be without it, users first."""

    used_by: list[str]


class RemovedModel(BaseModel):
    """What was removed, users first."""

    removed: list[str]


class AnnotationModel(BaseModel):
    """What a stream, source or computational unit is about."""

    kind: Literal["stream", "source", "transformation"]
    name: str
    features: list[str] = Field(description="IRIs of the features that it carries or makes")
    source: str = Field(description="the SSL text")

    @classmethod
    def of(cls, annotation: CheckedAnnotation) -> AnnotationModel:
        match annotation:
            case StreamAnnotation():
                features = [content.feature for content in annotation.contents]
                return cls(
                    kind="stream",
                    name=annotation.stream,
                    features=features,
                    source=annotation.source,
                )
            case SourceAnnotation() | TransformationAnnotation():
                kind: Literal["source", "transformation"] = (
                    "source" if isinstance(annotation, SourceAnnotation) else "transformation"
                )
                return cls(
                    kind=kind,
                    name=annotation.name,
                    features=[annotation.output.feature],
                    source=annotation.source,
                )


class OntologyModel(BaseModel):
    """A loaded ontology; FROM and GRAPH mean it by its name."""

    name: str


class ViolationModel(BaseModel):
    """What a shape refuses: a node, the property concerned (if it is one), and why."""

    node: str
    path: str | None
    message: str


class OntologyReportModel(BaseModel):
    """Whether the ontologies and the live stream space are well-formed."""

    conforms: bool
    violations: list[ViolationModel]


class StatusModel(BaseModel):
    """The service at a glance."""

    version: str
    epoch: str = Field(description="the life of the service that ids of samples speak of")
    started: str
    now: str
    streams: int
    templates: int
    requests: int = Field(description="event requests that run")
    clients: int = Field(description="clients that listen to streams")
    accepted: int = Field(description="samples accepted since the start")


class HealthModel(BaseModel):
    """``ok``, or what is wrong."""

    status: str
    reason: str | None = None


class ExplainModel(BaseModel):
    """Every stage of a query, template, request or match, as text."""

    text: str


def text_schema(description: str, example: str) -> dict[str, Any]:
    """What OpenAPI says of a body that is plain text."""
    return {"schema": {"type": "string", "description": description}, "example": example}


def _time(time: int | None) -> str | None:
    return None if time is None else format_time(time)


def _signed(duration: int) -> str:
    return format_duration(duration) if duration >= 0 else f"-{format_duration(-duration)}"
