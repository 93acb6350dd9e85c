"""Annotations in IRIs: what SSL says, for terms that SSL has no names for ([Introspection15 §4.3]).

JSON and Turtle descriptions are read into `Described` values; `Describer` checks them against the
ontology and makes the annotations that SSL texts make.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ..languages.ssl.annotation import (
    Argument,
    Content,
    PortAnnotation,
    Role,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from ..languages.ssl.check import variable_name
from ..matching.plan import ssl_of
from ..matching.words import port_words
from ..ontology.units import DIMENSIONLESS, Unit, UnitError, dimension, format_unit, parse_unit
from ..ontology.vocabulary import SELF, Vocabulary
from ..rdf.namespaces import shorten
from ..streams.sample import TIME_FIELDS
from .errors import BadArguments, UnknownFeature
from .knowing import did_you_mean, iri_of
from .transformations import Transformation

MOST_INPUTS = 100
"""A transformation has at most so many inputs."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


@dataclass(frozen=True, slots=True)
class DescribedArgument:
    """A sort, an object or ``self``, as a name; ``alias`` tells two of a sort apart, ``id`` is the
    field that names the object."""

    name: str
    alias: str | None = None
    id: str | None = None


@dataclass(frozen=True, slots=True)
class DescribedPort:
    """A field with the feature in it; ``unit`` None: the feature's own."""

    feature: str
    field: str | None = None
    unit: str | None = None
    arguments: tuple[DescribedArgument, ...] = ()


@dataclass(frozen=True, slots=True)
class DescribedTransformation:
    """A transformation in names; a source has no ``inputs``. Without ``implementation`` the code
    has the name of the transformation."""

    name: str
    inputs: tuple[DescribedPort, ...]
    output: DescribedPort
    implementation: str | None = None
    parameters: Mapping[str, str] = field(default_factory=dict)
    cost: float = 1.0
    quality: float = 1.0


@dataclass(frozen=True, slots=True)
class DescribedStream:
    """What a stream contains, in names."""

    stream: str
    contents: tuple[DescribedPort, ...]


class Describer:
    """Checks descriptions against a vocabulary.

    Its methods raise `UnknownFeature` for names that the ontology does not know, `BadArguments`
    for units that contradict it and for descriptions that do not hold together.
    """

    def __init__(self, vocabulary: Vocabulary) -> None:
        self._vocabulary = vocabulary

    def transformation(self, described: DescribedTransformation) -> Transformation:
        """The transformation that is described."""
        if not _NAME.match(described.name):
            raise BadArguments(
                f"{described.name!r} is no name of a transformation",
                "letters, digits and _; the first is a letter",
            )
        check_inputs(len(described.inputs))
        inputs = self._inputs(described.inputs)
        given = {argument.variable for port in inputs for argument in port.arguments}
        if any(not port.arguments for port in inputs):
            # Such an input speaks of what the output speaks of.
            given |= {variable_name(argument.name) for argument in described.output.arguments}
        output = self._output(described.output, given)
        annotation: TransformationAnnotation | SourceAnnotation
        words = ", ".join(map(port_words, inputs)) or "∅"
        source = f"{described.name} : {words} ⇒ {port_words(output)}"
        if inputs:
            annotation = TransformationAnnotation(described.name, inputs, output, source)
        else:
            annotation = SourceAnnotation(described.name, output, source)
        return Transformation(
            annotation,
            described.implementation or described.name,
            dict(described.parameters),
            described.cost,
            described.quality,
        )

    def stream(self, described: DescribedStream) -> StreamAnnotation:
        """The annotation of a stream that is described."""
        contents = tuple(self._content(content) for content in described.contents)
        if not contents:
            raise BadArguments("an annotation says of at least one field what it contains")
        for i, content in enumerate(contents):
            if any((c.feature, c.roles) == (content.feature, content.roles) for c in contents[:i]):
                raise BadArguments(
                    f"{shorten(content.feature)} of the same object is described twice",
                    "name each feature of an object once",
                )
        return StreamAnnotation(described.stream, contents, ssl_of(described.stream, contents))

    def _content(self, described: DescribedPort) -> Content:
        feature = self._feature(described.feature)
        roles = tuple(self._role(argument, described) for argument in described.arguments)
        unit = self._unit(feature, described.unit)
        return Content(feature, _field(described), unit, roles)

    def _role(self, argument: DescribedArgument, described: DescribedPort) -> Role:
        sort, object = self._named(argument.name)
        if object == SELF:
            object = self._vocabulary.self_object
        if sort is not None and argument.id is None:
            raise BadArguments(
                f"{described.feature} of every {argument.name}: no field names the object",
                'give "id", the field that names it',
            )
        return Role(sort, object, argument.id)

    def _inputs(self, described: Sequence[DescribedPort]) -> tuple[PortAnnotation, ...]:
        ports = [self._port(port) for port in described]
        fields = [port.field for port in ports]
        for name in fields:
            if fields.count(name) > 1:
                raise BadArguments(f"two inputs are called {name!r}", 'give each its own "field"')
        return tuple(ports)

    def _output(self, described: DescribedPort, given: set[str]) -> PortAnnotation:
        port = self._port(described)
        arguments = tuple(
            argument
            if argument.object is not None or argument.variable in given
            else Argument(argument.variable, argument.sort, None, argument.id_field or "id")
            for argument in port.arguments
        )
        fields = [port.field, *(a.id_field for a in arguments if a.id_field is not None)]
        if len(fields) > len(set(fields)):
            raise BadArguments(
                f"the output of {described.feature} has two fields of one name",
                'give its arguments another "id"',
            )
        return PortAnnotation(port.field, port.feature, port.unit, arguments)

    def _port(self, described: DescribedPort) -> PortAnnotation:
        feature = self._feature(described.feature)
        arguments = []
        for argument in described.arguments:
            sort, object = self._named(argument.name)
            name = variable_name(argument.name) if argument.alias is None else argument.alias
            arguments.append(Argument(name, sort, object, argument.id if sort else None))
        variables = [argument.variable for argument in arguments]
        if len(variables) > len(set(variables)):
            raise BadArguments(
                f"two arguments of {described.feature} have one name", 'give each an "as"'
            )
        unit = self._unit(feature, described.unit)
        return PortAnnotation(_field(described), feature, unit, tuple(arguments))

    def _named(self, name: str) -> tuple[str | None, str | None]:
        """A name as a sort or as an object."""
        iri = SELF if name == "self" else iri_of(name)
        return (iri, None) if self._vocabulary.is_sort(iri) else (None, iri)

    def _feature(self, name: str) -> str:
        iri = iri_of(name)
        known = self._vocabulary
        if not (known.is_feature(iri) or known.is_event(iri)):
            raise UnknownFeature(
                f"the ontology knows no feature {shorten(iri)}",
                did_you_mean(known.suggest(name, "feature"))
                or "declare it in the ontology as a :Feature first",
            )
        return iri

    def _unit(self, feature: str, text: str | None) -> Unit:
        info = self._vocabulary.feature(feature)
        own = None if info is None else info.unit
        if text is None:
            return own or ()
        try:
            unit = parse_unit(text)
            measures = DIMENSIONLESS if own is None else dimension(own)
            same = dimension(unit) == measures
        except UnitError as error:
            raise BadArguments(f"the unit of {shorten(feature)}: {error}") from error
        if not same:
            raise BadArguments(
                f"{shorten(feature)} measures {measures}, but {format_unit(unit)} is "
                f"{dimension(unit)}",
                f"it is in {format_unit(own or ())}: write that or another unit of {measures}",
            )
        return unit


def check_inputs(number: int) -> None:
    """Raises `BadArguments` for more inputs than a transformation may have."""
    if number > MOST_INPUTS:
        raise BadArguments(
            f"a transformation has at most {MOST_INPUTS} inputs, not {number}",
            "let a transformation of some of them stand before it",
        )


def _field(described: DescribedPort) -> str:
    name = described.field or variable_name(described.feature)
    for each in (name, *(argument.id for argument in described.arguments)):
        if each in TIME_FIELDS:
            raise BadArguments(
                f"a field cannot be called {each!r}: that is a sample's time",
                "give the field another name",
            )
    return name
