"""Statements of a stream of RDF as timed triples, for windows (SPEC §4)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...languages.ssl.annotation import StreamAnnotation
from ...rdf.dictionary import NO_TERM, Ids, TermDictionary, TermTable
from ...rdf.timed import Kind, TimedTriples, split_term
from ...streams.sample import Column, SampleBatch
from ...streams.string_pool import StringPool
from ..term_tables import PoolTable
from .ntriples import Statements, object_bits, timed_tables
from .statements import DATATYPE, NUMBER, NUMBERS, OBJECT, PREDICATE, SUBJECT, parse_term

_UNKNOWN: Final = -1


class StatementConverter:
    """The triples of statements, each at its available time, with its valid time.

    It takes the place of a `SampleConverter` for a stream of RDF: ``annotation`` names the stream
    and describes nothing. Law (tests/laws): the triples are those of the decoded text.

    Cost: numpy a column, and Python once for each distinct text that is new. Memory: 13 bytes a
    text of the stream's pools.
    """

    def __init__(self, stream: str, dictionary: TermDictionary) -> None:
        self.annotation = StreamAnnotation(stream, (), "")
        self.dictionary = dictionary
        self._subjects = PoolTable(self._id, dictionary)
        self._predicates = PoolTable(self._id, dictionary)
        self._objects = _ObjectTable(dictionary)

    @property
    def makes_nodes(self) -> bool:
        """No n-ary features, so no nodes of them."""
        return False

    def convert(self, batch: SampleBatch, names: Sequence[str] | None = None) -> TimedTriples:
        """The timed triples of the statements, a table for each predicate and kind of object.
        ``names``: as for `SampleConverter`, without use here."""
        kinds, values = self._objects.of(batch)
        found = Statements(
            _ids(batch.columns[SUBJECT], self._subjects),
            _ids(batch.columns[PREDICATE], self._predicates),
            kinds,
            values,
            np.full(len(batch), NO_TERM, np.int32),
            None,
        )
        return timed_tables(found, batch.available, batch.valid, self.dictionary)

    def _id(self, text: str) -> int:
        term = parse_term(text)
        assert term is not None, text
        return self.dictionary.transient_id(term)


def _ids(column: Column, table: PoolTable) -> Ids:
    assert column.pool is not None
    return table.of_codes(column.values, column.pool)


class _ObjectTable(TermTable):
    """Kinds and values of objects by the codes of a pool; see `PoolTable`."""

    def __init__(self, dictionary: TermDictionary) -> None:
        self._dictionary = dictionary
        self._pool: StringPool | None = None
        self._kinds = np.empty(0, np.int8)
        self._values = np.empty(0, np.int64)
        dictionary.follow(self)

    def of(self, batch: SampleBatch) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
        """Kind and value (`Statements`) of each object, shape ``(n,)`` each."""
        object, number, datatype = (batch.columns[name] for name in (OBJECT, NUMBER, DATATYPE))
        kinds, values = np.empty(len(batch), np.int8), np.empty(len(batch), np.int64)
        texts = np.flatnonzero(object.present)
        kinds[texts], values[texts] = self._of_codes(object, texts)
        rest = np.flatnonzero(~object.present)
        assert datatype.pool is not None
        for kind, name in NUMBERS.items():
            rows = rest[datatype.values[rest] == datatype.pool.find(name)]
            found: NDArray[Any] = number.values[rows]
            kinds[rows] = kind
            values[rows] = found if kind is Kind.INTEGER else found.view(np.int64)
        return kinds, values

    def _of_codes(
        self, column: Column, rows: NDArray[np.int64]
    ) -> tuple[NDArray[np.int8], NDArray[np.int64]]:
        pool, codes = column.pool, column.values[rows]
        assert pool is not None
        if pool is not self._pool:
            self._pool = pool
            self._kinds, self._values = np.empty(0, np.int8), np.empty(0, np.int64)
        if len(pool) > len(self._kinds):
            room = max(len(pool), 2 * len(self._kinds)) - len(self._kinds)
            self._kinds = np.concatenate([self._kinds, np.full(room, _UNKNOWN, np.int8)])
            self._values = np.concatenate([self._values, np.zeros(room, np.int64)])
        new = np.unique(codes[self._kinds[codes] == _UNKNOWN])
        for code in new.tolist():
            term = parse_term(pool[code])
            assert term is not None, pool[code]
            kind, value = split_term(term, self._dictionary.transient_id)
            self._kinds[code], self._values[code] = kind, object_bits(kind, value)
        return self._kinds[codes], self._values[codes]

    def forget(self, freed: NDArray[np.bool_]) -> None:
        """See `dictionary.TermTable`."""
        terms = np.flatnonzero(self._kinds == Kind.TERM)
        self._kinds[terms[freed[self._values[terms]]]] = _UNKNOWN
