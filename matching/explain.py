"""The reasons for and against each alternative of a match ([Introspection15 §4.3])."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace

from ..languages.hints import did_you_mean
from ..ontology.vocabulary import THING
from ..rdf.namespaces import shorten
from .fast_search import FastSearch
from .goal import Answer, Goal, Offer, Through, goal_of
from .goals import Goals
from .plan import Compute, Detect, Supply, UseStream, nodes_of
from .plan_text import stream_text, transformation_text
from .space import Ask, StreamDescription, TransformationDescription, why_not_convertible
from .subject import Subjects, whose
from .tree import Alternative, Outcome
from .want import Want

LISTED = 20
"""Alternatives of one kind to list; of the others only the number is shown."""
EXPLAINED_DEPTH = 12
"""Features on a path beyond which a failure is not explained further."""


class Explainer:
    """Explains a match. A transformation that fails is explained where it comes first."""

    def __init__(self, goals: Goals, search: FastSearch, chosen: Mapping[Goal, Answer]) -> None:
        self._goals = goals
        self._index = goals.index
        self._search = search
        self._chosen = chosen
        self._explained: set[tuple[str, Goal]] = set()

    def alternatives(
        self, want: Want, answered: Sequence[Goal], supply: Supply | None
    ) -> tuple[Alternative, ...]:
        """All ways to the wanted feature: streams, then transformations, in the order of trying.

        *fast* does not try the transformations after its choice, so they are listed as not tried.
        Streams are judged in any case, since that is cheap.
        """
        top = goal_of(want, self._index.sorts)
        self._explained.clear()
        streams = tuple(self._streams(top, supply))
        units = tuple(self._units(top, answered or (top,), supply))
        return streams + units

    def missing(self, want: Want, tree: tuple[Alternative, ...]) -> tuple[str, ...]:
        """The reasons at the leaves of a tree without a plan, each once."""
        unknown = [name for name in want.streams if name not in self._index.space.streams]
        if unknown:
            hint = did_you_mean(unknown[0], self._index.space.streams)
            text = f"there is no stream {unknown[0]} with an annotation"
            return (f"{text}: {hint}" if hint else text,)
        if not tree:
            return (_nothing_gives(want.feature),)
        return tuple(dict.fromkeys(_leaves(tree)))[:LISTED]

    # -- streams -----------------------------------------------------------------------------

    def _streams(self, goal: Goal, supply: Supply | None) -> Iterator[Alternative]:
        """Each stream with the feature: chosen, possible, or why not."""
        index = self._index
        chosen = _chosen_streams(supply)
        found = {stream.name: stream for stream in self._goals.streams.candidates(goal)}
        if supply is None and len(found) < LISTED:
            # Streams about other objects are no candidates, but the user learns that they exist.
            space = index.space
            names = (n for f in index.serving(goal.asks[0].feature) for n in space.holding(f))
            found |= {name: space.streams[name] for name in names}
        streams = sorted(
            found.values(), key=lambda s: (s.name not in chosen, index.space.place(s.name))
        )
        for stream in streams[:LISTED]:
            serving = index.serving(goal.asks[0].feature)
            fields = [c.field for c in stream.contents if c.feature in serving]
            text = stream_text(stream.name, stream.contents, fields, maker=stream.maker)
            if stream.name in chosen:
                yield Alternative(text, Outcome.CHOSEN, stream=stream.name)
            else:
                yield replace(self._stream(stream, goal, text), stream=stream.name)
        if len(streams) > LISTED:
            more = len(streams) - LISTED
            yield Alternative(f"{more} more streams", Outcome.UNTRIED, "not listed")

    def _stream(self, stream: StreamDescription, goal: Goal, text: str) -> Alternative:
        index = self._index
        if stream.name in index.without:
            return Alternative(
                text, Outcome.FAILED, "it is silent, has ended, or serves another request only"
            )
        if goal.streams and stream.name not in goal.streams:
            return Alternative(text, Outcome.FAILED, _names_others(goal))
        ask, subjects = goal.asks[0], goal.subjects
        reasons: dict[str, None] = {}
        for content, unit in zip(stream.contents, stream.units, strict=True):
            if content.feature not in index.serving(ask.feature) or not content.roles:
                continue
            reason = index.sorts.why_not_all(content.roles, subjects)
            reason = reason or why_not_convertible(unit, ask.unit)
            if not reason:
                whole = index.sorts.holds(content.roles, subjects)
                part = "" if whole else "some of the objects"
                return Alternative(text, Outcome.POSSIBLE, part)
            reasons[reason] = None
        return Alternative(text, Outcome.FAILED, "; ".join(reasons))

    # -- transformations ---------------------------------------------------------------------

    def _units(
        self, top: Goal, answered: Sequence[Goal], supply: Supply | None
    ) -> Iterator[Alternative]:
        """Each transformation that gives the feature: chosen, possible, not tried, or why not."""
        chosen = _chosen_units(supply)
        is_lazy = self._chosen is self._search.chosen and supply is not None and supply.complete
        passed = is_lazy and not chosen
        for unit in self._giving(top.asks[0]):
            if unit.name in chosen:
                passed = is_lazy
                yield Alternative(transformation_text(unit), Outcome.CHOSEN)
            elif passed:
                yield Alternative(transformation_text(unit), Outcome.UNTRIED)
            elif any(self._is_possible(unit, goal) for goal in answered):
                yield Alternative(transformation_text(unit), Outcome.POSSIBLE)
            else:
                yield self._unit(unit, answered[0], frozenset())

    def _giving(self, ask: Ask) -> tuple[TransformationDescription, ...]:
        return tuple(self._index.producers(ask))

    def _is_possible(self, unit: TransformationDescription, goal: Goal) -> bool:
        return any(self._solves(goal, way) for way in self._goals.ways(goal) if _is_by(way, unit))

    def _solves(self, goal: Goal, way: Answer) -> bool:
        """Whether all needs of ``way`` have answers without ``goal`` itself."""
        assert not isinstance(way, Offer)
        search = FastSearch(self._goals, blocked={goal})
        return all(search.solve(need) for need in way.needs)

    def _unit(
        self, unit: TransformationDescription, goal: Goal, path: frozenset[Goal]
    ) -> Alternative:
        """Why this transformation gives nothing."""
        text = transformation_text(unit)
        reason = self._no_answer(unit, goal)
        if reason:
            return Alternative(text, Outcome.FAILED, reason)
        ways = [way for way in self._goals.ways(goal) if _is_by(way, unit)]
        if not ways:
            return Alternative(text, Outcome.FAILED, self._unclear(unit))
        if (unit.name, goal) in self._explained:
            return Alternative(text, Outcome.FAILED, "as said above")
        if len(path) >= EXPLAINED_DEPTH:
            return Alternative(text, Outcome.FAILED, "nothing further below gives its inputs")
        self._explained.add((unit.name, goal))
        below = path | {goal}
        lacking: dict[Goal, Alternative] = {}
        way = min(ways, key=lambda way: sum(not self._search.solve(need) for need in way.needs))
        for need in way.needs:
            for ask in need.asks:
                single = need._replace(asks=(ask,))
                if single in below:
                    return Alternative(
                        text, Outcome.FAILED, "a feature would stand twice on the path"
                    )
                if not FastSearch(self._goals, blocked=below).solve(single):
                    lacking[single] = self._lacking(single, below)
        if not lacking:
            return Alternative(text, Outcome.FAILED, "a feature would stand twice on the path")
        return Alternative(text, Outcome.FAILED, "", tuple(lacking.values()))

    def _lacking(self, goal: Goal, path: frozenset[Goal]) -> Alternative:
        """An input that nothing gives."""
        feature = goal.asks[0].feature
        text = f"{shorten(feature)} of {whose(goal.subjects)}"
        if self._index.sorts.is_sort(feature) and not goal.streams:
            return Alternative(
                text,
                Outcome.FAILED,
                "a template that others read has a sort of one stream: `FROM NAME` names it",
            )
        parts = [
            *self._streams(goal, None),
            *(self._unit(unit, goal, path) for unit in self._giving(goal.asks[0])),
        ]
        failed = tuple(
            part
            if part.outcome is Outcome.FAILED
            else Alternative(part.text, Outcome.FAILED, "it holds only some of the objects")
            for part in parts
        )
        return Alternative(text, Outcome.FAILED, "" if failed else _nothing_gives(feature), failed)

    def _no_answer(self, unit: TransformationDescription, goal: Goal) -> str:
        """Why its output cannot be the wanted feature, whatever its inputs; empty if it can."""
        if goal.streams:
            return _names_others(goal)
        if unit.lacks:
            return unit.lacks
        reason = why_not_convertible(unit.output_unit, goal.asks[0].unit)
        if reason:
            return reason
        for argument, subject in zip(unit.arguments, goal.subjects, strict=False):
            if argument.object is not None:
                object = self._index.sorts.canonical(argument.object)
                if subject.object != object:
                    return f"it speaks of {shorten(object)}, not of {subject}"
            elif not self._index.sorts.belongs(subject, argument.sort or THING):
                return _of_another_sort(unit, argument.sort or THING, goal.subjects)
        return ""

    def _unclear(self, unit: TransformationDescription) -> str:
        """Why no choice of its further arguments is possible."""
        own = {a.variable for a in unit.arguments if a.id_field is None}
        sorts = dict.fromkeys(
            shorten(argument.sort or THING)
            for port in unit.inputs
            for argument in port.arguments
            if argument.object is None and argument.variable not in own
        )
        if not sorts:
            return "its inputs speak of other objects than its output"
        names = " and ".join(sorts)
        return f"no single {names} is known for its inputs: name one, or say what self is"


def _names_others(goal: Goal) -> str:
    return f"only {' and '.join(goal.streams)} is read"


def _is_by(way: Answer, unit: TransformationDescription) -> bool:
    return isinstance(way, Through) and way.unit is unit


def _of_another_sort(unit: TransformationDescription, sort: str, subjects: Subjects) -> str:
    return f"it is for every {shorten(sort)}, and what is wanted is for {whose(subjects)}"


def _nothing_gives(feature: str) -> str:
    return f"no stream and no transformation gives {shorten(feature)}"


def _leaves(tree: tuple[Alternative, ...]) -> Iterator[str]:
    for alternative in tree:
        if alternative.parts:
            yield from _leaves(alternative.parts)
        elif alternative.reason:
            name = alternative.text.partition(" : ")[0]
            own = alternative.reason.startswith("no stream and no transformation")
            yield alternative.reason if own else f"{name}: {alternative.reason}"


def _chosen_streams(supply: Supply | None) -> Collection[str]:
    """The streams in which the wanted feature itself was found."""
    if supply is None:
        return ()
    return {
        node.stream
        for source in supply.sources
        if not any(isinstance(node, Compute | Detect) for node in nodes_of(source.node))
        for node in nodes_of(source.node)
        if isinstance(node, UseStream)
    }


def _chosen_units(supply: Supply | None) -> Collection[str]:
    """The transformations whose units give the wanted feature."""
    if supply is None:
        return ()
    lasts = (list(nodes_of(source.node)) for source in supply.sources)
    return {
        last.transformation if isinstance(last, Compute) else last.event
        for nodes in lasts
        for last in [next((n for n in reversed(nodes) if isinstance(n, Compute | Detect)), None)]
        if last is not None
    }
