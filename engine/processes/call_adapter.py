"""Converts columns to the arguments of user-written code, and its answers to columns.

User-written code gets `Sample` objects. It answers with a `Sample`, a bare value, a mapping of
values, or None. Only here does a sample cost Python; the batch form avoids that.
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
"""``(available, valid, values)`` of one sample with the output's fields."""

Mark: TypeAlias = tuple[int, Schema | None]

VALUE = "value"
"""The field of an open output whose process answers with bare values."""

_TYPES = {bool: FieldType.BOOLEAN, int: FieldType.INTEGER, float: FieldType.FLOAT}


def samples_of(batch: SampleBatch) -> Iterator[Sample]:
    """Return each sample of a batch as an object. Cost: Python per value."""
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
    return [pool[code] if there else None for code, there in zip(codes, present, strict=True)]


def check_pair(answer: object) -> tuple[object, Any]:
    """Return the answer of a unit's code, ``(sample, new state)``. Raises `ProcessError` for any
    other."""
    if not isinstance(answer, tuple) or len(answer) != 2:
        raise ProcessError(
            f"a unit returns a pair (sample, new state), not {_type(answer)}: "
            "`return None, state` gives no sample"
        )
    return answer


class Answers:
    """Checks the answers of a process, and offers them to the output's generator.

    An answer must have exactly the output's fields, with their types. The first answer for an
    *open* output decides the fields: bool, int, float and str become BOOLEAN, INTEGER, FLOAT and
    STRING. A source's row that repeats an earlier one is a duplicate. Law: the stream does not
    depend on how the answers were cut into offers.
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
        """Reports that were not passed on yet."""
        return self._reports

    def replay(self, row: Row | None, report: Report | None) -> None:
        """Do what `row` did for an answer with this result and report."""
        if row is not None:
            self._check(row[2])
        if report is not None:
            self._reports.append(report)

    def mark(self) -> Mark:
        """Return the state of reports and fields, for `rewind`."""
        return len(self._reports), self._schema

    def rewind(self, mark: Mark) -> None:
        """Undo the answers since ``mark``, for which the log has no room."""
        count, self._schema = mark
        del self._reports[count:]

    def row(self, answer: object, time: int, valid: int) -> Row | None:
        """Return the sample of an answer given at ``time``; None for no_sample.

        ``valid`` is the valid time of an answer without one. Raises `ProcessError`. It may run on a
        watchdog's thread, so it changes only this object.
        """
        answer = self._take_report(answer)
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
                        f"the values of a sample must be a mapping, not {_type(answer.values)}: "
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
                "`available` out, or give a later time"
            )
        plain = {name: _plain(value) for name, value in values.items()}
        self._check(plain)
        return available, valid, plain

    def offer(self, rows: Sequence[Row | None]) -> None:
        """Offer the results of `row` in order; then pass on the reports."""
        samples = [row for row in rows if row is not None]
        if samples:
            schema = self._adopt_fields()
            self._take(batch_from_rows(schema, samples, self._output.stream.pools))
        self._pass_reports_on()

    def _take_report(self, answer: object) -> object:
        """Return the answer itself; note the report around it, if any. Raises `ProcessError`."""
        if not isinstance(answer, Report):
            return answer
        quality = answer.quality
        if quality is not None and not (isinstance(quality, float | int) and 0 <= quality <= 1):
            raise ProcessError(f"the quality of a stream is a number from 0 to 1, not {quality!r}")
        if answer.contains is not None and not isinstance(answer.contains, str):
            raise ProcessError("`contains` is SSL text: speed(UAV) = value for every UAV = id")
        self._reports.append(answer)
        return answer.answer

    def _pass_reports_on(self) -> None:
        while self._reports:
            self._on_report(self._output.name, self._reports.pop(0))

    def batch(self, answer: object, time: int) -> SampleBatch | None:
        """Check the answer of a batch form: None, or a `SampleBatch` without samples available
        before ``time``. Raises `ProcessError`."""
        answer = self._take_report(answer)
        if answer is None:
            return None
        if not isinstance(answer, SampleBatch):
            raise ProcessError(f"a batch form returns a SampleBatch or None, not {_type(answer)}")
        for name, times in (("available", answer.available), ("valid", answer.valid)):
            if not (isinstance(times, np.ndarray) and times.dtype == np.int64 and times.ndim == 1):
                raise ProcessError(f"the {name} times of a batch must be int64 of shape (n,)")
        if len(answer.valid) != len(answer):
            raise ProcessError(
                f"a batch has {len(answer)} available times, but {len(answer.valid)} valid times"
            )
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
        """Offer the results of `batch` in order, with texts encoded in the output's pools; then
        pass on the reports."""
        for batch in batches:
            if batch is not None:
                self._adopt_fields()
                pools = self._output.stream.pools
                columns = {
                    name: _encoded(column, pools[name]) if column.pool is not None else column
                    for name, column in batch.columns.items()
                }
                self._take(SampleBatch(batch.available, batch.valid, columns))
        self._pass_reports_on()

    def _adopt_fields(self) -> Schema:
        """Give an open output the decided fields; return them."""
        schema = self._schema
        assert schema is not None
        texts = [field.name for field in schema.fields if field.type is FieldType.STRING]
        if self._output.is_open:
            self._output.adopt(schema, {name: StringPool() for name in texts})
        for name in texts:  # for a stream that was made without pools
            self._output.stream.pools.setdefault(name, StringPool())
        return schema

    def _only_field(self, answer: object) -> str:
        if self._schema is None:
            return VALUE
        if len(self._schema.fields) != 1:
            names = ", ".join(self._schema.names)
            raise ProcessError(
                f"the output has the fields {names}, so a bare {_type(answer)} is ambiguous: "
                "give a mapping"
            )
        return self._schema.names[0]

    def _check(self, values: Mapping[str, Value]) -> None:
        """Check values against the output's fields; the first values decide an open output's.
        Raises `ProcessError`."""
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
        raise ProcessError(f"the {which} time must be an integer in ns, not {_type(value)}")
    if not TIME_MIN <= value <= TIME_MAX:
        raise ProcessError(f"the {which} time {value} is outside signed 64-bit nanoseconds")
    return value


def _plain(value: Any) -> Any:
    """Return the Python value of a numpy scalar, and other values as they are."""
    return value.item() if isinstance(value, np.number | np.bool_) else value


def _field_of(name: object, value: object) -> Field:
    if not isinstance(name, str) or not name:
        raise ProcessError(f"the name of a field must be a text, not {name!r}")
    if value is None:
        raise ProcessError(
            f"field {name!r} has no value: the first sample of an open output must have all, "
            "since it decides the types"
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
        return f"is a text that UTF-8 cannot encode: {value!r}"
    return None


def _check_column(name: object, column: object, length: int) -> None:
    if not isinstance(name, str) or not isinstance(column, Column):
        raise ProcessError(f"field {name!r} must be a Column, not {_type(column)}")
    values, null = column.values, column.null
    if not isinstance(values, np.ndarray) or values.shape != (length,):
        raise ProcessError(f"field {name!r} has another length than the batch's {length} times")
    if values.dtype != column.type.dtype:
        raise ProcessError(
            f"field {name!r} is a {column.type} column: its values must be {column.type.dtype}, "
            f"not {values.dtype}"
        )
    if null is not None and (null.shape != (length,) or null.dtype != np.bool_):
        raise ProcessError(f"the nulls of field {name!r} must be bool of shape ({length},)")
    present = values if null is None else values[~null]
    if column.type is FieldType.FLOAT and not bool(np.isfinite(present).all()):
        raise ProcessError(f"field {name!r} must be finite: set `null` where there is no value")
    if (column.type is FieldType.STRING) != (column.pool is not None):
        raise ProcessError(f"field {name!r}: a string column needs a pool, others have none")
    if (
        column.pool is not None
        and len(present)
        and not 0 <= int(present.min()) <= int(present.max()) < len(column.pool)
    ):
        raise ProcessError(f"field {name!r} has codes that are not in its pool")


def _refuse_fields(fields: Sequence[Field], schema: Schema) -> NoReturn:
    def listed(all: Sequence[Field]) -> str:
        return ", ".join(f"{field.name} ({field.type})" for field in all) or "no fields"

    raise ProcessError(f"the output has {listed(schema.fields)}; the batch has {listed(fields)}")


def _encoded(column: Column, pool: StringPool) -> Column:
    """Encode a string column in ``pool``. Cost: O(n log n), and Python per distinct text."""
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
