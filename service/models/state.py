"""The service itself and what it knows, as JSON."""

from __future__ import annotations

from pydantic import BaseModel, Field


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


class WaitingModel(BaseModel):
    """What an earlier run has accepted and this one cannot do at present."""

    kind: str = Field(description="stream, annotation, template, transformation, ontology, command")
    name: str = Field(description="what DELETE gives up; of a command nothing does")
    reason: str


class StatusModel(BaseModel):
    """The service at a glance."""

    version: str
    epoch: str = Field(description="the life of the service that ids of samples speak of")
    started: str
    now: str
    streams: int
    templates: int
    requests: int = Field(description="event requests that run")
    queries: int = Field(description="continuous queries that are registered")
    clients: int = Field(description="clients that listen to streams")
    accepted: int = Field(description="samples accepted since the start")
    waiting: list[WaitingModel] = Field(
        description="what an earlier run has accepted and cannot be done at present, but for "
        "requests, subscriptions and queries, which are listed among those that run"
    )


class HealthModel(BaseModel):
    """``ok``; ``degraded``: it works, and some unit has failed; ``failing``, and what is wrong."""

    status: str
    reason: str | None = None
    reasons: list[str] = Field(default=[], description="each cause for itself")


class ExplainModel(BaseModel):
    """Every stage of a query, template, request or match, as text."""

    text: str
