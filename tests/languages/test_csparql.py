"""C-SPARQL queries and templates: what they say, what they answer ([Events14 §III-V], SPEC §5)."""

from concurrent.futures import ThreadPoolExecutor

import pytest
from pyoxigraph import BlankNode, Literal, NamedNode, Quad, Store, Variable

from dyknow.languages.csparql import (
    Form,
    TimeWindow,
    bind,
    body_sparql,
    body_tree,
    format_query,
    group_keys,
    parse_argument,
    parse_event_request,
    parse_query,
    parse_template,
    required_parameters,
    with_streams,
)
from dyknow.languages.errors import LanguageError
from dyknow.rdf.namespaces import DYKNOW, RDF_TYPE, XSD

SECOND = 1_000_000_000
LISTING_3 = """REGISTER STREAM HighSpeedEvent COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?uav dyknow:speed ?avgSpeed}
FROM <http://www.ida.liu.se/dyknow/ontology.rdf>
FROM STREAM <http://www.ida.liu.se/dyknow/s59.trdf> [RANGE 5s STEP 1s]
WHERE { ?uav a dyknow:UAV . ?uav dyknow:speed ?spd . }
AGGREGATE {(?avgSpeed, AVG, {?spd}) FILTER (?avgSpeed > 100)}
"""
LISTING_4 = """REGISTER TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?avgSpeed}
FROM <http://www.ida.liu.se/dyknow/ontology.rdf>
WHERE { ?o a ?type . ?o dyknow:speed ?spd . }
AGGREGATE {(?avgSpeed, AVG, {?spd}) FILTER (?avgSpeed > ?threshold)}
WINDOW [RANGE 5s STEP 1s]
"""
SPARQL_11 = """REGISTER TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
SELECT ?o (AVG(?spd) AS ?avgSpeed)
WHERE { ?o a ?type . ?o dyknow:speed ?spd . }
GROUP BY ?o HAVING(?avgSpeed > ?threshold)
WINDOW [RANGE 5s STEP 1s]
"""


def dyknow(name: str) -> NamedNode:
    return NamedNode(DYKNOW + name)


def integer(value: int) -> Literal:
    return Literal(str(value), datatype=NamedNode(XSD + "integer"))


def flights() -> Store:
    """Two UAVs and a car; uav1 at 90 and 130, uav2 at 50, the car at 150."""
    store = Store()
    speeds = {"uav1": ("UAV", (90, 130)), "uav2": ("UAV", (50,)), "car1": ("Car", (150,))}
    for name, (sort, values) in speeds.items():
        store.add(Quad(dyknow(name), RDF_TYPE, dyknow(sort)))
        for value in values:
            store.add(Quad(dyknow(name), dyknow("speed"), integer(value)))
    return store


def constructed(sparql: str) -> set[tuple[str, str]]:
    triples = flights().query(sparql)
    return {(t.subject.value.removeprefix(DYKNOW), t.object.value) for t in triples}


def selected(sparql: str) -> set[tuple[str, ...]]:
    rows = flights().query(sparql)
    return {tuple(row[v].value.removeprefix(DYKNOW) for v in rows.variables) for row in rows}


def test_listing_3() -> None:
    query = parse_query(LISTING_3)
    assert query.name == "HighSpeedEvent"
    assert query.produces_stream
    assert query.every == SECOND
    assert query.form is Form.CONSTRUCT
    assert query.static == (DYKNOW + "ontology.rdf",)
    (stream,) = query.streams
    assert stream.iri == DYKNOW + "s59.trdf"
    assert stream.window == TimeWindow(5 * SECOND, SECOND)
    (aggregation,) = query.aggregations
    assert aggregation.function == "AVG"
    assert group_keys(query) == (Variable("uav"),)
    assert query.body.where is not None
    assert LISTING_3[query.body.where.span.start :].startswith("{ ?uav a dyknow:UAV")
    assert constructed(body_sparql(query)) == {("uav1", "110")}


def test_listing_4_as_in_the_scenario() -> None:
    template = parse_template(LISTING_4)
    assert template.name == DYKNOW + "HighSpeedEvent"
    assert [p.value for p in template.parameters] == ["o", "type", "threshold"]
    assert required_parameters(template) == (Variable("threshold"),)
    request = parse_event_request(
        'dyknow:HighSpeedEvent(dyknow:uav1, dyknow:UAV, "100"^^xsd:integer)'
    )
    assert request.event == template.name
    assert request.arguments == (dyknow("uav1"), dyknow("UAV"), integer(100))
    query = bind(template.query, dict(zip(template.parameters, request.arguments, strict=True)))
    assert constructed(body_sparql(query)) == {("uav1", "110")}
    running = with_streams(query, ["dyknow_reserved35"])
    text = format_query(running)
    assert (
        "FROM STREAM <http://www.ida.liu.se/dyknow/dyknow_reserved35.trdf> [RANGE 5s STEP" in text
    )
    again = parse_query(text)
    assert [clause.iri for clause in again.streams] == [DYKNOW + "dyknow_reserved35.trdf"]
    assert constructed(body_sparql(again)) == {("uav1", "110")}


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ({"type": dyknow("UAV"), "threshold": integer(100)}, {"uav1"}),
        ({"type": dyknow("UAV"), "threshold": integer(1)}, {"uav1", "uav2"}),
        ({"type": dyknow("Car"), "threshold": integer(1)}, {"car1"}),
        ({"threshold": integer(120)}, {"car1"}),
        ({"o": dyknow("uav2"), "threshold": integer(100)}, set()),
        ({"type": dyknow("UAV"), "threshold": integer(1), "o": dyknow("uav2")}, {"uav2"}),
    ],
)
@pytest.mark.parametrize("text", [LISTING_4, SPARQL_11])
def test_a_binding_joins_with_the_row_of_parameters(
    text: str, arguments: dict[str, NamedNode | Literal], expected: set[str]
) -> None:
    given = {Variable(name): term for name, term in arguments.items()}
    query = bind(parse_template(text).query, given)
    for sparql in (body_sparql(query), body_sparql(parse_query(format_query(query)))):
        answers = constructed(sparql) if query.form is Form.CONSTRUCT else selected(sparql)
        assert {answer[0] for answer in answers} == expected


@pytest.mark.parametrize(
    ("limit", "written"),
    [('"100"^^xsd:integer', "100"), ('"100"@en', '"100"@en'), ("100", "100")],
)
def test_a_condition_on_an_aggregate_may_have_any_literal(limit: str, written: str) -> None:
    query = parse_query(LISTING_3.replace("> 100", f"> {limit}"))
    assert f"(AVG(?spd) > {written})" in body_sparql(query)


def test_having_over_an_alias_is_the_aggregate() -> None:
    text = (
        "REGISTER STREAM s AS SELECT ?o (AVG(?v) AS ?a) (?a * 2 AS ?b) "
        "WHERE { ?o dyknow:speed ?v } GROUP BY ?o HAVING(?a > 100 && ?b < 250) "
        "WINDOW [RANGE 5s STEP 1s]"
    )
    assert {row[0] for row in selected(body_sparql(parse_query(text)))} == {"uav1"}


def headed(head: str) -> str:
    return (
        f"REGISTER STREAM s AS SELECT {head} WHERE {{ ?o dyknow:speed ?v }} "
        "WINDOW [RANGE 5s STEP 1s]"
    )


def test_names_that_stand_for_each_other_are_bounded() -> None:
    """Written out, forty names that are each twice the one before fill any memory."""
    names = ["(COUNT(?v) AS ?a0)", *(f"(?a{n} + ?a{n} AS ?a{n + 1})" for n in range(40))]
    with pytest.raises(LanguageError, match="aliases in the head expand"):
        parse_query(headed(" ".join(names)))
    chain = ["(COUNT(?v) AS ?a0)", *(f"(?a{n} + 1 AS ?a{n + 1})" for n in range(300))]
    with pytest.raises(LanguageError, match="aliases in the head expand"):
        parse_query(headed(" ".join(chain)))
    parse_query(headed(" ".join(names[:8])))


def test_an_aggregate_of_an_aggregate_is_refused() -> None:
    with pytest.raises(LanguageError, match=r"`\?a` is computed in the head") as caught:
        parse_query(headed("(AVG(?v) AS ?a) (SUM(?a) AS ?b)"))
    assert caught.value.column == len("REGISTER STREAM s AS SELECT (AVG(?v) AS ?a) ") + 1


def test_parameters_reach_nested_groups() -> None:
    template = parse_template(
        "REGISTER TEMPLATE dyknow:E(?low, ?high) AS SELECT ?o WHERE { "
        "{ ?o dyknow:speed ?v FILTER(?v < ?low) } UNION { ?o dyknow:speed ?v FILTER(?v > ?high) } "
        "{ SELECT ?o WHERE { ?o dyknow:speed ?w } GROUP BY ?o HAVING(COUNT(?w) < ?high) } } "
        "WINDOW [RANGE 5s STEP 1s]"
    )
    given = {Variable("low"): integer(60), Variable("high"): integer(140)}
    query = bind(template.query, given)
    # A row at the top, and one in each of the three nested groups.
    assert body_sparql(query).count("VALUES") == 4
    assert selected(body_sparql(query)) == {("uav2",), ("car1",)}
    assert selected(body_sparql(parse_query(format_query(query)))) == {("uav2",), ("car1",)}


def test_instances_of_a_template_share_one_tree() -> None:
    query = parse_template(LISTING_4).query
    given = [{Variable("threshold"): integer(n)} for n in (1, 100)]
    first, second = (bind(query, arguments) for arguments in given)
    assert body_tree(first) is body_tree(second)
    assert Variable("threshold") in group_keys(first)
    assert body_tree(query) is not body_tree(first)


def test_two_prefixes_of_one_namespace() -> None:
    text = LISTING_3.replace("a dyknow:UAV", "a d:UAV")
    query = parse_query(f"PREFIX d: <{DYKNOW}>\n{text}")
    assert constructed(body_sparql(query)) == {("uav1", "110")}


def test_a_prefix_declared_anew_wins() -> None:
    text = LISTING_3.replace(DYKNOW + ">\n", "http://example.org/>\n", 1)
    query = parse_query(text)
    bound = bind(query, {Variable("uav"): dyknow("uav1")})
    assert "<http://www.ida.liu.se/dyknow/uav1>" in format_query(bound)
    assert "http://example.org/" in repr(body_tree(query))


def test_a_parsed_text_is_remembered() -> None:
    assert parse_query(LISTING_3) is parse_query(LISTING_3)


def test_parsing_in_threads() -> None:
    texts = [LISTING_3.replace("100)}", f"{100 + n})}}") for n in range(16)]
    with ThreadPoolExecutor(8) as pool:
        queries = list(pool.map(parse_query, texts))
    assert [q.source for q in queries] == texts


def test_deep_nesting_is_an_error() -> None:
    for depth in (30, 64, 1000):
        deep = "(" * depth + "?avgSpeed" + ")" * depth
        try:
            parse_query(LISTING_3.replace("(?avgSpeed > 100)", f"({deep} > 100)"))
        except LanguageError as error:
            assert "deep" in str(error)  # noqa: PT017 - either outcome is right, no other is


def test_bind_refuses_what_it_cannot_bind() -> None:
    query = parse_template(LISTING_4).query
    with pytest.raises(ValueError, match="does not use"):
        bind(query, {Variable("nobody"): integer(1)})
    with pytest.raises(ValueError, match="blank node"):
        bind(query, {Variable("o"): BlankNode("x")})


def test_with_streams_needs_a_window() -> None:
    query = with_streams(parse_query(LISTING_3), ["http://example.org/x", "y"])
    assert [c.iri for c in query.streams] == ["http://example.org/x", DYKNOW + "y.trdf"]
    assert parse_query(format_query(query)).streams[1].window == TimeWindow(5 * SECOND, SECOND)


@pytest.mark.parametrize(
    ("text", "term"),
    [
        ("?o", Variable("o")),
        ("$o", Variable("o")),
        ("dyknow:UAV", dyknow("UAV")),
        ("<http://example.org/x>", NamedNode("http://example.org/x")),
        ("100", integer(100)),
        ("-7", integer(-7)),
        ("1.50", Literal("1.50", datatype=NamedNode(XSD + "decimal"))),
        ("1.5e3", Literal("1.5e3", datatype=NamedNode(XSD + "double"))),
        ("true", Literal(True)),
        ('"x"@en', Literal("x", language="en")),
        ("'a\\n\\u0041'", Literal("a\nA")),
        ('"""a "b" c"""', Literal('a "b" c')),
        ('"100"^^xsd:integer', integer(100)),
        ('""', Literal("")),
    ],
)
def test_arguments(text: str, term: object) -> None:
    assert parse_argument(text) == term


@pytest.mark.parametrize(
    "text", ["", "UAV", "a b", '"x', "ex:a", "<x>", "1 2", '"\\q"', "(1)", "_:a"]
)
def test_no_arguments(text: str) -> None:
    with pytest.raises(LanguageError):
        parse_argument(text)


def test_a_template_is_no_query_and_the_other_way_round() -> None:
    with pytest.raises(LanguageError, match="registers a template"):
        parse_query(LISTING_4)
    with pytest.raises(LanguageError, match="not a template"):
        parse_template(LISTING_3)
