"""The strategies that compare plans: cost, quality, and a weighted mix ([Introspection15 §4.3]).

The goals that lead to the wanted features are unfolded into an AND/OR graph of goals and producers;
`least_weight` and `best_quality` find its optimum. A producer is a stream, a selection, a
transformation or a synchronization. A producer that several goals use is one unit and counts once.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from itertools import zip_longest

import numpy as np

from .goal import Answer, Apart, Goal, Offer, Through
from .goals import Goals
from .optimum.best_quality import best_quality
from .optimum.hypergraph import Hypergraph
from .optimum.least_weight import least_weight
from .plan import Node, SelectObject, UseStream, nothing_runs
from .space import EventDescription
from .strategy import Kind, Strategy

SELECTION_COST = 1.0
"""The cost of one more unit that selects an object's samples."""
SYNCHRONIZATION_COST = 1.0
"""The cost of one more unit that synchronizes streams."""


@dataclass(frozen=True, slots=True)
class OptimalPlan:
    """The best answers. ``value`` is their total weight, or with *quality* the least quality of a
    wanted feature; no plan is better than ``bound``. ``proven``: this plan is as good."""

    chosen: dict[Goal, Answer]
    value: float
    bound: float
    proven: bool


def find_optimal_plan(
    goals: Goals,
    roots: Sequence[Goal],
    strategy: Strategy,
    is_running: Callable[[Node], bool] = nothing_runs,
) -> OptimalPlan | None:
    """Find the best plan for all ``roots`` together; None if one of them has none.

    Cost: linear in the goals and answers below the roots, then that of the optimum.
    """
    unfolded = _Unfolded(goals, strategy, is_running)
    places = [unfolded.goal(root) for root in roots]
    unfolded.unfold()
    graph = unfolded.graph()
    search = best_quality if strategy.kind is Kind.QUALITY else least_weight
    choice = search(graph, places)
    if choice is None:
        return None
    chosen = {}
    for producer in choice.producers.values():
        answered = unfolded.answered[producer]
        # Producers of shared streams and units answer no goal by themselves.
        if answered is not None:
            goal, answer = answered
            chosen[goal] = answer
    return OptimalPlan(chosen, choice.value, choice.bound, choice.proven)


class _Unfolded:
    """Builds the graph; its nodes are goals, and streams, selections and units that are shared."""

    def __init__(
        self, goals: Goals, strategy: Strategy, is_running: Callable[[Node], bool]
    ) -> None:
        self._goals = goals
        self._strategy = strategy
        self._is_running = is_running
        self._places: dict[Hashable, int] = {}
        self._synchronizing = strategy.weight(SYNCHRONIZATION_COST, 1.0)
        self._units: dict[Hashable, int] = {}
        """The first producer of each unit."""
        self._waiting: list[tuple[Goal, int]] = []
        self._derives: list[int] = []
        self._starts: list[int] = [0]
        self._inputs: list[int] = []
        self._weights: list[float] = []
        self._qualities: list[float] = []
        self.answered: list[tuple[Goal, Answer] | None] = []

    def goal(self, goal: Goal) -> int:
        """The number of a goal."""
        place = self._places.get(goal)
        if place is None:
            place = self._places[goal] = len(self._places)
            self._waiting.append((goal, place))
        return place

    def unfold(self) -> None:
        """Add everything below the goals that were asked for so far."""
        while self._waiting:
            goal, place = self._waiting.pop()
            for offer in self._goals.offers(goal):
                weight = self._offer(place, goal, offer)
                if weight == 0.0 and self._strategy.kind is not Kind.QUALITY:
                    break  # no later one is better
            for way in self._goals.ways(goal):
                if isinstance(way, Apart):
                    self._apart(place, goal, way)
                else:
                    self._through(place, goal, way)

    def graph(self) -> Hypergraph:
        """The graph as unfolded so far."""
        return Hypergraph(
            len(self._places),
            np.array(self._derives, np.int32),
            np.array(self._starts, np.int32),
            np.array(self._inputs, np.int32),
            np.array(self._weights, np.float64),
            np.array(self._qualities, np.float64),
        )

    def _apart(self, place: int, goal: Goal, way: Apart) -> None:
        """Add parts, and their synchronization unless the consumer of the goal does that."""
        needs = [self.goal(need) for need in way.needs]
        if not goal.joined:
            needs = [self._synchronization(needs)]
        self._add(place, needs, 0.0, 1.0, (goal, way))

    def _synchronization(self, needs: list[int]) -> int:
        # Numbers identify goals as well as goals do, and are faster to look up.
        return self._shared(("synchronize", *needs), needs, self._synchronizing, 1.0)

    def _through(self, place: int, goal: Goal, way: Through) -> None:
        """Add a unit, which may give other goals too, and the selections from its output."""
        unit = way.unit
        needs = [self.goal(need) for need in way.needs]
        # A unit without arguments is no event, and its output names no objects.
        is_event = bool(unit.arguments) and isinstance(unit, EventDescription)
        if len(needs) > 1 and not is_event:
            needs = [self._synchronization(needs)]
        weight = self._strategy.weight(unit.cost, unit.quality)
        # The query of an event depends on its objects, so other objects need another unit.
        key: Hashable = (unit.name, *needs, goal.subjects) if is_event else (unit.name, *needs)
        selections: Sequence[tuple[str, str]] = ()
        if unit.arguments:
            selections = [
                (argument.id_field, subject.object)
                for argument, subject in zip(unit.arguments, goal.subjects, strict=False)
                if argument.id_field is not None and subject.object is not None
            ]
        if not selections and self._units.setdefault(key, len(self._derives)) == len(self._derives):
            self._add(place, needs, weight, unit.quality, (goal, way))
            return
        made = self._unit(key, needs, weight, unit.quality)
        for selection in selections:
            price = self._strategy.weight(SELECTION_COST, 1.0)
            made = self._shared(("select", key, selection), [made], price, 1.0)
        # Several goals may use the unit, whose weight counts once.
        self._add(place, [made], 0.0, 1.0, (goal, way))

    def _unit(self, key: Hashable, needs: list[int], weight: float, quality: float) -> int:
        """The number of a unit that gives several goals, so that its cost counts once."""
        known = self._units.get(key)
        place = self._places.get(("unit", key))
        if known is not None and place is None:
            # So far it gave one goal only.
            place = self._places["unit", key] = len(self._places)
            first, answered = self._derives[known], self.answered[known]
            self._derives[known], self.answered[known] = place, None
            self._add(first, [place], 0.0, 1.0, answered)
        if place is None:
            self._units[key] = len(self._derives)
            place = self._shared(("unit", key), needs, weight, quality)
        return place

    def _offer(self, place: int, goal: Goal, offer: Offer) -> float:
        """Add the producer of an offer; returns its own weight."""
        stream = offer.stream
        strategy = self._strategy
        cost = stream.cost
        if strategy.subscribers:
            cost += strategy.subscribers * self._goals.index.space.subscribers(stream.name)
        weight = strategy.weight(cost, stream.quality)
        shared = self._shared(("stream", stream.name), [], weight, stream.quality)
        node: Node = UseStream(stream.name, stream.contents)
        for role, subject in zip_longest(offer.roles, goal.subjects[: len(offer.roles)]):
            object = (subject and subject.object) or role.object
            if object and role.id_field and not (role.sort and role.object):
                node = SelectObject(node, role.id_field, object)
                price = 0.0 if self._is_running(node) else strategy.weight(SELECTION_COST, 1.0)
                shared = self._shared(node, [shared], price, 1.0)
                weight += price
        self._add(place, [shared], 0.0, 1.0, (goal, offer))
        return weight

    def _shared(self, key: Hashable, inputs: list[int], weight: float, quality: float) -> int:
        """The number of a producer that all its users share."""
        place = self._places.get(key)
        if place is None:
            place = self._places[key] = len(self._places)
            self._add(place, inputs, weight, quality, None)
        return place

    def _add(
        self,
        place: int,
        inputs: list[int],
        weight: float,
        quality: float,
        answered: tuple[Goal, Answer] | None,
    ) -> None:
        self._derives.append(place)
        self._inputs += inputs
        self._starts.append(len(self._inputs))
        self._weights.append(weight)
        self._qualities.append(quality)
        self.answered.append(answered)
