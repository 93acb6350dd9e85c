"""The annotated streams and transformations to match against ([Introspection15 §4.1]).

The engine keeps one `StreamSpace` equal to the running system, change by change; its indexes make
a match cost what is relevant, not what exists.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import NamedTuple, TypeAlias, TypeVar

from ..languages.ssl.annotation import (
    Argument,
    Content,
    PortAnnotation,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from ..ontology.units import Unit, UnitError, conversion, format_unit, parse_unit
from ..ontology.vocabulary import SELF
from .subject import Subject
from .want import Want

K = TypeVar("K", bound=Hashable)
_Index: TypeAlias = dict[K, dict[str, None]]
"""Names by key. The inner dictionaries, without values, are sets that keep their order."""

ITSELF = (Argument("self", None, SELF),)
"""The arguments of a source whose annotation gives none: the system itself."""


class Ask(NamedTuple):
    """A feature (IRI) that is needed. ``unit`` None: in whatever unit it stands."""

    feature: str
    unit: str | None


@dataclass(frozen=True)
class TransformationDescription:
    """``name : inputs ⇒ output`` ([Introspection15 §4.3]); a source has no inputs.

    ``cost`` is that of one more unit, ``quality`` (0..1) that of its output, given perfect inputs.
    ``lacks`` gives the reason why it can have no unit (empty: it can).

    ``arguments`` are the objects of the output; empty: those of the inputs, whatever they are.
    ``asks`` are the features and units (as text) of the inputs, each once; ``fed[i]`` is the place
    there of what feeds input i. With ``passes_through`` inputs and output have the same objects.
    """

    name: str
    inputs: tuple[PortAnnotation, ...]
    output: PortAnnotation
    cost: float = 1.0
    quality: float = 1.0
    lacks: str = ""
    arguments: tuple[Argument, ...] = field(init=False, repr=False, compare=False)
    output_unit: str = field(init=False, repr=False, compare=False)
    asks: tuple[Ask, ...] = field(init=False, repr=False, compare=False)
    fed: tuple[int, ...] = field(init=False, repr=False, compare=False)
    passes_through: bool = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # Computed when it is registered, so that matching only looks it up.
        asks = [Ask(port.feature, unit_text(port.unit)) for port in self.inputs]
        distinct = tuple(dict.fromkeys(asks))
        own = (
            self.output.arguments
            or (ITSELF if not self.inputs else ())
            or next((port.arguments for port in self.inputs if port.arguments), ())
        )
        for name, value in (
            ("arguments", own),
            ("output_unit", unit_text(self.output.unit)),
            ("asks", distinct),
            ("fed", tuple(map(distinct.index, asks))),
            ("passes_through", not own),
        ):
            object.__setattr__(self, name, value)

    @classmethod
    def of(
        cls,
        annotation: TransformationAnnotation | SourceAnnotation,
        cost: float = 1.0,
        quality: float = 1.0,
        lacks: str = "",
    ) -> TransformationDescription:
        """From a checked annotation."""
        inputs = annotation.inputs if isinstance(annotation, TransformationAnnotation) else ()
        return cls(annotation.name, inputs, annotation.output, cost, quality, lacks)


@dataclass(frozen=True)
class EventDescription(TransformationDescription, ABC):
    """An event template as a transformation ([Events14 §VI]): what it needs depends on the objects
    of which the event is wanted. ``id_field`` names the object in its stream."""

    id_field: str = "id"

    @abstractmethod
    def wants_of(self, subject: Subject) -> tuple[Want, ...] | None:
        """The wants of its query for ``subject``; None if it cannot give that event."""

    @abstractmethod
    def is_selective(self, subject: Subject) -> bool:
        """Whether it gives the event of just ``subject``, and not of others too."""


@dataclass(frozen=True)
class StreamDescription:
    """A stream: its contents, its quality (0..1), and the cost of one more reader.

    ``maker`` is the transformation whose unit makes it; empty for a stream from outside. ``units``
    are those of ``contents``, as texts.
    """

    name: str
    contents: tuple[Content, ...]
    quality: float = 1.0
    cost: float = 0.0
    maker: str = ""
    units: tuple[str, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        texts = tuple(unit_text(content.unit) for content in self.contents)
        object.__setattr__(self, "units", texts)

    @classmethod
    def of(
        cls, annotation: StreamAnnotation, quality: float = 1.0, cost: float = 0.0
    ) -> StreamDescription:
        """From a checked annotation."""
        return cls(annotation.stream, annotation.contents, quality, cost)


class StreamSpace:
    """The streams and transformations that exist, each in the order of registration.

    Matching tries them in that order; a new description keeps the place of the old one.
    ``subscribers`` returns the present number of readers of a stream. ``version`` grows with every
    change.

    Cost: a change is linear in the contents of what changes, a look-up is one of a dictionary.
    """

    def __init__(
        self,
        streams: Iterable[StreamDescription | StreamAnnotation] = (),
        transformations: Iterable[TransformationDescription] = (),
        subscribers: Callable[[str], int] = lambda _: 0,
    ) -> None:
        self.version = 0
        self.subscribers = subscribers
        self.streams: dict[str, StreamDescription] = {}
        self.transformations: dict[str, TransformationDescription] = {}
        self._order: dict[str, int] = {}
        self._came = 0
        self._holding: _Index[str] = {}
        self._holding_object: _Index[tuple[str, str | None]] = {}
        self._giving: _Index[str] = {}
        for stream in streams:
            self.put_stream(
                StreamDescription.of(stream) if isinstance(stream, StreamAnnotation) else stream
            )
        for transformation in transformations:
            self.put_transformation(transformation)

    def put_stream(self, stream: StreamDescription) -> None:
        """Add a stream, or replace its description."""
        self.discard_stream(stream.name)
        self.version += 1
        self.streams[stream.name] = stream
        if stream.name not in self._order:
            self._came += 1
            self._order[stream.name] = self._came
        for content in stream.contents:
            _enter(self._holding, content.feature, stream.name)
            for role in content.roles:
                _enter(self._holding_object, (content.feature, role.object), stream.name)

    def discard_stream(self, name: str) -> None:
        """Remove a stream that has ended or lost its annotation; a new one keeps its place."""
        stream = self.streams.pop(name, None)
        if stream is None:
            return
        self.version += 1
        for content in stream.contents:
            _leave(self._holding, content.feature, name)
            for role in content.roles:
                _leave(self._holding_object, (content.feature, role.object), name)

    def forget_stream(self, name: str) -> None:
        """Remove a stream and its place: one of the same name would be another stream."""
        self.discard_stream(name)
        self._order.pop(name, None)

    def put_transformation(self, transformation: TransformationDescription) -> None:
        """Add a transformation, or replace its description."""
        before = self.transformations.get(transformation.name)
        if before is not None:
            feature = before.output.feature
            if feature != transformation.output.feature:
                _leave(self._giving, feature, transformation.name)
        self.version += 1
        self.transformations[transformation.name] = transformation
        _enter(self._giving, transformation.output.feature, transformation.name)

    def discard_transformation(self, name: str) -> None:
        """Remove a transformation."""
        transformation = self.transformations.pop(name, None)
        if transformation is not None:
            self.version += 1
            _leave(self._giving, transformation.output.feature, name)

    @property
    def features(self) -> tuple[str, ...]:
        """The features that streams contain, by name."""
        return tuple(sorted(self._holding))

    def holding(self, feature: str) -> Iterable[str]:
        """The streams that contain ``feature`` (an IRI)."""
        return self._holding.get(feature, ())

    def holding_object(self, feature: str, object: str | None) -> Iterable[str]:
        """The streams that contain ``feature`` of one object; None: of every object of a sort."""
        return self._holding_object.get((feature, object), ())

    def giving(self, feature: str) -> Iterable[str]:
        """The transformations whose output is ``feature`` (an IRI)."""
        return self._giving.get(feature, ())

    def place(self, stream: str) -> int:
        """The number of a stream in the order of registration."""
        return self._order[stream]


def _enter(index: _Index[K], key: K, name: str) -> None:
    index.setdefault(key, {})[name] = None


def _leave(index: _Index[K], key: K, name: str) -> None:
    """Remove ``name``, if it is there. Keys come without end, so a key without names is removed."""
    names = index.get(key)
    if names is not None:
        names.pop(name, None)
        if not names:
            del index[key]


@lru_cache(maxsize=4096)
def unit_text(unit: Unit) -> str:
    """The text of a unit, which is cheaper to compare and to look up than the unit."""
    return format_unit(unit)


@lru_cache(maxsize=4096)
def why_not_convertible(source: str, target: str | None) -> str:
    """Why values in ``source`` units cannot be converted to ``target`` units (None: any); empty if
    they can."""
    if target is None or source == target:
        return ""
    try:
        conversion(parse_unit(source), parse_unit(target))
    except UnitError as error:
        return str(error)
    return ""
