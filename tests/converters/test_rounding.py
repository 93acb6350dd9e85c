"""Which numbers of a batch float fields do not hold."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from dyknow.converters.arrow.stream import bytes_of_table, decode_arrow
from dyknow.converters.ndjson import decode_ndjson
from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.wire import Rounded
from dyknow.streams.sample import Field, FieldType, Schema

SCHEMA = Schema((Field("v", FieldType.FLOAT), Field("w", FieldType.FLOAT)))


def rounded(*rows: tuple[str, str]) -> Rounded | None:
    lines = (f'{{"valid": 1, "v": {v}, "w": {w}}}\n' for v, w in rows)
    return decode_ndjson("".join(lines).encode(), SCHEMA, {}).rounded


def is_lost(text: str) -> bool:
    """The definition: beyond a last digit, the number is not the one that people read back."""
    value = float(text)
    if text == "null" or not (abs(value) >= 2**53 or abs(value) < 2**-1022):
        return False
    return Fraction(repr(value)) != Fraction(text)


INTEGERS = st.integers(-(2**60), 2**60).map(str)
DIGITS = st.integers(1, 10**20)
TINY = st.builds(lambda digits, power: f"{digits}e-{power}", DIGITS, st.integers(290, 420))
DOUBLES = st.floats(allow_nan=False, allow_infinity=False).map(repr)
NUMBERS = INTEGERS | TINY | DOUBLES | st.sampled_from(["null", "0", "-0.0", "0e-400", "5E-324"])


@settings(deadline=None)
@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=40))
@example([("9007199254740993", "1")])
@example([("1", "9007199254740992"), ("1e-400", "1e300")])
@example([("0", "0"), ("0", "11009960943271584e-290")])
@example([("0." + "0" * 400 + "1", "1")])
@example([("0", "-1")] * 200 + [("1e-400", "1")])
@example([("0", "-1")] * 200 + [("1", "1E-400")])
def test_it_is_as_defined(rows: list[tuple[str, str]]) -> None:
    lost = [
        (line, name)
        for line, row in enumerate(rows, 1)
        for name, text in zip("vw", row, strict=True)
        if text != "null" and is_lost(text)
    ]
    assert rounded(*rows) == (Rounded(len(lost), *lost[0]) if lost else None)


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=40), st.booleans())
@example([("9007199254740993", "1")], False)
@example([("1", "9007199254740992"), ("1e-400", "1e300")], False)
@example([("0", "9007199254740993.0"), ("0." + "0" * 400 + "1", "null")], False)
def test_recordings_count_the_same(
    tmp_path: Path, rows: list[tuple[str, str]], is_csv: bool
) -> None:
    file = tmp_path / ("table.csv" if is_csv else "table.ndjson")
    if is_csv:
        lines = [f"{n},{v},{w}".replace("null", "") for n, (v, w) in enumerate(rows)]
        file.write_text("\n".join(["valid,v,w", *lines]))
    else:
        file.write_text(
            "\n".join(f'{{"valid":{n},"v":{v},"w":{w}}}' for n, (v, w) in enumerate(rows))
        )
    types = {"v": FieldType.FLOAT, "w": FieldType.FLOAT}
    recording = open_recording(file, types=types)
    for _ in range(2):
        list(recording)
    wanted = rounded(*rows)
    if wanted is not None:
        wanted = replace(wanted, line=wanted.line + is_csv)
    assert recording.rounding.rounded == wanted


def test_chunks_of_a_recording_are_counted_together(tmp_path: Path) -> None:
    file = tmp_path / "long.csv"
    file.write_text("t,v\n" + "".join(f"{t},{9007199254740993 + t % 2}\n" for t in range(20_000)))
    recording = open_recording(file, types={"v": FieldType.FLOAT})
    assert recording.rounding.rounded is None
    list(recording)
    assert recording.rounding.rounded == Rounded(10_000, 2, "v")


def test_arrow_recordings_count_integers(tmp_path: Path) -> None:
    table = pa.table({"t": [1, 2], "v": pa.array([1, 2**53 + 1], pa.int64())})
    file = tmp_path / "table.arrow"
    file.write_bytes(bytes_of_table(table))
    recording = open_recording(file, types={"v": FieldType.FLOAT})
    assert recording.rounding.rounded == Rounded(1, 2, "v")


@settings(deadline=None)
@given(st.lists(st.integers(-(2**63), 2**63 - 1) | st.none(), min_size=1, max_size=40))
def test_integers_of_arrow_are_as_those_of_json(values: list[int | None]) -> None:
    zeros = pa.array([0.0] * len(values))
    table = pa.table({"valid": [1] * len(values), "v": pa.array(values, pa.int64()), "w": zeros})
    found = decode_arrow(bytes_of_table(table), SCHEMA, {}).rounded
    texts = ("null" if value is None else str(value) for value in values)
    assert found == rounded(*((text, "0") for text in texts))


def test_doubles_of_arrow_are_what_they_are() -> None:
    columns = {"valid": [1], "v": [2.0**53 + 2], "w": np.array([5e-324])}
    assert decode_arrow(bytes_of_table(pa.table(columns)), SCHEMA, {}).rounded is None


def test_blank_lines_count() -> None:
    body = b'\n{"valid": 1, "v": 0, "w": 0}\n\n{"valid": 1, "v": 9007199254740993, "w": 1e-400}'
    assert decode_ndjson(body, SCHEMA, {}).rounded == Rounded(2, 4, "v")


@pytest.mark.parametrize("schema", [Schema(()), Schema((Field("v", FieldType.INTEGER),))])
def test_integers_are_exact_or_refused(schema: Schema) -> None:
    body = msgspec.json.encode({"valid": 1, "v": 2**53 + 1})
    found = decode_ndjson(body, schema, {})
    assert (found.batch.columns["v"].tolist(), found.rounded) == ([2**53 + 1], None)
