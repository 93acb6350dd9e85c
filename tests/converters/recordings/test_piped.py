"""A table by a pipe against the same table as a file: same samples, however the pipe cuts it."""

import csv
import io
import json

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dyknow.converters.errors import EmptyTable, WireError
from dyknow.converters.recordings import piped as piped_module
from dyknow.converters.recordings.piped import HEAD, open_pipe
from dyknow.converters.recordings.recording import open_recording
from dyknow.converters.recordings.time_order import in_time_order
from dyknow.streams.sample import FieldType

LAWS = settings(deadline=None, max_examples=150)


class Pipe:
    """Gives ``data`` in parts that end at ``cuts``; ``given`` counts the bytes so far."""

    def __init__(self, data, cuts=()):
        self.ends = [*sorted({cut for cut in cuts if 0 < cut < len(data)}), len(data)]
        self.data, self.given = data, 0

    def read1(self, size):
        while self.ends and self.ends[0] <= self.given:
            self.ends.pop(0)
        end = min(self.ends[0] if self.ends else self.given, self.given + size)
        part, self.given = self.data[self.given : end], end
        return part


def told(recording):
    return [row for incoming in recording for row in incoming.batch.rows()]


def as_csv(rows, names):
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(names)
    writer.writerows([[row.get(name) for name in names] for row in rows])
    return text.getvalue().encode()


def as_ndjson(rows, names):
    lines = [json.dumps({name: row.get(name) for name in names}) for row in rows]
    return "\n".join(lines).encode()


rows = st.lists(
    st.fixed_dictionaries(
        {
            "t": st.integers(10**9, 10**9 + 50),
            "available": st.integers(10**9, 10**9 + 50),
            "n": st.one_of(st.none(), st.integers(-5, 5)),
            "x": st.one_of(st.none(), st.floats(-1, 1)),
            "text": st.sampled_from(["a", "é\n,", '"', "long" * 9]),
        }
    ),
    min_size=1,
    max_size=30,
)
ROW = {"t": 10**9, "available": 10**9, "n": 1, "x": 0.5, "text": "a"}


@LAWS
@given(
    rows,
    st.lists(st.integers(0, 2000), max_size=12),
    st.booleans(),
    st.booleans(),
    st.sampled_from([1, 2, 3, 1000]),
    st.booleans(),
)
@example([ROW, ROW | {"t": 10**9 - 5}], [40, 60], True, False, 1, True)
def test_a_pipe_gives_what_the_file_gives(
    tmp_path_factory, given_rows, cuts, is_csv, is_stamped, head, is_declared
):
    names = ["t", "n", "x", "text", *(["available"] if is_stamped else [])]
    data = (as_csv if is_csv else as_ndjson)(given_rows, names)
    path = tmp_path_factory.mktemp("p") / ("a.csv" if is_csv else "a.ndjson")
    path.write_bytes(data)
    types = {
        "n": FieldType.INTEGER,
        "x": FieldType.FLOAT,
        "text": FieldType.STRING,
    }
    known = types if is_declared else {}
    file = open_recording(path, types=known)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(piped_module, "HEAD", head if is_declared else HEAD)
        piped = open_pipe(Pipe(data, cuts), types=known)
        assert piped.recording.schema == file.schema
        assert piped.rows == 0
        assert told(piped.recording) == told(file)
    order = in_time_order(file, sort=False)
    assert (piped.rows, piped.out_of_order) == (len(given_rows), order.out_of_order)
    key = "available" if is_stamped else "t"
    assert piped.last == max(row[key] for row in given_rows) * 10**9
    assert piped.first == given_rows[0][key] * 10**9
    assert (piped.note is None) == (order.out_of_order == 0)


def test_rows_are_given_as_they_come():
    """A pipe that waits holds back no whole row, once the head is there."""
    lines = [b"t,n\n", *(b"%d,%d\n" % (second, second) for second in range(1, 9))]
    ends = [sum(map(len, lines[:count])) for count in range(1, len(lines) + 1)]
    pipe = Pipe(b"".join(lines), ends)
    piped = open_pipe(pipe, types={"n": FieldType.INTEGER})
    for count, incoming in enumerate(piped.recording, 1):
        assert incoming.batch.columns["n"].tolist() == [count]
        assert pipe.given == ends[count]


def test_the_head_decides_the_types():
    rows = [b"%d,%d\n" % (n + 1, n) for n in range(HEAD)]
    data = b"t,n\n" + b"".join(rows)
    assert open_pipe(Pipe(data)).recording.schema.fields[0].type is FieldType.INTEGER
    piped = open_pipe(Pipe(data + b"2000,1.5\n"))
    with pytest.raises(WireError, match=r"line 1002: column 'n' is integer, got '1.5'"):
        told(piped.recording)
    first = data.replace(b"1,0\n", b"1,0.5\n", 1)
    piped = open_pipe(Pipe(first + b"2000,1.5\n"))
    assert piped.recording.schema.fields[0].type is FieldType.FLOAT
    assert len(told(piped.recording)) == HEAD + 1


def test_fields_that_the_head_does_not_have():
    head = b"".join(b'{"t": %d, "n": 1}\n' % (n + 1) for n in range(HEAD))
    piped = open_pipe(Pipe(head + b'{"t": 2000, "n": 1, "m": 2}\n'))
    with pytest.raises(WireError, match="line 1001: field 'm' is not in the head of the pipe"):
        told(piped.recording)
    stamped = head.replace(b'"n"', b'"available": 5, "n"')
    piped = open_pipe(Pipe(stamped + b'{"t": 2000, "n": 1}\n'))
    with pytest.raises(WireError, match="line 1001: 'available' is in some samples"):
        told(piped.recording)
    declared = {"n": FieldType.INTEGER, "m": FieldType.FLOAT}
    piped = open_pipe(Pipe(b'{"t": 1, "n": 1}\n{"t": 2, "m": 2}\n'), types=declared)
    assert [values for _, _, values in told(piped.recording)] == [
        {"n": 1, "m": None},
        {"n": None, "m": 2.0},
    ]


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x1f\x8b\x08rest", "gzip -dc"),
        (b"ARROW1\0\0\n", "CSV or NDJSON"),
        (b"\xff\xff\xff\xff\x10\0\0\0\n", "CSV or NDJSON"),
        (b'{"stream": "s", "t": 1}\n', "name their streams"),
        (b"a,b\n1,2\n", "no column is called"),
        (b"t,a,a\n1,2,3\n", "column 'a' is there twice"),
        (b"t,a\n1\n", "line 2: 1 cells"),
        (b't\n"', "the table cannot be read"),
        (b"t,a\n1,\xff\n", "the table cannot be read"),
        (b"{t: 1}\n", "line 1: not JSON"),
        (b"t,a\nsoon,1\n", "line 2: 't'"),
    ],
)
def test_what_is_no_table_is_refused(data, message):
    with pytest.raises(WireError) as refused:
        told(open_pipe(Pipe(data)).recording)
    assert message in str(refused.value)


@pytest.mark.parametrize("data", [b"", b"\n\n", b"t,a\n", b"t,a\n\n\n"])
def test_a_pipe_without_rows(data):
    for types in ({}, {"a": FieldType.FLOAT}):
        with pytest.raises(EmptyTable):
            open_pipe(Pipe(data), types=types)


def test_a_line_without_end_is_refused(monkeypatch):
    monkeypatch.setattr(piped_module, "LONGEST_LINE", 1000)
    with pytest.raises(WireError, match="a line has more than 1,000 bytes"):
        open_pipe(Pipe(b"t,a\n" + b"x" * 2000))
