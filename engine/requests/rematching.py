"""Matches adaptive subscriptions again when their sources change ([Introspection15 §4.4]).

A lost source is replaced at once, a better one is taken after the hold-off, and a subscription
without a source waits. A change costs O(subscriptions that read the lost stream or might read the
new one); the others are not examined.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial

from ...matching.plan import Supply, nodes_of_supply
from ...matching.space import StreamSpace, TransformationDescription
from ...matching.strategy import Kind
from ...ontology.ontology import Ontology
from ...rdf.dictionary import TermDictionary
from ...streams.generator import StreamGenerator
from ...streams.time import SECOND
from ..configuration.configuration import Configuration
from ..configuration.silent_streams import Silences
from ..model.beginning import start_from_retained
from ..model.errors import Conflict, DyknowError
from ..model.status_changes import Change, ChangeKind
from ..planning.plan_execution import Plans
from ..units.base import ComputationalUnit
from ..units.policy import AdaptationUnit
from .adaptive_subscription import (
    AdaptiveSubscription,
    State,
    Wish,
    names_of,
    transformations_of,
)
from .alarms import Alarms
from .plan_choice import PlanChoice
from .plan_switch import PlanSwitch
from .silent_sources import culprits, silent_from
from .subscription_index import SubscriptionIndex, other_readers

_CHECK_INTERVAL = SECOND
"""The longest time (ns) between two checks of a source: none is silent sooner (`MIN_SILENCE`)."""
_RETRY_AFTER = 30 * SECOND
"""The time (ns) after which a transformation that failed or made no samples is tried again."""
_MAX_MATCHES = 5
"""How often one `settle` matches a subscription, where plans fail in turn; then its hold-off."""


class Rematching:
    """The running adaptive subscriptions.

    It records which of them a change (`on_change`) or an arrival (`on_arrival`) affects. The caller
    of the change calls `settle` when it is complete, and only then subscriptions are matched again.
    ``clock`` returns the time (ns).
    """

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        configuration: Configuration,
        plans: Plans,
        space: StreamSpace,
        clock: Callable[[], int],
        adapt: Callable[[StreamGenerator, Wish], AdaptationUnit | None],
    ) -> None:
        self._configuration = configuration
        self._plans = plans
        self._space = space
        self._clock = clock
        self._adapt = adapt
        self._silences = Silences(configuration, space, plans.makes)
        self._choice = PlanChoice(ontology, configuration, plans, space, self._silences)
        self._switcher = PlanSwitch(ontology, dictionary, configuration, plans, clock)
        self._index = SubscriptionIndex()
        self._alarms = Alarms()
        self._lost: dict[str, str] = {}
        """The reason, by id of each subscription that has lost a source."""
        self._improvable: dict[str, None] = {}
        """Ids of subscriptions for which a better plan may exist, in order."""

    # -- subscriptions -----------------------------------------------------------------------

    def start(self, id: str, wish: Wish) -> AdaptiveSubscription:
        """Start a subscription; without a plan it waits until there is one."""
        unit = self._switcher.make(wish)
        self._configuration.start(unit, specification=f"{wish.want} by {wish.strategy}")
        adaptation = self._adapt(unit.output, wish)
        if adaptation is None:
            unit.users += 1
        subscription = AdaptiveSubscription(id, wish, unit, adaptation)
        self._index.add(subscription)
        try:
            self._rematch(subscription, "requested")
            self.settle()
        except Exception:
            self.cancel(id)
            raise
        return subscription

    def cancel(self, id: str) -> None:
        """Cancel a subscription and stop its units."""
        subscription = self._index.remove(id)
        self._lost.pop(id, None)
        self._improvable.pop(id, None)
        last = subscription.unit if subscription.adaptation is None else subscription.adaptation
        if self._configuration.units.get(last.output.name) is last:
            self._configuration.release(last)

    def get(self, id: str) -> AdaptiveSubscription | None:
        """A subscription by its id."""
        return self._index.get(id)

    def of_stream(self, name: str) -> AdaptiveSubscription | None:
        """The subscription whose stream this is."""
        return self._index.of_stream(name)

    # -- changes -----------------------------------------------------------------------------

    def on_change(self, change: Change) -> None:
        """Record the subscriptions that a change of the stream space affects."""
        match change.kind:
            case ChangeKind.STREAM_ENDED:
                self._silences.note_end(change.stream)
                self._note_loss(change.stream, f"{change.stream} ended")
            case ChangeKind.STREAM_REMOVED:
                self._silences.forget(change.stream)
                self._index.stop_avoiding_all(change.stream)
                self._note_loss(change.stream, f"{change.stream} was removed")
            case ChangeKind.UNIT_FAILED | ChangeKind.UNIT_STOPPED_BY_RULE:
                unit = self._configuration.units.get(change.stream)
                if unit is not None and unit.failure is not None:  # else it still runs
                    self._note_failure(unit)
            case ChangeKind.STREAM_ANNOTATED if not self._plans.makes(change.stream):
                self._silences.refresh()
                self._note_meaning(change.stream)
            case ChangeKind.STREAM_ANNOTATED:
                self._note_new_meaning(change.stream)
            case ChangeKind.QUALITY_CHANGED if change.quality is not None:
                self._note_quality(change.stream, change.quality)
            case ChangeKind.QUALITY_CHANGED | ChangeKind.TRANSFORMATION_ANNOTATED:
                assert change.described is not None
                self._note_transformation(change.described.description)
            case ChangeKind.TRANSFORMATION_REMOVED:
                self._choice.forget()
                self._index.drop_candidate(change.transformation)
            case _:
                pass

    def _note_new_meaning(self, stream: str) -> None:
        """Record the readers of a plan's stream whose annotation has changed."""
        unit = self._configuration.units.get(stream)
        for subscription in self._index.readers(stream):
            if unit is not None:
                self._avoid(subscription, unit.transformation)
            subscription.has_new_meaning = True
            self._lost.setdefault(subscription.id, f"{stream} means something else")

    def _note_failure(self, unit: ComputationalUnit) -> None:
        stream = unit.output.name
        for subscription in self._index.readers(stream):
            self._avoid(subscription, unit.transformation)
        self._note_loss(stream, f"{unit.name} ({unit.transformation}) failed")

    def _avoid(self, subscription: AdaptiveSubscription, name: str) -> None:
        """Avoid a silent stream until it brings samples again, and a transformation that failed or
        made no samples for some time."""
        if name in subscription.avoided:
            return
        self._index.avoid(subscription, name)
        now = self._clock()
        silent = self._silences.silent_streams(now, subscription.wish.staleness)
        speaks = self._silences.has_arrivals(name) and name not in silent
        if name in self._space.streams and not speaks:
            self._silences.pass_over(name)
        else:
            self._alarms.at(now + _RETRY_AFTER, partial(self._stop_avoiding, subscription.id, name))

    def on_arrival(self, stream: str, now: int) -> None:
        """Record that a batch was published to a stream."""
        if not self._silences.note_samples(stream):
            return  # the batch had no samples, or only late ones
        if self._silences.take_back(stream):
            self._on_return(stream)
        for subscription in self._index.candidates(stream):
            self._note_arrival(subscription, stream, now)
        self._silences.note_arrival(stream, now)

    def _note_arrival(self, subscription: AdaptiveSubscription, stream: str, now: int) -> None:
        """A candidate brought samples. Its hold-off counts since it was last silent."""
        if self._silences.is_new_or_silent(stream, now, subscription.wish.staleness):
            subscription.candidates[stream] = now
        if now - subscription.candidates[stream] >= subscription.wish.hold_off:
            self._mark_improvable(subscription, stream)

    def leave_stream(
        self, stream: str, users_of: Callable[[Iterable[str]], tuple[str, ...]]
    ) -> None:
        """Switch all subscriptions away from a stream that is about to be removed. Raises
        `Conflict`, and changes nothing, while other units read it: it names ``users_of`` them."""
        readers = other_readers(stream, self._index.all(), self._configuration)
        if readers:
            raise Conflict(
                f"stream {stream!r} is read by {', '.join(users_of(readers))}",
                "remove or cancel these first",
            )
        for subscription in self._index.readers(stream):
            self._rematch(subscription, f"{stream} is removed", removed=stream)

    def ontology_changed(self) -> None:
        """Check all subscriptions, since hierarchies of sorts and features may have changed."""
        self._choice.forget()
        for subscription in self._index.all():
            subscription.unit.refresh_objects()
            if subscription.supply is not None and not self._choice.means_the_same(subscription):
                self._lost.setdefault(subscription.id, "the ontology has changed")
            else:
                self._improvable[subscription.id] = None

    def _on_return(self, stream: str) -> None:
        """An avoided stream brings samples again."""
        self._index.stop_avoiding_all(stream)
        self._index.drop_candidate(stream)
        self._note_gain(stream)
        for subscription in self._index.readers(stream):
            if subscription.state is State.STALE:
                self._lost.setdefault(subscription.id, f"{stream} speaks again")

    def _note_loss(self, stream: str, why: str) -> None:
        for subscription in self._index.readers(stream):
            self._lost.setdefault(subscription.id, why)
        self._index.drop_candidate(stream)

    def _note_meaning(self, stream: str) -> None:
        for subscription in self._index.readers(stream):
            if not self._choice.means_the_same(subscription):
                self._lost.setdefault(subscription.id, f"{stream} means something else")
        for subscription in self._index.candidates(stream):
            if not self._choice.may_serve(stream, subscription):
                self._index.drop_candidate_of(subscription, stream)
        self._note_gain(stream)

    def _note_quality(self, stream: str, quality: float) -> None:
        for subscription in self._index.readers(stream):
            self._recheck_quality(subscription, f"quality of {stream} is {quality:g}")
        self._note_worth(stream, quality)
        self._note_gain(stream, is_only_quality=True)

    def _note_transformation(self, description: TransformationDescription) -> None:
        self._choice.forget()
        name = description.name
        for subscription in self._index.users(name):
            if self._choice.means_the_same(subscription):
                self._recheck_quality(subscription, f"quality of {name}")
            else:
                self._lost.setdefault(subscription.id, f"{name} means something else")
        self._note_worth(name, description.quality)
        for subscription in self._interested(description.output.feature):
            self._add_candidate(subscription, name)

    def _recheck_quality(self, subscription: AdaptiveSubscription, why: str) -> None:
        """Record a loss if a change of quality makes the present plan worse."""
        if subscription.supply is None or not subscription.wish.considers_quality:
            return
        before, wish = subscription.quality, subscription.wish
        subscription.quality = self._choice.quality(subscription.supply)
        has_fallen = subscription.quality < before and wish.kind is not Kind.FAST
        is_bad = subscription.quality < wish.quality or subscription.state is State.STALE
        if has_fallen or is_bad:
            self._lost.setdefault(subscription.id, why)

    def _note_worth(self, name: str, quality: float) -> None:
        """Drop a candidate whose quality has become too low."""
        for subscription in self._index.candidates(name):
            if not self._choice.may_improve(subscription, quality):
                self._index.drop_candidate_of(subscription, name)

    # -- better plans ------------------------------------------------------------------------

    def _note_gain(self, stream: str, *, is_only_quality: bool = False) -> None:
        """Record subscriptions for which a new stream, or one with a new quality, may be better."""
        description = self._space.streams.get(stream)
        if description is None:
            return
        for feature in dict.fromkeys(content.feature for content in description.contents):
            for subscription in self._interested(feature):
                considers = subscription.wish.considers_quality
                if (
                    stream not in subscription.reads
                    and (considers or not is_only_quality)
                    and self._choice.may_improve(subscription, description.quality)
                    and self._choice.may_serve(stream, subscription)
                ):
                    self._add_candidate(subscription, stream)

    def _interested(self, feature: str) -> Iterator[AdaptiveSubscription]:
        """Yield the subscriptions whose feature might be computed from ``feature``."""
        for wanted, subscriptions in self._index.wanted():
            if self._choice.may_lead(feature, wanted):
                yield from subscriptions

    def _add_candidate(self, subscription: AdaptiveSubscription, name: str) -> None:
        """Make ``name`` a candidate until its hold-off has passed; a subscription without a good
        source tries it at once.

        Samples show that a stream from outside still exists; for other candidates an alarm ends
        the hold-off.
        """
        now = self._clock()
        due = now + subscription.wish.hold_off
        if subscription.state is not State.RUNNING:
            self._improvable[subscription.id] = None
        elif name in subscription.transformations:
            if not subscription.will_match:
                subscription.will_match = True
                self._alarms.at(due, partial(self._match_later, subscription.id))
        elif name not in subscription.candidates:
            self._index.add_candidate(subscription, name, now)
            is_published = name in self._space.streams and name not in self._configuration.units
            if not is_published and name not in subscription.timed_candidates:
                subscription.timed_candidates.add(name)
                self._alarms.at(due, partial(self._end_hold_off, subscription.id, name))

    def _end_hold_off(self, id: str, name: str, now: int) -> None:
        subscription = self._index.get(id)
        if subscription is None:
            return
        subscription.timed_candidates.discard(name)
        if name not in subscription.candidates:
            return
        due = subscription.candidates[name] + subscription.wish.hold_off
        if due <= now:
            self._mark_improvable(subscription, name)
        else:
            subscription.timed_candidates.add(name)
            self._alarms.at(due, partial(self._end_hold_off, id, name))

    def _mark_improvable(self, subscription: AdaptiveSubscription, name: str) -> None:
        self._index.drop_candidate_of(subscription, name)
        self._improvable[subscription.id] = None

    # -- time --------------------------------------------------------------------------------

    def tick(self, now: int) -> None:
        """Advance the time to ``now`` (ns): find silent sources and candidates whose hold-off has
        passed. Cost: O(alarms due + avoided streams).
        """
        for name in self._silences.take_all_back():
            self._on_return(name)
        self._alarms.ring(now)
        self.settle()

    def _match_later(self, id: str, now: int) -> None:
        subscription = self._index.get(id)
        if subscription is not None:
            subscription.will_match = False
            self._improvable[id] = None

    def _stop_avoiding(self, id: str, name: str, now: int) -> None:
        subscription = self._index.get(id)
        if subscription is None or name not in subscription.avoided:
            return
        self._index.stop_avoiding(subscription, name)
        if subscription.state is not State.RUNNING:
            self._improvable[id] = None

    def _schedule_check(
        self, subscription: AdaptiveSubscription, source: StreamGenerator, time: int
    ) -> None:
        """Set an alarm to check a source at ``time`` or before, unless it has one."""
        if source not in subscription.watched_sources:
            subscription.watched_sources.add(source)
            soon = min(time, self._clock() + _CHECK_INTERVAL)
            self._alarms.at(soon, partial(self._check_source, subscription.id, source))

    def _check_source(self, id: str, source: StreamGenerator, now: int) -> None:
        subscription = self._index.get(id)
        if subscription is None:
            return
        subscription.watched_sources.discard(source)
        if source not in subscription.unit.arrivals:
            return
        silent_at = silent_from(subscription, source, self._silences)
        if silent_at is not None and silent_at <= now:
            blamed = culprits(subscription, source, self._silences, now)
            if not subscription.avoided.issuperset(blamed):
                for name in blamed:
                    self._avoid(subscription, name)
                self._lost.setdefault(id, f"{' and '.join(blamed)} fell silent")
        elif silent_at is not None and subscription.state is State.STALE:
            again = subscription.avoided & names_of(subscription.nodes_behind(source))
            for name in again:
                self._stop_avoiding(id, name, now)
            if again:
                self._lost.setdefault(id, f"{' and '.join(sorted(again))} speaks again")
        if silent_at is None or silent_at <= now:
            silent_at = now + _CHECK_INTERVAL
        self._schedule_check(subscription, source, silent_at)

    def settle(self) -> None:
        """Match the recorded subscriptions again."""
        times: Counter[str] = Counter()
        while self._lost or self._improvable:
            id = next(iter(self._lost or self._improvable))
            why = self._lost.pop(id, None)
            self._improvable.pop(id, None)
            subscription = self._index.get(id)
            if subscription is None:
                continue
            times[id] += 1
            if times[id] > _MAX_MATCHES:
                later = self._clock() + max(subscription.wish.hold_off, SECOND)
                self._alarms.at(later, partial(self._match_later, id))
            elif why is not None:
                self._rematch(subscription, why)
            else:
                self._improve(subscription)

    # -- matching again ----------------------------------------------------------------------

    def _improve(self, subscription: AdaptiveSubscription) -> None:
        """Switch to a better plan if there is one."""
        choice = self._choice
        if subscription.state is not State.RUNNING or not choice.is_served(subscription):
            self._rematch(subscription, "something appeared")
            return
        unusable = choice.unusable(subscription, self._clock())
        supply = choice.best(subscription, unusable | subscription.candidates.keys()).supply
        if supply is not None and choice.is_better(subscription, supply):
            subscription.state = choice.state_of(subscription, supply)
            self._switch(subscription, supply, "a better source appeared")

    def _rematch(
        self, subscription: AdaptiveSubscription, why: str, removed: str | None = None
    ) -> None:
        """Find a plan for a subscription whose sources are lost or bad, without the stream that is
        about to be ``removed``."""
        choice = self._choice
        without = frozenset() if removed is None else frozenset((removed,))
        match = choice.best(subscription, choice.unusable(subscription, self._clock()) | without)
        if match.supply is not None:
            subscription.state = choice.state_of(subscription, match.supply)
        elif removed is None and choice.is_served(subscription):
            subscription.state = State.STALE
            return
        else:
            # A silent stream, which may bring samples again, is better than none.
            failing = subscription.avoided - self._space.streams.keys()
            match = choice.best(
                subscription, choice.plan_streams() | failing | without, explained=True
            )
            subscription.state = State.WAITING if match.supply is None else State.STALE
        if match.supply is None:
            subscription.missing = match.missing
            if subscription.supply is None and subscription.rematches:
                return  # it waits already, so there is no switch to report
        elif choice.is_same(subscription, match.supply):
            return
        self._switch(subscription, match.supply, why)

    def _switch(self, subscription: AdaptiveSubscription, supply: Supply | None, why: str) -> None:
        try:
            streams = self._streams_of(subscription, supply)
        except DyknowError as error:
            # The plan cannot be executed: avoid its transformations for some time.
            for name in transformations_of(() if supply is None else nodes_of_supply(supply)):
                self._avoid(subscription, name)
            self._lost[subscription.id] = f"{why}; {error.causes}"
            return
        self._index.drop_sources(subscription)
        gained = self._switcher.switch(subscription, supply, streams, why)
        self._index.index_sources(subscription, self._configuration)
        now = self._clock()
        for stream in gained:
            self._schedule_check(
                subscription,
                stream,
                silent_from(subscription, stream, self._silences) or now + _CHECK_INTERVAL,
            )
        if supply is not None:
            subscription.missing = ()
            subscription.quality = self._choice.quality(supply)
        for part in self._configuration.upstream_units(subscription.unit):
            if part is not subscription.unit and part.failure is not None:
                self._note_failure(part)  # it failed on the history, before it had readers

    def _streams_of(
        self, subscription: AdaptiveSubscription, supply: Supply | None
    ) -> tuple[StreamGenerator, ...]:
        """The streams of a plan. If they have evicted samples since the beginning, a new
        subscription is refused; one that has waited begins with the oldest samples, and its switch
        reports the loss. Raises `DyknowError`, and `Forgotten` for a new subscription."""
        if supply is not None and not subscription.has_begun:
            since = self._plans.resolve_duration(subscription.wish.since, [supply])
            subscription.wish = replace(subscription.wish, since=since)
        begin = partial(self._switcher.streams_of, subscription, supply)
        beginning = subscription.beginning
        return start_from_retained(beginning, begin) if subscription.rematches else begin(beginning)
