"""Changes: beside each value of a feature the value before it, of the same objects (SPEC §8).

It is a step between the sources of a pattern and its plans. Behind it ``event(P[?x]:(v1, v2), t)``
of a chronicle is a row with a condition on its value and one on the value before.

numba's cache knows this file only: after a change of ``store.mix``, change the time of this file,
too (``touch``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...streams.jit import JIT, Kernel
from ...streams.time import TIME_MIN
from .plan import NO_VALUE
from .query import Part, Source
from .rows import Rows, Values
from .store import mix

Integers = NDArray[np.int64]

# An entry of the table: the number of its source plus 1 (0: a free place), its value, its keys.
SOURCE, VALUE, KEYS = range(3)
KEPT, UNSTORED = range(2)
_CHUNK: Final = 4096
"""Rows taken at a time: there is room for as many new keys."""
_SMALLEST: Final = 64


class Changes:
    """The values before, for the ``sources`` that have changes; rows of others pass unchanged.

    Rows come in order of their ends. A row behind the last one, or behind the watermark, is late:
    it is left out, counted, and the value before of no other row. The first row of some objects
    has no value before.

    Law (tests/laws/reasoning/test_changes.py): the values before are those of the definition,
    however the rows are cut into batches. Cost: a look-up a row, O(1). Memory: an entry of
    ``2 + objects`` words for each combination of objects, 2 to 4 times; at most ``most_keys``
    entries. Rows of further objects have no value before, and are counted.
    """

    def __init__(
        self, sources: Sequence[Source], *, most_keys: int = 10_000_000, capacity: int = _SMALLEST
    ) -> None:
        self._sources = [each for each in sources if each.has_changes]
        self._numbers = {each.kind: i for i, each in enumerate(self._sources)}
        self._keys = [_columns(each, Part.OBJECT) for each in self._sources]
        self._values = [_columns(each, Part.VALUE)[0] for each in self._sources]
        self._before = [_columns(each, Part.BEFORE)[0] for each in self._sources]
        self._most_keys = most_keys
        width = max(map(len, self._keys), default=0)
        self._table = np.zeros((capacity, KEYS + width), np.int64)
        self._marks = np.zeros(2, np.int64)
        self._watermark = TIME_MIN
        self.late = 0
        """The number of late rows."""

    @property
    def unstored(self) -> int:
        """The number of rows whose objects exceed the limit."""
        return int(self._marks[UNSTORED])

    @property
    def size(self) -> int:
        """The bytes of the table."""
        return self._table.nbytes

    def push(self, rows: Rows) -> Rows:
        """Return the rows that are not late, with their values before."""
        if not len(rows):
            return rows
        reached = np.maximum.accumulate(rows.end)
        is_late = rows.end < np.maximum(np.append(TIME_MIN, reached[:-1]), self._watermark)
        self._watermark = max(self._watermark, int(reached[-1]))
        late = int(np.count_nonzero(is_late))
        if late:
            self.late += late
            rows = _taken(rows, ~is_late)
        return self._with_values_before(rows)

    def advance(self, watermark: int) -> None:
        """Promise that no row ends before ``watermark`` any more."""
        self._watermark = max(self._watermark, watermark)

    def state(self) -> tuple[Any, ...]:
        """Everything that `restore` needs; it can be pickled and does not change later."""
        return self._table.copy(), self._marks.copy(), self._watermark, self.late

    def restore(self, state: tuple[Any, ...]) -> None:
        """Continue where the operator of the same sources was that gave this state."""
        table, marks, self._watermark, self.late = state
        self._table, self._marks = table.copy(), marks.copy()

    def _with_values_before(self, rows: Rows) -> Rows:
        numbers = np.array([self._numbers.get(kind, -1) for kind in rows.kinds], np.int64)
        source = numbers[rows.kind]
        count = len(rows)
        records = np.zeros((count, self._table.shape[1]), np.int64)
        records[:, SOURCE] = source + 1
        of_source = [np.flatnonzero(source == i) for i in range(len(self._sources))]
        for own, keys, value in zip(of_source, self._keys, self._values, strict=True):
            for column, name in enumerate((value, *keys), start=VALUE):
                if len(own):
                    records[own, column] = rows.columns[name][own].view(np.int64)
        is_known = np.zeros(count, np.int64)
        for begin in range(0, count, _CHUNK):
            part = slice(begin, begin + _CHUNK)
            self._make_room(min(_CHUNK, count - begin))
            _run(_changes, records[part], self._table, is_known[part], self._marks, self._most_keys)
        before: dict[str, Values] = {}
        for own, value, name in zip(of_source, self._values, self._before, strict=True):
            if not len(own):
                continue
            dtype: Any = rows.columns[value].dtype
            missing = np.nan if dtype == np.float64 else NO_VALUE
            # Sources may share a column of values before.
            filled = before.setdefault(name, np.full(count, missing, dtype))
            filled[own] = np.where(is_known[own] == 1, records[own, VALUE].view(dtype), missing)
        return Rows(rows.kinds, rows.kind, rows.start, rows.end, {**rows.columns, **before})

    def _make_room(self, more: int) -> None:
        """Double the table until half of it is free after ``more`` new entries."""
        wanted = 2 * (int(self._marks[KEPT]) + more)
        if wanted <= len(self._table):
            return
        old = self._table
        self._table = np.zeros((1 << (wanted - 1).bit_length(), old.shape[1]), np.int64)
        entries = old[old[:, SOURCE] > 0]
        marks = np.zeros(2, np.int64)
        _run(_changes, entries, self._table, np.zeros(len(entries), np.int64), marks, len(entries))


def _columns(source: Source, part: Part) -> tuple[str, ...]:
    return tuple(each.column for each in source.columns if each.part is part)


def _taken(rows: Rows, wanted: NDArray[np.bool_]) -> Rows:
    columns = {name: values[wanted] for name, values in rows.columns.items()}
    return Rows(rows.kinds, rows.kind[wanted], rows.start[wanted], rows.end[wanted], columns)


def _changes_loop(records: Any, table: Any, is_known: Any, marks: Any, most: int) -> None:
    """Exchange the value of each record for the one that the table has for its source and keys."""
    width = table.shape[1]
    for i in range(records.shape[0]):
        if records[i, SOURCE] == 0:
            continue
        mixed = mix(records[i, SOURCE], 0)
        for k in range(KEYS, width):
            mixed = mix(mixed, records[i, k])
        place = mixed & (table.shape[0] - 1)
        is_found = False
        while table[place, SOURCE] != 0:
            is_found = table[place, SOURCE] == records[i, SOURCE]
            for k in range(KEYS, width):
                is_found = is_found and table[place, k] == records[i, k]
            if is_found:
                break
            place = (place + 1) & (table.shape[0] - 1)
        if is_found:
            before = table[place, VALUE]
            table[place, VALUE] = records[i, VALUE]
            records[i, VALUE] = before
            is_known[i] = 1
        elif marks[KEPT] >= most:
            marks[UNSTORED] += 1
        else:
            marks[KEPT] += 1
            for k in range(width):
                table[place, k] = records[i, k]


def _signature() -> Any:
    from numba import types
    from numba.extending import register_jitable

    register_jitable(mix)
    row, table = types.int64[::1], types.int64[:, ::1]
    return types.void(table, table, row, row, types.int64)


def _run(kernel: Kernel, *arguments: Any) -> None:
    (kernel if JIT else kernel.py_func)(*arguments)


_changes = Kernel(_changes_loop, _signature, allocates=False)
