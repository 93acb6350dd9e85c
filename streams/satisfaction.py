"""What the definitions say of streams and policies ([DyKnow10 Def. 5.35-5.37], SPEC §1).

`prove` decides whether one stream is in eval_fsterm of another under a policy, and gives the first
counterexample where it is not. It shares nothing with `adaptation`, which makes such streams.

Def. 5.36 is read with each sample used at most once: else a sample could be repeated for ever, and
nothing would be maximal. For the same reason a delayed copy of a kept sample is no news for
``any change``. Whether something can be added is decided one sample at a time, which is enough: a
part of what satisfies an order, a delay or a duration satisfies it, and a chain of ``sample every``
grows by its next sample.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np

from .policy import AnyChange, Approximation, Constraint, Order, Policy
from .recent import most_recent_rows
from .sample import SampleBatch
from .time import TIME_MAX

Content = tuple[Any, ...]
"""Valid time and values of a sample: all but when it became available."""


@dataclass(frozen=True, slots=True)
class Counterexample:
    """Where a stream is not what it has to be: row ``row`` (from 0) of it, or of the stream it was
    made from where something is missing. Times in the message are ns."""

    constraint: Constraint | None
    row: int
    message: str


def satisfies(stream: SampleBatch, policy: Policy) -> Counterexample | None:
    """Def. 5.37 (and Def. 4.1: available times increase): the first sample that breaks it, or
    None. Cost: O(n) Python."""
    rows = list(zip(stream.available.tolist(), _contents(stream), strict=True))
    for row, (available, content) in enumerate(rows):
        problem = _alone(available, content[0], policy)
        if problem is None and row:
            problem = _after(*rows[row - 1], available, content, policy)
        if problem is not None:
            constraint, message = problem
            return Counterexample(constraint, row, message)
    return None


def extend(stream: SampleBatch, policy: Policy, horizon: int | None = None) -> SampleBatch:
    """Def. 5.35: the stream itself, or with ``use most recent`` the samples of the grid.

    ``horizon`` is the last valid time to make where the policy says ``to oo``; without it, the
    first at which all samples are in. Nothing is made before the first sample is in. Cost:
    O(n log n + grid).
    """
    if policy.approximation is not Approximation.MOST_RECENT:
        return stream
    start, period, delay = policy.duration.start, policy.period, policy.max_delay
    assert start is not None
    assert period is not None
    assert delay is not None
    if not len(stream):
        return stream
    pairs = zip(stream.available.tolist(), stream.valid.tolist(), strict=True)
    in_use = [max(valid, available - delay) for available, valid in pairs]
    first = max(0, -((start - min(in_use)) // period))
    last = (min(policy.duration.last, TIME_MAX - delay) - start) // period
    if policy.duration.to_oo:
        if horizon is None:
            last = min(last, max(0, -((start - max(in_use)) // period)))
        else:
            last = min(last, (horizon - start) // period)
    points = np.array([start + period * n for n in range(first, last + 1)], np.int64)
    rows = most_recent_rows(stream.available, stream.valid, points, points + delay)
    return SampleBatch(points + delay, points, stream.take(rows).columns)


def is_substream(part: SampleBatch, whole: SampleBatch) -> Counterexample | None:
    """Def. 5.36: every sample of ``part`` is one of ``whole``, no earlier, none used twice."""
    _, strange = _origins(part, whole)
    if strange is None:
        return None
    at, valid = int(part.available[strange]), int(part.valid[strange])
    message = f"no sample valid at {valid} with these values was available by {at}, or it is used"
    return Counterexample(None, strange, message)


def is_maximal(part: SampleBatch, whole: SampleBatch, policy: Policy) -> Counterexample | None:
    """Def. 5.35: no sample of ``whole`` can be added to its substream ``part`` at a free available
    time, so that ``policy`` still holds. The counterexample's row is in ``whole``."""
    used, _ = _origins(part, whole)
    times = part.available.tolist()
    contents = _contents(part)
    valid = [content[0] for content in contents]
    kept = set(contents)
    free = _next_free(times)
    whole_times, whole_contents = whole.available.tolist(), _contents(whole)
    for row in np.flatnonzero(~used).tolist():
        available, content = whole_times[row], whole_contents[row]
        if isinstance(policy.change, AnyChange) and content in kept:
            continue
        if _alone(available, content[0], policy) is not None:
            continue
        moment = _moment(available, content[0], policy, times, valid, free)
        if moment is not None:
            message = f"a sample valid at {content[0]} could be sent at {moment}"
            return Counterexample(None, row, message)
    return None


def prove(part: SampleBatch, stream: SampleBatch, policy: Policy) -> Counterexample | None:
    """Whether ``part`` is in eval_fsterm(stream with policy), Def. 5.35; None if it is.

    With ``to oo`` the grid is looked at as far as ``part`` goes, and at least until all samples
    are in it.
    """
    horizon = int(part.valid[-1]) if len(part) else None
    whole = extend(stream, policy)
    if len(part) > len(whole):
        whole = extend(stream, policy, horizon)
    return satisfies(part, policy) or is_substream(part, whole) or is_maximal(part, whole, policy)


def _contents(batch: SampleBatch) -> list[Content]:
    columns = [batch.columns[name].tolist() for name in sorted(batch.columns)]
    return list(zip(batch.valid.tolist(), *columns, strict=True))


def _alone(available: int, valid: int, policy: Policy) -> tuple[Constraint, str] | None:
    """What a sample breaks whatever stands beside it."""
    duration = policy.duration
    if not duration.first <= valid <= duration.last:
        return Constraint.DURATION, f"valid at {valid}, outside the duration"
    if policy.max_delay is not None and available - valid > policy.max_delay:
        delay = available - valid
        return Constraint.DELAY, f"delay {delay} of the sample valid at {valid} is too long"
    return None


def _after(
    available: int, content: Content, next_available: int, then: Content, policy: Policy
) -> tuple[Constraint, str] | None:
    """What two consecutive samples break."""
    if next_available <= available:
        return Constraint.AVAILABLE, f"available at {next_available}, not after {available}"
    step = then[0] - content[0]
    if policy.period is not None and step != policy.period:
        return Constraint.PERIOD, f"valid at {then[0]}, {step} after the one before"
    if policy.order is not Order.ANY and (step < 0 or (step == 0 and policy.order is Order.STRICT)):
        return Constraint.ORDER, f"valid at {then[0]} after one valid at {content[0]}"
    if isinstance(policy.change, AnyChange) and content == then:
        return Constraint.CHANGE, f"the sample valid at {then[0]} repeats the one before"
    return None


def _origins(part: SampleBatch, whole: SampleBatch) -> tuple[np.ndarray[Any, Any], int | None]:
    """Which samples of ``whole`` are used by ``part``, and the first row of ``part`` that has no
    origin. Of equal samples the newest possible one is used: the oldest are the freest to add."""
    used = np.zeros(len(whole), np.bool_)
    by_content: dict[Content, list[int]] = defaultdict(list)
    times = whole.available.tolist()
    contents = _contents(whole)
    arrived = 0
    for row, (time, content) in enumerate(
        zip(part.available.tolist(), _contents(part), strict=True)
    ):
        while arrived < len(times) and times[arrived] <= time:
            by_content[contents[arrived]].append(arrived)
            arrived += 1
        candidates = by_content.get(content)
        if not candidates:
            return used, row
        used[candidates.pop()] = True
    return used, None


def _next_free(times: list[int]) -> list[int]:
    """For each taken time the least free one after it."""
    free = list(times)
    for i in reversed(range(len(times))):
        following = times[i] + 1
        if i + 1 < len(times) and times[i + 1] == following:
            free[i] = free[i + 1]
        else:
            free[i] = following
    return free


def _moment(
    available: int,
    valid: int,
    policy: Policy,
    times: list[int],
    valids: list[int],
    free: list[int],
) -> int | None:
    """A free available time at which a sample could stand in a satisfying stream; None if none."""
    low, high = available, TIME_MAX
    if policy.max_delay is not None:
        high = min(high, valid + policy.max_delay)
    if policy.period is not None and times:
        if valid == valids[0] - policy.period:
            high = min(high, times[0] - 1)
        elif valid == valids[-1] + policy.period:
            low = max(low, times[-1] + 1)
        else:
            return None
    elif policy.period is None and policy.order is not Order.ANY:
        # The stream is ordered by valid time, so the place of the sample is known.
        before = bisect_left(valids, valid)
        after = before
        while after < len(valids) and valids[after] == valid:
            after += 1
        if after > before and policy.order is Order.STRICT:
            return None
        if before:
            low = max(low, times[before - 1] + 1)
        if after < len(times):
            high = min(high, times[after] - 1)
    place = bisect_left(times, low)
    if place < len(times) and times[place] == low:
        low = free[place]
    return low if low <= high else None
