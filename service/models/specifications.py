"""JSON models of specifications ([Introspection15 §3.2])."""

from __future__ import annotations

from pydantic import BaseModel, Field

from ...engine.model import views
from .events import UnitModel


class SpecificationModel(BaseModel):
    """The changes that a specification made."""

    started: list[UnitModel]
    stopped: list[UnitModel]
    there: list[UnitModel] = Field(description="units of the specification that ran already")
    named: dict[str, str] = Field(description="new names of streams: name to stream")

    @classmethod
    def of(cls, view: views.SpecificationView) -> SpecificationModel:
        return cls(
            started=[UnitModel.of(unit) for unit in view.started],
            stopped=[UnitModel.of(unit) for unit in view.stopped],
            there=[UnitModel.of(unit) for unit in view.there],
            named=dict(view.named),
        )


class InsertionModel(BaseModel):
    """A `cu` that a specification inserted; ``failure`` is the reason why it does not work."""

    name: str | None
    transformation: str
    text: str
    stream: str | None
    unit: str | None
    failure: str | None

    @classmethod
    def of(cls, view: views.InsertionView) -> InsertionModel:
        return cls(
            name=view.name,
            transformation=view.transformation,
            text=view.text,
            stream=view.stream,
            unit=view.unit,
            failure=view.failure,
        )
