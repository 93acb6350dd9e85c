"""What is in the windows of a query: who keeps the rows, and when an evaluation is due."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..rdf.timed import TripleRows
from ..streams.time import TIME_MAX
from .counting_intake import CountingIntake
from .intake import Intake
from .patterns import PatternSolver
from .windows import InputWindow, Schedule


@dataclass(frozen=True, slots=True)
class Due:
    """An evaluation at ``end``; ``moved`` is the counting window that brings it about (None on a
    grid), ``number`` the triple with which it moved on."""

    end: int
    moved: int | None = None
    number: int = 0


class Contents:
    """The rows of each input that some window still needs.

    Windows of time over one input share an `Intake`; a window that counts has its own
    `CountingIntake`. Law: as theirs.
    """

    def __init__(self, schedule: Schedule) -> None:
        self.schedule = schedule
        self.intakes: dict[str, Intake] = {}
        self._counting: dict[int, CountingIntake] = {}
        self._numbers: dict[int, int] = {}
        self.patterns: PatternSolver | None = None
        """Who reads the rows as numbers too."""
        for i, one in enumerate(schedule.windows):
            if one.counted:
                self._counting[i] = CountingIntake(one.window)  # type: ignore[arg-type]
                self._numbers[i] = 0
            # One that counts still needs to know the times of what came, for its lateness.
            self.intakes.setdefault(one.input, Intake())

    def push(self, input: str, rows: TripleRows, after: int | None) -> int:
        """Keep the rows of ``input`` with τ > ``after`` (None: all); returns how many were late."""
        if after is not None and len(rows):
            kept = rows.time > after
            late = len(rows) - int(kept.sum())
            if late:
                rows = rows.take(kept)
        else:
            late = 0
        for i, one in enumerate(self.schedule.windows):
            if one.input != input or not len(rows):
                continue
            if one.counted:
                self._counting[i].push(rows)
            elif self.patterns is not None:
                self.patterns.rows.push(i, rows)
        if any(not one.counted and one.input == input for one in self.schedule.windows):
            self.intakes[input].push(rows, None)
        return late

    def settle(self, watermark: int) -> None:
        """Nothing comes with τ < ``watermark`` any more."""
        for counting in self._counting.values():
            counting.settle(watermark)

    def limit(self, input: str, closed: int) -> int | None:
        """Rows of ``input`` up to here belong to evaluations that are past."""
        ends = [one.bounds(closed)[1] for one in self.schedule.windows if one.input == input]
        return max(ends, default=None)

    def next(self, closed: int | None) -> Due | None:
        """The next evaluation that has content to see: found without stepping through a gap.

        Content that lasts (of landmark and counting windows) brings about an evaluation when it
        changes; that of windows of time at each end while it is there.
        """
        if self.schedule.ends is None:
            return self._next_move()
        found: int | None = None
        for i, one in enumerate(self.schedule.windows):
            end = self._next_count(i, one) if one.counted else self._next_time(one, closed)
            if end is not None:
                end = end if closed is None else max(end, self.schedule.after(closed))
                found = end if found is None else min(found, end)
        return None if found is None else Due(found)

    def _next_time(self, one: InputWindow, closed: int | None) -> int | None:
        intake = self.intakes[one.input]
        seen = one.low
        if closed is not None:
            seen = max(seen, one.bounds(closed)[1])
            following = self.schedule.after(closed)
            latest = intake.latest(seen)
            if not one.lasts and latest is not None and latest > one.bounds(following)[0]:
                return following
        time = intake.earliest(seen)
        return None if time is None else self.schedule.first_end(one, time)

    def _next_count(self, i: int, one: InputWindow) -> int | None:
        move = next(self._counting[i].next_moves(self._numbers[i]), None)
        return None if move is None else self.schedule.first_end(one, move[0])

    def _next_move(self) -> Due | None:
        """Windows that count move on in order of τ, then of the windows."""
        moves = []
        for i, counting in self._counting.items():
            move = next(counting.next_moves(self._numbers[i]), None)
            if move is not None:
                moves.append((move[0], i, move[1]))
        if not moves:
            return None
        time, i, number = min(moves)
        return Due(time, i, number)

    def changed(self, due: Due, closed: int | None) -> tuple[bool, bool]:
        """Whether there is content at ``due``, and whether it is other than at ``closed``."""
        content = changed = due.moved is not None
        for i, one in enumerate(self.schedule.windows):
            if one.counted:
                number = self._numbers[i]
                moved = due.moved is None and self._counting[i].number_at(due.end) > number
                content |= moved
                changed |= moved
                continue
            intake, (low, high) = self.intakes[one.input], one.bounds(due.end)
            latest = intake.latest(high)
            seen = one.low if closed is None else one.bounds(closed)[1]
            entered = latest is not None and latest > max(seen, low)
            content |= entered or (not one.lasts and latest is not None and latest > low)
            changed |= entered
            if closed is not None and not one.lasts:
                left = intake.latest(low)
                changed |= left is not None and left > one.bounds(closed)[0]
        return content, changed

    def move(self, due: Due) -> None:
        """The windows that count stand where they stand at ``due``."""
        if due.moved is not None:
            self._numbers[due.moved] = due.number
            return
        for i, counting in self._counting.items():
            self._numbers[i] = counting.number_at(due.end)

    def tables(self, end: int) -> Mapping[str, list[TripleRows]]:
        """The rows in the windows at ``end``, by graph, input by input."""
        found: dict[str, list[TripleRows]] = {}
        for i, one in enumerate(self.schedule.windows):
            tables = found.setdefault(one.graph, [])
            if one.counted:
                tables.extend(self._counting[i].content(self._numbers[i]))
            else:
                tables.extend(self.intakes[one.input].between(*one.bounds(end)))
        return found

    def turn(self, end: int) -> None:
        """Let `patterns` solve the windows at ``end``."""
        if self.patterns is not None:
            bounds = np.array([one.bounds(end) for one in self.schedule.windows], np.int64)
            lows, highs = np.ascontiguousarray(bounds[:, 0]), np.ascontiguousarray(bounds[:, 1])
            self.patterns.turn(lows, highs)

    def drop(self, end: int, *, raw: bool) -> None:
        """Forget what no evaluation after ``end`` needs; ``raw``: windows are read again, else what
        was in one has been folded already."""
        for i, counting in self._counting.items():
            counting.forget(self._numbers[i])
        if self.patterns is not None:
            after = self.schedule.after(end)
            lows = [min(one.bounds(after)[0], one.bounds(end)[1]) for one in self.schedule.windows]
            self.patterns.rows.drop(np.array(lows, np.int64))
        for input, intake in self.intakes.items():
            lows, highs = [], []
            for one in self.schedule.windows:
                if one.input == input and not one.counted:
                    lows.append(one.bounds(self.schedule.after(end))[0])
                    highs.append(one.bounds(end)[1])
            if lows:
                low, high = min(lows), min(highs)
                if low > -TIME_MAX:
                    intake.drop(min(low, high) if raw else high, high)
                else:
                    intake.settle(high)
