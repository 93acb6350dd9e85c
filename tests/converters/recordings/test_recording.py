"""Recorded tables: types and times inferred, what is refused, and the example."""

import gzip
import os

import numpy as np
import pyarrow as pa
import pytest
from places import ROOT

from dyknow.converters import WireError
from dyknow.converters.arrow.stream import encode_arrow
from dyknow.converters.ndjson import encode_ndjson
from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.recordings.table_options import TableOptions
from dyknow.streams.sample import FieldType, concatenate
from dyknow.streams.time import SECOND

EXAMPLE = ROOT / "examples" / "adsb.csv.gz"


@pytest.fixture
def table(tmp_path):
    def write(text, name="table.csv"):
        path = tmp_path / name
        data = text if isinstance(text, bytes) else text.encode()
        path.write_bytes(gzip.compress(data) if name.endswith(".gz") else data)
        return path

    return write


def types(recording):
    return {field.name: str(field.type) for field in recording.schema.fields}


def rows(recording):
    return [row for incoming in recording for row in incoming.batch.rows()]


def test_types_are_the_narrowest_that_hold_every_cell(table):
    recording = open_recording(
        table(
            "time,i,f,e,b,zero,hexlike,icao24,mixed,none,vehicleId,long\n"
            "1,1,1,1e-5,True,007,4841e3,484136,1,,7,12345678901234567890\n"
            "2,-2,.5,1.0E3,false,1,4841e4,484137,x,,8,1\n"
            "3,,,,,,,,,,,\n"
        )
    )
    assert types(recording) == {
        "i": "integer",
        "f": "float",
        "e": "float",
        "b": "boolean",
        "zero": "string",
        "hexlike": "string",
        "icao24": "string",
        "mixed": "string",
        "none": "string",
        "vehicleId": "string",
        "long": "string",
    }
    assert recording.rows == 3
    assert rows(recording)[1][2]["e"] == 1000.0
    assert rows(recording)[0][2]["hexlike"] == "4841e3"
    assert all(value is None for value in rows(recording)[2][2].values())


def test_types_can_be_given(table):
    path = table("t,id,x\n1,5,1\n")
    given = {"id": FieldType.INTEGER, "x": FieldType.FLOAT}
    assert types(open_recording(path, types=given)) == {"id": "integer", "x": "float"}
    with pytest.raises(WireError, match="no column 'y'"):
        open_recording(path, types={"y": FieldType.FLOAT})


@pytest.mark.parametrize(
    ("cell", "unit", "time"),
    [
        ("1633608001", None, 1633608001 * SECOND),
        ("1633608001.25", None, 1633608001 * SECOND + 250_000_000),
        ("1633608001000", None, 1633608001 * SECOND),
        ("1633608001000001", None, 1633608001 * SECOND + 1000),
        ("1633608001000000001", None, 1633608001 * SECOND + 1),
        ("1000", "ms", SECOND),
        ("0.5", "s", SECOND // 2),
        ("2021-10-07T12:00:01Z", None, 1633608001 * SECOND),
        ("2021-10-07 12:00:01+00:00", None, 1633608001 * SECOND),
    ],
)
def test_times(table, cell, unit, time):
    recording = open_recording(table(f"timestamp,x\n{cell},1\n"), TableOptions(time_unit=unit))
    assert [row[1] for row in rows(recording)] == [time]


def test_rows_of_one_time_are_an_instant_and_a_step_back_joins_it(table):
    recording = open_recording(table("time,x\n5,1\n5,2\n4,3\n6,4\n"), TableOptions(time_unit="ns"))
    assert [row[:2] for row in rows(recording)] == [(5, 5), (5, 5), (5, 4), (6, 6)]
    assert rows(recording) == rows(recording)


def test_an_available_column_is_kept(table):
    recording = open_recording(
        table("valid,available,x\n5,9,1\n5,8,2\n"), TableOptions(time_unit="ns")
    )
    assert [row[:2] for row in rows(recording)] == [(9, 5), (8, 5)]
    assert recording.schema.names == ("x",)


def test_the_time_column_can_be_named(table):
    path = table("when,x\n5,1\n")
    assert len(rows(open_recording(path, TableOptions(time_column="when")))) == 1
    with pytest.raises(WireError, match="no column is called valid") as caught:
        open_recording(path)
    assert "when, x" in caught.value.hint
    with pytest.raises(WireError, match="there is no column 'y'"):
        open_recording(path, TableOptions(time_column="y"))


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", 1, "empty"),
        ("time,x\n", 1, "no rows"),
        ("\ntime,x\n1,2\n", 1, "first line is empty"),
        (",\n1,2\n", 1, "column 1 has no name"),
        ("time,time\n1,2\n", 1, "twice"),
        ("time,\n1,2\n", 1, "no name"),
        ("time,x\n1,2\n\n3\n", 4, "1 cells, but the header has 2"),
        ("time,x\n1,2\nsoon,2\n", 3, "'time'"),
        ("time,x\n1,2\n,2\n", 3, "'time'"),
        ('time,x\n1,"a\nb"\n2,c,d\n', 4, "3 cells"),
        ("time,x\n1,1.5\n2,1.5e999\n", 3, "column 'x' is float"),
        (b"time,x\n1,\xff\n", None, "cannot be read"),
    ],
)
def test_a_bad_table_names_its_line(table, text, line, message):
    with pytest.raises(WireError, match=message) as caught:
        rows(open_recording(table(text)))
    assert line is None or caught.value.line == line


def test_a_declared_type_is_checked(table):
    path = table("time,x\n1,1\n2,nan\n")
    with pytest.raises(WireError, match="'x' is float, got 'nan'") as caught:
        rows(open_recording(path, types={"x": FieldType.FLOAT}))
    assert caught.value.line == 3


def test_ndjson_tables(table):
    text = '{"time": 1, "x": 1, "id": 7}\n\n{"time": 2, "x": 1.5, "y": "a", "id": 8}\n'
    recording = open_recording(table(text, "table.ndjson.gz"), TableOptions(time_unit="s"))
    assert types(recording) == {"x": "float", "id": "integer", "y": "string"}
    assert rows(recording) == [
        (SECOND, SECOND, {"x": 1.0, "id": 7, "y": None}),
        (2 * SECOND, 2 * SECOND, {"x": 1.5, "id": 8, "y": "a"}),
    ]


@pytest.mark.parametrize(
    ("line", "message"),
    [("{", "not JSON"), ("[]", "object"), ('{"time": 1, "x": {}}', "nested"), ('{"x": 1}', "time")],
)
def test_bad_ndjson_tables_name_their_line(table, line, message):
    with pytest.raises(WireError, match=message) as caught:
        rows(open_recording(table('{"time": 1, "x": 1}\n' + line, "table.ndjson")))
    assert caught.value.line == 2


def test_all_formats_hold_the_same_recording(table):
    recording = open_recording(EXAMPLE)
    whole = concatenate([incoming.batch for incoming in recording]).take(slice(0, 200))
    expected = list(whole.rows())
    for name, data in (
        ("table.ndjson", encode_ndjson(whole)),
        ("table.arrow", encode_arrow(whole)),
    ):
        again = open_recording(table(data, name))
        assert rows(again) == expected
        assert types(again) == types(recording)


def test_arrow_files(table):
    sink = pa.BufferOutputStream()
    data = pa.table({"time": [1, 2], "x": [1.0, None]})
    with pa.ipc.new_file(sink, data.schema) as writer:
        writer.write_table(data)
    recording = open_recording(
        table(sink.getvalue().to_pybytes(), "t.arrow"), TableOptions(time_unit="s")
    )
    assert rows(recording) == [(SECOND, SECOND, {"x": 1.0}), (2 * SECOND, 2 * SECOND, {"x": None})]


def test_an_unknown_ending(table):
    with pytest.raises(WireError, match="unknown kind"):
        open_recording(table("x", "table.xls"))


def test_the_example_is_what_its_readme_says():
    recording = open_recording(EXAMPLE)
    assert EXAMPLE.stat().st_size < 500_000
    assert types(recording) == {
        "icao24": "string",
        "callsign": "string",
        "latitude": "float",
        "longitude": "float",
        "altitude": "integer",
        "groundspeed": "integer",
        "track": "float",
        "vertical_rate": "integer",
        "onground": "boolean",
    }
    batch = concatenate([incoming.batch for incoming in recording])
    assert len(batch) == recording.rows == 8256
    assert len(set(batch.columns["icao24"].tolist())) == 30
    assert (batch.valid[-1] - batch.valid[0]) / SECOND == 299
    assert np.all(batch.available[1:] >= batch.available[:-1])
    fastest: dict = {}
    pairs = zip(
        batch.columns["icao24"].tolist(), batch.columns["groundspeed"].tolist(), strict=True
    )
    for aircraft, knots in pairs:
        fastest[aircraft] = max(knots * 1.852, fastest.get(aircraft, 0))
    assert sum(speed > 800 for speed in fastest.values()) == 5
    assert sum(speed < 260 for speed in fastest.values()) == 3


def test_ndjson_with_a_byte_order_mark(tmp_path):
    path = tmp_path / "a.ndjson"
    path.write_bytes(b'\xef\xbb\xbf{"valid": 1, "a": 2}\n')
    assert open_recording(path).rows == 1


def test_ndjson_nested_deeply(tmp_path):
    path = tmp_path / "a.ndjson"
    path.write_bytes(b'{"valid": 1, "a": 2}\n' + b"[" * 5000)
    with pytest.raises(WireError, match="nested too deeply") as caught:
        open_recording(path)
    assert caught.value.line == 2


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_refused_at_once(tmp_path):
    """It was waited for a second time, for ever."""
    pipe = tmp_path / "a.csv"
    os.mkfifo(pipe)
    with pytest.raises(WireError, match="is a pipe"):
        open_recording(pipe)
