"""Many terms to columns at once: what one term after the other gives."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode

import dyknow
from dyknow.rdf.dictionary import Term, TermDictionary
from dyknow.rdf.namespaces import XSD
from dyknow.rdf.terms_to_columns import from_terms, split_terms, timed_triples
from dyknow.rdf.timed import Kind, TimedTriples, split_term

LIMITS = settings(deadline=None)
TEXTS = """
1 01 -0 +1 0 0.0 -0.0 1.0 1.50 .5 1. 1E3 1e3 1e22 INF -INF NaN nan inf true false x 0.1 1e-7 1E-7
0.0001 0.00001 999999999999999 1000000000000000 123456789.123456789 1_0 ١ 1,2 [1] null
9223372036854775807 9223372036854775808 -9223372036854775808 18446744073709551616 5e-324 1E400
0.1000000000000000055511151231257827
"""
ODD = TEXTS.split()
TYPES = ["integer", "decimal", "float", "double", "boolean", "int", "string"]
NUMBERS = st.one_of(
    st.floats().map(repr), st.integers(-(2**70), 2**70).map(str), st.floats(width=32).map(str)
)
LITERALS = st.one_of(
    st.builds(
        lambda text, type: Literal(text, datatype=NamedNode(XSD + type)),
        st.sampled_from([*ODD, " 1", "", "1 "]) | NUMBERS,
        st.sampled_from(TYPES),
    ),
    st.just(Literal("x", language="en")),
)
NAMES = st.sampled_from([NamedNode(f"http://e/{i}") for i in range(3)])
TERMS = NAMES | st.just(BlankNode("b")) | LITERALS
LISTS = st.lists(TERMS, max_size=12) | st.lists(LITERALS, max_size=12)
TRIPLES = st.lists(st.tuples(st.integers(0, 9), NAMES, NAMES, TERMS), max_size=12)


def value_of(kind: int, bits: Any) -> Any:
    return bits.view(np.float64) if Kind(kind).dtype == np.float64 else int(bits)


@given(LISTS)
@LIMITS
def test_terms_are_split_as_one_by_one(terms: list[Term]) -> None:
    dictionary = TermDictionary()
    kinds, bits = split_terms(terms, dictionary)
    found = [(int(k), value_of(k, b)) for k, b in zip(kinds, bits, strict=True)]
    wanted = [split_term(term, dictionary.transient_id) for term in terms]
    assert list(map(repr, found)) == [
        repr((int(k), np.float64(v) if k.dtype == np.float64 else int(v))) for k, v in wanted
    ]


def tables_one_by_one(
    triples: list[tuple[int, Term, NamedNode, Term]], dictionary: TermDictionary
) -> list[tuple[int, Kind, list[Any]]]:
    """The definition of `from_terms`: the rows of each table, in the order of the tables."""
    id = dictionary.transient_id
    groups: dict[tuple[int, Kind], list[Any]] = defaultdict(list)
    for time, subject, predicate, object in triples:
        kind, value = split_term(object, id)
        groups[id(predicate), kind].append((time, id(subject), repr(kind.dtype.type(value))))
    return [(predicate, kind, rows) for (predicate, kind), rows in groups.items()]


def tables_of(found: TimedTriples) -> list[tuple[int, Kind, list[Any]]]:
    tables = []
    for table in found.tables:
        ((predicate, column),) = table.objects.items()
        values = map(repr, column.values)
        rows = list(zip(table.time.tolist(), table.subject.tolist(), values, strict=True))
        tables.append((predicate, column.kind, rows))
    return tables


@given(TRIPLES)
@LIMITS
def test_tables_are_those_of_one_triple_after_the_other(
    triples: list[tuple[int, Term, NamedNode, Term]],
) -> None:
    dictionary = TermDictionary()
    found = from_terms(iter(triples), dictionary)
    assert tables_of(found) == tables_one_by_one(triples, dictionary)


P, Q = "http://e/p", "http://e/q"
A, B = NamedNode("http://e/a"), NamedNode("http://e/b")


def number(text: str, type: str) -> Literal:
    return Literal(text, datatype=NamedNode(XSD + type))


def test_a_table_is_its_triples() -> None:
    times = np.array(["1970-01-01T00:00:00.000000001", "1970-01-01T00:00:02"], "datetime64[ns]")
    masked = np.ma.MaskedArray([1, 2], [False, True])
    found = timed_triples(
        times,
        [A, "http://e/b"],
        {P: [1.5, 2.0], Q: masked, "http://e/r": ["x", None], "http://e/s": [True, 7]},
    )
    assert list(found) == [
        (1, A, NamedNode(P), number("1.5", "double")),
        (2_000_000_000, B, NamedNode(P), number("2", "double")),
        (1, A, NamedNode(Q), number("1", "integer")),
        (1, A, NamedNode("http://e/r"), Literal("x")),
        (1, A, NamedNode("http://e/s"), number("true", "boolean")),
        (2_000_000_000, B, NamedNode("http://e/s"), number("7", "integer")),
    ]


@pytest.mark.parametrize(
    ("table", "error", "said"),
    [
        (([1], [A, B], {P: [1.0]}), ValueError, "columns of different lengths: .*'subject': 2"),
        (([1.5], [A], {P: [1.0]}), TypeError, "a time is an integer in ns or a datetime64"),
        (([1], [Literal("a")], {P: [1.0]}), TypeError, "a subject is .* not Literal"),
        (([1], [A], {P: [object()]}), TypeError, "an object is a term, a text"),
    ],
)
def test_a_wrong_table_is_refused(table: Any, error: type[Exception], said: str) -> None:
    with pytest.raises(error, match=said):
        timed_triples(*table)


def test_a_table_is_evaluated() -> None:
    query = f"""SELECT ?s (AVG(?v) AS ?m) FROM STREAM <{Q}> [RANGE 2ns STEP 2ns]
    WHERE {{ ?s <{P}> ?v }} GROUP BY ?s"""
    table = dyknow.timed_triples([1, 2, 3], [A, A, B], {P: [1.0, 2.0, 5.0]})
    windows = list(dyknow.evaluate(query, {Q: table}))
    assert [(w.end, w.solutions[0]["s"], w.solutions[0]["m"].value) for w in windows] == [
        (2, A, "1.5"),
        (4, B, "5"),
    ]


def test_tables_may_share_their_terms() -> None:
    one = timed_triples([1], [A], {P: [1.0]})
    other = timed_triples([1], [A], {Q: [1.0]}, terms_of=one)
    assert other.dictionary is one.dictionary
    assert one.tables[0].subject.tolist() == other.tables[0].subject.tolist()
