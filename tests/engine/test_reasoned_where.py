"""What each language sees of the ontology: the rows of "What is reasoned where" in
docs/explanation/semantics.md."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from pyoxigraph import Literal, NamedNode, QueryBoolean

import dyknow
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import NoPlan
from dyknow.languages.errors import LanguageError
from dyknow.rdf.namespaces import DYKNOW

EX = "http://example.org/"
ONTOLOGY = f"""@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <{DYKNOW}> .
@prefix ex: <{EX}> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
<{EX}o> a owl:Ontology .
ex:Glider a owl:Class ; rdfs:subClassOf dyknow:Aircraft .
ex:Mover a owl:Class ; rdfs:subClassOf dyknow:Thing .
ex:groundSpeed a :UnaryFeature, owl:DatatypeProperty ; rdfs:subPropertyOf dyknow:speed ;
  rdfs:range xsd:double ; :hasUnit "km.h-1" .
ex:near a :UnaryFeature, owl:ObjectProperty, owl:SymmetricProperty ;
  rdfs:domain ex:Mover ; rdfs:range dyknow:Thing .
ex:leads a :UnaryFeature, owl:ObjectProperty, owl:TransitiveProperty ;
  owl:inverseOf ex:follows ; rdfs:range dyknow:Thing .
ex:follows a :UnaryFeature, owl:ObjectProperty ; rdfs:range dyknow:Thing .
ex:within a owl:ObjectProperty, owl:TransitiveProperty .
dyknow:a a dyknow:Thing . dyknow:b a dyknow:Thing . dyknow:c a dyknow:Thing .
dyknow:g1 ex:within ex:zone ; owl:sameAs ex:glider1 . ex:zone ex:within ex:sweden .
"""
SPEEDS = f"<{EX}groundSpeed>(<{EX}Glider>) = spd [km.h-1] for every <{EX}Glider> = id"
PLACES = f"<{EX}near>(dyknow:Thing) = near, <{EX}leads>(dyknow:Thing) = lead"
SSL = f"""stream speeds contains {SPEEDS}
stream places contains {PLACES} for every dyknow:Thing = id"""
TIMES = range(1_000_000_000, 4_000_000_000, 1_000_000_000)
# a is near b, and leads it; b is near c, and leads it.
STREAMS: dict[str, list[dict[str, Any]]] = {
    "speeds": [{"valid": t, "id": "g1", "spd": 101.0} for t in TIMES],
    "places": [
        {"valid": t, "id": one, "near": other, "lead": other}
        for t in TIMES
        for one, other in (("a", "b"), ("b", "c"))
    ],
}
STATES = "with sample every 1s, use most recent, max delay 1s"
SECOND = "[RANGE 1s STEP 1s]"
RULES = {
    "sub-feature": "?x dyknow:speed ?v",
    "sub-sort": "?x a dyknow:Aircraft ; dyknow:speed ?v",
    "static": "?x dyknow:speed ?v ; ex:within ex:sweden",
    "same": "ex:glider1 dyknow:speed ?x",
    "symmetric": "dyknow:b ex:near ?x",
    "inverse": "?x ex:follows ?y",
    "transitive": "dyknow:a ex:leads ?x",
    "domain": "?x a ex:Mover ; ex:near ?y",
}
SPEED_RULES = ("sub-feature", "sub-sort", "static", "same")
IN_WINDOWS = {
    "sub-feature": {"g1"},
    "sub-sort": {"g1"},
    "static": {"g1"},
    "same": set(),
    "symmetric": {"a", "c"},
    "inverse": {"b", "c"},
    "transitive": {"b"},
    "domain": {"a", "b", "c"},
}


@pytest.fixture
def ontology(tmp_path: Path) -> Path:
    path = tmp_path / "o.ttl"
    path.write_text(ONTOLOGY)
    return path


def found(text: str, ontology: Path, column: str = "x") -> set[str]:
    rows = dyknow.run(f"PREFIX ex: <{EX}>\n{text}", STREAMS, ssl=SSL, ontology=[ontology])
    return {row[column].removeprefix(DYKNOW) for row in rows}


def query(rule: str, *, stream: bool, extra: str = "") -> str:
    name = "speeds" if rule in SPEED_RULES else "places"
    source, window = (f"FROM STREAM dyknow:{name} {SECOND}", "") if stream else ("", SECOND)
    window = f"WINDOW {window}" if window else ""
    return f"""REGISTER QUERY q COMPUTE EVERY 1s AS
SELECT ?x {extra} {source} WHERE {{ {RULES[rule]} }} {window}"""


def test_sparql_sees_the_closure_and_no_samples() -> None:
    engine = Engine()
    engine.load_ontology(ONTOLOGY, name=f"{EX}o")

    def ask(pattern: str) -> bool:
        answer = engine.ontology.query(f"PREFIX ex: <{EX}> ASK {{ {pattern} }}")
        assert isinstance(answer, QueryBoolean)
        return bool(answer)

    assert ask("dyknow:g1 ex:within ex:sweden")
    assert ask("ex:glider1 ex:within ex:sweden")
    assert ask("ex:Glider rdfs:subClassOf dyknow:Thing")
    engine.annotate(SSL)
    assert ask("?s a :Annotation ; :hasName 'speeds'")
    assert not ask("?o ex:groundSpeed ?v")


@pytest.mark.parametrize("rule", RULES)
def test_from_stream_sees_the_schema_and_the_closed_static_side(rule: str, ontology: Path) -> None:
    assert found(query(rule, stream=True), ontology) == IN_WINDOWS[rule]


@pytest.mark.parametrize("rule", RULES)
def test_windows_on_oxigraph_see_the_same(rule: str, ontology: Path) -> None:
    text = query(rule, stream=True, extra="(BNODE() AS ?n)")
    assert found(text, ontology) == IN_WINDOWS[rule]


@pytest.mark.parametrize("rule", RULES)
def test_a_query_without_a_stream_sees_the_same_of_what_matching_finds(
    rule: str, ontology: Path
) -> None:
    text = query(rule, stream=False)
    if rule == "inverse":
        with pytest.raises(NoPlan):
            found(text, ontology)
    elif rule == "symmetric":
        assert found(text, ontology) == {"c"}  # only the samples of b are read
    else:
        assert found(text, ontology) == IN_WINDOWS[rule]


def verdicts(text: str, ontology: Path) -> dict[str, set[str]]:
    by_object: dict[str, set[str]] = {}
    for row in dyknow.run(f"monitor m{text} {STATES}", STREAMS, ssl=SSL, ontology=[ontology]):
        by_object.setdefault(row["x"].removeprefix(DYKNOW), set()).add(row["verdict"])
    return by_object


def test_formulas_see_sub_features_and_sub_sorts_only(ontology: Path) -> None:
    near = f"<{EX}near>(?x)"
    assert verdicts("(?x in dyknow:Aircraft) = speed(?x) > 200", ontology) == {"g1": {"false"}}
    some = verdicts(f"(?x in dyknow:Thing) = not {near} = dyknow:b", ontology)
    assert some["a"] == {"false"}
    # b is near a, by symmetry, and a formula does not see it.
    none = verdicts(f"(?x in dyknow:Thing) = {near} = dyknow:a", ontology)
    assert none == {"a": {"false"}, "b": {"false"}}
    assert verdicts(f"(?x in <{EX}Mover>) = {near} = dyknow:a", ontology) == {}
    with pytest.raises(NoPlan):
        verdicts(f"(?x in dyknow:Thing) = <{EX}follows>(?x) = dyknow:a", ontology)


@pytest.mark.parametrize(
    ("text", "objects"),
    [
        ("SELECT ?x WHERE {{ {sub-sort} }} SEQ {{ ?x dyknow:speed ?w }} WITHIN 2s", {"g1"}),
        ("SELECT ?x WHERE {{ {static} }} SEQ {{ ?x dyknow:speed ?w }} WITHIN 2s", {"g1"}),
        ("SELECT ?x WHERE {{ {symmetric} }} SEQ {{ dyknow:b ex:near ?z }} WITHIN 2s", {"c"}),
        ("SELECT ?x WHERE {{ {domain} }} SEQ {{ ?x ex:near ?z }} WITHIN 2s", set()),
        ("SELECT ?x WHERE {{ {inverse} }} SEQ {{ ?x ex:follows ?z }} WITHIN 2s", None),
        ("chronicle C(?x) {{ event(dyknow:speed[?x], t1); ?x in dyknow:Aircraft }}", {"g1"}),
        ("chronicle C(?x) {{ event(ex:near[dyknow:b]:(?, ?x), t1) }}", {"c"}),
        ("chronicle C(?x) {{ event(ex:near[?x], t1); ?x in ex:Mover }}", set()),
        ("chronicle C(?x) {{ event(ex:follows[?x], t1) }}", None),
        ("PATTERN SEQ(dyknow:speed x, dyknow:speed y) WITHIN 2s", {"g1"}),
        ("PATTERN SEQ(ex:follows x, ex:follows y) WITHIN 2s", None),
    ],
)
def test_patterns_see_sub_features_sub_sorts_and_static_triples(
    text: str, objects: set[str] | None, ontology: Path
) -> None:
    if objects is None:
        with pytest.raises(NoPlan):
            found(text.format(**RULES), ontology)
    else:
        assert found(text.format(**RULES), ontology) == objects


def test_labels_of_kpl_are_names() -> None:
    engine = Engine()
    engine.load_ontology(ONTOLOGY.replace(EX, DYKNOW), name=f"{EX}o")
    with pytest.raises(LanguageError, match="no generator"):
        engine.add_kpl("source float s\nstrmgen groundSpeed[g1] = s\nstream x = speed[g1]")


@pytest.mark.parametrize(
    ("pattern", "windows"),
    [
        ("?o dyknow:speed ?v", 3),
        ("?o a ex:Glider ; ex:groundSpeed ?v", 0),
        ("?o ex:groundSpeed ?v ; ex:within ex:zone", 3),
        ("?o ex:groundSpeed ?v ; ex:within ex:sweden", 0),
        ("?o ex:groundSpeed ?v . ex:Glider rdfs:subClassOf dyknow:Thing", 0),
    ],
)
def test_evaluate_entails_of_streams_and_not_of_static_triples(
    pattern: str, windows: int, ontology: Path
) -> None:
    subject, feature = NamedNode(DYKNOW + "g1"), NamedNode(EX + "groundSpeed")
    triples = [(time, subject, feature, Literal(101.0)) for time in TIMES]
    text = f"""PREFIX ex: <{EX}>
REGISTER QUERY q AS SELECT ?v FROM STREAM <urn:s> {SECOND} WHERE {{ {pattern} }}"""
    results = dyknow.evaluate(text, streams={"urn:s": triples}, static=[ontology])
    assert sum(bool(window.solutions) for window in results) == windows
