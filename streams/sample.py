"""Samples in batches of columns ([DyKnow10 Def. 5.3], SPEC §1).

A sample ⟨t_a, t_v, v⟩ is a row of a `SampleBatch`: available time, valid time, and one value a
field. `no_value` is a set bit in a column's null mask. `no_sample` is the absence of a row (and
`None` where a function must answer for a single sample). A single sample is a batch of one.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, TypeAlias, TypeVar, assert_never

import numpy as np
from numpy.typing import NDArray

from .string_pool import OVERHEAD, StringPool

Times: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]
Value: TypeAlias = float | int | bool | str | None
Key = TypeVar("Key")

TIME_FIELDS = ("available", "valid")
"""The names of a sample's times: no field is called so."""
TIMES_SIZE = 16
"""Bytes of a sample's times."""


class FieldType(StrEnum):
    """What a field's values are. Text is dictionary-encoded."""

    FLOAT = "float"
    INTEGER = "integer"
    BOOLEAN = "boolean"
    STRING = "string"

    @property
    def dtype(self) -> np.dtype[Any]:
        """The numpy type of the column that holds such values (codes for text)."""
        match self:
            case FieldType.FLOAT:
                return np.dtype(np.float64)
            case FieldType.INTEGER:
                return np.dtype(np.int64)
            case FieldType.BOOLEAN:
                return np.dtype(np.bool_)
            case FieldType.STRING:
                return np.dtype(np.int32)
            case _:
                assert_never(self)

    @property
    def size(self) -> int:
        """Bytes that a value is reckoned with in the history of a stream; of a text those beside
        its characters."""
        return OVERHEAD if self is FieldType.STRING else self.dtype.itemsize


class SampleError(ValueError):
    """A sample or batch that does not fit its schema. Nothing of the batch was taken.

    ``row`` counts from 0 within the batch; ``field`` is the field's name; either may be None.
    """

    def __init__(self, message: str, row: int | None = None, field: str | None = None) -> None:
        super().__init__(message)
        self.row = row
        self.field = field


@dataclass(frozen=True, slots=True)
class Field:
    """A named value of a sample, with its type."""

    name: str
    type: FieldType


LONGEST_NAME = 200
"""Characters of a name that people give: to a stream, a field, an object of an annotation."""
IN_FIELD_NAMES = r'[^"\\\x00-\x1f]'
"""What the name of a field is made of: in JSON it is spelled as it is."""
_FIELD_NAME = re.compile(f"{IN_FIELD_NAMES}{{1,{LONGEST_NAME}}}")


def check_field_name(name: str) -> None:
    """Raises `ValueError` for what a field cannot be called."""
    if not _FIELD_NAME.fullmatch(name):
        told = repr(name if len(name) <= LONGEST_NAME else f"{name[:LONGEST_NAME]}…")
        raise ValueError(
            f"a field cannot be called {told}: a name has 1 to {LONGEST_NAME} characters, and no "
            "quotation marks, backslashes and control characters"
        )


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Schema:
    """The fields of a stream's samples, in order; names are distinct."""

    fields: tuple[Field, ...]

    def __post_init__(self) -> None:
        counts = Counter(field.name for field in self.fields)
        twice = [name for name, count in counts.items() if count > 1]
        if twice:
            raise ValueError(f"field names must differ: {', '.join(sorted(twice))} is there twice")

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(field.name for field in self.fields)

    def get(self, name: str) -> Field | None:
        """The field called ``name``, or None."""
        return next((field for field in self.fields if field.name == name), None)


@dataclass(frozen=True, slots=True, eq=False)
class Column:
    """The values of one field over a batch: an array of ``type.dtype``, shape ``(n,)``.

    ``null`` marks no_value (True = no value; None = every value is there); what stands in
    ``values`` under a set bit means nothing. ``pool`` decodes text and is None otherwise.
    """

    type: FieldType
    values: NDArray[Any]
    null: Mask | None = None
    pool: StringPool | None = None

    def __len__(self) -> int:
        return len(self.values)

    @property
    def present(self) -> Mask:
        """True where there is a value, shape ``(n,)``."""
        return np.ones(len(self.values), np.bool_) if self.null is None else ~self.null

    def take(self, rows: NDArray[Any] | slice) -> Column:
        """The column at ``rows`` (a mask, indices or a slice)."""
        null = None if self.null is None else self.null[rows]
        return Column(self.type, self.values[rows], null, self.pool)

    def recoded(self, pool: StringPool) -> Column:
        """The same text encoded with another pool: those of two streams differ."""
        if self.pool is pool:
            return self
        assert self.pool is not None
        present = None if self.null is None else self.present
        values = self.values if present is None else self.values[present]
        if self.pool.has_place(pool):
            known, place = self.pool.codes_in(pool), values
        elif len(self.pool) <= len(values):
            # A batch's own texts: found without sorting.
            is_used = np.zeros(len(self.pool), np.bool_)
            is_used[values] = True
            used, place = np.flatnonzero(is_used), values
            known = np.zeros(len(self.pool), np.int32)
            known[used] = pool.encode([self.pool[code] for code in used.tolist()])
        else:
            used, place = np.unique(values, return_inverse=True)
            known = pool.encode([self.pool[code] for code in used.tolist()])
        if present is None:
            return Column(self.type, known.take(place), None, pool)
        codes = np.zeros(len(self), np.int32)
        codes[present] = known.take(place)
        return Column(self.type, codes, self.null, pool)

    def at(self, row: int) -> Value:
        """The value at ``row`` as a Python object, None for no_value."""
        if self.null is not None and self.null[row]:
            return None
        if self.pool is not None:
            return self.pool[int(self.values[row])]
        value: Value = self.values[row].item()
        return value

    def tolist(self) -> list[Value]:
        """All values as Python objects, None for no_value."""
        values: list[Value] = self.values.tolist()
        if self.pool is not None:
            # A copy of the pool is the quicker, unless it is much longer than the column.
            few = len(self.pool) > 16 * len(self)
            strings = self.pool if few else self.pool.strings()
            if self.null is None:
                return [strings[code] for code in self.values.tolist()]
            pairs = zip(self.values.tolist(), self.null.tolist(), strict=True)
            return [None if null else strings[code] for code, null in pairs]
        if self.null is not None:
            pairs = zip(values, self.null.tolist(), strict=True)
            return [None if null else value for value, null in pairs]
        return values


@dataclass(frozen=True, slots=True, eq=False)
class SampleBatch:
    """Samples as columns: ``available`` and ``valid`` in ns, shape ``(n,)``; a column a field.

    A batch by itself promises nothing about the order of its times; a `FluentStream` does.
    Cost of slicing: views, no copy. Cost of carrying: nothing per sample.
    """

    available: Times
    valid: Times
    columns: Mapping[str, Column]

    def __len__(self) -> int:
        return len(self.available)

    def take(self, rows: NDArray[Any] | slice) -> SampleBatch:
        """The samples at ``rows`` (a mask, indices or a slice), in that order."""
        if not isinstance(rows, slice) and rows.dtype == np.bool_:
            # Searched once instead of once a column.
            assert len(rows) == len(self)
            rows = np.flatnonzero(rows)
        columns = {name: column.take(rows) for name, column in self.columns.items()}
        return SampleBatch(self.available[rows], self.valid[rows], columns)

    @property
    def nbytes(self) -> int:
        """Bytes of its arrays: its texts are elsewhere, once for all batches that have them."""
        found = self.available.nbytes + self.valid.nbytes
        for column in self.columns.values():
            found += column.values.nbytes + (0 if column.null is None else column.null.nbytes)
        return found

    def sizes(self) -> NDArray[np.int64]:
        """Bytes that each sample is reckoned with in the history of a stream, shape ``(n,)``: 16
        for its times, 8 for a number, 1 for a boolean, of a text what `size_of` says, and 128 for
        one that is not there. Cost: O(n) for each field of texts."""
        columns = self.columns.values()
        found = np.full(len(self), TIMES_SIZE + sum(column.type.size for column in columns))
        for column in columns:
            if column.pool is not None and len(column.pool):
                texts = column.pool.sizes()[column.values] - OVERHEAD
                found += texts if column.null is None else np.where(column.null, 0, texts)
        return found

    def select(self, names: Sequence[str]) -> SampleBatch:
        """The same samples with these fields only, in this order."""
        columns = {name: self.columns[name] for name in names}
        return SampleBatch(self.available, self.valid, columns)

    def with_available(self, available: Times) -> SampleBatch:
        """The same samples with other available times."""
        return SampleBatch(available, self.valid, self.columns)

    def values_at(self, row: int) -> dict[str, Value]:
        """The named values of one sample, None for no_value."""
        return {name: column.at(row) for name, column in self.columns.items()}

    def rows(self) -> Iterator[tuple[int, int, dict[str, Value]]]:
        """Each sample as ``(available, valid, values)``: for edges and tests, not for the way."""
        names = list(self.columns)
        lists = [column.tolist() for column in self.columns.values()]
        for i, (available, valid) in enumerate(
            zip(self.available.tolist(), self.valid.tolist(), strict=True)
        ):
            yield available, valid, {name: lists[j][i] for j, name in enumerate(names)}


def empty_batch(schema: Schema, pools: Mapping[str, StringPool] | None = None) -> SampleBatch:
    """No samples, with the columns of ``schema``."""
    return batch_from_rows(schema, [], pools)


def widened(
    batch: SampleBatch, schema: Schema, pools: Mapping[str, StringPool] | None = None
) -> SampleBatch:
    """``batch`` with the columns of ``schema``, in its order; a column that the batch lacks has
    no_value throughout. ``pools`` has the pools of new text fields. Cost: O(new fields x rows)."""
    columns: dict[str, Column] = {}
    for field in schema.fields:
        column = batch.columns.get(field.name)
        if column is None:
            values = np.zeros(len(batch), field.type.dtype)
            pool = (pools or {}).get(field.name)
            column = Column(field.type, values, np.ones(len(batch), np.bool_), pool)
        columns[field.name] = column
    return SampleBatch(batch.available, batch.valid, columns)


def batch_from_rows(
    schema: Schema,
    rows: Sequence[tuple[int, int, Mapping[str, Value]]],
    pools: Mapping[str, StringPool] | None = None,
) -> SampleBatch:
    """Columns from ``(available, valid, values)`` rows, checked against ``schema``.

    A field that a row lacks and a field that the schema lacks are errors; None is no_value.
    ``pools`` gives the string pools to encode with, by field; a new one is made where it lacks.
    Raises `SampleError` with row and field. Cost: Python per value; a batch decoder is faster.
    """
    names = set(schema.names)
    for i, (_, _, values) in enumerate(rows):
        if values.keys() != names:
            for name in schema.names:
                if name not in values:
                    raise SampleError(f"field {name!r} is missing", i, name)
            extra = next(name for name in values if name not in names)
            raise SampleError(f"field {extra!r} is not declared", i, extra)
    columns = {
        field.name: column_from_values(
            field, [values[field.name] for _, _, values in rows], (pools or {}).get(field.name)
        )
        for field in schema.fields
    }
    return SampleBatch(
        np.array([row[0] for row in rows], np.int64),
        np.array([row[1] for row in rows], np.int64),
        columns,
    )


def column_from_values(
    field: Field, values: Sequence[Value], pool: StringPool | None = None
) -> Column:
    """A column from Python values (None = no_value), each checked against ``field.type``.

    Integers are taken for floats when exact; NaN and the infinities are refused: a sample that
    has no value says so with None. Raises `SampleError` with row and field.
    """
    missing = [value is None for value in values]
    null = np.array(missing, np.bool_) if any(missing) else None
    for i, value in enumerate(values):
        problem = None if value is None else problem_of(field.type, value)
        if problem:
            raise SampleError(f"field {field.name!r} {problem}", i, field.name)
    match field.type:
        case FieldType.STRING:
            pool = StringPool() if pool is None else pool
            codes = [0 if value is None else pool.code(str(value)) for value in values]
            return Column(field.type, np.array(codes, np.int32), null, pool)
        case FieldType.FLOAT | FieldType.INTEGER | FieldType.BOOLEAN:
            plain = [0 if value is None else value for value in values]
            return Column(field.type, np.array(plain, field.type.dtype), null)
        case _:
            assert_never(field.type)


def column_of_texts(
    values: Sequence[Key], text: Callable[[Key], Value], pool: StringPool | None = None
) -> Column:
    """A column of what ``text`` writes (None = no_value), called once for each distinct value."""
    pool = StringPool() if pool is None else pool
    codes = {}
    for value in dict.fromkeys(values):
        written = text(value)
        codes[value] = -1 if written is None else pool.code(str(written))
    coded = np.array([codes[value] for value in values], np.int32)
    null = coded < 0 if -1 in codes.values() else None
    return Column(FieldType.STRING, coded if null is None else np.maximum(coded, 0), null, pool)


def concatenate(batches: Sequence[SampleBatch]) -> SampleBatch:
    """One batch of all samples, in order. All have the same fields; text is in the codes of the
    last one's pool: streams get new pools, and what is kept of before is older."""
    if len(batches) == 1:
        return batches[0]
    last = batches[-1]
    columns: dict[str, Column] = {}
    for name, column in last.columns.items():
        parts = [batch.columns[name] for batch in batches]
        if column.pool is not None:
            parts = [part.recoded(column.pool) for part in parts]
        null = None
        if any(part.null is not None for part in parts):
            null = np.concatenate([~part.present for part in parts])
        values = np.concatenate([part.values for part in parts])
        columns[name] = Column(column.type, values, null, column.pool)
    return SampleBatch(
        np.concatenate([batch.available for batch in batches]),
        np.concatenate([batch.valid for batch in batches]),
        columns,
    )


def problem_of(kind: FieldType, value: Value) -> str | None:
    """What is wrong with a present ``value`` for a field of type ``kind``; None if nothing."""
    match kind:
        case FieldType.FLOAT:
            if isinstance(value, bool) or not isinstance(value, float | int):
                return f"is a float, got {value!r}"
            try:
                finite = np.isfinite(float(value))
            except OverflowError:
                finite = np.bool_(False)
            return None if finite else f"must be finite, got {value!r}: send null for no value"
        case FieldType.INTEGER:
            if isinstance(value, bool) or not isinstance(value, int):
                return f"is an integer, got {value!r}"
            return None if -(2**63) <= value < 2**63 else f"is outside 64 bits: {value!r}"
        case FieldType.BOOLEAN:
            return None if isinstance(value, bool) else f"is a boolean, got {value!r}"
        case FieldType.STRING:
            return None if isinstance(value, str) else f"is a string, got {value!r}"
        case _:
            assert_never(kind)


Content = tuple[Any, ...]
"""Valid time and values of a sample: all but when it became available."""


def contents(batch: SampleBatch) -> list[Content]:
    """The content of each sample; columns in order of their names."""
    columns = [batch.columns[name].tolist() for name in sorted(batch.columns)]
    return list(zip(batch.valid.tolist(), *columns, strict=True))
