"""Laws of the languages: printing and parsing undo each other, terms survive, errors are placed."""

import re

from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Store, Variable
from rdflib import Literal as RdflibLiteral
from rdflib import URIRef
from rdflib.plugins.sparql.algebra import translateQuery
from rdflib.plugins.sparql.parser import parseQuery

from dyknow.languages.csparql import (
    bind,
    body_sparql,
    format_query,
    parse_argument,
    parse_event_request,
    parse_query,
    parse_template,
    term_text,
)
from dyknow.languages.errors import LanguageError, Span
from dyknow.languages.ssl import Declaration, format_declaration, parse_ssl
from dyknow.languages.ssl.ast import (
    Argument,
    CompunitDeclaration,
    Entity,
    FeatureTerm,
    FieldFeature,
    SourceDeclaration,
    StreamDeclaration,
    UnitPower,
)

HERE = Span(0, 0)
KEYWORDS = ["stream", "contains", "for", "every", "as", "source", "provides"]
KEYWORDS += ["compunit", "transforms", "to", "no_unit"]
names = st.sampled_from(KEYWORDS) | st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,5}", fullmatch=True)
powers = st.integers(-9, 9).filter(bool)
units = st.none() | st.lists(
    st.builds(UnitPower, st.from_regex(r"[A-Za-z]{1,4}", fullmatch=True), powers), max_size=3
).map(tuple)
prefixed = st.from_regex(r"[a-z][a-z-]{0,3}:[A-Za-z0-9_]{1,3}", fullmatch=True)
iris = st.from_regex(r"<http://[a-z/#.0-9]{1,5}>", fullmatch=True)
terms = names | prefixed | iris
fields = names | st.from_regex(r"[A-Za-z0-9 .\[\]äé,=]{1,6}", fullmatch=True)
arguments = st.builds(Argument, terms, st.none() | names, st.just(HERE))
features = st.builds(
    FeatureTerm,
    terms,
    st.lists(arguments, max_size=3).map(tuple),
    fields,
    units,
    st.just(HERE),
    st.just(HERE),
)
ports = st.builds(FieldFeature, fields, terms, units, st.just(HERE), st.just(HERE))
conditions = st.lists(st.builds(Entity, terms, fields, st.just(HERE)), max_size=3)
governed = st.lists(st.builds(Entity, terms, fields, st.just(HERE), st.just(True)), max_size=3)
streams = st.builds(
    lambda name, contents, before, after: StreamDeclaration(
        name, contents, (*before, *after), HERE
    ),
    names,
    st.lists(features, min_size=1, max_size=3).map(tuple),
    conditions,
    governed,
)
declarations = (
    streams
    | st.builds(SourceDeclaration, names, ports, st.just(HERE))
    | st.builds(
        CompunitDeclaration,
        names,
        st.lists(ports, min_size=1, max_size=3).map(tuple),
        ports,
        st.just(HERE),
    )
)


@settings(deadline=None, max_examples=200)
@given(st.lists(declarations, max_size=3))
def test_ssl_printed_is_parsed_again(wanted: list[Declaration]) -> None:
    text = "\n".join(map(format_declaration, wanted))
    assert parse_ssl(text) == tuple(wanted)


TEMPLATE = """REGISTER TEMPLATE dyknow:E(?o, ?name) COMPUTE EVERY 1s AS
CONSTRUCT {?o dyknow:name ?name}
WHERE { ?o dyknow:name ?name . }
AGGREGATE {(?n, COUNT, {?o}) FILTER (?n > 0 || ?name != "x")}
WINDOW [RANGE 5s STEP 1s]
"""
hostile = st.sampled_from(
    [
        "} DROP ALL",
        '"',
        "'''",
        "\\",
        "\\u0041",
        "\\\\u00410041",
        "\n#",
        "\t",
        "{",
        "?o",
        "U",
        "\r\n",
    ]
)
characters = st.text(st.characters(exclude_categories=["Cs"]), max_size=6)
texts = st.lists(hostile | characters, max_size=5).map("".join)
literals = (
    texts.map(Literal)
    | texts.map(lambda text: Literal(text, language="en-GB"))
    | texts.map(lambda text: Literal(text, datatype=NamedNode("http://example.org/type")))
)


@settings(deadline=None, max_examples=120)
@given(literals)
def test_a_bound_literal_comes_back_unchanged(literal: Literal) -> None:
    query = bind(parse_template(TEMPLATE).query, {Variable("name"): literal})
    body = body_sparql(query)
    wanted = RdflibLiteral(
        literal.value,
        lang=literal.language,
        datatype=None if literal.language else URIRef(literal.datatype.value),
    )
    if literal.datatype == Literal("").datatype:
        wanted = RdflibLiteral(literal.value)
    assert wanted in _literals(translateQuery(parseQuery(body)).algebra), body
    again = parse_query(format_query(query))
    for text in (body, body_sparql(again)):
        Store().query(text)


@settings(deadline=None, max_examples=200)
@given(literals)
def test_a_written_term_is_read_again(literal: Literal) -> None:
    text = term_text(literal)
    assert parse_argument(text) == literal
    (row,) = Store().query(f"SELECT ?x WHERE {{ VALUES ?x {{ {text} }} }}")
    assert row["x"] == literal


def _literals(tree: object) -> list[RdflibLiteral]:
    """Every literal of rdflib's parse tree."""
    if isinstance(tree, RdflibLiteral):
        return [tree]
    if isinstance(tree, str):
        return []
    if isinstance(tree, dict):
        return [found for value in tree.values() for found in _literals(value)]
    try:
        parts = list(tree)  # type: ignore[call-overload]
    except TypeError:
        return []
    return [found for part in parts for found in _literals(part)]


SSL = """stream s2 contains altitude(uav1) = alt [ft] for uav1 = id # condition
stream s4 contains xydist(UAV as arg1, UAV as arg2) = dist
for every arg1 = id1, arg2 = id2
compunit c transforms alt:altitude [ft] to spd:speed [mi.h-1]
"""
CSPARQL = """PREFIX ex: <http://example.org/>
REGISTER TEMPLATE dyknow:E(?o, ?threshold) COMPUTE EVERY 1s AS
SELECT ?o ?avg
FROM <http://www.ida.liu.se/dyknow/ontology.rdf>
FROM STREAM <http://www.ida.liu.se/dyknow/s59.trdf> [RANGE 5s STEP 1s]
WHERE { ?o a ex:UAV ; ex:n "\\u0041", 'x'@en . ?o dyknow:speed ?spd . # speed
\tOPTIONAL { ?o ex:a ?a FILTER(?a > 3.5e1) } }
AGGREGATE {(?avg, AVG, {?spd}) FILTER (?avg > ?threshold)}
WINDOW [RANGE 5s TUMBLING]
"""
SPARQL_11 = """REGISTER QUERY q EVERY 1s AS
SELECT ?o (AVG(?spd) AS ?avg) WHERE { ?o dyknow:speed ?spd
  { SELECT ?o (MAX(?m) AS ?top) WHERE { ?o dyknow:speed ?m } GROUP BY ?o HAVING(?top > 5) } }
GROUP BY ?o HAVING(?avg > 100) ORDER BY DESC(?avg) LIMIT 3
WINDOW [RANGE 5s STEP 1s]
"""
RSP_QL = """PREFIX : <http://example.org/>
REGISTER ISTREAM <out> COMPUTE EVERY PT1S AS
SELECT DISTINCT ISTREAM ?o ?w FROM NAMED :g
FROM NAMED WINDOW :w ON STREAM :s [RANGE PT0.5S STEP "PT1S"^^xsd:duration]
FROM WINDOW ON :s [LANDMARK "2021-10-07T19:12:53Z"^^xsd:dateTime STEP 1s]
FROM NAMED WINDOW :v ON :s [ELEMENTS 10 STEP 5]
WHERE { WINDOW :w { ?o :in (1 2) } OPTIONAL { WINDOW ?w { ?o :b ?t } } GRAPH ?g { ?o a :C }
  FILTER (f:timestamp(?o, :in, ?t) < xsd:integer(?t)) }
"""
NO_REGISTER = """# roads
select ?a #?b
from stream <http://example.org/a> [triples 10 tumbling]
FROM <http://example.org/g>
where { ?a <http://example.org/p> ?b Filter dyknow-o:validTime(?a) }
"""
REQUEST = 'dyknow:HighSpeedEvent(?o, dyknow:UAV, "100"^^xsd:integer, -1.5e3, "a"@en)'
PIECES = """^^ ?x <x> 5s 1e9 [m0] \\u00zz ex:a every for as WHERE FROM STREAM NAMED WINDOW
AGGREGATE FILTER SELECT PREFIX GROUP BY HAVING VALUES BIND MINUS EXISTS SERVICE CONSTRUCT ASK
DESCRIBE BASE ISTREAM RSTREAM ON GRAPH TRIPLES LANDMARK RANGE STEP PT5S P1M 60000 f:timestamp( :w
:s ?w :foo("""
pieces = st.sampled_from([*"{}()[],.;?<>\"'\\#@^=-:*0é\n\t\x00", *PIECES.split()])


@st.composite
def mutations(draw: st.DrawFn, text: str) -> str:
    """The text with one to three tokens dropped, doubled or replaced."""
    parts = re.findall(r"\w+|\s+|.", text)
    for _ in range(draw(st.integers(1, 3))):
        index = draw(st.integers(0, len(parts) - 1))
        parts[index] = draw(st.sampled_from(["", parts[index] * 2]) | pieces)
    return "".join(parts[: draw(st.integers(0, len(parts)))] if draw(st.booleans()) else parts)


def _check(error: LanguageError, text: str) -> None:
    assert error.source == text
    assert 0 <= error.span.start <= error.span.end <= len(text)
    assert "^" in error.render()


@settings(deadline=None, max_examples=200)
@given(mutations(SSL))
def test_an_ssl_error_has_a_place(text: str) -> None:
    try:
        parse_ssl(text)
    except LanguageError as error:
        _check(error, text)


@settings(deadline=None, max_examples=200)
@given(st.one_of(map(mutations, [CSPARQL, SPARQL_11, RSP_QL, NO_REGISTER])))
def test_a_csparql_error_has_a_place(text: str) -> None:
    try:
        if "TEMPLATE" in text:
            format_query(parse_template(text).query)
        else:
            # What is accepted can be printed and read again.
            printed = format_query(parse_query(text))
            assert format_query(parse_query(printed)) == printed
    except LanguageError as error:
        if error.source == text:
            _check(error, text)
        else:
            raise


@settings(deadline=None, max_examples=200)
@given(mutations(REQUEST))
def test_a_request_error_has_a_place(text: str) -> None:
    try:
        parse_event_request(text)
    except LanguageError as error:
        _check(error, text)
