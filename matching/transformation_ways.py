"""Transformations that give a goal, and the goals of their inputs.

Exact outputs come first, then sub-features by name, each as registered.

Arguments with the same name in an annotation are the same object. An argument that the output does
not name (the `RMAX` that sees a `Human`) may be any object there is: `self` first, then those that
streams speak of. Of two kinds of objects that meet in a unit only the output's own may be many:
nothing says which of many others belongs to which.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TypeAlias

from ..languages.ssl.annotation import Argument
from ..ontology.vocabulary import SELF, THING
from .feature_index import FeatureIndex
from .goal import Goal, Through, goal_of
from .space import Ask, EventDescription, TransformationDescription, why_not_convertible
from .subject import Subject, Subjects, named_objects

PARTICIPANTS = 64
"""Objects that are tried, at most, where a transformation takes any object of a sort."""

_Binding: TypeAlias = Mapping[str, Subject]
_Said: TypeAlias = Mapping[str | None, Subject]
"""What the goal says of its objects: it holds for them in the inputs, too."""
_Group: TypeAlias = tuple[tuple[str, ...], Subjects]
"""Inputs of the same objects: the arguments that are many, and the subjects of all."""


class TransformationWays:
    """The ways through the transformations in an index."""

    def __init__(self, index: FeatureIndex) -> None:
        self._index = index
        self._sorts = index.sorts
        self._serving = index.serving

    def of(self, goal: Goal) -> Iterator[Through]:
        if goal.streams:
            return
        first, *others = goal.asks
        if others:
            # One output is all of them, so it is a sub-feature of each.
            features = set(self._serving(first.feature))
            if any(features.isdisjoint(self._serving(ask.feature)) for ask in others):
                return
        for unit in self._index.producers(first):
            yield from self._through(unit, goal)

    def _through(self, unit: TransformationDescription, goal: Goal) -> Iterator[Through]:
        """The ways in which a transformation gives the goal: one for each choice of the arguments
        that its output does not name."""
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
                yield Through(unit, tuple(goal_of(want, self._sorts) for want in wants), ())
            return
        if not unit.inputs:
            yield Through(unit, (), ())
            return
        said = named_objects(goal.subjects)
        for binding in self._bindings(unit, bound, said):
            needs = self._needs(unit, binding, said)
            if needs is not None:
                yield Through(unit, *needs)

    def _gives(self, unit: TransformationDescription, ask: Ask) -> bool:
        feature, own = unit.output.feature, unit.output_unit
        return (feature == ask.feature or feature in self._serving(ask.feature)) and (
            own == ask.unit or not why_not_convertible(own, ask.unit)
        )

    def _bind(self, arguments: Sequence[Argument], subjects: Subjects) -> _Binding | None:
        """Bind the arguments of an output to ``subjects``; None if that is impossible."""
        if not arguments:
            return {}
        if len(arguments) < len(subjects):
            return None
        binding: dict[str, Subject] = {}
        for argument, subject in zip(arguments, subjects, strict=False):
            if argument.object is not None:
                if subject.object != self._sorts.canonical(argument.object):
                    return None
                continue
            sort = argument.sort or THING
            if not self._sorts.belongs(subject, sort):
                return None
            if argument.id_field is None:
                binding[argument.variable] = self._sorts.bounded(subject, sort)
            elif any(not self._sorts.within(sort, bound) for bound in subject.bounds):
                return None
        return binding

    def _bindings(
        self, unit: TransformationDescription, bound: _Binding, said: _Said
    ) -> Iterator[_Binding]:
        """Extend ``bound`` by every choice of the arguments that are not bound."""
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
            if all(self._sorts.belongs(subject, sort) for sort in free[variable]):
                count += 1
                yield from self._bindings(unit, {**bound, variable: subject}, said)

    def _participants(self, features: frozenset[str]) -> Iterator[Subject]:
        """Objects and sorts of which there may be streams: ``self`` first."""
        own = Subject(None, self._sorts.canonical(SELF))
        yield own
        yield from (subject for subject in self._index.subjects(features) if subject != own)

    def _needs(
        self, unit: TransformationDescription, binding: _Binding, said: _Said
    ) -> tuple[tuple[Goal, ...], tuple[tuple[int, int], ...]] | None:
        """The goals of the inputs, one for the same objects, and the feeds of `Through`."""
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
            groups.setdefault(group, {})[ask] = None  # one ask may feed two inputs
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
        them together, or one for each; and the feeds of `Through`."""
        if len(asks) == 1 or self._index.may_be_held_together(asks):
            goal = Goal(asks, subjects, joined and len(asks) > 1)
            return (goal,), _in_one(fed)
        return tuple([Goal((ask,), subjects) for ask in asks]), _one_each(fed)

    def _is_clear(self, unit: TransformationDescription, kinds: set[tuple[str, ...]]) -> bool:
        """Whether at most one of several kinds of objects is many, and the output names it."""
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
                object = self._sorts.canonical(argument.object)
                own.append(said.get(object, Subject(None, object)))
                continue
            subject = binding[argument.variable]
            sort = argument.sort or THING
            if not self._sorts.belongs(subject, sort):
                return None
            own.append(self._sorts.bounded(subject, sort))
        return tuple(own)


@lru_cache(maxsize=4096)
def _in_one(fed: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """The feeds of `Through`, where all asks are of one goal."""
    return tuple((0, place) for place in fed)


@lru_cache(maxsize=4096)
def _one_each(fed: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """The feeds of `Through`, where each ask is a goal of its own."""
    return tuple((place, 0) for place in fed)
