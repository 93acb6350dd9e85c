"""Branch and bound for the plan of the least weight: the search of `least_weight`.

The search splits the part of the plans with the least bound first, at a goal that all its plans
use: those with one producer of it, and those without. When the effort is spent, the least bound of
the parts that are left holds for all plans.

Each of these buys something in `bench/matching/optimum.py` or `bench/matching/matching.py` (20
libraries a row):

| without | what is lost |
|---|---|
| landmarks (`owed`) | proofs: 20 → 5 of 20 over 10,000 transformations |
| `spared` | proofs: 16 → 9 at 10,000 (3 roots, near), 20 → 19 in matching over 1,000 |
| `necessary` | proofs: 20 → 15 in matching over 1,000, near |
| `dominated` | proofs: 8 → 3 at 1,000 (2–3 inputs, near) |
| smaller nets (`_compact`) | proofs: 9 → 1 at 10,000 (2–3 inputs, near) |
| exchanges (`_exchange`) | plans 6 % heavier at 1,000 (2–3 inputs, near), 16 % without near |
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace

import numpy as np

from .hypergraph import Flags, Floats, Ids, Integers, Net, restricted
from .knuth import trees, used
from .landmarks import owed
from .reductions import dominated, necessary, spared

EXCHANGING = 4
"""The part of the effort that may go into exchanging producers of the best plan: one in this."""


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """The plans for ``roots`` that only use the ``alive`` producers."""

    net: Net
    numbers: Integers
    """Of each producer, in the whole."""
    weights: Floats
    alive: Flags
    roots: Ids
    wanted: Ids
    """The roots, and other goals that all these plans use."""
    bound: float = 0.0

    @property
    def left(self) -> int:
        return int(np.count_nonzero(self.alive))


def whole_part(net: Net, weights: Floats, roots: Integers, bound: float) -> Part:
    """All plans, but for those with a producer that another one can stand in for."""
    wanted, alive = np.ascontiguousarray(roots, np.int32), np.ones(net.size, np.bool_)
    dominated(net, alive, weights)
    return Part(net, np.arange(net.size), weights, alive, wanted, wanted, bound)


class Search:
    """The search for the best plan of ``whole``. Offer it a plan first."""

    def __init__(self, whole: Part, effort: int) -> None:
        self.whole = whole
        self.effort = effort
        self.spent = 0
        self.best: Integers = np.empty(0, np.int64)
        self.weight = np.inf
        self._exchanged = np.inf
        # The weights of two plans differ by a multiple of this.
        self._step = max(1, int(np.gcd.reduce(whole.weights.astype(np.int64))))

    @property
    def enough(self) -> float:
        """A plan of this weight is no better than the best so far."""
        # A better plan weighs a step less at least, and bounds are whole numbers.
        return self.weight - self._step + 1

    def offer(self, producers: Integers) -> None:
        """A plan, as producers of the whole."""
        weight = float(self.whole.weights[producers].sum())
        if weight < self.weight:
            self.weight, self.best = weight, producers

    def run(self) -> float:
        """Search until the best plan is proven or the effort is spent; returns the bound of all."""
        root = self._bounded(_compact(self.whole))
        if root is None:
            return self.weight
        root = _compact(root)
        self._exchange(root)
        open_parts = [(root.bound, 0, root)]
        made = 1
        while open_parts:
            bound, _, part = open_parts[0]
            if bound >= self.enough:
                break
            if self.spent >= self.effort:
                return bound
            heapq.heappop(open_parts)
            for each in self._split(_compact(part)):
                # Parts have no order, so ``made`` decides between equal bounds.
                heapq.heappush(open_parts, (each.bound, made, each))
                made += 1
            self._exchange(root)
        return self.weight

    def _bounded(self, part: Part) -> Part | None:
        """The plans of ``part`` that may be better than the best; None if there are none."""
        wanted = necessary(part.net, part.alive, part.wanted)
        if wanted is None:
            return None
        cost = part.weights.copy()
        # One bound gets half of the effort at most: the rest is for better plans.
        effort = max(0, min(self.effort - self.spent, self.effort // 2))
        total, far, steps = owed(part.net, part.alive, wanted, cost, self.enough, effort)
        self.spent += steps
        if total == np.inf:
            return None
        bound = max(part.bound, total + far[wanted].max(initial=0.0))
        # The bound paid for the producers without cost left, so a plan of these is near it.
        self._try(part, part.alive, cost * 16 + part.weights)
        if bound >= self.enough:
            return None
        alive = part.alive.copy()
        spared(part.net, alive, wanted, cost, far, self.enough - total)
        return replace(part, alive=alive, wanted=wanted, bound=bound)

    def _split(self, part: Part) -> list[Part]:
        """At most two parts, with all plans of this one that may be better than the best."""
        # Again: `spared` may have left fewer alternatives since.
        wanted = necessary(part.net, part.alive, part.wanted)
        if wanted is None:
            return []
        picks = self._try(part, part.alive, part.weights)
        counts = np.bincount(part.net.derives[part.alive], minlength=part.net.goals)
        open_goals = wanted[counts[wanted] > 1]
        if len(open_goals) == 0 or picks[wanted].min() < 0:
            # There was no plan, or one, which was just tried.
            return []
        goal = open_goals[np.argmin(counts[open_goals])]
        others = part.net.producers_of(goal)
        with_it, without = part.alive.copy(), part.alive.copy()
        with_it[others[others != picks[goal]]] = False
        without[picks[goal]] = False
        sides = (self._bounded(replace(part, alive=alive)) for alive in (with_it, without))
        return [side for side in sides if side is not None]

    def _try(self, part: Part, alive: Flags, cost: Floats) -> Ids:
        """Offer the plan of the least trees by ``cost``; returns its pick for each goal."""
        self.spent += part.net.pass_steps
        _, picks = trees(part.net, alive, cost)
        if picks[part.roots].min(initial=0) >= 0:
            self.offer(part.numbers[picks[used(part.net, picks, part.roots)]])
        return picks

    def _exchange(self, part: Part) -> None:
        """Replace each producer of the best plan in turn, the others being free, while it helps."""
        limit = self.spent + (self.effort - self.spent) // EXCHANGING
        while self.weight < self._exchanged:
            self._exchanged = self.weight
            own = np.isin(part.numbers, self.best)
            free = np.where(own, 0.0, part.weights)
            for producer in np.flatnonzero(own):
                if self.spent >= limit:
                    return
                alive = part.alive | own
                alive[producer] = False
                self._try(part, alive, free)


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
