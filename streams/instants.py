"""Samples that share an available time (SPEC §1)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .sample import Column, Mask, SampleBatch, Times, concatenate

_MIX = np.uint64(0x9E3779B97F4A7C15)


def places_in_instants(available: Times) -> NDArray[np.int64]:
    """The place of each sample among those of its instant, from 0; ``available`` does not
    decrease.
    """
    rows = np.arange(len(available))
    begins = np.ones(len(available), np.bool_)
    np.not_equal(available[1:], available[:-1], out=begins[1:])
    return rows - np.maximum.accumulate(np.where(begins, rows, 0))


class Places:
    """`places_in_instants` of a stream whose batches may cut instants."""

    def __init__(self) -> None:
        self._last: tuple[int | None, int] = None, 0
        """The last instant, and how many samples of it there have been."""

    def of(self, available: Times) -> NDArray[np.int64]:
        """The places of the samples of the next batch."""
        places = places_in_instants(available)
        last, count = self._last
        if int(available[0]) == last:
            places[available == last] += count
        self._last = int(available[-1]), int(places[-1]) + 1
        return places


def repeated(known: SampleBatch, batch: SampleBatch) -> Mask:
    """Which rows of ``batch`` are duplicates: equal in available time, valid time and all fields to
    a row of ``known`` or to one before them in ``batch``.

    ``known`` is in order of available time; both have the same fields, with texts of one pool.
    Cost: O(n log n) numpy for n rows of ``batch``, and those of ``known`` with their times.
    """
    candidates = _with_times_of(known, batch.available)
    count = len(candidates)
    both = concatenate([candidates, batch]) if count else batch
    keys = [both.available, both.valid]
    for column in both.columns.values():
        keys += _keys(column)
    suspects = _shared(_digest(keys))
    found = np.zeros(len(batch), np.bool_)
    if not len(suspects):
        return found
    # Stable, so that of equal rows the one that came first stands first.
    order = suspects[np.lexsort([key[suspects] for key in keys])]
    same = np.ones(len(order) - 1, np.bool_)
    for key in keys:
        ordered = key[order]
        same &= ordered[1:] == ordered[:-1]
    again = order[1:][same]
    found[again[again >= count] - count] = True
    return found


def _with_times_of(known: SampleBatch, times: Times) -> SampleBatch:
    """The rows of ``known`` that are available at one of ``times``."""
    if not len(known):
        return known
    wanted = np.unique(times)
    place = np.minimum(np.searchsorted(wanted, known.available), len(wanted) - 1)
    return known.take(wanted[place] == known.available)


def _keys(column: Column) -> Iterator[NDArray[Any]]:
    """Integers that are equal where the values are, and where there is no value."""
    values = column.values
    if values.dtype == np.float64:
        values = (values + 0.0).view(np.int64)  # 0.0 and -0.0 are equal
    if column.null is None:
        yield values
    else:
        yield np.where(column.null, 0, values)
        yield column.null


def _digest(keys: list[NDArray[Any]]) -> NDArray[np.uint64]:
    digest = np.zeros(len(keys[0]), np.uint64)
    for key in keys:
        digest = (digest ^ key.astype(np.int64).view(np.uint64)) * _MIX
        digest ^= digest >> np.uint64(32)
    return digest


def _shared(digest: NDArray[np.uint64]) -> NDArray[np.int64]:
    """The rows whose digest another row has too, in order."""
    order = np.argsort(digest, kind="stable")
    same = digest[order][1:] == digest[order][:-1]
    shared = np.zeros(len(digest), np.bool_)
    shared[order[1:][same]] = True
    shared[order[:-1][same]] = True
    return np.flatnonzero(shared)
