"""N-Triples and N-Quads in columns are what pyoxigraph's parser finds, triple by triple."""

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, Literal, NamedNode, RdfFormat, parse
from rdf_drawing import XSD, bodies

from dyknow.converters import WireError
from dyknow.converters.rdf.ntriples import (
    TripleReader,
    decode_nquads,
    decode_ntriples,
)
from dyknow.rdf.dictionary import NO_TERM, TermDictionary
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.streams.jit import JIT

LIMITS = settings(deadline=None, max_examples=300)


def tables(triples):
    """What is told, table by table."""
    term = triples.dictionary.term
    return [
        (
            term(predicate),
            column.kind,
            table.time.tolist(),
            table.valid.tolist(),
            [term(id) for id in table.subject.tolist()],
            [column.term_at(row, triples.dictionary) for row in range(len(table))],
        )
        for table in triples.tables
        for predicate, column in table.objects.items()
    ]


def definition(data, time):
    """pyoxigraph's triples one by one; None where it finds an error, or a triple about triples."""
    try:
        found = [
            (time, q.subject, q.predicate, q.object)
            for q in parse(data, format=RdfFormat.N_TRIPLES)
        ]
    except SyntaxError as error:
        return error.lineno
    if not all(
        isinstance(t, NamedNode | BlankNode | Literal) for _, s, _, o in found for t in (s, o)
    ):
        return None
    return tables(from_terms(found, TermDictionary()))


@given(st.lists(bodies(), min_size=1, max_size=2), st.integers(-(2**63), 2**63 - 1))
@LIMITS
@example([b'<urn:a> <urn:a> "\\\n" .\n'], 0)
def test_triples_are_what_the_parser_finds(texts, time):
    reader = TripleReader(TermDictionary(), least=0)  # remembers the terms of the first text
    for data in texts:
        expected = definition(data, time)
        if b"<<" in data and not isinstance(expected, list):
            # It is refused at the first of its brackets, or at what the parser finds before.
            with pytest.raises(WireError):
                reader.triples(data, time)
            continue
        if not isinstance(expected, list):
            with pytest.raises(WireError) as caught:
                reader.triples(data, time)
            assert caught.value.line == expected
            continue
        assert tables(reader.triples(data, time)) == expected
        assert tables(decode_ntriples(data, time, TermDictionary())) == expected


@pytest.mark.parametrize("graph", ["", "_:g", "<urn:g>"])
def test_a_comment_may_follow_a_label_and_its_point(graph):
    data = f"<urn:a> <urn:b> _:b.#c {graph} .\n".encode()
    found = TripleReader(TermDictionary(), least=0).statements(data, RdfFormat.N_QUADS)
    assert found.graph.tolist() == [NO_TERM]


@given(st.integers(2**49, 2**53 - 1), st.integers(0, 8), st.sampled_from(["double", "decimal"]))
@LIMITS
def test_numbers_between_two_texts_are_spelled_as_python_does(significand, eighths, type):
    """Their exact value has one digit more than the shortest texts, which are equally close."""
    value = (significand * 8 + eighths) / 8
    texts = {repr(value), f"{value:.1f}", f"{value:.2f}", f"{int(value)}.3", f"{int(value)}.2"}
    data = "".join(
        f'<urn:a> <urn:b> "{text}"^^<{XSD}{type}> .\n' for text in sorted(texts)
    ).encode()
    assert tables(TripleReader(TermDictionary(), 0).triples(data, 0)) == definition(data, 0)


@given(bodies(graphs=True), st.permutations(["<urn:g1>", "<urn:g2>", "_:g"]), st.data())
@LIMITS
def test_graphs_hold_at_the_time_that_is_told(data, graphs, draws):
    times = {"<urn:g1>": 5, "<urn:g2>": -(10**9), "_:g": 5}
    spelled = {5: f'"5"^^<{XSD}integer>', -(10**9): f'"1969-12-31T23:59:59Z"^^<{XSD}dateTime>'}
    told = [
        f"{graph} <http://www.w3.org/ns/prov#generatedAtTime> {spelled[times[graph]]} .\n"
        for graph in graphs[: draws.draw(st.integers(1, 3))]
    ]
    cut = draws.draw(st.integers(0, len(told)))
    text = "".join(told[:cut]).encode() + data + b"\n" + "".join(told[cut:]).encode()
    outcomes = []
    for least in (0, 10**9):
        try:
            outcomes.append(tables(TripleReader(TermDictionary(), least).graphs(text)))
        except WireError as error:
            outcomes.append(error.message)
    assert outcomes[0] == outcomes[1]


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("<urn:a> <urn:b> 5 .", 1, "column"),
        ("<urn:a> <urn:b> <urn:c> <urn:d> .", 1, "column"),
        ("\n<urn:a> <b> <urn:c> .", 2, "column 9: No scheme found in an absolute IRI"),
        (
            "<urn:a> <urn:b> <<( <urn:a> <urn:b> <urn:c> )>> .",
            1,
            "column 17: triples about",
        ),
    ],
)
@pytest.mark.parametrize("size", [1, 200])
def test_what_is_refused_tells_line_and_column(text, line, message, size):
    good = '<urn:a> <urn:b> "5" .\n' * (size - 1)
    with pytest.raises(WireError, match=message) as caught:
        decode_ntriples((good + text).encode(), 0, TermDictionary())
    assert caught.value.line == line + size - 1


GOOD = "<urn:a> <urn:b> <urn:c> <urn:g> .\n"
TOLD = f'<urn:g> <http://www.w3.org/ns/prov#generatedAtTime> "1"^^<{XSD}integer> .\n'


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        (GOOD, 1, "graph <urn:g> has no time"),
        (GOOD + TOLD + TOLD.replace('"1"', '"2"'), 3, "graph <urn:g> has two times"),
        (GOOD + TOLD + "<urn:a> <urn:b> <urn:c> .\n", 3, "a triple in no graph has no time"),
        (GOOD + TOLD.replace("integer", "string"), 2, "is no time"),
        (GOOD + TOLD.replace("integer", "dateTime"), 2, "no time"),
    ],
)
def test_graphs_without_one_time_are_refused(text, line, message):
    with pytest.raises(WireError, match=message) as caught:
        TripleReader(TermDictionary(), least=0).graphs(text.encode())
    assert caught.value.line == (line if JIT else None)
    assert message in str(caught.value)
    with pytest.raises(WireError, match=message):
        decode_nquads(text.encode(), TermDictionary())
