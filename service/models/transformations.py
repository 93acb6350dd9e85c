"""JSON models of transformations and the ports of annotations ([Introspection15 §3.1, Listing
3])."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from ...engine.catalog.iri_annotations import (
    DescribedArgument,
    DescribedPort,
    DescribedStream,
    DescribedTransformation,
)
from ...engine.catalog.registered_transformations import TransformationView
from ...languages.ssl.annotation import (
    Argument,
    Content,
    PortAnnotation,
    Role,
    SourceAnnotation,
)
from ...ontology.units import format_unit
from ...ontology.vocabulary import SELF
from ...rdf.namespaces import shorten
from .parts import Body, Name, Quality

PORTS = 100
"""The most inputs of a transformation, and arguments of a feature."""


class ArgumentModel(Body):
    """A sort, an object or ``self``. ``as`` is an alias that distinguishes two of one sort; ``id``
    is the field with the object's name. ``every``: the name is a sort's (true) or an object's."""

    model_config = ConfigDict(extra="forbid", serialize_by_alias=True)

    name: Name
    alias: Name | None = Field(None, alias="as")
    id: Name | None = None
    every: bool | None = None


class PortModel(Body):
    """A feature and its field; ``unit`` null: the feature's own."""

    model_config = ConfigDict(extra="forbid", serialize_by_alias=True)

    feature: Name
    field: Name | None = None
    unit: str | None = Field(None, max_length=200, examples=["m.s-1"])
    of: list[Name | ArgumentModel] = Field(
        default_factory=list,
        max_length=PORTS,
        description="the feature's arguments: names of sorts and objects, or JSON objects with "
        "`name`, `as` and `id`",
    )

    @classmethod
    def of_port(cls, port: PortAnnotation) -> PortModel:
        return cls(
            feature=shorten(port.feature),
            field=port.field,
            unit=format_unit(port.unit) or None,
            of=[_argument(argument) for argument in port.arguments],
        )

    @classmethod
    def of_content(cls, content: Content) -> PortModel:
        return cls(
            feature=shorten(content.feature),
            field=content.field,
            unit=format_unit(content.unit),
            of=[_role(role) for role in content.roles],
        )

    def described(self) -> DescribedPort:
        """Convert the port for the engine."""
        arguments = (
            DescribedArgument(one)
            if isinstance(one, str)
            else DescribedArgument(one.name, one.alias, one.id, one.every, one.id is not None)
            for one in self.of
        )
        return DescribedPort(self.feature, self.field, self.unit, tuple(arguments))


class ContentsIn(Body):
    """An annotation in JSON: ``stream`` and ``contents``, or for a transformation ``name``,
    ``inputs`` (none: a source) and ``output``. The other members that GET shows are ignored."""

    stream: Name | None = None
    contents: list[PortModel] | None = Field(None, min_length=1, max_length=1000)
    name: Name | None = None
    inputs: list[PortModel] | None = Field(None, max_length=PORTS)
    output: PortModel | None = None
    kind: Literal["stream", "source", "transformation"] | None = None
    features: list[str] | None = Field(None, max_length=1000)
    source: str | None = None

    def described(self) -> DescribedStream | DescribedTransformation:
        """Convert the annotation for the engine. Raises `ValueError` unless it has one form."""
        of_stream = self.stream is not None and self.contents is not None
        if of_stream == (self.name is not None and self.output is not None):
            raise ValueError("an annotation has either stream and contents, or name and output")
        if self.output is not None:
            inputs = tuple(port.described() for port in self.inputs or ())
            return DescribedTransformation(self.name or "", inputs, self.output.described())
        contents = tuple(port.described() for port in self.contents or ())
        return DescribedStream(self.stream or "", contents)


class TransformationIn(Body):
    """A transformation and its code: ``annotation`` in SSL describes its inputs and output, or
    ``name``, ``inputs`` and ``output`` do."""

    annotation: str | None = Field(
        None,
        max_length=100_000,
        description="one `compunit` or `source` in SSL, instead of name, inputs and output",
    )
    name: Name | None = None
    inputs: list[PortModel] = Field(
        default_factory=list, max_length=PORTS, description="empty for a source"
    )
    output: PortModel | None = None
    implementation: Name | None = Field(None, description="the code; null: the code of its name")
    parameters: dict[Name, bool | int | float | str] = Field(
        default_factory=dict,
        max_length=PORTS,
        description="parameters of the code; missing ones get defaults",
    )
    cost: float = Field(1.0, ge=0, allow_inf_nan=False, description="the cost of one unit")
    quality: Quality = 1.0

    @property
    def texts(self) -> dict[str, str]:
        """The parameters as texts for the engine."""
        return {
            key: str(value).lower() if isinstance(value, bool) else str(value)
            for key, value in self.parameters.items()
        }

    def described(self) -> DescribedTransformation:
        """Convert it for the engine. Contract: it has a name and an output."""
        assert self.name is not None
        assert self.output is not None
        return DescribedTransformation(
            self.name,
            tuple(port.described() for port in self.inputs),
            self.output.described(),
            self.implementation,
            self.texts,
            self.cost,
            self.quality,
        )


class WorthIn(Body):
    """The new cost or quality of a transformation."""

    cost: float | None = Field(None, ge=0, allow_inf_nan=False)
    quality: Quality | None = None


class QualityIn(Body):
    """The new quality of a stream."""

    quality: Quality


class TransformationModel(BaseModel):
    """A transformation and its running units."""

    name: str
    kind: Literal["source", "transformation"]
    text: str = Field(description="its inputs and output, for reading")
    annotation: str = Field(description="the SSL text, or a description in words")
    inputs: list[PortModel]
    output: PortModel
    implementation: str
    parameters: dict[str, str]
    cost: float
    quality: float
    lacks: str = Field(description="why no unit can be made of it; empty if one can")
    units: list[str]

    @classmethod
    def of(cls, view: TransformationView) -> TransformationModel:
        annotation = view.annotation
        is_source = isinstance(annotation, SourceAnnotation)
        inputs = () if isinstance(annotation, SourceAnnotation) else annotation.inputs
        return cls(
            name=view.name,
            kind="source" if is_source else "transformation",
            text=view.text,
            annotation=annotation.source,
            inputs=[PortModel.of_port(port) for port in inputs],
            output=PortModel.of_port(annotation.output),
            implementation=view.implementation,
            parameters=dict(view.parameters),
            cost=view.cost,
            quality=view.quality,
            lacks=view.lacks,
            units=list(view.units),
        )


def _role(role: Role) -> ArgumentModel:
    return _named(role.object, role.sort, role.id_field, None)


def _argument(argument: Argument) -> ArgumentModel:
    return _named(argument.object, argument.sort, argument.id_field, argument.variable)


def _named(
    object: str | None, sort: str | None, id: str | None, variable: str | None
) -> ArgumentModel:
    """Return an argument: an object, or every object of a sort."""
    name = "self" if object == SELF else shorten(object or sort or "")
    return ArgumentModel.model_validate(
        {"name": name, "as": variable, "id": id, "every": object is None}
    )
