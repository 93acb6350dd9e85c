"""Writes a plan of semantic matching as a specification in XML
([Introspection15 §4.3]: the result of matching is a specification)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import assert_never

from ...languages.specification import Specification, format_specification
from ...languages.ssl.annotation import TransformationAnnotation
from ...matching.plan import (
    Compute,
    Detect,
    Node,
    SelectObject,
    SelectObjects,
    Supply,
    Synchronize,
    UseStream,
)
from ...rdf.namespaces import shorten
from ..catalog.transformation_library import Transformation
from ..configuration.configuration import SELECT_OBJECT, SYNCHRONIZE
from ..planning.unit_shapes import Parameters, Shape, Shapes, is_implied
from .writer import Writer


def plan_text(supply: Supply, transformations: Mapping[str, Transformation]) -> str | None:
    """Write the units of a plan as a specification; without insertions if the plan only reads
    existing streams. None for a plan with an event template: a specification makes no continuous
    query.

    Law: after it was applied, the same plan starts no further unit.
    """
    shapes = _PlanShapes(transformations)
    tops = [shapes.of(source.node) for source in supply.sources]
    if shapes.has_query:
        return None
    insertions = [(shape, None) for shape in dict.fromkeys(tops) if isinstance(shape, Shape)]
    # A reserved name is a reference within the text only.
    elements = Writer({}, lambda shape: f"dyknow_reserved{shape.number}").write(insertions)
    return format_specification(Specification(elements, (), ""))


class _PlanShapes:
    """The shapes of plan nodes."""

    def __init__(self, transformations: Mapping[str, Transformation]) -> None:
        self._shapes = Shapes()
        self._transformations = transformations
        self.has_query = False

    def of(self, node: Node) -> Shape | str:
        """Return the shape of a node, or the name of an existing stream."""
        match node:
            case UseStream(stream):
                return stream
            case SelectObject(source, field, object):
                parameters = (("field", field), ("object", shorten(object)))
                return self._shape_over(SELECT_OBJECT, parameters, (source,))
            case Synchronize(inputs):
                return self._shape_over(SYNCHRONIZE, (), tuple(edge.node for edge in inputs))
            case Compute():
                return self._shape_over(node.transformation, node.parameters, self._inputs(node))
            case Detect() | SelectObjects():
                self.has_query = True
                return ""
            case _:
                assert_never(node)

    def _shape_over(self, type: str, parameters: Parameters, inputs: tuple[Node, ...]) -> Shape:
        return self._shapes.of(type, parameters, tuple(map(self.of, inputs)))

    def _inputs(self, node: Compute) -> tuple[Node, ...]:
        """Return the input nodes of a unit; those behind an implied synchronization, if any."""
        edges = tuple(edge.node for edge in node.inputs)
        transformation = self._transformations.get(node.transformation)
        if transformation is None or not isinstance(
            transformation.annotation, TransformationAnnotation
        ):
            return edges
        fields = [port.field for port in transformation.annotation.inputs]
        if not node.inputs or not is_implied(node.inputs[0], fields):
            return edges
        synchronize = node.inputs[0].node
        assert isinstance(synchronize, Synchronize)
        feeding = {
            port.target_field: edge.node for edge in synchronize.inputs for port in edge.ports
        }
        read = {port.target_field: port.source_field for port in node.inputs[0].ports}
        return tuple(feeding[read[field]] for field in fields)
