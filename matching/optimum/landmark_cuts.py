"""Bounds on the weight of plans from disjoint landmarks (Helmert & Domshlak, ICAPS 2009: LM-cut).

A *landmark* is a set of producers of which every plan has one. For any set of goals, a *zone*, with
a wanted goal in it, the producers of goals in the zone that have no input in the zone are one: the
first goal of the zone that a plan derives comes from such a producer. If each has still some cost
left, the least of them is owed by every plan, and is taken off all of them; what is owed adds up.
The zone is grown from the wanted goal so that this is never 0: where a producer without cost would
enter it, the input of that producer that is furthest from being free is taken in.

This differs from LM-cut as published in two ways. A producer with any input in the zone is left out
of the landmark, not only one whose furthest input is there: the landmarks are smaller, the bound is
higher. And how far a goal is from free (h_max under the costs left) is renewed only every few
landmarks, ``patience``: it guides the choice, while what is free is followed exactly.

Weights are integers here, so that what is taken off leaves exactly 0. No total passes 2^61.

The loop is one function, long as it is: compiled loops do not call one another here.
"""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from ...streams.jit import JIT, Kernel
from .hypergraph import Flags, Ids, Integers, Net

INFINITE = 1 << 60
"""The distance of what cannot be derived."""


def _owed(
    net: Any,
    alive: Any,
    wanted: Any,
    cost: Any,
    far: Any,
    enough: int,
    patience: int,
    effort: int,
) -> tuple[int, int]:
    derives, starts, inputs, by_starts, by, use_starts, use = net
    producers, goals = derives.shape[0], far.shape[0]
    steps = producers
    # Distances (h_max), as Dijkstra: the input of a producer that is final last is the furthest.
    far[:] = INFINITE
    furthest = np.full(producers, -1, np.int32)
    left = np.empty(producers, np.int32)
    final = np.zeros(goals, np.bool_)
    heap = [(np.int64(0), np.int64(0))]
    heap.pop()
    for producer in range(producers):
        left[producer] = starts[producer + 1] - starts[producer]
        if left[producer] == 0 and alive[producer] and cost[producer] < far[derives[producer]]:
            far[derives[producer]] = cost[producer]
            heapq.heappush(heap, (np.int64(cost[producer]), np.int64(derives[producer])))
    while heap:
        distance, goal = heapq.heappop(heap)
        steps += 8
        if final[goal]:
            continue
        final[goal] = True
        for place in range(use_starts[goal], use_starts[goal + 1]):
            producer = use[place]
            left[producer] -= 1
            steps += 1
            if left[producer] == 0 and alive[producer]:
                furthest[producer] = goal
                reached = distance + cost[producer]
                if reached < far[derives[producer]]:
                    far[derives[producer]] = reached
                    heapq.heappush(heap, (np.int64(reached), np.int64(derives[producer])))
    for place in range(wanted.shape[0]):
        if far[wanted[place]] >= INFINITE:
            return INFINITE, steps

    # A goal is free if it can be had without further cost. From here on `left` counts the inputs
    # that are not free, and `able` says that a producer can be used at all.
    able = alive.copy()
    free = far == 0
    for producer in range(producers):
        count = 0
        for place in range(starts[producer], starts[producer + 1]):
            if far[inputs[place]] >= INFINITE:
                able[producer] = False
            elif far[inputs[place]] > 0:
                count += 1
        left[producer] = count

    newly = np.empty(goals + 1, np.int32)
    newly_free = 0
    mark = np.zeros(goals, np.int32)
    zone = np.empty(goals, np.int32)
    landmark = np.empty(producers, np.int32)
    lowered = np.empty(producers, np.int32)
    waiting = 0
    is_waiting = np.zeros(producers, np.bool_)
    owed, found = 0, 0
    while True:
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

        stop = owed >= enough or steps >= effort
        if not stop:
            stop = True
            for place in range(wanted.shape[0]):
                stop = stop and free[wanted[place]]
        if stop or found % patience == 0:
            # Make the distances true again: those of producers whose cost was lowered, and upwards.
            for place in range(waiting):
                producer = lowered[place]
                is_waiting[producer] = False
                reached = cost[producer]
                if furthest[producer] >= 0:
                    reached += far[furthest[producer]]
                if reached < far[derives[producer]]:
                    far[derives[producer]] = reached
                    heapq.heappush(heap, (np.int64(reached), np.int64(derives[producer])))
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
                        heapq.heappush(heap, (np.int64(reached), np.int64(derives[producer])))

        if stop:
            break

        start = -1
        for place in range(wanted.shape[0]):
            goal = wanted[place]
            if not free[goal] and (start < 0 or far[goal] > far[start]):
                start = goal
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
        least = INFINITE
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
    return owed, steps


def _types() -> Any:
    from numba import types

    tuple_of: Any = types.UniTuple
    ids, integers, integer = types.int32[::1], types.int64[::1], types.int64
    return tuple_of(integer, 2)(
        tuple_of(ids, 7), types.boolean[::1], ids, integers, integers, integer, integer, integer
    )


_owed_kernel = Kernel(_owed, _types)


def owed(
    net: Net,
    alive: Flags,
    wanted: Ids,
    cost: Integers,
    enough: int,
    patience: int,
    effort: int,
) -> tuple[int, Integers, int]:
    """What every plan for ``wanted`` by ``alive`` producers owes at least, and the distances left.

    Takes off ``cost``, in place, what is owed: the weight of any plan is at least that plus what is
    left of its costs. Stops once ``enough`` is owed, or after ``effort`` steps (a producer looked
    at is one); otherwise all wanted goals are free in the end. INFINITE: there is no plan. Returns
    also the steps taken. Cost: O(m + k) a landmark at worst, mostly that of its zone only.
    """
    far = np.empty(net.goals, np.int64)
    run = _owed_kernel if JIT else _owed
    total, steps = run(net.arrays, alive, wanted, cost, far, enough, patience, effort)
    return int(total), far, int(steps)
