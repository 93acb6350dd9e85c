"""Bounds of texts for streams of RDF."""

import pytest
from pyoxigraph import RdfFormat

from dyknow.converters import WireError
from dyknow.converters.rdf.statements import decode_statements
from dyknow.converters.wire import BatchLimits

LIMITS = BatchLimits(samples=25_000, text=1_000, decoded=1 << 30)
LINES = "<urn:a> <urn:p> <urn:b> .\n"


def decoded(text, format, limits=LIMITS):
    return decode_statements(text.encode(), format, {}, limits)


@pytest.mark.parametrize("count", [9_999, 10_000, 10_001, 25_000])
def test_statements_are_read_in_parts(count):
    text = "<urn:a> <urn:p> " + ",".join(map(str, range(count))) + " ."
    batch = decoded(text, RdfFormat.TURTLE).batch
    assert batch.columns["number"].tolist() == list(range(count))


@pytest.mark.parametrize(
    ("format", "text"),
    [
        (RdfFormat.TURTLE, "<urn:a> <urn:p> " + ",".join(["1"] * 25_001) + " ."),
        (RdfFormat.N_TRIPLES, LINES * 25_001),
        (RdfFormat.JSON_LD, '{"@id":"urn:a","urn:p":[' + ",".join(["1"] * 25_001) + "]}"),
    ],
)
def test_a_short_text_of_many_statements_is_bounded(format, text):
    with pytest.raises(WireError, match="at most 25000 statements"):
        decoded(text, format)


def test_an_error_far_down_has_its_line():
    with pytest.raises(WireError) as caught:
        decoded(LINES * 20_000 + "<urn:a> <urn:p> oops .\n", RdfFormat.N_TRIPLES)
    assert caught.value.line == 20_001


def test_a_long_term_is_refused():
    with pytest.raises(WireError, match="a term has at most 1000 bytes"):
        decoded(f'<urn:a> <urn:p> "{"x" * 1_000}" .', RdfFormat.TURTLE)
    assert len(decoded(f'<urn:a> <urn:p> "{"x" * 998}" .', RdfFormat.TURTLE).batch) == 1


def test_numbers_that_a_float_does_not_hold_stay_texts():
    values = ["9007199254740992", "9007199254740993", "-9007199254740993", "1.50", "true"]
    values.append('"NaN"^^<http://www.w3.org/2001/XMLSchema#double>')
    text = f"<urn:a> <urn:p> {','.join(values)} ."
    columns = decoded(text, RdfFormat.TURTLE).batch.columns
    assert columns["number"].tolist() == [9007199254740992.0, None, None, None, None, None]
    assert columns["datatype"].tolist() == ["integer", None, None, None, None, None]
    assert [str(text).split("^^")[0] for text in columns["object"].tolist()] == [
        "None",
        '"9007199254740993"',
        '"-9007199254740993"',
        '"1.50"',
        '"true"',
        '"NaN"',
    ]
