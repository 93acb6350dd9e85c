"""Duplicates: rows that equal one a stream has taken (SPEC §1, docs/explanation/semantics.md)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .history import FluentStream
from .sample import Column, Content, Mask, SampleBatch, Times, concatenate, contents
from .stream_rules import Rules

_MIX = np.uint64(0x9E3779B97F4A7C15)


class Duplicates:
    """Which rows of a batch a stream has taken already.

    Cost: O(n log n) numpy for n rows, and Python for each row of an instant that went on in another
    batch. Memory: the rows of such an instant.
    """

    def __init__(self, rules: Rules) -> None:
        self._rules = rules
        self._taken: set[Content] | None = None
        """The rows of the last instant, if that has gone on in another batch."""

    def forget(self) -> None:
        """The last instant of the stream is another, or its rows have got fields."""
        self._taken = None

    def among(self, batch: SampleBatch, stream: FluentStream, pending: SampleBatch) -> Mask:
        """Which rows of ``batch`` equal one of ``stream``, of those ``pending``, or one before them
        in the batch. By `UNIQUE_TIMES` an equal available time is enough."""
        if self._rules.gap:
            return _has_taken_time(batch, stream, pending)
        last = stream.last_available
        # Earlier instants are before the watermark: a row that equals one of theirs is late.
        if last is None or not bool((goes_on := batch.available == last).any()):
            return repeated(pending, batch)
        # The set costs Python for each row, so it is made only for an instant that goes on.
        if self._taken is None:
            self._taken = set(contents(stream.between(last, last)))
        found = np.zeros(len(batch), np.bool_)
        rows = np.flatnonzero(goes_on)
        for row, content in zip(rows.tolist(), contents(batch.take(rows)), strict=True):
            found[row] = content in self._taken
            self._taken.add(content)
        if len(rows) < len(batch):
            found[~goes_on] = repeated(pending, batch.take(~goes_on))
        return found


def _has_taken_time(batch: SampleBatch, stream: FluentStream, pending: SampleBatch) -> Mask:
    """Which rows have the available time of another."""
    taken = np.ones(len(batch), np.bool_)
    _, earliest = np.unique(batch.available, return_index=True)
    taken[earliest] = False
    known = [pending.available]
    if stream.last_available is not None:
        known.append(np.array([stream.last_available], np.int64))
    taken |= np.isin(batch.available, np.concatenate(known))
    return taken


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
    # Equal rows have equal digests, so only the few rows that share one are compared.
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
    # Rows below ``count`` are those of ``known``, which the stream has taken.
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
        # A value under a set null bit means nothing, so it must not distinguish two rows.
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
