"""Queries see what the ontology's schema says of stream triples, however their streams are found
(SPEC §4, "What is entailed in windows")."""

import pytest
from feeding import feed, samples

from dyknow.continuous.operators import background
from dyknow.ontology.entailment import deep_hierarchies

DYKNOW = "http://www.ida.liu.se/dyknow/"
SCHEMA = """
@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
dyknow:gs a :UnaryFeature, owl:DatatypeProperty ; rdfs:subPropertyOf dyknow:speed ;
    rdfs:domain dyknow:Aircraft ; rdfs:range xsd:double ; :hasUnit "kt" .
dyknow:near a :UnaryFeature, owl:ObjectProperty, owl:SymmetricProperty ;
    rdfs:range dyknow:Obstacle .
dyknow:Obstacle a owl:Class ; rdfs:subClassOf dyknow:Thing .
"""
SSL = """stream radar contains gs(Thing) = v [kt] for every Thing = id
stream seen contains near(Thing) = other for every Thing = id"""
WINDOW = "[RANGE 1s STEP 1s]"
RADAR = f"FROM STREAM <{DYKNOW}radar.trdf> {WINDOW}"
SEEN = f"FROM STREAM <{DYKNOW}seen.trdf> {WINDOW}"
ROWS = [(second, {"id": "a", "v": 100.0}) for second in (1, 2, 3)]


@pytest.fixture
def watching(engine):
    engine.load_ontology(SCHEMA, name="schema")
    engine.annotate(SSL)
    return engine


def answers(engine, text, stream="radar", rows=ROWS):
    engine.queries.register(f"REGISTER QUERY q AS {text}")
    feed(engine, stream, rows)
    engine.end(stream)
    return [values for _, values in samples(engine, "q")]


def test_a_sub_feature_answers_a_query_that_names_its_stream(watching):
    found = answers(
        watching, f"SELECT ?o (COUNT(?v) AS ?n) {RADAR} WHERE {{ ?o dyknow:speed ?v }} GROUP BY ?o"
    )
    assert found == [{"o": "a", "n": 1}] * 3


def test_it_does_so_in_the_unit_of_the_feature(watching):
    """As an event request on the same stream has it: 100 kt are 185.2 km/h."""
    (first, *_) = answers(watching, f"SELECT ?o ?v {RADAR} WHERE {{ ?o dyknow:speed ?v }}")
    assert first == {"o": "a", "v": pytest.approx(185.2)}


def test_the_same_without_from_stream(watching):
    (first, *_) = answers(watching, f"SELECT ?o ?v WHERE {{ ?o dyknow:speed ?v }} WINDOW {WINDOW}")
    assert first == {"o": "a", "v": pytest.approx(185.2)}


def test_a_sample_counts_once_where_a_query_asks_for_both_features(watching):
    found = answers(
        watching,
        f"""SELECT ?o (COUNT(?v) AS ?speeds) (COUNT(?g) AS ?own)
        WHERE {{ {{ ?o dyknow:speed ?v }} UNION {{ ?o dyknow:gs ?g }} }} GROUP BY ?o WINDOW {WINDOW}
        """,
    )
    assert found == [{"o": "a", "speeds": 1, "own": 1}] * 3


def test_a_domain_says_what_the_subject_is(watching):
    found = answers(
        watching, f"SELECT ?o {RADAR} WHERE {{ ?o a dyknow:Vehicle . ?o dyknow:gs ?v }}"
    )
    assert found == [{"o": "a"}] * 3


def test_a_symmetric_feature_holds_both_ways_and_a_range_says_what_its_object_is(watching):
    rows = [(1, {"id": "a", "other": "b"}), (2, {"id": "a", "other": "a"})]
    found = answers(
        watching,
        f"SELECT ?s ?o {SEEN} WHERE {{ ?s dyknow:near ?o . ?s a dyknow:Obstacle }}",
        "seen",
        rows,
    )
    both = [{"s": "a", "o": "b"}, {"s": "b", "o": "a"}]
    assert sorted(found[:2], key=str) == sorted(both, key=str)
    assert found[2:] == [{"s": "a", "o": "a"}]


def test_an_ontology_that_is_loaded_while_a_query_runs_counts_from_then_on(engine):
    engine.load_ontology(SCHEMA.replace("rdfs:subPropertyOf", ":like"), name="schema")
    engine.annotate(SSL)
    engine.queries.register(
        f"REGISTER QUERY q AS SELECT ?o ?v {RADAR} WHERE {{ ?o dyknow:speed ?v }}"
    )
    feed(engine, "radar", ROWS[:1])
    engine.load_ontology(SCHEMA, name="schema")
    feed(engine, "radar", ROWS[1:])
    engine.end("radar")
    assert [time for time, _ in samples(engine, "q")] == [2.0, 3.0]


@pytest.mark.parametrize(
    "pattern",
    [
        "dyknow:D9 rdfs:subClassOf ?c",
        "dyknow:D9 ?p ?c FILTER(?p = rdfs:subClassOf)",
        "dyknow:D9 (rdfs:subClassOf|dyknow:nothing) ?c",
        "?c ^rdfs:subClassOf ?d FILTER(?d = dyknow:D9)",
    ],
)
def test_the_static_side_has_all_pairs_of_a_deep_hierarchy(watching, monkeypatch, pattern):
    monkeypatch.setattr(deep_hierarchies, "MOST_PAIRS", 20)
    chain = "\n".join(f"dyknow:D{i + 1} rdfs:subClassOf dyknow:D{i} ." for i in range(9))
    watching.load_ontology(SCHEMA + chain, name="schema")
    found = answers(
        watching,
        f"""SELECT (COUNT(DISTINCT ?c) AS ?n) {RADAR}
        WHERE {{ ?o dyknow:gs ?v . {pattern} FILTER(CONTAINS(STR(?c), "dyknow/D")) }}""",
    )
    assert [row["n"] for row in found] == [9] * 3


def test_a_query_that_asks_for_too_many_pairs_fails_with_its_reason(watching, monkeypatch):
    monkeypatch.setattr(deep_hierarchies, "MOST_PAIRS", 20)
    monkeypatch.setattr(background, "MOST_MISSING", 20)
    chain = "\n".join(f"dyknow:D{i + 1} rdfs:subClassOf dyknow:D{i} ." for i in range(9))
    watching.load_ontology(SCHEMA + chain, name="schema")
    watching.queries.register(
        f"REGISTER QUERY q AS SELECT ?c {RADAR} WHERE {{ ?o dyknow:gs ?v . ?c rdfs:subClassOf ?d }}"
    )
    (unit,) = watching.units()
    feed(watching, "radar", ROWS)
    assert "the hierarchy of rdfs:subClassOf gives more than 20 pairs" in unit.failure


def test_windows_that_count_triples_count_those_of_the_stream(watching):
    found = answers(
        watching,
        f"""SELECT (COUNT(?v) AS ?n) FROM STREAM <{DYKNOW}radar.trdf> [TRIPLES 2 STEP 1]
        WHERE {{ ?o dyknow:speed ?v }}""",
    )
    assert [row["n"] for row in found] == [1, 2, 2]


def test_explain_says_what_is_entailed(watching):
    text = watching.queries.explain(
        f"REGISTER QUERY q AS SELECT ?o ?v {RADAR} WHERE {{ ?o dyknow:speed ?v }}"
    )
    assert "?s dyknow:gs ?o entails ?s dyknow:speed ?o" in text
    assert "Aircraft" not in text


def test_each_argument_of_a_feature_of_several_objects_is_of_its_sort(watching):
    watching.load_ontology(
        SCHEMA + "dyknow:distance a :Feature, owl:ObjectProperty .", name="schema"
    )
    watching.annotate(
        "stream gaps contains distance(Car as a, Human as b) = d for every a = x, every b = y"
    )
    found = answers(
        watching,
        f"""SELECT ?b FROM STREAM <{DYKNOW}gaps.trdf> {WINDOW} WHERE
        {{ ?n <http://www.w3.org/1999/02/22-rdf-syntax-ns#_2> ?b . ?b a dyknow:Human }}""",
        "gaps",
        [(1, {"x": "car1", "y": "human1", "d": 3.0})],
    )
    assert found == [{"b": "human1"}]
