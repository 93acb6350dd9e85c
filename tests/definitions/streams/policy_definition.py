"""Policies by their definition ([DyKnow10 Def. 5.35-5.37]): sets, quantifiers, brute force.

Samples are tuples ``(available, valid, value)``; everything is Python integers. It shares nothing
with the product but the last moment of time and the names of the constraints in a `Policy`.
"""

from __future__ import annotations

from itertools import combinations, pairwise

from dyknow.streams.policies.policy import (
    AnyChange,
    Approximation,
    ChangeBy,
    Order,
    Policy,
)
from dyknow.streams.time import TIME_MAX

Sample = tuple[int, int, object]


def satisfies(stream: list[Sample], policy: Policy) -> bool:
    """Def. 5.37, and the order of Def. 4.1: those of one available time stand in order of
    sequence.
    """
    times = [ta for ta, _, _ in stream]
    if any(a > b for a, b in pairwise(times)):
        return False
    pairs = list(pairwise(stream))
    if isinstance(policy.change, AnyChange) and any(a[1:] == b[1:] for a, b in pairs):
        return False
    if isinstance(policy.change, ChangeBy):
        d = policy.change.difference
        if not all(is_change_by(a[2], b[2], d) for a, b in pairs):
            return False
    if policy.period is not None and any(b[1] - a[1] != policy.period for a, b in pairs):
        return False
    if policy.duration.start is not None and any(tv < policy.duration.start for _, tv, _ in stream):
        return False
    if policy.duration.end is not None and any(tv > policy.duration.end for _, tv, _ in stream):
        return False
    if policy.max_delay is not None and any(ta - tv > policy.max_delay for ta, tv, _ in stream):
        return False
    if policy.order is Order.MONOTONE and any(a[1] > b[1] for a, b in pairs):
        return False
    return not (policy.order is Order.STRICT and any(a[1] >= b[1] for a, b in pairs))


def is_change_by(before: tuple[object, ...], then: tuple[object, ...], d: float) -> bool:
    """Some number differs by at least ``d``, or is there in one only."""

    def number(value: object) -> bool:
        return type(value) in (int, float)

    for a, b in zip(before, then, strict=True):
        if number(a) and number(b) and not -d < a - b < d:
            return True
        if (number(a) and b is None) or (a is None and number(b)):
            return True
    return False


def most_recent_at(stream: list[Sample], time: int, query: int) -> Sample | None:
    """Def. 5.6."""
    before = [s for s in stream if s[0] <= query and s[1] <= time]
    if not before:
        return None
    newest = max(s[1] for s in before)
    return [s for s in before if s[1] == newest][-1]


def extend(stream: list[Sample], policy: Policy, horizon: int) -> list[Sample]:
    """Def. 5.35; ``horizon`` is the last valid time to look at where the policy says ``oo``."""
    if policy.approximation is not Approximation.MOST_RECENT:
        return list(stream)
    assert policy.duration.start is not None
    assert policy.period is not None
    assert policy.max_delay is not None
    end = horizon if policy.duration.end is None else policy.duration.end
    made: list[Sample] = []
    time = policy.duration.start
    while time <= end:
        found = most_recent_at(stream, time, time + policy.max_delay)
        if found is not None:
            made.append((time + policy.max_delay, time, found[2]))
        time += policy.period
    return made


def origins(part: list[Sample], whole: list[Sample]) -> list[int] | None:
    """Def. 5.36 with each sample used once: for every sample of ``part`` the index of its origin
    in ``whole``, or None if there is no such correspondence (bipartite matching)."""
    chosen: dict[int, int] = {}

    def place(row: int, seen: set[int]) -> bool:
        ta, tv, value = part[row]
        for index, (a, v, w) in enumerate(whole):
            if index not in seen and a <= ta and v == tv and w == value:
                seen.add(index)
                if index not in chosen or place(chosen[index], seen):
                    chosen[index] = row
                    return True
        return False

    if not all(place(row, set()) for row in range(len(part))):
        return None
    return [next(i for i, r in chosen.items() if r == row) for row in range(len(part))]


def unused(part: list[Sample], whole: list[Sample]) -> list[int]:
    """The rows that ``part`` leaves where each of its samples comes from the oldest equal one of
    ``whole``; any other choice leaves an older one instead, which can be added wherever this one
    can."""
    left = list(range(len(whole)))
    for sample in part:
        left.remove(next(row for row in left if whole[row][1:] == sample[1:]))
    return left


def places(part: list[Sample], whole: list[Sample]) -> list[tuple[int, int]]:
    """The instant and the sequence number at which each sample of ``part`` stands: those of the
    first one like it in its instant that comes after the one before; else of the one before."""
    found: list[tuple[int, int]] = []
    for time, *content in part:
        last = found[-1][1] if found and found[-1][0] == time else -1
        rows = [
            row
            for row, (ta, *other) in enumerate(whole)
            if ta == time and other == content and row > last
        ]
        found.append((time, min(rows, default=last)))
    return found


def addable(part: list[Sample], whole: list[Sample], policy: Policy) -> Sample | None:
    """A sample of ``whole`` that can still be added to ``part``, with the available time at which;
    None if ``part`` is maximal.

    All times at which something could differ are tried: those of ``part`` and next to them, and its
    own; and all sequence numbers, but those in its own instant before its own.
    For `change by` all count only at their own place, up to three at once.
    For `any change` one that repeats what is kept counts only there: by itself, or with another
    such; where samples wait, only after the last one like it.
    """
    taken = places(part, whole)

    def own(row: int) -> int:
        """How many of ``part`` stand before the place of a sample."""
        return sum(place < (whole[row][0], row) for place in taken)

    def with_rows(rows: tuple[int, ...]) -> list[Sample]:
        more = list(part)
        for row in reversed(rows):
            more.insert(own(row), whole[row])
        return more

    if isinstance(policy.change, ChangeBy):
        free = [row for row, s in enumerate(whole) if (s[0], row) not in taken]
        for count in (1, 2, 3):
            for rows in combinations(free, count):
                more = with_rows(rows)
                if satisfies(more, policy) and origins(more, whole) is not None:
                    return whole[rows[0]]
        return None
    repeats = isinstance(policy.change, AnyChange)
    kept = {s[1:] for s in part}
    for row in unused(part, whole):
        sample = whole[row]
        if repeats and sample[1:] in kept:
            continue
        times = {sample[0]} | {s[0] + step for s in part for step in (-1, 0, 1)}
        if policy.max_delay is not None:
            times.add(min(sample[1] + policy.max_delay, TIME_MAX))
        for time in times:
            if not sample[0] <= time <= TIME_MAX:
                continue
            added = (time, *sample[1:])
            first = own(row) if time == sample[0] else 0
            for at in range(first, len(part) + 1):
                more = [*part[:at], added, *part[at:]]
                if satisfies(more, policy) and origins(more, whole) is not None:
                    return added
    if not repeats:
        return None
    copies = [row for row, s in enumerate(whole) if s[1:] in kept]
    if policy.order is not Order.ANY and policy.max_delay is not None:
        copies = [
            row
            for row in copies
            if all(
                place < (whole[row][0], row)
                for place, sample in zip(taken, part, strict=True)
                if sample[1:] == whole[row][1:]
            )
        ]
    for rows in [(one,) for one in copies] + list(combinations(copies, 2)):
        more = with_rows(rows)
        if satisfies(more, policy) and origins(more, whole) is not None:
            return whole[rows[0]]
    return None
