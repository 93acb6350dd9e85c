"""The triples that patterns can touch, as rows of numbers: those of the windows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...rdf.namespaces import RDF_TYPE
from ...rdf.timed import Kind, TripleRows
from ..columns.relation import TermValues, bits, decoded
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
    chain_heads,
    link,
    pack,
    turn,
    wait,
)
from .static_rows import StaticArrays

_WAITING = 256
"""At most so many columns wait: they hold on to the batches that they are of."""
_LEAST = 512
"""Rows that there is room for at least."""


class PatternRows:
    """The triples of all windows that the patterns of a query can touch.

    ``windows``: the graph of each window, by its number. ``once``, ``needed``: by slot whether
    equal triples count once, and which chains joins walk along (`row_kernels`).

    Law: what is visible after `turn` are the triples within the bounds, however they came; rows of
    a slot stand in order of evaluation, time, window and kind.
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
        """The sorts of annotations that have been met, numbered."""
        self.turns = 0
        """How often `turn` was called."""
        self.needed = needed
        self._once = once
        self._waiting: list[tuple[Any, ...]] = []
        """Window, slot, kind, subjects, values and times of what has come and nobody has seen."""
        self._asks_for_sorts = [Slot(graph, RDF_TYPE) in self.slots for graph in windows]
        self._numbers: list[dict[int, int]] = [{} for _ in windows]
        """By window: the slot of a predicate's id."""
        self._pending = _pending(_LEAST)
        self._ordered = True
        """Whether times of pending rows ascend."""
        self.marks = np.zeros(MARKS, np.int64)
        self._start()
        terms.dictionary.hold(self)

    def _start(self) -> None:
        """No row is here; pending ones stay pending."""
        slots = len(self.slots)
        self.marks[:FIRST_PENDING] = 0
        self.visible = np.zeros(slots, np.int64)
        """By slot: how many rows joins see."""
        self.entered = np.zeros(slots, np.int64)
        """By slot: how many such rows there ever were."""
        self.floors = np.zeros(slots, np.int64)
        """By slot: the first row that may be visible."""
        self._lasting = np.zeros(slots, np.int64)
        self._swept = np.zeros(len(self.windows), np.int64)
        self._inside = np.zeros((len(self.windows), slots), np.int64)
        self.rows, self._times, self._details = _room(_LEAST)
        self.heads, self.sizes = chain_heads(_LEAST, self.needed)

    @property
    def count(self) -> int:
        """How many rows are here, those that have gone and are not forgotten among them."""
        return int(self.marks[COUNT])

    def held_ids(self) -> Iterator[NDArray[Any] | Sequence[int]]:
        """See `dictionary.Holder`. Rows that have gone are passed by, whatever their ids are."""
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
        # What waits has not been spelled, so it is told as it came.
        for _, _, kind, subjects, values, _ in self._waiting:
            yield subjects
            if kind is Kind.TERM:
                yield values

    def push(self, window: int, tables: Sequence[TripleRows]) -> None:
        """Rows of a window. Cost: a copy of each column that a pattern names, when somebody looks
        at them: then all that have come since are taken in together."""
        numbers = self._slots_of(window)
        parts = self._waiting
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
            if rows.sort is not None and self._asks_for_sorts[window] and len(rows):
                number = self.sorts.setdefault(rows.sort, len(self.sorts))
                numbered = np.full(len(rows), number, np.int64)
                part = (window, SORT_SLOT, Kind.INTEGER, rows.subject, numbered, rows.time)
                parts.append(part)
        if len(parts) >= _WAITING:
            self._take_in()

    def _take_in(self) -> None:
        """What has come is pending: columns one after the other, in as few calls as there are
        kinds of arrays."""
        if not self._waiting:
            return
        windows, slots, kinds, subjects, values, times = zip(*self._waiting, strict=True)
        self._waiting = []
        lengths = map(len, subjects)
        self._wait(
            np.array(list(zip(windows, slots, kinds, lengths, strict=True)), np.int64),
            np.concatenate(subjects),
            np.concatenate([bits(part) for part in values]),
            np.concatenate(times),
        )

    def _wait(
        self,
        parts: NDArray[np.int64],
        subjects: NDArray[np.int32],
        words: NDArray[Any],
        times: NDArray[Any],
    ) -> None:
        """These rows are pending, too; ``parts``: windows, slots, kinds, how many they are."""
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
        # Tables of the same time, and inputs in turn: cheaper here than with all others.
        by = times.argsort(kind="stable")
        wait(parts, subjects, words, times, by, *self.terms.encodings, *self._pending, last)
        if stop > last > first:
            moments = self._pending[2]
            self._ordered &= bool(moments[last - 1] <= moments[last])
        self.marks[FIRST_PENDING:] = first, stop

    def _slots_of(self, window: int) -> dict[int, int]:
        """The dictionary may learn a predicate after the query was planned."""
        found = self._numbers[window]
        if len(found) < len(self.slots):
            graph = self.windows[window]
            for slot, number in self.slots.items():
                if slot.graph == graph:
                    found[self.terms.dictionary.transient_id(slot.predicate)] = number
        return found

    def turn(
        self,
        lows: NDArray[np.int64],
        highs: NDArray[np.int64],
        sorts: tuple[NDArray[np.int64], ...],
        static: StaticArrays,
    ) -> NDArray[np.int64] | None:
        """The windows have these bounds now; ``sorts`` says what those of annotations stand for.

        Returns where rows have moved to (`LOST` of one that has gone), if they have.
        """
        self._take_in()
        if not self._ordered:
            self._order()
        self.turns += 1
        moved = None
        while True:
            answer = turn(
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
                # It comes to this once a turn: then there is room.
                moved = self.compact(answer)

    def _order(self) -> None:
        """Put the pending rows in order of time, window, slot and kind, else of arrival."""
        first, last = self.marks[FIRST_PENDING:].tolist()
        places, words, times = (part[first:last] for part in self._pending)
        window, slot, _, tag = places.T
        by = np.lexsort((tag, slot, window, times))
        places[:], words[:], times[:] = places[by], words[by], times[by]
        self._ordered = True

    @property
    def is_full(self) -> bool:
        """Whether half of the rows have left the windows."""
        count, kept = self.marks[: KEPT + 1].tolist()
        return bool(count >= _LEAST and count >= 2 * kept)

    def compact(self, wanted: int = 0) -> NDArray[np.int64]:
        """Rows that have gone are dropped, and there is room for so many more, and for as many
        again; returns as `turn`."""
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

    def start_anew(self) -> None:
        """All rows come again at the next `turn`: what is static, or what sorts mean, is other than
        it was."""
        at = self._told()
        rows, times, windows = self.rows[at], self._times[at], self._details[at, WINDOW]
        self._take_in()
        self._start()
        first, last = self.marks[FIRST_PENDING:].tolist()
        places, words, later = (part[first:last].copy() for part in self._pending)
        slots, subjects, tags = _columns(rows)
        self.marks[FIRST_PENDING:] = 0
        ones = np.ones(len(rows), np.int32)
        parts = np.stack([windows, slots, tags, ones], axis=1).astype(np.int64)
        self._wait(parts, np.ascontiguousarray(subjects), _words(rows), times)
        window, slot, subject, tag = places.T
        parts = np.stack([window, slot, tag, np.ones_like(window)], axis=1).astype(np.int64)
        self._wait(parts, np.ascontiguousarray(subject), words, later)

    def _told(self) -> NDArray[np.int64]:
        """The rows that streams have said, and that have not gone."""
        count = self.count
        there = self.rows[:count, PLACE] >> STATE_SHIFT != GONE
        return np.flatnonzero(there & (self._details[:count, DERIVED] == 0))

    def tables(
        self, lows: NDArray[np.int64], highs: NDArray[np.int64]
    ) -> dict[str, list[TripleRows]]:
        """The triples in the windows as narrow tables, by graph (their valid time is unknown)."""
        at = self._told()
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
                made = TripleRows(time[at], time[at], subject[at], {}, sorts[kind])
            else:
                predicate = self.terms.dictionary.transient_id(names[number].predicate)
                column = decoded(Kind(kind), words[at])
                made = TripleRows(time[at], time[at], subject[at], {predicate: column})
            tables.append(made)
        return found


def _columns(rows: NDArray[np.int32]) -> tuple[NDArray[Any], ...]:
    """Slots, subjects and tags."""
    places = rows[:, PLACE]
    return places & SLOT_MASK, rows[:, SUBJECT], (places >> TAG_SHIFT) & TAG_MASK


def _words(rows: NDArray[np.int32]) -> NDArray[np.int64]:
    """The bits of objects."""
    high, low = (rows[:, half].astype(np.int64) for half in (HIGH, LOW))
    return (high << 32) | (low & 0xFFFFFFFF)


def _pending(capacity: int) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
    """Room for window, slot, subject and tag; bits; times."""
    capacity = max(_LEAST, capacity)
    return (
        np.empty((capacity, 4), np.int32),
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
    )


def _room(capacity: int) -> tuple[NDArray[np.int32], NDArray[np.int64], NDArray[np.int32]]:
    """Room for rows, their times and details."""
    capacity = max(_LEAST, capacity)
    rows, details = np.empty((capacity, ROW), np.int32), np.empty((capacity, 4), np.int32)
    return rows, np.empty(capacity, np.int64), details
