"""The library of transformations: labels for implementations with parameters
([Introspection15 §3.1]).

A transformation is annotated in SSL like any other; its implementation is a Python factory. The
same implementation with other parameters is another transformation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from ..languages.ssl import check_ssl, parse_ssl
from ..languages.ssl.annotation import TransformationAnnotation
from ..matching.space import TransformationDescription
from ..ontology.vocabulary import Vocabulary
from ..streams.time import format_duration, parse_duration
from .errors import Conflict, UnknownFeature
from .geodesy import SpeedFromCoordinates
from .unit import UnitFunction

Parameters = Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Implementation:
    """A factory of unit functions: ``make(parameters)`` gives a fresh one, with its own state.

    ``arity`` is the number of inputs, in the order of the annotation; ``parameters`` names every
    parameter with its default, as text.
    """

    name: str
    arity: int
    parameters: Parameters
    make: Callable[[Parameters], UnitFunction]


@dataclass(frozen=True, slots=True)
class Transformation:
    """A label for an implementation and its parameters, with what it takes and gives."""

    annotation: TransformationAnnotation
    implementation: Implementation
    parameters: Parameters
    cost: float = 1.0
    quality: float = 1.0

    @property
    def name(self) -> str:
        return self.annotation.name

    @property
    def description(self) -> TransformationDescription:
        """What semantic matching sees."""
        return TransformationDescription.of(self.annotation, self.cost, self.quality)


def _speed_from_coordinates(parameters: Parameters) -> UnitFunction:
    return SpeedFromCoordinates(
        baseline=parse_duration(parameters["baseline"]),
        max_gap=parse_duration(parameters["max_gap"]),
    )


_SPEED_DEFAULTS = SpeedFromCoordinates()

IMPLEMENTATIONS: Mapping[str, Implementation] = MappingProxyType(
    {
        "coordinatesToSpeed": Implementation(
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
"""What can be instantiated, by name."""

LIBRARY = """\
compunit coordinatesToSpeed
  transforms latitude:latitude [deg], longitude:longitude [deg]
  to speed:speed [m.s-1]
"""
"""The transformations that every engine knows from the start, in SSL."""


def library(vocabulary: Vocabulary) -> dict[str, Transformation]:
    """The transformations of `LIBRARY`, with default parameters, by name."""
    checked = check_ssl(parse_ssl(LIBRARY), LIBRARY, vocabulary)
    return {
        annotation.name: described(annotation)
        for annotation in checked
        if isinstance(annotation, TransformationAnnotation)
    }


def described(annotation: TransformationAnnotation) -> Transformation:
    """A transformation from its annotation and the implementation of the same name.

    Raises `UnknownFeature` without such an implementation, `Conflict` for another number of inputs.
    """
    implementation = IMPLEMENTATIONS.get(annotation.name)
    if implementation is None:
        raise UnknownFeature(
            f"there is no implementation called {annotation.name!r}",
            f"known implementations: {', '.join(IMPLEMENTATIONS)}",
        )
    if len(annotation.inputs) != implementation.arity:
        raise Conflict(
            f"{annotation.name} takes {implementation.arity} inputs, "
            f"the annotation gives {len(annotation.inputs)}",
            "name them in the order in which the library's annotation does",
        )
    return Transformation(annotation, implementation, implementation.parameters)
