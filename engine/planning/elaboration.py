"""Elaborates a specification to the shapes of its units ([Introspection15 §3.2]).

It checks each `cu`: transformation, parameters, inputs, and the field that feeds each input. Errors
have a place in the text. It starts nothing; `specifications` starts the elaborated units.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from ...languages.errors import LanguageError, Span
from ...languages.hints import did_you_mean
from ...languages.kpl import format_policy, parse_policy
from ...languages.specification import (
    Input,
    Parameter,
    StreamReference,
    UnitSpecification,
)
from ...languages.specification.ast import elements_of, is_reserved
from ...languages.ssl.annotation import Content
from ...matching.plan import Compute, SelectObject, Synchronize, contents_of
from ...matching.space import TransformationDescription
from ...ontology.vocabulary import Vocabulary
from ...rdf.namespaces import shorten
from ...streams.generator import StreamGenerator
from ..catalog.name_resolution import iri_of
from ..catalog.transformation_library import Transformation, Transformations
from ..configuration.configuration import POLICY, SELECT_OBJECT, SYNCHRONIZE, Configuration
from ..configuration.policy_keys import annotated_contents
from ..model.errors import DyknowError, UnknownFeature, UnknownStream
from ..units.base import ComputationalUnit
from .unit_shapes import MAX_CHAIN, RunningShapes, Shape
from .wiring import (
    Fields,
    InputStream,
    WiringError,
    compute_node,
    fields_of,
    select_node,
    synchronize_node,
)

SYSTEM = {SELECT_OBJECT: ("field", "object"), SYNCHRONIZE: (), POLICY: ("policy",)}
"""The transformations of the system that a specification can name, with their parameters."""


@dataclass(frozen=True, slots=True, eq=False)
class ElaboratedUnit:
    """An element and its elaboration."""

    element: UnitSpecification
    piece: InputStream

    @property
    def shape(self) -> Shape:
        """The shape of its unit."""
        assert isinstance(self.piece.what, Shape)
        return self.piece.what


class Elaboration:
    """Elaborates the insertions of one text, ``source``.

    ``removed`` are units that the same text removes. ``restoring``: the text is from an earlier
    run, so reserved names in it mean nothing now.
    """

    def __init__(
        self,
        source: str,
        vocabulary: Vocabulary,
        transformations: Transformations,
        configuration: Configuration,
        running: RunningShapes,
        removed: Collection[ComputationalUnit],
        *,
        restoring: bool,
    ) -> None:
        self._source = source
        self._vocabulary = vocabulary
        self._transformations = transformations
        self._configuration = configuration
        self._running = running
        self._removed = removed
        self._restoring = restoring
        self._named: dict[str, UnitSpecification] = {}
        self._pieces: dict[int, InputStream] = {}

    def elaborate(self, insertions: Sequence[UnitSpecification]) -> tuple[ElaboratedUnit, ...]:
        """Elaborate all elements of the text, in order of dependency. Raises `LanguageError`."""
        self._named = {one.name: one for one in elements_of(insertions) if one.name is not None}
        elaborated = []
        for element in self._in_order(insertions):
            piece = self._pieces[id(element)] = self._piece(element)
            elaborated.append(ElaboratedUnit(element, piece))
        return tuple(elaborated)

    # -- order -------------------------------------------------------------------------------

    def _in_order(self, insertions: Sequence[UnitSpecification]) -> Iterable[UnitSpecification]:
        """Yield the elements, inputs first. An explicit stack, since references by name can make
        chains longer than Python's recursion limit."""
        done: dict[int, bool] = {}
        for top in insertions:
            # An earlier element may have read this one by its name.
            stack = [] if id(top) in done else [(top, iter(top.inputs))]
            done.setdefault(id(top), False)
            while stack:
                element, rest = stack[-1]
                for source in rest:
                    below = self._element(source)
                    if below is None or done.get(id(below)):
                        continue
                    # The element is on the stack and not done, so it reads itself.
                    if id(below) in done:
                        raise self._cycle_error([one for one, _ in stack], below, source.span)
                    done[id(below)] = False
                    stack.append((below, iter(below.inputs)))
                    break
                else:
                    stack.pop()
                    done[id(element)] = True
                    yield element

    def _element(self, source: Input) -> UnitSpecification | None:
        return self._named.get(source.name) if isinstance(source, StreamReference) else source

    def _cycle_error(
        self, path: Sequence[UnitSpecification], back: UnitSpecification, span: Span
    ) -> LanguageError:
        start = next(i for i, element in enumerate(path) if element is back)
        names = [f"`{element.name or element.type}`" for element in (*path[start:], back)]
        return LanguageError(
            f"units read each other in a circle: {' reads '.join(names)}",
            self._source,
            span,
            "let one of them read a stream that exists without it",
        )

    # -- one element -------------------------------------------------------------------------

    def _piece(self, element: UnitSpecification) -> InputStream:
        pieces = [self._input(source) for source in element.inputs]
        try:
            match element.type:
                case "selectObject":
                    piece = self._selection(element, pieces)
                case "synchronize":
                    self._check_parameters(element)
                    piece = self._unit(element, pieces, (), synchronize_node(pieces))
                case "policy":
                    piece = self._adaptation(element, pieces)
                case _:
                    piece = self._transformation(element, pieces)
        except WiringError as error:
            span = element.span if error.input is None else element.inputs[error.input].span
            raise LanguageError(error.message, self._source, span, error.hint) from error
        assert isinstance(piece.what, Shape)
        if piece.what.chain > MAX_CHAIN:
            raise LanguageError(
                f"a chain of more than {MAX_CHAIN} units read each other here",
                self._source,
                element.span,
                "combine several units of the chain into one",
            )
        return piece

    def _unit(
        self,
        element: UnitSpecification,
        pieces: Sequence[InputStream],
        parameters: tuple[tuple[str, str], ...],
        recipe: Compute | SelectObject | Synchronize,
    ) -> InputStream:
        inputs = self._inputs(pieces, recipe)
        shape = self._running.shapes.of(element.type, parameters, inputs)
        return InputStream(shape, contents_of(recipe), fields_of(recipe, pieces), recipe)

    def _inputs(
        self, pieces: Sequence[InputStream], recipe: Compute | SelectObject | Synchronize
    ) -> tuple[Shape | str, ...]:
        """The inputs of a shape as `RunningShapes` has them: one for each input of the
        transformation, or a single stream that feeds all."""
        inputs = tuple(piece.what for piece in pieces)
        if not isinstance(recipe, Compute) or len(pieces) < 2 or len(recipe.inputs) == 0:
            return inputs
        return inputs if isinstance(recipe.inputs[0].node, Synchronize) else inputs[:1]

    def _selection(self, element: UnitSpecification, pieces: Sequence[InputStream]) -> InputStream:
        by_name = self._check_parameters(element)
        self._check_one_input(element, pieces)
        object = by_name["object"]
        try:
            iri = iri_of(object.value)
        except (LanguageError, UnknownFeature) as error:
            text = error.message if isinstance(error, LanguageError) else error.detail
            raise self._error(object.span or element.span, f"`object`: {text}") from error
        field = by_name["field"].value.strip()
        parameters = (("field", field), ("object", shorten(iri)))
        return self._unit(element, pieces, parameters, select_node(pieces[0], field, iri))

    def _adaptation(self, element: UnitSpecification, pieces: Sequence[InputStream]) -> InputStream:
        parameter = self._check_parameters(element)["policy"]
        self._check_one_input(element, pieces)
        try:
            policy = parse_policy(parameter.value)
        except LanguageError as error:
            place = f"column {error.column} of the policy"
            raise self._error(
                parameter.span or element.span, f"{place}: {error.message}", error.hint
            ) from error
        if policy.is_default:
            raise self._error(
                parameter.span or element.span,
                "the policy has no constraint",
                "write constraints as after `with` in KPL: any change, max delay 5s",
            )
        (piece,) = pieces
        parameters = (("policy", format_policy(policy)),)
        shape = self._running.shapes.of(element.type, parameters, (piece.what,))
        return InputStream(shape, piece.contents, piece.fields, policy)

    def _transformation(
        self, element: UnitSpecification, pieces: Sequence[InputStream]
    ) -> InputStream:
        transformation = self._transformations.get(element.type)
        if transformation is None:
            raise self._unknown_transformation(element)
        overriding = self._overriding(element, transformation)
        description = TransformationDescription.of(transformation.annotation)
        node = compute_node(description, pieces, self._vocabulary)
        return self._unit(element, pieces, overriding, replace(node, parameters=overriding))

    def _unknown_transformation(self, element: UnitSpecification) -> LanguageError:
        names = (*self._transformations, *SYSTEM)
        return LanguageError(
            f"there is no transformation called `{element.type}`",
            self._source,
            element.span,
            did_you_mean(element.type, names) or f"there are: {', '.join(names)}",
        )

    # -- parameters --------------------------------------------------------------------------

    def _check_parameters(self, element: UnitSpecification) -> dict[str, Parameter]:
        """Return the parameters of a system transformation, which has to have exactly its own."""
        own_names = SYSTEM[element.type]
        names = ", ".join(own_names) or "none"
        for parameter in element.parameters:
            if parameter.name not in own_names:
                raise self._error(
                    parameter.span or element.span,
                    f"`{element.type}` has no parameter `{parameter.name}`",
                    f"its parameters are: {names}",
                )
        by_name = {parameter.name: parameter for parameter in element.parameters}
        for name in own_names:
            if name not in by_name:
                raise self._error(
                    element.span,
                    f"`{element.type}` has no `{name}`",
                    f'add <spec:parameter name="{name}" value="…" />',
                )
        return by_name

    def _check_one_input(self, element: UnitSpecification, pieces: Sequence[InputStream]) -> None:
        if len(pieces) != 1:
            raise self._error(
                element.span,
                f"`{element.type}` takes 1 input, and has {len(pieces) or 'none'} here",
                "write one `cu` or `stream`",
            )

    def _overriding(
        self, element: UnitSpecification, transformation: Transformation
    ) -> tuple[tuple[str, str], ...]:
        """Return the parameters that differ from the transformation's own."""
        values = {parameter.name: parameter.value for parameter in element.parameters}
        try:
            self._check(transformation, values)
        except DyknowError as error:
            at_fault = self._parameter_at_fault(element, transformation, values)
            raise self._error(
                at_fault or element.span,
                f"no unit can be made of `{transformation.name}`: {error.detail}",
                error.hint or "see GET /transformations",
            ) from error
        own = self._transformations.parameters_of(transformation)
        return tuple(
            sorted((name, value) for name, value in values.items() if own.get(name) != value)
        )

    def _check(self, transformation: Transformation, values: dict[str, str]) -> None:
        self._transformations.check(
            replace(transformation, parameters={**transformation.parameters, **values})
        )

    def _parameter_at_fault(
        self, element: UnitSpecification, transformation: Transformation, values: dict[str, str]
    ) -> Span | None:
        """Find the parameter whose absence removes the error."""
        for parameter in element.parameters:
            others = {name: value for name, value in values.items() if name != parameter.name}
            try:
                self._check(transformation, others)
            except DyknowError:
                continue
            return parameter.span
        return None

    # -- streams -----------------------------------------------------------------------------

    def _input(self, source: Input) -> InputStream:
        element = self._element(source)
        if element is not None:
            return self._pieces[id(element)]
        assert isinstance(source, StreamReference)
        return self._stream(source)

    def _stream(self, reference: StreamReference) -> InputStream:
        """A stream that exists already."""
        generator = self._find_stream(reference)
        unit = self._configuration.units.get(generator.name)
        if unit is not None and unit in self._removed:
            raise self._error(
                reference.span,
                f"stream `{reference.name}` is removed by this text",
                "read another one, or leave the removal out",
            )
        if unit is not None and self._running.is_broken(unit):
            why = unit.failure or "a unit that it depends on has failed"
            raise self._error(
                reference.span,
                f"stream `{reference.name}` gets no more samples: {why}",
                "remove the unit that makes it, and insert it again",
            )
        fields: Fields = {field.name: field.type for field in generator.schema.fields}
        producer = self._running.producer(generator)
        what = generator.name if producer is None else self._running.shape_of[generator.name]
        return InputStream(what, self._contents_of(generator), fields)

    def _find_stream(self, reference: StreamReference) -> StreamGenerator:
        try:
            if self._restoring and is_reserved(reference.name):
                raise UnknownStream("the system named it in an earlier run")
            return self._configuration.stream(reference.name)
        except UnknownStream:
            names = (*self._named, *self._configuration.streams, *self._configuration.aliases)
            raise self._error(
                reference.span,
                f"there is no stream called `{reference.name}`, nor a `cu` of that name here",
                did_you_mean(reference.name, names) or "GET /streams shows all",
            ) from None

    def _contents_of(self, generator: StreamGenerator) -> tuple[Content, ...]:
        generator = self._configuration.unadapted(generator)
        unit = self._running.producer(generator)
        match None if unit is None else self._configuration.key_of(unit):
            case (Compute() | SelectObject() | Synchronize() as node, _):
                return contents_of(node)
            case _:
                return annotated_contents(self._configuration, generator.name)

    def _error(self, span: Span, message: str, hint: str = "") -> LanguageError:
        return LanguageError(
            message, self._source, span, hint or "see docs/reference/specifications.md"
        )
