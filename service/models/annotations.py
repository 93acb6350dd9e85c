"""What streams and transformations are about, as JSON."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, Field

from ...languages.ssl.annotation import (
    CheckedAnnotation,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)


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
