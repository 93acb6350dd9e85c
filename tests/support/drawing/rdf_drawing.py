"""Random texts of N-Triples and N-Quads, some of them damaged."""

from hypothesis import strategies as st

XSD = "http://www.w3.org/2001/XMLSchema#"
IRIS = st.sampled_from(["<urn:a>", "<urn:b>", "<http://x.org/é#a>", "<urn:\\u0061>", "<urn:a>"])
BLANK = st.sampled_from(["_:a ", "_:b.c ", "_:a\t", "_:a"])
NUMBERS = st.one_of(
    st.floats().map(repr),
    st.floats(-1e6, 1e6).map(lambda x: f"{x:.4g}"),
    st.integers(-(10**19), 10**19).map(str),
    st.integers(-(10**17), 10**17).map(lambda n: f"{n}"[:-3] + "." + f"{n}"[-3:]),
    st.sampled_from(
        [
            "0",
            "-0",
            "0.0",
            "1.50",
            "01",
            "1E2",
            "1e2",
            "0.0001",
            "0.00001",
            "INF",
            "NaN",
            "+1",
            ".5",
            "5.",
            "true",
            "false",
            "1",
            "0.1",
            "-0.5",
            "1e16",
            "10000000000000000",
        ]
    ),
)
TYPES = st.sampled_from(
    ["integer", "decimal", "float", "double", "boolean", "int", "string", "doubl"]
)
LITERALS = st.one_of(
    st.builds(lambda text, type: f'"{text}"^^<{XSD}{type}>', NUMBERS, TYPES),
    st.sampled_from(
        [
            '""',
            '"a b"',
            '"a"@en',
            '"a"@EN-us',
            '"\\""',
            '"\\\\"',
            '"é"',
            '"# ."',
            '"\t"',
            '"a"^^<urn:t>',
            '"\\u00e9"',
            '"1"',
        ]
    ),
)
GAPS = st.sampled_from([" ", "", "  ", "\t"])


@st.composite
def lines(draw, graphs=False):
    terms = [draw(IRIS | BLANK), draw(IRIS), draw(IRIS | BLANK | LITERALS)]
    if graphs and draw(st.integers(0, 5)):
        terms.append(draw(st.sampled_from(["<urn:g1>", "<urn:g2>", "_:g "])))
    line = draw(GAPS) + "".join(term + draw(GAPS) for term in terms) + "."
    return line + draw(st.sampled_from(["", " ", "# a <b> .", " #"]))


@st.composite
def bodies(draw, graphs=False):
    ends = st.sampled_from(["\n", "\n", "\r\n", "\n\n", "\n# comment\n", "\r"])
    text = "".join(line + draw(ends) for line in draw(st.lists(lines(graphs), max_size=6)))
    body = bytearray(text.encode())
    for _ in range(draw(st.sampled_from([0, 0, 1, 2]))):
        at = draw(st.integers(0, len(body)))
        swap = st.sampled_from([b"", b'"', b"\\", b".", b"<", b">", b"\n", b" ", b"\xff", b"#", b"_:", b"^^", b"@", b"\x00", b"<<("])  # fmt: skip  # noqa: E501
        body[at : at + draw(st.integers(0, 3))] = draw(swap)
    return bytes(body)
