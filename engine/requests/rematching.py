"""When adaptive subscriptions are matched again, and what follows ([Introspection15 §4.4]).

What is lost is replaced at once; what is better is taken when it has been there for a while; what
cannot be met waits. Only subscriptions that read what was lost, or might read what appeared, are
looked at: the cost of a change is linear in these.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
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
from .plan_choice import Choosing
from .plan_switch import Switching
from .silent_sources import culprits, silent_from
from .subscription_index import SubscriptionIndex, others

_LOOK_AGAIN = SECOND
"""After so long (ns) a source is looked at again, if not before: nothing that learns falls silent
sooner after it spoke (`arrivals.MIN_SILENCE`)."""
_FORGIVEN = 30 * SECOND
"""After so long (ns) a transformation is tried again that failed, or made nothing."""
_AT_ONCE = 5
"""So often a subscription is matched again in one go; then it waits for its hold-off."""


class Rematching:
    """The adaptive subscriptions that run.

    It hears of every change (`heard`) and of every arrival (`came`), and only notes what they
    concern; whoever caused them calls `settle` when all is as it is to be. ``clock`` gives the
    time (ns).
    """

    def __init__(
        self,
        ontology: Ontology,
        dictionary: TermDictionary,
        configuration: Configuration,
        plans: Plans,
        space: StreamSpace,
        clock: Callable[[], int],
        adapted: Callable[[StreamGenerator, Wish], AdaptationUnit | None],
    ) -> None:
        self._configuration = configuration
        self._plans = plans
        self._space = space
        self._clock = clock
        self._adapted = adapted
        self._silences = Silences(configuration, space, plans.makes)
        self._choosing = Choosing(ontology, configuration, plans, space, self._silences)
        self._switching = Switching(ontology, dictionary, configuration, plans, clock)
        self._index = SubscriptionIndex()
        self._alarms = Alarms()
        self._lost: dict[str, str] = {}
        """Who has lost something, and what."""
        self._ripe: dict[str, None] = {}
        """Who may have something better."""

    # -- subscriptions -----------------------------------------------------------------------

    def start(self, id: str, wish: Wish) -> AdaptiveSubscription:
        """Subscribe. What cannot be met now waits until it can."""
        unit = self._switching.make(wish)
        self._configuration.start(unit, specification=f"{wish.want} by {wish.strategy}")
        adapted = self._adapted(unit.output, wish)
        if adapted is None:
            unit.users += 1
        found = AdaptiveSubscription(id, wish, unit, adapted)
        self._index.add(found)
        try:
            self._rematch(found, "requested")
            self.settle()
        except Exception:
            self.cancel(id)
            raise
        return found

    def cancel(self, id: str) -> None:
        """Give a subscription up; its units stop with it."""
        found = self._index.remove(id)
        self._lost.pop(id, None)
        self._ripe.pop(id, None)
        last = found.unit if found.adapted is None else found.adapted
        if self._configuration.units.get(last.output.name) is last:
            self._configuration.release(last)

    def get(self, id: str) -> AdaptiveSubscription | None:
        """A subscription by its id."""
        return self._index.get(id)

    def of_stream(self, name: str) -> AdaptiveSubscription | None:
        """The subscription whose stream this is."""
        return self._index.of_stream(name)

    # -- what has happened -------------------------------------------------------------------

    def heard(self, change: Change) -> None:
        """Note whom a change of the stream space concerns."""
        match change.kind:
            case ChangeKind.STREAM_ENDED:
                self._silences.note_end(change.stream)
                self._note_loss(change.stream, f"{change.stream} ended")
            case ChangeKind.STREAM_REMOVED:
                self._forget_stream(change.stream)
            case ChangeKind.UNIT_FAILED | ChangeKind.UNIT_STOPPED_BY_RULE:
                unit = self._configuration.units.get(change.stream)
                if unit is not None and unit.failure is not None:  # else it goes on
                    self._note_failure(unit)
            case ChangeKind.STREAM_ANNOTATED if not self._plans.makes(change.stream):
                self._silences.refresh()
                self._note_meaning(change.stream)
            case ChangeKind.STREAM_ANNOTATED:
                self._note_misled(change.stream)
            case ChangeKind.QUALITY_CHANGED if change.quality is not None:
                self._note_quality(change.stream, change.quality)
            case ChangeKind.QUALITY_CHANGED | ChangeKind.TRANSFORMATION_ANNOTATED:
                assert change.described is not None
                self._note_transformation(change.described.description)
            case ChangeKind.TRANSFORMATION_REMOVED:
                self._choosing.forget()
                self._index.drop_candidate(change.transformation)
            case _:
                pass

    def _forget_stream(self, stream: str) -> None:
        self._silences.forget(stream)
        self._index.admit(stream)
        self._note_loss(stream, f"{stream} was removed")

    def _note_misled(self, stream: str) -> None:
        """The stream of a plan's unit means something; to who reads it already, something else."""
        unit = self._configuration.units.get(stream)
        for found in self._index.readers(stream):
            if unit is not None:
                self._avoid(found, unit.transformation)
            found.misled = True
            self._lost.setdefault(found.id, f"{stream} means something else")

    def _note_failure(self, unit: ComputationalUnit) -> None:
        stream = unit.output.name
        for found in self._index.readers(stream):
            self._avoid(found, unit.transformation)
        self._note_loss(stream, f"{unit.name} ({unit.transformation}) failed")

    def _avoid(self, found: AdaptiveSubscription, name: str) -> None:
        """Use a stream that is silent no more until it speaks again, and for a while what fails,
        or gives nothing of what is wanted."""
        if name in found.avoided:
            return
        self._index.avoid(found, name)
        now = self._clock()
        silent = self._silences.silent_streams(now, found.wish.staleness)
        speaks = self._silences.has_arrivals(name) and name not in silent
        if name in self._space.streams and not speaks:
            self._silences.pass_over(name)
        else:
            self._alarms.at(now + _FORGIVEN, partial(self._forgive, found.id, name))

    def came(self, stream: str, now: int) -> None:
        """Something was published to a stream."""
        if not self._silences.note_samples(stream):
            return  # it brought no sample, or only such as were late
        if self._silences.take_back(stream):
            self._back(stream)
        for found in self._index.candidates(stream):
            self._note_stay(found, stream, now)
        self._silences.note_arrival(stream, now)

    def _note_stay(self, found: AdaptiveSubscription, stream: str, now: int) -> None:
        """What may be better speaks: it has been there since it last was silent."""
        if self._silences.is_new_or_silent(stream, now, found.wish.staleness):
            found.young[stream] = now
        if now - found.young[stream] >= found.wish.hold_off:
            self._ripen(found, stream)

    def withdraw(self, stream: str) -> None:
        """A stream is about to be removed: nobody reads it any more, whatever there is instead.

        Raises `Conflict`, changing nothing, while anybody else needs it."""
        readers = others(stream, self._index.all(), self._configuration)
        if readers:
            raise Conflict(
                f"stream {stream!r} is read by {', '.join(readers)}",
                "cancel the requests that need it first",
            )
        for found in self._index.readers(stream):
            self._rematch(found, f"{stream} is removed", removed=stream)

    def ontology_changed(self) -> None:
        """Sorts and features may contain each other otherwise: everybody is looked at again."""
        self._choosing.forget()
        for found in self._index.all():
            found.unit.refresh_objects()
            if found.supply is not None and not self._choosing.means_the_same(found):
                self._lost.setdefault(found.id, "the ontology has changed")
            else:
                self._ripe[found.id] = None

    def _back(self, stream: str) -> None:
        """A stream that was passed over speaks again."""
        self._index.admit(stream)
        self._index.drop_candidate(stream)
        self._note_gain(stream)
        for found in self._index.readers(stream):
            if found.state is State.STALE:
                self._lost.setdefault(found.id, f"{stream} speaks again")

    def _note_loss(self, stream: str, why: str) -> None:
        for found in self._index.readers(stream):
            self._lost.setdefault(found.id, why)
        self._index.drop_candidate(stream)

    def _note_meaning(self, stream: str) -> None:
        for found in self._index.readers(stream):
            if not self._choosing.means_the_same(found):
                self._lost.setdefault(found.id, f"{stream} means something else")
        for found in self._index.candidates(stream):
            if not self._choosing.may_serve(stream, found):
                self._index.drop_young(found, stream)
        self._note_gain(stream)

    def _note_quality(self, stream: str, quality: float) -> None:
        for found in self._index.readers(stream):
            self._doubt(found, f"quality of {stream} is {quality:g}")
        self._note_worth(stream, quality)
        self._note_gain(stream, is_only_quality=True)

    def _note_transformation(self, description: TransformationDescription) -> None:
        self._choosing.forget()
        name = description.name
        for found in self._index.users(name):
            if self._choosing.means_the_same(found):
                self._doubt(found, f"quality of {name}")
            else:
                self._lost.setdefault(found.id, f"{name} means something else")
        self._note_worth(name, description.quality)
        for found in self._interested(description.output.feature):
            self._consider(found, name)

    def _doubt(self, found: AdaptiveSubscription, why: str) -> None:
        """The quality of what a subscription reads has changed."""
        if found.supply is None or not found.wish.minds_quality:
            return
        before, found.quality = found.quality, self._choosing.quality(found.supply)
        has_fallen = found.quality < before and found.wish.kind is not Kind.FAST
        if has_fallen or found.quality < found.wish.quality or found.state is State.STALE:
            self._lost.setdefault(found.id, why)

    def _note_worth(self, name: str, quality: float) -> None:
        """Who waits to take what has become too bad waits for it no more."""
        for found in self._index.candidates(name):
            if not self._choosing.is_worth(found, quality):
                self._index.drop_young(found, name)

    # -- what may be better ------------------------------------------------------------------

    def _note_gain(self, stream: str, *, is_only_quality: bool = False) -> None:
        """A stream is there, or has another quality, that might be better for somebody."""
        known = self._space.streams.get(stream)
        if known is None:
            return
        for feature in dict.fromkeys(content.feature for content in known.contents):
            for found in self._interested(feature):
                minds = found.wish.minds_quality
                if (
                    stream not in found.reads
                    and (minds or not is_only_quality)
                    and self._choosing.is_worth(found, known.quality)
                    and self._choosing.may_serve(stream, found)
                ):
                    self._consider(found, stream)

    def _interested(self, feature: str) -> Iterator[AdaptiveSubscription]:
        """The subscriptions to whose feature ``feature`` may lead."""
        for wanted, those in self._index.wanted():
            if self._choosing.leads(feature, wanted):
                yield from those

    def _consider(self, found: AdaptiveSubscription, name: str) -> None:
        """Take what might be better when it has been there for a while; at once if need be.

        A stream from outside proves by speaking that it is there, anything else by time.
        """
        now = self._clock()
        due = now + found.wish.hold_off
        if found.state is not State.RUNNING:
            self._ripe[found.id] = None
        elif name in found.made_by:
            if not found.looks_again:
                found.looks_again = True
                self._alarms.at(due, partial(self._look_again, found.id))
        elif name not in found.young:
            self._index.add_young(found, name, now)
            is_published = name in self._space.streams and name not in self._configuration.units
            if not is_published and name not in found.timed:
                found.timed.add(name)
                self._alarms.at(due, partial(self._has_stayed, found.id, name))

    def _has_stayed(self, id: str, name: str, now: int) -> None:
        found = self._index.get(id)
        if found is None:
            return
        found.timed.discard(name)
        if name not in found.young:
            return
        due = found.young[name] + found.wish.hold_off
        if due <= now:
            self._ripen(found, name)
        else:
            found.timed.add(name)
            self._alarms.at(due, partial(self._has_stayed, id, name))

    def _ripen(self, found: AdaptiveSubscription, name: str) -> None:
        self._index.drop_young(found, name)
        self._ripe[found.id] = None

    # -- time --------------------------------------------------------------------------------

    def tick(self, now: int) -> None:
        """The time is ``now`` (ns): who has fallen silent, and what has been better long enough.

        Cost: what is due, and a look at what was passed over.
        """
        for name in self._silences.take_all_back():
            self._back(name)
        self._alarms.ring(now)
        self.settle()

    def _look_again(self, id: str, now: int) -> None:
        found = self._index.get(id)
        if found is not None:
            found.looks_again = False
            self._ripe[id] = None

    def _forgive(self, id: str, name: str, now: int) -> None:
        found = self._index.get(id)
        if found is None or name not in found.avoided:
            return
        self._index.forgive(found, name)
        if found.state is not State.RUNNING:
            self._ripe[id] = None

    def _watch(self, found: AdaptiveSubscription, source: StreamGenerator, time: int) -> None:
        """Look at a source at ``time``, or before; there is one alarm for each."""
        if source not in found.watched:
            found.watched.add(source)
            soon = min(time, self._clock() + _LOOK_AGAIN)
            self._alarms.at(soon, partial(self._look_at, found.id, source))

    def _look_at(self, id: str, source: StreamGenerator, now: int) -> None:
        found = self._index.get(id)
        if found is None:
            return
        found.watched.discard(source)
        if source not in found.unit.arrivals:
            return
        silent_at = silent_from(found, source, self._silences)
        if silent_at is not None and silent_at <= now:
            blamed = culprits(found, source, self._silences, now)
            if not found.avoided.issuperset(blamed):
                for name in blamed:
                    self._avoid(found, name)
                self._lost.setdefault(id, f"{' and '.join(blamed)} fell silent")
        elif silent_at is not None and found.state is State.STALE:
            again = found.avoided & names_of(found.nodes_behind(source))
            for name in again:
                self._forgive(id, name, now)
            if again:
                self._lost.setdefault(id, f"{' and '.join(sorted(again))} speaks again")
        if silent_at is None or silent_at <= now:
            silent_at = now + _LOOK_AGAIN
        self._watch(found, source, silent_at)

    def settle(self) -> None:
        """Match again whoever has lost something, or may have something better by now."""
        times: Counter[str] = Counter()
        while self._lost or self._ripe:
            id = next(iter(self._lost or self._ripe))
            why = self._lost.pop(id, None)
            self._ripe.pop(id, None)
            found = self._index.get(id)
            if found is None:
                continue
            times[id] += 1
            if times[id] > _AT_ONCE:
                later = self._clock() + max(found.wish.hold_off, SECOND)
                self._alarms.at(later, partial(self._look_again, id))
            elif why is not None:
                self._rematch(found, why)
            else:
                self._improve(found)

    # -- matching again ----------------------------------------------------------------------

    def _improve(self, found: AdaptiveSubscription) -> None:
        """Take a better plan if there is one."""
        choosing = self._choosing
        if found.state is not State.RUNNING or not choosing.serves(found):
            self._rematch(found, "something appeared")
            return
        unusable = choosing.unusable(found, self._clock())
        supply = choosing.best(found, unusable | found.young.keys()).supply
        if supply is not None and choosing.is_better(found, supply):
            found.state = choosing.state_of(found, supply)
            self._switch(found, supply, "a better source appeared")

    def _rematch(self, found: AdaptiveSubscription, why: str, removed: str | None = None) -> None:
        """What it reads is lost or bad: take what is there, but not what is about to be
        ``removed``."""
        choosing = self._choosing
        without = frozenset() if removed is None else frozenset((removed,))
        match = choosing.best(found, choosing.unusable(found, self._clock()) | without)
        if match.supply is not None:
            found.state = choosing.state_of(found, match.supply)
        elif removed is None and choosing.serves(found):
            found.state = State.STALE
            return
        else:
            # Better a silent stream, which may speak again, than none.
            failing = found.avoided - self._space.streams.keys()
            match = choosing.best(
                found, choosing.made_streams() | failing | without, explained=True
            )
            found.state = State.WAITING if match.supply is None else State.STALE
        if match.supply is None:
            found.missing = match.missing
            if found.supply is None and found.rematches:
                return  # it waits already
        elif choosing.is_same(found, match.supply):
            return
        self._switch(found, match.supply, why)

    def _switch(self, found: AdaptiveSubscription, supply: Supply | None, why: str) -> None:
        try:
            streams = self._streams_of(found, supply)
        except DyknowError as error:
            # A plan that cannot be carried out: do without its transformations for a while.
            for name in transformations_of(() if supply is None else nodes_of_supply(supply)):
                self._avoid(found, name)
            self._lost[found.id] = f"{why}; {error.causes}"
            return
        self._index.forget_reads(found)
        gained = self._switching.switch(found, supply, streams, why)
        self._index.remember_reads(found, self._configuration)
        now = self._clock()
        for stream in gained:
            self._watch(
                found, stream, silent_from(found, stream, self._silences) or now + _LOOK_AGAIN
            )
        if supply is not None:
            found.missing = ()
            found.quality = self._choosing.quality(supply)
        for part in self._configuration.upstream_units(found.unit):
            if part is not found.unit and part.failure is not None:
                self._note_failure(part)  # it failed on the past, before anybody read it

    def _streams_of(
        self, found: AdaptiveSubscription, supply: Supply | None
    ) -> tuple[StreamGenerator, ...]:
        """The streams of a plan. A subscription that begins at a moment which they do not keep is
        refused; one that has waited begins with what they keep, and its switch says that some is
        lost. Raises `DyknowError`, and `Forgotten` for a request."""
        if supply is not None and not found.has_begun:
            since = self._plans.resolve_duration(found.wish.since, [supply])
            found.wish = replace(found.wish, since=since)
        begin = partial(self._switching.streams_of, found, supply)
        return start_from_retained(found.begins, begin) if found.rematches else begin(found.begins)
