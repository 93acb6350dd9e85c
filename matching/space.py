"""What there is to match against: annotated streams, sources, transformations.

A `StreamSpace` is an immutable snapshot that the engine makes for a match; its
indexes make a match cost what is relevant, not what exists.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import TypeVar

from ..languages.ssl.annotation import (
    PortAnnotation,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from ..ontology.vocabulary import THING

_Key = TypeVar("_Key")


@dataclass(frozen=True, slots=True)
class TransformationDescription:
    """``name : inputs ⇒ output`` for objects of ``sort`` ([Introspection15 §4.3]).

    The object passes through: what the inputs say of an object, the output says of the same one.
    ``cost`` (of one more unit) and ``quality`` (0..1, of its output) are for the strategies that
    weigh plans.
    """

    name: str
    inputs: tuple[PortAnnotation, ...]
    output: PortAnnotation
    cost: float = 1.0
    quality: float = 1.0
    sort: str = THING

    @classmethod
    def of(
        cls, annotation: TransformationAnnotation, cost: float = 1.0, quality: float = 1.0
    ) -> TransformationDescription:
        """From an SSL ``compunit`` annotation: for objects of every sort."""
        return cls(annotation.name, annotation.inputs, annotation.output, cost, quality)


@dataclass(frozen=True)
class StreamSpace:
    """The streams, transformations and sources there are, each in the order of registration.

    That order is the order in which matching tries them. A stream with two annotations is there
    twice. Sources provide a feature of ``self``; matching does not start them yet.
    """

    streams: tuple[StreamAnnotation, ...] = ()
    transformations: tuple[TransformationDescription, ...] = ()
    sources: tuple[SourceAnnotation, ...] = ()

    @cached_property
    def streams_by_feature(self) -> Mapping[str, tuple[int, ...]]:
        """Positions in ``streams`` by each feature (IRI) that the stream contains."""
        return _index(
            (content.feature, position)
            for position, stream in enumerate(self.streams)
            for content in stream.contents
        )

    @cached_property
    def streams_by_object(self) -> Mapping[tuple[str, str | None], tuple[int, ...]]:
        """Positions in ``streams`` by (feature, object); object None for features of sorts."""
        return _index(
            ((content.feature, role.object), position)
            for position, stream in enumerate(self.streams)
            for content in stream.contents
            for role in content.roles
        )

    @cached_property
    def transformations_by_output(self) -> Mapping[str, tuple[int, ...]]:
        """Positions in ``transformations`` by output feature (IRI)."""
        return _index((t.output.feature, i) for i, t in enumerate(self.transformations))

    @cached_property
    def sources_by_feature(self) -> Mapping[str, tuple[int, ...]]:
        """Positions in ``sources`` by feature (IRI)."""
        return _index((s.output.feature, i) for i, s in enumerate(self.sources))


def _index(pairs: Iterable[tuple[_Key, int]]) -> Mapping[_Key, tuple[int, ...]]:
    lists: dict[_Key, dict[int, None]] = {}
    for key, position in pairs:
        lists.setdefault(key, {})[position] = None
    return MappingProxyType({key: tuple(positions) for key, positions in lists.items()})
