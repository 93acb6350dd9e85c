"""What has come in and is still in some window that counts triples: single triples, in order."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...languages.csparql.ast import CountWindow
from ...rdf.dictionary import TermDictionary
from ...rdf.timed import Kind, TripleRows
from ..columns.relation import bits, decoded

_NO_SORT = -1


class CountingIntake:
    """The triples of one input for windows of the last ``size``, each ``step`` more.

    Triples are counted in order of τ, then of arrival: table by table of a push, row by row, the
    objects of a wide row in its order. Those of one τ are counted when the watermark has passed
    it: `settle`. Law: what `content` gives does not depend on how the triples were cut into pushes.

    Cost: a sort of what is settled. Memory: the last ``size + step`` triples, and what waits.
    """

    def __init__(self, window: CountWindow, dictionary: TermDictionary) -> None:
        self.window = window
        self._dictionary = dictionary
        self.counted = 0
        """How many triples have been settled."""
        self._waiting: list[_Triples] = []
        self._settled = _Triples.none()
        self._first = 0
        """How many settled triples have been forgotten."""
        dictionary.hold(self)

    def held_ids(self) -> Iterator[NDArray[np.int64]]:
        """See `dictionary.Holder`."""
        for part in (*self._waiting, self._settled):
            yield part.subject
            yield part.predicate
            yield part.object[part.kind == Kind.TERM]
            yield part.sort

    def push(self, rows: TripleRows) -> None:
        """Keep the triples of ``rows``."""
        self._waiting.append(_Triples.of(rows))

    def settle(self, watermark: int) -> None:
        """No more triples come with τ < ``watermark``: those that are there are counted."""
        if not any(len(part) and part.time.min() < watermark for part in self._waiting):
            return
        waiting = _Triples.joined(self._waiting)
        order = np.argsort(waiting.time, kind="stable")
        ready = order[waiting.time[order] < watermark]
        late = np.sort(order[len(ready) :])
        self._waiting = [waiting.take(late)] if len(late) else []
        self._settled = _Triples.joined([self._settled, waiting.take(ready)])
        self.counted += len(ready)

    def next_move(self, after: int) -> tuple[int, int] | None:
        """τ and number of the first triple behind number ``after`` with which the window moves on;
        None while it has not come."""
        number = after - after % self.window.step + self.window.step
        if number > self.counted:
            return None
        return int(self._settled.time[number - 1 - self._first]), number

    def number_at(self, end: int) -> int:
        """How many settled triples have τ ≤ ``end``, in whole steps."""
        count = self._first + int(np.searchsorted(self._settled.time, end, "right"))
        return count - count % self.window.step

    def content(self, number: int) -> list[TripleRows]:
        """The last ``size`` triples up to ``number``, as narrow tables by predicate and kind."""
        stop = number - self._first
        start = max(0, number - self.window.size) - self._first
        return list(self._settled.take(slice(max(0, start), stop)).tables(self._dictionary))

    def forget(self, number: int) -> None:
        """No window ends before triple ``number`` any more."""
        first = max(0, number - self.window.size)
        if first - self._first > 2 * (self.window.size + self.window.step):
            self._settled = self._settled.take(slice(first - self._first, None))
            self._first = first


class _Triples:
    """Triples one by one in columns; an object is its kind and the bits of its value."""

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
        """The triples of wide rows, row by row."""
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
        """Narrow tables, one a sort, predicate and kind, each in order."""
        shapes = np.stack([self.sort, self.predicate, self.kind], axis=1)

        def named(shape: list[int]) -> tuple[str, str, int]:
            # By names, not by ids, as `Intake.between`.
            sort, predicate, kind = shape
            term = dictionary.term
            return "" if sort == _NO_SORT else str(term(sort)), str(term(predicate)), kind

        for sort, predicate, kind in sorted(np.unique(shapes, axis=0).tolist(), key=named):
            at = np.flatnonzero((shapes == (sort, predicate, kind)).all(axis=1))
            yield TripleRows(
                self.time[at],
                self.valid[at],
                self.subject[at].astype(np.int32),
                {predicate: decoded(Kind(kind), self.object[at])},
                None if sort == _NO_SORT else sort,
            )
