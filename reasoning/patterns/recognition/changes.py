"""Changes: beside each value of a feature the value before it, of the same objects (SPEC §8).

It is a step between the sources of a pattern and its plans. Behind it ``event(P[?x]:(v1, v2), t)``
of a chronicle is a row with a condition on its value and one on the value before.

"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ....streams.jit import Kernel
from ....streams.time import TIME_MIN
from ..evaluation.store import mix
from ..plans.plan import NO_VALUE, ColumnType
from ..plans.query import Part, Source, column_type
from ..plans.rows import Rows, Values

Integers = NDArray[np.int64]

# An entry of the table: the number of its source plus 1 (0: a free place), its value, its keys.
SOURCE, VALUE, KEYS = range(3)
# A source: the words of a record that have its value and its keys; the word of the values before.
VALUE_WORD, BEFORE_WORD, KEY_COUNT, KEY_WORDS = range(4)
KEPT, UNSTORED, LATE, WATERMARK, HAS_PARTS = range(5)
_CHUNK: Final = 4096
"""Rows taken at a time: there is room for as many new keys."""
_SMALLEST: Final = 64
_NAN: Final = int(np.float64(np.nan).view(np.int64))
# In place of the number of a source: a row without changes, a late row.
_UNCHANGED, _IS_LATE = -1, -2


class Changes:
    """The values before, for the ``sources`` that have changes; rows of others pass unchanged.

    Rows come in order of their ends. A row behind the last one, or behind the watermark, is late:
    it is left out, counted, and the value before of no other row. The first row of some objects
    has no value before.

    Law (tests/laws/reasoning/patterns/test_changes.py): the values before are those of the
    definition, however the rows are cut into batches. Cost: a look-up a row, O(1): some 20 ns in
    batches of 1,000, and 5 µs for a row alone. Memory: an entry of ``2 + objects`` words for each
    combination of objects, 2 to 4 times; at most ``most_keys`` entries. Rows of further objects
    have no value before, and are counted. ``state`` and ``restore`` serve checkpoints.
    """

    def __init__(
        self, sources: Sequence[Source], *, most_keys: int = 10_000_000, capacity: int = _SMALLEST
    ) -> None:
        changing = [each for each in sources if each.has_changes]
        self._numbers = {each.kind: i for i, each in enumerate(changing)}
        self._codes: dict[tuple[str, ...], Integers] = {}
        self._read = _columns(changing, (Part.VALUE, Part.OBJECT))
        self._made = _columns(changing, (Part.BEFORE,))
        self._layout = _layout(changing, list(self._read), list(self._made))
        missing = [_NAN if is_number else NO_VALUE for is_number in self._made.values()]
        self._missing = np.array(missing, np.int64)
        self._most_keys = most_keys
        self._table = np.zeros((capacity, KEYS + self._layout.shape[1] - KEY_WORDS), np.int64)
        self._marks = np.array([0, 0, 0, TIME_MIN, 0], np.int64)

    @property
    def late(self) -> int:
        """The number of late rows."""
        return int(self._marks[LATE])

    @property
    def unstored(self) -> int:
        """The number of rows whose objects exceed the limit."""
        return int(self._marks[UNSTORED])

    @property
    def has_parts(self) -> bool:
        """Whether rows fall into parts, by one of their objects, and come in order within these: no
        row is late then."""
        return bool(self._marks[HAS_PARTS])

    @has_parts.setter
    def has_parts(self, value: bool) -> None:
        self._marks[HAS_PARTS] = value

    @property
    def size(self) -> int:
        """The bytes of the table."""
        return self._table.nbytes

    def push(self, rows: Rows) -> Rows:
        """Return the rows that are not late, with their values before."""
        if len(rows) > _CHUNK:
            parts = [self.push(rows[a : a + _CHUNK]) for a in range(0, len(rows), _CHUNK)]
            return _joined(parts)
        late = self.late
        source, records, made = self._records(rows)
        self._make_room(len(rows))
        _changes.run(
            source,
            rows.end,
            records,
            self._layout,
            self._table,
            made,
            self._marks,
            self._most_keys,
            size=len(rows),
        )
        numbers = made.view(np.float64)
        before: dict[str, Values] = {
            name: (numbers if is_number else made)[:, i]
            for i, (name, is_number) in enumerate(self._made.items())
        }
        found = Rows(rows.kinds, rows.kind, rows.start, rows.end, {**rows.columns, **before})
        return found if self.late == late else _taken(found, source != _IS_LATE)

    def advance(self, watermark: int) -> None:
        """Promise that no row ends before ``watermark`` any more."""
        self._marks[WATERMARK] = max(int(self._marks[WATERMARK]), watermark)

    def state(self) -> tuple[Any, ...]:
        """Everything that `restore` needs; it can be pickled and does not change later."""
        return self._table.copy(), self._marks.copy()

    def restore(self, state: tuple[Any, ...]) -> None:
        """Continue where the operator of the same sources was that gave this state."""
        self._table, self._marks = (each.copy() for each in state)

    def _records(self, rows: Rows) -> tuple[Integers, Integers, Integers]:
        """The number of each row's source, what is read of it, and the values before, missing."""
        codes = self._codes.get(rows.kinds)
        if codes is None:
            numbers = [self._numbers.get(kind, _UNCHANGED) for kind in rows.kinds]
            codes = self._codes[rows.kinds] = np.array(numbers, np.int64)
        records = np.zeros((len(rows), len(self._read)), np.int64)
        floats = records.view(np.float64)
        for i, (name, is_number) in enumerate(self._read.items()):
            values = rows.columns.get(name)
            if values is not None:
                (floats if is_number else records)[:, i] = values
        made = np.empty((len(rows), len(self._made)), np.int64)
        made[:] = self._missing
        return codes[rows.kind], records, made

    def _make_room(self, more: int) -> None:
        """Double the table until half of it is free after ``more`` new entries."""
        wanted = 2 * (int(self._marks[KEPT]) + more)
        if wanted <= len(self._table):
            return
        old = self._table
        self._table = np.zeros((1 << (wanted - 1).bit_length(), old.shape[1]), np.int64)
        entries = old[old[:, SOURCE] > 0]
        # An entry is a record whose words are in the order of the table.
        layout = self._layout.copy()
        layout[:, VALUE_WORD], layout[:, BEFORE_WORD] = VALUE, 0
        layout[:, KEY_WORDS:] = np.arange(KEYS, old.shape[1])
        count = len(entries)
        ends, made = np.zeros(count, np.int64), np.zeros((count, 1), np.int64)
        source, marks = entries[:, SOURCE] - 1, np.array([0, 0, 0, TIME_MIN, 0], np.int64)
        _changes.run(source, ends, entries, layout, self._table, made, marks, count, size=count)


def _columns(sources: Sequence[Source], parts: tuple[Part, ...]) -> dict[str, bool]:
    """The columns of these parts, each once, and whether they are numbers."""
    return {
        each.column: each.kind is not None and column_type(each.kind) is ColumnType.NUMBER
        for source in sources
        for each in source.columns
        if each.part in parts
    }


def _layout(sources: Sequence[Source], read: list[str], made: list[str]) -> Integers:
    keys = [
        [read.index(c.column) for c in each.columns if c.part is Part.OBJECT] for each in sources
    ]
    found = np.zeros((len(sources), KEY_WORDS + max(map(len, keys), default=0)), np.int64)
    for row, source, own in zip(found, sources, keys, strict=True):
        word = {each.part: each.column for each in source.columns}
        row[VALUE_WORD], row[BEFORE_WORD] = (
            read.index(word[Part.VALUE]),
            made.index(word[Part.BEFORE]),
        )
        row[KEY_COUNT] = len(own)
        row[KEY_WORDS : KEY_WORDS + len(own)] = own
    return found


def _taken(rows: Rows, wanted: NDArray[np.bool_]) -> Rows:
    columns = {name: values[wanted] for name, values in rows.columns.items()}
    return Rows(rows.kinds, rows.kind[wanted], rows.start[wanted], rows.end[wanted], columns)


def _joined(parts: Sequence[Rows]) -> Rows:
    columns: dict[str, Values] = {
        name: np.concatenate([each.columns[name] for each in parts]) for name in parts[0].columns
    }
    kind, start, end = (
        np.concatenate([getattr(each, name) for each in parts]) for name in ("kind", "start", "end")
    )
    return Rows(parts[0].kinds, kind, start, end, columns)


def _changes_loop(
    source: Any,
    ends: Any,
    records: Any,
    layout: Any,
    table: Any,
    made: Any,
    marks: Any,
    most: int,
) -> None:
    """Exchange the value of each record for the one that the table has for its source and keys."""
    for i in range(source.shape[0]):
        if marks[HAS_PARTS] == 0 and ends[i] < marks[WATERMARK]:
            marks[LATE] += 1
            source[i] = _IS_LATE
            continue
        marks[WATERMARK] = ends[i]
        if source[i] < 0:
            continue
        own = layout[source[i]]
        count = own[KEY_COUNT]
        mixed = mix(source[i] + 1, 0)
        for k in range(count):
            mixed = mix(mixed, records[i, own[KEY_WORDS + k]])
        place = mixed & (table.shape[0] - 1)
        is_found = False
        while table[place, SOURCE] != 0:
            is_found = table[place, SOURCE] == source[i] + 1
            for k in range(count):
                is_found = is_found and table[place, KEYS + k] == records[i, own[KEY_WORDS + k]]
            if is_found:
                break
            place = (place + 1) & (table.shape[0] - 1)
        if is_found:
            made[i, own[BEFORE_WORD]] = table[place, VALUE]
        elif marks[KEPT] >= most:
            marks[UNSTORED] += 1
            continue
        else:
            marks[KEPT] += 1
            table[place, SOURCE] = source[i] + 1
            for k in range(count):
                table[place, KEYS + k] = records[i, own[KEY_WORDS + k]]
        table[place, VALUE] = records[i, own[VALUE_WORD]]


def _signature() -> Any:
    from numba import types

    row, table = types.int64[::1], types.int64[:, ::1]
    ends = types.Array(types.int64, 1, "A", readonly=True)
    return types.void(row, ends, table, table, table, table, row, types.int64)


_changes = Kernel(_changes_loop, _signature, allocates=False, calls=(mix,))
