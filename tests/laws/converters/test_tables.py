"""Tables read many rows at once are those read cell by cell and line by line."""

from __future__ import annotations

import csv
import io
import re
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow.converters import csv_table
from dyknow.converters.csv_table import read_csv_lines
from dyknow.converters.errors import WireError
from dyknow.converters.inference import TIME_UNITS, TimeReader
from dyknow.converters.recordings import text_files
from dyknow.converters.recordings.recording import open_recording
from dyknow.streams.sample import FieldType

CELL = st.text("ab \n\r,", max_size=4)
TIME = st.one_of(
    st.integers(-(2**66), 2**66),
    st.integers(0, 2**40).map(str),
    st.from_regex(r"[+-]?0*[0-9]{1,20}(\.[0-9]{1,3})?", fullmatch=True),
    st.from_regex(
        r"(1[5-9]|2[0-3])[0-9]{2}-[01][0-9]-[0-3][0-9][T ][0-2][0-9]:[0-6][0-9]:[0-6][0-9]"
        r"(\.[0-9]{1,10})?(Z|z|[+-]0[0-9]:00)?",
        fullmatch=True,
    ),
    st.sampled_from(
        ["", "1\n2", "2020-01-01T00:00:00Z\n2020-01-01T00:00:00Z", "\u0661", "1_0", None]
    ),
)


def plain(text: str) -> list[tuple[int, list[str]]]:
    """The line at which each row ends, and its cells, by the library alone."""
    reader = csv.reader(io.StringIO(text, newline=""), strict=True)
    next(reader)
    return [(reader.line_num, row) for row in reader if row]


@given(st.lists(st.lists(CELL, min_size=2, max_size=2), max_size=20), st.integers(1, 5))
def test_lines_of_rows(rows: list[list[str]], chunk: int) -> None:
    text = io.StringIO(newline="")
    csv.writer(text, quoting=csv.QUOTE_ALL).writerows([["a", "b"], *rows])
    lines = io.StringIO(text.getvalue().replace('"",""', ""), newline="")
    with patch.object(csv_table, "CHUNK", chunk):
        found = [
            (line, list(row))
            for numbers, cells in read_csv_lines(lines)
            for line, row in zip(numbers, zip(*cells.values(), strict=True), strict=True)
        ]
    assert found == plain(lines.getvalue())


@given(st.text("ab\r\n", max_size=60), st.integers(1, 7))
def test_lines_of_a_text(text: str, block: int) -> None:
    with patch.object(text_files, "_BLOCK", block):
        found = list(text_files._text_lines(io.StringIO(text, newline="")))
    assert found == list(io.StringIO(text, newline=""))


def test_a_line_without_end_is_refused() -> None:
    with patch.object(text_files, "LONGEST_LINE", 10), pytest.raises(WireError) as refused:
        list(text_files._text_lines(io.StringIO("a\n" + "b" * 9_000 + "\n")))
    assert refused.value.line == 2


def one_by_one(times: list, unit: str | None) -> list[int]:
    """Each time by the definition of one."""
    reader = TimeReader(unit)
    for time in times:
        reader.observe([time])
    scale = TIME_UNITS[reader.unit]
    return [reader._one(time, scale, 7, "t") for time in times]


@given(st.lists(TIME, min_size=1, max_size=6), st.sampled_from([None, "s", "ms", "us", "ns"]))
def test_times(times: list, unit: str | None) -> None:
    reader = TimeReader(unit)
    reader.observe(times)
    try:
        expected = one_by_one(times, unit)
    except WireError as error:
        with pytest.raises(WireError, match=re.escape(str(error))):
            reader.read(times, [7] * len(times), "t")
        return
    assert reader.read(times, [7] * len(times), "t").tolist() == expected


@given(
    st.lists(
        st.tuples(st.integers(0, 50), st.sampled_from(["1", "2.5", "", "x", "1e+999"])), min_size=1
    ),
    st.booleans(),
    st.sampled_from([None, FieldType.FLOAT, FieldType.STRING]),
)
def test_available_times_alone(
    tmp_path_factory: pytest.TempPathFactory,
    rows: list[tuple[int, str]],
    stamped: bool,
    wanted: FieldType | None,
) -> None:
    path = tmp_path_factory.mktemp("table") / "t.csv"
    more = [f",{time + 1}" if stamped else "" for time, _ in rows]
    lines = [f"{time},{value}{rest}" for (time, value), rest in zip(rows, more, strict=True)]
    path.write_text("\n".join(["t,v" + (",available" if stamped else ""), *lines]))
    recording = open_recording(path, types={} if wanted is None else {"v": wanted})
    try:
        expected = [batch.available for batch in recording.read()]
    except WireError:
        # What cannot be read is told by whoever asks for the times, before a row is used.
        with pytest.raises(WireError):
            list(recording.available_times())
        return
    found = list(recording.available_times())
    assert np.concatenate(found).tolist() == np.concatenate(expected).tolist()
