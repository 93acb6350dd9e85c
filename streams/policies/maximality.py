"""Samples that could still be added to a substream ([DyKnow10 Def. 5.35, 5.36]).

Def. 5.36 is read with each sample used at most once: else a sample could be repeated for ever, and
nothing would be maximal. So a stream comes from another by a correspondence, and where samples are
equal there may be several. It is maximal if under one of them no unused sample can be added. The
one that uses the oldest of equal samples leaves the least to add.

Under ``any change`` a delayed copy of a kept sample is no news. So copies count only undelayed, at
their own available time, whichever of equal samples the kept ones are taken to be. Where samples
wait for others (an order with a max delay), a copy that came before the last one like it was sent
is no news either: a sample that waits cannot know that there will be room before it. Under
``change by d`` every sample counts only undelayed: delayed enough, nearly each would differ from
its neighbours.

Whether something can be added is decided one sample at a time, which is enough: a part of what
satisfies an order, a delay or a duration satisfies it, and a chain of ``sample every`` grows by its
next sample. Only what must differ from its neighbours may need each other: copies (between A and B
there is room for B, A), and samples under ``change by d``.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import defaultdict, deque
from collections.abc import Sequence
from itertools import groupby, pairwise

from ..sample import Content
from ..time import TIME_MAX
from .constraints import after, alone
from .policy import AnyChange, ChangeBy, Order, Policy

Known = tuple[int, Content]
"""Available time and content of a sample."""


def unused(part: Sequence[Known], whole: Sequence[Known]) -> tuple[list[int], int | None]:
    """The rows of ``whole`` that its substream ``part`` leaves unused, where each sample comes
    from the oldest one like it; and the first row of ``part`` that comes from none. Both in order
    of available time. Cost: O(n + m) Python."""
    waiting: dict[Content, deque[int]] = defaultdict(deque)
    arrived = 0
    for row, (time, content) in enumerate(part):
        while arrived < len(whole) and whole[arrived][0] <= time:
            waiting[whole[arrived][1]].append(arrived)
            arrived += 1
        if not waiting[content]:
            return [], row
        waiting[content].popleft()
    left = [row for rows in waiting.values() for row in rows]
    return sorted([*left, *range(arrived, len(whole))]), None


def addable(
    part: Sequence[Known], whole: Sequence[Known], policy: Policy
) -> tuple[int, int] | None:
    """A row of ``whole`` that can be added to its satisfying substream ``part``, and a free
    available time for it; None if there is none. Cost: O((n + m) log m) Python, m rows of ``part``.
    """
    if isinstance(policy.change, ChangeBy):
        return _addable_undelayed(part, whole, policy)
    times = [time for time, _ in part]
    valids = [content[0] for _, content in part]
    free = _next_free(times)
    rows, _ = unused(part, whole)
    kept: set[Content] = set()
    if isinstance(policy.change, AnyChange):
        kept.update(content for _, content in part)
    for row in rows:
        available, content = whole[row]
        if content in kept or alone(available, content[0], policy) is not None:
            continue
        moment = _moment(available, content[0], policy, times, valids, free)
        if moment is not None:
            return row, moment
    return _addable_copy(part, whole, kept, policy) if kept else None


def _addable_undelayed(
    part: Sequence[Known], whole: Sequence[Known], policy: Policy
) -> tuple[int, int] | None:
    """A row that can be added at its own available time, by itself or before others of the same
    gap. Cost: O(k²) Python for k rows in a gap."""
    times = [time for time, _ in part]
    taken = set(times)
    rows, _ = unused(part, whole)
    free = [
        (bisect_left(times, time), row)
        for row in rows
        for time, content in [whole[row]]
        if time not in taken and alone(time, content[0], policy) is None
    ]
    for place, gap in groupby(free, key=lambda each: each[0]):
        before, then = part[place - 1 : place] if place else [], part[place : place + 1]
        reached: list[tuple[int, int]] = []
        """Rows to which a chain leads from before the gap, and the first of that chain."""
        for _, row in gap:
            starts = [first for last, first in reached if _fits([whole[last], whole[row]], policy)]
            if _fits([*before, whole[row]], policy):
                starts.append(row)
            if starts and _fits([whole[row], *then], policy):
                return starts[0], whole[starts[0]][0]
            if starts:
                reached.append((row, starts[0]))
    return None


def _addable_copy(
    part: Sequence[Known], whole: Sequence[Known], kept: set[Content], policy: Policy
) -> tuple[int, int] | None:
    """A copy of a ``kept`` sample that can be added at its own available time, by itself or
    before another copy."""
    times = [time for time, _ in part]
    places = (
        (bisect_left(times, whole[row][0]), row) for row in _copies(part, whole, kept, policy)
    )
    for place, gap in groupby(places, key=lambda each: each[0]):
        before, then = part[place - 1 : place], part[place : place + 1]
        told: int | None = None
        for _, row in gap:
            if _fits([*before, whole[row], *then], policy):
                return row, whole[row][0]
            # All others that fit their neighbours in order repeat one of the two.
            if told is not None and _fits([*before, whole[told], whole[row], *then], policy):
                return told, whole[told][0]
            if told is None and then and whole[row][1] == then[0][1]:
                told = row
    return None


def _fits(run: Sequence[Known], policy: Policy) -> bool:
    return all(after(*first, *second, policy) is None for first, second in pairwise(run))


def _copies(
    part: Sequence[Known], whole: Sequence[Known], kept: set[Content], policy: Policy
) -> list[int]:
    """Rows of ``whole`` like a ``kept`` one that could be in ``part`` at their own, free available
    time, as far as Def. 5.36 and their delay go; in order of time."""
    waits = policy.order is not Order.ANY and policy.max_delay is not None
    taken = {time for time, _ in part}
    spare: dict[Content, int] = defaultdict(int)
    found: dict[Content, list[int]] = defaultdict(list)
    sent = 0

    def send_before(time: int) -> None:
        nonlocal sent
        while sent < len(part) and part[sent][0] < time:
            content = part[sent][1]
            spare[content] -= 1
            # All that had come are in use: none of them can be sent once more before this one.
            if waits or not spare[content]:
                found[content].clear()
            sent += 1

    for row, (time, content) in enumerate(whole):
        if content in kept:
            send_before(time)
            spare[content] += 1
            if time not in taken and alone(time, content[0], policy) is None:
                found[content].append(row)
    send_before(TIME_MAX + 1)
    return sorted(row for rows in found.values() for row in rows)


def _next_free(times: list[int]) -> list[int]:
    """For each taken time the least free one after it."""
    free = list(times)
    for i in reversed(range(len(times))):
        following = times[i] + 1
        if i + 1 < len(times) and times[i + 1] <= following:
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
