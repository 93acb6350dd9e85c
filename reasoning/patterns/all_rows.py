"""Every match of a plan without repetition: chronicles, EP-SPARQL, and any match of SASE+
(SPEC §8).

The join (`join_loop`) finds a match from its last row. A match whose probes later rows may still
change waits (`waiting`) until the watermark has passed the last of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...streams.time import TIME_MAX, TIME_MIN, format_duration
from .conditions import COLUMNS, END, NUMBER, START
from .join_loop import ask, join, scratch
from .network import minimal_network
from .outputs import output_columns
from .packing import OF, kind_codes, pack
from .plan import NO_VALUE, ColumnType, PatternPlan
from .printer import print_network, print_plan
from .row_values import Row
from .rows import Matches, Rows, concatenated
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


@dataclass(frozen=True, slots=True)
class Limits:
    """How much an evaluation may keep. What exceeds a limit is left out and counted (`Counters`).

    ``rows`` kept; ``candidates``: rows kept for one element and key; ``matches`` that one row
    completes; ``waiting`` matches.
    """

    rows: int = 10_000_000
    candidates: int = 1_000_000
    matches: int = 1_000_000
    waiting: int = 1_000_000


@dataclass(frozen=True, slots=True)
class Counters:
    """What an evaluation has done. The last five are losses.

    ``rows`` taken, ``candidates`` looked at, ``matches`` made, before their last probes;
    ``late`` rows, behind the watermark; ``unstored`` rows beyond the limit of rows, ``crowded``
    ones beyond that of candidates; ``cut_short``: rows that complete more matches than the limit;
    ``unawaited`` matches, beyond the limit of those that wait.
    """

    rows: int
    candidates: int
    matches: int
    late: int
    unstored: int
    crowded: int
    cut_short: int
    unawaited: int


class AllRows:
    """Every match of a plan, in order of decision.

    ``is_ordered``: rows come in order of their ends, and a row behind the last one is late.
    Otherwise only a row behind the watermark that `advance` was given is late; such plans have no
    probes.

    Law (tests/laws/reasoning/test_pattern_joins.py): the matches are those of the definition, each
    once, however the rows are cut into batches. They come in the order in which they are decided:
    when a row arrives, first those that waited until then, by their time of decision; then those
    that it completes. Those of one row or time are in order of their rows, element by element, by
    (end, arrival).

    Cost: O(log) a look-up, and O(1) for each row looked at and match; the plan decides how many.
    Memory: `Store`, `Waiting`. ``state`` and ``restore`` serve checkpoints; pickle does, too.

    Raises `PlanError`.
    """

    def __init__(
        self,
        plan: PatternPlan,
        *,
        is_ordered: bool = True,
        limits: Limits = Limits(),
        capacity: int = SMALLEST,
    ) -> None:
        self.plan = plan
        self._network = minimal_network(plan)
        self._packed = packed = pack(plan, self._network, is_ordered=is_ordered)
        self._is_ordered = is_ordered
        self._limits = limits
        self._known = {kind: i for i, kind in enumerate(plan.kinds())}
        self._codes: dict[tuple[str, ...], Integers] = {}
        self._is_number = [plan.type_of(name) is ColumnType.NUMBER for name in packed.columns]
        count = len(plan.elements)
        most = limits.matches if plan.max_matches is None else min(plan.max_matches, limits.matches)
        distinct, intervals = int(plan.is_distinct), int(plan.has_intervals)
        settings = [count, intervals, distinct, int(is_ordered), most, limits.candidates]
        self._settings = np.array(settings, np.int64)
        self._store = Store(packed, capacity, limits.rows)
        self._waiting = Waiting(count)
        self._out = np.zeros((capacity, count), np.int64)
        self._due = np.zeros(capacity, np.int64)
        self._scratch = scratch(packed.buffers)
        self._rows = self._unawaited = 0
        self._next_try = TIME_MIN

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

    def rows(self) -> list[list[Row]]:
        """The rows in memory that suit each element, then each probe; of the element that always
        comes last there are none."""
        plan, store = self.plan, self._store
        buffers = self._packed.buffers[:, OF].tolist()
        found = []
        for of in range(len(plan.elements) + len(plan.probes)):
            places = store.places(buffers.index(of)) if of in buffers else ()
            found.append([self._row(place) for place in places])
        return found

    def _row(self, place: int) -> Row:
        record = self._store.table[place]
        floats = record.view(np.float64)
        values: dict[str, int | float | None] = {}
        for i, (name, is_number) in enumerate(
            zip(self._packed.columns, self._is_number, strict=True), COLUMNS
        ):
            value = float(floats[i]) if is_number else int(record[i])
            values[name] = None if value == NO_VALUE or value != value else value
        return Row(int(record[NUMBER]), int(record[START]), int(record[END]), values)

    def state(self) -> tuple[Any, ...]:
        """Everything that `restore` needs; it can be pickled and does not change later."""
        self._compact()
        store = self._store
        arrays = store.table, store.ends, store.rows, store.vectors, store.heads, store.marks
        waiting = self._waiting.rows.copy(), self._waiting.dues.copy()
        return tuple(each.copy() for each in arrays), waiting, self._rows, self._unawaited

    def restore(self, state: tuple[Any, ...]) -> None:
        """Continue where the evaluator of the same plan was that gave this state."""
        arrays, (rows, due), self._rows, self._unawaited = state
        store = self._store
        store.table, store.ends, store.rows, store.vectors, store.heads, store.marks = (
            each.copy() for each in arrays
        )
        self._waiting = Waiting(len(self.plan.elements))
        self._waiting.add(rows, due)

    def explain(self) -> str:
        """Return the plan, its network and how it is evaluated as text."""
        lines = [
            print_plan(self.plan),
            print_network(self._network),
            "evaluated by a join from the last row"
            + ("" if self._is_ordered else ", in any order of arrival"),
        ]
        if self.plan.probes:
            longest = self._network.longest_wait
            lines.append(
                f"a match waits at most {format_duration(longest)} for its probes"
                if longest > 0
                else "no match waits for its probes"
            )
        return "\n".join(lines)

    # -- the way of a batch ------------------------------------------------------------------

    def _taken(self, rows: Rows) -> Matches:
        batch, kind = self._records(rows)
        self._rows += len(rows)
        if self._store.marks[IS_FULL] and self._store.marks[WATERMARK] >= self._next_try:
            self._compact()
        marks = self._store.marks
        parts = []
        done = 0
        while (reached := self._join(batch, kind, done)) < len(rows):
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
        batch = np.empty((count, self._packed.width), np.int64)
        batch[:, END] = rows.end
        batch[:, START] = rows.start if self.plan.has_intervals else rows.end
        batch[:, NUMBER] = np.arange(self._rows, self._rows + count)
        numbers = batch.view(np.float64)
        for i, (name, is_number) in enumerate(
            zip(self._packed.columns, self._is_number, strict=True)
        ):
            values = rows.columns.get(name)
            if is_number:
                numbers[:, COLUMNS + i] = np.nan if values is None else values
            else:
                batch[:, COLUMNS + i] = NO_VALUE if values is None else values
        return batch, codes[rows.kind]

    def _join(self, batch: Integers, kind: Integers, begin: int) -> int:
        packed, store = self._packed, self._store
        conditions = packed.conditions
        return join(
            batch,
            kind,
            begin,
            self._settings,
            packed.kinds,
            packed.own,
            packed.triggers,
            packed.levels,
            packed.greatest,
            packed.buffers,
            packed.probes,
            packed.hulls,
            conditions.conditions,
            conditions.factors,
            conditions.code,
            conditions.constants,
            store.table,
            store.table.view(np.float64),
            store.ends,
            store.rows,
            store.vectors,
            store.heads,
            store.marks,
            self._out,
            self._due,
            *self._scratch,
        )

    def _compact(self) -> None:
        """Drop what is of no use any more, and make room."""
        made = self._out[: int(self._store.marks[OUT])]
        self._store.compact(self._waiting.rows, made)
        self._next_try = int(self._store.marks[WATERMARK]) + self._network.span // 8

    def _decided(self) -> Matches:
        """The matches made since the last call that are decided, and those that waited until the
        watermark."""
        store = self._store
        marks = store.marks
        rows, due = self._out[: int(marks[OUT])], self._due[: int(marks[OUT])]
        watermark = int(marks[WATERMARK])
        marks[OUT], marks[DECIDED] = 0, watermark
        decided = self._ends(rows)
        if self.plan.probes and len(rows):
            is_open = due > decided
            self._wait(rows[is_open], due[is_open])
            rows, decided = rows[~is_open], decided[~is_open]
        if len(rows) > 1 and not self._packed.is_sorted:
            order = self._order(rows)
            rows, decided = rows[order], decided[order]
        late_rows, late_due = self._answered(watermark)
        if len(late_due):
            decided = np.concatenate([late_due, decided])
            order = np.argsort(decided, kind="stable")
            rows, decided = np.concatenate([late_rows, rows])[order], decided[order]
        outputs = output_columns(self.plan, self._packed.columns, store.table, rows)
        numbers = store.table[: int(marks[ROWS]), NUMBER].copy()
        return Matches(numbers.take(rows), decided, outputs)

    def _ends(self, rows: Integers) -> Integers:
        """The latest end in each match."""
        ends = self._store.table[:, END]
        if len(self._packed.triggers) == 1 and self._is_ordered:
            return ends[rows[:, self._packed.triggers[0]]]
        found = ends[rows[:, 0]]
        for element in range(1, rows.shape[1]):
            np.maximum(found, ends[rows[:, element]], out=found)
        return found

    def _wait(self, rows: Integers, due: Integers) -> None:
        room = max(0, self._limits.waiting - len(self._waiting))
        self._unawaited += max(0, len(due) - room)
        if room and len(due):
            self._waiting.add(rows[:room], due[:room])

    def _answered(self, watermark: int) -> tuple[Integers, Integers]:
        """The matches that waited until the watermark and whose probes hold."""
        rows, due = self._waiting.take(watermark)
        if not len(due):
            return rows, due
        rows = np.ascontiguousarray(rows)
        packed, store = self._packed, self._store
        conditions = packed.conditions
        hold = np.empty(len(due), np.bool_)
        ask(
            rows,
            packed.buffers,
            packed.probes,
            conditions.conditions,
            conditions.factors,
            conditions.code,
            conditions.constants,
            store.table,
            store.table.view(np.float64),
            store.ends,
            store.rows,
            store.vectors,
            store.heads,
            hold,
            *self._scratch,
        )
        return rows[hold], due[hold]

    def _order(self, rows: Integers) -> Integers:
        """The order of matches: by the row that completes each, then by the rows of each element in
        order of (end, arrival)."""
        keys: list[Integers] = []
        for element in reversed(range(rows.shape[1])):
            keys.append(rows[:, element])
            if not self._is_ordered:
                keys.append(self._store.table[rows[:, element], END])
        # Rows arrive in the order of their places in the table.
        return np.lexsort([*keys, rows.max(axis=1)])
