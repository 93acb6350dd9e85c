"""Producers that the best plan does not need, and goals that every plan uses.

`spared` corresponds to reduced costs in linear programs: it uses the costs that a bound left over.
`dominated` compares the alternatives of a goal, `necessary` finds the inputs that they share.
"""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from ...streams.jit import JIT, Kernel
from .hypergraph import Flags, Floats, Ids, Net, signature

MANY = 32
"""`dominated` skips goals with more producers, as it takes time in their square."""


def _spared(net: Any, alive: Any, wanted: Any, cost: Any, far: Any, room: float) -> int:
    derives, starts, inputs, by_starts, by, _, _ = net
    up = np.full(far.shape[0], np.inf)
    through = cost.copy()
    for producer in range(derives.shape[0]):
        below = 0.0
        for place in range(starts[producer], starts[producer + 1]):
            below = max(below, far[inputs[place]])
        through[producer] += below
    # The compiler takes the type of the items from this one.
    heap = [(0.0, np.int64(0))]
    heap.pop()
    for place in range(wanted.shape[0]):
        up[wanted[place]] = 0
        heapq.heappush(heap, (0.0, np.int64(wanted[place])))
    while heap:
        above, goal = heapq.heappop(heap)
        if above > up[goal]:
            continue
        for place in range(by_starts[goal], by_starts[goal + 1]):
            producer = by[place]
            if not alive[producer] or through[producer] + above >= room:
                continue
            reached = above + cost[producer]
            for other in range(starts[producer], starts[producer + 1]):
                if reached < up[inputs[other]]:
                    up[inputs[other]] = reached
                    heapq.heappush(heap, (float(reached), np.int64(inputs[other])))
    count = 0
    for producer in range(derives.shape[0]):
        if alive[producer] and up[derives[producer]] + through[producer] >= room:
            alive[producer] = False
            count += 1
    return count


def _necessary(net: Any, alive: Any, wanted: Any, is_wanted: Any) -> bool:
    _, starts, inputs, by_starts, by, _, _ = net
    is_wanted[:] = False
    waiting = np.empty(is_wanted.shape[0], np.int32)
    size = 0
    for place in range(wanted.shape[0]):
        is_wanted[wanted[place]] = True
        waiting[size] = wanted[place]
        size += 1
    named = np.zeros(is_wanted.shape[0], np.int32)
    while size > 0:
        size -= 1
        goal = waiting[size]
        alternatives = 0
        last = -1
        for place in range(by_starts[goal], by_starts[goal + 1]):
            if alive[by[place]]:
                alternatives += 1
                last = by[place]
                for other in range(starts[last], starts[last + 1]):
                    named[inputs[other]] += 1
        if last < 0:
            return False
        for other in range(starts[last], starts[last + 1]):
            needed = inputs[other]
            if named[needed] == alternatives and not is_wanted[needed]:
                is_wanted[needed] = True
                waiting[size] = needed
                size += 1
        for place in range(by_starts[goal], by_starts[goal + 1]):
            for other in range(starts[by[place]], starts[by[place] + 1]):
                named[inputs[other]] = 0
    return True


def _dominated(net: Any, alive: Any, weights: Any) -> int:
    _, starts, inputs, by_starts, by, _, _ = net
    mark = np.full(by_starts.shape[0], -1, np.int32)
    count = 0
    for goal in range(by_starts.shape[0] - 1):
        if by_starts[goal + 1] - by_starts[goal] > MANY:
            continue
        for place in range(by_starts[goal], by_starts[goal + 1]):
            producer = by[place]
            for needed in range(starts[producer], starts[producer + 1]):
                # Each producer has its own mark, so old marks need no reset.
                mark[inputs[needed]] = producer
            for other_place in range(by_starts[goal], by_starts[goal + 1]):
                other = by[other_place]
                if not (alive[producer] and alive[other]) or weights[other] > weights[producer]:
                    continue
                more = starts[producer + 1] - starts[producer] - starts[other + 1] + starts[other]
                # A producer does not replace itself, and of two equal ones the lower number stays.
                if weights[other] == weights[producer] and (more, producer) <= (0, other):
                    continue
                within = True
                for needed in range(starts[other], starts[other + 1]):
                    if mark[inputs[needed]] != producer:
                        within = False
                        break
                if within:
                    alive[producer] = False
                    count += 1
    return count


_spared_kernel = Kernel(
    _spared, signature("int", "net", "flags", "ids", "floats", "floats", "float")
)
_necessary_kernel = Kernel(_necessary, signature("truth", "net", "flags", "ids", "flags"))
_dominated_kernel = Kernel(_dominated, signature("int", "net", "flags", "floats"))


def spared(net: Net, alive: Flags, wanted: Ids, cost: Floats, far: Floats, room: float) -> int:
    """Strike off ``alive``, in place, the producers in no plan with less than ``room`` of ``cost``.

    A plan with some producer has also the producers on a way from a wanted goal down to it, and
    those that its furthest input needs. All are distinct, as a plan has no cycle. ``far`` holds the
    distances under ``cost``. Returns the number of producers struck off. O((m + k) log m).
    """
    run = _spared_kernel if JIT else _spared
    return int(run(net.arrays, alive, wanted, cost, far, room))


def necessary(net: Net, alive: Flags, wanted: Ids) -> Ids | None:
    """``wanted``, and the goals that all alternatives of a necessary goal need; None if a necessary
    goal has no alternative. O(k)."""
    flags = np.empty(net.goals, np.bool_)
    run = _necessary_kernel if JIT else _necessary
    if not run(net.arrays, alive, wanted, flags):
        return None
    return np.flatnonzero(flags).astype(np.int32)


def dominated(net: Net, alive: Flags, weights: Floats) -> int:
    """Strike off ``alive``, in place, each producer for which another one of its goal can stand in.

    The other one weighs no more and has no further inputs. Returns the number of producers struck
    off. O(k * MANY).
    """
    run = _dominated_kernel if JIT else _dominated
    return int(run(net.arrays, alive, weights))
