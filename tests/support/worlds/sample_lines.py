"""Bodies of NDJSON for laws: lines that fit a schema more or less, and what becomes of them when
bytes are lost."""

from hypothesis import strategies as st

from dyknow.streams.sample import Field, FieldType, Schema

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
