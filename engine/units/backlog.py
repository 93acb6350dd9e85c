"""Units whose windows or batches take long: they fall behind, and catch up a little at a time.

A query's windows are closed by `Behind.go_on`, not by who publishes, and so are large batches
taken: so whoever runs the engine can do other things in between, and nobody waits for a query that
is none of theirs. A unit that is behind puts by what its inputs say, in order, so that its stream
says what it would say had it never been behind, only later.

What a window takes may depend on the machine; what comes of it must not. So `go_on` tells what it
did, and `again` does that once more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import groupby
from typing import Protocol

import msgspec


class Went(msgspec.Struct, frozen=True, array_like=True, omit_defaults=True):
    """So many windows of ``unit`` closed, and then so many parts of batches were taken.
    ``stopped``: why the last window has no result, where that depended on the machine; with no
    windows, why the unit was cut off."""

    unit: str
    windows: int
    stopped: str = ""
    parts: int = 0


class Overwhelmed(Exception):
    """A unit cannot keep up with what comes, and is cut off."""


class Task(Protocol):
    """Windows of one unit that are being closed."""

    @property
    def spent(self) -> float:
        """Seconds of work that it took so far."""

    @property
    def is_ready(self) -> bool:
        """Whether it can go on now; else it does something apart, or waits for it."""

    def end(self) -> None:
        """Begin no further window."""

    def go_on(self, *, to_end: bool = False) -> bool:
        """Work until the time is over, or the windows are; whether no window is half done. Raises
        what they do.

        ``to_end``: until the present window has closed, however long that takes; then no other is
        begun.
        """


class Turns(Protocol):
    """Whoever has the time: it says how much there is for closing windows, and how.

    ``most``: a unit that has worked for so many seconds and is still behind is cut off.
    """

    most: float

    @property
    def is_over(self) -> bool:
        """Whether the time is over."""

    def begin(self, close_next: Callable[[], bool], telling: float = 0.0) -> Task:
        """Close windows until there are no more. What each of them gives is told afterwards, which
        takes ``telling`` seconds of the same time."""

    def timed(self, what: Callable[[], None]) -> float:
        """Do ``what``; gives the seconds that it took."""


class Backlogged(Protocol):
    """A unit that may be behind (`WindowUnit`)."""

    @property
    def name(self) -> str:
        """Its name in the configuration."""

    @property
    def is_ready(self) -> bool:
        """Whether it can go on now; else it waits for something that is done apart."""

    @property
    def is_within(self) -> bool:
        """Whether a window is half done, or what it gave is not told."""

    def go_on(self, turns: Turns, *, begins: bool = True) -> list[Went]:
        """Close windows, and take batches, while there is time; gives what was done."""

    def finish_window(self) -> None:
        """Close the window that is half done."""

    def again(self, turn: Sequence[Went]) -> None:
        """Do what one turn did."""


class Behind:
    """The units of an engine that are behind, in the order of their turns.

    ``turns`` None: windows close at once, and nobody is ever behind.
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
        """Those that are behind."""
        return tuple(self._units)

    @property
    def is_waiting(self) -> bool:
        """Whether all of them wait for something that is done apart."""
        return all(not unit.is_ready for unit in self._units)

    @property
    def is_within(self) -> bool:
        """Whether a window is half done, or what it gave is not told."""
        return any(unit.is_within for unit in self._units)

    @property
    def has_new(self) -> bool:
        """Whether there are units that have had no turn yet."""
        return bool(self._new)

    def fell(self, unit: Backlogged) -> None:
        """``unit`` has windows to close, or parts of a batch to take."""
        if unit not in self._units:
            self._units.append(unit)
            self._new.append(unit)

    def left(self, unit: Backlogged) -> None:
        """``unit`` has caught up, or is no more."""
        for units in (self._units, self._new):
            if unit in units:
                units.remove(unit)

    def go_on(self, *, new: bool = False, begins: bool = True) -> list[Went]:
        """Close windows, and take batches, for as long as there is time; gives what was done.

        ``new``: only of units that have had no turn yet: most are done with one. Not ``begins``:
        only those that are half done.
        """
        assert self.turns is not None
        done: list[Went] = []
        for unit in tuple(self._new) if new else self.units:
            if (begins or unit.is_within) and unit.is_ready:
                done += unit.go_on(self.turns, begins=begins)
                self._had_its_turn(unit)
            if begins and self.turns.is_over:
                break
        return done

    def finish(self) -> None:
        """Close the windows that are half done, however long that takes. What they give is told,
        and counts as done, when it is the turn of their units."""
        for unit in self.units:
            unit.finish_window()

    def again(self, done: Iterable[Went]) -> None:
        """Do what `go_on` did. Raises ``ValueError`` where there is no such thing to do."""
        for name, turn in groupby(done, lambda each: each.unit):
            unit = next((one for one in self._units if one.name == name), None)
            if unit is None:
                raise ValueError(f"{name} is not behind")
            unit.again(tuple(turn))
            self._had_its_turn(unit)

    def _had_its_turn(self, unit: Backlogged) -> None:
        """Its next one comes after those of the others."""
        if unit in self._new:
            self._new.remove(unit)
        if unit in self._units:
            self._units.remove(unit)
            self._units.append(unit)
