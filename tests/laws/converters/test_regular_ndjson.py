"""The short way through NDJSON is the exact decoder, or nothing: also on bytes made to break it."""

import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from sample_lines import NUMBERS, TIMES, bodies, mutated

from dyknow.converters import WireError, cells
from dyknow.converters.decimals import floats
from dyknow.converters.ndjson import decode_ndjson, encode_ndjson
from dyknow.converters.ndjson_lines import decode_lines
from dyknow.converters.ndjson_scan import scan_lines
from dyknow.streams.jit import JIT
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.time import parse_time

LIMITS = settings(deadline=None, max_examples=400)
pytestmark = pytest.mark.skipif(not JIT, reason="loops are not compiled here")


def outcome(decode, data, schema):
    """What a decoder says, down to the bits of floats and the codes of pools; None: refused."""
    pools = {}
    try:
        incoming = decode(data, schema, pools)
    except WireError:
        assert not pools
        return None
    if incoming is None:
        assert not pools
        return None
    columns = {
        name: (
            column.type,
            [
                struct.pack("d", v) if isinstance(v, float) else v
                for v in (
                    None if null else value.item()
                    for value, null in zip(column.values, ~column.present, strict=True)
                )
            ],
        )
        for name, column in incoming.batch.columns.items()
    }
    times = incoming.batch.available.tolist(), incoming.batch.valid.tolist()
    return incoming.stamped, times, columns, {name: list(p.strings()) for name, p in pools.items()}


def regular(data, schema, pools):
    return scan_lines(data, schema, pools, least=0)


@given(bodies() | mutated())
@LIMITS
@example((Schema((Field("x", FieldType.FLOAT),)), b'{"valid":0,"x":-0}'))
def test_the_short_way_is_the_exact_one_or_none(drawn):
    schema, data = drawn
    found = outcome(regular, data, schema)
    assert found is None or found == outcome(decode_lines, data, schema)


@given(st.data())
@settings(deadline=None, max_examples=60)
def test_what_we_write_is_regular(data):
    types = data.draw(st.lists(st.sampled_from(list(FieldType)), max_size=4))
    schema = Schema(tuple(Field(f"f{i}", type) for i, type in enumerate(types)))
    plain = st.characters(exclude_categories=["Cs", "Cc"], exclude_characters='"\\')
    values = {
        FieldType.FLOAT: st.floats(-1e290, 1e290).filter(lambda x: x == 0 or abs(x) > 1e-290),
        FieldType.INTEGER: st.integers(-(2**63) + 1, 2**63 - 1),
        FieldType.BOOLEAN: st.booleans(),
        FieldType.STRING: st.text(plain, max_size=4),
    }
    times = st.integers(parse_time("1900-01-01T00:00:00Z"), 2**62)
    row = st.tuples(
        times,
        times,
        st.fixed_dictionaries({f.name: st.none() | values[f.type] for f in schema.fields}),
    )
    batch = batch_from_rows(schema, data.draw(st.lists(row, min_size=1, max_size=5)))
    body = encode_ndjson(batch)
    assert outcome(regular, body, schema) == outcome(decode_lines, body, schema) is not None


def column(texts):
    """Cells of a text, one after the other."""
    data = np.frombuffer(" ".join(texts).encode(), np.uint8)
    ends = np.cumsum([len(text.encode()) + 1 for text in texts]) - 1
    starts = ends - [len(text.encode()) for text in texts]
    return data, starts.astype(np.int32), ends.astype(np.int32)


@given(st.lists(NUMBERS, min_size=1, max_size=4))
@settings(deadline=None, max_examples=1000)
@example(["9007199254740993"])
@example(["9007199254740993.00000000000000000001"])
@example(["0.1", "1e22", "1e23", "5e-1", "1.7976931348623157e299"])
def test_floats_are_the_nearest_ones(texts):
    try:
        found, null = floats(*column(texts))
    except cells.Irregular:
        return
    assert null is None
    assert (
        found.view(np.int64).tolist() == np.array(list(map(float, texts))).view(np.int64).tolist()
    )


@given(st.integers(2**52, 2**53 - 1), st.integers(1, 10), st.integers(-2, 2))
@settings(deadline=None, max_examples=500)
def test_floats_beside_a_half_are_the_nearest_ones(significand, shift, beside):
    """Integers in the middle between two float64, and next to it."""
    middle = (2 * significand + 1) << (shift - 1)
    text = str(middle + beside)
    found, _ = floats(*column([text, text + ".0", text[:-3] + "." + text[-3:]]))
    assert found.tolist() == [float(text), float(text), float(text[:-3] + "." + text[-3:])]


@given(st.lists(TIMES.filter(lambda text: text.startswith('"')), min_size=1, max_size=3))
@LIMITS
def test_times_are_those_of_the_calendar(texts):
    try:
        found = cells.times(*column(texts))
    except cells.Irregular:
        return
    assert found.tolist() == [parse_time(text.strip('"')) for text in texts]


@given(st.lists(st.text(max_size=3), max_size=40))
@LIMITS
def test_distinct_cells_are_numbered_as_they_are_met(texts):
    data, starts, ends = column(texts) if texts else column([""])
    codes, first = cells.distinct(data, starts, ends)
    met = list(dict.fromkeys(text for text in texts if text))
    assert [texts[row] for row in first.tolist()] == met
    assert [met[code] for code, text in zip(codes.tolist(), texts, strict=False) if text] == [
        text for text in texts if text
    ]


def test_a_large_body_takes_the_short_way():
    schema = Schema((Field("id", FieldType.STRING), Field("x", FieldType.FLOAT)))
    line = b'{"valid": "2021-10-07T19:12:53Z", "id": "uav%d", "x": 1.25}\n'
    body = b"".join(line % (i % 7) for i in range(2 * cells.LEAST // len(line)))
    assert scan_lines(body, schema, {}) is not None
    pools = {}
    with pytest.raises(WireError, match="'x' is a float") as caught:
        decode_ndjson(body + line.replace(b"1.25", b"true") % 9, schema, pools)
    assert caught.value.line == body.count(b"\n") + 1
    assert not pools
