"""Semantic matching: find the streams and units that give a wanted feature.

[Introspection15 §4.3]. The engine calls `match_all` with the wants of a query or a subscription;
docs/explanation/design/0003-semantic-matching.md explains how it works.

One stream (or unit) that holds every wanted object is a complete supply. Where there is none, each
stream that holds some of them is a source, and together they are a partial supply. Of two sources
of which one covers the other's objects only the wider is taken, so that no sample counts twice.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from itertools import chain
from typing import TypeAlias

from ..ontology.vocabulary import Vocabulary
from .explain import Explainer
from .fast_search import FastSearch
from .feature_index import FeatureIndex
from .gc_pause import gc_paused
from .goal import Answer, Goal, goal_of
from .goals import Goals
from .optimal_plan import find_optimal_plan
from .plan import Node, Supply, nothing_runs
from .plan_builder import Builder, source_of
from .render import render
from .space import StreamSpace
from .strategy import Kind, Strategy, UnknownStrategy
from .stream_offers import StreamOffers
from .subject import Sorts, Subjects
from .tree import Alternative, Match, Outcome
from .want import Want

__all__ = [
    "Alternative",
    "Match",
    "Outcome",
    "Strategy",
    "UnknownStrategy",
    "match",
    "match_all",
    "render",
]


def match(want: Want, space: StreamSpace, vocabulary: Vocabulary, strategy: str = "fast") -> Match:
    """Match one want; see `match_all`."""
    (found,) = match_all([want], space, vocabulary, strategy)
    return found


def match_all(
    wants: Sequence[Want],
    space: StreamSpace,
    vocabulary: Vocabulary,
    strategy: str = "fast",
    *,
    without: AbstractSet[str] = frozenset(),
    is_running: Callable[[Node], bool] = nothing_runs,
    explained: bool = True,
) -> tuple[Match, ...]:
    """Match several wants together; returns one match for each, in order.

    A unit that several wants need is made once: *cost* counts it once, and *fast* tries a stream
    that serves several before others. ``without`` names streams and transformations that are not
    to be used. ``is_running`` returns whether a selection has a unit, which then costs nothing.
    Without ``explained`` the trees are left out. Raises `UnknownStrategy`. Law: the same arguments
    give equal matches.
    """
    chosen = Strategy.parse(strategy)
    with gc_paused():
        return _match_all(
            wants, space, vocabulary, chosen, without, is_running, explained=explained
        )


def _match_all(
    wants: Sequence[Want],
    space: StreamSpace,
    vocabulary: Vocabulary,
    chosen: Strategy,
    without: AbstractSet[str],
    is_running: Callable[[Node], bool],
    *,
    explained: bool,
) -> tuple[Match, ...]:
    favoured = _favoured(wants, space, vocabulary, without)
    goals = Goals(space, vocabulary, without=without, favoured=favoured)
    search = FastSearch(goals)
    needed = [_needed(goals, search, want) for want in dict.fromkeys(wants)]
    answers, proven = _choose(goals, search, needed, chosen, is_running)
    builder = Builder(answers, goals.index.sorts)
    explainer = Explainer(goals, search, answers)
    found = {}
    for need in needed:
        supply = _supply(need, builder)
        if supply is None and need.goals:
            reason = f"more than {MAX_DEPTH} transformations would stand on one path"
            found[need.want] = Match(need.want, str(chosen), None, (), (reason,), proven)
            continue
        tree = explainer.alternatives(need.want, need.goals, supply) if explained else ()
        reasons = explainer.missing(need.want, tree) if supply is None and explained else ()
        found[need.want] = Match(need.want, str(chosen), supply, tree, reasons, proven)
    return tuple(found[want] for want in wants)


MAX_DEPTH = 200
"""Transformations on a path of a plan, at most: a unit calls the next one."""


@dataclass(frozen=True, slots=True)
class _Needed:
    """The goals that together give a want: one for all of it, or several for parts."""

    want: Want
    goals: tuple[Goal, ...]
    complete: bool


def _favoured(
    wants: Sequence[Want], space: StreamSpace, vocabulary: Vocabulary, without: AbstractSet[str]
) -> Mapping[str, int]:
    """The number of wants that each stream serves completely by itself, where there are several."""
    counts: Counter[str] = Counter()
    distinct = tuple(dict.fromkeys(wants))
    if len(distinct) > 1:
        index = FeatureIndex(space, vocabulary, without)
        offers = StreamOffers(index, {})
        for want in distinct:
            found = offers.of(goal_of(want, index.sorts))
            counts.update({offer.stream.name for offer in found})
    return counts


def _needed(goals: Goals, search: FastSearch, want: Want) -> _Needed:
    whole = goal_of(want, goals.index.sorts)
    if search.solve(whole):
        return _Needed(want, (whole,), complete=True)
    parts = [part for part in goals.parts(whole) if search.solve(part)]
    return _Needed(want, tuple(_widest(goals.index.sorts, parts)), complete=False)


def _widest(sorts: Sorts, parts: Sequence[Goal]) -> Sequence[Goal]:
    """The parts whose objects no other part covers; of equal ones the first."""
    # Only a sort covers other objects, and sorts are few where objects may be many.
    wide: list[int] = []
    alike: defaultdict[_Objects, list[int]] = defaultdict(list)
    for place, part in enumerate(parts):
        objects = tuple(subject.object for subject in part.subjects)
        alike[objects].append(place)
        if None in objects:
            wide.append(place)

    def covers(wider: Subjects, narrower: Subjects) -> bool:
        return all(map(sorts.covers, wider, narrower))

    def is_covered(place: int, subjects: Subjects) -> bool:
        for i in chain(wide, alike[tuple(subject.object for subject in subjects)]):
            other = parts[i].subjects
            is_same_stream = parts[i].streams == parts[place].streams
            is_wider = i != place and is_same_stream and covers(other, subjects)
            if is_wider and (i < place or not covers(subjects, other)):
                return True
        return False

    return [part for i, part in enumerate(parts) if not is_covered(i, part.subjects)]


_Objects: TypeAlias = tuple[str | None, ...]
"""The objects of several subjects; None for every object of a sort."""


def _choose(
    goals: Goals,
    search: FastSearch,
    needed: Sequence[_Needed],
    strategy: Strategy,
    is_running: Callable[[Node], bool],
) -> tuple[Mapping[Goal, Answer], bool]:
    roots = [goal for need in needed for goal in need.goals]
    if strategy.kind is Kind.FAST or not roots:
        return search.chosen, True
    optimal = find_optimal_plan(goals, roots, strategy, is_running)
    assert optimal is not None, "each of them has an answer"
    return optimal.chosen, optimal.proven


def _supply(need: _Needed, builder: Builder) -> Supply | None:
    """The plans for the goals; None where there are none, or one is too deep."""
    found = [builder.build(goal) for goal in need.goals]
    if not found or max(each.depth for each in found) > MAX_DEPTH:
        return None
    sources = tuple(
        source_of(each, goal, need.want) for goal, each in zip(need.goals, found, strict=True)
    )
    return Supply(need.want, sources, need.complete)
