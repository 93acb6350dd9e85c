"""The triples of windows that patterns can match, as rows of numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.namespaces import RDF_TYPE
from ...rdf.timed import Kind, TripleRows
from ..columns.relation import TermValues, bits, decode
from .plan_cut import Slot
from .row_kernels import (
    COUNT,
    DERIVED,
    DONE,
    FIRST_PENDING,
    GONE,
    HIGH,
    KEPT,
    LOW,
    MARKS,
    PLACE,
    ROW,
    SLOT_MASK,
    SORT_SLOT,
    STATE_SHIFT,
    SUBJECT,
    TAG_MASK,
    TAG_SHIFT,
    UNORDERED,
    WINDOW,
    append_pending,
    chain_heads,
    link,
    pack,
    select_rows,
)
from .static_rows import StaticArrays

_WAITING = 256
"""The limit of columns not yet copied: they keep whole batches in memory."""
_LEAST = 512
"""The least number of rows with allocated space."""


class PatternRows:
    """The triples of all windows that the patterns of a query can match.

    ``windows``: the graph of each window, by its number. ``once``, ``needed``: by slot whether
    equal triples count once, and which chains joins follow (`row_kernels`).

    Law: `select` makes the triples within the bounds visible, however they came. The rows of a slot
    are in order of evaluation, time, window and kind.
    """

    def __init__(
        self,
        slots: Sequence[Slot],
        windows: Sequence[str],
        terms: TermValues,
        once: NDArray[np.bool_],
        needed: NDArray[np.int64],
    ) -> None:
        self.slots = {slot: number for number, slot in enumerate(slots)}
        self.windows = tuple(windows)
        self.terms = terms
        self.sorts: dict[int, int] = {}
        """The sorts of annotations so far, numbered."""
        self.selections = 0
        """The number of calls of `select`."""
        self.needed = needed
        self._once = once
        self._uncopied: list[tuple[Any, ...]] = []
        """Window, slot, kind, subjects, values and times of rows that are not pending yet."""
        self._reads_sorts = [Slot(graph, RDF_TYPE) in self.slots for graph in windows]
        self._numbers: list[dict[int, int]] = [{} for _ in windows]
        """By window: the slot of each predicate id."""
        self._pending = _pending(_LEAST)
        self._ordered = True
        """Whether pending rows are in order of time."""
        self.marks = np.zeros(MARKS, np.int64)
        self._start()
        terms.dictionary.hold(self)

    def _start(self) -> None:
        """Remove all rows; pending ones stay."""
        slots = len(self.slots)
        self.marks[:FIRST_PENDING] = 0
        self.visible = np.zeros(slots, np.int64)
        """By slot: the number of rows that joins see."""
        self.entered = np.zeros(slots, np.int64)
        """By slot: the number of such rows ever."""
        self.floors = np.zeros(slots, np.int64)
        """By slot: the first row that may be visible."""
        self._lasting = np.zeros(slots, np.int64)
        self._swept = np.zeros(len(self.windows), np.int64)
        self._inside = np.zeros((len(self.windows), slots), np.int64)
        self.rows, self._times, self._details = _room(_LEAST)
        self.heads, self.sizes = chain_heads(_LEAST, self.needed)

    @property
    def count(self) -> int:
        """The number of rows, including expired ones that are not removed."""
        return int(self.marks[COUNT])

    def held_ids(self) -> Iterator[NDArray[Any] | Sequence[int]]:
        """See `dictionary.Holder`. Joins skip expired rows, so their ids do not matter."""
        count = self.count
        rows = self.rows[:count][self.rows[:count, PLACE] >> STATE_SHIFT != GONE]
        slots, subjects, tags = _columns(rows)
        yield subjects
        yield _words(rows[(tags == Kind.TERM) & (slots != SORT_SLOT)])
        first, last = self.marks[FIRST_PENDING:].tolist()
        places, words, _ = (part[first:last] for part in self._pending)
        yield places[:, 2]
        yield words[places[:, 3] == Kind.TERM]
        yield list(self.sorts)
        yield from map(list, self._numbers)
        # Uncopied values are not canonical yet: hold the ids as they are.
        for _, _, kind, subjects, values, _ in self._uncopied:
            yield subjects
            if kind is Kind.TERM:
                yield values

    def push(self, window: int, tables: Sequence[TripleRows]) -> None:
        """Add rows of a window. Cost: a copy of each column that a pattern names, made at the next
        `select` for all rows since the last one together."""
        numbers = self._slots_of(window)
        parts = self._uncopied
        for rows in tables:
            for predicate, column in rows.objects.items():
                slot = numbers.get(predicate)
                if slot is None:
                    continue
                subjects, values, times = rows.subject, column.values, rows.time
                if column.null is not None:
                    at = np.flatnonzero(~column.null)
                    subjects, values, times = subjects[at], values[at], times[at]
                parts.append((window, slot, column.kind, subjects, values, times))
            if rows.sort is not None and self._reads_sorts[window] and len(rows):
                number = self.sorts.setdefault(rows.sort, len(self.sorts))
                numbered = np.full(len(rows), number, np.int64)
                part = (window, SORT_SLOT, Kind.INTEGER, rows.subject, numbered, rows.time)
                parts.append(part)
        if len(parts) >= _WAITING:
            self._copy()

    def _copy(self) -> None:
        """Copy new rows to the pending ones, with as few numpy calls as there are kinds of
        arrays."""
        if not self._uncopied:
            return
        windows, slots, kinds, subjects, values, times = zip(*self._uncopied, strict=True)
        self._uncopied = []
        lengths = map(len, subjects)
        self._append_pending(
            np.array(list(zip(windows, slots, kinds, lengths, strict=True)), np.int64),
            np.concatenate(subjects),
            np.concatenate([bits(part) for part in values]),
            np.concatenate(times),
        )

    def _append_pending(
        self,
        parts: NDArray[np.int64],
        subjects: NDArray[np.int32],
        words: NDArray[Any],
        times: NDArray[Any],
    ) -> None:
        """Append rows to the pending ones; ``parts``: windows, slots, kinds and lengths."""
        first, last = self.marks[FIRST_PENDING:].tolist()
        stop = last + len(times)
        if first == last:
            first, last, stop, self._ordered = 0, 0, len(times), True
            if len(self._pending[0]) > 8 * max(stop, _LEAST):
                self._pending = _pending(2 * stop)
        if stop > len(self._pending[0]):
            places, all_words, all_times = (part[first:last] for part in self._pending)
            self._pending = _pending(2 * (stop - first))
            first, last, stop = 0, last - first, stop - first
            self._pending[0][:last] = places
            self._pending[1][:last], self._pending[2][:last] = all_words, all_times
        # Sort the new rows now: they come in runs by table, which is cheap, unlike a sort of all.
        by = times.argsort(kind="stable")
        append_pending(
            parts, subjects, words, times, by, *self.terms.encodings, *self._pending, last
        )
        if stop > last > first:
            moments = self._pending[2]
            self._ordered &= bool(moments[last - 1] <= moments[last])
        self.marks[FIRST_PENDING:] = first, stop

    def _slots_of(self, window: int) -> dict[int, int]:
        """Return the slots of a window by predicate id, interned on first use."""
        found = self._numbers[window]
        if len(found) < len(self.slots):
            graph = self.windows[window]
            for slot, number in self.slots.items():
                if slot.graph == graph:
                    found[self.terms.dictionary.transient_id(slot.predicate)] = number
        return found

    def select(
        self,
        lows: NDArray[np.int64],
        highs: NDArray[np.int64],
        sorts: tuple[NDArray[np.int64], ...],
        static: StaticArrays,
    ) -> NDArray[np.int64] | None:
        """Move the windows to these bounds. ``sorts``: the facts that annotated sorts imply.

        Returns the new positions of rows (`LOST` if removed), or None if they have not moved.
        """
        self._copy()
        if not self._ordered:
            self._order()
        self.selections += 1
        moved = None
        while True:
            answer = select_rows(
                lows,
                highs,
                *sorts,
                *self._pending,
                self._once,
                self.needed,
                *static[:3],
                self.rows,
                self._times,
                self._details,
                self.heads,
                self.sizes,
                self.visible,
                self.entered,
                self.floors,
                self._lasting,
                self._swept,
                self._inside,
                self.marks,
            )
            if answer == DONE:
                return moved
            if answer == UNORDERED:
                self._order()
            else:
                # At most once per call: then there is enough space.
                moved = self.compact(answer)

    def _order(self) -> None:
        """Sort the pending rows by time, window, slot and kind, then by arrival."""
        first, last = self.marks[FIRST_PENDING:].tolist()
        places, words, times = (part[first:last] for part in self._pending)
        window, slot, _, tag = places.T
        by = np.lexsort((tag, slot, window, times))
        places[:], words[:], times[:] = places[by], words[by], times[by]
        self._ordered = True

    @property
    def is_full(self) -> bool:
        """Whether half of the rows have expired."""
        count, kept = self.marks[: KEPT + 1].tolist()
        return bool(count >= _LEAST and count >= 2 * kept)

    def compact(self, wanted: int = 0) -> NDArray[np.int64]:
        """Remove expired rows, and allocate space for ``wanted`` further ones and as many again.
        Returns as `select`."""
        wanted += int(self.marks[KEPT])
        moved = np.empty(self.count, np.int64)
        pack(self.rows, self._times, self._details, self._swept, self.marks, moved)
        room = len(self.rows)
        if not wanted <= room <= 8 * max(wanted, _LEAST):
            kept = self.count
            rows, times, details = self.rows, self._times, self._details
            self.rows, self._times, self._details = _room(2 * wanted)
            self.rows[:kept] = rows[:kept]
            self._times[:kept] = times[:kept]
            self._details[:kept] = details[:kept]
        self.heads, self.sizes = chain_heads(len(self.rows), self.needed)
        link(self.rows, self.needed, self.heads, self.sizes, self.count)
        return moved

    def reinsert_rows(self) -> None:
        """Make all rows pending again, since static triples or the meanings of sorts have
        changed."""
        # Derived rows follow from the sorts again, whose meaning may be another one now.
        at = self._stated_rows()
        rows, times, windows = self.rows[at], self._times[at], self._details[at, WINDOW]
        self._copy()
        self._start()
        first, last = self.marks[FIRST_PENDING:].tolist()
        places, words, later = (part[first:last].copy() for part in self._pending)
        slots, subjects, tags = _columns(rows)
        self.marks[FIRST_PENDING:] = 0
        ones = np.ones(len(rows), np.int32)
        parts = np.stack([windows, slots, tags, ones], axis=1).astype(np.int64)
        # The rows of the windows are older than the pending ones, so they go first.
        self._append_pending(parts, np.ascontiguousarray(subjects), _words(rows), times)
        window, slot, subject, tag = places.T
        parts = np.stack([window, slot, tag, np.ones_like(window)], axis=1).astype(np.int64)
        self._append_pending(parts, np.ascontiguousarray(subject), words, later)

    def _stated_rows(self) -> NDArray[np.int64]:
        """Return the rows that streams stated and that have not expired."""
        count = self.count
        there = self.rows[:count, PLACE] >> STATE_SHIFT != GONE
        return np.flatnonzero(there & (self._details[:count, DERIVED] == 0))

    def tables(
        self, lows: NDArray[np.int64], highs: NDArray[np.int64]
    ) -> dict[str, list[TripleRows]]:
        """Return the triples in the windows as narrow tables, by graph. Their valid time is
        unknown."""
        at = self._stated_rows()
        window, time = self._details[at, WINDOW], self._times[at]
        inside = (time > lows[window]) & (time <= highs[window])
        at, window, time = at[inside], window[inside], time[inside]
        slot, subject, tag = _columns(self.rows[at])
        words = _words(self.rows[at])
        names = {number: one for one, number in self.slots.items()}
        sorts = {number: sort for sort, number in self.sorts.items()}
        found: dict[str, list[TripleRows]] = {}
        shapes = np.stack([window, slot, np.where(slot == SORT_SLOT, words, tag)], axis=1)
        for w, number, kind in np.unique(shapes, axis=0).tolist():
            at = np.flatnonzero((shapes == (w, number, kind)).all(axis=1))
            at = at[np.argsort(time[at], kind="stable")]
            tables = found.setdefault(self.windows[w], [])
            if number == SORT_SLOT:
                table = TripleRows(time[at], time[at], subject[at], {}, sorts[kind])
            else:
                predicate = self.terms.dictionary.transient_id(names[number].predicate)
                column = decode(Kind(kind), words[at])
                table = TripleRows(time[at], time[at], subject[at], {predicate: column})
            tables.append(table)
        return found


def _columns(rows: NDArray[np.int32]) -> tuple[NDArray[Any], ...]:
    """Return slots, subjects and tags."""
    places = rows[:, PLACE]
    return places & SLOT_MASK, rows[:, SUBJECT], (places >> TAG_SHIFT) & TAG_MASK


def _words(rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the bits of objects."""
    high, low = (rows[:, half].astype(np.int64) for half in (HIGH, LOW))
    return (high << 32) | (low & 0xFFFFFFFF)


def _pending(capacity: int) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
    """Allocate window, slot, subject and tag; bits; times."""
    capacity = max(_LEAST, capacity)
    return (
        np.empty((capacity, 4), np.int32),
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
    )


def _room(capacity: int) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]:
    """Allocate rows, their times and details."""
    capacity = max(_LEAST, capacity)
    rows, details = np.empty((capacity, ROW), np.int32), np.empty((capacity, 4), np.int32)
    return rows, np.empty(capacity, np.int64), details
