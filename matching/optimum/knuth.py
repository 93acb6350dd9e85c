"""Knuth's generalisation of Dijkstra's algorithm (Information Processing Letters 6, 1977).

Where the value of a producer never is better than that of any of its inputs, and never gets better
when one of them gets worse, the best value of every goal is found in one pass, best first: once a
goal is taken from the heap, its value is final. What the goal takes its value from was final
before, so the producers picked are never a cycle, whatever the weights.

`trees` adds (the weight of the tree under a producer, where a shared goal counts each time);
`qualities` multiplies with the least of the inputs. Both cost O((m + k) log m) for m producers with
k inputs in all, and 24 bytes a producer and a goal.
"""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from ...streams.jit import JIT, Kernel
from .hypergraph import Flags, Floats, Ids, Integers, Net


def _trees(net: Any, alive: Any, cost: Any, value: Any, picks: Any) -> None:
    derives, starts, _, _, _, use_starts, use = net
    value[:] = np.inf
    picks[:] = -1
    final = np.zeros(value.shape[0], np.bool_)
    total = cost.copy()
    left = np.empty(derives.shape[0], np.int32)
    heap = [(0.0, np.int64(0))]
    heap.pop()
    for producer in range(derives.shape[0]):
        left[producer] = starts[producer + 1] - starts[producer]
        if left[producer] == 0 and alive[producer]:
            goal = derives[producer]
            # Producers ascend, so that the first of equals is the lowest.
            if picks[goal] < 0 or total[producer] < value[goal]:
                value[goal] = total[producer]
                picks[goal] = producer
                heapq.heappush(heap, (float(total[producer]), np.int64(goal)))
    while heap:
        _, goal = heapq.heappop(heap)
        if final[goal]:
            continue
        final[goal] = True
        for place in range(use_starts[goal], use_starts[goal + 1]):
            producer = use[place]
            left[producer] -= 1
            total[producer] += value[goal]
            target = derives[producer]
            # Asking for `picks` first: a tree can be too heavy for a float, and still be the only.
            if (
                left[producer] == 0
                and alive[producer]
                and not final[target]
                and (
                    picks[target] < 0
                    or total[producer] < value[target]
                    or (total[producer] == value[target] and producer < picks[target])
                )
            ):
                value[target] = total[producer]
                picks[target] = producer
                heapq.heappush(heap, (float(total[producer]), np.int64(target)))


def _qualities(net: Any, alive: Any, quality: Any, value: Any) -> None:
    derives, starts, _, _, _, use_starts, use = net
    value[:] = -1.0
    final = np.zeros(value.shape[0], np.bool_)
    left = np.empty(derives.shape[0], np.int32)
    heap = [(0.0, np.int64(0))]
    heap.pop()
    for producer in range(derives.shape[0]):
        left[producer] = starts[producer + 1] - starts[producer]
        if left[producer] == 0 and alive[producer] and quality[producer] > value[derives[producer]]:
            value[derives[producer]] = quality[producer]
            heapq.heappush(heap, (-float(quality[producer]), np.int64(derives[producer])))
    while heap:
        _, goal = heapq.heappop(heap)
        if final[goal]:
            continue
        final[goal] = True
        for place in range(use_starts[goal], use_starts[goal + 1]):
            producer = use[place]
            left[producer] -= 1
            # The last input to be final is the worst.
            reached = quality[producer] * value[goal]
            target = derives[producer]
            if left[producer] == 0 and alive[producer] and reached > value[target]:
                value[target] = reached
                heapq.heappush(heap, (-float(reached), np.int64(target)))


def _used(net: Any, picks: Any, roots: Any, flags: Any) -> None:
    _, starts, inputs, _, _, _, _ = net
    flags[:] = False
    waiting = np.empty(picks.shape[0] + 1, np.int32)
    size = 0
    for place in range(roots.shape[0]):
        flags[roots[place]] = True
        waiting[size] = roots[place]
        size += 1
    while size > 0:
        size -= 1
        producer = picks[waiting[size]]
        for place in range(starts[producer], starts[producer + 1]):
            goal = inputs[place]
            if not flags[goal]:
                flags[goal] = True
                waiting[size] = goal
                size += 1


def _trees_types() -> Any:
    from numba import types

    tuple_of: Any = types.UniTuple
    floats, ids = types.float64[::1], types.int32[::1]
    return types.void(tuple_of(ids, 7), types.boolean[::1], floats, floats, ids)


def _qualities_types() -> Any:
    from numba import types

    tuple_of: Any = types.UniTuple
    floats, ids = types.float64[::1], types.int32[::1]
    return types.void(tuple_of(ids, 7), types.boolean[::1], floats, floats)


def _used_types() -> Any:
    from numba import types

    tuple_of: Any = types.UniTuple
    ids = types.int32[::1]
    return types.void(tuple_of(ids, 7), ids, ids, types.boolean[::1])


_trees_kernel = Kernel(_trees, _trees_types)
_qualities_kernel = Kernel(_qualities, _qualities_types)
_used_kernel = Kernel(_used, _used_types)


def trees(net: Net, alive: Flags, cost: Floats) -> tuple[Floats, Ids]:
    """The least tree weight of each goal by ``alive`` producers, and the producer it comes from.

    Infinite and -1 where there is none. Equals: the lowest producer of those whose inputs were
    final before the goal was (with weights of 0 an equal one can come too late).
    """
    value, picks = np.empty(net.goals), np.empty(net.goals, np.int32)
    run = _trees_kernel if JIT else _trees
    run(net.arrays, alive, cost, value, picks)
    return value, picks


def qualities(net: Net, alive: Flags, quality: Floats) -> Floats:
    """The best quality of each goal by ``alive`` producers; -1 where there is none."""
    value = np.empty(net.goals)
    run = _qualities_kernel if JIT else _qualities
    run(net.arrays, alive, quality, value)
    return value


def used(net: Net, picks: Ids, roots: Ids) -> Integers:
    """The goals that distinct ``roots`` use, ascending, where ``picks[goal]`` is the producer."""
    flags = np.empty(net.goals, np.bool_)
    run = _used_kernel if JIT else _used
    run(net.arrays, picks, roots, flags)
    return np.flatnonzero(flags)
