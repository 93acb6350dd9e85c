"""Lower bounds from landmarks (Helmert & Domshlak, ICAPS 2009: LM-cut).

A *landmark* is a set of producers of which every plan has one. Take any set of goals, a *zone*,
with a wanted goal in it. The producers of goals in the zone without an input in the zone form a
landmark: the first goal of the zone that a plan derives comes from such a producer. Every plan owes
the least cost in the landmark, which is then taken off all its producers, so that what several
landmarks owe adds up.

The zone grows from the wanted goal so that this least cost is never 0: for each producer of the
zone that has no cost left, it takes in the input with the greatest distance.

Two things differ from LM-cut as published. A producer with any input in the zone is left out of the
landmark, not only one whose furthest input is there: landmarks are smaller and the bound is higher.
And distances follow the costs only every few landmarks: they guide the choice, while the goals that
have become free are followed exactly.

The loop is one function, long as it is: compiled loops do not call one another here.
"""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from ...streams.jit import JIT, Kernel
from .hypergraph import Flags, Floats, Ids, Net, signature
from .knuth import distances


def _owed(
    net: Any, alive: Any, wanted: Any, cost: Any, far: Any, enough: float, effort: int
) -> tuple[float, float]:
    derives, starts, inputs, by_starts, by, use_starts, use = net
    producers, goals = derives.shape[0], far.shape[0]
    # A goal is free if it can be had without further cost. `left` counts the inputs of a producer
    # that are not free, and `able` says that it can be used at all.
    free = far == 0
    able = alive.copy()
    left = np.zeros(producers, np.int32)
    furthest = np.full(producers, -1, np.int32)
    for producer in range(producers):
        for place in range(starts[producer], starts[producer + 1]):
            goal = inputs[place]
            if far[goal] == np.inf:
                able[producer] = False
            if far[goal] > 0:
                left[producer] += 1
            if furthest[producer] < 0 or far[goal] > far[furthest[producer]]:
                furthest[producer] = goal
    newly = np.empty(goals + 1, np.int32)
    mark = np.zeros(goals, np.int32)
    zone = np.empty(goals, np.int32)
    landmark = np.empty(producers, np.int32)
    lowered = np.empty(producers, np.int32)
    waiting = 0
    is_waiting = np.zeros(producers, np.bool_)
    # The compiler takes the type of the items from this one.
    heap = [(0.0, np.int64(0))]
    heap.pop()
    owed, steps, found = 0.0, float(producers), 0
    # A large net needs many landmarks, and its distances take long to follow each.
    patience = min(16, max(2, producers // 128))
    while True:
        start = -1
        for place in range(wanted.shape[0]):
            goal = wanted[place]
            if not free[goal] and (start < 0 or far[goal] > far[start]):
                start = goal
        stop = start < 0 or owed >= enough or steps >= effort
        if stop or found % patience == 0:
            # Distances follow: those of producers whose cost was lowered, and upwards.
            for place in range(waiting):
                producer = lowered[place]
                is_waiting[producer] = False
                reached = cost[producer]
                if furthest[producer] >= 0:
                    reached += far[furthest[producer]]
                if reached < far[derives[producer]]:
                    far[derives[producer]] = reached
                    heapq.heappush(heap, (float(reached), np.int64(derives[producer])))
            waiting = 0
            while heap:
                distance, goal = heapq.heappop(heap)
                steps += 8
                if distance > far[goal]:
                    continue
                for place in range(use_starts[goal], use_starts[goal + 1]):
                    producer = use[place]
                    steps += 1
                    if furthest[producer] != goal or not able[producer]:
                        continue
                    for other in range(starts[producer], starts[producer + 1]):
                        if far[inputs[other]] > far[furthest[producer]]:
                            furthest[producer] = inputs[other]
                    reached = far[furthest[producer]] + cost[producer]
                    if reached < far[derives[producer]]:
                        far[derives[producer]] = reached
                        heapq.heappush(heap, (float(reached), np.int64(derives[producer])))
        if stop:
            break

        found += 1
        mark[start] = found
        zone[0] = start
        size, at = 1, 0
        while at < size:
            goal = zone[at]
            at += 1
            for place in range(by_starts[goal], by_starts[goal + 1]):
                producer = by[place]
                steps += 1
                if cost[producer] > 0 or not able[producer]:
                    continue
                choice = -1
                for other in range(starts[producer], starts[producer + 1]):
                    needed = inputs[other]
                    # The producer has an input in the zone, so the landmark leaves it out anyway.
                    if mark[needed] == found:
                        choice = -1
                        break
                    if not free[needed] and (choice < 0 or far[needed] > far[choice]):
                        choice = needed
                if choice >= 0:
                    mark[choice] = found
                    zone[size] = choice
                    size += 1

        members = 0
        least = np.inf
        for at in range(size):
            for place in range(by_starts[zone[at]], by_starts[zone[at] + 1]):
                producer = by[place]
                steps += 1
                outside = able[producer]
                for other in range(starts[producer], starts[producer + 1]):
                    if mark[inputs[other]] == found:
                        outside = False
                        break
                if outside:
                    landmark[members] = producer
                    members += 1
                    least = min(least, cost[producer])
        owed += least

        newly_free = 0
        for place in range(members):
            producer = landmark[place]
            cost[producer] -= least
            if not is_waiting[producer]:
                is_waiting[producer] = True
                lowered[waiting] = producer
                waiting += 1
            if cost[producer] == 0 and left[producer] == 0 and not free[derives[producer]]:
                free[derives[producer]] = True
                newly[newly_free] = derives[producer]
                newly_free += 1
        while newly_free > 0:
            newly_free -= 1
            goal = newly[newly_free]
            for place in range(use_starts[goal], use_starts[goal + 1]):
                producer = use[place]
                left[producer] -= 1
                steps += 1
                if (
                    left[producer] == 0
                    and able[producer]
                    and cost[producer] == 0
                    and not free[derives[producer]]
                ):
                    free[derives[producer]] = True
                    newly[newly_free] = derives[producer]
                    newly_free += 1
    return owed, steps


_owed_kernel = Kernel(
    _owed,
    signature("pair", "net", "flags", "ids", "floats", "floats", "float", "int"),
)


def owed(
    net: Net, alive: Flags, wanted: Ids, cost: Floats, enough: float, effort: int
) -> tuple[float, Floats, int]:
    """The weight that all plans for ``wanted`` by ``alive`` producers owe; distances; steps taken.

    Takes the owed weight off ``cost``, in place: a plan weighs at least that plus its costs left.
    Stops once ``enough`` is owed, or after ``effort`` steps (one for each look at a producer);
    otherwise all wanted goals are free in the end. Infinite: there is no plan. Costs are whole
    numbers up to 2^50, so that floats add and subtract them exactly wherever it matters. Cost:
    O(m + k) a landmark at worst, usually that of its zone.
    """
    far = distances(net, alive, cost)
    if far[wanted].max(initial=0.0) == np.inf:
        return np.inf, far, net.pass_steps
    run = _owed_kernel if JIT else _owed
    total, steps = run(net.arrays, alive, wanted, cost, far, enough, effort)
    return float(total), far, int(steps) + net.pass_steps
