"""Chooses plans for adaptive subscriptions, and checks whether the present ones are still valid
([Introspection15 §4.3, §4.4])."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import replace

from ...matching.plan import (
    Compute,
    Detect,
    Node,
    Supply,
    UseStream,
    contents_of,
    expanded,
    nodes_of,
)
from ...matching.plan_value import quality_of, weight_of
from ...matching.reachability import Reachability
from ...matching.space import StreamSpace
from ...matching.strategy import Kind, Strategy
from ...matching.subject import Sorts, Subject
from ...matching.tree import Match
from ...matching.want import Want
from ...ontology.ontology import Ontology
from ..configuration.configuration import Configuration
from ..configuration.silent_streams import Silences
from ..model.views import Since
from ..planning.plan_execution import Plans
from .adaptive_subscription import AdaptiveSubscription, State, names_of


class PlanChoice:
    """Compares plans. It changes nothing except that it marks silent streams as avoided. Cost: that
    of semantic matching to find a plan, else linear in the plan."""

    def __init__(
        self,
        ontology: Ontology,
        configuration: Configuration,
        plans: Plans,
        space: StreamSpace,
        silences: Silences,
    ) -> None:
        self._ontology = ontology
        self._configuration = configuration
        self._plans = plans
        self._space = space
        self._silences = silences
        self._reach = Reachability(space)

    def forget(self) -> None:
        """Drop the cache of reachable features, after transformations or the ontology changed."""
        self._reach.forget()

    def may_lead(self, feature: str, wanted: str) -> bool:
        """Whether ``wanted`` might be computed from streams of ``feature``."""
        return feature in self._reach.of(wanted, self._ontology.vocabulary)

    def may_serve(self, stream: str, subscription: AdaptiveSubscription) -> bool:
        """Whether a stream might serve a subscription, directly or through transformations."""
        description = self._space.streams.get(stream)
        if description is None:
            return False
        want = subscription.wish.want
        vocabulary = self._ontology.vocabulary
        reach = self._reach.of(want.feature, vocabulary)
        direct = vocabulary.subfeatures(want.feature)
        sorts = Sorts(vocabulary)
        subject = _subject(want, sorts)
        # Through transformations a stream may serve other objects; only a direct one has to match.
        return any(
            content.feature in reach
            and (
                content.feature not in direct
                or not content.roles
                or not sorts.why_not(content.roles[0], subject)
            )
            for content in description.contents
        )

    def may_improve(self, subscription: AdaptiveSubscription, quality: float) -> bool:
        """Whether a plan with a part of this quality might be good enough, or better."""
        if subscription.state is not State.RUNNING or not subscription.wish.considers_quality:
            return True
        is_better = subscription.wish.kind is not Kind.QUALITY or quality > subscription.quality
        return is_better and quality >= subscription.wish.quality

    def is_better(self, subscription: AdaptiveSubscription, supply: Supply) -> bool:
        """Whether a plan that the strategy chose is better than the present one. With *fast* every
        new choice is. Units that run already, for any user, cost nothing."""
        old = subscription.supply
        if old is None or self.is_same(subscription, supply):
            return False
        strategy = Strategy.parse(subscription.wish.strategy)
        if strategy.kind is Kind.FAST or supply.complete != old.complete:
            return True
        new_weight, old_weight = (
            weight_of(each, self._space, strategy, self._is_running(subscription))
            for each in (supply, old)
        )
        return new_weight < old_weight

    def plan_streams(self) -> AbstractSet[str]:
        """The broken streams and the streams of plans. The latter are no sources: a plan contains
        the nodes that make them, and execution shares the units of equal nodes."""
        return self._plans.unusable_streams(Since.START) | self._plans.streams

    def unusable(self, subscription: AdaptiveSubscription, now: int) -> AbstractSet[str]:
        """The streams and transformations that a subscription cannot use, with those that are
        silent or failed it."""
        silent = self._silences.silent_streams(now, subscription.wish.staleness)
        for name in silent:
            self._silences.pass_over(name)
        return self.plan_streams() | silent | subscription.avoided

    def state_of(self, subscription: AdaptiveSubscription, supply: Supply) -> State:
        is_good = self.quality(supply) >= subscription.wish.quality
        return State.RUNNING if is_good else State.STALE

    def best(
        self,
        subscription: AdaptiveSubscription,
        without: AbstractSet[str],
        *,
        explained: bool = False,
    ) -> Match:
        """The strategy's choice among plans of the wanted quality; if there is none, the plan of
        the best quality."""
        wish = subscription.wish
        if wish.quality > 0:
            bad = self._below_quality(wish.quality)
            match = self._match(subscription, wish.strategy, without, bad)
            # Qualities multiply along a path, so a plan of good parts may still be below the bound.
            if match.supply is not None and self.quality(match.supply) >= wish.quality:
                return match
        strategy = str(Kind.QUALITY) if wish.quality > 0 else wish.strategy
        match = self._match(subscription, strategy, without, explained=explained)
        # The subscriber named this strategy; *quality* only stands in where no plan is good enough.
        return replace(match, strategy=wish.strategy)

    def _match(
        self,
        subscription: AdaptiveSubscription,
        strategy: str,
        without: AbstractSet[str],
        bad: AbstractSet[str] = frozenset(),
        *,
        explained: bool = False,
    ) -> Match:
        counts = Strategy.parse(strategy).kind is Kind.COST
        shared = self._shared(subscription, without, bad) if counts else {}
        (match,) = self._plans.match(
            [subscription.wish.want], strategy, (without - shared.keys()) | bad, explained=explained
        )
        supply = None if match.supply is None else expanded(match.supply, shared)
        return replace(match, supply=supply)

    def _shared(
        self, subscription: AdaptiveSubscription, without: AbstractSet[str], bad: AbstractSet[str]
    ) -> Mapping[str, Node]:
        """The streams of running units, which cost nothing more, with their nodes, which a
        subscription has to know. Left out are those with a node that is ``without`` or ``bad``, or
        whose meaning has changed."""
        avoided = (without | bad) - self._plans.streams
        streams = self._space.streams
        shared = {}
        for name, node in self._plans.shareable_nodes(subscription.beginning).items():
            if name not in streams or name in bad or streams[name].contents != contents_of(node):
                continue
            nodes = tuple(nodes_of(node))
            if avoided.isdisjoint(names_of(nodes)) and all(map(self._is_known, nodes)):
                shared[name] = node
        return shared

    def _below_quality(self, bound: float) -> AbstractSet[str]:
        """The streams and transformations below the ``bound``. A plan is at most as good as its
        worst part, so plans without these suffice."""
        streams, transformations = self._space.streams, self._space.transformations
        return frozenset(
            {name for name, stream in streams.items() if stream.quality < bound}
            | {name for name, unit in transformations.items() if unit.quality < bound}
        )

    def quality(self, supply: Supply) -> float:
        return quality_of(supply, self._space)

    def _is_running(self, subscription: AdaptiveSubscription) -> Callable[[Node], bool]:
        own = set(subscription.nodes)
        return lambda node: node in own or self._plans.is_shared(node, subscription.beginning)

    def is_same(self, subscription: AdaptiveSubscription, supply: Supply) -> bool:
        return (
            subscription.supply is not None
            and subscription.supply.sources == supply.sources
            and self._still_reads(subscription)
        )

    def _still_reads(self, subscription: AdaptiveSubscription) -> bool:
        """Whether its inputs exist and work."""
        unit = subscription.unit
        return bool(unit.inputs) and (
            self._configuration.has_current_inputs(unit) and not self._configuration.is_broken(unit)
        )

    def is_served(self, subscription: AdaptiveSubscription) -> bool:
        """Whether its inputs exist, work, and still mean the wanted feature."""
        return self._still_reads(subscription) and self.means_the_same(subscription)

    def means_the_same(self, subscription: AdaptiveSubscription) -> bool:
        """Whether the parts of its plan have the meaning that they had, and match the want."""
        if subscription.supply is None or subscription.has_new_meaning:
            return False
        vocabulary = self._ontology.vocabulary
        sorts = Sorts(vocabulary)
        want = subscription.wish.want
        served = vocabulary.subfeatures(want.feature)
        return all(
            source.port.feature in served
            and not (source.roles and sorts.why_not(source.roles[0], _subject(want, sorts)))
            for source in subscription.supply.sources
        ) and all(self._is_known(node) for node in subscription.nodes)

    def _is_known(self, node: Node) -> bool:
        if isinstance(node, UseStream):
            stream = self._space.streams.get(node.stream)
            return stream is not None and stream.contents == node.contents
        if isinstance(node, Compute):
            unit = self._space.transformations.get(node.transformation)
            return unit is not None and unit.output == node.output
        if isinstance(node, Detect):
            return node.event in self._space.transformations
        return True


def _subject(want: Want, sorts: Sorts) -> Subject:
    if want.object is None:
        return Subject(want.wanted_sort, None)
    return Subject(want.sort, sorts.canonical(want.object))
