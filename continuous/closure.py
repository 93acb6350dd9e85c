"""Repeated paths: ``p*``, ``p+``, ``p?`` as a set of pairs of ends (SPARQL 1.1 §18.4, ALP)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..rdf.dictionary import Ids
from ..rdf.timed import Kind, ObjectColumn
from .columns import Relation, TermValues, as_terms
from .expressions import Const, Var
from .joins import match_keys
from .logical import START, STOP, Closure, Position


def closure(plan: Closure, step: Relation, nodes: ObjectColumn, terms: TermValues) -> Relation:
    """The pairs of ends of the repetition of ``step``, in the order of their ids.

    ``nodes`` are those of the graph: each reaches itself where ``plan.zero``. From an end that is a
    constant only what it reaches is followed; between two variables every pair is found: O(pairs)
    memory, a sort a round, as many rounds as the longest shortest path has steps.
    """
    dictionary = terms.dictionary
    starts = as_terms(step.column(START), dictionary).values.astype(np.int64)
    stops = as_terms(step.column(STOP), dictionary).values.astype(np.int64)
    size = len(dictionary)
    if isinstance(plan.subject, Const):
        first = np.array([dictionary.id(plan.subject.term)], np.int64)
        found = _reached(first, starts, stops, plan, size + 1)
    elif isinstance(plan.object, Const):
        first = np.array([dictionary.id(plan.object.term)], np.int64)
        stop, start = _reached(first, stops, starts, plan, size + 1)
        found = (start, stop)
    else:
        every = as_terms(nodes, dictionary).values.astype(np.int64)
        seeds = np.unique(np.concatenate([every, starts]) if plan.zero else starts)
        found = _reached(seeds, starts, stops, plan, size + 1)
    return _selected(plan.subject, plan.object, *found, terms)


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


def _selected(
    subject: Position,
    object: Position,
    starts: NDArray[np.int64],
    stops: NDArray[np.int64],
    terms: TermValues,
) -> Relation:
    keep = np.ones(len(starts), np.bool_)
    for position, ids in ((subject, starts), (object, stops)):
        if isinstance(position, Const):
            keep &= ids == terms.dictionary.find(position.term)
    if isinstance(subject, Var) and subject == object:
        keep &= starts == stops
    columns = {
        position.name: ObjectColumn(Kind.TERM, _ids(ids[keep]))
        for position, ids in ((subject, starts), (object, stops))
        if isinstance(position, Var)
    }
    return Relation(columns, int(np.count_nonzero(keep)))


def _ids(values: NDArray[np.int64]) -> Ids:
    return values.astype(np.int32)
