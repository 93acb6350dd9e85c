"""Statements of a stream of RDF are what pyoxigraph's parser finds, as samples and as triples."""

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import BlankNode, DefaultGraph, Literal, NamedNode, RdfFormat, parse
from rdf_drawing import XSD, bodies

from dyknow.converters import WireError
from dyknow.converters.ndjson import decode_ndjson, encode_ndjson
from dyknow.converters.rdf.statement_converter import StatementConverter
from dyknow.converters.rdf.statements import (
    SCHEMA,
    check_statements,
    decode_statements,
    with_named_nodes,
)
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.rdf.timed import Kind, make_literal

LIMITS = settings(deadline=None, max_examples=300)
TERMS = NamedNode | BlankNode | Literal


def parsed(data):
    """The quads of a text without graph times; None where it is refused."""
    try:
        found = list(parse(data, format=RdfFormat.N_QUADS))
    except SyntaxError:
        return None
    return found if all(isinstance(q.object, TERMS) for q in found) else None


def numbered(quads):
    """The same quads with blank nodes by order of appearance, graph first."""
    names = {}

    def name(term):
        if not isinstance(term, BlankNode):
            return term
        return names.setdefault(term, BlankNode(f"b{len(names)}"))

    rows = []
    for quad in quads:
        graph = name(quad.graph_name)
        rows.append((name(quad.subject), quad.predicate, name(quad.object), graph))
    return rows


def statements(batch):
    """The statements of samples by their definition."""

    def term(text):
        (quad,) = parse(f"<x:s> <x:p> {text} .", format=RdfFormat.N_TRIPLES)
        return quad.object

    for _, _, row in batch.rows():
        if row["object"] is None:
            object = make_literal(Kind[row["datatype"].upper()], row["number"])
        else:
            object = term(row["object"])
        graph = DefaultGraph() if row["graph"] is None else term(row["graph"])
        yield term(row["subject"]), term(row["predicate"]), object, graph


def triples(timed):
    return Counter(timed.with_valid())


@given(st.lists(bodies(graphs=True), min_size=1, max_size=3))
@LIMITS
def test_samples_and_triples_are_what_the_parser_finds(texts):
    pools, dictionary = {}, TermDictionary()
    converter = StatementConverter("s", dictionary)
    for number, data in enumerate(texts):
        expected = parsed(data)
        if not expected:
            with pytest.raises(WireError):
                decode_statements(data, RdfFormat.N_QUADS, pools)
            continue
        rows = numbered(expected)
        incoming = decode_statements(data, RdfFormat.N_QUADS, pools)
        assert incoming.stamped
        assert incoming.valid_on_arrival
        nodes = [term for row in rows for term in row if isinstance(term, BlankNode)]
        assert incoming.has_nodes == bool(nodes)
        batch = incoming.batch
        assert list(statements(batch)) == rows
        assert triples(converter.convert(batch)) == Counter((0, 0, s, p, o) for s, p, o, _ in rows)
        named = with_named_nodes(batch, number)
        renamed = [
            tuple(
                BlankNode(f"s{number}{term.value}") if isinstance(term, BlankNode) else term
                for term in row
            )
            for row in rows
        ]
        assert list(statements(named)) == renamed
        check_statements(named)
        again = decode_ndjson(encode_ndjson(named), SCHEMA, {}).batch
        check_statements(again)
        if number == 1:
            del expected
            dictionary.collect()
        assert triples(converter.convert(again)) == triples(
            from_terms([(0, s, p, o) for s, p, o, _ in renamed], TermDictionary())
        )


TIMES = st.integers(0, 5)


@given(
    st.lists(st.tuples(st.integers(0, 5), st.integers(0, 5)), max_size=10),
    st.dictionaries(st.integers(0, 5), TIMES, min_size=1),
)
@LIMITS
def test_the_earliest_time_that_leads_to_a_subject_is_its_own(links, own):
    property = "urn:time"
    lines = [f"<urn:{s}> <urn:p> <urn:{o}> ." for s, o in links]
    lines += [f'<urn:{s}> <{property}> "{time}"^^<{XSD}integer> .' for s, time in own.items()]
    text = "\n".join(lines).encode()
    # By definition: all paths from subjects with a time, through subjects without one.
    times = dict(own)
    for _ in range(len(links) + 1):
        for s, o in links:
            if s in times and o not in own:
                times[o] = min(times.get(o, times[s]), times[s])
    subjects = {s for s, _ in links} | set(own)
    if not subjects <= set(times):
        with pytest.raises(WireError, match="has no time"):
            decode_statements(text, RdfFormat.N_TRIPLES, {}, None, property)
        return
    incoming = decode_statements(text, RdfFormat.N_TRIPLES, {}, None, property)
    assert not incoming.stamped
    found = [(row["subject"], available, valid) for available, valid, row in incoming.batch.rows()]
    assert found == sorted(found, key=lambda each: each[1])
    assert Counter(found) == Counter(
        (f"<urn:{s}>", times[s], times[s]) for s in [*(s for s, _ in links), *own]
    )


@given(bodies(graphs=True), bodies(graphs=True))
@LIMITS
def test_codes_do_not_depend_on_earlier_texts(earlier, data):
    """A thread remembers terms, and a replay has to give the codes of then."""
    found = []
    for texts in ([data], [earlier, data], [data, earlier, data]):
        for text in texts:
            pools = {}
            try:
                batch = decode_statements(text, RdfFormat.N_QUADS, pools).batch
            except WireError:
                batch = None
        codes = {} if batch is None else {n: c.values.tolist() for n, c in batch.columns.items()}
        found.append((codes, {name: pool.strings() for name, pool in pools.items()}))
    assert found[0] == found[1] == found[2]
