"""Repeated paths: ``p*``, ``p+``, ``p?`` as a set of pairs of ends (SPARQL 1.1 §18.4, ALP)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..rdf.timed import Kind, ObjectColumn
from .columns import Pairs, Relation, TermValues, as_terms
from .expressions import Const
from .joins import match_keys
from .logical import START, STOP, Closure


def closure(plan: Closure, step: Relation, nodes: ObjectColumn, terms: TermValues) -> Pairs:
    """The pairs of ends of the repetition of ``step``, in the order of their ids; of those that the
    constants of ``plan`` select no one is missing.

    ``nodes`` are those of the graph: each reaches itself where ``plan.zero``. From an end that is a
    constant only what it reaches is followed; between two variables every pair is found: O(pairs)
    memory, a sort a round, as many rounds as the longest shortest path has steps.
    """
    dictionary = terms.dictionary
    starts = as_terms(step.column(START), dictionary).values.astype(np.int64)
    stops = as_terms(step.column(STOP), dictionary).values.astype(np.int64)
    if isinstance(plan.subject, Const):
        first = np.array([dictionary.id(plan.subject.term)], np.int64)
        found = _reached(first, starts, stops, plan, len(dictionary))
    elif isinstance(plan.object, Const):
        first = np.array([dictionary.id(plan.object.term)], np.int64)
        stop, start = _reached(first, stops, starts, plan, len(dictionary))
        found = start, stop
    else:
        every = as_terms(nodes, dictionary).values.astype(np.int64)
        seeds = np.unique(np.concatenate([every, starts]) if plan.zero else starts)
        found = _reached(seeds, starts, stops, plan, len(dictionary))
    first_ids, last_ids = (ObjectColumn(Kind.TERM, ids.astype(np.int32)) for ids in found)
    return first_ids, last_ids


def _reached(
    seeds: NDArray[np.int64],
    starts: NDArray[np.int64],
    stops: NDArray[np.int64],
    plan: Closure,
    size: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs (seed, what it reaches), each once: what is new in a round goes one step further."""
    front = np.unique(seeds) * size + np.unique(seeds)
    known = front if plan.zero else np.zeros(0, np.int64)
    while len(front):
        at, to = match_keys(front % size, starts)
        following = np.unique(front[at] // size * size + stops[to])
        front = np.setdiff1d(following, known, assume_unique=True)
        known = np.union1d(known, front)
        if not plan.more:
            break
    return known // size, known % size
