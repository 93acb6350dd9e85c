"""Between columns and user-written code: single samples in, answers out.

A process written by a user sees `Sample` objects and answers with one, with a bare value, with
named values or with None. Here is the only place where that costs Python per sample; the batch
form of a unit goes past it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NoReturn, TypeAlias

import numpy as np

from ...streams.generator import StreamGenerator
from ...streams.sample import (
    Column,
    Field,
    FieldType,
    SampleBatch,
    Schema,
    Value,
    batch_from_rows,
    problem_of,
)
from ...streams.single_sample import Sample
from ...streams.string_pool import StringPool
from ...streams.time import TIME_MAX, TIME_MIN
from ..model.process_reports import OnReport, Report, ignore_report
from .supervision import ProcessError

Row: TypeAlias = tuple[int, int, dict[str, Value]]
"""``(available, valid, values)`` of one sample that fits the output's fields."""

Mark: TypeAlias = tuple[int, Schema | None]

VALUE = "value"
"""The field of an output whose fields nobody gave, where the process answers with bare values."""

_TYPES = {bool: FieldType.BOOLEAN, int: FieldType.INTEGER, float: FieldType.FLOAT}


def samples_of(batch: SampleBatch) -> Iterator[Sample]:
    """Each sample of a batch as an object. Cost: Python per value."""
    columns = [_values(column) for column in batch.columns.values()]
    names = tuple(batch.columns)
    rows = zip(*columns, strict=True) if columns else iter([()] * len(batch))
    times = zip(batch.available.tolist(), batch.valid.tolist(), strict=True)
    for (available, valid), row in zip(times, rows, strict=True):
        yield Sample(valid, dict(zip(names, row, strict=True)), available)


def _values(column: Column) -> list[Value]:
    if column.pool is None:
        return column.tolist()
    # Not `tolist`: that copies the pool, which may be much longer than the batch.
    pool, present = column.pool, column.present.tolist()
    codes = column.values.tolist()
    return [pool[c] if there else None for c, there in zip(codes, present, strict=True)]


class Answers:
    """Reads what a process gives back, and offers it to the output's generator.

    Where the output has fields, an answer must have just these, each of its type. Where it is
    *open*, the first answer decides them: bool, int, float and str become BOOLEAN, INTEGER, FLOAT
    and STRING. Of a source a row that repeats an earlier one is a duplicate. Law: the stream is the
    same however the answers were cut into offers.
    """

    def __init__(
        self,
        output: StreamGenerator,
        on_report: OnReport = ignore_report,
        *,
        is_source: bool = False,
    ) -> None:
        self._output = output
        self._take: Callable[[SampleBatch], object] = output.offer if is_source else output.emit
        self._on_report = on_report
        self._reports: list[Report] = []
        self._schema: Schema | None = None if output.is_open else output.schema

    @property
    def reports(self) -> Sequence[Report]:
        """What has been reported and not passed on yet."""
        return self._reports

    def again(self, row: Row | None, report: Report | None) -> None:
        """`row` gave this when it was done first."""
        if row is not None:
            self._check(row[2])
        if report is not None:
            self._reports.append(report)

    def mark(self) -> Mark:
        """What answers have said by now."""
        return len(self._reports), self._schema

    def forget(self, mark: Mark) -> None:
        """What was answered since ``mark`` was never said."""
        count, self._schema = mark
        del self._reports[count:]

    def row(self, answer: object, time: int, valid: int) -> Row | None:
        """The sample that an answer given at ``time`` means; None for no_sample.

        ``valid`` is the valid time where the answer names none. Raises `ProcessError`. Changes
        nothing that others see: it may be called on another thread.
        """
        answer = self._heard(answer)
        if answer is None:
            return None
        available = time
        values: Mapping[Any, Any]
        match answer:
            case Sample():
                valid = _time(answer.valid, "valid")
                if answer.available is not None:
                    available = _time(answer.available, "available")
                if not isinstance(answer.values, Mapping):
                    raise ProcessError(
                        f"the values of a sample are a mapping, got {_type(answer.values)}: "
                        "write Sample(valid, {'field': value})"
                    )
                values = answer.values
            case Mapping():
                values = answer
            case _:
                values = {self._only_field(answer): answer}
        if available < time:
            raise ProcessError(
                f"a sample made at {time} cannot have been available at {available}: leave "
                "`available` out, or give a later one"
            )
        plain = {name: _plain(value) for name, value in values.items()}
        self._check(plain)
        return available, valid, plain

    def offer(self, rows: Sequence[Row | None]) -> None:
        """Offer what `row` gave, in order; then pass on what was reported."""
        made = [row for row in rows if row is not None]
        if made:
            schema = self._decided()
            self._take(batch_from_rows(schema, made, self._output.stream.pools))
        self._pass_on()

    def _heard(self, answer: object) -> object:
        """The answer, out of the report that it came with; raises `ProcessError`."""
        if not isinstance(answer, Report):
            return answer
        quality = answer.quality
        if quality is not None and not (isinstance(quality, float | int) and 0 <= quality <= 1):
            raise ProcessError(f"the quality of a stream is a number from 0 to 1, got {quality!r}")
        if answer.contains is not None and not isinstance(answer.contains, str):
            raise ProcessError("`contains` is SSL text: speed(UAV) = value for every UAV = id")
        self._reports.append(answer)
        return answer.answer

    def _pass_on(self) -> None:
        while self._reports:
            self._on_report(self._output.name, self._reports.pop(0))

    def batch(self, answer: object, time: int) -> SampleBatch | None:
        """The same for the batch form: None or a `SampleBatch`, none of it available before
        ``time``. Raises `ProcessError`."""
        answer = self._heard(answer)
        if answer is None:
            return None
        if not isinstance(answer, SampleBatch):
            raise ProcessError(f"a batch form gives a SampleBatch or None, got {_type(answer)}")
        for name, times in (("available", answer.available), ("valid", answer.valid)):
            if not (isinstance(times, np.ndarray) and times.dtype == np.int64 and times.ndim == 1):
                raise ProcessError(f"the {name} times of a batch are int64 of shape (n,)")
        if len(answer.valid) != len(answer):
            raise ProcessError(f"{len(answer)} available and {len(answer.valid)} valid times")
        if not len(answer):
            return None
        if int(answer.available.min()) < time:
            raise ProcessError(
                f"samples made from {time} on cannot have been available at "
                f"{int(answer.available.min())}"
            )
        fields = []
        for name, column in answer.columns.items():
            _check_column(name, column, len(answer))
            fields.append(Field(name, column.type))
        schema = self._schema
        if schema is None:
            schema = self._schema = _new_schema(fields)
        if set(fields) != set(schema.fields):
            _refuse_fields(fields, schema)
        return SampleBatch(
            answer.available, answer.valid, {name: answer.columns[name] for name in schema.names}
        )

    def offer_batches(self, batches: Sequence[SampleBatch | None]) -> None:
        """Offer what `batch` gave, in order. Text is encoded anew in the output's pools."""
        for batch in batches:
            if batch is not None:
                self._decided()
                pools = self._output.stream.pools
                columns = {
                    name: _encoded(column, pools[name]) if column.pool is not None else column
                    for name, column in batch.columns.items()
                }
                self._take(SampleBatch(batch.available, batch.valid, columns))
        self._pass_on()

    def _decided(self) -> Schema:
        """The output's fields, which it now has."""
        schema = self._schema
        assert schema is not None
        texts = [field.name for field in schema.fields if field.type is FieldType.STRING]
        if self._output.is_open:
            self._output.adopt(schema, {name: StringPool() for name in texts})
        for name in texts:  # one pool for the stream's life, even where nobody gave one
            self._output.stream.pools.setdefault(name, StringPool())
        return schema

    def _only_field(self, answer: object) -> str:
        if self._schema is None:
            return VALUE
        if len(self._schema.fields) != 1:
            names = ", ".join(self._schema.names)
            raise ProcessError(
                f"the output has the fields {names}: a bare {_type(answer)} says not which; "
                "give a mapping"
            )
        return self._schema.names[0]

    def _check(self, values: Mapping[str, Value]) -> None:
        """Refuse what does not fit the output; the first answer of an open one decides it."""
        schema = self._schema
        if schema is None:
            schema = _new_schema([_field_of(name, value) for name, value in values.items()])
        for field in schema.fields:
            if field.name not in values:
                raise ProcessError(f"field {field.name!r} is missing")
            value = values[field.name]
            problem = None if value is None else problem_of(field.type, value)
            if problem is None and isinstance(value, str):
                problem = _not_text(value)
            if problem is not None:
                raise ProcessError(f"field {field.name!r} {problem}")
        if len(values) != len(schema.fields):
            extra = next(name for name in values if name not in schema.names)
            raise ProcessError(
                f"the output has no field {extra!r}; its fields are {', '.join(schema.names)}"
            )
        self._schema = schema


def _time(value: object, which: str) -> int:
    if isinstance(value, np.integer):
        value = int(value)
    if isinstance(value, bool) or not isinstance(value, int):
        raise ProcessError(f"the {which} time is an integer in ns, got {_type(value)}")
    if not TIME_MIN <= value <= TIME_MAX:
        raise ProcessError(f"the {which} time {value} is outside signed 64-bit nanoseconds")
    return value


def _plain(value: Any) -> Any:
    """A numpy scalar as the Python value it stands for; anything else as it is."""
    return value.item() if isinstance(value, np.number | np.bool_) else value


def _field_of(name: object, value: object) -> Field:
    if not isinstance(name, str) or not name:
        raise ProcessError(f"fields are named by text, got {name!r}")
    if value is None:
        raise ProcessError(
            f"field {name!r} has no value: the first sample of an open output must have all, "
            "for it decides the types"
        )
    kind = FieldType.STRING if isinstance(value, str) else None
    for type, found in _TYPES.items():  # bool first: it is an int too
        if kind is None and isinstance(value, type):
            kind = found
    if kind is None:
        raise ProcessError(f"field {name!r} is a {_type(value)}: values are bool, int, float, str")
    return Field(name, kind)


def _new_schema(fields: Sequence[Field]) -> Schema:
    if not fields:
        raise ProcessError("a sample has at least one field")
    return Schema(tuple(fields))


def _not_text(value: str) -> str | None:
    try:
        value.encode()
    except UnicodeEncodeError:
        return f"is text that UTF-8 has no bytes for: {value!r}"
    return None


def _check_column(name: object, column: object, length: int) -> None:
    if not isinstance(name, str) or not isinstance(column, Column):
        raise ProcessError(f"field {name!r} is a Column, got {_type(column)}")
    values, null = column.values, column.null
    if not isinstance(values, np.ndarray) or values.shape != (length,):
        raise ProcessError(f"field {name!r} has another length than the batch's {length} times")
    if values.dtype != column.type.dtype:
        raise ProcessError(
            f"field {name!r} is a {column.type} column of {column.type.dtype}, got {values.dtype}"
        )
    if null is not None and (null.shape != (length,) or null.dtype != np.bool_):
        raise ProcessError(f"the nulls of field {name!r} are bool of shape ({length},)")
    there = values if null is None else values[~null]
    if column.type is FieldType.FLOAT and not bool(np.isfinite(there).all()):
        raise ProcessError(f"field {name!r} must be finite: set `null` where there is no value")
    if (column.type is FieldType.STRING) != (column.pool is not None):
        raise ProcessError(f"field {name!r}: text has a pool, and nothing else has one")
    if (
        column.pool is not None
        and len(there)
        and not 0 <= int(there.min()) <= int(there.max()) < len(column.pool)
    ):
        raise ProcessError(f"field {name!r} has codes that its pool does not know")


def _refuse_fields(fields: Sequence[Field], schema: Schema) -> NoReturn:
    def listed(all: Sequence[Field]) -> str:
        return ", ".join(f"{field.name} ({field.type})" for field in all) or "no fields"

    raise ProcessError(f"the output has {listed(schema.fields)}; the batch has {listed(fields)}")


def _encoded(column: Column, pool: StringPool) -> Column:
    """A text column in the codes of ``pool``. Cost: O(n log n), Python per distinct text."""
    own = column.pool
    if own is None or own is pool:
        return column
    present = column.present
    codes = np.zeros(len(column), np.int32)
    distinct, place = np.unique(column.values[present], return_inverse=True)
    codes[present] = pool.encode([own[code] for code in distinct.tolist()])[place]
    return Column(column.type, codes, column.null, pool)


def _type(value: object) -> str:
    return type(value).__name__
