"""The buffer of a counting window: its triples one by one, in order."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...languages.csparql.ast import CountWindow
from ...rdf.dictionary import TermDictionary
from ...rdf.timed import Kind, TripleRows
from ..columns.relation import bits, decode

_NO_SORT = -1


class CountBuffer:
    """The triples of one input for windows of the last ``size`` triples, which move by ``step``.

    Triples are counted in order of τ, then of arrival: table by table of a push, row by row, and
    the objects of a wide row in its order. Triples of one τ are counted when the watermark has
    passed it (`settle`). Law: `content` does not depend on how the triples are cut into pushes.

    Cost: a sort of the settled triples. Memory: the last ``size + step`` triples and those not yet
    settled.
    """

    def __init__(self, window: CountWindow, dictionary: TermDictionary) -> None:
        self.window = window
        self._dictionary = dictionary
        self.counted = 0
        """The number of settled triples."""
        self._waiting: list[_Triples] = []
        self._settled = _Triples.none()
        self._first = 0
        """The number of settled triples that have been dropped."""
        dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[np.int64]]:
        """See `dictionary.Holder`."""
        for part in (*self._waiting, self._settled):
            yield part.subject
            yield part.predicate
            yield part.object[part.kind == Kind.TERM]
            yield part.sort

    def push(self, rows: TripleRows) -> None:
        """Store the triples of ``rows``."""
        self._waiting.append(_Triples.of(rows))

    def settle(self, watermark: int) -> None:
        """Count the triples with τ < ``watermark``, which are complete."""
        if not any(len(part) and part.time.min() < watermark for part in self._waiting):
            return
        waiting = _Triples.joined(self._waiting)
        order = np.argsort(waiting.time, kind="stable")
        ready = order[waiting.time[order] < watermark]
        # The rest stays in order of arrival, which decides among triples of one time.
        remaining = np.sort(order[len(ready) :])
        self._waiting = [waiting.take(remaining)] if len(remaining) else []
        self._settled = _Triples.joined([self._settled, waiting.take(ready)])
        self.counted += len(ready)

    def next_move(self, after: int) -> tuple[int, int] | None:
        """Return τ and number of the first triple after number ``after`` that moves the window, or
        None if it has not come."""
        number = after - after % self.window.step + self.window.step
        if number > self.counted:
            return None
        return int(self._settled.time[number - 1 - self._first]), number

    def number_at(self, end: int) -> int:
        """Return the number of settled triples with τ ≤ ``end``, rounded down to whole steps."""
        count = self._first + int(np.searchsorted(self._settled.time, end, "right"))
        return count - count % self.window.step

    def content(self, number: int) -> list[TripleRows]:
        """Return the last ``size`` triples up to ``number``, as narrow tables by predicate and
        kind."""
        stop = number - self._first
        start = max(0, number - self.window.size) - self._first
        return list(self._settled.take(slice(max(0, start), stop)).tables(self._dictionary))

    def forget(self, number: int) -> None:
        """Drop the triples that no window ending at or after triple ``number`` contains."""
        first = max(0, number - self.window.size)
        # A drop copies the triples that stay, so it waits until many can go.
        if first - self._first > 2 * (self.window.size + self.window.step):
            self._settled = self._settled.take(slice(first - self._first, None))
            self._first = first


class _Triples:
    """Triples in columns, one row per triple; an object is its kind and the bits of its value."""

    __slots__ = ("kind", "object", "predicate", "sort", "subject", "time", "valid")

    def __init__(self, columns: tuple[NDArray[Any], ...]) -> None:
        time, valid, subject, predicate, kind, object, sort = columns
        self.time, self.valid, self.subject, self.predicate = time, valid, subject, predicate
        self.kind, self.object, self.sort = kind, object, sort

    def __len__(self) -> int:
        return len(self.time)

    def _columns(self) -> tuple[NDArray[Any], ...]:
        return (
            self.time,
            self.valid,
            self.subject,
            self.predicate,
            self.kind,
            self.object,
            self.sort,
        )

    @classmethod
    def none(cls) -> _Triples:
        return cls(tuple(np.zeros(0, np.int64) for _ in range(7)))

    @classmethod
    def of(cls, rows: TripleRows) -> _Triples:
        """Split wide rows into triples, row by row."""
        width = len(rows.objects)
        present = np.stack([c.present for c in rows.objects.values()], axis=1).reshape(-1)
        at = np.repeat(np.arange(len(rows)), width)[present]

        def each(values: list[Any]) -> NDArray[np.int64]:
            return np.tile(np.array(values, np.int64), len(rows))[present]

        objects = np.stack([bits(c.values) for c in rows.objects.values()], axis=1).reshape(-1)
        sort = _NO_SORT if rows.sort is None else rows.sort
        return cls(
            (
                rows.time[at],
                rows.valid[at],
                rows.subject[at].astype(np.int64),
                each(list(rows.objects)),
                each([int(column.kind) for column in rows.objects.values()]),
                objects[present],
                np.full(len(at), sort),
            )
        )

    @classmethod
    def joined(cls, parts: list[_Triples]) -> _Triples:
        columns = zip(*(part._columns() for part in parts), strict=True)
        return cls(tuple(np.concatenate(column) for column in columns))

    def take(self, rows: NDArray[Any] | slice) -> _Triples:
        return _Triples(tuple(column[rows] for column in self._columns()))

    def tables(self, dictionary: TermDictionary) -> Iterator[TripleRows]:
        """Yield narrow tables, one per sort, predicate and kind, each in order."""
        shapes = np.stack([self.sort, self.predicate, self.kind], axis=1)

        def by_name(shape: list[int]) -> tuple[str, str, int]:
            # Ids depend on the history of the dictionary, names do not (see `RowBuffer.between`).
            sort, predicate, kind = shape
            term = dictionary.term
            return "" if sort == _NO_SORT else str(term(sort)), str(term(predicate)), kind

        for sort, predicate, kind in sorted(np.unique(shapes, axis=0).tolist(), key=by_name):
            at = np.flatnonzero((shapes == (sort, predicate, kind)).all(axis=1))
            yield TripleRows(
                self.time[at],
                self.valid[at],
                self.subject[at].astype(np.int32),
                {predicate: decode(Kind(kind), self.object[at])},
                None if sort == _NO_SORT else sort,
            )
