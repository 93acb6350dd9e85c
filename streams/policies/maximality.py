"""Samples that could still be added to a substream ([DyKnow10 Def. 5.35, 5.36]).

Def. 5.36 is read with each sample used at most once: else a sample could be repeated for ever, and
nothing would be maximal. So a stream comes from another by a correspondence, and where samples are
equal there may be several. It is maximal if under one of them no unused sample can be added. The
one that uses the oldest of equal samples leaves the least to add.

Under ``any change`` a delayed copy of a kept sample is no news. So copies count only undelayed, at
their own place, whichever of equal samples the kept ones are taken to be. Where samples
wait for others (an order with a max delay), a copy that came before the last one like it was sent
is no news either: a sample that waits cannot know that there will be room before it. Under
``change by d`` every sample counts only undelayed: delayed enough, nearly each would differ from
its neighbours.

Samples of one instant differ by their sequence numbers (SPEC §1), so there is always room for one
more in an instant, but none before the place that the sample has itself in its own instant.

Whether something can be added is decided one sample at a time, which is enough: a part of what
satisfies an order, a delay or a duration satisfies it, and a chain of ``sample every`` grows by its
next sample. Only what must differ from its neighbours may need each other: copies (between A and B
there is room for B, A), and samples under ``change by d``.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections import defaultdict, deque
from collections.abc import Sequence
from itertools import groupby, pairwise

from ..sample import Content
from ..time import TIME_MAX
from .constraints import after, alone
from .policy import AnyChange, ChangeBy, Order, Policy

Known = tuple[int, Content]
"""Available time and content of a sample."""
Place = tuple[int, int]
"""An instant, and the row of the whole stream at which a sample stands in it."""


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


def places(part: Sequence[Known], whole: Sequence[Known]) -> list[Place]:
    """Where the samples of ``part`` stand among those of ``whole``: each at the first one like it
    of its instant, else right after the one before it. Cost: O(n + m) Python."""
    found: list[Place] = []
    like: dict[Content, list[int]] = {}
    end = 0
    for time, content in part:
        last = found[-1][1] if found and found[-1][0] == time else -1
        if last < 0:
            while end < len(whole) and whole[end][0] < time:
                end += 1
            begin = end
            while end < len(whole) and whole[end][0] == time:
                end += 1
            if end > begin:
                like = defaultdict(list)
                for row in range(begin, end):
                    like[whole[row][1]].append(row)
        rows = like.get(content, [])
        at = bisect_right(rows, last)
        is_own = at < len(rows) and whole[rows[at]][0] == time
        found.append((time, rows[at] if is_own else last))
    return found


def addable(
    part: Sequence[Known], whole: Sequence[Known], policy: Policy
) -> tuple[int, int] | None:
    """A row of ``whole`` that can be added to its satisfying substream ``part``, and an available
    time for it; None if there is none. Cost: O((n + m) log m) Python, m rows of ``part``.
    """
    if isinstance(policy.change, ChangeBy):
        return _addable_undelayed(part, whole, policy)
    valids = [content[0] for _, content in part]
    taken = places(part, whole)
    rows, _ = unused(part, whole)
    kept: set[Content] = set()
    if isinstance(policy.change, AnyChange):
        kept.update(content for _, content in part)
    for row in rows:
        available, content = whole[row]
        # Under `any change` a copy counts at its own place only: `_addable_copy` tries these.
        if content in kept or alone(available, content[0], policy) is not None:
            continue
        moment = _moment((available, row), content[0], policy, taken, valids)
        if moment is not None:
            return row, moment
    return _addable_copy(part, whole, kept, policy) if kept else None


def _addable_undelayed(
    part: Sequence[Known], whole: Sequence[Known], policy: Policy
) -> tuple[int, int] | None:
    """A row that can be added at its own place, by itself or before others of the same
    gap. Cost: O(k²) Python for k rows in a gap."""
    taken = places(part, whole)
    rows = _copies(part, whole, taken, {content for _, content in whole}, policy)
    free = [(bisect_left(taken, (whole[row][0], row)), row) for row in rows]
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
    """A copy of a ``kept`` sample that can be added at its own place, by itself or
    before another copy."""
    taken = places(part, whole)
    free = (
        (bisect_left(taken, (whole[row][0], row)), row)
        for row in _copies(part, whole, taken, kept, policy)
    )
    for place, gap in groupby(free, key=lambda each: each[0]):
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
    part: Sequence[Known],
    whole: Sequence[Known],
    taken: Sequence[Place],
    kept: set[Content],
    policy: Policy,
) -> list[int]:
    """Rows of ``whole`` like a ``kept`` one that could be in ``part``, whose places are ``taken``,
    at their own place, as far as Def. 5.36 and their delay go; in order of time."""
    waits = (
        policy.order is not Order.ANY
        and policy.max_delay is not None
        and isinstance(policy.change, AnyChange)
    )
    spare: dict[Content, int] = defaultdict(int)
    found: dict[Content, list[int]] = defaultdict(list)
    sent = 0

    def send_before(place: Place) -> None:
        nonlocal sent
        while sent < len(part) and taken[sent] < place:
            content = part[sent][1]
            spare[content] -= 1
            # All that had come are in use: none of them can be sent once more before this one.
            if waits or not spare[content]:
                found[content].clear()
            sent += 1

    for row, (time, content) in enumerate(whole):
        if content in kept:
            send_before((time, row))
            spare[content] += 1
            if alone(time, content[0], policy) is None:
                found[content].append(row)
    # Samples sent after the last row use up copies, too.
    send_before((TIME_MAX + 1, 0))
    return sorted(row for rows in found.values() for row in rows)


def _moment(
    own: Place, valid: int, policy: Policy, taken: Sequence[Place], valids: Sequence[int]
) -> int | None:
    """An available time at which a sample could stand in a satisfying stream; None if none.
    ``own`` is its place in the whole, ``taken`` are those of the stream."""
    available, row = own
    # A sample is sent no earlier than it came (Def. 5.36).
    low, high = available, TIME_MAX
    then: int | None = None
    """The sample before which it has to stand."""
    if policy.max_delay is not None:
        high = min(high, valid + policy.max_delay)
    if policy.period is not None and taken:
        # A chain of samples one period apart grows at its ends only.
        if valid == valids[0] - policy.period:
            then = 0
        elif valid == valids[-1] + policy.period:
            low = max(low, taken[-1][0])
        else:
            return None
    elif policy.period is None and policy.order is not Order.ANY:
        # The stream is ordered by valid time, so the place of the sample is known.
        before, after = bisect_left(valids, valid), bisect_right(valids, valid)
        if after > before and policy.order is Order.STRICT:
            return None
        if before:
            low = max(low, taken[before - 1][0])
        if after < len(taken):
            then = after
    # A sample that waits for a later instant may stand anywhere in it.
    if then is not None and (low, row if low == available else -1) > taken[then]:
        return None
    return low if low <= high else None
