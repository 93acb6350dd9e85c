"""What `publish` takes: rows, batches, DataFrames and bytes, as NDJSON.

Times of rows are ISO-8601 texts, integers of nanoseconds, ``datetime`` with a time zone, or floats:
seconds since 1970 as of ``time.time()``.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator, Mapping
from datetime import UTC, datetime
from decimal import Decimal
from math import isfinite
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import msgspec

from .tables import TIMES

if TYPE_CHECKING:
    from pandas import DataFrame

    from ...streams.sample import SampleBatch

    Samples: TypeAlias = Iterable[Mapping[str, Any]] | SampleBatch | DataFrame | bytes

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_SECOND: Final = 1_000_000_000
_LATEST: Final = 1e11
"""A float from here on is no time in seconds: it would be after the year 5138."""


class BadTime(ValueError):
    """A time of a sample is not clear. Nothing was sent."""


def ndjson(samples: Samples, stamp: bool) -> bytes:
    """Encode samples as NDJSON; ``stamp`` omits a batch's available times. Raises `BadTime`."""
    if isinstance(samples, bytes):
        return samples
    if isinstance(samples, Mapping):
        raise TypeError("samples are a list of rows, and this is a single row: write [row]")
    if (pandas := sys.modules.get("pandas")) is not None and isinstance(samples, pandas.DataFrame):
        return _lines(_frame_rows(samples, pandas))
    # A list has rows: skip the imports of numpy and the encoder of columns.
    if not isinstance(samples, list | tuple):
        from ...converters.ndjson import encode_ndjson
        from ...streams.sample import SampleBatch

        if isinstance(samples, SampleBatch):
            body = encode_ndjson(samples)
            if not stamp:
                return body
            rows = msgspec.json.Decoder(dict[str, Any]).decode_lines(body)
            return msgspec.json.Encoder().encode_lines([_unstamped(row) for row in rows])
    return _lines(samples)


def _lines(rows: Iterable[Mapping[str, Any]]) -> bytes:
    # json, not msgspec: it writes NaN as NaN, which the service refuses; msgspec writes null.
    return "\n".join(json.dumps(_timed(row, i)) for i, row in enumerate(rows, 1)).encode()


def _timed(row: Mapping[str, Any], number: int) -> Mapping[str, Any]:
    """Return a row whose times are as the service reads them."""
    changed = {
        name: _time(row[name], name, number)
        for name in TIMES
        if isinstance(row.get(name), float | datetime)
    }
    return {**row, **changed} if changed else row


def _time(value: float | datetime, name: str, number: int) -> int:
    """Return a time in ns."""
    if isinstance(value, datetime):
        if value.utcoffset() is None:
            raise BadTime(
                f"row {number}, {name!r}: {value} has no time zone; "
                "use datetime.now(UTC), or value.replace(tzinfo=UTC) if it is in UTC"
            )
        since = value - _EPOCH
        whole = (since.days * 86_400 + since.seconds) * _SECOND + since.microseconds * 1_000
        # A Timestamp of pandas has nanoseconds too.
        return whole + int(getattr(since, "nanoseconds", 0))
    if not isfinite(value) or abs(value) >= _LATEST:
        raise BadTime(
            f"row {number}, {name!r}: a float is seconds since 1970, and {value!r} is none; "
            "write nanoseconds as int(…)"
        )
    # By its shortest text: 0.1 s are 100,000,000 ns.
    return int((Decimal(float.__repr__(value)) * _SECOND).to_integral_value())


def _frame_rows(frame: DataFrame, pandas: Any) -> Iterator[dict[str, Any]]:
    """Yield the rows of a DataFrame, missing values as None. An index of times is ``valid``."""
    columns = {str(name): frame[name] for name in frame.columns}
    if "valid" not in columns and isinstance(frame.index, pandas.DatetimeIndex):
        columns = {"valid": frame.index.to_series(), **columns}
    values = [
        [None if is_missing else value for value, is_missing in zip(each, each.isna(), strict=True)]
        for each in (column.astype(object) for column in columns.values())
    ]
    for row in zip(*values, strict=True):
        yield dict(zip(columns, row, strict=True))


def _unstamped(row: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in row.items() if key != "available"}
