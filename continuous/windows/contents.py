"""The contents of a query's windows: the buffered rows, and when an evaluation is due."""

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
from .count_buffer import CountBuffer
from .grid import Grid, InputWindow, Schedule
from .panes import Panes
from .row_buffer import RowBuffer


@dataclass(frozen=True, slots=True)
class DueEvaluation:
    """An evaluation at ``end``. ``moved`` is the counting window that triggers it (None on a grid),
    ``number`` the number of the triple that moved the window."""

    end: int
    moved: int | None = None
    number: int = 0


class Contents:
    """The rows of each input that an open window needs.

    Time windows over one input share a `RowBuffer`; a counting window has its own `CountBuffer`. If
    only a `PatternSolver` reads the rows (`attach_patterns`), it alone stores them. Law: see there.
    """

    def __init__(
        self, schedule: Schedule, dictionary: TermDictionary, entailment: StreamEntailment
    ) -> None:
        self.schedule = schedule
        self._entailment = entailment
        self.buffers = {one.input: RowBuffer(dictionary) for one in schedule.windows}
        self._counting: dict[int, CountBuffer] = {}
        self._numbers: dict[int, int] = {}
        self._panes: dict[int, Panes] = {}
        for i, one in enumerate(schedule.windows):
            if isinstance(one.window, CountWindow):
                self._counting[i] = CountBuffer(one.window, dictionary)
                self._numbers[i] = 0
            elif one.grid is not None:
                self._panes[i] = Panes(Grid(schedule.pane, one.grid.origin), one.low)
        self._ranges: NDArray[np.int64] | None = None
        """The length of each window, if all end at each evaluation and none is a landmark."""
        ranges = [one.range for one in schedule.windows if one.grid == schedule.ends]
        if len(ranges) == len(schedule.windows) and None not in ranges:
            self._ranges = np.array(ranges, np.int64)
        self._patterns: PatternSolver | None = None
        self.keeps = True
        """Whether the buffers here store the rows; else only the `PatternSolver` does."""
        self._cached_next: tuple[int | None, DueEvaluation | None] | None = None
        """The argument and result of the last `next`, until rows or counts change."""

    def attach_patterns(self, patterns: PatternSolver, *, alone: bool) -> None:
        """Pass the rows to ``patterns`` too; ``alone``: it is the only reader."""
        self._patterns = patterns
        self.keeps = not alone

    def push(
        self, input: str, rows: TripleRows, after: int | None, *, entailed: bool = False
    ) -> int:
        """Store the rows of ``input`` with τ > ``after`` (None: all); return the number of late
        rows with triples. ``entailed``: the schema implies the rows, so counting windows ignore
        them.

        Cost: one pass over τ if it ascends, which is the usual case; else a few.
        """
        size, in_order = len(rows), ascending(rows.time)
        if after is not None:
            rows = _rows_after(rows, after, in_order)
        # A row without objects states a sort only, so no triple of the stream is lost.
        late = size - len(rows) if rows.objects else 0
        if not len(rows):
            return late
        times = rows.time
        ends = (times[0], times[-1]) if in_order else (times.min(), times.max())
        least, greatest = map(int, ends)
        self._cached_next = None
        stores = False
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
            stores = self.keeps
        if stores:
            self.buffers[input].push(rows, ascending=in_order)
        return late

    def push_at_once(self, input: str, tables: Sequence[TripleRows], after: int | None) -> bool:
        """Push all tables in one call, which is faster than a `push` of each. Return False, and do
        nothing, unless no row is late, no object is null and the `PatternSolver` alone stores
        rows."""
        if self.keeps or self._patterns is None:
            return False
        for table in tables:
            for column in table.objects.values():
                if column.null is not None:
                    return False
        tables = [table for table in tables if len(table) and _has_triples(table)]
        if not tables:
            return True
        times = [table.time for table in tables]
        moments = times[0] if len(times) == 1 else np.concatenate(times)
        least, greatest = int(moments.min()), int(moments.max())
        # Late rows are found and counted table by table.
        if after is not None and least <= after:
            return False
        self._cached_next = None
        for i, one in enumerate(self.schedule.windows):
            if one.input == input:
                self._panes[i].push(moments, least, greatest)
                self._patterns.rows.push(i, tables)
        return True

    def settle(self, watermark: int) -> None:
        """Count the triples with τ < ``watermark``, which are complete."""
        if self._counting:
            self._cached_next = None
        for counting in self._counting.values():
            counting.settle(watermark)

    def limit(self, input: str, last_end: int) -> int | None:
        """Return the τ up to which rows of ``input`` belong to past evaluations only."""
        ends = [one.bounds(last_end)[1] for one in self.schedule.windows if one.input == input]
        # A row that some closed window lacks is late, even if another one could still have it.
        return max(ends, default=None)

    # -- when an evaluation is due ---------------------------------------------------------

    def next(self, last_end: int | None) -> DueEvaluation | None:
        """Return the next evaluation that has content. A gap without rows costs no steps.

        Landmark and counting windows trigger an evaluation when their content changes; time windows
        do at each of their ends while they have content.
        """
        cached = self._cached_next
        if cached is None or cached[0] != last_end or last_end is None:
            cached = self._cached_next = last_end, self._next(last_end)
        return cached[1]

    def ends_from(
        self, first: int, greatest: int, most: int, *, leaves: bool = False, follows: bool = False
    ) -> list[int]:
        """Return the evaluations from ``first`` to ``greatest`` that have content, at most ``most``
        of them; if ``leaves``, also those without content that follow one with content.
        ``follows``: the evaluation before ``first`` had content. Contract: the schedule is
        `uniform`, and ``first`` is the next evaluation.

        Cost: O(panes and evaluations), without a call of numpy.
        """
        grid, length = self.schedule.ends, self.schedule.windows[0].range
        assert grid is not None
        assert length is not None
        last = min(greatest, first + grid.step * most)
        panes: set[int] = set()
        for one in self._panes.values():
            panes.update(one.between(first - length, last))
        ends: list[int] = []
        end = first
        for pane in sorted(panes):
            begin = grid.ceil(pane)
            if begin > end:
                # The first window without content has losses for a stream operator.
                if leaves and follows and len(ends) < most:
                    ends.append(end)
                end, follows = begin, False
            while end <= greatest and end - length < pane and len(ends) < most:
                ends.append(end)
                end, follows = end + grid.step, True
        if leaves and follows and end <= greatest and len(ends) < most:
            ends.append(end)
        return ends

    def has_content(self, end: int) -> bool:
        """Whether the windows at ``end``, on the grid, contain rows."""
        return self.compare(DueEvaluation(end), None)[0]

    def _next(self, last_end: int | None) -> DueEvaluation | None:
        if self.schedule.ends is None:
            return self._next_move()
        found: int | None = None
        for i, one in enumerate(self.schedule.windows):
            end = self._next_count(i, one) if one.counted else self._next_time(i, one, last_end)
            if end is not None:
                end = end if last_end is None else max(end, self.schedule.after(last_end))
                found = end if found is None else min(found, end)
        return None if found is None else DueEvaluation(found)

    def _next_time(self, i: int, one: InputWindow, last_end: int | None) -> int | None:
        panes = self._panes[i]
        previous_high = -TIME_MAX
        if last_end is not None:
            previous_high = one.bounds(last_end)[1]
            following = self.schedule.after(last_end)
            last = panes.last_until(previous_high)
            # Rows of the last window are still in the next one, which needs no new row to be due.
            if not one.lasts and last is not None and last > one.bounds(following)[0]:
                return following
        pane = panes.first_after(previous_high)
        while pane is not None:
            end = self.schedule.first_end(one, pane)
            low = one.bounds(end)[0]
            if pane > low:
                return end
            # RANGE is less than STEP, and the pane is between two windows: no window has it.
            pane = panes.first_after(low)
        return None

    def _next_count(self, i: int, one: InputWindow) -> int | None:
        move = self._counting[i].next_move(self._numbers[i])
        return None if move is None else self.schedule.first_end(one, move[0])

    def _next_move(self) -> DueEvaluation | None:
        """Return the next move of a counting window, by τ, then by window number."""
        moves = []
        for i, counting in self._counting.items():
            move = counting.next_move(self._numbers[i])
            if move is not None:
                moves.append((move[0], i, move[1]))
        if not moves:
            return None
        time, i, number = min(moves)
        return DueEvaluation(time, i, number)

    def compare(self, due: DueEvaluation, last_end: int | None) -> tuple[bool, bool]:
        """Return whether there is content at ``due``, and whether it differs from the content at
        ``last_end``."""
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
            previous_high = low if last_end is None else max(low, one.bounds(last_end)[1])
            entered = last is not None and last > previous_high
            content |= entered or (not one.lasts and last is not None and last > low)
            changed |= entered
            if last_end is not None and not one.lasts:
                before = one.bounds(last_end)
                # Only a pane of the earlier content can have left it.
                left = panes.last_until(min(low, before[1]))
                changed |= left is not None and left > before[0]
        return content, changed

    # -- what is in the windows ------------------------------------------------------------

    def select(self, due: DueEvaluation) -> None:
        """Move the windows to their bounds at ``due``."""
        self._cached_next = None
        if due.moved is not None:
            self._numbers[due.moved] = due.number
        else:
            for i, counting in self._counting.items():
                self._numbers[i] = counting.number_at(due.end)
        if self._patterns is not None:
            self._patterns.select(*self._bounds(due.end))

    def _bounds(self, end: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the lows and the highs of all windows."""
        if self._ranges is not None:
            return end - self._ranges, np.full(len(self._ranges), end, np.int64)
        lows, highs = zip(*(one.bounds(end) for one in self.schedule.windows), strict=True)
        return np.array(lows, np.int64), np.array(highs, np.int64)

    def tables(self, end: int) -> Mapping[str, list[TripleRows]]:
        """Return the rows in the windows at ``end``, by graph, input by input."""
        if not self.keeps and self._patterns is not None:
            return self._patterns.rows.tables(*self._bounds(end))
        found: dict[str, list[TripleRows]] = {}
        for i, one in enumerate(self.schedule.windows):
            tables = found.setdefault(one.graph, [])
            if one.counted:
                counted = self._counting[i].content(self._numbers[i])
                tables.extend((*counted, *self._entailment.of(counted)))
            else:
                tables.extend(self.buffers[one.input].between(*one.bounds(end)))
        return found

    def _is_full(self) -> bool:
        """Whether a search for droppable rows is worth its cost."""
        crowded = any(len(panes) > 64 for panes in self._panes.values())
        return crowded or (self._patterns is not None and self._patterns.rows.is_full)

    def drop(self, end: int, *, raw: bool) -> None:
        """Drop the rows that no evaluation after ``end`` needs. ``raw``: evaluations read the rows
        of a window again; else rows up to ``end`` have been folded and go too."""
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
            # A lasting window is due by new rows only, so it needs no pane that it has seen.
            self._panes[i].drop(min(low, high) if not one.lasts else high)
            lows[one.input] = min(low, lows.get(one.input, low))
            highs[one.input] = min(high, highs.get(one.input, high))
        if self._patterns is not None:
            self._patterns.drop()
        if self.keeps:
            for input, low in lows.items():
                high = highs[input]
                if low > -TIME_MAX:
                    self.buffers[input].drop(min(low, high) if raw else high, high)
                else:
                    # A landmark window drops no row; merged chunks keep its reads cheap.
                    self.buffers[input].settle(high)


def _has_triples(table: TripleRows) -> bool:
    return bool(table.objects) or table.sort is not None


def _rows_after(rows: TripleRows, after: int, in_order: bool) -> TripleRows:
    """Return the rows with τ > ``after``."""
    if in_order:
        if rows.time[0] > after:
            return rows
        first = int(rows.time.searchsorted(after, "right"))
        return rows.take(slice(first, None))
    kept = rows.time > after
    return rows if kept.all() else rows.take(kept)
