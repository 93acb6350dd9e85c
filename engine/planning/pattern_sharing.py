"""Requests of a pattern template that differ in an object: which one evaluation serves them
(DESIGN §3 "Sharing").

The object's samples must be selected from streams that have those of all objects, and the pattern
must be that of all objects with this one put in. Then an evaluation with the object left free finds
the same matches, object by object.
"""

from __future__ import annotations

from collections.abc import Sequence

from pyoxigraph import NamedNode, Variable

from ...languages.csparql.ast import EventRequest
from ...languages.errors import LanguageError
from ...languages.templates import AnyTemplate
from ...matching.match import Match
from ...matching.plan import Node, SelectObject, Supply
from ...rdf.dictionary import Term
from ...reasoning.patterns.plans.by_object import pattern_by_object
from ...reasoning.patterns.plans.query import Part
from ...templates.event_patterns import BoundPattern
from ...templates.instantiate import ArgumentError
from ...templates.library import TemplateLibrary
from ...templates.needs import NeedsError
from ..model.views import Since
from .pattern_start import ShareablePattern, argument_of
from .plan_execution import Plans

SAME_PATTERN = 2
"""The number of requests of one pattern from which on one evaluation serves them."""


class PatternSharing:
    """Finds the pattern that a request can share."""

    def __init__(self, templates: TemplateLibrary, plans: Plans) -> None:
        self._templates = templates
        self._plans = plans

    def find_shareable(
        self,
        template: AnyTemplate,
        request: EventRequest,
        bound: BoundPattern,
        matches: Sequence[Match],
        strategy: str,
    ) -> ShareablePattern | None:
        """Return the pattern that ``request``, with its pattern and matches, can share; None if
        there is none. Cost: another match."""
        own = self._plans.expand_supplies(matches)
        object = _object_of(own)
        if object is None or _reads_fields(bound):
            return None
        free = self._without(template, request, object)
        if free is None or _reads_fields(free):
            return None
        query = bound.query({})
        pattern = pattern_by_object(free.query({}), query, object)
        if pattern is None:
            return None
        all_objects = self._plans.expand_supplies(
            self._plans.match_from(free.needs.wants, strategy, Since.NOW)
        )
        if not _select_from(own, all_objects, free, pattern.column):
            return None
        # The strategy is in the key since an object has one instance, and a request one strategy.
        key = (template.source, pattern, all_objects, strategy)
        return ShareablePattern(key, pattern, object, query, free, all_objects, SAME_PATTERN)

    def _without(
        self, template: AnyTemplate, request: EventRequest, object: str
    ) -> BoundPattern | None:
        """The pattern of the request with its object left free."""
        named = [argument == NamedNode(object) for argument in request.arguments]
        if named.count(True) != 1:
            return None
        arguments: list[Term | Variable] = [
            parameter if is_object else argument
            for parameter, argument, is_object in zip(
                template.parameters, request.arguments, named, strict=True
            )
        ]
        try:
            free = self._templates.instantiate(template, arguments)
        except (ArgumentError, NeedsError, LanguageError):
            # The template needs the object: to find its streams, or as a value.
            return None
        assert isinstance(free, BoundPattern)
        return free


def _object_of(supplies: Sequence[Supply]) -> str | None:
    """The object whose samples all plans select; None if there is none, or several."""
    nodes = [source.node for supply in supplies for source in supply.sources]
    objects = {node.object if isinstance(node, SelectObject) else None for node in nodes}
    return objects.pop() if len(objects) == 1 else None


def _reads_fields(bound: BoundPattern) -> bool:
    """Whether it reads fields by name, whose kinds are known only once the streams run."""
    columns = (column for source in bound.sources.values() for column in source.columns)
    return any(column.part is Part.FIELD for column in columns)


def _select_from(
    own: Sequence[Supply], all_objects: Sequence[Supply], free: BoundPattern, column: str
) -> bool:
    """Whether each of the ``own`` streams selects from the same one of all objects, by the field
    that names the object in ``column``, and no two select from one."""
    if len(own) != len(all_objects):
        return False
    selected: dict[Node, str] = {}
    for mine, others in zip(own, all_objects, strict=True):
        if len(mine.sources) != len(others.sources):
            return False
        place = argument_of(free.sources[others.want], column)
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
