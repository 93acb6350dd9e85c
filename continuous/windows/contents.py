"""What is in the windows of a query: who keeps the rows, and when an evaluation is due."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...languages.csparql.ast import CountWindow
from ...rdf.dictionary import TermDictionary
from ...rdf.timed import TripleRows
from ...streams.time import TIME_MAX
from ..columns.fold_kernels import ascending
from ..operators.entailment import StreamEntailment
from ..pattern_join.solver import PatternSolver
from .count_buffer import CountingIntake
from .grid import Grid, InputWindow, Schedule
from .panes import Panes
from .row_buffer import Intake


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
    `CountingIntake`. Where ``patterns`` alone read the rows (`read_by`), they alone keep them.
    Law: as theirs.
    """

    def __init__(
        self, schedule: Schedule, dictionary: TermDictionary, entailment: StreamEntailment
    ) -> None:
        self.schedule = schedule
        self._entailment = entailment
        self.intakes = {one.input: Intake(dictionary) for one in schedule.windows}
        self._counting: dict[int, CountingIntake] = {}
        self._numbers: dict[int, int] = {}
        self._panes: dict[int, Panes] = {}
        for i, one in enumerate(schedule.windows):
            if isinstance(one.window, CountWindow):
                self._counting[i] = CountingIntake(one.window, dictionary)
                self._numbers[i] = 0
            elif one.grid is not None:
                self._panes[i] = Panes(Grid(schedule.pane, one.grid.origin), one.low)
        self._ranges: NDArray[np.int64] | None = None
        """How long each window is, where all end at each evaluation and nothing lasts."""
        ranges = [one.range for one in schedule.windows if one.grid == schedule.ends]
        if len(ranges) == len(schedule.windows) and None not in ranges:
            self._ranges = np.array(ranges, np.int64)
        self._patterns: PatternSolver | None = None
        self.keeps = True
        """Whether rows are kept here, or ``patterns`` alone have them."""
        self._known_next: tuple[int | None, Due | None] | None = None
        """The answer of `next`, until something comes or is counted."""

    def read_by(self, patterns: PatternSolver, *, alone: bool) -> None:
        """Have ``patterns`` read the rows too; ``alone``: nobody else does."""
        self._patterns = patterns
        self.keeps = not alone

    def push(
        self, input: str, rows: TripleRows, after: int | None, *, entailed: bool = False
    ) -> int:
        """Keep the rows of ``input`` with τ > ``after`` (None: all); returns how many triples were
        late. ``entailed``: they follow from others, so that windows do not count them.

        Cost: one pass over τ where it ascends, as it mostly does; else a few.
        """
        come, in_order = len(rows), ascending(rows.time)
        if after is not None:
            rows = _behind(rows, after, in_order)
        late = come - len(rows) if rows.objects else 0
        if not len(rows):
            return late
        times = rows.time
        ends = (times[0], times[-1]) if in_order else (times.min(), times.max())
        least, greatest = map(int, ends)
        self._known_next = None
        wanted = False
        for i, one in enumerate(self.schedule.windows):
            if one.input != input:
                continue
            if one.counted:
                if rows.objects and not entailed:
                    self._counting[i].push(rows)
                continue
            self._panes[i].push(times, least, greatest)
            if self._patterns is not None:
                self._patterns.rows.push(i, [rows])
            wanted = self.keeps
        if wanted:
            self.intakes[input].push(rows, ascending=in_order)
        return late

    def push_plain(self, input: str, tables: Sequence[TripleRows], after: int | None) -> bool:
        """The same as `push` of each table, at once, where nothing is late, no triple is missing
        and ``patterns`` alone keep the rows; False, and nothing done, where it is not so plain."""
        if self.keeps or self._patterns is None:
            return False
        for table in tables:
            for column in table.objects.values():
                if column.null is not None:
                    return False
        tables = [table for table in tables if len(table) and _says_something(table)]
        if not tables:
            return True
        times = [table.time for table in tables]
        moments = times[0] if len(times) == 1 else np.concatenate(times)
        least, greatest = int(moments.min()), int(moments.max())
        if after is not None and least <= after:
            return False
        self._known_next = None
        for i, one in enumerate(self.schedule.windows):
            if one.input == input:
                self._panes[i].push(moments, least, greatest)
                self._patterns.rows.push(i, tables)
        return True

    def settle(self, watermark: int) -> None:
        """Nothing comes with τ < ``watermark`` any more."""
        if self._counting:
            self._known_next = None
        for counting in self._counting.values():
            counting.settle(watermark)

    def limit(self, input: str, closed: int) -> int | None:
        """Rows of ``input`` up to here belong to evaluations that are past."""
        ends = [one.bounds(closed)[1] for one in self.schedule.windows if one.input == input]
        return max(ends, default=None)

    # -- when an evaluation is due ---------------------------------------------------------

    def next(self, closed: int | None) -> Due | None:
        """The next evaluation that has content to see: found without stepping through a gap.

        Content that lasts (of landmark and counting windows) brings about an evaluation when it
        changes; that of windows of time at each end while it is there.
        """
        known = self._known_next
        if known is None or known[0] != closed or closed is None:
            known = self._known_next = closed, self._next(closed)
        return known[1]

    def _next(self, closed: int | None) -> Due | None:
        if self.schedule.ends is None:
            return self._next_move()
        found: int | None = None
        for i, one in enumerate(self.schedule.windows):
            end = self._next_count(i, one) if one.counted else self._next_time(i, one, closed)
            if end is not None:
                end = end if closed is None else max(end, self.schedule.after(closed))
                found = end if found is None else min(found, end)
        return None if found is None else Due(found)

    def _next_time(self, i: int, one: InputWindow, closed: int | None) -> int | None:
        panes = self._panes[i]
        seen = -TIME_MAX
        if closed is not None:
            seen = one.bounds(closed)[1]
            following = self.schedule.after(closed)
            last = panes.last_until(seen)
            if not one.lasts and last is not None and last > one.bounds(following)[0]:
                return following
        pane = panes.first_after(seen)
        while pane is not None:
            end = self.schedule.first_end(one, pane)
            low = one.bounds(end)[0]
            if pane > low:
                return end
            # Between two windows, where RANGE is less than STEP: nobody sees it.
            pane = panes.first_after(low)
        return None

    def _next_count(self, i: int, one: InputWindow) -> int | None:
        move = self._counting[i].next_move(self._numbers[i])
        return None if move is None else self.schedule.first_end(one, move[0])

    def _next_move(self) -> Due | None:
        """Windows that count move on in order of τ, then of the windows."""
        moves = []
        for i, counting in self._counting.items():
            move = counting.next_move(self._numbers[i])
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
            panes, (low, high) = self._panes[i], one.bounds(due.end)
            last = panes.last_until(high)
            seen = low if closed is None else max(low, one.bounds(closed)[1])
            entered = last is not None and last > seen
            content |= entered or (not one.lasts and last is not None and last > low)
            changed |= entered
            if closed is not None and not one.lasts:
                before = one.bounds(closed)
                left = panes.last_until(min(low, before[1]))
                changed |= left is not None and left > before[0]
        return content, changed

    # -- what is in the windows ------------------------------------------------------------

    def turn(self, due: Due) -> None:
        """The windows stand where they stand at ``due``."""
        self._known_next = None
        if due.moved is not None:
            self._numbers[due.moved] = due.number
        else:
            for i, counting in self._counting.items():
                self._numbers[i] = counting.number_at(due.end)
        if self._patterns is not None:
            self._patterns.turn(*self._bounds(due.end))

    def _bounds(self, end: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Lows and highs, by window."""
        if self._ranges is not None:
            return end - self._ranges, np.full(len(self._ranges), end, np.int64)
        lows, highs = zip(*(one.bounds(end) for one in self.schedule.windows), strict=True)
        return np.array(lows, np.int64), np.array(highs, np.int64)

    def tables(self, end: int) -> Mapping[str, list[TripleRows]]:
        """The rows in the windows at ``end``, by graph, input by input."""
        if not self.keeps and self._patterns is not None:
            return self._patterns.rows.tables(*self._bounds(end))
        found: dict[str, list[TripleRows]] = {}
        for i, one in enumerate(self.schedule.windows):
            tables = found.setdefault(one.graph, [])
            if one.counted:
                counted = self._counting[i].content(self._numbers[i])
                tables.extend((*counted, *self._entailment.of(counted)))
            else:
                tables.extend(self.intakes[one.input].between(*one.bounds(end)))
        return found

    def _is_full(self) -> bool:
        """Whether it is worth while to look for what can be forgotten."""
        crowded = any(len(panes) > 64 for panes in self._panes.values())
        return crowded or (self._patterns is not None and self._patterns.rows.is_full)

    def drop(self, end: int, *, raw: bool) -> None:
        """Forget what no evaluation after ``end`` needs; ``raw``: windows are read again, else what
        was in one has been folded already."""
        if not self.keeps and not self._counting and not self._is_full():
            return
        following = self.schedule.after(end)
        lows: dict[str, int] = {}
        highs: dict[str, int] = {}
        for i, one in enumerate(self.schedule.windows):
            if one.counted:
                self._counting[i].forget(self._numbers[i])
                continue
            low, high = one.bounds(following)[0], one.bounds(end)[1]
            self._panes[i].drop(min(low, high) if not one.lasts else high)
            lows[one.input] = min(low, lows.get(one.input, low))
            highs[one.input] = min(high, highs.get(one.input, high))
        if self._patterns is not None:
            self._patterns.drop()
        if self.keeps:
            for input, low in lows.items():
                high = highs[input]
                if low > -TIME_MAX:
                    self.intakes[input].drop(min(low, high) if raw else high, high)
                else:
                    self.intakes[input].settle(high)


def _says_something(table: TripleRows) -> bool:
    return bool(table.objects) or table.sort is not None


def _behind(rows: TripleRows, after: int, in_order: bool) -> TripleRows:
    """The rows with τ > ``after``."""
    if in_order:
        first = int(np.searchsorted(rows.time, after, "right"))
        return rows.take(slice(first, None)) if first else rows
    kept = rows.time > after
    return rows if kept.all() else rows.take(kept)
