"""The plan of the least weight, where what is shared counts once.

The strategy *cost* of [Introspection15 §4.3]. As a problem: the cheapest AND/OR directed acyclic
graph, or optimal delete-free planning (h+). NP-hard, so this is branch and bound:

1. A plan to begin with: the least tree weights (`knuth`), then exchanges of one producer.
2. A bound from landmarks (`landmark_cuts`), and what it says no better plan can use is struck off.
   What is left is numbered anew, and again, while that helps.
3. The least bound first: a node is the producers left and the goals known to be necessary. It is
   split at a necessary goal that has alternatives, into the plans with one of them and without it.
   Bounds are found from scratch at each node, which proves far more than going on from its
   parent's. A split is chosen by looking at both sides of a few.

Weights become integers, in units of about 2^-50 of the first plan's weight and rounded down, so
that bounds add up exactly and stay bounds. A plan of n producers is heavier than its integers say
by n units at most; `Choice.proven` compares the bound with the true weight. Where all weights are
multiples of one step (whole numbers, say), a bound within a step of the best plan is enough.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import frexp, fsum, ldexp

import numpy as np

from .branching import Search, whole_part
from .hypergraph import (
    Choice,
    Floats,
    Hypergraph,
    Integers,
    checked_roots,
    net_of,
    restricted,
)
from .knuth import trees, used
from .landmark_cuts import owed
from .reductions import spared

DEFAULT = 4_000_000
"""Steps of search: about a tenth of a second."""
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
    # What comes for nothing, and what no plan can use that weighs no more than the first one.
    _, far, _ = owed(net, everything, wanted, whole.copy(), 0, 1, 0)
    given = far == 0
    if tree[given].any():
        # They weigh something, but too little to count: what they are got from must not count too.
        picks[given] = trees(net, everything, whole.astype(np.float64))[1][given]
    keep = ~given[net.derives]
    spared(net, keep, wanted, whole, far, int(whole[first].sum()) + 1)
    part, numbers, goals = restricted(net, keep, given)
    needed = goals[wanted[~given[wanted]]]
    bound = int(far[wanted].max(initial=0))
    search = Search(whole_part(part, whole[numbers], needed, bound), effort)
    search.offer(np.searchsorted(numbers, first[keep[first]]))
    bound = search.run()
    best = numbers[search.best]
    picks[net.derives[best]] = best
    chosen = used(net, picks, wanted)
    value = fsum(weights[picks[chosen]].tolist())
    plan = dict(zip(chosen.tolist(), picks[chosen].tolist(), strict=True))
    return Choice(plan, value, min(value, ldexp(float(bound), unit)))


def _whole(weights: Floats, total: float) -> tuple[Integers, int]:
    """Weights in units of 2^unit, rounded down; ``total`` is less than 2^BITS of them.

    What weighs more than that is in no best plan, and gets just that.
    """
    unit = frexp(total)[1] - BITS
    most = ldexp(1.0, BITS)
    with np.errstate(over="ignore"):
        scaled = np.minimum(np.ldexp(weights, -unit), most)
    return np.floor(scaled).astype(np.int64), unit
