"""Requests of a template that share one query (DESIGN §3 "Sharing").

Requests share a query if they differ in arguments and read the same streams, or differ only in the
objects that each selects from these streams. The shared plan then selects the objects of all these
requests (`matching.plan.SelectObjects`), so it costs what they need, not what all objects need.
Sharing begins with the second request; the first one goes on by itself.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import TypeAlias

from pyoxigraph import NamedNode, Variable

from ...languages.csparql.ast import ContinuousQuery, EventRequest, Template
from ...languages.templates import AnyTemplate
from ...matching.match import Match
from ...matching.plan import (
    Compute,
    Edge,
    Node,
    SelectObject,
    SelectObjects,
    Supply,
    Synchronize,
    below_of,
    nodes_of_supply,
)
from ...ontology.entailment.rules import Rules
from ...ontology.ontology import Ontology
from ...rdf.dictionary import Term
from ...templates.instantiate import ArgumentError, instantiate
from ...templates.library import TemplateLibrary
from ...templates.needs import NeedsError
from ..model.views import Since
from ..units.sharing.shared_query import TemplateUnit, can_enter
from .plan_execution import Plans
from .reasoning_start import ShareableEvaluation

MIN_SHARED = 2
"""The number of requests from which on one query, formula or pattern evaluates them."""
_MAX_CACHED = 1_000
"""Kinds of requests of one template whose agreement is cached."""


@dataclass(frozen=True, slots=True)
class ShareableQuery:
    """The query that requests with an equal ``key`` can share, over the streams of ``supplies``.
    ``keys`` are all those for which a request counts while it is evaluated alone, ``key`` first.

    ``selections`` are the nodes in ``supplies`` that select the objects of the requests, each with
    the object (an IRI) of this request. Their ``generation`` is the first that the objects can
    enter.
    """

    keys: tuple[Hashable, ...]
    query: ContinuousQuery
    supplies: tuple[Supply, ...]
    selections: tuple[tuple[SelectObjects, str], ...] = ()
    generation: int = 0

    @property
    def key(self) -> Hashable:
        """Equal for requests that can share the query."""
        return self.keys[0]

    @property
    def unit_key(self) -> Hashable:
        """The key of the unit that evaluates the query."""
        return self.key, self.generation

    @property
    def nodes(self) -> tuple[SelectObjects, ...]:
        """The nodes that select objects."""
        return tuple(node for node, _ in self.selections)

    @property
    def objects(self) -> tuple[str, ...]:
        """The objects of the request (IRIs), in the order of the nodes."""
        return tuple(object for _, object in self.selections)


Shareable: TypeAlias = ShareableQuery | ShareableEvaluation


@dataclass(frozen=True, slots=True)
class _Agreements:
    """The parameters on which requests have to agree, by kind of request; None where they cannot
    share. Valid for a template with this text under these rules of the ontology."""

    source: str
    rules: Rules
    by_kind: dict[Hashable, frozenset[str] | None]


class RequestSharing:
    """Finds the query that a request can share, and counts the requests that do not share yet."""

    def __init__(self, ontology: Ontology, templates: TemplateLibrary, plans: Plans) -> None:
        self._ontology = ontology
        self._templates = templates
        self._plans = plans
        self._agreements: dict[str, _Agreements] = {}
        """By the template's name."""
        self._alone: Counter[Hashable] = Counter()

    def find_shareable(
        self,
        template: Template,
        request: EventRequest,
        query: ContinuousQuery,
        matches: Sequence[Match],
        strategy: str,
    ) -> ShareableQuery | None:
        """Return the query that ``request``, with its query and matches, can share; None if there
        is none.

        Cost: another match where the request selects objects; the first request of a kind plans
        the template's query.
        """
        if not query.bindings:
            return None
        own = self._plans.expand_supplies(matches)
        selected = _selected(own, query.bindings)
        alike = self._shareable(template, query, own)
        if not selected or (alike is not None and self._is_begun(alike)):
            return alike
        together = self._select_together(template, request, query, own, selected, strategy)
        if together is None or alike is None:
            return together or alike
        # The next request may have the same objects, or others.
        return replace(together, keys=(together.key, alike.key))

    def _shareable(
        self,
        template: Template,
        query: ContinuousQuery,
        supplies: tuple[Supply, ...],
        selected: frozenset[str] = frozenset(),
    ) -> ShareableQuery | None:
        """Return the query that requests over ``supplies`` share, which select their own terms for
        the parameters ``selected``; None if they cannot share."""
        fixed = self._agreement(template, query, supplies, selected)
        if fixed is None:
            return None
        terms = tuple((v.value, t if v.value in fixed else None) for v, t in query.bindings.items())
        key = (template.source, terms, selected, supplies)
        return ShareableQuery((key,), template.query, supplies)

    def _select_together(
        self,
        template: Template,
        request: EventRequest,
        query: ContinuousQuery,
        own: tuple[Supply, ...],
        selected: frozenset[str],
        strategy: str,
    ) -> ShareableQuery | None:
        """Return the query that requests share which differ in objects that they select from the
        same streams; None if they cannot share."""
        if self._agreement(template, query, own, selected) is None:
            return None
        all_objects = self._supplies_without_selection(template, request, own, selected, strategy)
        if all_objects is None:
            return None
        shareable = self._shareable(template, query, all_objects, selected)
        if shareable is None:
            return None
        # Units behind a selection remember the samples of an object. An object that comes back
        # needs another selection: these units would compute over the gap.
        for generation in count():
            together = _with_selections(own, all_objects, generation)
            if together is None:
                return None
            supplies, selections = together
            found = replace(
                shareable, supplies=supplies, selections=selections, generation=generation
            )
            if self._can_enter(found):
                return found
        raise AssertionError("a generation without running requests takes any object")

    def _is_begun(self, shareable: ShareableQuery) -> bool:
        """Whether a request runs, shared or alone, that can share this."""
        running = self._plans.find_shared(shareable.unit_key)
        return running is not None or self._alone[shareable.key] > 0

    def _can_enter(self, shareable: ShareableQuery) -> bool:
        """Whether the objects of a request can enter the running units of a generation."""
        unit = self._plans.find_shared(shareable.unit_key)
        if isinstance(unit, TemplateUnit):
            return can_enter(unit.selections, shareable.objects)
        running = map(self._plans.queries.selection, shareable.nodes)
        return can_enter(running, shareable.objects)

    def is_worth_it(self, shareable: Shareable) -> bool:
        """Whether one request more makes sharing worth it."""
        return self._alone[shareable.key] + 1 >= MIN_SHARED

    def add_alone(self, shareable: Shareable) -> None:
        """Count a request that is evaluated alone."""
        self._alone.update(shareable.keys)

    def remove_alone(self, shareable: Shareable) -> None:
        """Stop counting a request that was evaluated alone."""
        for key in shareable.keys:
            self._alone[key] -= 1
            if not self._alone[key]:
                del self._alone[key]

    def forget(self, template: AnyTemplate) -> None:
        """Drop the cache of a removed template."""
        self._agreements.pop(template.name, None)

    def _agreement(
        self,
        template: Template,
        query: ContinuousQuery,
        supplies: Sequence[Supply],
        selected: frozenset[str],
    ) -> frozenset[str] | None:
        """Return the parameters on which such requests have to agree, or None; cached. Requests
        that differ in one of these would each need a plan of its own over the shared streams."""
        streamed = frozenset(supply.want.feature for supply in supplies)
        parameters = frozenset(variable.value for variable in query.bindings)
        agreements = self._agreements.get(template.name)
        rules = self._ontology.rules
        if (
            agreements is None
            or agreements.source != template.source
            or agreements.rules is not rules
        ):
            agreements = _Agreements(template.source, rules, {})
            self._agreements[template.name] = agreements
        by_kind = agreements.by_kind
        kind = (parameters, selected, streamed)
        if kind not in by_kind:
            if len(by_kind) >= _MAX_CACHED:
                by_kind.clear()
            by_kind[kind] = self._plans.queries.agreement(
                template.query, query.bindings, streamed, selected
            )
        return by_kind[kind]

    def _supplies_without_selection(
        self,
        template: Template,
        request: EventRequest,
        supplies: tuple[Supply, ...],
        selected: frozenset[str],
        strategy: str,
    ) -> tuple[Supply, ...] | None:
        """Match the request with its objects left free. Return the supplies if the request selects
        its own objects from the same streams, else None."""
        arguments = [
            parameter if parameter.value in selected else argument
            for parameter, argument in zip(template.parameters, request.arguments, strict=True)
        ]
        try:
            free = instantiate(template, arguments, self._ontology.vocabulary)
            wants = self._templates.needs(free).wants
        except (ArgumentError, NeedsError):
            # The template needs these arguments to find its objects.
            return None
        matches = self._plans.match_from(wants, strategy, Since.NOW)
        all_objects = self._plans.expand_supplies(matches)
        if len(all_objects) != len(supplies) or _count_reads(all_objects) != _count_reads(supplies):
            return None
        return all_objects


def _selected(supplies: Sequence[Supply], bindings: Mapping[Variable, Term]) -> frozenset[str]:
    """Return the parameters whose objects the plans select from streams of several objects."""
    objects = {
        node.object
        for supply in supplies
        for node in nodes_of_supply(supply)
        if isinstance(node, SelectObject)
    }
    return frozenset(
        variable.value
        for variable, term in bindings.items()
        if isinstance(term, NamedNode) and term.value in objects
    )


def _count_reads(supplies: Sequence[Supply]) -> int:
    """Count the streams with the features read from each: two patterns that want one feature of
    one stream count once."""
    return len(
        {
            (source.node, supply.want.feature, source.port.target)
            for supply in supplies
            for source in supply.sources
        }
    )


class _Selections:
    """Selects the objects of requests in the plans for all objects. Each pair of nodes has one
    result, since a plan shares nodes."""

    def __init__(self, generation: int) -> None:
        self._generation = generation
        self._known: dict[tuple[Node, Node], Node | None] = {}
        self.objects: dict[SelectObjects, str] = {}
        """The object of the request that each selection has to select."""

    def of(self, own: Node, every: Node) -> Node | None:
        """Return ``every``, the node for all objects, with the objects selected that ``own``
        selects. None if the nodes differ in more."""
        # Without recursion: a plan may be some hundred nodes deep.
        waiting = [(own, every)]
        while waiting:
            pair = waiting[-1]
            missing = [each for each in _below(*pair) if each not in self._known]
            if pair in self._known or not missing:
                self._known.setdefault(pair, self._select(*pair))
                waiting.pop()
            else:
                waiting += missing
        return self._known[own, every]

    def _select(self, own: Node, every: Node) -> Node | None:
        if own == every:
            return every
        below = [self._known[pair] for pair in _below(own, every)]
        nodes = [node for node in below if node is not None]
        if len(nodes) < len(below):
            return None
        if isinstance(own, SelectObject):
            selection = SelectObjects(nodes[0], own.id_field, self._generation)
            object = self.objects.setdefault(selection, own.object)
            # A request has one object in each selection, so it cannot select two from one stream.
            return selection if object == own.object else None
        if len(below_of(own)) != len(below_of(every)):
            return None
        match own, every:
            case (Compute(name, parameters=parameters), Compute()):
                if (name, parameters) == (every.transformation, every.parameters):
                    return replace(every, inputs=_edges(every.inputs, nodes))
            case (Synchronize(), Synchronize()):
                return replace(every, inputs=_edges(every.inputs, nodes))
        return None


def _below(own: Node, every: Node) -> Sequence[tuple[Node, Node]]:
    """Return the pairs of nodes that a pair of nodes reads."""
    if own == every:
        return ()
    if isinstance(own, SelectObject):
        return ((own.source, every),)
    return tuple(zip(below_of(own), below_of(every), strict=False))


def _edges(edges: Sequence[Edge], nodes: Sequence[Node]) -> tuple[Edge, ...]:
    """Return the edges from other nodes."""
    return tuple(replace(edge, node=node) for edge, node in zip(edges, nodes, strict=True))


def _with_selections(
    own: Sequence[Supply], all_objects: Sequence[Supply], generation: int
) -> tuple[tuple[Supply, ...], tuple[tuple[SelectObjects, str], ...]] | None:
    """Return the supplies for all objects, with the objects of requests selected where ``own``
    selects its objects, and these selections. None if the plans differ in more."""
    selections = _Selections(generation)
    supplies = []
    for mine, other in zip(own, all_objects, strict=True):
        if len(mine.sources) != len(other.sources):
            return None
        sources = []
        for one, another in zip(mine.sources, other.sources, strict=True):
            node = selections.of(one.node, another.node)
            if node is None:
                return None
            sources.append(replace(another, node=node))
        supplies.append(replace(other, sources=tuple(sources)))
    return tuple(supplies), tuple(selections.objects.items())
