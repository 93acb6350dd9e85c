"""The plan of the best quality (the strategy *quality* of [Introspection15 §4.3]).

The quality of a goal under a plan is that of its producer times the least quality of its inputs (1
if it has none). Better inputs never make it worse, so Knuth's algorithm finds the best quality of
every goal, and one plan has them all.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .hypergraph import Choice, Hypergraph, checked_roots, net_of
from .knuth import qualities, trees, used


def best_quality(graph: Hypergraph, roots: Sequence[int]) -> Choice | None:
    """A plan that gives every root, and every goal it uses, its best quality in any plan.

    None if a root cannot be derived. Exact in the arithmetic of floats (the same products, in the
    same order, as in the definition); always proven. Of the producers that keep every goal at its
    best, each goal takes the one with the least tree weight (a shared goal counts at each use),
    then the lowest, as far as `trees` promises. Cost: O((m + k) log m).
    """
    net, wanted = net_of(graph), checked_roots(graph, roots)
    quality = np.array(graph.qualities, np.float64)
    best = qualities(net, np.ones(net.size, np.bool_), quality)
    if len(wanted) and best[wanted].min() < 0:
        return None
    least = np.ones(net.size)
    owners = np.repeat(np.arange(net.size), np.diff(net.starts))
    np.minimum.at(least, owners, best[net.inputs])
    keeps = (least >= 0) & (quality * least == best[net.derives])
    _, picks = trees(net, keeps, np.array(graph.weights, np.float64))
    value = float(best[wanted].min()) if len(wanted) else 1.0
    goals = used(net, picks, wanted)
    return Choice(dict(zip(goals.tolist(), picks[goals].tolist(), strict=True)), value, value)
