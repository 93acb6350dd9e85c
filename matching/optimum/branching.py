"""Branch and bound for the plan of the least weight: the search of `least_weight`.

The least bound goes first, so that what is left open when the effort is spent bounds all plans.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace

import numpy as np

from .hypergraph import Flags, Floats, Ids, Integers, Net, restricted
from .knuth import trees, used
from .landmark_cuts import INFINITE, owed
from .reductions import dominated, necessary, spared

SPLITS = 4
"""Goals to look at before a part is split."""
ROUNDS = 3
"""Bounds of different patience for the whole, at most."""
IMPROVING = 4
"""One step of so many may go into exchanging producers of the best plan."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """Some of the plans: those by the producers left that have all that is wanted."""

    net: Net
    numbers: Integers
    """Of each producer, in the whole."""
    weights: Integers
    alive: Flags
    roots: Ids
    wanted: Ids
    """The roots, and other goals that all these plans use."""
    bound: int = 0

    @property
    def left(self) -> int:
        return int(np.count_nonzero(self.alive))


def whole_part(net: Net, weights: Integers, roots: Integers, bound: int) -> Part:
    """All plans."""
    wanted, alive = np.ascontiguousarray(roots, np.int32), np.ones(net.size, np.bool_)
    return Part(net, np.arange(net.size), weights, alive, wanted, wanted, bound)


class Search:
    """The search for the best plan of ``whole``. Offer it a plan first."""

    def __init__(self, whole: Part, effort: int) -> None:
        self.whole = whole
        self.effort = effort
        self.spent = 0
        self.best: Integers = np.empty(0, np.int64)
        self.weight = INFINITE
        self._improved = INFINITE
        self._base = whole
        # Whatever two plans weigh, they differ by a multiple of this.
        self._step = max(1, int(np.gcd.reduce(whole.weights))) if len(whole.weights) else 1

    @property
    def enough(self) -> int:
        """A plan of this weight is no better than the best so far."""
        return self.weight - self._step + 1

    def offer(self, producers: Integers) -> None:
        """A plan, as producers of the whole."""
        weight = int(self.whole.weights[producers].sum())
        if weight < self.weight:
            self.weight, self.best = weight, producers

    def run(self) -> int:
        """Search until the best plan is proven, or the effort is spent; returns what bounds all."""
        part = self._root()
        open_parts = [] if part is None else [(part.bound, 0, part)]
        made = 1
        while open_parts:
            bound, _, part = open_parts[0]
            if bound >= self.enough:
                break
            if self.spent >= self.effort:
                return bound
            heapq.heappop(open_parts)
            parts = self._split(_compact(part))
            self._improve(self._base)
            for each in parts:
                heapq.heappush(open_parts, (each.bound, made, each))
                made += 1
        return self.weight

    def _root(self) -> Part | None:
        """The whole, reduced as far as bounds of different patience reduce it."""
        alive = self.whole.alive.copy()
        dominated(self.whole.net, alive, self.whole.weights)
        part: Part | None = _compact(replace(self.whole, alive=alive))
        for round in range(ROUNDS):
            if part is None or self.spent >= self.effort:
                break
            before = part.left
            part = self._bounded(part, _patience(part) << (round % 3))
            if part is None:
                break
            part = _compact(part)
            self._base = part
            self._improve(part)
            if round > 1 and part.left > before * 0.9:
                break
        return part

    def _bounded(self, part: Part, patience: int) -> Part | None:
        """The same plans, but for those that are no better than the best; None if none is left."""
        wanted = necessary(part.net, part.alive, part.wanted)
        if wanted is None:
            return None
        cost = part.weights.copy()
        # No bound may take it all: where one would, a better plan is worth more.
        effort = max(0, min(self.effort - self.spent, self.effort // 2))
        total, far, steps = owed(part.net, part.alive, wanted, cost, self.enough, patience, effort)
        self.spent += steps + part.net.size
        if total >= INFINITE:
            return None
        bound = max(part.bound, total + int(far[wanted].max(initial=0)))
        # Producers without cost left are those of the bound: a plan of them is near it.
        self._try(part, part.alive, (cost * 16 + part.weights).astype(np.float64))
        if bound >= self.enough:
            return None
        alive = part.alive.copy()
        spared(part.net, alive, wanted, cost, far, self.enough - total)
        return replace(part, alive=alive, wanted=wanted, bound=bound)

    def _split(self, part: Part) -> list[Part]:
        """Two parts that have all plans of this one that are better than the best; or fewer."""
        while True:
            # Again: what was struck off since may have left less choice.
            wanted = necessary(part.net, part.alive, part.wanted)
            if wanted is None:
                return []
            counts = np.bincount(part.net.derives[part.alive], minlength=part.net.goals)
            open_goals = wanted[counts[wanted] > 1]
            picks = self._try(part, part.alive, part.weights.astype(np.float64))
            if len(open_goals) == 0 or picks[wanted].min() < 0:
                # There was one plan only, and it was just tried; or none.
                return []
            order = np.argsort(counts[open_goals], kind="stable")[:SPLITS]
            chosen: list[Part] = []
            score = -1.0
            for goal in open_goals[order].tolist():
                pair = self._pair(part, goal, int(picks[goal]))
                if len(pair) < 2:
                    chosen = pair
                    break
                gains = [each.bound - part.bound + 1.0 for each in pair]
                if gains[0] * gains[1] > score:
                    chosen, score = pair, gains[0] * gains[1]
            if len(chosen) != 1 or self.spent >= self.effort:
                return chosen
            part = chosen[0]

    def _pair(self, part: Part, goal: int, producer: int) -> list[Part]:
        """The plans of ``part`` with ``producer`` for ``goal`` (which all use), then the others."""
        others = part.net.producers_of(goal)
        with_it, without = part.alive.copy(), part.alive.copy()
        with_it[others[others != producer]] = False
        without[producer] = False
        parts = (self._bounded(replace(part, alive=a), _patience(part)) for a in (with_it, without))
        return [each for each in parts if each is not None]

    def _try(self, part: Part, alive: Flags, cost: Floats) -> Ids:
        """Offer the plan of the least trees by ``cost``; returns what it picks for each goal."""
        self.spent += part.net.size + 8 * part.net.goals
        _, picks = trees(part.net, alive, cost)
        if picks[part.roots].min(initial=0) >= 0:
            producers = picks[used(part.net, picks, part.roots)]
            if part.weights[producers].sum() < self.weight:
                self.offer(part.numbers[producers])
        return picks

    def _improve(self, part: Part) -> None:
        """Try the best plan without each of its producers in turn, where the others are free."""
        limit = self.spent + (self.effort - self.spent) // IMPROVING
        while self.weight < self._improved:
            self._improved = self.weight
            tried: set[int] = set()
            while self.spent < limit:
                own = np.isin(part.numbers, self.best)
                waiting = [p for p in np.flatnonzero(own).tolist() if p not in tried]
                if not waiting:
                    break
                tried.add(waiting[0])
                alive = part.alive | own
                alive[waiting[0]] = False
                self._try(part, alive, np.where(own, 0.0, part.weights))


def _patience(part: Part) -> int:
    """Large nets need many landmarks, and each takes long to make distances true again."""
    return min(16, max(2, part.left // 128))


def _compact(part: Part) -> Part:
    """The same plans in a smaller net, if it is much smaller."""
    if part.left > 0.75 * part.net.size:
        return part
    net, numbers, goals = restricted(part.net, part.alive, np.zeros(part.net.goals, np.bool_))
    return Part(
        net,
        part.numbers[numbers],
        part.weights[numbers],
        np.ones(net.size, np.bool_),
        goals[part.roots].astype(np.int32),
        goals[part.wanted].astype(np.int32),
        part.bound,
    )
