"""Repeated paths: ``p*``, ``p+``, ``p?`` as a set of pairs of nodes (SPARQL 1.1 §18.4, ALP)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...rdf.timed import Kind, ObjectColumn
from ..algebra.expressions import Const
from ..algebra.plan import START, STOP, Closure
from ..columns.budget import Budget
from ..columns.relation import Pairs, Relation, TermValues, as_terms
from .joins import match_keys


def closure(plan: Closure, step: Relation, nodes: ObjectColumn, terms: TermValues) -> Pairs:
    """Return the (start, end) pairs of the repetition of ``step``: at least those that the
    constants of ``plan`` select.

    ``nodes`` are those of the graph: each reaches itself if ``plan.zero``. From a constant end only
    reachable nodes are followed. Between two variables the result has all pairs: O(pairs) memory, a
    sort per round, as many rounds as the longest shortest path has steps.
    """
    dictionary = terms.dictionary
    begins, ends = (as_terms(step.column(name), dictionary).values for name in (START, STOP))
    given = [ids[:0] for ids in (begins, begins)]
    if isinstance(plan.subject, Const):
        given[0] = np.array([dictionary.transient_id(plan.subject.term)], np.int32)
    elif isinstance(plan.object, Const):
        given[0] = np.array([dictionary.transient_id(plan.object.term)], np.int32)
    elif plan.zero:
        given[1] = as_terms(nodes, dictionary).values
    # Number nodes by first appearance. Ids would give an order that depends on forgotten terms.
    numbered, (seed, every, starts, stops) = _numbered([*given, begins, ends])
    if isinstance(plan.subject, Const):
        found = _reached(seed, starts, stops, plan, len(numbered), terms.budget)
    elif isinstance(plan.object, Const):
        stop, start = _reached(seed, stops, starts, plan, len(numbered), terms.budget)
        found = start, stop
    else:
        seeds = np.concatenate([every, starts])
        found = _reached(seeds, starts, stops, plan, len(numbered), terms.budget)
    first_ids, last_ids = (ObjectColumn(Kind.TERM, numbered[codes]) for codes in found)
    return first_ids, last_ids


def _numbered(
    parts: Sequence[NDArray[np.int32]],
) -> tuple[NDArray[np.int32], list[NDArray[np.int64]]]:
    """Return the distinct ids in order of appearance, and the ids of each part as places in it."""
    ids, first, inverse = np.unique(np.concatenate(parts), return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    cuts = np.cumsum([len(part) for part in parts])[:-1]
    return ids[order], np.split(rank[inverse.reshape(-1)], cuts)


def _reached(
    seeds: NDArray[np.int64],
    starts: NDArray[np.int64],
    stops: NDArray[np.int64],
    plan: Closure,
    size: int,
    budget: Budget,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return pairs (seed, reachable node), each once. A round extends only the last round's new
    pairs, so each pair is extended once."""
    front = np.unique(seeds) * size + np.unique(seeds)
    known = front if plan.zero else np.zeros(0, np.int64)
    while len(front):
        at, to = match_keys(front % size, starts, budget)
        following = np.unique(front[at] // size * size + stops[to])
        front = np.setdiff1d(following, known, assume_unique=True)
        budget.check(len(known) + len(front), "a repeated path")
        known = np.union1d(known, front)
        if not plan.more:
            break
    return known // size, known % size
