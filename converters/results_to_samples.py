"""Results of continuous queries -> samples of their output streams ([Events14 §V.A], SPEC §4):
subject -> field ``id``, object -> a field named after the predicate, and a SELECT table column by
column.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Final, Protocol

import numpy as np
from pyoxigraph import NamedNode

from ..ontology.vocabulary import Vocabulary
from ..rdf.dictionary import Ids, TermDictionary
from ..rdf.namespaces import DYKNOW, local_name
from ..rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows
from ..streams.sample import (
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    Times,
    concatenate,
    empty_batch,
)
from ..streams.string_pool import StringPool
from .errors import ConversionError
from .term_tables import TextTable
from .values import field_column, field_type, term_text

ID: Final = "id"
ANSWER: Final = "answer"


class Solved(Protocol):
    """A SELECT table from `continuous`."""

    @property
    def variables(self) -> tuple[str, ...]: ...
    @property
    def columns(self) -> Mapping[str, ObjectColumn]: ...
    @property
    def dictionary(self) -> TermDictionary: ...
    def __len__(self) -> int: ...


class BatchOfResults(Protocol):
    """The results of successive windows: a table or triples. Rows of the table are in order of
    windows, those of window i before ``offsets[i + 1]``; triples have the ends as τ."""

    @property
    def ends(self) -> Sequence[int]: ...
    @property
    def solutions(self) -> Solved | None: ...
    @property
    def triples(self) -> TimedTriples | None: ...
    @property
    def offsets(self) -> Sequence[int]: ...


class Result(Protocol):
    """The result of a window: a table, triples, or the answer to ASK."""

    @property
    def end(self) -> int: ...
    @property
    def solutions(self) -> Solved | None: ...
    @property
    def triples(self) -> TimedTriples | None: ...
    @property
    def answer(self) -> bool | None: ...


def result_schema(
    *,
    predicates: Sequence[str] = (),
    variables: Sequence[str] = (),
    ranges: Mapping[str, str | None] | None = None,
    kinds: Mapping[str, Kind] | None = None,
    vocabulary: Vocabulary | None = None,
    ask: bool = False,
) -> Schema:
    """The fields of a query's output stream, known before its first result.

    CONSTRUCT: ``id`` and a field for each of ``predicates`` (IRIs of the head). SELECT: a field for
    each of ``variables``. ASK: ``answer``. A field's type comes from ``kinds`` (predicate or
    variable -> kind of its column, if the query's plan determines it), else from the range in
    ``ranges`` or the vocabulary; else it is text.
    """
    if ask:
        return Schema((Field(ANSWER, FieldType.BOOLEAN),))
    ranges, kinds = ranges or {}, kinds or {}
    if not predicates:
        return Schema(tuple(Field(v, field_type(ranges.get(v), kinds.get(v))) for v in variables))
    fields = [Field(ID, FieldType.STRING)]
    for predicate, name in field_names(predicates).items():
        info = None if vocabulary is None else vocabulary.feature(predicate)
        range = ranges.get(predicate, None if info is None else info.range)
        fields.append(Field(name, field_type(range, kinds.get(predicate))))
    return Schema(tuple(fields))


def field_names(predicates: Iterable[str]) -> dict[str, str]:
    """The field of each predicate: its local name, with a number from the second equal one on."""
    names: dict[str, str] = {}
    taken = {ID, "available", "valid"}
    for predicate in dict.fromkeys(predicates):
        name = base = local_name(predicate)
        number = 1
        while name in taken:
            number += 1
            name = f"{base}_{number}"
        taken.add(name)
        names[predicate] = name
    return names


class ResultConverter:
    """Results of a continuous query -> samples of its output stream.

    The valid time is the window's end; the caller gives the available time of all.
    CONSTRUCT: a wide row is a solution and becomes a sample (``id``, then a field per predicate).
    Triples of several tables are joined by subject unless a field would get two values.
    SELECT: a row is a sample. IRIs in ``namespace`` are written as their local name.

    Samples are sorted by the schema's fields, first to last (no_value first, text by code point),
    so that the output does not depend on the evaluator; ``keep_order`` keeps that of ORDER BY.

    Raises `ConversionError` for a predicate that ``predicates`` does not name, and for an object
    that its field cannot hold unless there is a list `lost`. Cost: numpy per column. The texts of a
    field are sorted once; in results with new texts, those of the result alone.
    """

    def __init__(
        self,
        schema: Schema,
        pools: dict[str, StringPool],
        namespace: str = DYKNOW,
        *,
        predicates: Sequence[str] = (),
        keep_order: bool = False,
    ) -> None:
        self.schema = schema
        self._pools = pools
        self._namespace = namespace
        self._fields = field_names(predicates)
        self._keep_order = keep_order
        self.lost: list[ConversionError] | None = None
        """Gets the first error of each field and result; such values become no_value."""
        self._texts: dict[str, TextTable] = {}
        self._ranks: dict[str, tuple[StringPool, Ids]] = {}
        self._sizes: dict[str, int] = {}
        """By field, the size of its pool when its texts were sorted last."""
        for field in schema.fields:
            if field.type is FieldType.STRING:
                pools.setdefault(field.name, StringPool())

    def convert(self, result: Result, available: int) -> SampleBatch:
        """The samples of a window's result."""
        if result.triples is not None:
            return self.triples(result.triples, result.end, available)
        solved = result.solutions
        if solved is not None:
            return self.table(
                solved.variables,
                solved.columns,
                solved.dictionary,
                result.end,
                available,
                len(solved),
            )
        answer = np.array([bool(result.answer)], np.bool_)
        column = Column(FieldType.BOOLEAN, answer)
        return self._stamped({ANSWER: column}, result.end, available, 1)

    def convert_batch(self, results: BatchOfResults) -> SampleBatch:
        """The samples of successive windows, one window after the other; each is available at its
        valid time.

        Law: those of `convert` for each window, except for the available times and `lost`.
        """
        if results.triples is not None:
            batch = self._of_tables(results.triples)
            return self._stamped(batch.columns, batch.valid, batch.valid, len(batch))
        solved = results.solutions
        assert solved is not None
        ends = np.repeat(np.array(results.ends, np.int64), np.diff(results.offsets))
        return self.table(solved.variables, solved.columns, solved.dictionary, ends, ends)

    def table(
        self,
        variables: Sequence[str],
        columns: Mapping[str, ObjectColumn],
        dictionary: TermDictionary,
        valid: int | Times,
        available: int | Times,
        length: int | None = None,
    ) -> SampleBatch:
        """Samples from the columns of a SELECT table; unbound is no_value. Times are those of all
        rows, or of each, in order."""
        if not isinstance(valid, int):
            length = len(valid)
        if length is None:
            length = len(next(iter(columns.values()))) if columns else 0
        unknown = [name for name in variables if self.schema.get(name) is None]
        if unknown:
            raise ConversionError(f"the output stream has no field {unknown[0]!r}")
        found = {
            field.name: self._field(field, columns[field.name], dictionary)
            if field.name in columns
            else _nothing(field, length, self._pools)
            for field in self.schema.fields
        }
        return self._stamped(found, valid, available, length)

    def triples(self, triples: TimedTriples, valid: int, available: int) -> SampleBatch:
        """Samples from the triples of a CONSTRUCT head."""
        batch = self._of_tables(triples)
        return self._stamped(batch.columns, valid, available, len(batch))

    def _of_tables(self, triples: TimedTriples) -> SampleBatch:
        """A sample a wide row, or a subject and time, in any order."""
        tables = [table for table in triples.tables if len(table) and table.objects]
        batches = [self._rows(table, triples.dictionary) for table in tables]
        if not batches:
            return empty_batch(self.schema, self._pools)
        batch = concatenate(batches)
        return _join_subjects(batch) if len(batches) > 1 else batch

    def _rows(self, table: TripleRows, dictionary: TermDictionary) -> SampleBatch:
        found: dict[str, ObjectColumn] = {ID: ObjectColumn(Kind.TERM, table.subject)}
        for predicate, objects in table.objects.items():
            term = dictionary.term(predicate)
            assert isinstance(term, NamedNode)
            name = self._fields.get(term.value)
            if name is None:
                raise ConversionError(
                    f"the output stream has no field for <{term.value}>",
                    hint="name the predicate in the query's head",
                )
            found[name] = objects
        columns = {
            field.name: self._field(field, found[field.name], dictionary)
            if field.name in found
            else _nothing(field, len(table), self._pools)
            for field in self.schema.fields
        }
        return SampleBatch(table.time, table.valid, columns)

    def _field(self, field: Field, objects: ObjectColumn, dictionary: TermDictionary) -> Column:
        pool = self._pools.get(field.name)
        if pool is not None and objects.kind is Kind.TERM and objects.null is None:
            texts = self._texts.get(field.name)
            if texts is None or texts.dictionary is not dictionary:
                text = partial(term_text, namespace=self._namespace)
                texts = self._texts[field.name] = TextTable(text, dictionary)
            return Column(field.type, texts.of_ids(objects.values, pool), None, pool)
        return field_column(field, objects, dictionary, pool, self._namespace, self.lost)

    def _stamped(
        self,
        columns: Mapping[str, Column],
        valid: int | Times,
        available: int | Times,
        length: int,
    ) -> SampleBatch:
        """Samples in their order, with these times: of all, or of each row."""
        keys = [] if isinstance(valid, int) else [valid]
        if not self._keep_order and length > 1:
            keys += [key for field in self.schema.fields for key in self._keys(field, columns)]
        if keys:
            order = np.lexsort(keys[::-1])
            columns = {name: column.take(order) for name, column in columns.items()}
            valid, available = (
                each if isinstance(each, int) else each[order] for each in (valid, available)
            )
        return SampleBatch(_repeated(available, length), _repeated(valid, length), columns)

    def _keys(self, field: Field, columns: Mapping[str, Column]) -> list[np.ndarray]:
        """The sort keys of a field: presence, then value."""
        column = columns[field.name]
        values = column.values
        if column.pool is not None and len(column.pool):
            values = self._rank(field.name, values, column.pool)
        if column.null is None:
            return [values]
        return [column.present, np.where(column.null, values.dtype.type(0), values)]

    def _rank(self, name: str, codes: Ids, pool: StringPool) -> Ids:
        """Numbers that order the texts with these codes."""
        known = self._ranks.get(name)
        # A new pool may have as many texts (`FluentStream.forget_texts`), hence both checks.
        if known is None or known[0] is not pool or len(known[1]) != len(pool):
            if self._sizes.get(name) != len(pool):
                # If each result adds texts, sorting the whole pool would cost more each time.
                self._sizes[name] = len(pool)
                distinct, place = np.unique(codes, return_inverse=True)
                among: Ids = _ranked([pool[code] for code in distinct.tolist()])[place]
                return among
            known = self._ranks[name] = pool, _ranked(pool.strings())
        found: Ids = known[1][codes]
        return found


def _ranked(texts: Sequence[str]) -> Ids:
    """The place of each text in their order."""
    order = np.array(sorted(range(len(texts)), key=texts.__getitem__), np.int64)
    ranks = np.empty(len(texts), np.int32)
    ranks[order] = np.arange(len(texts), dtype=np.int32)
    return ranks


def _repeated(time: int | Times, length: int) -> Times:
    if not isinstance(time, int):
        return time
    times = np.empty(length, np.int64)
    times.fill(time)
    return times


def _join_subjects(batch: SampleBatch) -> SampleBatch:
    """Join the rows of each subject and time, unless a field has two values."""
    subjects = batch.columns[ID]
    codes = subjects.values
    if len(codes) and batch.valid.min() != batch.valid.max():
        times = np.unique(batch.valid, return_inverse=True)[1]
        codes = times.astype(np.int64) * (int(codes.max()) + 1) + codes
    _, first, group = np.unique(codes, return_index=True, return_inverse=True)
    joined = np.ones(len(first), np.bool_)
    fields = {name: column for name, column in batch.columns.items() if name != ID}
    for column in fields.values():
        joined &= np.bincount(group[column.present], minlength=len(first)) <= 1
    target = np.where(joined[group], first[group], np.arange(len(batch)))
    columns: dict[str, Column] = {ID: subjects}
    for name, column in fields.items():
        present = column.present
        values, there = np.zeros_like(column.values), np.zeros(len(batch), np.bool_)
        values[target[present]] = column.values[present]
        there[target[present]] = True
        columns[name] = Column(column.type, values, None if there.all() else ~there, column.pool)
    return SampleBatch(batch.available, batch.valid, columns).take(np.unique(target))


def _nothing(field: Field, length: int, pools: Mapping[str, StringPool]) -> Column:
    """A column of no_value."""
    pool = pools[field.name] if field.type is FieldType.STRING else None
    return Column(field.type, np.zeros(length, field.type.dtype), np.ones(length, np.bool_), pool)
