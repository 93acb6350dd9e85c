"""Writes annotations as Turtle, in the shape of [Introspection15 Listing 3].

Law (tests/laws/languages/test_annotations.py): `transformation_turtle.read_annotations` reads the
same annotations from the text. Listing 3 has no terms for the order of arguments, their aliases and
id fields; a list, `:hasArguments`, holds these.
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
    """Return annotations of streams, sources and units as one Turtle text."""
    return _PREFIX + "".join(f"\n{_format(annotation)} .\n" for annotation in annotations)


def _format(annotation: CheckedAnnotation) -> str:
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
        body = _chain("hasOutputAnnotation", segments)
        return f"[] a :Stream ; :hasName {_literal(annotation.stream)} ; :hasAnnotation [ {body} ]"
    body = f":hasOutputAnnotation {_port(annotation.output)}"
    if not isinstance(annotation, SourceAnnotation):
        inputs = [_port(port) for port in annotation.inputs]
        body += f" ; {_chain('hasInputAnnotation', inputs)}"
    name = _literal(annotation.name)
    return f"[] a :Transformation ; :hasName {name} ; :hasAnnotation [ {body} ]"


def _chain(link: str, segments: list[str]) -> str:
    """Return the segments in order, linked by `:nextSegment`."""
    chain = ""
    for segment in reversed(segments):
        following = f" ; :nextSegment [ {chain} ]" if chain else ""
        # The link goes inside the segment's own brackets: `segment` ends with " ]".
        chain = f":{link} {segment[:-2]}{following} ]"
    return chain


def _port(port: PortAnnotation) -> str:
    arguments = [
        _argument(each.object, each.sort, each.id_field, each.variable) for each in port.arguments
    ]
    return _segment(port.feature, port.field, port.unit, arguments)


def _segment(feature: str, field: str, unit: Unit, arguments: list[str]) -> str:
    body = f":describesFeature <{feature}> ; :hasName {_literal(field)}"
    body += f" ; :hasUnit {_literal(format_unit(unit))}"
    if arguments:
        body += f" ; :hasArguments ( {' '.join(arguments)} )"
    return f"[ {body} ]"


def _argument(object: str | None, sort: str | None, id: str | None, variable: str | None) -> str:
    link = "describesSort" if object is None else "describesObject"
    body = f":{link} <{object or sort or SELF}>"
    if id is not None:
        body += f" ; :hasIdField {_literal(id)}"
    if variable is not None:
        body += f" ; :hasName {_literal(variable)}"
    return f"[ {body} ]"


def _literal(text: str) -> str:
    return str(Literal(text))
