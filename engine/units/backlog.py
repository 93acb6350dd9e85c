"""The backlog: units that have windows to close or parts of large batches to take.

A command makes windows due; `Backlog.work` closes them later, a little at a time, so a request does
not wait for the windows of another request's query. Meanwhile a unit defers what its inputs bring,
in order. Its output stream is therefore the same as without a backlog, only later.

How many windows one call of `work` closes depends on the machine; the results must not. So `work`
returns what it did, the journal records that, and `replay` does the same again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from typing import Protocol

import msgspec


class TurnRecord(msgspec.Struct, frozen=True, array_like=True, omit_defaults=True):
    """What ``unit`` did in its turn: it closed ``windows`` windows, then took ``parts`` parts of
    batches. The journal contains such records.

    ``stopped``: why the last window has no result, where that depended on the machine; with no
    windows, why the unit was cut off.
    """

    unit: str
    windows: int
    stopped: str = ""
    parts: int = 0


class Overwhelmed(Exception):
    """A unit cannot keep up with its input and is cut off."""


class Task(Protocol):
    """Closes windows of one unit."""

    @property
    def spent(self) -> float:
        """Seconds of work by now."""

    @property
    def is_ready(self) -> bool:
        """Whether it can go on now, rather than work without the turn."""

    def stop_early(self) -> None:
        """Begin no further window."""

    def run(self, *, to_end: bool = False) -> bool:
        """Work until the time is over or no window is due; return whether no window is half done.
        Raises what closing a window raises.

        ``to_end``: work until the present window has closed, whatever the time, and begin no other.
        """


class Turns(Protocol):
    """The time that the caller of `Backlog.work` grants.

    ``limit``: seconds of work after which a unit that has not caught up is cut off.
    """

    limit: float

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""

    def start(self, close_next: Callable[[], int], emitting: float = 0.0) -> Task:
        """Make a task that closes windows until none is due. ``close_next`` returns how many it has
        closed. To emit the results of each takes ``emitting`` further seconds of the same time."""

    def time(self, work: Callable[[], None]) -> float:
        """Do ``work`` and return the seconds that it took."""


class Backlogged(Protocol):
    """A unit that may be in the backlog (`WindowUnit`)."""

    @property
    def name(self) -> str:
        """Its name in the configuration."""

    @property
    def is_ready(self) -> bool:
        """Whether it can go on now."""

    @property
    def is_mid_window(self) -> bool:
        """Whether a window is half done, or its results are not emitted."""

    def work(self, turns: Turns, *, begins: bool = True) -> list[TurnRecord]:
        """Close windows and take parts of batches while there is time; return what was done."""

    def finish_window(self) -> None:
        """Close the window that is half done."""

    def replay(self, turn: Sequence[TurnRecord]) -> None:
        """Do what one call of `work` did."""


class Backlog:
    """The units of an engine that have work to do, in the order of their turns.

    Without ``turns`` windows close at once, and the backlog stays empty.
    """

    def __init__(self, turns: Turns | None = None) -> None:
        self.turns = turns
        self._units: list[Backlogged] = []
        self._new: list[Backlogged] = []
        """Those that have had no turn yet."""

    def __bool__(self) -> bool:
        return bool(self._units)

    @property
    def units(self) -> Sequence[Backlogged]:
        """The units, in the order of their turns."""
        return tuple(self._units)

    @property
    def is_waiting(self) -> bool:
        """Whether all units work without the turn."""
        return all(not unit.is_ready for unit in self._units)

    @property
    def is_mid_window(self) -> bool:
        """Whether a window is half done, or its results are not emitted."""
        return any(unit.is_mid_window for unit in self._units)

    @property
    def has_new(self) -> bool:
        """Whether there are units that have had no turn yet."""
        return bool(self._new)

    def add(self, unit: Backlogged) -> None:
        """Add ``unit``, which has work to do; without effect if it is there."""
        if unit not in self._units:
            self._units.append(unit)
            # The command that made this work due gives the unit a turn before its answer.
            self._new.append(unit)

    def discard(self, unit: Backlogged) -> None:
        """Remove ``unit``, which has caught up or stopped."""
        for units in (self._units, self._new):
            if unit in units:
                units.remove(unit)

    def work(self, *, new: bool = False, begins: bool = True) -> list[TurnRecord]:
        """Give each unit a turn while there is time; return what they did.

        ``new``: only units that have had no turn yet, since most are done with one. Not ``begins``:
        only windows that are half done.
        """
        assert self.turns is not None
        done: list[TurnRecord] = []
        for unit in tuple(self._new) if new else self.units:
            # A unit that works without the turn needs none, and would only use up the time.
            if (begins or unit.is_mid_window) and unit.is_ready:
                done += unit.work(self.turns, begins=begins)
                self._rotate(unit)
            # Without ``begins`` a command waits for all half-done windows, whatever their time.
            if begins and self.turns.is_over:
                break
        return done

    def finish_windows(self) -> None:
        """Close the windows that are half done, however long that takes. Their units emit and
        record the results in their next turns."""
        for unit in self.units:
            unit.finish_window()

    def replay(self, done: Iterable[TurnRecord]) -> None:
        """Do what `work` did. Raises ``ValueError`` where there is no such work to do."""
        for name, turn in groupby(done, lambda each: each.unit):
            unit = next((one for one in self._units if one.name == name), None)
            if unit is None:
                raise ValueError(f"{name} is not in the backlog")
            unit.replay(tuple(turn))
            self._rotate(unit)

    def _rotate(self, unit: Backlogged) -> None:
        """Put ``unit`` behind the others after its turn, if it has more to do."""
        if unit in self._new:
            self._new.remove(unit)
        if unit in self._units:
            self._units.remove(unit)
            self._units.append(unit)
