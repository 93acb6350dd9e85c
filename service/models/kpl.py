"""JSON models of KPL declarations."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from pydantic import BaseModel, Field

from ...engine.model import views


class DeclarationModel(BaseModel):
    """A KPL declaration and its state."""

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
        description="counters of samples under its policy, and the objects of its set"
    )
    violations: str | None = Field(description="the stream of samples that violated the policy")

    @classmethod
    def of(cls, view: views.DeclarationView) -> DeclarationModel:
        members = {field.name: getattr(view, field.name) for field in fields(view)}
        return cls(**members | {"uses": list(view.uses), "counters": dict(view.counters)})


class OneDeclarationModel(DeclarationModel):
    """A declaration with the declarations that depend on it, users first."""

    used_by: list[str]


class RemovedModel(BaseModel):
    """The removed declarations, users first."""

    removed: list[str]
