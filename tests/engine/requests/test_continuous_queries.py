"""Continuous queries without a template: registered, read by others, shared, kept ([Events14 §III],
SPEC §5)."""

import gc
from dataclasses import replace

import pytest
from feeding import feed, samples
from pyoxigraph import Literal, NamedNode

from dyknow.continuous.algebra.options import Options
from dyknow.converters.wire import Incoming
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import (
    AlreadyExists,
    BadArguments,
    Conflict,
    NoPlan,
    NoResult,
    NotAnnotated,
    Refused,
    UnknownQuery,
    UnknownStream,
)
from dyknow.engine.model.stream_statistics import rate_of
from dyknow.engine.model.views import Since, StreamDeclaration
from dyknow.engine.planning.registrations import Submission
from dyknow.languages.csparql import parse_query
from dyknow.languages.csparql.ast import CountWindow, Dialect, StreamOperator
from dyknow.languages.errors import LanguageError
from dyknow.streams.sample import Field, FieldType, batch_from_rows
from dyknow.streams.time import SECOND

DYKNOW = "http://www.ida.liu.se/dyknow/"
RDF = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
S5 = f"<{DYKNOW}s5.trdf>"
SSL = "stream s5 contains speed(UAV) = spd [km.h-1], altitude(UAV) = alt [ft] for every UAV = id"
WINDOW = "[RANGE 5s STEP 1s]"
FAST = f"""REGISTER STREAM fast COMPUTE EVERY 1s AS
CONSTRUCT {{ ?o dyknow:speed ?mean }}
FROM STREAM {S5} {WINDOW}
WHERE {{ ?o a dyknow:UAV . ?o dyknow:speed ?v . }}
AGGREGATE {{(?mean, AVG, {{?v}}) FILTER (?mean > 100)}}"""
SELECT = f"""REGISTER QUERY means AS
SELECT ?o (AVG(?v) AS ?mean) (COUNT(?v) AS ?n) FROM STREAM {S5} {WINDOW}
WHERE {{ ?o dyknow:speed ?v }} GROUP BY ?o"""
ROWS = [
    (second, {"id": name, "spd": spd, "alt": 1000.0})
    for second in range(1, 11)
    for name, spd in ((f"uav{second % 2 + 1}", 50.0 + 100 * (second % 2)),)
]


@pytest.fixture
def flying(engine):
    engine.annotate(SSL)
    return engine


def play(engine, rows=ROWS):
    feed(engine, "s5", rows)
    engine.end("s5")


def rows_of(result):
    return sorted(
        ({name: term.value for name, term in row.items()} for row in result.solutions.rows()),
        key=lambda row: row["o"],
    )


# -- results ---------------------------------------------------------------------------------


def test_a_registered_stream_is_a_stream_of_its_name(flying):
    view = flying.queries.register(FAST)
    assert (view.name, view.stream, view.kind, view.form) == ("fast", "fast", "STREAM", "CONSTRUCT")
    assert (view.semantics, view.bounds, view.origin, view.report) == ("bag", "(]", 0, "non-empty")
    assert view.plan.streams == ("s5",)
    assert [field.name for field in view.fields] == ["id", "speed"]
    play(flying)
    found = samples(flying, "fast")
    assert found
    assert {values["id"] for _, values in found} == {"uav2"}
    assert {values["speed"] for _, values in found} == {150.0}
    assert flying.queries.view("fast").state == "ended"


def test_a_table_has_a_column_a_variable(flying):
    flying.queries.register(SELECT)
    play(flying)
    assert samples(flying, "means")[:3] == [
        (1.0, {"o": "uav2", "mean": 150.0, "n": 1}),
        (2.0, {"o": "uav1", "mean": 50.0, "n": 1}),
        (2.0, {"o": "uav2", "mean": 150.0, "n": 1}),
    ]
    (last,) = flying.queries.latest("means").solutions.rows()
    assert last["o"] == NamedNode(DYKNOW + "uav1")


COMPUTED = [
    ("MAX(?v) - MIN(?v)", FieldType.FLOAT, 0.0),
    ("COUNT(?v) + 1", FieldType.INTEGER, 2),
    ("COUNT(?v) / 4", FieldType.FLOAT, 0.25),
    ("ROUND(AVG(?v))", FieldType.FLOAT, 150.0),
    ("-MAX(?v)", FieldType.FLOAT, -150.0),
    ("MAX(?v) > 100", FieldType.BOOLEAN, True),
    ("IF(MAX(?v) > 100, 1, 2.5)", FieldType.FLOAT, 1.0),
    ("IF(MAX(?v) > 100, 1, 2)", FieldType.INTEGER, 1),
    ("IF(MAX(?v) > 100, 1, 'slow')", FieldType.STRING, "1"),
    ("STRLEN(STR(COUNT(?v)))", FieldType.INTEGER, 1),
    ("xsd:integer(MAX(?v))", FieldType.INTEGER, 150),
    ("STR(MAX(?v))", FieldType.STRING, "150"),
    ("1 / 0", FieldType.FLOAT, None),
    ("SUM(IF(?v > 100, 1, 0))", FieldType.INTEGER, 1),
    ("MAX(?v * 2)", FieldType.FLOAT, 300.0),
    ("GROUP_CONCAT(STR(?v))", FieldType.STRING, "150"),
]


@pytest.mark.parametrize(("expression", "type", "value"), COMPUTED)
def test_what_is_computed_of_aggregates_is_of_its_datatype(flying, expression, type, value):
    view = flying.queries.register(
        f"REGISTER QUERY computed AS SELECT ?o ({expression} AS ?x) FROM STREAM {S5} "
        "[RANGE 1s STEP 1s] WHERE { ?o dyknow:speed ?v } GROUP BY ?o"
    )
    assert {field.name: field.type for field in view.fields}["x"] is type
    play(flying)
    assert samples(flying, "computed")[0][1].get("x") == value


def test_what_bind_computes_is_of_its_datatype(flying):
    view = flying.queries.register(
        f"REGISTER QUERY computed AS SELECT ?sum ?either FROM STREAM {S5} [RANGE 1s STEP 1s] "
        "WHERE { ?o dyknow:speed ?v ; dyknow:altitude ?h BIND(?v + ?h AS ?sum) "
        "{ BIND(1 AS ?either) } UNION { BIND('text' AS ?either) } }"
    )
    types = {field.name: field.type for field in view.fields}
    assert types == {"sum": FieldType.FLOAT, "either": FieldType.STRING}
    play(flying)
    assert [values for _, values in samples(flying, "computed")[:2]] == [
        {"sum": 1150.0, "either": "1"},
        {"sum": 1150.0, "either": "text"},
    ]


T1 = 1_000_000_000
TIMED = "?o dyknow:speed ?z"
TIMES = [
    ("(f:timestamp(?z) AS ?x)", TIMED, T1),
    ("(f:timestamp(?z) + 1 AS ?x)", TIMED, T1 + 1),
    ("(dyknow-o:validTime(?z) AS ?x)", TIMED, T1),
    ("(f:timestamp(?o, dyknow:speed, ?z) AS ?x)", TIMED, T1),
    ("?x", f"{TIMED} BIND(dyknow-o:validTime(?o, dyknow:speed, ?z) AS ?x)", T1),
    ("(MIN(?t) AS ?x)", f"{TIMED} BIND(f:timestamp(?z) AS ?t)", T1),
    ("(MIN(f:timestamp(?z)) AS ?x)", TIMED, T1),
    ("(MAX(?t) - MIN(?t) AS ?x)", f"{TIMED} BIND(f:timestamp(?z) AS ?t)", 0),
]


@pytest.mark.parametrize(("head", "where", "value"), TIMES)
def test_times_of_triples_are_integers(flying, head, where, value):
    view = flying.queries.register(
        f"REGISTER QUERY times AS SELECT {head} FROM STREAM {S5} [RANGE 1s STEP 1s] "
        f"WHERE {{ {where} }}"
    )
    assert view.fields == (Field("x", FieldType.INTEGER),)
    play(flying)
    assert samples(flying, "times")[0][1] == {"x": value}


UNIONS = [
    ("?x", "?o dyknow:speed ?v VALUES ?x { 1 2 }", FieldType.INTEGER, 1),
    ("?x", "?o dyknow:speed ?v VALUES ?x { 1 2.5 UNDEF }", FieldType.FLOAT, None),
    ("?x", "?o dyknow:speed ?v VALUES ?x { 1 'one' }", FieldType.STRING, "1"),
    ("(?n + ?k AS ?x)", "?o dyknow:level ?n VALUES ?k { 1 2 }", FieldType.INTEGER, 8),
    ("(?n + 1 AS ?x)", "?o dyknow:small ?n", FieldType.INTEGER, 8),
    ("?x", "?o dyknow:small ?x", FieldType.INTEGER, 7),
    ("?x", "{ ?o dyknow:speed ?x } UNION { ?o dyknow:altitude ?x }", FieldType.FLOAT, 150.0),
    ("?x", "{ ?o dyknow:level ?x } UNION { ?o dyknow:altitude ?x }", FieldType.FLOAT, 7.0),
    ("?x", "{ ?o dyknow:level ?x } UNION { ?o dyknow:small ?x }", FieldType.INTEGER, 7),
    ("?x", "?o dyknow:level|dyknow:altitude ?x", FieldType.FLOAT, 7.0),
    (
        "(MAX(?y) AS ?x)",
        "{ ?o dyknow:level ?y } UNION { ?o dyknow:altitude ?y }",
        FieldType.FLOAT,
        1000.0,
    ),
    (
        "(MAX(?y) AS ?x)",
        "{ ?o dyknow:level ?y } UNION { ?o dyknow:speed ?v BIND(?v / 4 AS ?y) }",
        FieldType.FLOAT,
        37.5,
    ),
    ("?x", "{ ?o dyknow:level ?x } UNION { ?o dyknow:call ?x }", FieldType.STRING, "7"),
    ("?x", "{ ?o dyknow:level ?x } UNION { ?o dyknow:unknown ?x }", FieldType.STRING, "7"),
]
RANGES = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix d: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> . @prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
d:level a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:integer .
d:small a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:int .
d:call a :UnaryFeature, owl:DatatypeProperty ; rdfs:range xsd:string ."""


@pytest.mark.parametrize(("head", "where", "type", "value"), UNIONS)
def test_numbers_of_several_kinds_are_of_the_wider(engine, head, where, type, value):
    engine.ontology.load(RANGES, name="ranges")
    engine.annotate(
        "stream s5 contains speed(UAV) = spd, altitude(UAV) = alt, level(UAV) = l, small(UAV) = l, "
        "call(UAV) = c for every UAV = id"
    )
    view = engine.queries.register(
        f"REGISTER QUERY q AS SELECT {head} FROM STREAM {S5} [RANGE 1s STEP 1s] WHERE {{ {where} }}"
    )
    assert view.fields == (Field("x", type),)
    row = {"id": "uav1", "spd": 150.0, "alt": 1000.0, "l": 7, "c": "AFR12"}
    play(engine, [(1, row), (2, row)])
    assert samples(engine, "q")[0][1].get("x") == value


def test_a_constructed_feature_fits_all_of_its_objects(flying):
    view = flying.queries.register(
        "REGISTER STREAM both AS PREFIX x: <http://x.example/> "
        "CONSTRUCT { ?o x:n 1 . ?p x:n ?half } "
        f"FROM STREAM {S5} [RANGE 1s STEP 1s] "
        "WHERE { ?o dyknow:speed ?v BIND(dyknow:other AS ?p) BIND(?v / 4 AS ?half) }"
    )
    assert view.fields == (Field("id", FieldType.STRING), Field("n", FieldType.FLOAT))
    play(flying)
    assert [values for _, values in samples(flying, "both")[:2]] == [
        {"id": "other", "n": 37.5},
        {"id": "uav2", "n": 1.0},
    ]


def test_a_constructed_number_without_a_range_is_a_number(flying):
    view = flying.queries.register(
        f"REGISTER STREAM spread AS PREFIX x: <http://x.example/> CONSTRUCT {{ ?o x:spread ?x }} "
        f"FROM STREAM {S5} [RANGE 1s STEP 1s] "
        "WHERE { { SELECT ?o (MAX(?v) - MIN(?v) AS ?x) WHERE { ?o dyknow:speed ?v } GROUP BY ?o } }"
    )
    assert {field.name: field.type for field in view.fields}["spread"] is FieldType.FLOAT
    play(flying)
    assert samples(flying, "spread")[0][1] == {"id": "uav2", "spread": 0.0}


SUMS = f"""AS SELECT ?o (SUM(?n) AS ?sum) FROM STREAM {S5} [RANGE 1s STEP 1s]
WHERE {{ ?o dyknow:level ?n FILTER (?o = %s) }} GROUP BY ?o"""


def test_a_value_that_its_field_cannot_hold_is_lost_alone(engine):
    engine.ontology.load(RANGES, name="ranges")
    engine.annotate("stream s5 contains level(UAV) = l for every UAV = id")
    engine.queries.register(f"REGISTER QUERY sums {SUMS % '?o'}")
    # Two of one form, which share a unit.
    for name in ("uav1", "uav2"):
        engine.queries.register(f"REGISTER QUERY {name} {SUMS % f'dyknow:{name}'}")
    large = [(t, {"id": "uav1", "l": 2**62}) for t in (0.5, 0.6, 0.7)]
    play(engine, [*large, (0.8, {"id": "uav2", "l": 1}), (1.5, {"id": "uav1", "l": 5})])
    lost = {"o": "uav1", "sum": None}
    assert samples(engine, "sums") == [
        (1.0, lost),
        (1.0, {"o": "uav2", "sum": 1}),
        (2.0, {"o": "uav1", "sum": 5}),
    ]
    assert samples(engine, "uav1") == [(1.0, lost), (2.0, {"o": "uav1", "sum": 5})]
    for name in ("sums", "uav1"):
        view = engine.queries.view(name)
        assert (view.state, view.failure, view.errors) == ("ended", None, 1)
        assert view.last_error == (
            "the window that ends 1970-01-01T00:00:01Z has no value in field 'sum': "
            '"13835058055282163712"^^<http://www.w3.org/2001/XMLSchema#integer> is no integer value'
        )
    other = engine.queries.view("uav2")
    assert (other.errors, other.last_error) == (0, None)


def test_ask_is_a_boolean(flying):
    flying.queries.register(
        f"REGISTER QUERY any AS ASK FROM STREAM {S5} [RANGE 1s STEP 1s] "
        "WHERE { ?o dyknow:speed ?v FILTER (?v > 100) }"
    )
    play(flying)
    assert [values["answer"] for _, values in samples(flying, "any")] == [True, False] * 5
    assert flying.queries.latest("any").answer is False


def test_windows_are_kept_as_the_query_gave_them(flying):
    flying.queries.register(SELECT)
    with pytest.raises(NoResult, match="it waits for s5"):
        flying.queries.latest("means")
    assert flying.queries.results("means") == []
    play(flying)
    ends = [window.end // SECOND for window in flying.queries.results("means")]
    assert ends == list(range(1, 15))
    assert [w.end for w in flying.queries.results("means", limit=2)] == [13 * SECOND, 14 * SECOND]
    found = flying.queries.results("means", 3 * SECOND, 5 * SECOND)
    assert [w.end // SECOND for w in found] == [3, 4, 5]
    found = flying.queries.results("means", start=3 * SECOND, limit=1)
    assert rows_of(found[0]) == [
        {"o": DYKNOW + "uav1", "mean": "50", "n": "1"},
        {"o": DYKNOW + "uav2", "mean": "150", "n": "2"},
    ]
    assert flying.queries.view("means").last_window == 14 * SECOND


def test_construct_of_several_predicates_is_one_sample_a_subject(flying):
    flying.queries.register(
        f"""REGISTER STREAM both AS
        CONSTRUCT {{ ?o dyknow:speed ?v ; dyknow:altitude ?a ; a dyknow:Fast ; dyknow:twin ?o }}
        FROM STREAM {S5} [RANGE 1s STEP 1s]
        WHERE {{ ?o dyknow:speed ?v ; dyknow:altitude ?a }}"""
    )
    play(flying, ROWS[:1])
    assert samples(flying, "both") == [
        (1.0, {"id": "uav2", "speed": 150.0, "altitude": 1000.0, "type": "Fast", "twin": "uav2"})
    ]
    (text,) = flying.rdf_of("both", flying.generator("both").stream.all())
    assert (
        f"<{DYKNOW}uav2> <http://www.w3.org/1999/02/22-rdf-syntax-ns#type> <{DYKNOW}Fast>" in text
    )
    assert f"<{DYKNOW}uav2> <{DYKNOW}twin> <{DYKNOW}uav2>" in text
    assert f'<{DYKNOW}uav2> <{DYKNOW}speed> "150"' in text


def test_order_by_is_kept(flying):
    flying.queries.register(
        f"REGISTER QUERY down AS SELECT ?o ?v FROM STREAM {S5} [RANGE 2s STEP 2s] "
        "WHERE { ?o dyknow:speed ?v } ORDER BY DESC(?v)"
    )
    play(flying, ROWS[:2])
    assert [values["v"] for _, values in samples(flying, "down")] == [150.0, 50.0]


@pytest.mark.parametrize(
    ("head", "hint"),
    [
        ("DESCRIBE ?o", "write CONSTRUCT"),
        ("CONSTRUCT { ?o ?p ?v }", "write the features"),
        ("SELECT ?valid", "(?valid AS ?validTime)"),
        ("CONSTRUCT { ?o dyknow:speed 'fast' }", "another predicate"),
        ("CONSTRUCT { ?o dyknow:speed ?o }", "another predicate"),
        ("CONSTRUCT { }", "write the features"),
        ("CONSTRUCT", "write the features"),
        (f"SELECT ?o ({'?v AS ?' + 'x' * 201})", "shorten it"),
    ],
)
def test_heads_without_known_fields_are_refused_with_what_to_write(flying, head, hint):
    text = f"REGISTER QUERY q AS {head} FROM STREAM {S5} {WINDOW} WHERE {{ ?o ?p ?v, ?valid }}"
    with pytest.raises(LanguageError) as refused:
        flying.queries.register(text)
    assert hint in refused.value.hint
    assert refused.value.column == 21
    assert flying.queries.views() == ()


@pytest.mark.parametrize(
    ("other", "types"),
    [("?o a ?v", FieldType.STRING), ("?v a dyknow:UAV", FieldType.STRING)],
)
def test_a_column_of_numbers_and_names_is_text(flying, other, types):
    view = flying.queries.register(
        f"REGISTER QUERY q AS SELECT ?v FROM STREAM {S5} {WINDOW} "
        f"WHERE {{ {{ ?o dyknow:speed ?v }} UNION {{ {other} }} }}"
    )
    assert view.fields == (Field("v", types),)
    play(flying)
    assert flying.queries.view("q").state == "ended"


# -- streams ---------------------------------------------------------------------------------


def test_a_query_reads_the_stream_of_another(flying):
    flying.queries.register(FAST)
    flying.queries.register(
        f"""REGISTER QUERY alarms AS SELECT (COUNT(DISTINCT ?o) AS ?n)
        FROM STREAM <{DYKNOW}fast.trdf> [RANGE 1s STEP 1s]
        WHERE {{ ?o a dyknow:UAV . ?o dyknow:speed ?v }}"""
    )
    play(flying)
    assert {values["n"] for _, values in samples(flying, "alarms")} == {1}
    with pytest.raises(Conflict, match="read by query alarms"):
        flying.queries.remove("fast")
    flying.queries.remove("alarms")
    flying.queries.remove("fast")
    assert {view.name for view in flying.streams()} == {"s5", "status"}


def test_constructed_speeds_are_no_stream_of_speed_for_matching(flying, high_speed):
    flying.queries.register(FAST)
    found = flying.match("speed", sort="UAV")
    assert found.plan.streams == ("s5",)


def test_all_that_a_stream_says_is_in_the_window(flying):
    flying.queries.register(
        f"""REGISTER QUERY wide AS SELECT (COUNT(?v) AS ?n) FROM STREAM {S5} [RANGE 2s STEP 1s]
        WHERE {{ dyknow:uav2 ?p ?v FILTER isLiteral(?v) }}"""
    )
    play(flying, ROWS[:1])
    assert [values["n"] for _, values in samples(flying, "wide")] == [2, 2]


def test_streams_are_found_from_features(flying):
    view = flying.queries.register(
        "REGISTER QUERY climbs AS SELECT ?o ?a WHERE { ?o a dyknow:UAV ; dyknow:altitude ?a } "
        "WINDOW [RANGE 1s STEP 1s]"
    )
    assert view.plan.streams == ("s5",)
    assert f"FROM STREAM {S5}" in view.plan.query
    play(flying, ROWS[:1])
    assert samples(flying, "climbs") == [(1.0, {"o": "uav2", "a": 1000.0})]


def test_units_are_built_for_what_is_needed_and_go_with_the_query(engine):
    engine.annotate(
        "stream gps contains latitude(UAV) = lat [deg], longitude(UAV) = lon [deg] "
        "for every UAV = id"
    )
    text = "REGISTER STREAM v AS CONSTRUCT {?o dyknow:speed ?s} WHERE {?o dyknow:speed ?s} WINDOW "
    view = engine.queries.register(text + WINDOW)
    assert [unit.transformation for unit in view.plan.units] == ["coordinatesToSpeed", "cSparql"]
    engine.queries.remove("v")
    assert {each.name for each in engine.streams()} == {"gps", "status"}


@pytest.mark.parametrize(
    ("clause", "error", "words"),
    [
        (f"<{DYKNOW}s55.trdf>", UnknownStream, f"did you mean {S5}"),
        ("<http://example.org/elsewhere>", UnknownStream, "GET /streams lists them"),
        (f"<{DYKNOW}plain.trdf>", NotAnnotated, "its fields are x"),
        (f"<{DYKNOW}status.trdf>", NotAnnotated, "POST /annotations"),
    ],
)
def test_streams_that_cannot_be_read(flying, clause, error, words):
    flying.declare(StreamDeclaration("plain", (Field("x", FieldType.FLOAT),)))
    with pytest.raises(error) as refused:
        flying.queries.register(
            f"REGISTER QUERY q AS SELECT ?o FROM STREAM {clause} {WINDOW} WHERE {{ ?o ?p ?v }}"
        )
    assert words in str(refused.value)
    assert not flying._parts.configuration.has("q")


@pytest.mark.parametrize("iri", ["dyknow:s5", "<http://www.dyknow.eu/ontology#s5>", S5])
def test_the_names_of_a_stream(flying, iri):
    view = flying.queries.register(
        f"REGISTER QUERY q AS SELECT ?o FROM STREAM {iri} {WINDOW} WHERE {{ ?o ?p ?v }}"
    )
    assert view.plan.streams == ("s5",)


def test_nothing_gives_the_feature(flying):
    with pytest.raises(NoPlan) as refused:
        flying.queries.register(
            "REGISTER QUERY q AS SELECT ?o WHERE { ?o dyknow:heading ?v } WINDOW " + WINDOW
        )
    assert refused.value.missing
    assert {each.name for each in flying.streams()} == {"s5", "status"}


def test_an_unknown_graph_lists_those_there_are(flying):
    with pytest.raises(NoPlan, match=r"ontology\.rdf"):
        flying.queries.register(FAST.replace("FROM STREAM", "FROM <http://x.org/y>\nFROM STREAM"))


# -- how it runs -----------------------------------------------------------------------------


def test_options_say_how_the_text_is_read(flying):
    twice = [(1 + i / 10, {"id": "uav1", "spd": 60.0, "alt": None}) for i in range(3)]
    text = f"""REGISTER QUERY n AS SELECT (COUNT(?v) AS ?n) FROM STREAM {S5} [RANGE 1s STEP 1s]
    WHERE {{ ?o dyknow:speed ?v }}"""
    view = flying.queries.register(
        text, semantics="set", bounds="[)", origin=SECOND // 2, report="close"
    )
    assert (view.semantics, view.bounds, view.origin) == ("set", "[)", SECOND // 2)
    play(flying, twice)
    assert samples(flying, "n") == [(1.5, {"n": 1})]


def test_windows_with_names_and_graphs_with_names(flying):
    """What RSP-QL says, put together by hand: two windows of one stream, an ontology by its name,
    what is new in the result."""
    text = f"""REGISTER QUERY q AS SELECT ?o ?v ?last
    FROM STREAM {S5} [RANGE 5s STEP 1s] FROM STREAM <{DYKNOW}s6.trdf> [RANGE 5s STEP 1s] WHERE {{
      GRAPH <http://x.org/time> {{ ?o dyknow:speed ?v }}
      GRAPH <http://x.org/count> {{ ?o dyknow:speed ?last }}
      GRAPH <{DYKNOW}ontology.rdf> {{ dyknow:UAV a ?class }} }}"""
    query = parse_query(text)
    time, count = query.streams
    clauses = (
        replace(time, name="http://x.org/time"),
        replace(count, iri=time.iri, name="http://x.org/count", window=CountWindow(2, 1)),
    )
    query = replace(
        query,
        streams=clauses,
        static_named=(DYKNOW + "ontology.rdf",),
        dialect=Dialect.RSP_QL,
        operator=StreamOperator.ISTREAM,
    )
    view = flying.queries.start(query, Submission(text, Options("set"), "fast", Since.NOW))
    assert (view.dialect, view.reads) == ("RSP-QL", ("s5",))
    rows = [(s, {"id": "uav1", "spd": float(s), "alt": None}) for s in (1, 2, 3)]
    play(flying, rows)
    assert flying.queries.view("q").state == "ended"
    found = [(t, row["v"], row["last"]) for t, row in samples(flying, "q")]
    assert found[:6] == [
        (1.0, 1.0, 1.0),
        (2.0, 1.0, 2.0),
        (2.0, 2.0, 1.0),
        (2.0, 2.0, 2.0),
        (3.0, 1.0, 3.0),
        (3.0, 2.0, 3.0),
    ]


def test_a_registration_leaves_the_ontology_as_it_was(flying):
    """Queries that run need not look at it anew."""
    version = flying.ontology.version
    flying.queries.register(FAST)
    flying.queries.remove("fast")
    assert flying.ontology.version == version


def test_the_past_is_answered_when_it_is_asked_for(flying):
    feed(flying, "s5", ROWS)
    flying.queries.register(FAST)
    flying.queries.register(FAST.replace("STREAM fast", "STREAM old"), since=Since.START)
    flying.end("s5")
    assert samples(flying, "fast") == []
    assert samples(flying, "old")


def test_windows_that_end_together_do_not_lose_results(flying):
    """More solutions than there are nanoseconds to the next window."""
    flying.queries.register(
        f"REGISTER QUERY q AS SELECT ?o ?v FROM STREAM {S5} [RANGE 3ns STEP 1ns] "
        "WHERE { ?o dyknow:speed ?v }"
    )
    generator = flying.generator("s5")
    rows = [(t, t, {"id": f"uav{t}", "spd": 1.0, "alt": None}) for t in range(1, 5)]
    batch = batch_from_rows(generator.schema, rows, generator.stream.pools)
    flying.publish("s5", Incoming(batch, False), 0)
    flying.end("s5")
    assert len(samples(flying, "q")) == sum(len(w.solutions) for w in flying.queries.results("q"))


# -- names and sharing -----------------------------------------------------------------------


def test_the_same_text_again_is_shared_and_stops_with_the_last(flying):
    first = flying.queries.register(FAST)
    again = flying.queries.register(f"\n{FAST}\n")
    assert (first.users, again.users) == (1, 2)
    assert len(flying.queries.views()) == 1
    flying.queries.remove("fast")
    assert flying.queries.view("fast").users == 1
    flying.queries.remove("fast")
    with pytest.raises(UnknownQuery):
        flying.queries.remove("fast")
    assert {view.name for view in flying.streams()} == {"s5", "status"}


def test_another_query_of_the_name_is_refused(flying):
    flying.queries.register(FAST)
    with pytest.raises(AlreadyExists, match="another text"):
        flying.queries.register(FAST.replace("100", "120"))
    with pytest.raises(AlreadyExists, match="semantics=bag"):
        flying.queries.register(FAST, semantics="set")
    assert flying.queries.view("fast").users == 1


@pytest.mark.parametrize(
    ("name", "error"),
    [("s5", AlreadyExists), ("status", Refused), ("dyknow_mine", Refused), ("dyknow:a-b", Refused)],
)
def test_names_that_cannot_be_given(flying, name, error):
    with pytest.raises(error):
        flying.queries.register(FAST.replace("STREAM fast", f"STREAM {name}"))


def test_an_iri_is_called_by_its_local_name(flying):
    view = flying.queries.register(FAST.replace("STREAM fast", "STREAM dyknow:HighSpeed"))
    assert (view.name, view.stream) == ("HighSpeed", "HighSpeed")


def test_a_query_without_a_name_gets_a_reserved_one(flying):
    query = replace(parse_query(FAST), name="")
    asked = Submission(FAST, Options(), "fast", Since.NOW)
    view = flying.queries.start(query, asked)
    assert view.stream == view.name == "dyknow_reserved1"
    assert flying.queries.start(query, asked).users == 2
    assert flying.ontology.registered.queries == {}


def test_a_stream_of_a_query_is_not_published_to_nor_removed(flying):
    flying.queries.register(FAST)
    with pytest.raises(Refused):
        flying.accepting("fast")
    with pytest.raises(Refused):
        flying.remove_stream("fast")


def test_a_text_that_makes_no_query(flying):
    with pytest.raises(LanguageError):
        flying.queries.register("REGISTER QUERY q AS SELECT")
    with pytest.raises(BadArguments):
        flying.queries.register(FAST, strategy="slow")


def test_it_starts_anew_once_its_stream_means_something_else(flying):
    flying.queries.register(FAST)
    flying.annotate("stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id")
    before = flying._parts.configuration.units["fast"]
    assert flying.queries.register(FAST).users == 2
    assert flying._parts.configuration.units["fast"] is not before


# -- knowing ---------------------------------------------------------------------------------


def test_it_is_in_the_stream_space_and_on_status(flying):
    flying.queries.register(FAST)
    ask = """ASK { ?unit dyknow-o:hasOutput ?s ; dyknow-o:hasInput ?i ; dyknow-o:instantiationOf
    dyknow-o:cSparql . ?s dyknow-o:hasName "fast" . ?i dyknow-o:hasName "s5" }"""
    assert bool(flying.ontology.query(ask))
    changes = [values for _, values in samples(flying, "status") if values["stream"] == "fast"]
    started = next(values for values in changes if values["change"] == "unit started")
    assert started["specification"] == FAST


def test_of_a_long_text_the_status_stream_tells_the_beginning(flying):
    long = FAST + "# " + "x" * 20_000
    flying.queries.register(long)
    changes = [values for _, values in samples(flying, "status") if values["stream"] == "fast"]
    started = next(values for values in changes if values["change"] == "unit started")
    assert started["specification"] == f"{long[:2048]}… ({len(long)} characters)"
    assert flying.queries.view("fast").source.endswith("xxx")


def test_explanations(flying):
    flying.queries.register(FAST)
    text = flying.queries.explain_running("fast")
    for words in ("registered", SSL, "fast  ← cSparql", "in columns, incrementally"):
        assert words in text
    found = flying.explain(
        query="REGISTER QUERY q AS SELECT ?o WHERE { ?o dyknow:speed ?v } WINDOW " + WINDOW
    )
    for words in ("features needed", "semantic matching", "FROM STREAM", "logical plan"):
        assert words in found


def test_costs_are_estimated_from_the_rate_of_the_stream(flying):
    flying.queries.register(FAST)
    assert "1,000 samples a second of 100 subjects (assumed)" in flying.explain(query=FAST)
    play(flying)
    rate = rate_of(flying.generator("s5"))
    told = f"s5: {rate:.0f} sample a second of 100 subjects (the subjects are assumed)"
    assert told in flying.explain_running("fast")
    asked = flying.explain(query=FAST)
    assert f"s5.trdf{told[2:]}" in asked
    scan = next(line for line in reversed(asked.splitlines()) if "folded, each step" in line)
    assert rate == 1
    assert "  1 " in scan


def test_a_stream_of_one_object_has_one_subject_and_says_what_its_annotation_tells(engine):
    engine.annotate("stream s5 contains speed(uav1) = spd [km.h-1]")
    play(engine, [(second, {"spd": 90.0}) for second in range(1, 11)])
    both = f"SELECT * FROM STREAM {S5} {WINDOW} WHERE {{ ?o dyknow:speed ?v ; dyknow:altitude ?h }}"
    asked = engine.explain(query=both)
    assert "s5.trdf: 1 sample a second of 1 subject\n" in asked
    rows = {line.split()[2]: line.split()[4] for line in asked.splitlines() if "within" in line}
    assert rows == {"dyknow:speed": "5", "dyknow:altitude": "0"}


def test_a_query_that_cannot_be_evaluated_is_told_so_beforehand(flying, monkeypatch):
    def refuses(*arguments):
        raise ValueError("these do not go together")

    monkeypatch.setattr("dyknow.engine.planning.query_units.ContinuousEvaluator", refuses)
    monkeypatch.setattr("dyknow.engine.planning.explanations.ContinuousEvaluator", refuses)
    for ask in (flying.queries.register, flying.queries.explain):
        with pytest.raises(BadArguments, match="go together"):
            ask(FAST)
    assert {view.name for view in flying.streams()} == {"s5", "status"}


# -- an earlier run --------------------------------------------------------------------------


def test_queries_survive_a_restart(tmp_path):
    first = Engine(tmp_path)
    first.annotate(SSL)
    first.queries.register(FAST)
    first.annotate("stream fast contains altitude(UAV) = speed for every UAV = id")
    first.queries.register(
        "REGISTER QUERY again AS SELECT ?o WHERE { ?o dyknow:speed ?v } WINDOW " + WINDOW,
        report="close",
    )
    del first
    gc.collect()
    second = Engine(tmp_path)
    names = [(view.name, view.state, view.report) for view in second.queries.views()]
    assert names == [("fast", "running", "non-empty"), ("again", "running", "close")]
    assert "altitude" in second.stream("fast").annotation
    play(second)
    assert samples(second, "fast")
    second.queries.remove("fast")
    assert set(second.ontology.registered.queries) == {"again"}
    assert "fast" not in second.ontology.registered.annotations


def test_what_cannot_be_restored_is_told_and_kept(tmp_path):
    first = Engine(tmp_path)
    first.annotate(SSL)
    first.queries.register(FAST)
    del first.ontology.registered.annotations["s5"]
    del first
    gc.collect()
    second = Engine(tmp_path)
    (view,) = second.queries.views()
    assert view.state == "not restored"
    assert "names no stream" in view.failure
    assert ("fast", "not restored") in [
        (values["stream"], values["change"]) for _, values in samples(second, "status")
    ]
    second.annotate(SSL)
    assert second.queries.register(FAST).state == "running"
    second.queries.remove("fast")
    assert second.ontology.registered.queries == {}


def test_literals_keep_what_fields_cannot_hold(flying):
    flying.queries.register(
        f'REGISTER QUERY q AS SELECT ("Hallo"@de AS ?word) FROM STREAM {S5} [RANGE 1s STEP 1s] '
        "WHERE { ?o dyknow:speed ?v }"
    )
    play(flying, ROWS[:1])
    assert flying.queries.latest("q").solutions.rows() == [
        {"word": Literal("Hallo", language="de")}
    ]


@pytest.mark.parametrize(
    "condition",
    [
        f"?v IN ({', '.join(map(str, range(300, 900)))})",
        f"?v NOT IN ({', '.join(map(str, range(600)))}, {', '.join(map(str, range(900, 1200)))})",
        " || ".join(f"?v = {number}" for number in range(600, 900)),
        " && ".join(f"?v != {number}" for number in range(900, 1001)),
        # An error in one of many is none where another decides.
        "1 / 0 > 1 || " + " || ".join(f"?v = {number}" for number in range(600, 900)),
    ],
    ids=["IN", "NOT IN", "or", "and", "an error"],
)
def test_long_lists_in_conditions(flying, condition):
    text = f"""REGISTER QUERY among AS SELECT ?v FROM STREAM {S5} [RANGE 20s STEP 20s]
        WHERE {{ ?o dyknow:speed ?v . FILTER({condition}) }}"""
    flying.queries.register(text)
    speeds = range(600, 1001, 7)
    play(flying, [(n / 100, {"id": f"uav{n}", "spd": float(n), "alt": 1.0}) for n in speeds])
    told = sorted(values["v"] for _, values in samples(flying, "among"))
    assert told == [float(n) for n in speeds if n < 900]


def test_what_is_nested_too_deeply_after_all_is_refused(flying, monkeypatch):
    """Bounds of the text see to it that nothing is; were it so, the text would be to blame."""

    def deep(*_):
        raise RecursionError

    monkeypatch.setattr("dyknow.continuous.evaluation.solver.QueryBody.translate", deep)
    with pytest.raises(LanguageError, match="nested too deeply to be evaluated"):
        flying.queries.register(SELECT)
    assert flying.queries.views() == ()
    monkeypatch.undo()
    assert flying.queries.register(SELECT).state == "running"
