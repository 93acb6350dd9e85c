"""`most_recent_at` for many query points at once ([DyKnow10 Def. 5.6])."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .sample import Times
from .tuples import Rows


def most_recent_rows(
    available: Times, valid: Times, points: Times, known: Times, order: Rows | None = None
) -> Rows:
    """For each k the row of most_recent_at(f, points[k], known[k]), -1 for no_sample; shape (K,).

    f is given by its times, shape (n,), ``available`` increasing. Contract: ``points`` and
    ``known`` are nondecreasing, so a sample that may be used at one point may be used from then
    on; the answer at k is the greatest (valid, available) of the samples in use by then.

    Cost: O(n log K + K) where valid times do not decrease, else O(n log n + n log K + K).
    """
    begins = np.maximum(
        np.searchsorted(points, valid, "left"), np.searchsorted(known, available, "left")
    )
    return rows_in_use(available, valid, begins, np.arange(len(points)), order)


def rows_in_use(
    available: Times,
    valid: Times,
    begins: NDArray[Any],
    queries: NDArray[Any],
    order: Rows | None = None,
) -> Rows:
    """For each query the row with the greatest (valid, available) among those with
    ``begins`` ≤ query, -1 for none; ``queries`` are nondecreasing, ``available`` increases."""
    if not len(available):
        return np.full(len(queries), -1, np.int64)
    # In order of both, the last row that has come into use is the most recent one.
    if bool(np.all(valid[1:] >= valid[:-1])) and bool(np.all(begins[1:] >= begins[:-1])):
        return np.searchsorted(begins, queries, "right").astype(np.int64) - 1
    by_news = np.lexsort((available, valid)) if order is None else order
    rank = np.empty(len(valid), np.int64)
    rank[by_news] = np.arange(len(valid))
    by_begin = np.argsort(begins, kind="stable")
    # A row stays in use, so the answer is the greatest rank up to then.
    best = np.maximum.accumulate(rank[by_begin])
    last = np.searchsorted(begins[by_begin], queries, "right") - 1
    found = by_news[best[np.maximum(last, 0)]]
    return np.where(last < 0, -1, found).astype(np.int64)
