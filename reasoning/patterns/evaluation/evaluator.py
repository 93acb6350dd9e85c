"""What the evaluations of a plan have in common: rows in, matches out, waiting, limits (SPEC §8).

A subclass takes a batch of records row by row (`Evaluator._take`) and writes each match as a record
of integers, whose first words are the places of its rows in the table.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....streams.time import TIME_MAX, TIME_MIN, format_duration
from ..plans.limits import Counters, Limits
from ..plans.network import Network
from ..plans.plan import NO_VALUE, ColumnType, PatternPlan
from ..plans.printer import print_network, print_plan
from ..plans.row_values import Row
from ..plans.rows import Matches, Rows, concatenated
from .conditions import COLUMNS, END, NUMBER, START
from .packing import PackedRows, kind_codes
from .store import (
    CROWDED,
    CUT_SHORT,
    DECIDED,
    IS_FULL,
    IS_OUT_FULL,
    LATE,
    LOOKED_AT,
    MADE,
    OUT,
    ROWS,
    SMALLEST,
    UNSTORED,
    WATERMARK,
    Store,
)
from .waiting import Waiting

Integers = NDArray[np.int64]
_CHUNK: Final = 2048
"""Rows taken at a time: then what the watermark has passed is dropped."""
_OUT: Final = 1 << 16
"""Matches made at a time, unless one row makes more."""


class Evaluator(ABC):
    """The matches of a plan in order of decision.

    Law: what comes out does not depend on how the rows are cut into batches. When a row arrives,
    first come the matches that waited until then, by their time of decision; then those that it
    completes. Those of one row or time are in order of their rows, element by element, by (end,
    arrival).

    Memory: `Store`, `Waiting`. ``state`` and ``restore`` serve checkpoints; pickle does, too.
    """

    def __init__(
        self,
        plan: PatternPlan,
        network: Network,
        packed: PackedRows,
        width: int,
        limits: Limits,
        capacity: int,
        rows_given: int | None = None,
        part_word: int = 0,
    ) -> None:
        self.plan = plan
        self._network = network
        self._limits = limits
        self._width = width
        self._rows_given = len(plan.elements) if rows_given is None else rows_given
        self._columns = packed.columns
        self._record_width = packed.width
        self._known = {kind: i for i, kind in enumerate(plan.kinds())}
        self._codes: dict[tuple[str, ...], Integers] = {}
        self._is_number = [plan.type_of(name) is ColumnType.NUMBER for name in packed.columns]
        self._store = Store(packed, capacity, limits.rows, part_word)
        self._waiting = Waiting(width)
        self._out = np.zeros((capacity, width), np.int64)
        self._due = np.zeros(capacity, np.int64)
        self._rows = self._unawaited = 0
        self._next_try = TIME_MIN
        self._nothing: Matches | None = None

    @property
    def _most_matches(self) -> int:
        most = self._limits.matches
        return most if self.plan.max_matches is None else min(self.plan.max_matches, most)

    # -- rows and time -----------------------------------------------------------------------

    def push(self, rows: Rows) -> Matches:
        """Take rows and return what they decide."""
        if len(rows) <= _CHUNK:
            return self._taken(rows)
        starts = range(0, len(rows), _CHUNK)
        return concatenated([self._taken(rows[a : a + _CHUNK]) for a in starts])

    def advance(self, watermark: int) -> Matches:
        """Promise that no row ends before ``watermark`` any more; return what that decides."""
        marks = self._store.marks
        marks[WATERMARK] = max(int(marks[WATERMARK]), watermark)
        return self._decided()

    def end(self) -> Matches:
        """Promise that no row comes any more; return what that decides."""
        return self.advance(TIME_MAX)

    def next_due(self) -> int | None:
        """The watermark at which the next match that waits is decided, or None."""
        return self._waiting.next_due

    # -- state -------------------------------------------------------------------------------

    @property
    def counters(self) -> Counters:
        """What the evaluation has done, and what it has left out."""
        marks = self._store.marks
        return Counters(
            self._rows,
            candidates=int(marks[LOOKED_AT]),
            matches=int(marks[MADE]),
            late=int(marks[LATE]),
            unstored=int(marks[UNSTORED]),
            crowded=int(marks[CROWDED]),
            cut_short=int(marks[CUT_SHORT]),
            unawaited=self._unawaited,
            unstarted=0,
            rounded=0,
        )

    @property
    def watermark(self) -> int:
        """The time (ns) before which no row comes any more."""
        return int(self._store.marks[WATERMARK])

    @property
    def pending(self) -> int:
        """The number of matches that wait."""
        return len(self._waiting)

    @property
    def kept(self) -> int:
        """The number of rows in the table, of which some may be of no use any more."""
        return int(self._store.marks[ROWS])

    @property
    def size(self) -> int:
        """The bytes of rows and candidates."""
        return self._store.size

    def state(self) -> tuple[Any, ...]:
        """Everything that `restore` needs; it can be pickled and does not change later."""
        self._compact()
        waiting = self._waiting.rows.copy(), self._waiting.dues.copy()
        return self._store.state(), waiting, self._rows, self._unawaited

    def restore(self, state: tuple[Any, ...]) -> None:
        """Continue where the evaluator of the same plan was that gave this state."""
        store, (rows, due), self._rows, self._unawaited = state
        self._store.restore(store)
        self._waiting = Waiting(self._width)
        self._waiting.add(rows, due)

    def explain(self) -> str:
        """Return the plan, its network and how it is evaluated as text."""
        lines = [print_plan(self.plan), print_network(self._network), self._way()]
        if self.plan.probes:
            longest = self._network.longest_wait
            lines.append(
                f"a match waits at most {format_duration(longest)} for its probes"
                if longest > 0
                else "no match waits for its probes"
            )
        return "\n".join(lines)

    def _rows_in(self, buffer: int, part: int) -> list[Row]:
        """The rows in a buffer that may still be joined; with parts, those of ``part``."""
        return [self._row(place) for place in self._store.places(buffer, part)]

    def _row(self, place: int) -> Row:
        record = self._store.table[place]
        floats = record.view(np.float64)
        values: dict[str, int | float | None] = {}
        for i, (name, is_number) in enumerate(
            zip(self._columns, self._is_number, strict=True), COLUMNS
        ):
            value = float(floats[i]) if is_number else int(record[i])
            values[name] = None if value == NO_VALUE or value != value else value
        return Row(int(record[NUMBER]), int(record[START]), int(record[END]), values)

    # -- what the evaluations differ in ------------------------------------------------------

    @abstractmethod
    def _take(self, batch: Integers, kind: Integers, begin: int) -> int:
        """Take records from ``begin`` on; return the one before which an array was full."""

    @abstractmethod
    def _ends(self, records: Integers) -> Integers:
        """The latest end in each match."""

    @abstractmethod
    def _last(self, records: Integers) -> Integers:
        """The place of the row of each match that came last."""

    @abstractmethod
    def _order(self, records: Integers) -> Integers | None:
        """The order of matches: by the row that completes each, then by their rows. None: they
        are in order."""

    @abstractmethod
    def _ask(self, records: Integers, hold: NDArray[np.bool_]) -> None:
        """Ask all probes of matches whose probes can be answered."""

    @abstractmethod
    def _outputs(self, records: Integers) -> dict[str, NDArray[Any]]:
        """The plan's outputs for matches."""

    @abstractmethod
    def _way(self) -> str:
        """How the plan is evaluated, as text."""

    def _compact_store(self, made: Integers) -> None:
        """Drop what is of no use any more, and make room; ``made`` are matches not given out."""
        self._store.compact(self._waiting.rows, made)

    # -- the way of a batch ------------------------------------------------------------------

    def _taken(self, rows: Rows) -> Matches:
        batch, kind = self._records(rows)
        self._rows += len(rows)
        if len(rows) > SMALLEST:
            # Otherwise large batches are compacted again and again.
            self._store.capacity = max(self._store.capacity, 2 * len(rows))
        if self._store.marks[IS_FULL] and self._store.marks[WATERMARK] >= self._next_try:
            self._compact()
        marks = self._store.marks
        parts = []
        done = 0
        while (reached := self._take(batch, kind, done)) < len(rows):
            done = reached
            if not marks[IS_OUT_FULL]:
                self._compact()
                continue
            if marks[OUT] and len(self._out) >= _OUT:
                parts.append(self._decided())
                continue
            out, due = self._out, self._due
            self._out = np.concatenate([out, np.zeros_like(out)])
            self._due = np.concatenate([due, np.zeros_like(due)])
        parts.append(self._decided())
        return concatenated(parts)

    def _records(self, rows: Rows) -> tuple[Integers, Integers]:
        """The rows as records, and the numbers of their sources in the plan."""
        codes = self._codes.get(rows.kinds)
        if codes is None:
            codes = self._codes[rows.kinds] = kind_codes(rows.kinds, self._known)
        count = len(rows)
        batch = np.empty((count, self._record_width), np.int64)
        batch[:, END] = rows.end
        batch[:, START] = rows.start if self.plan.has_intervals else rows.end
        batch[:, NUMBER] = np.arange(self._rows, self._rows + count)
        numbers = batch.view(np.float64)
        for i, (name, is_number) in enumerate(zip(self._columns, self._is_number, strict=True)):
            values = rows.columns.get(name)
            if is_number:
                numbers[:, COLUMNS + i] = np.nan if values is None else values
            else:
                batch[:, COLUMNS + i] = NO_VALUE if values is None else values
        return batch, codes[rows.kind]

    def _compact(self) -> None:
        """Drop what is of no use any more, and make room."""
        self._compact_store(self._out[: int(self._store.marks[OUT])])
        self._next_try = int(self._store.marks[WATERMARK]) + self._network.span // 8

    def _decided(self) -> Matches:
        """The matches made since the last call that are decided, and those that waited until the
        watermark."""
        store = self._store
        marks = store.marks
        records, due = self._out[: int(marks[OUT])], self._due[: int(marks[OUT])]
        marks[OUT] = 0
        if not self._pass_time() and not len(records):
            if self._nothing is None:
                self._nothing = self._matches(records, due)
            return self._nothing
        decided = self._ends(records)
        if self.plan.probes and len(records):
            is_open = due > decided
            self._wait(records[is_open], due[is_open])
            records, decided = records[~is_open], decided[~is_open]
        if len(records) > 1 and (order := self._order(records)) is not None:
            records, decided = records[order], decided[order]
        late_records, late_due = self._answered()
        if len(late_due):
            decided = np.concatenate([late_due, decided])
            order = np.argsort(decided, kind="stable")
            records, decided = np.concatenate([late_records, records])[order], decided[order]
        return self._matches(records, decided)

    def _matches(self, records: Integers, decided: Integers) -> Matches:
        outputs = self._outputs(records)
        numbers = self._store.table[: int(self._store.marks[ROWS]), NUMBER]
        if len(numbers) < len(records):
            # Neighbours in memory are read faster, again and again.
            numbers = numbers.copy()
        rows = numbers[records[:, : self._rows_given]]
        return Matches(rows, decided.copy(), outputs, numbers[self._last(records)])

    def _wait(self, records: Integers, due: Integers) -> None:
        room = max(0, self._limits.waiting - len(self._waiting))
        self._unawaited += max(0, len(due) - room)
        if room and len(due):
            self._waiting.add(records[:room], due[:room])

    def _pass_time(self) -> bool:
        """Decide matches up to the watermark from now on. Return whether one that waits may be
        due."""
        marks, due = self._store.marks, self._waiting.next_due
        marks[DECIDED] = marks[WATERMARK]
        return due is not None and due <= int(marks[WATERMARK])

    def _take_due(self) -> tuple[Integers, Integers]:
        """Remove the matches that waited until the watermark."""
        return self._waiting.take(int(self._store.marks[WATERMARK]))

    def _answered(self) -> tuple[Integers, Integers]:
        """The matches that waited until the watermark and whose probes hold."""
        records, due = self._take_due()
        if not len(due):
            return records, due
        records = np.ascontiguousarray(records)
        hold = np.empty(len(due), np.bool_)
        self._ask(records, hold)
        return records[hold], due[hold]
