"""NDJSON, CSV and Arrow: what is taken, what is refused, and where."""

import builtins

import msgspec
import numpy as np
import pyarrow as pa
import pytest

from dyknow.converters import WireError
from dyknow.converters.arrow.stream import (
    ArrowMissing,
    bytes_of_table,
    decode_arrow,
    encode_arrow,
)
from dyknow.converters.csv_table import encode_csv
from dyknow.converters.ndjson import decode_ndjson, encode_ndjson, sample_json
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows

SCHEMA = Schema(
    (
        Field("id", FieldType.STRING),
        Field("alt", FieldType.FLOAT),
        Field("n", FieldType.INTEGER),
        Field("up", FieldType.BOOLEAN),
    )
)
GOOD = b'{"valid": 1, "id": "a", "alt": 1.5, "n": 2, "up": true}\n'


def test_a_batch_without_available_times_is_to_be_stamped():
    incoming = decode_ndjson(
        b'\n{"valid":"1970-01-01T00:00:01Z","id":"a","alt":2,"n":null,"up":null}\r\n' + GOOD,
        SCHEMA,
        {},
    )
    assert incoming.stamped
    assert list(incoming.batch.rows()) == [
        (10**9, 10**9, {"id": "a", "alt": 2.0, "n": None, "up": None}),
        (1, 1, {"id": "a", "alt": 1.5, "n": 2, "up": True}),
    ]


def test_available_times_are_kept():
    line = GOOD.replace(b'"valid": 1', b'"valid": 1, "available": "1970-01-01T00:00:02+00:00"')
    incoming = decode_ndjson(line, SCHEMA, {})
    assert not incoming.stamped
    assert incoming.batch.available.tolist() == [2 * 10**9]


def bad(old, new):
    return GOOD + b"\n" + GOOD.replace(old, new) + GOOD


@pytest.mark.parametrize(
    ("data", "line", "message", "hint"),
    [
        (b"", None, "no sample", "at least one"),
        (b"\n \n", None, "no sample", "at least one"),
        (bad(b"{", b""), 3, "not JSON", "one JSON object a line"),
        (bad(b"1.5", b"NaN"), 3, "NaN and Infinity", "null"),
        (bad(b"1.5", b"-Infinity"), 3, "NaN and Infinity", "null"),
        (bad(b"1.5", b"1e999"), 3, "larger than a float", "null"),
        (bad(b"1.5", b'"1.5"'), 3, "field 'alt' is a float, got \"1.5\"", ""),
        (bad(b"1.5", b"true"), 3, "field 'alt' is a float, got true", ""),
        (bad(b'"n": 2', b'"n": 2.5'), 3, "field 'n' is an integer, got 2.5", ""),
        (bad(b'"n": 2', b'"n": 9223372036854775808'), 3, "outside 64 bits", ""),
        (bad(b'"n": 2', b'"n": -9223372036854775809'), 3, "outside 64 bits", ""),
        (bad(b'"a"', b"7"), 3, "field 'id' is a string, got 7", ""),
        (bad(b'"a"', b'["a"]'), 3, "field 'id' is a string", ""),
        (bad(b"true", b"1"), 3, "field 'up' is a boolean, got 1", ""),
        (bad(b', "alt": 1.5', b""), 3, "'alt' is missing", "null"),
        (bad(b'"valid": 1, ', b""), 3, "'valid' is missing", "valid time"),
        (bad(b'"up"', b'"z": 1, "up"'), 3, "'z' is not declared", "id, alt, n, up"),
        (bad(b'"valid": 1', b'"valid": "yesterday"'), 3, "'valid'", "ISO-8601"),
        (bad(b'"valid": 1', b'"valid": "2021-13-01T00:00:00Z"'), 3, "'valid'", "ISO-8601"),
        (bad(b'"valid": 1', b'"valid": null'), 3, "'valid' is a time, got null", "ISO-8601"),
        (bad(b'"valid": 1', b'"valid": true'), 3, "'valid' is a time, got true", "ISO-8601"),
        (
            bad(b'"valid": 1', b'"valid": "2021-10-07T19:12:53.1234567891Z"'),
            3,
            "finer than a nanosecond",
            "ISO-8601",
        ),
        (bad(b'"valid": 1', b'"valid": 1.5'), 3, "'valid' is a time", "ISO-8601"),
        (bad(b'"valid": 1', b'"valid": 9223372036854775808'), 3, "64-bit", "ISO-8601"),
        (bad(b'"valid": 1', b'"valid": 1, "available": 2'), 3, "in some samples", "every"),
        (GOOD + b"[1]\n", 2, "a sample is a JSON object, got [1]", ""),
        (GOOD + b"\xff\n", 2, "not JSON", ""),
        (GOOD.strip() + GOOD, 1, "not JSON", "one JSON object a line"),
        (GOOD.replace(b", ", b",\n"), 1, "not JSON", "one JSON object a line"),
        (GOOD.strip() + GOOD + GOOD.replace(b", ", b",\n", 1), 1, "not JSON", "a line"),
        (bad(b'"n": 2', b'"n": 9223372036854775808') + b"{\n", 3, "outside 64 bits", ""),
        (bad(b'"valid": 1', b'"n": 2, "valid": 1') + b"{\n", 3, "'n' is there twice", ""),
    ],
)
def test_a_bad_line_refuses_the_whole_batch(data, line, message, hint):
    pools = {}
    with pytest.raises(WireError) as caught:
        decode_ndjson(data, SCHEMA, pools)
    assert caught.value.line == line
    assert message in caught.value.message
    assert hint in caught.value.hint
    assert not pools


def test_a_field_cannot_be_called_like_a_time():
    schema = Schema((Field("valid", FieldType.FLOAT),))
    with pytest.raises(WireError, match="cannot be called"):
        decode_ndjson(b"{}", schema, {})


def test_a_sample_is_written_with_iso_times():
    assert sample_json(1_500_000_000, 0, {"x": None}) == {
        "available": "1970-01-01T00:00:01.5Z",
        "valid": "1970-01-01T00:00:00Z",
        "x": None,
    }
    incoming = decode_ndjson(GOOD, SCHEMA, {})
    assert msgspec.json.decode(encode_ndjson(incoming.batch)) == {
        "available": "1970-01-01T00:00:00.000000001Z",
        "valid": "1970-01-01T00:00:00.000000001Z",
        "id": "a",
        "alt": 1.5,
        "n": 2,
        "up": True,
    }


def test_csv_out():
    rows = [
        (10**9, 0, {"id": 'a,"b"', "alt": 1.5, "n": 2, "up": True}),
        (2 * 10**9, 0, dict.fromkeys(SCHEMA.names)),
    ]
    assert encode_csv(batch_from_rows(SCHEMA, rows)).decode() == (
        "available,valid,id,alt,n,up\n"
        '1970-01-01T00:00:01Z,1970-01-01T00:00:00Z,"a,""b""",1.5,2,true\n'
        "1970-01-01T00:00:02Z,1970-01-01T00:00:00Z,,,,\n"
    )


def arrow_bytes(**columns):
    table = pa.table(columns)
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, table.schema) as writer:
        writer.write_table(table)
    return sink.getvalue().to_pybytes()


ARROW = {
    "valid": pa.array([1, 2], pa.timestamp("ms")),
    "id": pa.array(["a", None]).dictionary_encode(),
    "alt": pa.array([1, None], pa.int32()),
    "n": pa.array([1, 2], pa.uint64()),
    "up": pa.array([None, None], pa.null()),
}


def test_arrow_columns_of_kindred_types_are_taken():
    incoming = decode_arrow(arrow_bytes(**ARROW), SCHEMA, {})
    assert incoming.stamped
    assert list(incoming.batch.rows()) == [
        (10**6, 10**6, {"id": "a", "alt": 1.0, "n": 1, "up": None}),
        (2 * 10**6, 2 * 10**6, {"id": None, "alt": None, "n": 2, "up": None}),
    ]


@pytest.mark.parametrize(
    ("change", "line", "message"),
    [
        ({"alt": pa.array([1.0, np.nan])}, 2, "must be finite"),
        ({"alt": pa.array([-np.inf, 1.0])}, 1, "must be finite"),
        ({"alt": pa.array(["1", "2"])}, None, "'alt' is float, got string"),
        ({"n": pa.array([1.0, 2.0])}, None, "'n' is integer, got double"),
        ({"n": pa.array([1, 2**63], pa.uint64())}, 2, "outside 64 bits"),
        ({"valid": pa.array([1, None], pa.int64())}, 2, "'valid' is missing"),
        ({"valid": pa.array([0, 2**40], pa.timestamp("s"))}, 2, "64-bit"),
        ({"z": pa.array([1, 2])}, None, "'z' is not declared"),
        ({"id": None}, None, "'id' is missing"),
        ({"id": pa.array([b"a", b"b"])}, None, "column 'id' is binary"),
    ],
)
def test_bad_arrow_is_refused(change, line, message):
    columns = {name: array for name, array in (ARROW | change).items() if array is not None}
    pools = {}
    with pytest.raises(WireError, match=message) as caught:
        decode_arrow(arrow_bytes(**columns), SCHEMA, pools)
    assert caught.value.line == line
    assert not pools


@pytest.mark.parametrize("data", [b"", b"no arrow", GOOD])
def test_bytes_that_are_no_arrow(data):
    with pytest.raises(WireError, match=r"empty|Arrow"):
        decode_arrow(data, SCHEMA, {})


def test_arrow_without_samples():
    with pytest.raises(WireError, match="no sample"):
        decode_arrow(encode_arrow(batch_from_rows(SCHEMA, [])), SCHEMA, {})


def test_without_pyarrow_the_error_says_how_to_get_it(monkeypatch):
    original = builtins.__import__

    def missing(name, *args):
        if name == "pyarrow":
            raise ImportError(name)
        return original(name, *args)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ArrowMissing, match=r"pip install 'dyknow\[arrow\]'"):
        decode_arrow(b"", SCHEMA, {})


@pytest.mark.parametrize(
    "line",
    [
        b"[" * 2000,
        b'{"a":' * 100_000,
        GOOD.replace(b"1.5", b"[" * 5000 + b"]" * 5000).strip(),
        GOOD.replace(b"}", b', "more": ' + b"[" * 5000 + b"]" * 5000 + b"}").strip(),
    ],
)
def test_deep_nesting_is_refused_with_its_line(line):
    with pytest.raises(WireError, match="nested too deeply") as caught:
        decode_ndjson(GOOD + line + b"\n" + GOOD, SCHEMA, {})
    assert caught.value.line == 2
    assert caught.value.hint


def test_a_nested_time_is_told_in_short():
    line = GOOD.replace(b'"valid": 1', b'"valid": ' + b"[" * 500 + b"]" * 500)
    with pytest.raises(WireError, match="'valid' is a time") as caught:
        decode_ndjson(line, SCHEMA, {})
    assert len(caught.value.message) < 100


@pytest.mark.parametrize(
    "more", [b'"alt": 2, ', b'"alt" : 2, ', b'"\\u0061lt": 2, ', b'"valid": 2, ']
)
def test_a_key_twice_is_refused_with_its_line(more):
    line = GOOD.replace(b'{"valid"', b"{" + more + b'"valid"')
    with pytest.raises(WireError, match="is there twice") as caught:
        decode_ndjson(GOOD + b"\n" + line + GOOD, SCHEMA, {})
    assert caught.value.line == 3


@pytest.mark.parametrize(
    "line",
    [
        GOOD.replace(b'"a"', b'"\\"alt\\": 1, \\"alt\\": 2"'),
        GOOD.replace(b'":', b'" :'),
        GOOD.replace(b'":', b'"\t:'),
    ],
)
def test_what_only_looks_like_a_key_twice_is_taken(line):
    assert len(decode_ndjson(GOOD + line, SCHEMA, {}).batch) == 2


def test_a_byte_order_mark_is_no_part_of_the_samples():
    assert len(decode_ndjson(b"\xef\xbb\xbf" + GOOD, SCHEMA, {}).batch) == 1


@pytest.mark.parametrize(
    ("last", "told"),
    [
        (b'"x": [' + b"1," * 40_000 + b"1]", "a float, got [1,1,1,"),
        (b'"x": ' + b'{"a": 1' + b', "b": 2' * 9_000 + b"}", 'a float, got {"a": 1, "b"'),
        (b'"x": "' + b"y" * 70_000 + b'"', 'a float, got "yyyy'),
        (b'"x": 1, "more": "' + b"y" * 70_000 + b'"', "'more' is not declared"),
        (b'"x": [' + b"1," * 40_000 + b"]", "not JSON"),
    ],
)
def test_of_a_long_line_is_told_how_it_begins(last, told):
    schema = Schema((Field("x", FieldType.FLOAT),))
    with pytest.raises(WireError) as caught:
        decode_ndjson(b'{"valid": 1, "x": 1}\n{"valid": 1, ' + last + b"}", schema, {})
    assert told in str(caught.value)
    assert len(caught.value.message) < 100
    assert caught.value.line == 2


def test_the_fields_of_an_open_stream_are_those_before_a_bad_line():
    body = b'{"valid": 1, "id": "a", "n": null}\n{"valid": 1, "id": "b", "n": [1]}\n'
    with pytest.raises(WireError, match=r"'n' is a string, got \[1\]") as caught:
        decode_ndjson(body, Schema(()), {})
    assert caught.value.line == 2
    with pytest.raises(WireError, match="not JSON") as caught:
        decode_ndjson(b'{"valid": 1, "id": "a"}\n{"valid"', Schema(()), {})
    assert caught.value.line == 2


def test_columns_of_arrow_that_are_not_plain_times():
    times = [f"1970-01-01T00:00:00.{i % 1000:03d}Z" for i in range(10_000)]
    table = pa.table({"valid": times, "id": ["a"] * len(times)})
    schema = Schema((Field("id", FieldType.STRING),))
    found = decode_arrow(bytes_of_table(table), schema, {}).batch
    assert found.valid.tolist() == [i % 1000 * 10**6 for i in range(10_000)]
    times[9_000] = "yesterday"
    table = pa.table({"valid": times, "id": ["a"] * len(times)})
    with pytest.raises(WireError, match="'valid'") as caught:
        decode_arrow(bytes_of_table(table), schema, {})
    assert caught.value.line == 9_001


def test_lines_of_any_white_space_are_blank():
    assert len(decode_ndjson(b"\x0b\n" + GOOD + b"\x0c \r\n" + GOOD, SCHEMA, {}).batch) == 2
