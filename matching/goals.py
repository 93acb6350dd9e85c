"""The transformation tree, unfolded where somebody looks ([Introspection15 §4.3]).

A `Goal` is features of the same objects that somebody needs together. Its answers are the
*alternatives* of the paper: a stream that holds them all (an `Offer`), a transformation whose
output is the feature (a `Through`), or, of several features, parts that are synchronized (an
`Apart`). What an answer needs in turn is its *conjunction*.

The order of answers is the order of trying: streams before transformations; of streams those that
serve more wants of the same query, then exact features before sub-features, then those about the
wanted object itself, then those made for the sort before more general ones, then as registered;
of transformations exact outputs first, then sub-features by name, each as registered.

Arguments with the same name in an annotation are the same object. What no argument of the output
names (the `RMAX` that sees a `Human`) may be any object there is: `self` first, then those that
streams speak of. Of two kinds of objects that meet in a unit only the output's own may be many:
nothing says which of many others belongs to which.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from collections.abc import Set as AbstractSet
from functools import lru_cache
from itertools import islice, product
from typing import NamedTuple, TypeAlias

from ..languages.ssl.annotation import Argument, Content, Role
from ..ontology.units import UnitError, conversion, parse_unit
from ..ontology.vocabulary import SELF, THING, Vocabulary
from .space import (
    Ask,
    EventDescription,
    StreamDescription,
    StreamSpace,
    TransformationDescription,
    unit_text,
)
from .subject import Roles, Sorts, Subject, Subjects
from .want import Want

PARTICIPANTS = 64
"""Objects that are tried, at most, where a transformation takes any object of a sort."""
COMBINED = 512
"""Combinations of parts that are tried, at most, where several subjects are wanted at once."""


class Goal(NamedTuple):
    """Features of the same objects, in samples that belong together.

    ``joined``: whoever needs it synchronizes it with others, so parts of it need no
    synchronization of their own.
    """

    asks: tuple[Ask, ...]
    subjects: Subjects
    joined: bool = False


class Offer(NamedTuple):
    """A stream that holds all that is asked for; ``contents`` one an ask, all of the same roles."""

    stream: StreamDescription
    contents: tuple[Content, ...]

    @property
    def roles(self) -> Roles:
        return self.contents[0].roles


class Through(NamedTuple):
    """A transformation fed with ``needs``: input ``i`` with ask ``k`` of ``needs[j]``, where
    ``feeds[i]`` is ``(j, k)``."""

    unit: TransformationDescription
    needs: tuple[Goal, ...]
    feeds: tuple[tuple[int, int], ...]


class Apart(NamedTuple):
    """Several asks answered by different streams; ``needs[j]`` answers those at ``places[j]``."""

    needs: tuple[Goal, ...]
    places: tuple[tuple[int, ...], ...]


Answer: TypeAlias = Offer | Through | Apart

_Binding: TypeAlias = Mapping[str, Subject]
_Said: TypeAlias = Mapping[str | None, Subject]
"""What is said of the objects of a goal: it holds for them in its inputs, too."""
_Features: TypeAlias = tuple[str, ...]
_Group: TypeAlias = tuple[tuple[str, ...], Subjects]
"""Inputs of the same objects: the arguments that are many, and whom all of them mean."""


class Goals:
    """The answers to goals in one space. Valid as long as the space and the vocabulary stay.

    ``without`` names streams and transformations that are not to be used, ``favoured`` says of
    streams how many wants they serve: more is first.
    """

    def __init__(
        self,
        space: StreamSpace,
        vocabulary: Vocabulary,
        *,
        without: AbstractSet[str] = frozenset(),
        favoured: Mapping[str, int] | None = None,
    ) -> None:
        self.space = space
        self.vocabulary = vocabulary
        self.sorts = Sorts(vocabulary)
        self.without = without
        self._favoured = favoured or {}
        self._offers: dict[Goal, tuple[Offer, ...]] = {}
        self._ways: dict[Goal, tuple[Through | Apart, ...]] = {}
        self._serving: dict[str, _Features] = {}
        self._holders: dict[str, frozenset[str]] = {}
        self._known: dict[frozenset[str], tuple[Subject, ...]] = {}

    # -- what is asked -----------------------------------------------------------------------

    def top(self, want: Want) -> Goal:
        """The goal of a want: the feature in its own unit, of all that is wanted."""
        info = self.vocabulary.feature(want.feature)
        unit = None if info is None or info.unit is None else unit_text(info.unit)
        own = Subject(want.sort, self.sorts.canonical(want.object)) if want.object else None
        first = own or Subject(want.wanted_sort, None)
        others = (
            other._replace(object=self.sorts.canonical(other.object)) if other.object else other
            for other in want.others
        )
        return Goal((Ask(want.feature, unit),), _as_said((first, *others)))

    def parts(self, goal: Goal) -> tuple[Goal, ...]:
        """The same for parts of what is wanted, where no stream gives all of it; in order of
        trying. Cost: what leads to the feature is looked through once for each subject."""
        held = self._subjects(frozenset(ask.feature for ask in goal.asks))
        choices = []
        for wanted in goal.subjects:
            parts = (self.sorts.part(each, wanted) for each in held)
            choices.append(dict.fromkeys((wanted, *(part for part in parts if part is not None))))
        if len(choices) == 1:
            combined: dict[Subjects, None] = {(part,): None for part in choices[0]}
        else:
            combined = dict.fromkeys(map(_as_said, islice(product(*choices), COMBINED)))
        combined.pop(goal.subjects, None)
        return tuple(Goal(goal.asks, subjects) for subjects in combined)

    # -- alternatives ------------------------------------------------------------------------

    def answers(self, goal: Goal) -> Iterator[Answer]:
        """Every answer, in order of trying; looked for only when it is asked for."""
        yield from self.offers(goal)
        yield from self._throughs(goal)
        if len(goal.asks) > 1:
            yield from self._aparts(goal)

    def offers(self, goal: Goal) -> tuple[Offer, ...]:
        """The streams that hold all that is asked for, best first."""
        found = self._offers.get(goal)
        if found is None:
            ranked = list(self._ranked_offers(goal))
            if len(ranked) > 1:
                ranked.sort(key=lambda pair: pair[0])
            found = self._offers[goal] = tuple(offer for _, offer in ranked)
        return found

    def ways(self, goal: Goal) -> tuple[Through | Apart, ...]:
        """The transformations, then the parts, that give all that is asked for, in order."""
        found = self._ways.get(goal)
        if found is None:
            apart = () if len(goal.asks) == 1 else self._aparts(goal)
            found = self._ways[goal] = (*self._throughs(goal), *apart)
        return found

    def producers(self, ask: Ask) -> Iterator[TransformationDescription]:
        """The transformations whose output is the feature or a sub-feature of it, in order."""
        space = self.space
        for feature in self.serving(ask.feature):
            for name in space.giving(feature):
                if name not in self.without:
                    yield space.transformations[name]

    def candidates(self, goal: Goal) -> Iterator[StreamDescription]:
        """The streams that hold the first feature asked for, of anything that may be meant."""
        features = self.serving(goal.asks[0].feature)
        if not any(map(self.space.holding, features)):
            return
        object = goal.subjects[0].object if goal.subjects else None
        seen: dict[str, None] = {}
        for feature in features:
            if object is None:
                seen |= dict.fromkeys(self.space.holding(feature))
            else:
                seen |= dict.fromkeys(self.space.holding_object(feature, None))
                seen |= dict.fromkeys(self.space.holding_object(feature, object))
        for name in seen:
            if name not in self.without:
                yield self.space.streams[name]

    def serving(self, feature: str) -> _Features:
        """``feature``, then its sub-features by name."""
        found = self._serving.get(feature)
        if found is None:
            below = sorted(self.vocabulary.subfeatures(feature) - {feature})
            found = self._serving[feature] = (feature, *below)
        return found

    # -- streams -----------------------------------------------------------------------------

    def _ranked_offers(self, goal: Goal) -> Iterator[tuple[tuple[object, ...], Offer]]:
        subjects = goal.subjects
        object = subjects[0].object if subjects else None
        for stream in self.candidates(goal):
            seen: set[Roles] = set()
            for first in self._contents(stream, goal.asks[0], None):
                roles = first.roles
                if roles in seen or not self.sorts.holds(roles, subjects):
                    continue
                others = [next(self._contents(stream, a, roles), None) for a in goal.asks[1:]]
                contents = (first, *(other for other in others if other is not None))
                if len(contents) < len(goal.asks):
                    continue
                seen.add(roles)
                inexact = sum(
                    c.feature != a.feature for c, a in zip(contents, goal.asks, strict=True)
                )
                rank = (
                    -self._favoured.get(stream.name, 0),
                    inexact,
                    object is None or roles[0].object != object,
                    self._generality(roles, subjects),
                    self.space.place(stream.name),
                    len(seen),
                )
                yield rank, Offer(stream, contents)

    def _contents(
        self, stream: StreamDescription, ask: Ask, roles: Roles | None
    ) -> Iterator[Content]:
        """What answers ``ask`` for ``roles`` (None: any): exact features, then sub-features."""
        serving = self.serving(ask.feature)
        fitting = [
            content
            for content, unit in zip(stream.contents, stream.units, strict=True)
            if content.roles
            and (roles is None or content.roles == roles)
            and content.feature in serving
            and why_not_convertible(unit, ask.unit) == ""
        ]
        if len(fitting) > 1:
            fitting.sort(key=lambda content: content.feature != ask.feature)
        return iter(fitting)

    def _generality(self, roles: Roles, subjects: Subjects) -> int:
        """How far the stream's sort is above the wanted one: a stream made for a sort goes before
        one that speaks of it among others."""
        sort = roles[0].sort
        above = self.vocabulary.supersorts((subjects[0].sort if subjects else None) or THING)
        if sort is None or sort not in above:
            return 0
        return len(above) - len(self.vocabulary.supersorts(sort))

    # -- transformations ---------------------------------------------------------------------

    def _throughs(self, goal: Goal) -> Iterator[Through]:
        first, *others = goal.asks
        if others:
            # One output is all of them, so it is a sub-feature of each.
            features = set(self.serving(first.feature))
            if any(features.isdisjoint(self.serving(ask.feature)) for ask in others):
                return
        for unit in self.producers(first):
            yield from self.through(unit, goal)

    def through(self, unit: TransformationDescription, goal: Goal) -> Iterator[Through]:
        """The ways in which a transformation gives the goal, one for each choice of what it takes
        besides the objects of its output."""
        if unit.lacks or not all(self._gives(unit, ask) for ask in goal.asks):
            return
        if unit.passes_through:
            yield Through(unit, *self._together(unit.asks, unit.fed, goal.subjects))
            return
        bound = self._bind(unit.arguments, goal.subjects)
        if bound is None:
            return
        if isinstance(unit, EventDescription):
            wants = unit.wants_of(goal.subjects[0])
            if wants is not None:
                yield Through(unit, tuple(self.top(want) for want in wants), ())
            return
        if not unit.inputs:
            yield Through(unit, (), ())
            return
        said = _said_of(goal.subjects)
        for binding in self._bindings(unit, bound, said):
            needs = self._needs(unit, binding, said)
            if needs is not None:
                yield Through(unit, *needs)

    def _gives(self, unit: TransformationDescription, ask: Ask) -> bool:
        return (
            unit.output.feature == ask.feature or unit.output.feature in self.serving(ask.feature)
        ) and (unit.output_unit == ask.unit or not why_not_convertible(unit.output_unit, ask.unit))

    def _bind(self, arguments: Sequence[Argument], subjects: Subjects) -> _Binding | None:
        """What the arguments of an output are, for it to speak of ``subjects``; None: never."""
        if not arguments:
            return {}
        if len(arguments) < len(subjects):
            return None
        binding: dict[str, Subject] = {}
        for argument, subject in zip(arguments, subjects, strict=False):
            if argument.object is not None:
                if subject.object != self.sorts.canonical(argument.object):
                    return None
                continue
            sort = argument.sort or THING
            if not self.sorts.belongs(subject, sort):
                return None
            if argument.id_field is None:
                binding[argument.variable] = self.sorts.bounded(subject, sort)
            elif any(not self.sorts.within(sort, bound) for bound in subject.bounds):
                return None
        return binding

    def _bindings(
        self, unit: TransformationDescription, bound: _Binding, said: _Said
    ) -> Iterator[_Binding]:
        """``bound`` with every choice for what is not bound."""
        free: dict[str, list[str]] = {}
        features: dict[str, set[str]] = {}
        for port in unit.inputs:
            for argument in port.arguments or unit.arguments:
                if argument.object is None and argument.variable not in bound:
                    free.setdefault(argument.variable, []).append(argument.sort or THING)
                    features.setdefault(argument.variable, set()).add(port.feature)
        if not free:
            yield bound
            return
        variable, *_ = free
        count = 0
        for participant in self._participants(frozenset(features[variable])):
            if count == PARTICIPANTS:
                return
            subject = said.get(participant.object, participant)
            if all(self.sorts.belongs(subject, sort) for sort in free[variable]):
                count += 1
                yield from self._bindings(unit, {**bound, variable: subject}, said)

    def _participants(self, features: frozenset[str]) -> Iterator[Subject]:
        """Objects and sorts that there may be streams of: ``self`` first."""
        own = Subject(None, self.sorts.canonical(SELF))
        yield own
        yield from (subject for subject in self._subjects(features) if subject != own)

    def _needs(
        self, unit: TransformationDescription, binding: _Binding, said: _Said
    ) -> tuple[tuple[Goal, ...], tuple[tuple[int, int], ...]] | None:
        """The goals of the inputs, those of the same objects together, and what feeds which."""
        groups: dict[_Group, dict[Ask, None]] = {}
        wanted: list[tuple[_Group, Ask]] = []
        for port, place in zip(unit.inputs, unit.fed, strict=True):
            arguments = port.arguments or unit.arguments
            own = self._port_subjects(arguments, binding, said)
            if own is None:
                return None
            pairs = zip(arguments, own, strict=True)
            many = tuple(a.variable for a, subject in pairs if subject.object is None)
            # Two arguments that stand for every object of a sort are still two.
            group, ask = (many, own), unit.asks[place]
            groups.setdefault(group, {})[ask] = None  # what feeds two inputs is needed once
            wanted.append((group, ask))
        if len(groups) > 1 and not self._is_clear(unit, {many for many, _ in groups if many}):
            return None
        needs: list[Goal] = []
        place_of: dict[tuple[_Group, Ask], tuple[int, int]] = {}
        for group, found in groups.items():
            asks = tuple(found)
            every = tuple(range(len(asks)))
            goals, fed = self._together(asks, every, group[1], joined=len(groups) > 1)
            for ask, (j, k) in zip(asks, fed, strict=True):
                place_of[group, ask] = (len(needs) + j, k)
            needs += goals
        return tuple(needs), tuple(place_of[each] for each in wanted)

    def _together(
        self,
        asks: tuple[Ask, ...],
        fed: tuple[int, ...],
        subjects: Subjects,
        *,
        joined: bool = False,
    ) -> tuple[tuple[Goal, ...], tuple[tuple[int, int], ...]]:
        """The goals of several asks of the same subjects: one, where a stream might hold some of
        them together, or one for each; and what feeds which input."""
        if len(asks) == 1 or self._may_be_held_together(asks):
            goal = Goal(asks, subjects, joined and len(asks) > 1)
            return (goal,), _in_one(fed)
        return tuple([Goal((ask,), subjects) for ask in asks]), _one_each(fed)

    def _may_be_held_together(self, asks: tuple[Ask, ...]) -> bool:
        """Whether there may be a stream that holds two of the features, or a unit whose output is
        both."""
        first, *others = asks
        seen = self._where(first.feature)
        for ask in others:
            names = self._where(ask.feature)
            if not seen.isdisjoint(names):
                return True
            seen = seen | names
        return False

    def _where(self, feature: str) -> frozenset[str]:
        """The feature and its sub-features, and the streams that hold them."""
        found = self._holders.get(feature)
        if found is None:
            serving = self.serving(feature)
            streams = (name for served in serving for name in self.space.holding(served))
            found = self._holders[feature] = frozenset((*serving, *streams))
        return found

    def _is_clear(self, unit: TransformationDescription, kinds: set[tuple[str, ...]]) -> bool:
        """Of several kinds of objects at most one is many, and the output keeps it apart."""
        if not kinds:
            return True
        own = {argument.variable for argument in unit.arguments if argument.id_field is None}
        return len(kinds) == 1 and all(set(variables) <= own for variables in kinds)

    def _port_subjects(
        self, arguments: Sequence[Argument], binding: _Binding, said: _Said
    ) -> Subjects | None:
        own = []
        for argument in arguments:
            if argument.object is not None:
                object = self.sorts.canonical(argument.object)
                own.append(said.get(object, Subject(None, object)))
                continue
            subject = binding[argument.variable]
            sort = argument.sort or THING
            if not self.sorts.belongs(subject, sort):
                return None
            own.append(self.sorts.bounded(subject, sort))
        return tuple(own)

    # -- parts -------------------------------------------------------------------------------

    def _aparts(self, goal: Goal) -> Iterator[Apart]:
        """What one stream serves together, as much as possible, and the rest one by one; last
        everything one by one."""
        everything = range(len(goal.asks))
        groups: dict[tuple[int, ...], None] = {}
        for first in everything if len(goal.asks) > 2 else ():
            for offer in self.offers(Goal((goal.asks[first],), goal.subjects)):
                contents = (
                    next(self._contents(offer.stream, ask, offer.roles), None) for ask in goal.asks
                )
                held = tuple(i for i, content in enumerate(contents) if content is not None)
                if 1 < len(held) < len(goal.asks):
                    groups[held] = None
        for held in sorted(groups, key=len, reverse=True):
            yield self._apart(goal, (held, *((i,) for i in everything if i not in held)))
        yield self._apart(goal, tuple((i,) for i in everything))

    def _apart(self, goal: Goal, places: tuple[tuple[int, ...], ...]) -> Apart:
        needs = (Goal(tuple(goal.asks[i] for i in group), goal.subjects) for group in places)
        return Apart(tuple(needs), places)

    # -- who there is ------------------------------------------------------------------------

    def _subjects(self, features: frozenset[str]) -> tuple[Subject, ...]:
        """Whose features stand in any stream, or come from any source, that can lead to
        ``features``: each once, in the order of looking."""
        found = self._known.get(features)
        if found is None:
            found = self._known[features] = tuple(self._look(features))
        return found

    def _look(self, features: frozenset[str]) -> Iterable[Subject]:
        space = self.space
        found: dict[Subject, None] = {}
        waiting, seen = sorted(features), set(features)
        for feature in waiting:
            for served in self.serving(feature):
                for name in space.holding(served):
                    if name in self.without:
                        continue
                    for content in space.streams[name].contents:
                        if content.feature == served:
                            found |= dict.fromkeys(map(_held, content.roles))
            for unit in self.producers(Ask(feature, None)):
                for argument in unit.arguments:
                    if argument.object is not None:
                        found[Subject(None, self.sorts.canonical(argument.object))] = None
                    else:
                        found[Subject(argument.sort or THING, None)] = None
                for port in unit.inputs:
                    if port.feature not in seen:
                        seen.add(port.feature)
                        waiting.append(port.feature)
        return found


@lru_cache(maxsize=4096)
def _in_one(fed: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """What feeds which input, where all asks are of one goal."""
    return tuple((0, place) for place in fed)


@lru_cache(maxsize=4096)
def _one_each(fed: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """What feeds which input, where each ask is a goal of its own."""
    return tuple((place, 0) for place in fed)


def _as_said(subjects: Subjects) -> Subjects:
    """The same, where of one object the same is said wherever it stands."""
    said = _said_of(subjects)
    return tuple(said.get(subject.object, subject) for subject in subjects)


def _said_of(subjects: Subjects) -> _Said:
    """What is said of each object; where two things are, the first."""
    said: dict[str | None, Subject] = {}
    for subject in subjects:
        object = subject.object
        if object is not None and (object not in said or said[object].sort is None):
            said[object] = subject
    return said


def _held(role: Role) -> Subject:
    return Subject(role.sort or THING, None) if role.object is None else Subject(None, role.object)


@lru_cache(maxsize=4096)
def why_not_convertible(source: str, target: str | None) -> str:
    """Why values in ``source`` units cannot be had in ``target`` units (None: any), as texts;
    empty if they can."""
    if target is None or source == target:
        return ""
    try:
        conversion(parse_unit(source), parse_unit(target))
    except UnitError as error:
        return str(error)
    return ""
