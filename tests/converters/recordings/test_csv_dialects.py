"""Dialects of CSV: delimiters, decimal commas, spellings of times, compression by content."""

import gzip

import pytest

from dyknow.converters import WireError
from dyknow.converters.recordings import text_files
from dyknow.converters.recordings.csv_dialect import delimiter_of, detect_delimiter
from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.recordings.table_options import TableOptions
from dyknow.converters.time_format import spelling_hint, time_parser
from dyknow.streams.sample import FieldType
from dyknow.streams.time import format_time, parse_time


@pytest.fixture
def table(tmp_path):
    def write(text, name="table.csv"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def types(recording):
    return {field.name: str(field.type) for field in recording.schema.fields}


def values(recording):
    return [row[2] for incoming in recording for row in incoming.batch.rows()]


def times(recording):
    return [format_time(row[1]) for incoming in recording for row in incoming.batch.rows()]


@pytest.mark.parametrize(
    ("header", "mark"),
    [
        ("time,x", ","),
        ("time;x", ";"),
        ("time\tx", "\t"),
        ("time|x", "|"),
        ("time", ","),
        ("time;position (x, y);speed", ";"),
        ('time,"x;y;z",v', ","),
    ],
)
def test_the_delimiter_is_in_the_header(header, mark):
    assert detect_delimiter(header) == mark


@pytest.mark.parametrize("mark", [",", ";", "\t", "|"])
def test_a_table_with_each_delimiter(table, mark):
    recording = open_recording(table(f"time{mark}id{mark}x\n1{mark}a{mark}2\n"))
    assert values(recording) == [{"id": "a", "x": 2}]


def test_a_header_that_leaves_the_delimiter_open(table):
    path = table("time;x, m\n1;2,5\n")
    with pytest.raises(WireError, match="',' and ';' both cut the header into 2 columns") as caught:
        open_recording(path)
    assert "--delimiter ';'" in caught.value.hint
    assert values(open_recording(path, TableOptions(delimiter=";"))) == [{"x, m": 2.5}]


def test_a_delimiter_can_be_given(table):
    recording = open_recording(table("time:x\n1:2\n"), TableOptions(delimiter=":"))
    assert values(recording) == [{"x": 2}]
    assert delimiter_of("tab") == "\t"
    with pytest.raises(ValueError, match="one character"):
        delimiter_of(";;")


def test_decimal_commas_stand_with_semicolons(table):
    recording = open_recording(
        table("time;x;n;text;id\n1,5;1,25;7;a,b;1,5\n2,5;1,234;8;1,2,3;1,6\n3;;9;;\n")
    )
    assert types(recording) == {"x": "float", "n": "integer", "text": "string", "id": "string"}
    assert [row["x"] for row in values(recording)] == [1.25, 1.234, None]
    assert [row["id"] for row in values(recording)] == ["1,5", "1,6", None]
    assert times(recording)[0] == "1970-01-01T00:00:01.5Z"


def test_a_comma_in_another_table_is_no_decimal_comma(table):
    assert types(open_recording(table('time,x\n1,"1,5"\n'))) == {"x": "string"}


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("time;x\n1;1\n2;1,234\n", 3, "column 'x': '1,234' may be 1.234 or 1234"),
        ("time;x;y\n1;1,5;\n2;;2.5\n", 2, "column 'x' has '1,5'.* column 'y' has '2.5'.* line 3"),
        ("time;x\n1;1,5\n2;2.5\n", 2, "column 'x' has '1,5', with a comma"),
    ],
)
def test_decimal_marks_that_are_not_clear_are_named(table, text, line, message):
    with pytest.raises(WireError, match=message) as caught:
        open_recording(table(text))
    assert caught.value.line == line


def test_numbers_that_stay_text_keep_their_commas(table):
    text = "time;x;y\n1;007,5;1,5\n2;1,5;2,5\n"
    assert values(open_recording(table(text)))[0] == {"x": "007,5", "y": 1.5}
    given = open_recording(table(text), types={"y": FieldType.STRING})
    assert values(given)[0]["y"] == "1,5"


@pytest.mark.parametrize(
    ("format", "cell", "time"),
    [
        ("day-first", "07.10.2021 14:10:01", "2021-10-07T14:10:01Z"),
        ("day-first", "7/1/2021 9:05", "2021-01-07T09:05:00Z"),
        ("day-first", "7-1-2021", "2021-01-07T00:00:00Z"),
        ("day-first", "07.10.2021 14:10:01,123456789", "2021-10-07T14:10:01.123456789Z"),
        ("day-first", "07.10.2021 14:10:01+02:00", "2021-10-07T12:10:01Z"),
        ("%d.%m.%Y %H:%M:%S", "07.10.2021 14:10:01", "2021-10-07T14:10:01Z"),
        ("%m/%d/%Y %I:%M %p", "10/07/2021 02:10 PM", "2021-10-07T14:10:00Z"),
        ("%d %b %Y %H:%M:%S.%f %z", "07 Oct 2021 14:10:01.25 +0200", "2021-10-07T12:10:01.25Z"),
        ("%Y%m%d%H%M%S", "20211007141001", "2021-10-07T14:10:01Z"),
    ],
)
def test_times_of_another_spelling(table, format, cell, time):
    options = TableOptions(time_format=format)
    assert times(open_recording(table(f'time,x\n"{cell}",1\n'), options)) == [time]
    line = f'{{"time": "{cell}", "x": 1}}\n'
    assert times(open_recording(table(line, "table.ndjson"), options)) == [time]


@pytest.mark.parametrize(
    ("cell", "message", "hint"),
    [
        ("03.04.2021 10:00", "may begin with the day", "day-first, or --time-format '%m.%d.%Y %H"),
        ("31/12/2021 10:00:01", "is no time", "days first is read with --time-format day-first"),
        ("12/31/2021 10:00 PM", "is no time", "--time-format '%m/%d/%Y %I:%M %p'"),
        ("2021/12/31 10:00:01.5", "is no time", "--time-format '%Y/%m/%d %H:%M:%S.%f'"),
        ("noon", "is no time", "--time-format '%d.%m.%Y %H:%M:%S'"),
    ],
)
def test_a_time_that_cannot_be_read_suggests_its_format(table, cell, message, hint):
    recording = open_recording(table(f"time,x\n2021-10-07 00:00,1\n{cell},1\n"))
    with pytest.raises(WireError, match=message) as caught:
        times(recording)
    assert caught.value.line == 3
    assert "'time'" in caught.value.message
    assert hint in caught.value.hint


@pytest.mark.parametrize(
    "cell", ["12/31/2021 10:00 PM", "12/31/2021 10:00:05.5", "2021/12/31 10:00:01.5", "12.31.2021"]
)
def test_a_suggested_pattern_reads_the_time(cell):
    """The months of an ambiguous date are as those of a clear one."""
    _, hint = spelling_hint(cell)
    pattern = hint.split("'")[1]
    assert time_parser(pattern)(cell) // 10**9 >= parse_time("2021-12-31T00:00:00Z") // 10**9


def test_a_time_that_does_not_fit_its_format(table):
    options = TableOptions(time_format="day-first")
    with pytest.raises(
        WireError, match="'time': \"2021-10-07\" is no time of the format"
    ) as caught:
        times(open_recording(table("time,x\n07.10.2021,1\n2021-10-07,1\n"), options))
    assert caught.value.line == 3
    with pytest.raises(WireError, match="outside signed 64-bit"):
        times(open_recording(table("time,x\n01.01.1000,1\n"), TableOptions(time_format="%d.%m.%Y")))


@pytest.mark.parametrize(
    ("format", "message"), [("%H:%M", "has no year"), ("%Y %Q", "no time format"), ("", "no year")]
)
def test_a_bad_format_is_refused_before_the_table_is_read(format, message):
    with pytest.raises(WireError, match=message):
        TableOptions(time_format=format).times()


@pytest.mark.parametrize(
    ("name", "text"),
    [("table.csv", b"time,x\n1,2\n"), ("table.ndjson", b'{"time": 1, "x": 2}\n')],
)
def test_gzip_is_known_by_its_bytes(table, name, text):
    """A name says nothing: neither that a file is compressed nor that it is not."""
    for data in (text, gzip.compress(text)):
        for ending in ("", ".gz"):
            assert values(open_recording(table(data, name + ending))) == [{"x": 2}]


@pytest.mark.parametrize("name", ["table.csv", "table.ndjson"])
def test_a_damaged_gzip_file_is_an_error(table, name):
    if name == "table.csv":
        line, row = b"time,x\n", b"%d,%d\n"
    else:
        line, row = b"", b'{"time": %d, "x": %d}\n'
    rows = b"".join(row % (i, i * i) for i in range(9999))
    packed = gzip.compress(line + rows)
    with pytest.raises(WireError, match="cannot be read"):
        open_recording(table(packed[:15], name))
    for place in range(20, len(packed), 2999):
        flipped = bytearray(packed)
        flipped[place] ^= 255
        for data in (packed[:place], bytes(flipped)):
            with pytest.raises(WireError):
                values(open_recording(table(data, name)))


@pytest.mark.parametrize(
    ("name", "line"), [("table.csv", b"time,x\n"), ("table.ndjson", b'{"time": 1, "x": 2}\n')]
)
def test_a_line_without_end_does_not_fill_the_memory(table, name, line, monkeypatch):
    """A compressed file of a few kB may expand to gigabytes."""
    monkeypatch.setattr(text_files, "LONGEST_LINE", 1000)
    with pytest.raises(WireError, match="more than 1,000 characters") as caught:
        open_recording(table(gzip.compress(line + b"9" * 1_000_000), name))
    assert caught.value.line == 2
