"""Which requests of a template one query can serve (DESIGN §3 "Sharing").

Requests share what is computed when their arguments differ and the streams they read are the same;
or differ only in that each selects its own objects from these. It is worth while from some requests
on: a few objects are cheaper selected than all of them computed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

from pyoxigraph import NamedNode, Variable

from ...languages.csparql.ast import ContinuousQuery, EventRequest, Template
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

SAME_STREAMS = 4
"""So many requests that read the same streams are evaluated as one query."""
OWN_OBJECTS = 32
"""So many requests that select objects of their own from the same streams are."""
_REMEMBERED = 1_000
"""Of so many kinds of requests of one template it is kept whether they can share."""


@dataclass(frozen=True, slots=True)
class Common:
    """What requests have in common that can be evaluated as one query.

    ``supplies`` give what all of them read; ``least`` are worth it. Equal ``key``, equal query.
    """

    key: Hashable
    query: ContinuousQuery
    supplies: tuple[Supply, ...]
    least: int


@dataclass(frozen=True, slots=True)
class _Agreements:
    """Of a template with this text, under these rules of the ontology: by kind of request the
    parameters on which they have to agree, None where they cannot share."""

    source: str
    rules: Rules
    known: dict[Hashable, frozenset[str] | None]


class Sharing:
    """Says of a request with whom it could share, and counts those who do not yet."""

    def __init__(self, ontology: Ontology, templates: TemplateLibrary, plans: Plans) -> None:
        self._ontology = ontology
        self._templates = templates
        self._plans = plans
        self._agreements: dict[str, _Agreements] = {}
        """By the template's name."""
        self._alone: Counter[Hashable] = Counter()

    def common(
        self,
        template: Template,
        request: EventRequest,
        query: ContinuousQuery,
        matches: Sequence[Match],
        strategy: str,
    ) -> Common | None:
        """With whom ``request``, whose query and matches these are, can share; None: nobody.

        Cost: another match where the request selects objects; the first request of a kind plans
        the template's query.
        """
        if not query.bindings:
            return None
        own = self._plans.made_from(matches)
        selected = _selected(own, query.bindings)
        fixed = self._agreement(template, query, own, selected)
        if fixed is None:
            return None
        supplies = own
        if selected:
            every = self._unselected(template, request, own, selected, strategy)
            if every is None:
                return None
            supplies = every
        terms = tuple((v.value, t if v.value in fixed else None) for v, t in query.bindings.items())
        kind = (template.source, terms, selected, supplies)
        least = OWN_OBJECTS if selected else SAME_STREAMS
        return Common(kind, template.query, supplies, least)

    def is_worth_it(self, common: Common) -> bool:
        """Whether one request more makes enough of them."""
        return self._alone[common.key] + 1 >= common.least

    def began_alone(self, common: Common) -> None:
        """A request has a query of its own."""
        self._alone[common.key] += 1

    def ended_alone(self, common: Common) -> None:
        """A request that had a query of its own has ended."""
        self._alone[common.key] -= 1
        if not self._alone[common.key]:
            del self._alone[common.key]

    def forget(self, template: Template) -> None:
        """``template`` is gone."""
        self._agreements.pop(template.name, None)

    def _agreement(
        self,
        template: Template,
        query: ContinuousQuery,
        supplies: Sequence[Supply],
        selected: frozenset[str],
    ) -> frozenset[str] | None:
        """The parameters on which such requests have to agree to share the template's query, or
        None; found once. (Others would have a plan each over what all of them read.)"""
        streamed = frozenset(supply.want.feature for supply in supplies)
        given = frozenset(variable.value for variable in query.bindings)
        agreements = self._agreements.get(template.name)
        rules = self._ontology.rules
        if (
            agreements is None
            or agreements.source != template.source
            or agreements.rules is not rules
        ):
            agreements = _Agreements(template.source, rules, {})
            self._agreements[template.name] = agreements
        known = agreements.known
        kind = (given, selected, streamed)
        if kind not in known:
            if len(known) >= _REMEMBERED:
                known.clear()
            known[kind] = self._plans.queries.agreement(
                template.query, query.bindings, streamed, selected
            )
        return known[kind]

    def _unselected(
        self,
        template: Template,
        request: EventRequest,
        supplies: tuple[Supply, ...],
        selected: frozenset[str],
        strategy: str,
    ) -> tuple[Supply, ...] | None:
        """What the request would read of all objects, if it is that from which it selects."""
        arguments = [
            parameter if parameter.value in selected else argument
            for parameter, argument in zip(template.parameters, request.arguments, strict=True)
        ]
        try:
            free = instantiate(template, arguments, self._ontology.vocabulary)
            wants = self._templates.needs(free).wants
        except (ArgumentError, NeedsError):
            # Nothing else finds these objects.
            return None
        found = self._plans.match(wants, strategy, self._plans.unusable(Since.NOW))
        every = self._plans.made_from(found)
        if len(every) != len(supplies) or _elements(every) != _elements(supplies):
            return None
        outlines = _Outlines()
        same = all(
            [outlines.of(one.node) for one in mine.sources]
            == [outlines.of(one.node) for one in other.sources]
            for mine, other in zip(supplies, every, strict=True)
        )
        return every if same else None


def _selected(supplies: Sequence[Supply], bindings: Mapping[Variable, Term]) -> frozenset[str]:
    """The parameters whose objects are selected from streams of several."""
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


def _elements(supplies: Sequence[Supply]) -> int:
    """How many streams are read, counting what each is read for: two patterns that want the same of
    one stream read it once, of two objects twice."""
    return len(
        {
            (source.node, supply.want.feature, source.port.target)
            for supply in supplies
            for source in supply.sources
        }
    )


class _Outlines:
    """How streams are made, whether of all objects or of some that are selected: numbers, equal
    for those that are made alike. Cost: O(distinct nodes)."""

    def __init__(self) -> None:
        self._numbers: dict[Hashable, int] = {}
        self._known: dict[Node, int] = {}

    def of(self, source: Node) -> int:
        """The number of a node's outline."""
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
