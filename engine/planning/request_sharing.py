"""Requests of a template that share one query (DESIGN §3 "Sharing").

Requests share a query if they differ in arguments and read the same streams, or differ only in the
objects that each selects from these streams. Sharing begins with some number of requests: selecting
a few objects is cheaper than computing all.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from pyoxigraph import NamedNode, Variable

from ...languages.csparql.ast import ContinuousQuery, EventRequest, Template
from ...languages.templates import AnyTemplate
from ...matching.match import Match
from ...matching.plan import (
    Compute,
    Node,
    SelectObject,
    Supply,
    Synchronize,
    below_of,
    nodes_of,
    nodes_of_supply,
)
from ...ontology.entailment import Rules
from ...ontology.ontology import Ontology
from ...rdf.dictionary import Term
from ...templates.instantiate import ArgumentError, instantiate
from ...templates.library import TemplateLibrary
from ...templates.needs import NeedsError
from ..model.views import Since
from .plan_execution import Plans
from .reasoning_start import ShareableEvaluation

SAME_STREAMS = 4
"""The number of requests with the same streams from which on one query evaluates them."""
OWN_OBJECTS = 32
"""The same for requests that each select objects of their own."""
_MAX_CACHED = 1_000
"""Kinds of requests of one template whose agreement is cached."""


@dataclass(frozen=True, slots=True)
class ShareableQuery:
    """The query that requests with an equal ``key`` can share, over the streams of ``supplies``;
    worth it from ``least`` requests on.
    """

    key: Hashable
    query: ContinuousQuery
    supplies: tuple[Supply, ...]
    least: int


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
        fixed = self._agreement(template, query, own, selected)
        if fixed is None:
            return None
        supplies = own
        if selected:
            all_objects = self._supplies_without_selection(
                template, request, own, selected, strategy
            )
            if all_objects is None:
                return None
            supplies = all_objects
        terms = tuple((v.value, t if v.value in fixed else None) for v, t in query.bindings.items())
        kind = (template.source, terms, selected, supplies)
        least = OWN_OBJECTS if selected else SAME_STREAMS
        return ShareableQuery(kind, template.query, supplies, least)

    def is_worth_it(self, shareable: Shareable) -> bool:
        """Whether one request more makes sharing worth it."""
        return self._alone[shareable.key] + 1 >= shareable.least

    def add_alone(self, shareable: Shareable) -> None:
        """Count a request that is evaluated alone."""
        self._alone[shareable.key] += 1

    def remove_alone(self, shareable: Shareable) -> None:
        """Stop counting a request that was evaluated alone."""
        self._alone[shareable.key] -= 1
        if not self._alone[shareable.key]:
            del self._alone[shareable.key]

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
        outlines = _Outlines()
        same = all(
            [outlines.of(one.node) for one in mine.sources]
            == [outlines.of(one.node) for one in other.sources]
            for mine, other in zip(supplies, all_objects, strict=True)
        )
        return all_objects if same else None


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


class _Outlines:
    """Numbers nodes by their outline, that is the node without its selections of objects: equal
    outlines have equal numbers. Cost: O(distinct nodes)."""

    def __init__(self) -> None:
        self._numbers: dict[Hashable, int] = {}
        self._known: dict[Node, int] = {}

    def of(self, source: Node) -> int:
        """Return the number of a node's outline."""
        for node in nodes_of(source):
            if node not in self._known:
                self._known[node] = self._number(node)
        return self._known[source]

    def _number(self, node: Node) -> int:
        below = tuple(self._known[each] for each in below_of(node))
        if isinstance(node, SelectObject):
            return below[0]
        outline: Hashable = node
        if isinstance(node, Compute):
            outline = (node.transformation, node.parameters, below)
        elif isinstance(node, Synchronize):
            outline = below
        return self._numbers.setdefault(outline, len(self._numbers))
