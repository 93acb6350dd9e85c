"""Requests of a template whose body is a formula or pattern, which differ in an object: which one
evaluation serves them (DESIGN §3 "Sharing").

The object's samples must be selected from streams that have those of all objects, and the formula
or pattern must be that of all objects with this one put in. Then an evaluation with the object left
free finds the same results, object by object.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from pyoxigraph import NamedNode, Variable

from ...continuous.sharing.similar_queries import Unshared
from ...languages.csparql.ast import EventRequest
from ...languages.errors import LanguageError
from ...languages.templates import AnyTemplate
from ...matching.match import Match
from ...matching.plan import Node, SelectObject, Supply
from ...matching.want import Want
from ...rdf.dictionary import Term
from ...reasoning.mtl.formulas import is_of_one_object
from ...reasoning.patterns.plans.by_object import pattern_by_object
from ...reasoning.patterns.plans.query import Part
from ...templates.event_patterns import BoundPattern
from ...templates.formulas import BoundFormula
from ...templates.instantiate import ArgumentError
from ...templates.library import TemplateLibrary
from ...templates.needs import NeedsError
from ...templates.reasoning import Bound
from ..model.views import Since
from .pattern_start import argument_of
from .plan_execution import Plans
from .reasoning_start import EvaluationByObject, ShareableEvaluation


class ObjectSharing:
    """Finds the formula or pattern that a request can share."""

    def __init__(self, templates: TemplateLibrary, plans: Plans) -> None:
        self._templates = templates
        self._plans = plans

    def find_shareable(
        self,
        template: AnyTemplate,
        request: EventRequest,
        bound: Bound,
        matches: Sequence[Match],
        strategy: str,
    ) -> ShareableEvaluation:
        """Return what ``request``, with its formula or pattern and matches, can share; raise
        `Unshared`, with the reason, if there is nothing. Cost: another match."""
        own = self._plans.expand_supplies(matches)
        object = _object_of(own)
        if object is None:
            raise Unshared("its streams are not those of many objects, with one selected")
        free = self._without(template, request, object)
        evaluation, place = _of_object(free, bound, object)
        all_objects = self._plans.expand_supplies(
            self._plans.match_from(free.needs.wants, strategy, Since.NOW)
        )
        if not _select_from(own, all_objects, place):
            raise Unshared("a request for all objects would read other streams")
        key = (template.source, evaluation, all_objects)
        return ShareableEvaluation(key, evaluation, object, bound, free, all_objects)

    def _without(self, template: AnyTemplate, request: EventRequest, object: str) -> Bound:
        """The formula or pattern of the request with its object left free."""
        named = [argument == NamedNode(object) for argument in request.arguments]
        if named.count(True) != 1:
            raise Unshared("the object is no argument of it, or several")
        arguments: list[Term | Variable] = [
            parameter if is_object else argument
            for parameter, argument, is_object in zip(
                template.parameters, request.arguments, named, strict=True
            )
        ]
        try:
            free = self._templates.instantiate(template, arguments)
        except (ArgumentError, NeedsError, LanguageError) as error:
            raise Unshared(
                "the template needs the object to find its streams, or as a value"
            ) from error
        assert isinstance(free, Bound)
        return free


def _of_object(
    free: Bound, own: Bound, object: str
) -> tuple[EvaluationByObject, Callable[[Want], int]]:
    """What serves all objects, and which argument of a want is the object."""
    if isinstance(free, BoundFormula):
        if not is_of_one_object(free.monitor):
            raise Unshared("the formula is about further objects")
        if free.monitor.once and free.monitor.policy.period is not None:
            raise Unshared("a single start on a grid has one verdict, which ends its stream")
        return free.open, lambda want: 0
    assert isinstance(own, BoundPattern)
    if _reads_fields(own) or _reads_fields(free):
        # Their kinds are known only once the streams run.
        raise Unshared("the pattern reads fields of streams by name")
    pattern = pattern_by_object(free.query({}), own.query({}), object)
    if pattern is None:
        raise Unshared(
            "the pattern has alternatives, static triples or a maximal delay, or reads samples of "
            "other objects"
        )
    return pattern, lambda want: argument_of(free.sources[want], pattern.column)


def _object_of(supplies: Sequence[Supply]) -> str | None:
    """The object whose samples all plans select; None if there is none, or several."""
    nodes = [source.node for supply in supplies for source in supply.sources]
    objects = {node.object if isinstance(node, SelectObject) else None for node in nodes}
    return objects.pop() if len(objects) == 1 else None


def _reads_fields(bound: BoundPattern) -> bool:
    """Whether it reads fields by name."""
    columns = (column for source in bound.sources.values() for column in source.columns)
    return any(column.part is Part.FIELD for column in columns)


def _select_from(
    own: Sequence[Supply], all_objects: Sequence[Supply], place_in: Callable[[Want], int]
) -> bool:
    """Whether each of the ``own`` streams selects from the same one of all objects, by the field
    that names the object, and no two select from one by different fields."""
    if len(own) != len(all_objects):
        return False
    selected: dict[Node, str] = {}
    for mine, others in zip(own, all_objects, strict=True):
        if len(mine.sources) != len(others.sources):
            return False
        place = place_in(others.want)
        for one, other in zip(mine.sources, others.sources, strict=True):
            node = one.node
            is_selected = (
                isinstance(node, SelectObject)
                and node.source == other.node
                and one.port == other.port
                and other.roles[place].id_field == node.id_field
                and other.roles[place].object is None
                and _rest(one.roles, place) == _rest(other.roles, place)
            )
            if not is_selected:
                return False
            assert isinstance(node, SelectObject)
            if selected.setdefault(other.node, node.id_field) != node.id_field:
                return False
    return True


def _rest(roles: Sequence[object], place: int) -> list[object]:
    return [each for i, each in enumerate(roles) if i != place]
