"""The parser of SPARQL texts: names, ``<``, escapes, what is bounded, what is printed."""

from __future__ import annotations

import pytest
from pyoxigraph import Literal, NamedNode, Store, Variable

from dyknow.sparql import LanguageError, parse_sparql, print_query
from dyknow.sparql.ast import (
    Aggregate,
    Arithmetic,
    Comparison,
    Expression,
    Filter,
    Logical,
    Query,
    Triple,
    Triples,
    Unary,
    variables_of,
    walk,
)
from dyknow.sparql.tokens import Limits

EX = "http://example.org/"
PREFIXES = {"": EX}
V, W = Variable("v"), Variable("w")
ONE, TWO = Literal(1), Literal(2)


def condition(text: str, limits: Limits | None = None) -> Expression:
    query = parse_sparql(f"SELECT * {{ ?s ?p ?v . FILTER({text}) }}", PREFIXES, limits or Limits())
    (found,) = (node for node in walk(query) if isinstance(node, Filter))
    return found.condition


def triple(text: str) -> Triple:
    query = parse_sparql(f"SELECT * {{ {text} }}", PREFIXES)
    assert query.where is not None
    (block,) = query.where.elements
    assert isinstance(block, Triples)
    (found,) = block.triples
    return found


# -- what `<` means --------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["?v<1&&?w>2", "?v < 1 && ?w > 2", "?v<1 &&?w>2"])
def test_where_an_operator_is_due_it_is_less_than(text: str) -> None:
    assert condition(text) == Logical("&&", (Comparison("<", V, ONE), Comparison(">", W, TWO)))


def test_where_a_term_is_due_it_begins_an_iri() -> None:
    assert condition("?v=<urn:a>") == Comparison("=", V, NamedNode("urn:a"))
    assert condition("<urn:a><<urn:b>") == Comparison("<", NamedNode("urn:a"), NamedNode("urn:b"))
    assert triple("?v<urn:a>?w").predicate == NamedNode("urn:a")


def test_an_absolute_iri_is_as_written_whatever_the_base() -> None:
    query = parse_sparql("BASE <http://b.example/x/> ASK { <http://a.example/?> <y> <z:#> }", {})
    found = [node.value for node in walk(query) if isinstance(node, NamedNode)]
    assert found == ["http://a.example/?", "http://b.example/x/y", "z:#"]


def test_less_or_equal_is_one_sign() -> None:
    assert condition("?v<=1&&?w>=2") == Logical(
        "&&", (Comparison("<=", V, ONE), Comparison(">=", W, TWO))
    )


# -- names -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["éclair", "a\u0301", "a\u00b7b", "a\u203fb", "a\u2040", "名", "\U00010000x", "1a", "_"]
)
def test_variables_are_those_of_the_grammar(name: str) -> None:
    query = parse_sparql(f"SELECT ?{name} {{ ?{name} ?p ?o }}", {})
    assert next(iter(variables_of(query))) == name


@pytest.mark.parametrize("name", ["a\u00d7b", "a\u037eb", "\u0301a", "\u00b7a", "\ufffea"])
def test_no_other_characters_stand_in_variables(name: str) -> None:
    with pytest.raises(LanguageError):
        parse_sparql(f"SELECT ?{name} {{ ?s ?p ?o }}", {})


@pytest.mark.parametrize(
    ("name", "iri"),
    [
        (":a\u0301", "a\u0301"),
        (":a\u00b7b.c", "a\u00b7b.c"),
        (":a\u203f", "a\u203f"),
        (":a-b", "a-b"),
        (":a:b", "a:b"),
        (":%41b", "%41b"),
        (":a\\'b", "a'b"),
        (":1", "1"),
    ],
)
def test_prefixed_names_are_those_of_the_grammar(name: str, iri: str) -> None:
    assert triple(f"?s {name} ?o").predicate == NamedNode(EX + iri)


def test_prefixes_and_labels_have_the_characters_of_names() -> None:
    query = "PREFIX a\u0301\u00b7b: <urn:x:> ASK { _:c\u203f a\u0301\u00b7b:y ?o }"
    assert "urn:x:y" in print_query(parse_sparql(query, {}))
    with pytest.raises(LanguageError):
        parse_sparql("PREFIX \u0301a: <urn:x:> ASK {}", {})


def test_escapes_of_code_points() -> None:
    assert triple('?\\u0061 <urn:\\u0062> "\\U00000063"') == Triple(
        Variable("a"), NamedNode("urn:b"), Literal("c")
    )
    assert triple("?s :\\u00e9 ?o").predicate == NamedNode(f"{EX}é")


@pytest.mark.parametrize("name", ["?a\\u0020b", "?a\\u002Bb", "?a\\uD800", ":a\\u007Db"])
def test_an_escape_in_a_name_is_a_character_of_names(name: str) -> None:
    with pytest.raises(LanguageError, match="is not a name"):
        parse_sparql(f"SELECT * {{ ?s ?p {name} }}", PREFIXES)


# -- numbers and signs -----------------------------------------------------------------------------


def test_a_sign_that_touches_a_number_is_its_own_but_behind_an_operand() -> None:
    assert condition("?v = -1") == Comparison("=", V, Literal(-1))
    assert condition("?v-1 = 0") == Comparison("=", Arithmetic(V, (("-", ONE),)), Literal(0))
    assert condition("- 1 = ?v") == Comparison("=", Unary("-", ONE), V)
    assert triple("?s :p +5").object == Literal("+5", datatype=Literal(5).datatype)
    assert triple("?s :p+ ?o").predicate != NamedNode(EX + "p")


def test_operators_in_a_row_are_one_node() -> None:
    assert condition("1+2-1*2*2+?v") == Arithmetic(
        ONE,
        (("+", TWO), ("-", Arithmetic(ONE, (("*", TWO), ("*", TWO)))), ("+", V)),
    )


# -- what is bounded -------------------------------------------------------------------------------

NESTED = [
    "(" * 70 + "?v" + ")" * 70,
    "ABS(" * 70 + "?v" + ")" * 70,
    "EXISTS {" * 70 + "}" * 70,
    "!" * 70 + "?v",
    "?v<" + "!" * 40_000 + "1&&2>1",
]


@pytest.mark.parametrize("text", NESTED, ids=range(len(NESTED)))
def test_what_nests_is_bounded(text: str) -> None:
    with pytest.raises(LanguageError, match=r"nested more than 64 deep|more than 64 negations"):
        condition(text)


@pytest.mark.parametrize(
    ("text", "height"),
    [
        ("?v + 1 * 2 > 1", 2),
        ("1 - (2 - (3 - ?v)) > 1", 3),
        ("(1 - 2 - 3) / ?v > 1", 3),
        ("!(?v > 1 + 2)", 2),
        ("?v > 1 || ?v > 2 || ?v < 1 - 1", 3),
        ("?v IN (1, 1 + 1, ?v * 2 * 3)", 2),
        ("COALESCE(1 + 2, 3) > - ?v", 1),
        ("?v<1+1+1&&2>1", 3),
    ],
)
def test_the_height_of_an_expression_is_known_exactly(text: str, height: int) -> None:
    condition(text, Limits(operators=height))
    with pytest.raises(LanguageError, match=f"more than {height - 1} operators"):
        condition(text, Limits(operators=height - 1))


def test_many_that_are_alike_are_not_high() -> None:
    condition(" || ".join(["?v = 1"] * 5_000), Limits(operators=128))
    condition(" && ".join(["?v<1&&?w>2"] * 5_000), Limits(operators=128))


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("?s :p ?o", 1),
        ("?s :p ?o , 1 ; :q ?o", 3),
        ("?s :p/:q/:r ?o", 3),
        ("?s :p|^:q ?o", 2),
        ("?s !(:p|:q) ?o", 2),
        ("?s :p (1 2)", 5),
        ("?s :p [ :q 1 ]", 2),
    ],
)
def test_patterns_are_counted(text: str, count: int) -> None:
    parse_sparql(f"ASK {{ {text} }}", PREFIXES, Limits(patterns=count))
    with pytest.raises(LanguageError, match=f"more than {count - 1} triple patterns"):
        parse_sparql(f"ASK {{ {text} }}", PREFIXES, Limits(patterns=count - 1))


# -- rules beside the grammar ----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "message", "column"),
    [
        ("ASK { ?s ?p ?o BIND (1 AS ?o) }", "is bound earlier in its group", 27),
        ("SELECT (1 AS ?s) { ?s ?p ?o }", "is bound already", 8),
        ("SELECT ?s (COUNT(*) AS ?n) { ?s ?p ?o }", "neither grouped nor aggregated", 8),
        ("SELECT * { ?s ?p ?o } GROUP BY ?s", "is not allowed with GROUP BY", 1),
        ("ASK { _:a ?p ?o OPTIONAL { _:a ?q ?r } }", "occurs in two graph patterns", 28),
        ("ASK { FILTER(COUNT(?x) > 1) }", "is not allowed here", 14),
        ("ASK { FILTER(STRLEN(?x, 1) > 1) }", "`STRLEN` takes 1 argument, not 2", 14),
        ("ASK { FILTER(BOUND(1)) }", "`BOUND` takes a variable", 14),
        ("ASK { VALUES (?a ?b) { (1) } }", "expected a row of 2, found a row of 1", 24),
        ("PREFIX a:b: <urn:x> ASK {}", "expected a prefix like `dyknow:`", 8),
        ("SELECT ?s { ?s ?p ?o } LIMIT 1 LIMIT 2", "is not allowed here", 38),
        ("SELECT (SUM(SUM(?x)) AS ?y) { ?s ?p ?x }", "is not allowed here", 13),
    ],
)
def test_what_is_no_matter_of_the_grammar(text: str, message: str, column: int) -> None:
    with pytest.raises(LanguageError, match=message) as caught:
        parse_sparql(text, {})
    assert (caught.value.line, caught.value.column) == (1, column)


def test_a_label_is_of_its_graph_pattern_and_of_the_template() -> None:
    parse_sparql(
        "CONSTRUCT { _:a ?p ?o } { _:a ?p ?o FILTER(?o > 1) _:a ?q ?r OPTIONAL { _:b ?s ?t } }", {}
    )


# -- what is printed -------------------------------------------------------------------------------

ROUND = [
    "SELECT DISTINCT ?s (COUNT(DISTINCT *) AS ?n) { ?s a :C ; :p/^:q*|!(:r|^:s) ?o } GROUP BY ?s "
    "HAVING (COUNT(*) > 1) ORDER BY DESC(?n) ?s LIMIT 3 OFFSET 1",
    "SELECT REDUCED * { { ?s :p -1.5e3 } UNION { ?s :p 'x'@en-GB } UNION {} MINUS { ?s :q true } }",
    'CONSTRUCT WHERE { ?s :p """l\n"x """ }',
    "CONSTRUCT { _:a :p ?x } { GRAPH ?g { ?x :p ?y } GRAPH :g {} VALUES (?x ?z) { (1 UNDEF) } }",
    "BASE <http://b.example/> SELECT (IRI('c') AS ?i) { <d> ?p ?o }",
    "DESCRIBE :a ?x { ?x :p ?y OPTIONAL { ?x :q ?z FILTER(?z<?y&&?y>1) } } VALUES ?x { :a UNDEF }",
    "ASK { FILTER(!(?a || !?b) && NOT EXISTS { ?a :p ?b } || ?a NOT IN () && - ?a IN (1, +2)) }",
    "SELECT ?k { { SELECT (GROUP_CONCAT(?o ; SEPARATOR = '\\n') AS ?k) { ?s ?p ?o } } } ",
    "SELECT (SUM(?x + 1) / COUNT(?x) AS ?m) { ?s ?p ?x } GROUP BY (STR(?s) AS ?k) (?p)",
    "SELECT * { BIND(IF(?a, CONCAT(), COALESCE(?a, RAND())) AS ?b) FILTER :f(?a) }",
]


@pytest.mark.parametrize("text", ROUND)
def test_what_is_printed_is_read_as_the_same(text: str) -> None:
    query = parse_sparql(text, PREFIXES)
    for prefixes in ({}, PREFIXES):
        printed = print_query(query, prefixes)
        assert parse_sparql(printed, {}) == query
        assert print_query(parse_sparql(printed, {}), prefixes) == printed


def test_oxigraph_reads_a_key_by_another_name() -> None:
    """Its parser refuses ``GROUP BY (?x AS ?key)``."""
    query = parse_sparql("SELECT ?k { VALUES ?x { 1 2 1 } } GROUP BY (?x AS ?k)", {})
    assert isinstance(query, Query)
    assert sorted(row["k"].value for row in Store().query(print_query(query))) == ["1", "2"]


def test_aggregates_are_found_in_order_by() -> None:
    query = parse_sparql("SELECT ?s { ?s ?p ?o } GROUP BY ?s ORDER BY COUNT(?o)", {})
    assert query.is_aggregated
    assert query.order[0].expression == Aggregate("COUNT", Variable("o"))
