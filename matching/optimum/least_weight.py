"""The plan of the least weight, in which a shared unit counts once.

The strategy *cost* of [Introspection15 §4.3]. The problem is that of the cheapest AND/OR directed
acyclic graph, or of optimal delete-free planning (h+), and is NP-hard.

1. Knuth's algorithm gives a first plan: the least trees, which count a shared unit at each use.
2. Distances strike off the producers that no better plan can use.
3. Branch and bound searches the rest, with bounds from landmarks.

Weights become whole numbers, in units of about 2^-50 of the first plan's weight and rounded down,
so that floats add them exactly. A plan of n producers is at most n units heavier than its whole
weights say; `Choice.proven` compares the bound with the true weight. Where all weights are
multiples of one step (whole numbers, say), a bound within a step of the best plan is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import frexp, fsum, ldexp

import numpy as np

from .branch_and_bound import Search, whole_part
from .hypergraph import (
    Choice,
    Floats,
    Hypergraph,
    checked_roots,
    net_of,
    restricted,
)
from .knuth import distances, trees, used
from .reductions import spared

DEFAULT = 4_000_000
"""Steps of search: about 0.05 s."""
BITS = 50
"""Of the integer weight of the first plan."""


def least_weight(graph: Hypergraph, roots: Sequence[int], effort: int = DEFAULT) -> Choice | None:
    """The plan for ``roots`` whose distinct producers weigh least; None if one cannot be derived.

    The plan is always valid, and its ``bound`` true. If it is ``proven``, it is the best; otherwise
    ``effort`` (steps of search, not time) was spent, and it is the best found, which is never worse
    than the plan of least tree weights. The same arguments give the same answer. Of several best
    plans no particular one is promised. Cost: O((m + k) log m) to begin with, then ``effort``.
    Memory: about 150 bytes a producer, and some for each producer left in each open node.
    """
    net, wanted = net_of(graph), checked_roots(graph, roots)
    weights = np.array(graph.weights, np.float64)
    everything = np.ones(net.size, np.bool_)
    tree, picks = trees(net, everything, weights)
    if len(wanted) and picks[wanted].min() < 0:
        return None
    first = picks[used(net, picks, wanted)]
    whole, unit = _whole(weights, fsum(weights[first].tolist()))
    # Strike off the goals that cost nothing, and producers in no plan as good as the first one.
    far = distances(net, everything, whole)
    given = far == 0
    if tree[given].any():
        # Their trees weigh something, but their whole weights are 0: take trees of such producers.
        picks[given] = trees(net, everything, whole)[1][given]
    keep = ~given[net.derives]
    # The room is exclusive: with 1 more, plans as good as the first one stay.
    spared(net, keep, wanted, whole, far, whole[first].sum() + 1)
    part, numbers, goals = restricted(net, keep, given)
    needed = goals[wanted[~given[wanted]]]
    bound = far[wanted].max(initial=0)
    search = Search(whole_part(part, whole[numbers], needed, bound), effort)
    search.offer(np.searchsorted(numbers, first[keep[first]]))
    bound = search.run()
    best = numbers[search.best]
    picks[net.derives[best]] = best
    chosen = used(net, picks, wanted)
    value = fsum(weights[picks[chosen]].tolist())
    plan = dict(zip(chosen.tolist(), picks[chosen].tolist(), strict=True))
    return Choice(plan, value, min(value, ldexp(bound, unit)))


def _whole(weights: Floats, total: float) -> tuple[Floats, int]:
    """Weights in units of 2^unit, rounded down; ``total`` is less than 2^BITS of them.

    A producer that weighs more is in no best plan; its weight becomes 2^BITS.
    """
    unit = frexp(total)[1] - BITS
    most = ldexp(1.0, BITS)
    with np.errstate(over="ignore"):
        scaled = np.minimum(np.ldexp(weights, -unit), most)
    return np.floor(scaled), unit
