"""What users' SPARQL may not do, and what it may."""

import pytest
from pyoxigraph import NamedNode

from dyknow.ontology.errors import QueryRefused
from dyknow.ontology.texts.query_guard import check_user_query, read_query


@pytest.mark.parametrize(
    "text",
    [
        "SELECT * { ?s ?p ?o }",
        'ASK { ?service ?load \'INSERT\' . # DELETE\n ?s <http://e.org/SERVICE> """LOAD""" }',
        "PREFIX drop: <http://e.org/> SELECT * { ?s drop:service ?o . ?o rdfs:label 'x'@add }",
        "SELECT ?o (COUNT(?s) AS ?n) FROM <http://e.org/g> FROM NAMED <http://e.org/h> "
        "{ ?s a ?o . GRAPH ?g { ?s ?p ?o } } GROUP BY ?o HAVING (COUNT(?s) > 1) ORDER BY ?n",
        "SELECT * { VALUES (?a ?b) { " + "(1 2) " * 200 + "} ?s ?a ?b }",
        "SELECT * { " + "?s ?p ?o . FILTER(?o > 1 && ?s != ?p) " * 64 + "}",
        "SELECT * { ?s ?p " + ", ".join(["?o"] * 64) + " }",
        "ASK { FILTER(" + "(" * 62 + "1" + ")" * 62 + ") }",
        "ASK { { SELECT ?s { ?s ?p ?o } LIMIT 1 } ?s ?q ?r }",
    ],
)
def test_queries_pass(text: str) -> None:
    check_user_query(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("SELECT * { SERVICE <http://e.org/> { ?s ?p ?o } }", "SERVICE"),
        ("SELECT * { service silent ?x { ?s ?p ?o } }", "SERVICE"),
        ("LOAD <http://e.org/>", "LOAD"),
        ("INSERT DATA { dyknow:a a dyknow:UAV }", "INSERT"),
        ("DELETE WHERE { ?s ?p ?o }", "DELETE"),
        ("WITH <http://e.org/> DELETE { ?s ?p ?o } WHERE { ?s ?p ?o }", "WITH"),
        ("CLEAR ALL", "CLEAR"),
        ("SELECT * { ?s zz:p ?o }", "prefix `zz:`"),
        ("SELECT * { " + "?s ?p ?o . " * 65 + "}", "64 triple patterns"),
        ("SELECT * { ?s ?p " + ", ".join(["?o"] * 65) + " }", "64 triple patterns"),
        ("SELECT * { ?s a/" + "/".join(["a"] * 3000) + " ?o }", "64 triple patterns"),
        ("SELECT * { ?s ?p (" + "1 " * 1000 + ") }", "64 triple patterns"),
        ("SELECT * { ?s ?p " + "[ ?p 1 ; ?p " * 40 + "2" + " ]" * 40 + " }", "64 triple patterns"),
        ("ASK { FILTER(" + "(" * 65 + "1" + ")" * 65 + ") }", "64 deep"),
        ("ASK " + "{" * 65 + "}" * 65, "64 deep"),
        ("ASK {}" + " " * 9000, "8192 bytes"),
        ("", "is not a query"),
        ("SELEC * { ?s ?p ?o }", "is not a query"),
        ("SELECT", "ends too early"),
    ],
)
def test_texts_are_refused(text: str, message: str) -> None:
    with pytest.raises(QueryRefused, match=message):
        check_user_query(text)


def test_the_place_of_a_refusal() -> None:
    with pytest.raises(QueryRefused) as refusal:
        check_user_query("SELECT * {\n  SERVICE <http://e.org/> {}\n}")
    assert (refusal.value.line, refusal.value.column) == (2, 3)
    with pytest.raises(QueryRefused) as refusal:
        check_user_query("SELECT * {\n ?s ?p }")
    assert refusal.value.line == 2


def test_relative_iris_need_a_base() -> None:
    with pytest.raises(QueryRefused, match="`a` is not an IRI"):
        check_user_query("ASK FROM <a> { <s> ?p ?o }")
    query, dataset = read_query("ASK FROM <a> { <s> ?p ?o }", "http://e.org/sparql")
    assert dataset == ((NamedNode("http://e.org/a"),), ())
    assert query.base == "http://e.org/sparql"


def test_the_form_of_a_query() -> None:
    forms = {
        "PREFIX select: <http://e.org/> ASK { ?s select:x ?o }": "ASK",
        "CONSTRUCT { ?s a ?o } { SELECT * { ?s a ?o } }": "CONSTRUCT",
        "DESCRIBE dyknow:UAV": "DESCRIBE",
        "SELECT (1 AS ?x) {}": "SELECT",
    }
    assert {text: read_query(text)[0].form for text in forms} == forms


@pytest.mark.parametrize(
    ("text", "said", "line", "column"),
    [
        ("SELECT * { ?s ?p ?o FILTER(-----1 > 0) }", "`-` is not allowed here", 1, 29),
        ('SELECT * {\n ?s ?p ?o FILTER("\\uD800" = ?o) }', "U+D800 is not a character", 2, 18),
        ("SELECT * { ?s ?p ?o } LIMIT x", "`x` is not allowed here", 1, 29),
        ("SELECT * { ?s ?p ?o FILTER(NOSUCH(?s)) }", "`NOSUCH` is not allowed here", 1, 28),
        ("SELECT * { ?s ?p ?o FILTER(?s = ) }", "`)` is not allowed here", 1, 33),
        ("SELECT * {\n ?s ?p ?o", "`{` is not closed", 1, 10),
        ("ASK { ?s ?p '}' } }", "`}` closes nothing", 1, 19),
        ("ASK { ?s ?p 'abc }", "the string is not closed", 1, 13),
        ("SELECT (1 AS ?s) { ?s ?p ?o }", "`?s` is bound already", 1, 8),
        ("ASK { ?s ?p 'é' ?o }", "`?o` is not allowed here", 1, 17),
        ("ASK { ?s ?p ?o BIND(1 AS ?s) }", "`?s` is bound earlier in its group", 1, 26),
        ("SELECT", "the query ends too early", 1, 7),
    ],
)
def test_what_is_no_sparql_is_told_by_what_stands_there(
    text: str, said: str, line: int, column: int
) -> None:
    with pytest.raises(QueryRefused) as refusal:
        check_user_query(text)
    assert said in refusal.value.message
    assert "expected" not in refusal.value.message
    assert (refusal.value.line, refusal.value.column) == (line, column)
    assert refusal.value.hint
