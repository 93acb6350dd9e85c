"""Parquet files, written by pyarrow: the fields and times of the same table in Arrow."""

from datetime import UTC, datetime

import pyarrow as pa
import pytest
from pyarrow import parquet

from dyknow.converters import WireError
from dyknow.converters.recordings.many_streams import open_recordings
from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.recordings.table_options import TableOptions
from dyknow.streams.sample import FieldType
from dyknow.streams.time import SECOND


def rows(recording):
    return [row for incoming in recording for row in incoming.batch.rows()]


def tables():
    times = [1633615801, 1633615802, 1633615802]
    values = {"id": ["a", "b", "a"], "x": [1.5, None, 2.5], "n": [1, 2, None], "b": [True] * 3}
    coded = {**values, "id": pa.array(values["id"]).dictionary_encode()}
    moments = [datetime.fromtimestamp(time, UTC) for time in times]
    for unit in ("s", "ms", "us", "ns"):
        stamps = pa.array(moments, pa.timestamp(unit, "UTC"))
        yield pa.table({"time": stamps, **values})
    yield pa.table({"timestamp": times, **coded})
    yield pa.table({"t": pa.array(times, pa.float64()), "available": times, **values})


@pytest.mark.parametrize("table", list(tables()), ids=lambda table: str(table.schema.types[0]))
@pytest.mark.parametrize("pack", ["snappy", "none", "gzip"])
def test_it_is_read_as_arrow_is(tmp_path, table, pack):
    parquet.write_table(table, tmp_path / "a.parquet", compression=pack, row_group_size=2)
    with pa.ipc.new_file(str(tmp_path / "b.arrow"), table.schema) as writer:
        writer.write_table(table)
    found, other = (open_recording(tmp_path / name) for name in ("a.parquet", "b.arrow"))
    assert rows(found) == rows(other)
    assert found.schema == other.schema
    assert rows(found)[0] == (
        1633615801 * SECOND,
        1633615801 * SECOND,
        {"id": "a", "x": 1.5, "n": 1, "b": True},
    )


def test_options_and_types_apply(tmp_path):
    path = tmp_path / "a.pq"
    parquet.write_table(pa.table({"when": ["07.10.2021 14:10:01"], "n": [1]}), path)
    options = TableOptions(time_column="when", time_format="day-first")
    recording = open_recording(path, options, {"n": FieldType.FLOAT})
    assert rows(recording)[0][1:] == (1633615801 * SECOND, {"n": 1.0})


def test_a_folder_may_have_parquet_files(tmp_path):
    parquet.write_table(pa.table({"t": [1], "n": [1]}), tmp_path / "first.parquet")
    (tmp_path / "second.csv").write_text("t,n\n1,1\n")
    assert list(open_recordings([tmp_path])) == ["first", "second"]


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"t": [], "n": []}, "no rows"),
        ({"t": [1], "n": [[1]]}, "column 'n' is list"),
        ({"n": [1]}, "no column is called valid"),
        ({"t": [1, None]}, "'t' is missing"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, table, message):
    parquet.write_table(pa.table(table), tmp_path / "a.parquet")
    with pytest.raises(WireError, match=message):
        open_recording(tmp_path / "a.parquet")


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "a.parquet"
    parquet.write_table(pa.table({"t": [1], "n": [1]}), path)
    whole = path.read_bytes()
    for data in (b"", b"time,x\n1,2\n", whole[:-1], whole[10:]):
        path.write_bytes(data)
        with pytest.raises(WireError, match=r"a.parquet: this is no Parquet file"):
            open_recording(path)


def test_a_pipe_of_parquet_is_refused():
    import io

    from dyknow.converters.recordings.piped import open_pipe

    with pytest.raises(WireError, match="CSV or NDJSON only"):
        open_pipe(io.BytesIO(b"PAR1\x15\x04\n"))
