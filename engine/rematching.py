"""When adaptive subscriptions are matched again, and what follows ([Introspection15 §4.4]).

What is lost is replaced at once; what is better is taken when it has been there for a while; what
cannot be met waits. Only subscriptions that read what was lost, or might read what appeared, are
looked at: the cost of a change is linear in these.
"""

from __future__ import annotations

import heapq
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import count

from ..converters.values import field_type
from ..matching.plan import Supply, UseStream, nodes_of, streams_of
from ..matching.reach import Reach
from ..matching.space import StreamSpace
from ..matching.strategy import Kind, Strategy
from ..matching.subject import Sorts, Subject
from ..matching.tree import Match
from ..matching.valuing import quality_of, weight_of
from ..ontology.ontology import Ontology
from ..rdf.dictionary import TermDictionary
from ..streams.generator import StreamGenerator
from ..streams.sample import Field, FieldType, Schema
from ..streams.strings import StringPool
from ..streams.time import SECOND
from .adaptive import (
    AdaptiveSubscription,
    Rematch,
    State,
    Wish,
    behind,
    merge_inputs,
    transformations_of,
    value_field,
)
from .arrivals import Arrivals
from .changes import Change, ChangeKind
from .configuration import MERGE, Configuration
from .merge_unit import MergeUnit, object_fields
from .plans import Plans
from .stream_units import AdaptationUnit
from .views import Since

_LOOK_AGAIN = SECOND
"""After so long (ns) a source is looked at again of which nobody knows when it is silent."""
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
        self._ontology = ontology
        self._dictionary = dictionary
        self._configuration = configuration
        self._plans = plans
        self._space = space
        self._clock = clock
        self._adapted = adapted
        self._reach = Reach(space)
        self._subscriptions: dict[str, AdaptiveSubscription] = {}
        self._by_output: dict[str, AdaptiveSubscription] = {}
        self._readers: dict[str, dict[str, None]] = defaultdict(dict)
        self._users: dict[str, dict[str, None]] = defaultdict(dict)
        self._wanting: dict[str, dict[str, None]] = defaultdict(dict)
        self._avoiders: dict[str, dict[str, None]] = defaultdict(dict)
        self._arrivals: dict[str, Arrivals] = {}
        self._gone: dict[str, int] = {}
        """Streams that were passed over as silent or ended, until they speak again, with how many
        samples they had then."""
        self._lost: dict[str, str] = {}
        self._better: dict[str, int] = {}
        self._due: list[tuple[int, int, str, StreamGenerator]] = []
        self._forgiven: list[tuple[int, str, str]] = []
        self._serial = count()
        self._looked = -1
        self._silent: dict[int | None, frozenset[str]] = {}

    # -- subscriptions -----------------------------------------------------------------------

    def start(self, id: str, wish: Wish) -> AdaptiveSubscription:
        """Subscribe. What cannot be met now waits until it can."""
        name = self._configuration.reserved_name()
        unit = self._unit(name, wish)
        self._configuration.start(unit, specification=f"{wish.want} by {wish.strategy}")
        adapted = self._adapted(unit.output, wish)
        if adapted is None:
            unit.users += 1
        found = AdaptiveSubscription(id, wish, unit, adapted)
        self._subscriptions[id] = found
        self._by_output[found.output.name] = found
        self._wanting[wish.want.feature][id] = None
        try:
            self._rematch(found, "requested")
        except Exception:
            self.cancel(id)
            raise
        return found

    def cancel(self, id: str) -> None:
        """Give a subscription up; its units stop with it."""
        found = self._subscriptions.pop(id)
        self._by_output.pop(found.output.name, None)
        self._forget_reads(found)
        for name in found.avoided:
            self._avoiders[name].pop(id, None)
        del self._wanting[found.wish.want.feature][id]
        self._lost.pop(id, None)
        self._better.pop(id, None)
        last = found.unit if found.adapted is None else found.adapted
        if self._configuration.units.get(last.output.name) is last:
            self._configuration.release(last)

    def get(self, id: str) -> AdaptiveSubscription | None:
        """A subscription by its id."""
        return self._subscriptions.get(id)

    def of_stream(self, name: str) -> AdaptiveSubscription | None:
        """The subscription whose stream this is."""
        return self._by_output.get(name)

    def _unit(self, name: str, wish: Wish) -> MergeUnit:
        want = wish.want
        info = self._ontology.vocabulary.feature(want.feature)
        objects = object_fields(1 + len(want.others))
        value = value_field(want)
        type = field_type(None if info is None else info.range)
        fields = (*(Field(n, FieldType.STRING) for n in objects), Field(value, type))
        pools = {each.name: StringPool() for each in fields if each.type is FieldType.STRING}
        output = self._configuration.add_stream(name, Schema(fields), pools=pools)
        parameters = {"feature": str(want), "strategy": wish.strategy}
        return MergeUnit(
            *self._configuration.identity(MERGE, (), output, parameters),
            dictionary=self._dictionary,
            value=value,
            clock=self._clock,
        )

    # -- what has happened -------------------------------------------------------------------

    def heard(self, change: Change) -> None:
        """Note whom a change of the stream space concerns."""
        if not self._subscriptions:
            return
        match change.kind:
            case ChangeKind.STREAM_ENDED:
                self._silent.clear()  # what was found silent at this moment lacks it
                self._pass_over(change.stream)
                self._note_loss(change.stream, f"{change.stream} ended")
            case ChangeKind.STREAM_REMOVED:
                self._arrivals.pop(change.stream, None)
                self._gone.pop(change.stream, None)
                self._note_loss(change.stream, f"{change.stream} was removed")
            case ChangeKind.UNIT_FAILED | ChangeKind.UNIT_STOPPED_BY_RULE:
                self._note_failure(change)
            case ChangeKind.STREAM_ANNOTATED:
                self._note_meaning(change.stream)
            case ChangeKind.QUALITY_CHANGED | ChangeKind.TRANSFORMATION_ANNOTATED:
                self._note_quality(change)
            case _:
                pass

    def _note_failure(self, change: Change) -> None:
        unit = self._configuration.units.get(change.stream)
        if unit is None or unit.failure is None:
            return  # it has begun anew, or goes on
        for id in self._readers.get(change.stream, ()):
            self._avoid(self._subscriptions[id], change.transformation)
        self._note_loss(change.stream, f"{change.unit} ({change.transformation}) failed")

    def _avoid(self, found: AdaptiveSubscription, name: str) -> None:
        """Use a stream no more until it speaks again, a transformation for a while."""
        found.avoided.add(name)
        self._avoiders[name][found.id] = None
        if name in self._space.streams:
            self._pass_over(name)
        else:
            heapq.heappush(self._forgiven, (self._clock() + _FORGIVEN, name, found.id))

    def _pass_over(self, stream: str) -> None:
        if stream not in self._gone and stream in self._configuration.streams:
            self._gone[stream] = self._configuration.streams[stream].counters.accepted

    def came(self, stream: str, now: int) -> None:
        """Samples of a stream have come (from outside)."""
        arrivals = self._arrivals.get(stream)
        if arrivals is None:
            self._arrivals[stream] = Arrivals(now)
        else:
            arrivals.came(now)
        if stream in self._gone:
            self._back(stream)

    def withdraw(self, stream: str) -> None:
        """A stream is about to be removed: nobody reads it any more, whatever there is instead."""
        for id in list(self._readers.get(stream, ())):
            found = self._subscriptions[id]
            found.avoided.add(stream)
            self._avoiders[stream][id] = None
            match = self._match(found)
            supply = None if match is None else match.supply
            if supply is not None and stream in streams_of(supply):
                supply = None
            if supply is None:
                found.state = State.WAITING
            self._switch(found, supply, f"{stream} is removed")

    def ontology_changed(self) -> None:
        """Sorts and features may contain each other otherwise: everybody is looked at again."""
        self._reach.forget()
        for id in self._subscriptions:
            self._better[id] = self._clock()

    def _back(self, stream: str) -> None:
        """A stream that was passed over speaks again."""
        del self._gone[stream]
        self._silent.clear()
        for id in list(self._avoiders.pop(stream, ())):
            self._subscriptions[id].avoided.discard(stream)
        self._note_gain(stream)
        for id in self._readers.get(stream, ()):
            found = self._subscriptions[id]
            if found.state is State.STALE:
                found.state = State.RUNNING

    def _note_loss(self, stream: str, why: str) -> None:
        for id in self._readers.get(stream, ()):
            self._lost.setdefault(id, why)
        self._postpone(stream)

    def _postpone(self, stream: str) -> None:
        """What might have been better is gone, or bad: whoever waits to take it waits anew."""
        for id in list(self._better):
            if self._may_serve(stream, self._subscriptions[id]):
                self._better[id] = self._clock() + self._subscriptions[id].wish.hold_off

    def _note_meaning(self, stream: str) -> None:
        known = self._space.streams.get(stream)
        for id in self._readers.get(stream, ()):
            found = self._subscriptions[id]
            nodes = [
                node
                for source in (found.supply.sources if found.supply else ())
                for node in nodes_of(source.node)
                if isinstance(node, UseStream) and node.stream == stream
            ]
            maker = self._configuration.units.get(stream)
            if maker is not None and self._plans.makes(stream):
                # It was said what it means before anybody read it: now its unit says otherwise.
                self._avoid(found, maker.transformation)
            elif all(known is not None and known.contents == node.contents for node in nodes):
                continue
            found.misled = True
            self._lost.setdefault(id, f"{stream} means something else")
        if known is not None and not self._plans.makes(stream):
            self._note_gain(stream)

    def _note_quality(self, change: Change) -> None:
        if change.described is not None:
            self._reach.forget()
            name = change.transformation
            concerned = dict(self._users.get(name, {}))
            text = f"quality of {name}"
            self._note_gain_of(change.described.description.output.feature, None)
        else:
            name = change.stream
            concerned = dict(self._readers.get(name, {}))
            text = f"quality of {name} is {change.quality:g}"
            self._note_gain(name)
        for id in concerned:
            found = self._subscriptions[id]
            strategy = Strategy.parse(found.wish.strategy)
            if found.wish.quality > 0 or strategy.kind in (Kind.QUALITY, Kind.WEIGHTED):
                self._lost.setdefault(id, text)

    def _note_gain(self, stream: str) -> None:
        """A stream is there that might be better for somebody."""
        known = self._space.streams.get(stream)
        for content in known.contents if known is not None else ():
            self._note_gain_of(content.feature, stream)

    def _note_gain_of(self, feature: str, stream: str | None) -> None:
        now = self._clock()
        for id in self._interested(feature):
            found = self._subscriptions[id]
            if stream is not None and stream in found.reads:
                continue
            if stream is None or self._may_serve(stream, found):
                waits = found.state is not State.RUNNING
                self._better[id] = now if waits else now + found.wish.hold_off

    def _interested(self, feature: str) -> Iterator[str]:
        """The subscriptions to whose feature ``feature`` may lead."""
        vocabulary = self._ontology.vocabulary
        for wanted, ids in self._wanting.items():
            if feature in self._reach.of(wanted, vocabulary):
                yield from ids

    def _may_serve(self, stream: str, found: AdaptiveSubscription) -> bool:
        """Whether a stream may have anything to do with what is wanted."""
        known = self._space.streams.get(stream)
        if known is None:
            return False
        want = found.wish.want
        vocabulary = self._ontology.vocabulary
        reach = self._reach.of(want.feature, vocabulary)
        direct = vocabulary.subfeatures(want.feature)
        sorts = Sorts(vocabulary)
        subject = (
            Subject(want.sort, want.object) if want.object else Subject(want.wanted_sort, None)
        )
        return any(
            content.feature in reach
            and (
                content.feature not in direct
                or not content.roles
                or not sorts.why_not(content.roles[0], subject)
            )
            for content in known.contents
        )

    # -- time --------------------------------------------------------------------------------

    def tick(self, now: int) -> None:
        """The time is ``now`` (ns): who has fallen silent, and what has been better long enough.

        Cost: what is due, and a look at what was passed over.
        """
        for name, accepted in list(self._gone.items()):
            generator = self._configuration.streams.get(name)
            if generator is not None and generator.counters.accepted != accepted:
                self._back(name)
        while self._forgiven and self._forgiven[0][0] <= now:
            _, name, id = heapq.heappop(self._forgiven)
            self._avoiders[name].pop(id, None)
            forgiven = self._subscriptions.get(id)
            if forgiven is not None:
                forgiven.avoided.discard(name)
                if forgiven.state is not State.RUNNING:
                    self._better[id] = now
        while self._due and self._due[0][0] <= now:
            _, _, id, source = heapq.heappop(self._due)
            found = self._subscriptions.get(id)
            if found is not None and source in found.unit.arrivals:
                self._look_at(found, source, now)
        self.settle()

    def _look_at(self, found: AdaptiveSubscription, source: StreamGenerator, now: int) -> None:
        silent_at = found.unit.arrivals[source].silent_at(found.wish.staleness)
        if silent_at is None or silent_at > now or found.state is State.STALE:
            next = now + _LOOK_AGAIN if silent_at is None or silent_at <= now else silent_at
            self._watch(found, source, next)
            return
        culprits = self._culprits(found, now)
        for name in culprits:
            self._avoid(found, name)
        self._lost.setdefault(found.id, f"{' and '.join(culprits)} fell silent")
        self._watch(found, source, now + _LOOK_AGAIN)

    def _culprits(self, found: AdaptiveSubscription, now: int) -> tuple[str, ...]:
        """Of what a silent plan is made from, what is silent itself: streams from outside, or
        else the transformations, which make nothing of what they get."""
        silent = self._silent_at(now, found.wish.staleness)
        streams = tuple(name for name in found.leaves if name in silent)
        if streams:
            return streams
        return tuple(sorted(found.made_by)) or found.leaves

    def _watch(self, found: AdaptiveSubscription, source: StreamGenerator, time: int) -> None:
        heapq.heappush(self._due, (time, next(self._serial), found.id, source))

    def _silent_at(self, now: int, declared: int | None) -> frozenset[str]:
        """The streams from outside that are silent by now, or have ended."""
        if self._looked != now:
            self._looked = now
            self._silent.clear()
        found = self._silent.get(declared)
        if found is None:
            streams = self._configuration.streams
            found = self._silent[declared] = frozenset(
                name
                for name in self._space.streams
                if name in streams
                and not self._plans.makes(name)
                and (streams[name].is_ended or self._is_silent(name, now, declared))
            )
        return found

    def _is_silent(self, name: str, now: int, declared: int | None) -> bool:
        arrivals = self._arrivals.get(name)
        if arrivals is None:
            return False
        silent_at = arrivals.silent_at(declared)
        return silent_at is not None and silent_at <= now

    def settle(self) -> None:
        """Match again whoever has lost something, or may have something better by now."""
        now = self._clock()
        times: Counter[str] = Counter()
        while True:
            lost, self._lost = self._lost, {}
            due = [id for id, time in self._better.items() if time <= now]
            for id in due:
                del self._better[id]
            if not lost and not due:
                return
            for id in due:
                if id not in lost and id in self._subscriptions:
                    self._improve(self._subscriptions[id])
            for id, why in lost.items():
                times[id] += 1
                if id not in self._subscriptions:
                    continue
                found = self._subscriptions[id]
                if times[id] > _AT_ONCE:
                    self._better[id] = now + max(found.wish.hold_off, SECOND)
                else:
                    self._rematch(found, why)

    # -- matching again ----------------------------------------------------------------------

    def _improve(self, found: AdaptiveSubscription) -> None:
        """Take a better plan if there is one."""
        if found.state is not State.RUNNING or found.supply is None:
            self._rematch(found, "something appeared")
            return
        match = self._match(found)
        if match is None or match.supply is None or self._is_same(found, match.supply):
            return
        strategy = Strategy.parse(found.wish.strategy)
        if strategy.kind is not Kind.FAST and match.supply.complete == found.supply.complete:
            new, old = (
                weight_of(supply, self._space, strategy, self._is_running(found))
                for supply in (match.supply, found.supply)
            )
            if not new < old:
                return
        self._switch(found, match.supply, "a better source appeared")

    def _rematch(self, found: AdaptiveSubscription, why: str) -> None:
        """What it reads is lost or bad: take what is there."""
        match = self._match(found)
        if match is None or match.supply is None:
            if self._still_reads(found):
                found.state = State.STALE
                return
            (told,) = self._plans.match([found.wish.want], found.wish.strategy, explained=True)
            found.missing = told.missing
            self._switch(found, None, why)
            return
        if self._is_same(found, match.supply):
            return
        self._switch(found, match.supply, why)

    def _match(self, found: AdaptiveSubscription) -> Match | None:
        """The best plan of what is not silent; None where only silent streams would do."""
        wish = found.wish
        now = self._clock()
        unusable = self._plans.unusable(Since.START, found.unit.delivered)
        own = {found.output.name, found.unit.output.name}
        silent = self._silent_at(now, wish.staleness) | found.avoided
        for name in silent:
            self._pass_over(name)
        match = self._best(found, unusable | silent | own)
        if match.supply is not None:
            found.state = State.RUNNING
            return match
        if self._still_reads(found):
            return None
        # Better a silent stream, which may speak again, than none.
        match = self._best(found, unusable | own | (found.avoided if found.misled else set()))
        found.state = State.WAITING if match.supply is None else State.STALE
        return match

    def _best(self, found: AdaptiveSubscription, without: Iterable[str]) -> Match:
        wish = found.wish
        excluded = frozenset(without)
        (match,) = self._plans.match([wish.want], wish.strategy, excluded)
        bound = wish.quality
        if match.supply is not None and bound > 0 and self._quality(match.supply) < bound:
            (other,) = self._plans.match([wish.want], str(Kind.QUALITY), excluded)
            if other.supply is not None:
                match = replace(other, strategy=wish.strategy)
        return match

    def _quality(self, supply: Supply) -> float:
        return quality_of(supply, self._space)

    def _is_running(self, found: AdaptiveSubscription) -> Callable[[object], bool]:
        own = {
            node
            for source in (found.supply.sources if found.supply else ())
            for node in nodes_of(source.node)
        }
        return lambda node: node in own

    def _is_same(self, found: AdaptiveSubscription, supply: Supply) -> bool:
        return (
            found.supply is not None
            and found.supply.sources == supply.sources
            and self._still_reads(found)
        )

    def _still_reads(self, found: AdaptiveSubscription) -> bool:
        """Its inputs are there, and work."""
        unit = found.unit
        return (
            bool(unit.inputs)
            and not found.misled
            and self._configuration.reads_what_is_there(unit)
            and not self._configuration.is_broken(unit)
        )

    def _switch(self, found: AdaptiveSubscription, supply: Supply | None, why: str) -> None:
        unit = found.unit
        before = unit.inputs
        is_first = not found.rematches and supply is not None and found.supply is None
        since = found.wish.since if is_first else Since.START
        position = found.output.stream.last_number
        sources = () if supply is None else supply.sources
        try:
            streams = [self._plans.obtain(source.node, since) for source in sources]
        except Exception:
            self._configuration.release_unused()
            raise
        lost_some = self._has_forgotten(unit, streams)
        inputs = (
            []
            if supply is None
            else merge_inputs(
                supply, streams, self._configuration, lambda: self._ontology.vocabulary
            )
        )
        names = found.leaves
        self._forget_reads(found)
        found.misled = False
        found.supply = supply
        unit.switch(inputs, history=since is Since.START)
        gained = [stream for stream in unit.inputs if stream not in before]
        lost = [stream for stream in before if stream not in unit.inputs]
        text = f"{found.wish.want}: {why}"
        self._configuration.change_inputs(unit, gained, lost, text)
        self._remember_reads(found)
        now = self._clock()
        for stream in gained:
            silent_at = unit.arrivals[stream].silent_at(found.wish.staleness)
            self._watch(found, stream, silent_at or now + _LOOK_AGAIN)
        found.rematches.append(Rematch(now, position, why, names, found.leaves, lost_some))
        if supply is not None:
            found.missing = ()

    def _has_forgotten(self, unit: MergeUnit, streams: Iterable[StreamGenerator]) -> bool:
        """Whether one of new sources has forgotten samples that follow the last one passed on."""
        if unit.output.stream.last_number == 0:
            return False
        for source in streams:
            if source in unit.arrivals or source.stream.first_number <= 1:
                continue
            kept = next(iter(source.stream.since(0)), None)
            if kept is not None and int(kept.batch.available[0]) > unit.delivered:
                return True
        return False

    def _remember_reads(self, found: AdaptiveSubscription) -> None:
        found.reads = frozenset(behind(found.unit, self._configuration))
        found.made_by = frozenset() if found.supply is None else transformations_of(found.supply)
        for name in found.reads:
            self._readers[name][found.id] = None
        for name in found.made_by:
            self._users[name][found.id] = None

    def _forget_reads(self, found: AdaptiveSubscription) -> None:
        _drop(self._readers, found.reads, found.id)
        _drop(self._users, found.made_by, found.id)


def _drop(index: dict[str, dict[str, None]], keys: Iterable[str], id: str) -> None:
    for key in keys:
        known = index.get(key)
        if known is not None:
            known.pop(id, None)
            if not known:
                del index[key]
