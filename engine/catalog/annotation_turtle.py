"""Annotations as Turtle, in the shape of [Introspection15 Listing 3].

Law (tests/laws/languages/test_annotations.py): `transformation_turtle.read_annotations` of what is
written here describes the same annotations. Listing 3 has no words for the order of arguments,
their aliases and id fields: these stand in a list, `:hasArguments`.
"""

from __future__ import annotations

from collections.abc import Iterable

from pyoxigraph import Literal

from ...languages.ssl.annotation import (
    CheckedAnnotation,
    PortAnnotation,
    SourceAnnotation,
    StreamAnnotation,
)
from ...ontology.units import Unit, format_unit
from ...ontology.vocabulary import SELF
from ...rdf.namespaces import STREAM_SPACE

_PREFIX = f"@prefix : <{STREAM_SPACE}> .\n"


def format_annotations(annotations: Iterable[CheckedAnnotation]) -> str:
    """Annotations of streams, sources and units as one Turtle text."""
    return _PREFIX + "".join(f"\n{_described(annotation)} .\n" for annotation in annotations)


def _described(annotation: CheckedAnnotation) -> str:
    if isinstance(annotation, StreamAnnotation):
        segments = [
            _segment(
                content.feature,
                content.field,
                content.unit,
                [_argument(role.object, role.sort, role.id_field, None) for role in content.roles],
            )
            for content in annotation.contents
        ]
        said = _chain("hasOutputAnnotation", segments)
        return f"[] a :Stream ; :hasName {_text(annotation.stream)} ; :hasAnnotation [ {said} ]"
    said = f":hasOutputAnnotation {_port(annotation.output)}"
    if not isinstance(annotation, SourceAnnotation):
        inputs = [_port(port) for port in annotation.inputs]
        said += f" ; {_chain('hasInputAnnotation', inputs)}"
    name = _text(annotation.name)
    return f"[] a :Transformation ; :hasName {name} ; :hasAnnotation [ {said} ]"


def _chain(link: str, segments: list[str]) -> str:
    """Segments in order, each next one by `:nextSegment`."""
    said = ""
    for segment in reversed(segments):
        following = f" ; :nextSegment [ {said} ]" if said else ""
        said = f":{link} {segment[:-2]}{following} ]"
    return said


def _port(port: PortAnnotation) -> str:
    arguments = [
        _argument(each.object, each.sort, each.id_field, each.variable) for each in port.arguments
    ]
    return _segment(port.feature, port.field, port.unit, arguments)


def _segment(feature: str, field: str, unit: Unit, arguments: list[str]) -> str:
    said = f":describesFeature <{feature}> ; :hasName {_text(field)}"
    said += f" ; :hasUnit {_text(format_unit(unit))}"
    if arguments:
        said += f" ; :hasArguments ( {' '.join(arguments)} )"
    return f"[ {said} ]"


def _argument(object: str | None, sort: str | None, id: str | None, variable: str | None) -> str:
    link = "describesSort" if object is None else "describesObject"
    said = f":{link} <{object or sort or SELF}>"
    if id is not None:
        said += f" ; :hasIdField {_text(id)}"
    if variable is not None:
        said += f" ; :hasName {_text(variable)}"
    return f"[ {said} ]"


def _text(text: str) -> str:
    return str(Literal(text))
