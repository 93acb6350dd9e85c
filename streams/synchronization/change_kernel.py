"""The simulation of `ChangeStates` as a compiled loop, for many samples at once.

Same events, same order, same states (tests/laws/streams/test_joining.py); what `ChangeStates` keeps
in lists stands in arrays that are laid out beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

import numpy as np

from ..jit import Kernel
from ..joins.join import distinct
from ..policies.policy import Duration
from ..sample import Mask, SampleBatch, Times
from ..time import TIME_MAX, TIME_MIN

_BLOCK: Final = 512
"""So many keys or times in a row have one count, which tells whether to look at them at all."""
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
    last in ``row_at`` (-1: none yet); ``place[i, m]`` is the greatest key of input i that is not
    after the time. Written: ``waiting``, ``row_at``, ``reach``, ``clock``,
    for each state ``leaves_at``, ``state`` (an index into ``times``), ``complete`` and ``rows``,
    shape ``(m, inputs)``, and for each event ``why`` it was late (0: it was not).

    Cost: a few steps an event, a state and an input; O(√m) where many keys between have not come.
    """
    events = at.shape[0]
    inputs = monotone.shape[0]
    count = times.shape[0]
    now, left, last = clock[NOW], clock[LEFT], clock[LAST]
    has_begun, has_left = clock[HAS_BEGUN] > 0, clock[HAS_LEFT] > 0
    made = 0
    head = 0
    waiting_in = np.zeros(count // _BLOCK + 1, np.int64)
    for own in range(count):
        waiting_in[own // _BLOCK] += waiting[own]
    come_in = np.zeros(keys.shape[0] // _BLOCK + 1, np.int64)
    for key in range(keys.shape[0]):
        come_in[key // _BLOCK] += row_at[key] >= 0
    for event in range(events + 1):
        limit = until
        is_due = True
        if event < events:
            # What leaves does so by the moment before.
            is_due = has_begun and at[event] > now
            limit = at[event] - 1 if is_due else until
        while is_due:
            while head < count and not waiting[head]:
                if head % _BLOCK == 0 and waiting_in[head // _BLOCK] == 0:
                    head += _BLOCK
                else:
                    head += 1
            if head >= count:
                head = count
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
            due = TIME_MAX if time > TIME_MAX - delay else time + delay
            if is_complete and now < due:
                due = now
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
                    if key % _BLOCK == _BLOCK - 1 and come_in[key // _BLOCK] == 0:
                        key -= _BLOCK
                    else:
                        key -= 1
                is_none = key < first_key[i] or (exact and keys[key] != time)
                rows[made, i] = -1 if is_none else row_at[key]
            waiting[head] = False
            waiting_in[head // _BLOCK] -= 1
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
        come_in[key // _BLOCK] += row_at[key] < 0
        row_at[key] = row_of[event]
        if not has_reached[i] or reach[i] < valid:
            reach[i], has_reached[i] = valid, True
        if own >= 0 and valid <= TIME_MAX - delay and now > valid + delay:
            why[event] = OVER_DELAY
        elif has_left and valid <= last and (own >= 0 or not exact):
            why[event] = AFTER_STATE
        elif own >= 0:
            waiting_in[own // _BLOCK] += not waiting[own]
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

Events: TypeAlias = tuple[Times, Times, Times, Times]
"""When, of which input, which row and valid at what time."""


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The events and what they speak of, as `_simulate` explains its arguments."""

    at: Times
    input_of: Times
    row_of: Times
    key_of: Times
    state_of: Times
    times: Times
    waiting: Mask
    keys: Times
    row_at: Times
    first_key: Times
    place: Times

    @property
    def arrays(self) -> tuple[Times | Mask, ...]:
        """In the order of the arguments."""
        events = (self.at, self.input_of, self.row_of, self.key_of, self.state_of)
        tables = (self.keys, self.row_at, self.first_key, self.place)
        return (*events, self.times, self.waiting, *tables)


def lay_out(
    tables: Sequence[SampleBatch],
    fresh: Sequence[int],
    events: Events,
    duration: Duration,
    waiting: Sequence[int],
) -> Layout:
    """``tables`` are the samples of each input, of which those from row ``fresh[i]`` on are yet to
    come, by ``events``; ``waiting`` are times of states. Cost: O(n log n) numpy."""
    at, input_of, row_of, valid = events
    within = (valid >= duration.first) & (valid <= duration.last) & (row_of >= 0)
    before = np.array(waiting, np.int64)
    times = distinct(np.concatenate([before, valid[within]]))
    key_of = np.zeros(len(at), np.int64)
    place = np.empty((len(tables), len(times)), np.int64)
    keys: list[Times] = []
    rows: list[Times] = []
    first_key = [0]
    for i, (table, count) in enumerate(zip(tables, fresh, strict=True)):
        own = distinct(table.valid)
        row_at = np.full(len(own), -1, np.int64)
        row_at[np.searchsorted(own, table.valid[:count])] = np.arange(count)
        mine = input_of == i
        key_of[mine] = np.searchsorted(own, valid[mine]) + first_key[i]
        place[i] = np.searchsorted(own, times, "right") - 1 + first_key[i]
        keys.append(own)
        rows.append(row_at)
        first_key.append(first_key[i] + len(own))
    return Layout(
        *(at, input_of, row_of, key_of),
        np.where(within, np.searchsorted(times, valid), -1),
        times,
        np.isin(times, before),
        np.concatenate(keys),
        np.concatenate(rows),
        np.array(first_key[:-1], np.int64),
        place,
    )


def clock_of(now: int, left: int, last: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """The clock of a simulation; what is before all time has not been."""
    begun, gone = now >= TIME_MIN, left >= TIME_MIN
    known = (now if begun else 0, left if gone else 0, last if gone else 0)
    return np.array([*known, begun, gone], np.int64)
