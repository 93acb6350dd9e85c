"""Clauses of query texts: windows, dialects, streams by name, accessors of time (SPEC §5).

What is printed and what is refused, with its place, are golden cases (tests/cases/csparql); laws
are in tests/laws/languages/test_query_texts.py.
"""

import pytest
from pyoxigraph import NamedNode, Variable
from shared_data import DATA

from dyknow.languages.csparql import (
    TIMESTAMP,
    VALID_TIME,
    CountWindow,
    Dialect,
    Form,
    LandmarkWindow,
    StreamOperator,
    TimeWindow,
    Window,
    bind,
    body_sparql,
    format_query,
    group_keys,
    parse_query,
    parse_template,
    printer,
    with_streams,
)
from dyknow.languages.csparql.limits import LIMITS
from dyknow.languages.csparql.printer import MOST_READ, compact
from dyknow.languages.errors import LanguageError
from dyknow.sparql import parse_sparql
from dyknow.sparql.ast import FunctionCall, walk

MS = 1_000_000
SECOND = 1000 * MS
DAY = 86_400 * SECOND
EX = "http://example.org/"
CITYBENCH = DATA / "citybench" / "queries"

RSP_QL = """PREFIX : <http://example.org/>
REGISTER ISTREAM :out COMPUTE EVERY PT2S AS
SELECT ?o (AVG(?v) AS ?avg)
FROM :people
FROM NAMED :map
FROM NAMED WINDOW :long ON :s [RANGE PT1M STEP PT5S]
FROM NAMED WINDOW :short ON STREAM :s [ELEMENTS 10 STEP 2]
WHERE { WINDOW :long { ?o :speed ?v } WINDOW ?w { ?o :seen true } GRAPH ?g { ?o :in ?place } }
GROUP BY ?o
"""


def one_window(window: str, every: str = "") -> Window:
    text = f"REGISTER QUERY q {every} AS SELECT ?o FROM STREAM <http://e/s> {window} {{ ?o ?p ?v }}"
    (clause,) = parse_query(text).streams
    return clause.window


@pytest.mark.parametrize(
    ("text", "window"),
    [
        ("[RANGE 5s STEP 1s]", TimeWindow(5 * SECOND, SECOND)),
        ("[range 3000ms step 1s]", TimeWindow(3 * SECOND, SECOND)),
        ("[RANGE 5 s SLIDE 1 MS]", TimeWindow(5 * SECOND, MS)),
        ("[RANGE 1d TUMBLING]", TimeWindow(DAY, DAY)),
        ("[RANGE PT5S STEP PT0.5S]", TimeWindow(5 * SECOND, SECOND // 2)),
        ("[RANGE P1DT2H STEP pt1m]", TimeWindow(DAY + 7200 * SECOND, 60 * SECOND)),
        ('[RANGE "PT5S"^^xsd:duration STEP 1ns]', TimeWindow(5 * SECOND, 1)),
        ("[RANGE PT5S]", TimeWindow(5 * SECOND, 7 * SECOND)),
        ("[TRIPLES 10]", CountWindow(10, 1)),
        ("[TRIPLES 10 STEP 20]", CountWindow(10, 20)),
        ("[ELEMENTS 10 TUMBLING]", CountWindow(10, 10)),
        ("[TRIPLES 2147483647 SLIDE 1]", CountWindow(2**31 - 1, 1)),
        ("[LANDMARK STEP 1s]", LandmarkWindow(None, SECOND)),
        ("[LANDMARK]", LandmarkWindow(None, 7 * SECOND)),
        ('[LANDMARK "1970-01-01T00:00:01Z"^^xsd:dateTime]', LandmarkWindow(SECOND, 7 * SECOND)),
        ("[LANDMARK '1970-01-01T01:00:00+01:00'^^xsd:dateTime STEP 1s]", LandmarkWindow(0, SECOND)),
    ],
)
def test_windows(text: str, window: Window) -> None:
    assert one_window(text, "EVERY 7s") == window


def test_the_papers_windows_of_templates_may_be_of_any_kind() -> None:
    text = "REGISTER TEMPLATE dyknow:E(?o) AS SELECT ?o WHERE { ?o dyknow:speed ?v } WINDOW "
    assert parse_template(text + "[TRIPLES 3 STEP 2]").query.window == CountWindow(3, 2)
    assert parse_template(text + "[LANDMARK STEP 1s]").query.window == LandmarkWindow(None, SECOND)


def test_rsp_ql() -> None:
    query = parse_query(RSP_QL)
    assert query.dialect is Dialect.RSP_QL
    assert query.operator is StreamOperator.ISTREAM
    assert query.name == EX + "out"
    assert query.produces_stream
    assert query.every == 2 * SECOND
    assert query.static == (EX + "people",)
    assert query.static_named == (EX + "map",)
    assert [(c.iri, c.name) for c in query.streams] == [
        (EX + "s", EX + "long"),
        (EX + "s", EX + "short"),
    ]
    assert [c.window for c in query.streams] == [
        TimeWindow(60 * SECOND, 5 * SECOND),
        CountWindow(10, 2),
    ]
    assert query.window_variables == {"w"}
    assert group_keys(query) == ()
    # A named window is a named graph to SPARQL.
    assert body_sparql(query).count("GRAPH") == 3
    span = query.streams[0].span
    assert RSP_QL[span.start : span.end] == "FROM NAMED WINDOW :long ON :s [RANGE PT1M STEP PT5S]"


@pytest.mark.parametrize(
    ("head", "dialect", "operator", "produces"),
    [
        ("SELECT ?o", Dialect.C_SPARQL, StreamOperator.RSTREAM, False),
        ("SELECT ISTREAM ?o", Dialect.C_SPARQL, StreamOperator.ISTREAM, False),
        ("REGISTER QUERY q AS SELECT DISTINCT DSTREAM ?o", "C-SPARQL", "DSTREAM", False),
        ("REGISTER STREAM q AS CONSTRUCT ISTREAM { ?o a ?o }", "C-SPARQL", "ISTREAM", True),
        ("REGISTER RSTREAM q AS SELECT ?o", "RSP-QL", "RSTREAM", True),
        ("REGISTER dstream q AS SELECT DStream ?o", "RSP-QL", "DSTREAM", True),
    ],
)
def test_dialect_and_operator(head: str, dialect: str, operator: str, produces: bool) -> None:
    query = parse_query(f"{head} FROM STREAM <http://e/s> [RANGE 5s STEP 1s] {{ ?o ?p ?v }}")
    assert (query.dialect, query.operator, query.produces_stream) == (dialect, operator, produces)
    again = parse_query(format_query(query))
    assert (again.dialect, again.operator, again.produces_stream) == (dialect, operator, produces)


@pytest.mark.parametrize(
    "clause", ["FROM NAMED WINDOW <http://e/w> ON <http://e/s>", "FROM WINDOW ON <http://e/s>"]
)
def test_a_window_clause_makes_rsp_ql(clause: str) -> None:
    query = parse_query(f"ASK {clause} [RANGE PT5S STEP PT1S] {{ ?o ?p ?v }}")
    assert query.dialect is Dialect.RSP_QL
    assert query.form is Form.ASK
    assert query.name == ""


def test_windows_of_the_default_graph_have_no_name() -> None:
    query = parse_query(
        "ASK FROM WINDOW <http://e/w> ON <http://e/s> [RANGE 5s STEP 1s] "
        "FROM WINDOW <http://e/v> ON <http://e/s> [TRIPLES 3] { ?o ?p ?v }"
    )
    assert [c.name for c in query.streams] == [None, None]


def test_the_streams_of_named_windows_are_not_replaced() -> None:
    with pytest.raises(ValueError, match=r"names the window <http://example\.org/long>"):
        with_streams(parse_query(RSP_QL), ["s1"])
    default = parse_query("ASK FROM WINDOW ON <http://e/s> [TRIPLES 3] { ?o ?p ?v }")
    (clause,) = with_streams(default, ["http://e/t"]).streams
    assert (clause.iri, clause.window) == ("http://e/t", CountWindow(3, 1))


def test_a_bound_window_variable_stays_one() -> None:
    query = bind(parse_query(RSP_QL), {Variable("w"): NamedNode(EX + "short")})
    printed = format_query(query)
    assert "VALUES (?w) { (:short) }" in printed
    assert parse_query(printed).window_variables == {"w"}


def test_relative_names_are_plain_unless_there_is_a_base() -> None:
    text = "REGISTER RSTREAM <out> AS ASK FROM WINDOW ON <http://e/s> [TRIPLES 3] { ?o ?p ?v }"
    assert parse_query(text).name == "out"
    assert parse_query(f"BASE <http://e/> {text}").name == "http://e/out"
    with pytest.raises(LanguageError, match="is not an IRI"):
        parse_query(text.replace("<out>", "<out/put>"))


def test_the_accessors_are_named_by_their_iris() -> None:
    text = f"""SELECT (<{TIMESTAMP}>(?o) AS ?t) (dyknow-o:validTime(?o, ?p, 5) AS ?u)
    FROM STREAM <http://e/s> [RANGE 5s STEP 1s] {{ ?o ?p ?v }}"""
    assert TIMESTAMP in body_sparql(parse_query(text))
    assert VALID_TIME == "http://www.dyknow.eu/ontology#validTime"
    calls = [one for one in walk(parse_query(text).body) if isinstance(one, FunctionCall)]
    assert [call.iri.value for call in calls] == [TIMESTAMP, VALID_TIME]


@pytest.mark.parametrize(
    ("text", "called"),
    [
        ("SELECT (:f(?x) AS ?y) { ?x :p (1) FILTER :g(?x) }", [":f", ":g"]),
        ("ASK { ?x :p (:q (1)) ; :r (2) , [ :s (3) ] }", []),
        ("ASK { ?x (:p|^:q)/:r (1) }", []),
        ("ASK { BIND(:f(:g(?x) + 1) AS ?y) VALUES (?a) { (:h) } }", [":f", ":g"]),
        ("ASK { FILTER EXISTS { ?x :p (1) FILTER(!:f(?x)) } }", [":f"]),
        ("ASK { FILTER regex(:f(?x), 'a') FILTER NOT EXISTS { ?x :p (1) } }", [":f"]),
        ("ASK { { SELECT (:f(?x) AS ?y) { ?x :p (1) } GROUP BY ?x HAVING :g(?x) } }", [":f", ":g"]),
        ("SELECT ?x { ?x :p (1) } GROUP BY ?x HAVING(:f(?x)) ORDER BY ?x :g(?x)", [":f", ":g"]),
    ],
)
def test_a_predicate_before_a_collection_is_no_call(text: str, called: list[str]) -> None:
    query = parse_sparql(text, {"": EX})
    calls = [one for one in walk(query) if isinstance(one, FunctionCall)]
    assert sorted(f":{call.iri.value.removeprefix(EX)}" for call in calls) == called


@pytest.mark.parametrize(
    "cast", ["boolean", "dateTime", "decimal", "double", "float", "integer", "string", "duration"]
)
def test_casts_are_known(cast: str) -> None:
    parse_query(f"ASK FROM STREAM <http://e/s> [TRIPLES 1] {{ ?o ?p ?v FILTER(xsd:{cast}(?v)) }}")


@pytest.mark.skipif(not CITYBENCH.exists(), reason="CityBench in shared/data is not here")
def test_citybench() -> None:
    """Each query as it is in the benchmark."""
    texts = [path.read_text(encoding="utf-8") for path in sorted(CITYBENCH.glob("Q*.txt"))]
    assert len(texts) == 6
    for text in texts:
        query = parse_query(text)
        assert query.name == ""
        assert query.dialect is Dialect.C_SPARQL
        assert {clause.window for clause in query.streams} == {TimeWindow(3 * SECOND, SECOND)}
        assert query.static
        printed = format_query(query)
        assert "REGISTER" not in printed
        assert format_query(parse_query(printed)) == printed


def condition(text: str) -> str:
    window = "[RANGE 5s STEP 1s]"
    return (
        f"REGISTER QUERY q AS SELECT ?o FROM STREAM <http://e/s> {window}\n"
        f"WHERE {{ ?o <http://e/p> ?v . FILTER({text}) }}"
    )


@pytest.mark.parametrize(
    "text",
    [
        "?v > 1{}",
        "?v > 1 + (2 * (3 - 4 {}))",
        "(1 {}) / ?v + 2 - 3 > ?v",
        "COALESCE(1 + 2, 3 {}) > 1 + 1",
        "EXISTS {{ ?o ?p ?w FILTER(?w > 1 {}) }}",
    ],
)
def test_operators_in_each_other_are_bounded(text: str) -> None:
    own = {"(2 * (": 3, "(1 {}) /": 3}
    others = next((count for part, count in own.items() if part in text), 0)
    parse_query(condition(text.format("+ 1" * (LIMITS.operators - others))))
    with pytest.raises(LanguageError, match="more than 128 operators") as caught:
        parse_query(condition(text.format("+ 1" * (LIMITS.operators - others + 1))))
    assert (caught.value.line, caught.value.column > 300) == (2, True)


def test_many_signs_that_are_not_in_each_other() -> None:
    parse_query(condition(f"?v IN ({', '.join(['-1'] * 500)})"))
    parse_query(condition(" || ".join(["?v = -1"] * 100)))
    values = condition("true").replace("FILTER(true)", f"VALUES ?v {{ {'-1 ' * 500} }}")
    parse_query(values)


@pytest.mark.parametrize(
    ("part", "costs"),
    [("FILTER(?v > 1)", 1), ("FILTER EXISTS {}", 2), ("OPTIONAL {}", 1), ("VALUES ?w { 1 }", 2)],
)
def test_parts_of_patterns_are_bounded(part: str, costs: int) -> None:
    before = 2  # the group of WHERE and the FILTER that is there
    most = (LIMITS.parts - before) // costs
    parse_query(condition("true").replace("}", " ".join(["", *[part] * most, "}"])))
    with pytest.raises(LanguageError, match="more than 160 groups"):
        parse_query(condition("true").replace("}", " ".join(["", *[part] * (most + 1), "}"])))


def test_a_long_blank_is_looked_at_once() -> None:
    """Looked at anew from each of its characters, this would take hours."""
    assert compact(f"SELECT{' ' * 2_000_000}?a\n{' ' * 2_000_000}\n {{}}").split() == [
        "SELECT",
        "?a",
        "{}",
    ]


def test_a_long_text_is_not_read_again_to_be_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """A request is told while others wait."""
    read = []
    monkeypatch.setattr(printer, "_is_query", lambda *given: not read.append(given))
    term = NamedNode("http://www.ida.liu.se/dyknow/uav1")
    for conditions in (2, MOST_READ):
        where = " || ".join(f"?v = {number}" for number in range(conditions))
        text = (
            "REGISTER QUERY q AS SELECT ?v FROM STREAM <urn:s> [RANGE 1s STEP 1s] "
            f"WHERE {{ ?o <urn:p> ?v FILTER ({where}) }}"
        )
        told = format_query(bind(parse_query(text), {Variable("o"): term}))
        assert ("VALUES" in told) == (conditions > 2)
    assert len(read) == 1
