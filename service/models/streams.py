"""JSON models of streams and their samples."""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    field_validator,
    model_validator,
)

from ...converters.rdf.statements import SCHEMA
from ...converters.wire import Rounded
from ...engine.model import views
from ...rdf.namespaces import DYKNOW
from ...streams import history, sample
from ...streams.sample import (
    IN_FIELD_NAMES,
    LONGEST_NAME,
    TIME_FIELDS,
    check_field_name,
)
from ...streams.time import FOREVER, HOUR, format_duration
from .parts import Body, Duration, iso, signed
from .transformations import PortModel

_TYPES = {
    "double": "float",
    "number": "float",
    "int": "integer",
    "long": "integer",
    "bool": "boolean",
    "str": "string",
    "text": "string",
}


def _type(value: object) -> object:
    return _TYPES.get(value, value) if isinstance(value, str) else value


def _fields(value: object) -> object:
    """Convert an object of name: type to a list of fields."""
    if isinstance(value, dict):
        return [{"name": name, "type": kind} for name, kind in value.items()]
    return value


def _oo(value: object) -> object:
    return FOREVER if value == "oo" else value


def _field_name(name: str) -> str:
    check_field_name(name)
    return name


def _retention(value: object) -> object:
    return {"samples": value} if isinstance(value, int) and not isinstance(value, bool) else value


class FieldModel(Body):
    """A named value of a stream's samples."""

    name: str
    type: Annotated[Literal["float", "integer", "boolean", "string"], BeforeValidator(_type)]


class FieldIn(FieldModel):
    """A named value of the samples, in a declaration."""

    name: Annotated[
        str,
        AfterValidator(_field_name),
        Field(
            json_schema_extra={
                "minLength": 1,
                "maxLength": LONGEST_NAME,
                "pattern": f"^{IN_FIELD_NAMES}+$",
            }
        ),
    ]


class RetentionModel(Body):
    """The size of the history: the newest samples within a number, an age and a number of bytes,
    and at least the newest batch. A sample takes 16 bytes for its times, 8 for a number, 1 for a
    boolean, and for a text 128 plus its characters, or four times these if not all are ASCII."""

    samples: int | None = Field(default=None, gt=0, le=100_000_000)
    age: Duration | None = None
    bytes: int | None = Field(default=None, gt=0, lt=2**63)


class StreamIn(Body):
    """The declaration of a stream."""

    @field_validator("fields")
    @classmethod
    def _tell_apart(cls, fields: list[FieldIn]) -> list[FieldIn]:
        for name, count in Counter(field.name for field in fields).items():
            if name in TIME_FIELDS:
                raise ValueError(f"a field cannot be called {name!r}: that is a sample's time")
            if count > 1:
                raise ValueError(f"the field {name!r} is declared twice")
        return fields

    @model_validator(mode="after")
    def _fit_kind(self) -> Self:
        if self.kind == "rdf" and self.fields:
            raise ValueError("a stream of RDF has fields of its own: leave `fields` out")
        if self.kind == "samples" and not self.fields:
            raise ValueError('a stream has at least one field: give "fields": {"id": "string"}')
        if self.kind == "samples" and self.time is not None:
            raise ValueError('`time` is for streams of RDF: give "kind": "rdf"')
        return self

    kind: Literal["samples", "rdf"] = Field(
        "samples",
        description="rdf: the samples are statements, published as N-Triples, N-Quads, TriG, "
        "Turtle or JSON-LD, and need no annotation to be queried",
    )
    fields: Annotated[list[FieldIn], BeforeValidator(_fields)] = Field(
        [],
        max_length=1000,
        description="a list of names and types, or an object of name: type; at least one, and "
        "none for a stream of RDF",
        examples=[[{"name": "id", "type": "string"}, {"name": "speed", "type": "float"}]],
    )
    time: str | None = Field(
        None,
        min_length=1,
        max_length=2000,
        description="of a stream of RDF: the property (IRI) that gives the times of statements "
        "whose graph has no time; without it they have the time of arrival",
        examples=["http://www.w3.org/ns/sosa/resultTime"],
    )
    lateness: Duration = Field(0, description="how far behind the newest sample one may arrive")
    idle: Annotated[Duration, Field(gt=0)] | None = Field(
        None,
        description="time without samples, by the service's clock, after which queries of several "
        "streams no longer wait for this one; a sample ends that; null: they always wait",
        examples=["10s"],
    )
    ahead: Annotated[Duration, BeforeValidator(_oo)] = Field(
        HOUR,
        description="how far ahead of the service's clock a sample may be stamped; a batch with a "
        "sample further ahead is refused; oo: any",
        examples=["1h", "oo"],
    )
    retention: Annotated[RetentionModel, BeforeValidator(_retention)] = RetentionModel()
    namespace: str = Field(
        DYKNOW, min_length=1, description="the namespace of the objects in id fields"
    )

    def declaration(self, name: str, default: history.Retention) -> views.StreamDeclaration:
        """Return the declaration for the engine; ``default`` is the retention for missing members.
        The default of bytes does not apply if the request limits samples: it then gets that many,
        however large."""
        fields = tuple(sample.Field(f.name, sample.FieldType(f.type)) for f in self.fields)
        if self.kind == "rdf":
            fields = SCHEMA.fields
        own = self.retention
        size = default.bytes if own.bytes is None and own.samples is None else own.bytes
        kept = history.Retention(own.samples or default.samples, own.age, size)
        return views.StreamDeclaration(
            name,
            fields,
            self.lateness,
            kept,
            self.namespace,
            self.idle,
            self.ahead,
            None if self.kind == "samples" else self.time or "",
        )


class CountersModel(BaseModel):
    """The fates of samples: accepted = used + late + duplicate + expired + pending. The stream
    `NAME_late` has the late ones. `ahead` counts refused batches, whose samples are in none of the
    others."""

    accepted: int
    used: int
    late: int
    duplicate: int
    expired: int
    pending: int
    ahead: int


class StreamModel(BaseModel):
    """The present state of a stream."""

    name: str
    kind: Literal["samples", "rdf"]
    time: str | None = Field(description="of RDF: the property that gives the times of statements")
    fields: list[FieldModel]
    namespace: str
    lateness: str
    ahead: str = Field(description="how far ahead of the clock a sample may be stamped; oo: any")
    idle: str | None = Field(description="time without samples after which it is idle; null: never")
    is_idle: bool = Field(description="whether it has been silent for that time: no reader waits")
    retention: dict[str, int | str | None]
    stamped: bool | None = Field(description="samples are stamped on arrival; null: no samples yet")
    ended: bool
    counters: CountersModel
    kept: int = Field(description="samples in history")
    first: int = Field(description="number of the oldest sample in history")
    last: int = Field(description="number of the newest sample; 0 before the first")
    watermark: str | None = Field(description="later samples have at least this available time")
    first_available: str | None = Field(description="the least available time of the history")
    last_available: str | None
    last_valid: str | None
    rate: float = Field(description="recent samples per second of available time; 0: ended")
    lag: str | None = Field(description="how late the newest sample became available")
    silent_for: str | None = Field(
        description="time since the newest sample became available, by the service's clock"
    )
    annotation: str | None = Field(description="the SSL text")
    ports: list[PortModel] = Field(
        description="the features that the annotation gives to fields; that of a subscription to it"
    )
    producer: str | None = Field(description="the unit that makes the stream")
    subscribers: int
    samples: str
    events: str

    @classmethod
    def of(cls, view: views.StreamView, now: int) -> StreamModel:
        age, last = view.retention.age, view.last_available
        return cls(
            name=view.name,
            kind="samples" if view.time_property is None else "rdf",
            time=view.time_property or None,
            fields=[FieldModel(name=f.name, type=f.type.value) for f in view.fields],
            namespace=view.namespace,
            lateness=format_duration(view.lateness),
            ahead="oo" if view.ahead == FOREVER else format_duration(view.ahead),
            idle=None if view.idle is None else format_duration(view.idle),
            is_idle=view.is_idle,
            retention={
                "samples": view.retention.samples,
                "age": None if age is None else format_duration(age),
                "bytes": view.retention.bytes,
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
                ahead=view.counters.ahead,
            ),
            kept=view.samples_kept,
            first=view.first_number,
            last=view.last_number,
            watermark=iso(view.watermark),
            first_available=iso(view.first_available),
            last_available=iso(view.last_available),
            last_valid=iso(view.last_valid),
            rate=round(view.rate, 3),
            lag=None if view.lag is None else signed(view.lag),
            silent_for=None if last is None else format_duration(max(0, now - last)),
            annotation=view.annotation,
            ports=[PortModel.of_content(content) for content in view.contents],
            producer=view.producer,
            subscribers=view.subscribers,
            samples=f"/streams/{view.name}/samples",
            events=f"/streams/{view.name}/events",
        )


class FailureModel(BaseModel):
    """A computational unit that failed."""

    unit: str
    stream: str = Field(description="its output")
    asked: list[str] = Field(description="the requests, queries and subscriptions that it answers")
    failure: str


class EvaluationModel(BaseModel):
    """The progress of all direct and indirect readers of a stream."""

    last: int = Field(description="number of the newest sample; 0 before the first")
    evaluated: int = Field(
        description="number of the newest sample that all readers have evaluated; failed ones do "
        "not count"
    )
    failed: list[FailureModel]

    @classmethod
    def of(cls, view: views.EvaluationView) -> EvaluationModel:
        failed = [
            FailureModel(
                unit=each.unit, stream=each.stream, asked=list(each.asked), failure=each.failure
            )
            for each in view.failed
        ]
        return cls(last=view.last, evaluated=view.evaluated, failed=failed)


class RoundedModel(BaseModel):
    """Numbers that a double cannot represent exactly: integers beyond 2^53, and numbers nearer to 0
    than doubles have digits."""

    count: int
    line: int = Field(description="the line of the first one; in Arrow the row")
    field: str = Field(description="the field of the first one")


class AcceptedModel(BaseModel):
    """The number of accepted samples; a batch is accepted as a whole or not at all."""

    accepted: int
    rounded: RoundedModel | None = Field(
        None, description="numbers of float fields that lost digits"
    )

    @classmethod
    def of(cls, accepted: int, rounded: Rounded | None) -> AcceptedModel:
        model = None
        if rounded is not None:
            model = RoundedModel(count=rounded.count, line=rounded.line, field=rounded.field)
        return cls(accepted=accepted, rounded=model)
