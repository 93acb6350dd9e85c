"""The triples that patterns can touch, as numbers: those of the windows, and the static ones."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..rdf.namespaces import RDF_TYPE
from ..rdf.timed import Kind, TripleRows
from .columns import TermValues, bits, decoded
from .expressions import Var
from .kernels import ascending
from .logical import Scan, TypeScan
from .pattern_kernels import chain
from .pattern_parts import Slot
from .sources import StaticSide

_SORT_SLOT = -1
_WAITING = 256
"""At most so many columns wait: they hold on to the batches that they are of."""


class PatternRows:
    """The triples of all windows that the patterns of a query can touch, in order of arrival.

    ``windows``: the graph of each window, by its number.
    """

    def __init__(self, slots: Sequence[Slot], windows: Sequence[str], terms: TermValues) -> None:
        self.slots = {slot: number for number, slot in enumerate(slots)}
        self.windows = tuple(windows)
        self.terms = terms
        self.sorts: dict[int, int] = {}
        """The sorts of annotations that have been met, numbered."""
        self.count = 0
        self._ordered = True
        """Whether times ascend."""
        self.inside = 0
        """How many were in the windows when they were looked at last."""
        self._columns: tuple[NDArray[Any], ...] = _empty(64)
        self._waiting: list[tuple[Any, ...]] = []
        """Window, slot, kind, subjects, values and times of what has come and nobody has seen."""
        self._numbers: list[dict[int, int]] = [{} for _ in windows]
        """By window: the slot of a predicate's id."""
        terms.dictionary.hold(self)

    @property
    def columns(self) -> tuple[NDArray[Any], ...]:
        """Window, slot, subject, tag, bits, time of each triple; the first `count` are valid."""
        self._take_in()
        return self._columns

    def held(self) -> Iterator[NDArray[Any] | Sequence[int]]:
        """See `dictionary.Holder`: what waits has not been spelled, so it is told as it came."""
        _, _, subjects, tags, objects, _ = (column[: self.count] for column in self._columns)
        yield subjects
        yield objects[tags == Kind.TERM]
        yield list(self.sorts)
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
            if rows.sort is not None and len(rows):
                number = self.sorts.setdefault(rows.sort, len(self.sorts))
                numbered = np.full(len(rows), number, np.int64)
                part = (window, _SORT_SLOT, Kind.INTEGER, rows.subject, numbered, rows.time)
                parts.append(part)
        if len(parts) >= _WAITING:
            self._take_in()

    def _take_in(self) -> None:
        """What has come stands with the others: columns one after the other, in as few calls as
        there are kinds of arrays."""
        if not self._waiting:
            return
        windows, slots, kinds, subjects, values, times = zip(*self._waiting, strict=True)
        self._waiting = []
        lengths = [len(part) for part in subjects]
        start = self.count
        stop = start + sum(lengths)
        if stop > len(self._columns[0]):
            larger = _empty(2 * stop)
            for old, new in zip(self._columns, larger, strict=True):
                new[:start] = old[:start]
            self._columns = larger
        added = tuple(column[start:stop] for column in self._columns)
        added[0][:] = np.repeat(windows, lengths)
        added[1][:] = np.repeat(slots, lengths)
        np.concatenate(subjects, out=added[2])
        added[3][:] = np.repeat(kinds, lengths)
        np.concatenate([bits(part) for part in values], out=added[4])
        np.concatenate(times, out=added[5])
        if Kind.TERM in kinds:
            self.terms.spell(added[3], added[4])
        if self._ordered:
            if not ascending(added[5]):
                # Tables of the same time, and inputs in turn: cheaper here than with all others.
                by = np.argsort(added[5], kind="stable")
                for column in added:
                    column[:] = column[by]
            before = self._columns[5][start - 1] if start else added[5][0]
            self._ordered = bool(before <= added[5][0])
        self.count = stop

    def _slots_of(self, window: int) -> dict[int, int]:
        """The dictionary may learn a predicate after the query was planned."""
        found = self._numbers[window]
        if len(found) < len(self.slots):
            graph = self.windows[window]
            for slot, number in self.slots.items():
                if slot.graph == graph:
                    found[self.terms.dictionary.id(slot.predicate)] = number
        return found

    @property
    def is_full(self) -> bool:
        """Whether half of the triples that were taken in may have left their windows."""
        return self.count >= 64 and self.count >= 2 * self.inside

    def drop(self, lows: NDArray[np.int64]) -> None:
        """Forget what is not above ``lows``, by window, when that is half of all."""
        if not self.is_full:
            return
        self._take_in()
        window, times = self._columns[0][: self.count], self._columns[5][: self.count]
        keep = np.flatnonzero(times > lows[window])
        if 2 * len(keep) <= self.count:
            larger = _empty(max(64, 2 * len(keep)))
            for old, new in zip(self._columns, larger, strict=True):
                new[: len(keep)] = old[keep]
            self._columns, self.count = larger, len(keep)

    def order(self) -> None:
        """Put the triples in order of time and tag, those of one in order of arrival."""
        self._take_in()
        _, _, _, tags, _, times = (column[: self.count] for column in self._columns)
        by = np.lexsort((tags, times))
        for column in self._columns:
            column[: self.count] = column[: self.count][by]
        self._ordered = True

    def between(self, low: int, high: int) -> tuple[int, int]:
        """Where the triples with ``low < time <= high`` begin and end; others may be among them."""
        self._take_in()
        if not self._ordered:
            self.order()
        times = self._columns[5][: self.count]
        return int(times.searchsorted(low, "right")), int(times.searchsorted(high, "right"))

    def tables(
        self, lows: NDArray[np.int64], highs: NDArray[np.int64]
    ) -> dict[str, list[TripleRows]]:
        """The triples in the windows as narrow tables, by graph (their valid time is unknown)."""
        window, slot, subject, tag, bits, time = (c[: self.count] for c in self.columns)
        inside = (time > lows[window]) & (time <= highs[window])
        names = {number: one for one, number in self.slots.items()}
        sorts = {number: sort for sort, number in self.sorts.items()}
        found: dict[str, list[TripleRows]] = {}
        shapes = np.stack([window, slot, np.where(slot < 0, bits, tag)], axis=1)
        for w, number, kind in np.unique(shapes[inside], axis=0).tolist():
            at = np.flatnonzero(inside & (shapes == (w, number, kind)).all(axis=1))
            at = at[np.argsort(time[at], kind="stable")]
            tables = found.setdefault(self.windows[w], [])
            if number < 0:
                rows = TripleRows(time[at], time[at], subject[at], {}, sorts[kind])
            else:
                predicate = self.terms.dictionary.id(names[number].predicate)
                column = decoded(Kind(kind), bits[at])
                rows = TripleRows(time[at], time[at], subject[at], {predicate: column})
            tables.append(rows)
        return found


def _empty(capacity: int) -> tuple[NDArray[Any], ...]:
    kinds = (np.int8, np.int32, np.int32, np.int8, np.int64, np.int64)
    return tuple(np.zeros(capacity, kind) for kind in kinds)


class StaticRows:
    """The static triples of the slots, with their chains: made once a version of the background."""

    def __init__(self, slots: Sequence[Slot], windows: frozenset[str], static: StaticSide) -> None:
        self.slots = slots
        self.windows = windows
        self.static = static
        self._version: int | None = None
        self._arrays: tuple[NDArray[Any], ...] = ()

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Starts by slot, subjects, tags, bits; heads and links by subject, by object."""
        version = self.static.background.version
        if version != self._version:
            self._version = version
            self._arrays = self._read()
        return self._arrays

    def _read(self) -> tuple[NDArray[Any], ...]:
        terms = self.static.terms
        starts = np.zeros(len(self.slots) + 1, np.int64)
        parts: list[tuple[NDArray[Any], ...]] = []
        for number, slot in enumerate(self.slots):
            rows = 0
            if slot.graph not in self.windows:
                if slot.predicate == RDF_TYPE:
                    scan: Scan | TypeScan = TypeScan(Var("s"), Var("o"), slot.graph)
                else:
                    scan = Scan(Var("s"), slot.predicate, Var("o"), slot.graph)
                subjects, objects = self.static.pairs(scan)
                parts.append((subjects.values, *terms.encoded(terms.canonical(objects))))
                rows = len(subjects)
            starts[number + 1] = starts[number] + rows
        if parts:
            subject, tag, bit = (np.concatenate(column) for column in zip(*parts, strict=True))
        else:
            subject, tag, bit = (np.zeros(0, kind) for kind in (np.int32, np.int8, np.int64))
        ends = (starts, subject, bit)
        return (starts, subject, tag, bit, *chain(*ends, True), *chain(*ends, False))
