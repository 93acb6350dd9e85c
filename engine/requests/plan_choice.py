"""Which plan is best for an adaptive subscription now, and whether its own still is what is wanted
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


class Choosing:
    """Judges plans; changes nothing but that it passes over what is silent. Cost: that of semantic
    matching where a plan is looked for, else linear in the plan."""

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
        """Transformations or the ontology have changed, and what leads to a feature with them."""
        self._reach.forget()

    def leads(self, feature: str, wanted: str) -> bool:
        """Whether streams of ``feature`` may lead to ``wanted``."""
        return feature in self._reach.of(wanted, self._ontology.vocabulary)

    def may_serve(self, stream: str, found: AdaptiveSubscription) -> bool:
        """Whether a stream may have anything to do with what is wanted."""
        known = self._space.streams.get(stream)
        if known is None:
            return False
        want = found.wish.want
        vocabulary = self._ontology.vocabulary
        reach = self._reach.of(want.feature, vocabulary)
        direct = vocabulary.subfeatures(want.feature)
        sorts = Sorts(vocabulary)
        subject = _subject(want, sorts)
        return any(
            content.feature in reach
            and (
                content.feature not in direct
                or not content.roles
                or not sorts.why_not(content.roles[0], subject)
            )
            for content in known.contents
        )

    def is_worth(self, found: AdaptiveSubscription, quality: float) -> bool:
        """Whether what is made of a part of this quality may be good enough, or better."""
        if found.state is not State.RUNNING or not found.wish.minds_quality:
            return True
        is_better = found.wish.kind is not Kind.QUALITY or quality > found.quality
        return is_better and quality >= found.wish.quality

    def is_better(self, found: AdaptiveSubscription, supply: Supply) -> bool:
        """Whether a plan, that the strategy has chosen, is better than the one that is carried
        out: with *fast* the first one is. What runs for either, or for somebody else, is paid."""
        old = found.supply
        if old is None or self.is_same(found, supply):
            return False
        strategy = Strategy.parse(found.wish.strategy)
        if strategy.kind is Kind.FAST or supply.complete != old.complete:
            return True
        new_weight, old_weight = (
            weight_of(each, self._space, strategy, self._is_running(found))
            for each in (supply, old)
        )
        return new_weight < old_weight

    def made_streams(self) -> AbstractSet[str]:
        """The streams of other plans, which are no sources: of equal plans the units are shared,
        and each knows what it is made from. And those that are broken."""
        return self._plans.unusable(Since.START) | self._plans.made

    def unusable(self, found: AdaptiveSubscription, now: int) -> AbstractSet[str]:
        """What a subscription is to do without: also what is silent, or failed it."""
        silent = self._silences.silent_streams(now, found.wish.staleness)
        for name in silent:
            self._silences.pass_over(name)
        return self.made_streams() | silent | found.avoided

    def state_of(self, found: AdaptiveSubscription, supply: Supply) -> State:
        is_good = self.quality(supply) >= found.wish.quality
        return State.RUNNING if is_good else State.STALE

    def best(
        self, found: AdaptiveSubscription, without: AbstractSet[str], *, explained: bool = False
    ) -> Match:
        """What the strategy chooses of what is good enough; where nothing is, the best."""
        wish = found.wish
        if wish.quality > 0:
            bad = self._too_bad(wish.quality)
            match = self._match(found, wish.strategy, without, bad)
            if match.supply is not None and self.quality(match.supply) >= wish.quality:
                return match
        strategy = str(Kind.QUALITY) if wish.quality > 0 else wish.strategy
        match = self._match(found, strategy, without, explained=explained)
        return replace(match, strategy=wish.strategy)

    def _match(
        self,
        found: AdaptiveSubscription,
        strategy: str,
        without: AbstractSet[str],
        bad: AbstractSet[str] = frozenset(),
        *,
        explained: bool = False,
    ) -> Match:
        counts = Strategy.parse(strategy).kind is Kind.COST
        shared = self._shared(found, without, bad) if counts else {}
        (match,) = self._plans.match(
            [found.wish.want], strategy, (without - shared.keys()) | bad, explained=explained
        )
        supply = None if match.supply is None else expanded(match.supply, shared)
        return replace(match, supply=supply)

    def _shared(
        self, found: AdaptiveSubscription, without: AbstractSet[str], bad: AbstractSet[str]
    ) -> Mapping[str, Node]:
        """The streams of units that run and cost nothing more, and what makes them: a subscription
        has to know what it rests on. None of it is ``without`` or ``bad``, or means something else
        by now."""
        avoided = (without | bad) - self._plans.made
        streams = self._space.streams
        shared = {}
        for name, node in self._plans.shared(found.begins).items():
            if name not in streams or name in bad or streams[name].contents != contents_of(node):
                continue
            nodes = tuple(nodes_of(node))
            if avoided.isdisjoint(names_of(nodes)) and all(map(self._is_known, nodes)):
                shared[name] = node
        return shared

    def _too_bad(self, bound: float) -> AbstractSet[str]:
        """What nothing good enough is made of: a plan is as good as the worst of it at most."""
        streams, transformations = self._space.streams, self._space.transformations
        return frozenset(
            {name for name, stream in streams.items() if stream.quality < bound}
            | {name for name, unit in transformations.items() if unit.quality < bound}
        )

    def quality(self, supply: Supply) -> float:
        return quality_of(supply, self._space)

    def _is_running(self, found: AdaptiveSubscription) -> Callable[[Node], bool]:
        own = set(found.nodes)
        return lambda node: node in own or self._plans.is_shared(node, found.begins)

    def is_same(self, found: AdaptiveSubscription, supply: Supply) -> bool:
        return (
            found.supply is not None
            and found.supply.sources == supply.sources
            and self._still_reads(found)
        )

    def _still_reads(self, found: AdaptiveSubscription) -> bool:
        """Its inputs are there, and work."""
        unit = found.unit
        return bool(unit.inputs) and (
            self._configuration.has_current_inputs(unit) and not self._configuration.is_broken(unit)
        )

    def serves(self, found: AdaptiveSubscription) -> bool:
        """What it reads is there and works, and is what is wanted."""
        return self._still_reads(found) and self.means_the_same(found)

    def means_the_same(self, found: AdaptiveSubscription) -> bool:
        """What its plan is made of means what it did when it was made, and that is wanted."""
        if found.supply is None or found.misled:
            return False
        vocabulary = self._ontology.vocabulary
        sorts = Sorts(vocabulary)
        want = found.wish.want
        served = vocabulary.subfeatures(want.feature)
        return all(
            source.port.feature in served
            and not (source.roles and sorts.why_not(source.roles[0], _subject(want, sorts)))
            for source in found.supply.sources
        ) and all(self._is_known(node) for node in found.nodes)

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
