"""The library of transformations: labels for implementations with parameters
([Introspection15 §3.1]).

An implementation is built in (`IMPLEMENTATIONS`: vectorized functions) or user-written (`registry`:
a computational unit or a source). The same implementation with other parameters is another
transformation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TypeAlias

from ...languages.ssl import check_ssl, parse_ssl
from ...languages.ssl.annotation import SourceAnnotation, TransformationAnnotation
from ...matching.space import TransformationDescription
from ...ontology.vocabulary import Vocabulary
from ...streams.time import format_duration, parse_duration
from ..model.errors import BadArguments, Conflict, DyknowError, UnknownFeature
from ..processes.geodesy import SpeedFromCoordinates
from ..processes.parameters import bind_parameters
from ..processes.registry import (
    PROCESSES,
    Processes,
    SourceImplementation,
    UnitImplementation,
)
from ..units.function import UnitFunction

Parameters: TypeAlias = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class BuiltIn:
    """A factory of unit functions: ``make(parameters)`` returns a new one, with its own state.

    ``arity`` is the number of inputs, in the order of the annotation; ``parameters`` names every
    parameter with its default, as text.
    """

    name: str
    arity: int
    parameters: Parameters
    make: Callable[[Parameters], UnitFunction]


Implementation: TypeAlias = BuiltIn | UnitImplementation | SourceImplementation


@dataclass(frozen=True, slots=True)
class Transformation:
    """A label for an implementation and its parameters, with the annotation of inputs and output.

    ``parameters`` without a value here have their defaults.
    """

    annotation: TransformationAnnotation | SourceAnnotation
    implementation: str
    parameters: Parameters = field(default_factory=dict)
    cost: float = 1.0
    quality: float = 1.0

    @property
    def name(self) -> str:
        return self.annotation.name


def _speed_from_coordinates(parameters: Parameters) -> UnitFunction:
    return SpeedFromCoordinates(
        baseline=parse_duration(parameters["baseline"]),
        max_gap=parse_duration(parameters["max_gap"]),
    )


_SPEED_DEFAULTS = SpeedFromCoordinates()

IMPLEMENTATIONS: Mapping[str, BuiltIn] = MappingProxyType(
    {
        "coordinatesToSpeed": BuiltIn(
            "coordinatesToSpeed",
            2,
            MappingProxyType(
                {
                    "baseline": format_duration(_SPEED_DEFAULTS.baseline),
                    "max_gap": format_duration(_SPEED_DEFAULTS.max_gap),
                }
            ),
            _speed_from_coordinates,
        )
    }
)
"""The built-in implementations, by name."""

LIBRARY = """\
compunit coordinatesToSpeed
  transforms latitude:latitude [deg], longitude:longitude [deg]
  to speed:speed [m.s-1]
"""
"""The transformations that every engine has from the start, in SSL."""
LIBRARY_NAMES = frozenset({"coordinatesToSpeed"})
"""The names of these transformations."""


class Transformations(Mapping[str, Transformation]):
    """The registered transformations by name, and their implementations."""

    def __init__(self, vocabulary: Vocabulary, processes: Processes = PROCESSES) -> None:
        self._processes = processes
        self._by_name: dict[str, Transformation] = {}
        checked = check_ssl(parse_ssl(LIBRARY), LIBRARY, vocabulary)
        for annotation in checked:
            assert isinstance(annotation, TransformationAnnotation)
            self.put(Transformation(annotation, annotation.name))

    def __getitem__(self, name: str) -> Transformation:
        return self._by_name[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._by_name)

    def __len__(self) -> int:
        return len(self._by_name)

    def put(self, transformation: Transformation) -> None:
        """Add or replace a transformation."""
        self._by_name[transformation.name] = transformation

    def discard(self, name: str) -> None:
        """Remove a transformation."""
        del self._by_name[name]

    def implementation(self, name: str) -> Implementation:
        """Return the implementation called ``name``. Raises `UnknownFeature`."""
        processes = self._processes
        found = (
            IMPLEMENTATIONS.get(name) or processes.units.get(name) or processes.sources.get(name)
        )
        if found is None:
            names = (*IMPLEMENTATIONS, *processes.units, *processes.sources)
            raise UnknownFeature(
                f"there is no implementation called {name!r}",
                f"known implementations: {', '.join(names)}; write one with "
                "@dyknow.computational_unit or @dyknow.source and load its module with --processes",
            )
        return found

    def check(self, transformation: Transformation) -> None:
        """Check that units of ``transformation`` can be made. Raises `UnknownFeature` if there is
        no implementation, `Conflict` if its number of inputs differs from the annotation's, and
        `BadArguments` for wrong parameters."""
        implementation = self.implementation(transformation.implementation)
        inputs = _inputs(transformation)
        match implementation:
            case SourceImplementation():
                fits = not inputs
            case UnitImplementation():
                fits = inputs > 0 and len(implementation.inputs) in (1, inputs)
            case BuiltIn():
                fits = inputs == implementation.arity
        if not fits:
            takes = (
                "no input"
                if isinstance(implementation, SourceImplementation)
                else f"{_arity(implementation)} inputs"
            )
            raise Conflict(
                f"{implementation.name} takes {takes}, but the annotation of {transformation.name} "
                f"has {inputs}",
                "the code takes one input for each of the annotation, or a single one for all",
            )
        self._check_parameters(transformation, implementation)

    def _check_parameters(
        self, transformation: Transformation, implementation: Implementation
    ) -> None:
        texts = transformation.parameters
        if not isinstance(implementation, BuiltIn):
            bind_parameters(implementation.code, texts)
            return
        for name in texts:
            if name not in implementation.parameters:
                raise BadArguments(
                    f"there is no parameter {name!r}",
                    f"its parameters are: {', '.join(implementation.parameters)}",
                )
        try:
            implementation.make({**implementation.parameters, **texts})
        except (TypeError, ValueError) as error:
            raise BadArguments(f"the parameters of {implementation.name}: {error}") from error

    def parameters_of(self, transformation: Transformation) -> Parameters:
        """Return all parameters of its units as text, the defaults included."""
        declared = self.implementation(transformation.implementation).parameters
        texts = {name: text for name, text in declared.items() if text is not None}
        return {**texts, **transformation.parameters}

    def describe(self, transformation: Transformation) -> TransformationDescription:
        """Return the description for semantic matching. Its ``lacks`` is the error of `check`, or
        empty."""
        lacks = ""
        try:
            self.check(transformation)
        except DyknowError as error:
            lacks = error.detail
        return TransformationDescription.of(
            transformation.annotation, transformation.cost, transformation.quality, lacks
        )


def _inputs(transformation: Transformation) -> int:
    annotation = transformation.annotation
    return len(annotation.inputs) if isinstance(annotation, TransformationAnnotation) else 0


def _arity(implementation: BuiltIn | UnitImplementation) -> int:
    if isinstance(implementation, BuiltIn):
        return implementation.arity
    return len(implementation.inputs)
