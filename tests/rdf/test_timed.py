"""The dictionary and columns of timed triples: terms go in and come out equal."""

import pyoxigraph as ox
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode

from dyknow.rdf.dictionary import NO_TERM, TermDictionary
from dyknow.rdf.namespaces import DYKNOW, XSD, shorten
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.rdf.timed import DATATYPES, Kind, make_term, split_term

LIMITS = settings(deadline=None, max_examples=150)
TIMES = st.integers(-(2**63), 2**63 - 1)
NAMES = st.integers(0, 4).map(lambda i: NamedNode(f"{DYKNOW}n{i}"))
NUMBER_TEXTS = """
1 01 -0 +1 1.0 1.50 .5 1E3 1e3 INF -INF NaN nan inf true x 0.1 1e-7 1_0 ١
9223372036854775808 -9223372036854775808
"""
LEXICAL = st.sampled_from(NUMBER_TEXTS.split())
TYPES = st.sampled_from(["integer", "decimal", "float", "double", "boolean", "int", "string"])
LITERALS = st.one_of(
    st.builds(lambda text, type: Literal(text, datatype=NamedNode(XSD + type)), LEXICAL, TYPES),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=4).map(Literal),
    st.just(Literal("x", language="en")),
)
OBJECTS = st.one_of(NAMES, LITERALS, st.just(BlankNode("b")))
TRIPLES = st.lists(st.tuples(TIMES, NAMES | st.just(BlankNode("s")), NAMES, OBJECTS), max_size=10)


def texts(triples):
    return sorted(str(triple) for triple in triples)


@given(TRIPLES)
@LIMITS
def test_terms_to_columns_and_back(triples):
    found = from_terms(triples, TermDictionary())
    assert len(found) == len(triples)
    assert texts(found) == texts(triples)
    assert all(time == valid for time, valid, *_ in found.with_valid())


@given(TRIPLES, st.data())
@LIMITS
def test_valid_times_ride_along(triples, data):
    valid = [data.draw(TIMES) for _ in triples]
    found = from_terms(triples, TermDictionary(), valid)
    wanted = [(t, v, *rest) for (t, *rest), v in zip(triples, valid, strict=True)]
    assert texts(found.with_valid()) == texts(wanted)


@given(st.lists(OBJECTS, max_size=12))
@LIMITS
def test_an_id_is_a_term_for_ever(terms):
    dictionary = TermDictionary()
    ids = [dictionary.id(term) for term in terms]
    assert [dictionary.term(id) for id in ids] == terms
    assert [dictionary.find(term) for term in terms] == ids == dictionary.ids(terms).tolist()
    assert len(dictionary) == len({str(term) for term in terms})
    assert dictionary.find(NamedNode("urn:new")) == NO_TERM


NUMBERS = st.one_of(
    st.tuples(st.just(Kind.INTEGER), st.integers(-(2**63), 2**63 - 1)),
    st.tuples(st.just(Kind.DOUBLE), st.floats(allow_nan=False)),
    st.tuples(st.just(Kind.FLOAT), st.floats(allow_nan=False, width=32)),
    # Oxigraph's decimals have 18 digits after the point and 20 before it.
    st.tuples(
        st.just(Kind.DECIMAL), st.integers(-(10**12), 10**12).map(lambda value: value / 10**6)
    ),
    st.tuples(st.just(Kind.BOOLEAN), st.booleans()),
)
STORE = ox.Store()


@given(NUMBERS)
@LIMITS
def test_texts_of_numbers_are_canonical_and_oxigraph_agrees(number):
    kind, value = number
    dictionary = TermDictionary()
    term = make_term(kind, value, dictionary)
    assert isinstance(term, Literal)
    assert term.datatype == DATATYPES[kind]
    assert split_term(term, dictionary.id) == (kind, value)
    # Oxigraph reads the text, finds it equal, and computes with it.
    plus = "?x || false" if kind is Kind.BOOLEAN else "?x + 0"
    query = f"SELECT ?x ({plus} AS ?y) (?x = {term} AS ?same) {{ VALUES ?x {{ {term} }} }}"
    (row,) = list(STORE.query(query))
    assert row["same"].value == "true"
    # Oxigraph writes no exponents, and computes xsd:float in 32 bits: compared as values.
    read = {Kind.BOOLEAN: lambda text: text == "true", Kind.INTEGER: int}.get(kind, float)
    if kind is not Kind.FLOAT:
        assert read(row["x"].value) == value
        assert read(row["y"].value) == value


@pytest.mark.parametrize(
    ("kind", "value", "text"),
    [
        (Kind.INTEGER, -7, "-7"),
        (Kind.DOUBLE, 100.0, "100"),
        (Kind.DOUBLE, 0.1, "0.1"),
        (Kind.DOUBLE, 1e300, "1E300"),
        (Kind.DOUBLE, 1.5e-7, "1.5E-7"),
        (Kind.DOUBLE, float("inf"), "INF"),
        (Kind.FLOAT, float("-inf"), "-INF"),
        (Kind.FLOAT, float("nan"), "NaN"),
        (Kind.DECIMAL, 1e21, "1000000000000000000000"),
        (Kind.DECIMAL, 1.5e-7, "0.00000015"),
        (Kind.DECIMAL, -3.0, "-3"),
        (Kind.BOOLEAN, False, "false"),
    ],
)
def test_texts_of_numbers(kind, value, text):
    assert make_term(kind, value, TermDictionary()).value == text


def test_names_for_people():
    assert shorten(DYKNOW + "uav1") == "dyknow:uav1"
    assert shorten(XSD + "integer") == "xsd:integer"
    assert shorten(DYKNOW + "a/b") == f"<{DYKNOW}a/b>"
    assert shorten("http://x.org/y") == "<http://x.org/y>"
