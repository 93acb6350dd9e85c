"""Knuth's generalisation of Dijkstra's algorithm (Information Processing Letters 6, 1977).

A cost is *superior* if a producer never costs less than one of its inputs, and never costs less
when an input costs more. The cheapest goal that is not final can then be made final in each step,
so one pass finds the least cost of every goal. The inputs of a picked producer were final before
its goal, so the picks never form a cycle.

One loop serves three costs, in O((m + k) log m) for m producers with k inputs in all:

- `trees` adds: the weight of the tree below a goal, where a shared goal counts at each use. No plan
  of one goal weighs more than its tree, so this gives a plan and an upper bound.
- `distances` adds the costliest input only: a lower bound of every plan (h_max in planning).
- `qualities` multiplies with the worst input; qualities are negated, so that the best is the least.
"""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from ...streams.jit import JIT, Kernel
from .hypergraph import Flags, Floats, Ids, Integers, Net, signature

SUM, MAXIMUM, PRODUCT = 0, 1, 2


def _knuth(net: Any, alive: Any, own: Any, kind: int, value: Any, picks: Any) -> None:
    derives, starts, _, _, _, use_starts, use = net
    value[:] = np.inf
    picks[:] = -1
    final = np.zeros(value.shape[0], np.bool_)
    total = -own if kind == PRODUCT else own.copy()
    left = starts[1:] - starts[:-1]
    # The compiler takes the type of the items from this one.
    heap = [(0.0, np.int64(0))]
    heap.pop()
    for producer in range(derives.shape[0]):
        if left[producer] > 0 or not alive[producer]:
            continue
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
            if kind == SUM:
                total[producer] += value[goal]
            elif left[producer] == 0:
                # The last input to be final is the costliest.
                if kind == MAXIMUM:
                    total[producer] += value[goal]
                else:
                    total[producer] = own[producer] * value[goal]
            target = derives[producer]
            # `picks` first: the weight of the only tree may be infinite in floats.
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


_knuth_kernel = Kernel(_knuth, signature("void", "net", "flags", "floats", "int", "floats", "ids"))
_used_kernel = Kernel(_used, signature("void", "net", "ids", "ids", "flags"))


def trees(net: Net, alive: Flags, weights: Floats) -> tuple[Floats, Ids]:
    """The least tree weight of each goal by ``alive`` producers, and the producer it comes from.

    Infinite and -1 for a goal without one. Of equal producers it takes the lowest whose inputs were
    final before the goal (with weights of 0 an equal one can come too late).
    """
    return _least(net, alive, weights, SUM)


def distances(net: Net, alive: Flags, costs: Floats) -> Floats:
    """The least cost of each goal, counting only the costliest input of each producer; infinite for
    a goal that cannot be derived."""
    return _least(net, alive, costs, MAXIMUM)[0]


def qualities(net: Net, alive: Flags, quality: Floats) -> Floats:
    """The best quality of each goal by ``alive`` producers; -1 for a goal without one."""
    value, picks = _least(net, alive, quality, PRODUCT)
    return np.where(picks < 0, -1.0, -value)


def used(net: Net, picks: Ids, roots: Ids) -> Integers:
    """The goals that distinct ``roots`` use, ascending, where ``picks[goal]`` is the producer."""
    flags = np.empty(net.goals, np.bool_)
    run = _used_kernel if JIT else _used
    run(net.arrays, picks, roots, flags)
    return np.flatnonzero(flags)


def _least(net: Net, alive: Flags, own: Floats, kind: int) -> tuple[Floats, Ids]:
    value, picks = np.empty(net.goals), np.empty(net.goals, np.int32)
    run = _knuth_kernel if JIT else _knuth
    run(net.arrays, alive, own, kind, value, picks)
    return value, picks
