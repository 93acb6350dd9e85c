"""The definitions of streams and policies ([DyKnow10 Def. 5.35-5.37], SPEC §1).

`prove` decides whether one stream is in eval_fsterm of another under a policy, and gives the first
counterexample where it is not. It shares nothing with `adaptation`, which makes such streams.
`maximality` says how Def. 5.35 and 5.36 are read where samples are equal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..most_recent import most_recent_rows
from ..sample import Content, SampleBatch, contents
from ..time import TIME_MAX
from ..time_arithmetic import earlier
from .constraints import after, alone
from .maximality import addable, unused
from .policy import GRID_LIMIT, Approximation, Constraint, Policy, PolicyError

Name: TypeAlias = tuple[Any, ...]
"""The values of the fields that name an object."""


@dataclass(frozen=True, slots=True)
class Counterexample:
    """Where a stream is not what it has to be: row ``row`` (from 0) of it, or of the stream it was
    made from where something ``is_missing``, with ``use most recent`` of the grid of that. Times in
    the message are ns."""

    constraint: Constraint | None
    row: int
    message: str
    is_missing: bool = False


def satisfies(stream: SampleBatch, policy: Policy) -> Counterexample | None:
    """Def. 5.37 (and Def. 4.1: available times do not decrease): the first sample that breaks
    it, or None. Cost: O(n) Python.
    """
    rows = _rows(stream)
    for row, (available, content) in enumerate(rows):
        problem = alone(available, content[0], policy)
        if problem is None and row:
            problem = after(*rows[row - 1], available, content, policy)
        if problem is not None:
            constraint, message = problem
            return Counterexample(constraint, row, message)
    return None


def extend(stream: SampleBatch, policy: Policy, horizon: int | None = None) -> SampleBatch:
    """Def. 5.35: the stream itself, or with ``use most recent`` the samples of the grid.

    ``horizon`` is the last valid time to make where the policy says ``to oo``; without it, the
    first at which all samples are in. Nothing is made before the first sample is in. Raises
    `PolicyError` for a grid of more than `GRID_LIMIT` samples. Cost: O(n log n + grid) numpy.
    """
    if policy.approximation is not Approximation.MOST_RECENT:
        return stream
    start, period, delay = policy.duration.start, policy.period, policy.max_delay
    assert start is not None
    assert period is not None
    assert delay is not None
    if not len(stream):
        return stream
    in_use = np.maximum(stream.valid, earlier(stream.available, delay))
    first = max(0, -((start - int(in_use.min())) // period))
    last = (min(policy.duration.last, TIME_MAX - delay) - start) // period
    if policy.duration.to_oo:
        if horizon is None:
            last = min(last, max(0, -((start - int(in_use.max())) // period)))
        else:
            last = min(last, (horizon - start) // period)
    count = max(0, last + 1 - first)
    if count > GRID_LIMIT:
        raise PolicyError(
            f"the grid of `sample every` has {count} samples, more than {GRID_LIMIT}",
            "choose a longer period, or a `from` and `to` nearer to the data",
        )
    # Unsigned, as all the steps together may be longer than signed 64 bits; the points are not.
    steps = np.arange(count, dtype=np.uint64) * np.uint64(period)
    points = (steps + np.uint64((start + period * first) % 2**64)).view(np.int64)
    rows = most_recent_rows(stream.available, stream.valid, points, points + delay)
    return SampleBatch(points + delay, points, stream.take(rows).columns)


def is_substream(part: SampleBatch, whole: SampleBatch) -> Counterexample | None:
    """Def. 5.36: every sample of ``part`` is one of ``whole``, no earlier, none used twice."""
    _, strange = unused(_rows(part), _rows(whole))
    if strange is None:
        return None
    at, valid = int(part.available[strange]), int(part.valid[strange])
    message = f"no sample valid at {valid} with these values was available by {at}, or it is used"
    return Counterexample(None, strange, message)


def is_maximal(part: SampleBatch, whole: SampleBatch, policy: Policy) -> Counterexample | None:
    """Def. 5.35: no sample of ``whole`` can be added to its substream ``part`` at a free available
    time, so that ``policy`` still holds. The counterexample's row is in ``whole``."""
    found = addable(_rows(part), _rows(whole), policy)
    if found is None:
        return None
    row, moment = found
    message = f"a sample valid at {int(whole.valid[row])} could be sent at {moment}"
    return Counterexample(None, row, message, is_missing=True)


def prove(part: SampleBatch, stream: SampleBatch, policy: Policy) -> Counterexample | None:
    """Whether ``part`` is in eval_fsterm(stream with policy), Def. 5.35; None if it is.

    With ``to oo`` the grid is looked at as far as ``part`` goes, and at least until all samples
    are in it. Raises `PolicyError` for a grid of more than `GRID_LIMIT` samples. Cost: O(n log n)
    Python; numpy where ``part`` is just the grid of ``use most recent``.
    """
    horizon = int(part.valid[-1]) if len(part) else None
    whole = extend(stream, policy)
    if len(part) > len(whole):
        whole = extend(stream, policy, horizon)
    if policy.approximation is Approximation.MOST_RECENT and _is_same(part, whole):
        # The grid satisfies its policy by being made, and nothing of it is left to add.
        return None
    return satisfies(part, policy) or is_substream(part, whole) or is_maximal(part, whole, policy)


def satisfies_each(
    stream: SampleBatch, policy: Policy, keys: Sequence[str]
) -> Counterexample | None:
    """`satisfies`, for each object that the fields ``keys`` name by itself (SPEC §1, Policies)."""
    if not keys:
        return satisfies(stream, policy)
    for name, rows in by_object(stream, keys).items():
        found = satisfies(stream.take(rows), policy)
        if found is not None:
            return _of_object(found, rows, name)
    return None


def prove_each(
    part: SampleBatch, stream: SampleBatch, policy: Policy, keys: Sequence[str]
) -> Counterexample | None:
    """`prove`, for each object that the fields ``keys`` name by itself (SPEC §1, Policies)."""
    if not keys:
        return prove(part, stream, policy)
    parts, wholes = by_object(part, keys), by_object(stream, keys)
    nothing = np.zeros(0, np.int64)
    for name in {**wholes, **parts}:
        own, all = parts.get(name, nothing), wholes.get(name, nothing)
        found = prove(part.take(own), stream.take(all), policy)
        if found is None:
            continue
        rows = all if found.is_missing else own
        if found.is_missing and policy.approximation is Approximation.MOST_RECENT:
            rows = np.arange(found.row + 1)  # each object has a grid of its own
        return _of_object(found, rows, name)
    return None


def by_object(stream: SampleBatch, keys: Sequence[str]) -> dict[Name, NDArray[np.int64]]:
    """The rows of each object that the fields ``keys`` name; samples without a name are of one
    object together. Cost: O(n) Python."""
    if not len(stream):
        return {}  # it need not have fields yet
    columns = (stream.columns[key].tolist() for key in keys)
    found: dict[Name, list[int]] = {}
    for row, name in enumerate(zip(*columns, strict=True)):
        found.setdefault(name, []).append(row)
    return {name: np.array(rows, np.int64) for name, rows in found.items()}


def _of_object(found: Counterexample, rows: NDArray[np.int64], name: Name) -> Counterexample:
    """What was found in the samples of one object, in the stream that has those of all."""
    object = ", ".join("no name" if part is None else str(part) for part in name)
    return replace(found, row=int(rows[found.row]), message=f"of {object}: {found.message}")


def _rows(batch: SampleBatch) -> list[tuple[int, Content]]:
    return list(zip(batch.available.tolist(), contents(batch), strict=True))


def _is_same(one: SampleBatch, other: SampleBatch) -> bool:
    """Whether two streams are seen to be equal without looking at each sample in Python."""
    if len(one) != len(other) or one.columns.keys() != other.columns.keys():
        return False
    if not np.array_equal(one.available, other.available):
        return False
    if not np.array_equal(one.valid, other.valid):
        return False
    for name, column in one.columns.items():
        like = other.columns[name]
        present = column.present
        if column.pool is not like.pool or not np.array_equal(present, like.present):
            return False
        if not np.array_equal(column.values[present], like.values[present]):
            return False
    return True
