"""The N-Triples of samples, written column by column, are those of the triples one by one."""

from __future__ import annotations

import pickle

import numpy as np
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode

from dyknow.converters.rdf.sample_texts import sample_texts
from dyknow.converters.term_tables import TermTexts
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.timed import (
    Kind,
    ObjectColumn,
    TimedTriples,
    TripleRows,
    column_texts,
    make_literal,
)

SAMPLES = 5
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=5) | st.sampled_from(
    ["\0", '"', "\\", "\n", "\r\n", "%s", "a\u2028b", "\U0001f681"]
)
TERMS = st.one_of(
    st.sampled_from([NamedNode("urn:a"), NamedNode("http://x.org/a%20b"), BlankNode("n0")]),
    TEXTS.map(Literal),
    st.sampled_from("ab").map(lambda text: Literal(300 * text)),
    TEXTS.map(lambda text: Literal(text, language="en")),
    TEXTS.map(lambda text: Literal(text, datatype=NamedNode("urn:%64"))),
)
VALUES = {
    Kind.INTEGER: st.integers(-(2**63), 2**63 - 1),
    Kind.DECIMAL: st.floats(allow_nan=False, allow_infinity=False),
    Kind.FLOAT: st.floats(),
    Kind.DOUBLE: st.floats(),
    Kind.BOOLEAN: st.booleans(),
}
NODES = st.sampled_from([NamedNode("urn:s"), NamedNode("urn:%73"), BlankNode("b1")])
PREDICATES = st.sampled_from(
    [NamedNode("urn:p"), NamedNode("http://x.org/%64"), NamedNode("urn:q")]
)


@st.composite
def tables(draw, dictionary):
    each_once = st.just([*range(SAMPLES)])
    rows = draw(each_once | st.lists(st.integers(0, SAMPLES - 1), max_size=6))
    count = len(rows)
    subjects = dictionary.ids(draw(st.lists(NODES, min_size=count, max_size=count)))
    objects = {}
    for predicate in draw(st.lists(PREDICATES, min_size=1, max_size=2, unique=True)):
        kind = draw(st.sampled_from(Kind))
        each = TERMS.map(dictionary.id) if kind is Kind.TERM else VALUES[kind]
        values = draw(st.lists(each, min_size=count, max_size=count))
        null = draw(st.none() | st.lists(st.booleans(), min_size=count, max_size=count))
        null = None if null is None else np.array(null, np.bool_)
        column = ObjectColumn(kind, np.array(values, kind.dtype), null)
        objects[dictionary.id(predicate)] = column
    times = np.array(rows, np.int64)
    return TripleRows(times, times, np.array(subjects, np.int32), objects)


@given(st.data())
@settings(deadline=None)
def test_the_texts_are_those_of_the_triples(data):
    dictionary = TermDictionary()
    found = data.draw(st.lists(tables(dictionary), max_size=3))
    triples = TimedTriples(dictionary, tuple(found))
    lines = [[] for _ in range(SAMPLES)]
    for sample, subject, predicate, object in triples:
        lines[sample].append(f"{subject} {predicate} {object} .")
    wanted = ["\n".join(each) for each in lines]
    texts = TermTexts(dictionary)
    assert sample_texts(triples, SAMPLES, texts) == wanted
    assert sample_texts(triples, SAMPLES, pickle.loads(pickle.dumps(texts))) == wanted
    assert sample_texts(triples, SAMPLES, texts) == wanted


@given(st.sampled_from([*VALUES]), st.data())
@settings(deadline=None)
def test_the_texts_of_a_column_are_those_of_its_literals(kind, data):
    values = np.array(data.draw(st.lists(VALUES[kind])), kind.dtype)
    assert column_texts(kind, values) == [make_literal(kind, v).value for v in values]


NEXT_TO_0 = [1e-4, np.nextafter(1e-4, 0), 9.9e-5, 5e-324, 0.0, -0.0]
LARGE = [1e16, np.nextafter(1e16, 0), 1e15, 2.0**53 + 1, 1e22, 1.7e308, -1e16]


LONG = st.lists(st.floats(1e-4, 1e16, exclude_max=True) | st.integers(1, 10**15), min_size=16)


@given(st.sampled_from([Kind.DECIMAL, Kind.FLOAT, Kind.DOUBLE]), LONG, st.booleans())
@settings(deadline=None)
def test_the_texts_of_long_columns_are_those_of_their_literals(kind, numbers, negative):
    values = np.array(numbers, np.float64) * (-1 if negative else 1)
    assert column_texts(kind, values) == [make_literal(kind, v).value for v in values]


@given(st.sampled_from([Kind.DECIMAL, Kind.FLOAT, Kind.DOUBLE]), st.floats(1e-5, 1e17))
@example(Kind.DECIMAL, 0.1)
@settings(deadline=None)
def test_numbers_change_their_spelling_at_the_same_place(kind, value):
    values = np.array([value, -value, *NEXT_TO_0, *LARGE])
    assert column_texts(kind, values) == [make_literal(kind, v).value for v in values]
