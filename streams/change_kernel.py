"""The simulation of `ChangeStates` as a compiled loop, for many samples at once.

Same events, same order, same states (tests/laws/test_joining.py); what `ChangeStates` keeps in
lists stands in arrays that are laid out beforehand.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from .compiled import Kernel
from .time import TIME_MAX, TIME_MIN

NOT_LATE: Final = 0
OVER_DELAY: Final = 1
"""The sample came after its state's deadline."""
AFTER_STATE: Final = 2
"""The sample came after the first state that could have used it."""

NOW: Final = 0
LEFT: Final = 1
LAST: Final = 2
HAS_BEGUN: Final = 3
HAS_LEFT: Final = 4
"""Places in ``clock``: the moment of the latest event, when and for what time the last state left,
and whether there has been an event and a state (0 or 1)."""


def _simulate(
    at: Any,
    input_of: Any,
    row_of: Any,
    key_of: Any,
    state_of: Any,
    times: Any,
    waiting: Any,
    keys: Any,
    row_at: Any,
    first_key: Any,
    place: Any,
    monotone: Any,
    reach: Any,
    has_reached: Any,
    excuse: Any,
    is_excused: Any,
    until: int,
    delay: int,
    exact: bool,
    clock: Any,
    leaves_at: Any,
    state: Any,
    complete: Any,
    rows: Any,
    why: Any,
) -> int:
    """Run the events, shape ``(n,)``, in order; how many states left.

    Of an event: when, of which input, the sample's row (-1: an excuse begins), its valid time as an
    index into ``keys`` and into ``times`` (-1: outside of the duration). ``times``, ``(m,)``, are
    all times that may get a state, ``waiting`` those that do. ``keys`` are the valid times of the
    inputs one after the other, those of input i from ``first_key[i]`` on, with the row that came
    last in ``row_at``; ``place[i, m]`` is the greatest key of input i that is not after the time.
    ``delay`` -1 is none. Written: ``waiting``, ``row_at``, ``reach``, ``clock``, for each state
    ``leaves_at``, ``state`` (an index into ``times``), ``complete`` and ``rows``, shape
    ``(m, inputs)``, and for each event ``why`` it was late.
    """
    events = at.shape[0]
    inputs = monotone.shape[0]
    count = times.shape[0]
    now, left, last = clock[NOW], clock[LEFT], clock[LAST]
    has_begun, has_left = clock[HAS_BEGUN] > 0, clock[HAS_LEFT] > 0
    made = 0
    head = 0
    for event in range(events + 1):
        limit = until
        is_due = True
        if event < events:
            # What leaves does so by the moment before.
            is_due = has_begun and at[event] > now
            limit = at[event] - 1 if is_due else until
        while is_due:
            while head < count and not waiting[head]:
                head += 1
            if head == count:
                break
            time = times[head]
            is_complete = True
            for i in range(inputs):
                if is_excused[i] and excuse[i] <= now:
                    continue
                if monotone[i]:
                    if not has_reached[i] or reach[i] < time:
                        is_complete = False
                        break
                else:
                    key = place[i, head]
                    if key < first_key[i] or keys[key] != time or row_at[key] < 0:
                        is_complete = False
                        break
            due = now
            if delay >= 0:
                deadline = TIME_MAX if time > TIME_MAX - delay else time + delay
                if not is_complete or deadline < due:
                    due = deadline
            elif not is_complete:
                break
            if has_left and left >= due:
                if left == TIME_MAX:
                    break
                due = left + 1
            if due > limit:
                break
            leaves_at[made], state[made], complete[made] = due, head, is_complete
            for i in range(inputs):
                key = place[i, head]
                while key >= first_key[i] and row_at[key] < 0:
                    key -= 1
                is_none = key < first_key[i] or (exact and keys[key] != time)
                rows[made, i] = -1 if is_none else row_at[key]
            waiting[head] = False
            left, last, has_left = due, time, True
            made += 1
        if event == events:
            break
        if not has_begun or at[event] > now:
            now, has_begun = at[event], True
        if row_of[event] < 0:
            continue
        i, key, own = input_of[event], key_of[event], state_of[event]
        valid = keys[key]
        row_at[key] = row_of[event]
        if not has_reached[i] or reach[i] < valid:
            reach[i], has_reached[i] = valid, True
        if own >= 0 and delay >= 0 and valid <= TIME_MAX - delay and now > valid + delay:
            why[event] = OVER_DELAY
        elif has_left and valid <= last and (own >= 0 or not exact):
            why[event] = AFTER_STATE
        elif own >= 0:
            waiting[own] = True
            head = min(head, own)
    clock[NOW], clock[LEFT], clock[LAST] = now, left, last
    clock[HAS_BEGUN], clock[HAS_LEFT] = has_begun, has_left
    return made


def _signature() -> Any:
    from numba import types

    times, flags = types.int64[::1], types.boolean[::1]
    table = types.Array(types.int64, 2, "C")
    return types.int64(
        *(times, times, times, times, times),
        *(times, flags, times, times, times, table),
        *(flags, times, flags, times, flags),
        *(types.int64, types.int64, types.boolean, times),
        *(times, times, flags, table, times),
    )


simulate = Kernel(_simulate, _signature)


def clock_of(now: int, left: int, last: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """The clock of a simulation; what is before all time has not been."""
    begun, gone = now >= TIME_MIN, left >= TIME_MIN
    known = (now if begun else 0, left if gone else 0, last if gone else 0)
    return np.array([*known, begun, gone], np.int64)
