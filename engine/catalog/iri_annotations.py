"""Annotations by IRIs, for terms that SSL cannot name ([Introspection15 §4.3]).

The readers of JSON and Turtle descriptions return `Described…` values. `Describer` checks these
against the ontology and makes the same annotations as SSL texts.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from ...languages.errors import LanguageError
from ...languages.ssl.annotation import (
    Argument,
    Content,
    PortAnnotation,
    Role,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
)
from ...languages.ssl.annotation_text import Annotation, declaration_of, with_ssl_source
from ...languages.ssl.check import check_ssl, variable_name
from ...ontology.units import (
    DIMENSIONLESS,
    Unit,
    UnitError,
    dimension,
    format_unit,
    parse_unit,
)
from ...ontology.vocabulary import SELF, Vocabulary
from ...rdf.namespaces import shorten
from ...streams.sample import TIME_FIELDS
from ..model.errors import BadArguments, UnknownFeature
from .name_resolution import did_you_mean, iri_of
from .transformation_library import Transformation

MOST_INPUTS = 100
"""The greatest number of inputs of a transformation."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*\Z")


@dataclass(frozen=True, slots=True)
class DescribedArgument:
    """The name of a sort, of an object or ``self``. ``alias`` distinguishes two arguments of one
    sort; ``id`` is the field that names the object.

    ``every``: the name is that of a sort (True) or of an object (False). If it is None, the
    ontology decides. A name that the ontology does not know is then that of an object, or an error
    if the name ``must_be_known``. Descriptions in journals of earlier versions have neither.
    """

    name: str
    alias: str | None = None
    id: str | None = None
    every: bool | None = None
    must_be_known: bool | None = None


@dataclass(frozen=True, slots=True)
class DescribedPort:
    """A field and the feature that it holds; ``unit`` None: the feature's own."""

    feature: str
    field: str | None = None
    unit: str | None = None
    arguments: tuple[DescribedArgument, ...] = ()


@dataclass(frozen=True, slots=True)
class DescribedTransformation:
    """A transformation by names; a source has no ``inputs``. Without ``implementation`` the code
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
    """The contents of a stream, by names."""

    stream: str
    contents: tuple[DescribedPort, ...]


class Describer:
    """Checks descriptions against a vocabulary.

    Its methods raise `UnknownFeature` for names that the ontology does not know, and `BadArguments`
    for units that contradict it and for inconsistent descriptions.
    """

    def __init__(self, vocabulary: Vocabulary) -> None:
        self._vocabulary = vocabulary

    def transformation(self, described: DescribedTransformation) -> Transformation:
        """Return the transformation that ``described`` describes."""
        if not _NAME.match(described.name):
            raise BadArguments(
                f"{described.name!r} is not a valid name of a transformation",
                "use letters, digits and _, with a letter first",
            )
        check_inputs(len(described.inputs))
        inputs = self._inputs(described.inputs)
        bound = {argument.variable for port in inputs for argument in port.arguments}
        if any(not port.arguments for port in inputs):
            # An input without arguments is about the objects of the output.
            bound |= {variable_name(argument.name) for argument in described.output.arguments}
        output = self._output(described.output, bound)
        annotation: TransformationAnnotation | SourceAnnotation
        if inputs:
            annotation = self._checked(TransformationAnnotation(described.name, inputs, output, ""))
        else:
            annotation = self._checked(SourceAnnotation(described.name, output, ""))
        return Transformation(
            annotation,
            described.implementation or described.name,
            dict(described.parameters),
            described.cost,
            described.quality,
        )

    def stream(self, described: DescribedStream) -> StreamAnnotation:
        """Return the annotation that ``described`` describes."""
        contents = tuple(self._content(content) for content in described.contents)
        if not contents:
            raise BadArguments("an annotation describes at least one field")
        return self._checked(StreamAnnotation(described.stream, contents, ""))

    def _checked(self, annotation: Annotation) -> Annotation:
        """Return the annotation with its SSL text, after the checks of SSL: both forms obey the
        same rules."""
        written = with_ssl_source(annotation, self._vocabulary)
        try:
            check_ssl([declaration_of(annotation, self._vocabulary)], "", self._vocabulary)
        except LanguageError as error:
            raise BadArguments(error.message, error.hint) from error
        return written

    def _content(self, described: DescribedPort) -> Content:
        feature = self._feature(described.feature)
        roles = tuple(self._role(argument, described) for argument in described.arguments)
        unit = self._unit(feature, described.unit)
        return Content(feature, _field(described), unit, roles)

    def _role(self, argument: DescribedArgument, described: DescribedPort) -> Role:
        sort, object = self._named(argument)
        if object == SELF:
            object = self._vocabulary.self_object
        if sort is not None and argument.id is None:
            raise BadArguments(
                f"{described.feature} of every {argument.name}: no field names the object",
                'set "id" to the field that names it',
            )
        return Role(sort, object, argument.id)

    def _inputs(self, described: Sequence[DescribedPort]) -> tuple[PortAnnotation, ...]:
        ports = [self._port(port, is_input=True) for port in described]
        fields = [port.field for port in ports]
        for name in fields:
            if fields.count(name) > 1:
                raise BadArguments(f"two inputs are called {name!r}", 'give each its own "field"')
        return tuple(ports)

    def _output(self, described: DescribedPort, bound: set[str]) -> PortAnnotation:
        """``bound``: the variables of the inputs' arguments. Only the others need an id field."""
        port = self._port(described)
        arguments = tuple(
            replace(argument, id_field=None)
            if argument.object is not None or argument.variable in bound
            else Argument(argument.variable, argument.sort, None, argument.id_field or "id")
            for argument in port.arguments
        )
        fields = [port.field, *(a.id_field for a in arguments if a.id_field is not None)]
        if len(fields) > len(set(fields)):
            raise BadArguments(
                f"the output of {described.feature} has two fields with the same name",
                'give its arguments another "id"',
            )
        return PortAnnotation(port.field, port.feature, port.unit, arguments)

    def _port(self, described: DescribedPort, *, is_input: bool = False) -> PortAnnotation:
        feature = self._feature(described.feature)
        arguments = []
        for argument in described.arguments:
            sort, object = self._named(argument)
            default = variable_name(argument.name)
            name = argument.alias or default
            if name != default and not _NAME.match(name):
                raise BadArguments(
                    f'{name!r} is not a valid "as" of an argument',
                    "use letters, digits and _, with a letter first",
                )
            id_field = argument.id if sort and not is_input else None
            arguments.append(Argument(name, sort, object, id_field))
        variables = [argument.variable for argument in arguments]
        if len(variables) > len(set(variables)):
            raise BadArguments(
                f"two arguments of {described.feature} have the same name", 'give each an "as"'
            )
        unit = self._unit(feature, described.unit)
        return PortAnnotation(_field(described), feature, unit, tuple(arguments))

    def _named(self, argument: DescribedArgument) -> tuple[str | None, str | None]:
        """Return the IRI that ``argument`` names, as (sort, None) or as (None, object)."""
        name, vocabulary = argument.name, self._vocabulary
        iri = SELF if name == "self" else iri_of(name)
        is_sort = vocabulary.is_sort(iri)
        if argument.every and not is_sort:
            raise BadArguments(
                f"{shorten(iri)} is not a sort of the ontology, and `every` needs one",
                did_you_mean(vocabulary.suggest(name, "sort"))
                or 'write "every": false for an object',
            )
        if is_sort and argument.every is False:
            raise BadArguments(
                f"{shorten(iri)} is a sort, not a single object",
                'leave "every" out, or write "every": true',
            )
        is_known = is_sort or vocabulary.is_object(iri) or iri == SELF
        if argument.every is None and argument.must_be_known and not is_known:
            raise BadArguments(
                f"the ontology knows neither a sort nor an object {shorten(iri)}",
                did_you_mean(vocabulary.suggest(name, "sort"))
                or 'write "every": false if it names one object',
            )
        return (iri, None) if is_sort else (None, iri)

    def _feature(self, name: str) -> str:
        iri = iri_of(name)
        vocabulary = self._vocabulary
        if not (vocabulary.is_feature(iri) or vocabulary.is_event(iri)):
            raise UnknownFeature(
                f"the ontology knows no feature {shorten(iri)}",
                did_you_mean(vocabulary.suggest(name, "feature"))
                or "add it to the ontology first: dyknow ontology add-feature",
            )
        return iri

    def _unit(self, feature: str, text: str | None) -> Unit:
        info = self._vocabulary.feature(feature)
        own = None if info is None else info.unit
        if text is None:
            return own or ()
        try:
            unit = parse_unit(text)
            expected = DIMENSIONLESS if own is None else dimension(own)
            found = dimension(unit)
        except UnitError as error:
            raise BadArguments(f"the unit of {shorten(feature)}: {error}") from error
        if found != expected:
            raise BadArguments(
                f"{shorten(feature)} measures {expected}, but {format_unit(unit)} is {found}",
                f"its unit is {format_unit(own or ())}: write that or another unit of {expected}",
            )
        return unit


def check_inputs(number: int) -> None:
    """Raise `BadArguments` if there are more than `MOST_INPUTS` inputs."""
    if number > MOST_INPUTS:
        raise BadArguments(
            f"a transformation has at most {MOST_INPUTS} inputs, not {number}",
            "combine some of them in another transformation first",
        )


def _field(described: DescribedPort) -> str:
    name = described.field or variable_name(described.feature)
    for each in (name, *(argument.id for argument in described.arguments)):
        if each in TIME_FIELDS:
            raise BadArguments(
                f"a field cannot have the name {each!r}: that is a sample's time",
                "choose another name for the field",
            )
    return name
