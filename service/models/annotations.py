"""JSON models of annotations."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from ...languages.ssl.annotation import (
    CheckedAnnotation,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from .transformations import PortModel


class AnnotationModel(BaseModel):
    """The annotation of a stream, source or computational unit."""

    kind: Literal["stream", "source", "transformation"]
    name: str
    features: list[str] = Field(description="IRIs of the features of the stream or the output")
    source: str = Field(description="the SSL text")
    stream: str | None = None
    contents: list[PortModel] | None = None
    inputs: list[PortModel] | None = None
    output: PortModel | None = None

    @classmethod
    def of(cls, annotation: CheckedAnnotation) -> AnnotationModel:
        match annotation:
            case StreamAnnotation():
                return cls(
                    kind="stream",
                    name=annotation.stream,
                    features=[content.feature for content in annotation.contents],
                    source=annotation.source,
                    stream=annotation.stream,
                    contents=[PortModel.of_content(content) for content in annotation.contents],
                )
            case SourceAnnotation() | TransformationAnnotation():
                is_source = isinstance(annotation, SourceAnnotation)
                inputs = () if isinstance(annotation, SourceAnnotation) else annotation.inputs
                return cls(
                    kind="source" if is_source else "transformation",
                    name=annotation.name,
                    features=[annotation.output.feature],
                    source=annotation.source,
                    inputs=[PortModel.of_port(port) for port in inputs],
                    output=PortModel.of_port(annotation.output),
                )
