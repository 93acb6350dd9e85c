"""What a batch may have that comes from outside: told with its line, before anything is kept."""

import io
import json
import struct
from dataclasses import replace

import pyarrow as pa
import pytest

from dyknow.converters.arrow.messages import ArrowMessages
from dyknow.converters.arrow.sizes import SCHEMA, check_sizes, message_at, size_of
from dyknow.converters.arrow.stream import ArrowWriter, decode_arrow
from dyknow.converters.errors import WireError
from dyknow.converters.ndjson import decode_ndjson
from dyknow.converters.wire import BatchLimits
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows

SCHEMA_OF_TEXTS = Schema((Field("t", FieldType.STRING), Field("u", FieldType.STRING)))
LIMITS = BatchLimits(samples=100, text=1000, decoded=100_000)


def lines(*texts):
    return "".join(json.dumps({"valid": 1, "t": "a", "u": text}) + "\n" for text in texts).encode()


def table(texts, **columns):
    if not isinstance(texts, pa.Array):
        texts = pa.array(texts, pa.string())
    count = len(texts)
    given = {"valid": pa.array([1] * count, pa.int64()), "t": pa.array(["a"] * count), "u": texts}
    return pa.table({**given, **columns})


def stream(*tables, compression=None):
    sink = io.BytesIO()
    options = pa.ipc.IpcWriteOptions(compression=compression)
    with pa.ipc.new_stream(sink, tables[0].schema, options=options) as writer:
        for each in tables:
            writer.write_table(each)
    return sink.getvalue()


def coded(texts, places):
    return pa.DictionaryArray.from_arrays(pa.array(places, pa.int8()), pa.array(texts))


def refused(decode, body, *, limits=LIMITS, line=None):
    """What is said; nothing was kept, and without limits it is taken."""
    pools = {}
    with pytest.raises(WireError) as told:
        decode(body, SCHEMA_OF_TEXTS, pools, limits)
    assert told.value.line == line
    assert not any(map(len, pools.values()))
    assert len(decode(body, SCHEMA_OF_TEXTS, {}).batch)
    return str(told.value)


def taken(decode, body, limits=LIMITS):
    return decode(body, SCHEMA_OF_TEXTS, {}, limits).batch


def test_lines_have_so_many_samples():
    assert len(taken(decode_ndjson, b"\n" + lines(*"x" * 100) + b"\n \n")) == 100
    told = refused(decode_ndjson, b"\n" + lines(*"x" * 101), line=102)
    assert "at most 100 samples" in told


@pytest.mark.parametrize("text", ["x" * 1000, "ä" * 500, "\u20ac" * 333, "\n" * 1000])
def test_a_text_in_a_line_has_so_many_bytes(text):
    """Of what it says, however it is written."""
    assert taken(decode_ndjson, lines("b", text)).columns["u"].at(1) == text
    told = refused(decode_ndjson, lines("b", text, "c", text + text[0], text * 2), line=4)
    assert "field 'u': a text has at most 1000 bytes" in told


def test_a_long_text_is_found_wherever_it_stands():
    for before in (0, 1, 30, 99):
        body = lines(*["x" * 900] * before, "y" * 1001)
        assert "1001" in refused(decode_ndjson, body, line=before + 1)
        assert "1001" in refused(decode_ndjson, body.rstrip(b"\n"), line=before + 1)


def test_a_line_has_so_many_bytes():
    """However it gets them: nothing in it is made."""
    limits = BatchLimits(samples=100, text=1000, decoded=100_000, line=2000)
    for filling in (b" " * 2000, b'"more": [' + b"{}," * 700 + b"0],", b'"t":"a",' * 300):
        line = b'{"valid": 1, ' + filling + b'"t": "a", "u": "b"}'
        with pytest.raises(WireError, match="a line has at most 2000 bytes, and this one") as told:
            decode_ndjson(lines("b") + b"\n" + line + b"\n", SCHEMA_OF_TEXTS, {}, limits)
        assert told.value.line == 3


def test_an_open_stream_gets_so_many_fields():
    limits = BatchLimits(samples=100, text=1000, decoded=100_000, fields=3)
    for count in (3, 4):
        names = [f"f{i}" for i in range(count)]
        line = json.dumps({"valid": 1, "available": 1, **dict.fromkeys(names, 1)}).encode()
        given = pa.table({"valid": [1], "available": [1], **{name: [1] for name in names}})
        for decode, body in ((decode_ndjson, line), (decode_arrow, stream(given))):
            if count == 3:
                assert [*decode(body, Schema(()), {}, limits).batch.columns] == names
                continue
            with pytest.raises(WireError, match="at most 3 fields"):
                decode(body, Schema(()), {}, limits)


@pytest.mark.parametrize("body", [b"x" * 5000, b'{"valid": 1, "t": ' + b"[" * 5000, b"\xff" * 5000])
def test_a_long_line_that_is_no_sample_is_told_as_ever(body):
    with pytest.raises(WireError) as told:
        decode_ndjson(body, SCHEMA_OF_TEXTS, {}, LIMITS)
    with pytest.raises(WireError) as usual:
        decode_ndjson(body, SCHEMA_OF_TEXTS, {})
    assert str(told.value) == str(usual.value)


@pytest.mark.parametrize("compression", [None, "lz4", "zstd"])
def test_what_a_message_declares_is_what_it_has(compression):
    texts = ["x" * i for i in range(50)]
    for column in (texts, [None, *texts[1:]], pa.array(texts, pa.large_string())):
        given = table(column, f=pa.array([0.5] * 50), b=pa.array([True, None] * 25))
        body = stream(given, given, compression=compression)
        plain = stream(given, given)
        found, at = [], 0
        while message_at(body, at).kind:
            if message_at(body, at).kind != SCHEMA:
                found.append(size_of(body, at))
            at += message_at(body, at).size
        at = message_at(plain).size
        assert found == [size_of(plain, at)] * 2
        assert found[0].rows == 50
        # Buffers of a message end at multiples of eight bytes, and are as long as declared.
        assert given.nbytes - 8 <= found[0].bytes <= given.nbytes + 8 * 12


@pytest.mark.parametrize("compression", [None, "lz4", "zstd"])
def test_arrow_has_so_many_samples(compression):
    def body(*counts):
        return stream(*(table(["x"] * count) for count in counts), compression=compression)

    assert len(taken(decode_arrow, body(60, 40))) == 100
    assert "at most 100 samples" in refused(decode_arrow, body(60, 41))
    assert "at most 100 samples" in refused(decode_arrow, body(101))


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_arrow_is_refused_by_what_it_would_be(compression, monkeypatch):
    """Some kilobytes that stand for a hundred times as much are never decompressed."""
    limits = BatchLimits(samples=1_000_000, text=1_000_000, decoded=1_000_000)
    body = stream(table(["x" * 10_000] * 101), compression=compression)
    assert len(body) < 50_000
    assert "1000000 bytes once it is decompressed" in refused(decode_arrow, body, limits=limits)
    assert len(taken(decode_arrow, body, BatchLimits(1_000, 10_000, 2_000_000))) == 101
    many = stream(*[table(["x" * 10_000] * 11)] * 10, compression=compression)
    refused(decode_arrow, many, limits=limits)
    words = stream(table(coded(["x" * 1_000_001], [0])), compression=compression)
    refused(decode_arrow, words, limits=limits)
    monkeypatch.setattr(pa.ipc, "open_stream", None)
    with pytest.raises(WireError):
        decode_arrow(body, SCHEMA_OF_TEXTS, {}, limits)


def test_arrow_of_live_samples_is_refused_by_what_it_would_be():
    limits = BatchLimits(samples=100, text=10_000, decoded=200_000)
    good, large = table(["x"] * 100), table(["x" * 10_000] * 50)
    for bad in (table(["x"] * 101), large):
        messages = ArrowMessages(limits)
        found = messages.take(stream(good, good, bad, compression="zstd"))
        assert [next(found).num_rows, next(found).num_rows] == [100, 100]
        with pytest.raises(WireError):
            next(found)


@pytest.mark.parametrize("count", [3, 80])
def test_a_text_in_arrow_has_so_many_bytes(count):
    limits = BatchLimits(samples=100, text=1000, decoded=1_000_000)
    good, bad = ["ä" * 500] * count, ["ä" * 500] * (count - 1) + ["ä" * 500 + "b"]
    assert len(taken(decode_arrow, stream(table(good)), limits)) == count
    for column in (bad, pa.array(bad, pa.large_string()), pa.array(bad).dictionary_encode()):
        told = refused(decode_arrow, stream(table(column)), limits=limits, line=count)
        assert "at most 1000 bytes, and this one 1001" in told


def test_a_text_of_a_dictionary_is_told_where_it_is_used():
    texts = ["a", "x" * 1001]
    assert len(taken(decode_arrow, stream(table(coded(texts, [0, 0, None]))))) == 3
    body = stream(table(coded(texts, [0, None, 0, 1, 1])))
    refused(decode_arrow, body, line=4)


def test_a_stream_that_is_none_is_no_failure():
    whole = stream(table(["x"] * 10), compression="zstd")
    for cut in range(0, len(whole), 7):
        for body in (whole[:cut], whole[:cut] + b"\xff" * 8 + whole[cut + 8 :]):
            try:
                decode_arrow(body, SCHEMA_OF_TEXTS, {}, LIMITS)
            except WireError:
                continue


@pytest.mark.parametrize("number", [2**63 - 1, 2**62 + 1, 2**62, 2**33, 1, 0, -1, -8, -(2**63)])
@pytest.mark.parametrize("compression", [None, "lz4", "zstd"])
def test_a_number_that_is_damaged_is_no_failure(compression, number):
    """Wherever it stands: sizes of messages, places and sizes of buffers, counts of rows."""
    texts = pa.array([0] * 20, pa.int8())
    whole = stream(table(pa.DictionaryArray.from_arrays(texts, ["x"])), compression=compression)
    refused = 0
    for at in range(0, len(whole) - 8, 4):
        body = whole[:at] + struct.pack("<q", number) + whole[at + 8 :]
        for decode in (
            lambda body: decode_arrow(body, SCHEMA_OF_TEXTS, {}, LIMITS),
            lambda body: list(ArrowMessages(LIMITS).take(body)),
        ):
            try:
                decode(body)
            except WireError:
                refused += 1
    assert refused > 20


def test_the_file_format_is_no_stream():
    sink = io.BytesIO()
    with pa.ipc.new_file(sink, table(["x"]).schema) as writer:
        writer.write_table(table(["x"]))
    assert "the file format" in refused(decode_arrow, sink.getvalue())


def test_batches_written_one_by_one_are_one_stream():
    rows = [(i, i, {"t": "x" * i, "u": None}) for i in range(30)]
    writer = ArrowWriter()
    batches = [batch_from_rows(SCHEMA_OF_TEXTS, rows[i : i + 10]) for i in (0, 10, 20)]
    body = b"".join(map(writer.write, batches)) + writer.close()
    assert list(decode_arrow(body, SCHEMA_OF_TEXTS, {}).batch.rows()) == rows


@pytest.mark.parametrize("compression", [None, "zstd"])
def test_values_count_even_where_they_are_bits(compression):
    """A million truth values are some kilobytes of a message, and megabytes here."""
    rows, columns = 1000, 400
    bits = pa.table({f"b{i}": pa.array([True] * rows) for i in range(columns)})
    body = stream(bits, compression=compression)
    limits = BatchLimits(rows, 100, 4 * rows * columns)
    check_sizes(body, limits)
    with pytest.raises(WireError, match=f"and this one {4 * rows * columns} \\(4 for each"):
        check_sizes(body, replace(limits, decoded=4 * rows * columns - 1))
