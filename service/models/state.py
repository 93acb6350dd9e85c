"""JSON models of the service's state."""

from __future__ import annotations

from pydantic import BaseModel, Field


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
    waiting: list[WaitingModel] = Field(
        description="commands that an earlier run accepted and this one cannot execute now; their "
        "own lists have waiting requests, subscriptions and queries"
    )


class HealthModel(BaseModel):
    """``ok``; ``degraded``: it works, but some units failed; ``failing``, with the reasons."""

    status: str
    reason: str | None = None
    reasons: list[str] = Field(default=[], description="the single reasons")


class ExplainModel(BaseModel):
    """The stages of a query, template, request or match, as text."""

    text: str
