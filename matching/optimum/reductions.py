"""What can be left out of a hypergraph without losing its best plan, and what every plan uses.

`spared` is what reduced costs are for linear programs: what a bound left over says of each
producer. `dominated` compares the alternatives of a goal, `necessary` finds what they share.
"""

from __future__ import annotations

import heapq
from typing import Any

import numpy as np

from ...streams.jit import JIT, Kernel
from .hypergraph import Flags, Ids, Integers, Net
from .landmark_cuts import INFINITE

MANY = 32
"""The producers of a goal with more are not compared with one another: it takes their square."""


def _spared(net: Any, alive: Any, wanted: Any, cost: Any, far: Any, room: int) -> int:
    derives, starts, inputs, by_starts, by, _, _ = net
    up = np.full(far.shape[0], INFINITE, np.int64)
    through = np.zeros(derives.shape[0], np.int64)
    for producer in range(derives.shape[0]):
        below = 0
        for place in range(starts[producer], starts[producer + 1]):
            below = max(below, far[inputs[place]])
        through[producer] = min(below + cost[producer], INFINITE)
    heap = [(np.int64(0), np.int64(0))]
    heap.pop()
    for place in range(wanted.shape[0]):
        up[wanted[place]] = 0
        heapq.heappush(heap, (np.int64(0), np.int64(wanted[place])))
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
                    heapq.heappush(heap, (np.int64(reached), np.int64(inputs[other])))
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
                mark[inputs[needed]] = producer
            for other_place in range(by_starts[goal], by_starts[goal + 1]):
                other = by[other_place]
                if not (alive[producer] and alive[other]) or weights[other] > weights[producer]:
                    continue
                more = starts[producer + 1] - starts[producer] - starts[other + 1] + starts[other]
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


def _types(*names: str) -> Any:
    def signature() -> Any:
        from numba import types

        tuple_of: Any = types.UniTuple
        kinds = {
            "net": tuple_of(types.int32[::1], 7),
            "flags": types.boolean[::1],
            "ids": types.int32[::1],
            "integers": types.int64[::1],
            "integer": types.int64,
            "truth": types.boolean,
        }
        result, *arguments = (kinds[name] for name in names)
        return result(*arguments)

    return signature


_spared_kernel = Kernel(
    _spared, _types("integer", "net", "flags", "ids", "integers", "integers", "integer")
)
_necessary_kernel = Kernel(_necessary, _types("truth", "net", "flags", "ids", "flags"))
_dominated_kernel = Kernel(_dominated, _types("integer", "net", "flags", "integers"))


def spared(net: Net, alive: Flags, wanted: Ids, cost: Integers, far: Integers, room: int) -> int:
    """Strike off ``alive``, in place, what no plan with less than ``room`` of ``cost`` can use.

    A plan with some producer has all producers on a way down from a wanted goal to it, itself, and
    what its furthest input costs: distinct ones, as a plan has no cycle. Returns how many were
    struck. ``far``: distances under ``cost``. O((m + k) log m).
    """
    run = _spared_kernel if JIT else _spared
    return int(run(net.arrays, alive, wanted, cost, far, room))


def necessary(net: Net, alive: Flags, wanted: Ids) -> Ids | None:
    """``wanted`` and what all alternatives of a necessary goal need; None if one has none. O(k)."""
    flags = np.empty(net.goals, np.bool_)
    run = _necessary_kernel if JIT else _necessary
    if not run(net.arrays, alive, wanted, flags):
        return None
    return np.flatnonzero(flags).astype(np.int32)


def dominated(net: Net, alive: Flags, weights: Integers) -> int:
    """Strike off ``alive``, in place, what another producer of the same goal is as good as.

    That one weighs no more and has no other inputs, so it can stand in for it in any plan. Returns
    how many were struck. O(k * MANY).
    """
    run = _dominated_kernel if JIT else _dominated
    return int(run(net.arrays, alive, weights))
