"""The short way through NDJSON is the exact decoder, or nothing: also on bytes made to break it."""

import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dyknow.converters import WireError, cells
from dyknow.converters.decimals import floats
from dyknow.converters.exact import decode_exactly
from dyknow.converters.ndjson import decode_ndjson, encode_ndjson
from dyknow.converters.regular import decode_regular
from dyknow.streams.compiled import JIT
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.time import parse_time

LIMITS = settings(deadline=None, max_examples=400)
pytestmark = pytest.mark.skipif(not JIT, reason="loops are not compiled here")

NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.integers(-(10**20), 10**20).map(str),
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.3f}"),
    st.from_regex(r"-?(0|[1-9][0-9]{0,22})(\.[0-9]{1,22})?([eE][+-]?[0-9]{1,3})?", fullmatch=True),
    st.sampled_from(
        [
            "-0",
            "0",
            "-0.0",
            "00",
            "01",
            "1.",
            ".5",
            "+1",
            "1e5",
            "1E+05",
            "1e",
            "0x1",
            "1_0",
            "1e-400",
            "2.2250738585072014e-308",
            "9007199254740993",
            "9007199254740993.0",
            "1e23",
            "8.5",
            "NaN",
            "Infinity",
            "9223372036854775807",
            "9223372036854775808",
            "-9223372036854775808",
            "1.0",
        ]
    ),
)
TEXTS = st.one_of(
    st.sampled_from(
        ['"a"', '"b"', '"uav12"', '""', '"null"', '"é"', '"a\\u0062"', '"\\""', '"\t"']
    ),
    st.text(
        st.characters(exclude_categories=["Cs", "Cc"], exclude_characters='"\\'), max_size=5
    ).map(lambda text: f'"{text}"'),
)
TIMES = st.one_of(
    st.integers(-(2**63), 2**63).map(str),
    st.integers(0, 2 * 10**18).map(str),
    st.datetimes().map(lambda time: f'"{time.isoformat()}Z"'),
    st.from_regex(
        r'"(19|20|21)[0-9]{2}-(0[1-9]|1[0-2])-[0-3][0-9]T[0-2][0-9]:[0-5][0-9]:[0-6][0-9](\.[0-9]{1,9})?Z"',
        fullmatch=True,
    ),
    st.sampled_from(
        ['"2021-10-07T19:12:53+02:00"', '"2021-10-07"', "null", "1.5", '"2024-02-29T00:00:00Z"']
    ),
)
VALUES = {
    FieldType.FLOAT: NUMBERS,
    FieldType.INTEGER: st.integers(-(2**63), 2**63 - 1).map(str) | NUMBERS,
    FieldType.BOOLEAN: st.sampled_from(["true", "false", "true", "false", "True", "1"]),
    FieldType.STRING: TEXTS,
}
GOOD = {
    FieldType.FLOAT: st.floats(-1e6, 1e6).map(repr),
    FieldType.INTEGER: st.integers(-(10**12), 10**12).map(str),
    FieldType.BOOLEAN: st.sampled_from(["true", "false"]),
    FieldType.STRING: st.sampled_from(['"a"', '"b"', '"å"', '""']),
}
BLANKS = st.sampled_from(["", "", "", " ", "\t", "  "])
NAMES = st.sampled_from(["id", "x", "y", "é", "a b", "", "available2", "valid2"])


@st.composite
def bodies(draw):
    """A schema and lines that fit it more or less: mostly regular ones, some strange."""
    names = draw(st.lists(NAMES, unique=True, max_size=4))
    types = [draw(st.sampled_from(list(FieldType))) for _ in names]
    schema = Schema(tuple(Field(*pair) for pair in zip(names, types, strict=True)))
    hostile = draw(st.booleans())
    values = VALUES if hostile else GOOD
    times = TIMES if hostile else draw(st.sampled_from([TIMES, st.integers(0, 10**18).map(str)]))
    keys = ["valid", *names] + (["available"] if draw(st.booleans()) else [])
    ordered = draw(st.permutations(keys))
    lines = []
    for _ in range(draw(st.integers(1, 5))):
        cells_of = {"valid": draw(times), "available": draw(times)}
        for field in schema.fields:
            missing = draw(st.integers(0, 5)) == 0
            cells_of[field.name] = "null" if missing else draw(values[field.type])
        order = draw(st.permutations(keys)) if draw(st.integers(0, 3)) == 0 else ordered
        gap = draw(BLANKS)
        spelled = (f'{gap}"{key}"{gap}:{gap}{cells_of[key]}{gap}' for key in order)
        lines.append(gap + "{" + ",".join(spelled) + "}" + draw(BLANKS))
    end = draw(st.sampled_from(["\n", "\r\n", "\n\n"]))
    return schema, (end.join(lines) + draw(st.sampled_from(["", end]))).encode()


@st.composite
def mutated(draw):
    """The same with bytes lost, doubled or replaced."""
    schema, data = draw(bodies())
    body = bytearray(data)
    for _ in range(draw(st.integers(0, 3))):
        at = draw(st.integers(0, max(0, len(body) - 1)))
        length = draw(st.integers(0, 4))
        swap = draw(st.sampled_from([b"", b'"', b"\\", b",", b"}", b"{", b"\n", b"0", b"-", b" ", b"\xff", b"\x00", b":", b"e", b".", b"null", b"1,1", bytes(body[at : at + 2 * length])]))  # fmt: skip  # noqa: E501
        body[at : at + length] = swap
    return schema, bytes(body)


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
    return decode_regular(data, schema, pools, least=0)


@given(bodies() | mutated())
@LIMITS
@example((Schema((Field("x", FieldType.FLOAT),)), b'{"valid":0,"x":-0}'))
def test_the_short_way_is_the_exact_one_or_none(drawn):
    schema, data = drawn
    found = outcome(regular, data, schema)
    assert found is None or found == outcome(decode_exactly, data, schema)


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
    assert outcome(regular, body, schema) == outcome(decode_exactly, body, schema) is not None


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
    assert decode_regular(body, schema, {}) is not None
    pools = {}
    with pytest.raises(WireError, match="'x' is a float") as caught:
        decode_ndjson(body + line.replace(b"1.25", b"true") % 9, schema, pools)
    assert caught.value.line == body.count(b"\n") + 1
    assert not pools
