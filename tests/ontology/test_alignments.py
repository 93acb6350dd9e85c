"""The stream space in the words of other vocabularies (SPEC §2)."""

import pytest

from dyknow.engine.engine import Engine
from dyknow.ontology.ontology import Ontology
from dyknow.ontology.units import conversion, parse_unit

PREFIXES = """PREFIX prov: <http://www.w3.org/ns/prov#>
PREFIX sosa: <http://www.w3.org/ns/sosa/>
PREFIX ssn: <http://www.w3.org/ns/ssn/>
PREFIX vocals: <http://w3id.org/rsp/vocals#>
PREFIX qudt: <http://qudt.org/schema/qudt/>
PREFIX unit: <http://qudt.org/vocab/unit/>
PREFIX skos: <http://www.w3.org/2004/02/skos/core#>
"""


@pytest.fixture(scope="module")
def engine() -> Engine:
    """gps → pos → (pos, alt) → both, with a policy between."""
    engine = Engine()
    engine.add_kpl(
        "source float gps\nsource float baro\nstrmgen pos = gps\nstrmgen alt = baro\n"
        "strmgen both = join(pos with sample every 200, alt)\nstream out = both with max delay 5s"
    )
    return engine


def asked(ontology: Ontology, pattern: str) -> set[str]:
    """The local names of ``?x``."""
    _, rows = ontology.query_rows(PREFIXES + f"SELECT DISTINCT ?x {{ {pattern} }}")
    return {str(row[0]).strip("<>").rpartition("#")[2] for row in rows}


def test_lineage_in_prov(engine: Engine) -> None:
    ontology = engine.ontology
    origins = asked(ontology, ":out (prov:wasGeneratedBy/prov:used)+ ?x . ?x a prov:Entity")
    assert {"gps", "baro", "both"} <= origins
    first = "FILTER NOT EXISTS { ?x prov:wasGeneratedBy ?unit }"
    found = asked(ontology, f":out (prov:wasGeneratedBy/prov:used)+ ?x . {first}")
    assert found == {"gps", "baro"}
    assert asked(ontology, "?x prov:generated :both . ?x a prov:Activity") == asked(
        ontology, "?x :hasOutput :both"
    )
    plans = asked(ontology, "?unit prov:generated :out ; :instantiationOf ?x . ?x a prov:Plan")
    assert plans == {"policy"}


def test_sensors_and_procedures_in_sosa(engine: Engine) -> None:
    ontology = engine.ontology
    assert "join" in asked(ontology, "?x a sosa:Procedure")
    assert asked(ontology, "?x ssn:implements :join ; a ssn:System") == asked(
        ontology, "?x :hasOutput :both"
    )
    features = asked(ontology, "?x a sosa:ObservableProperty")
    assert "http://www.ida.liu.se/dyknow/speed" in features


def test_streams_in_vocals(engine: Engine) -> None:
    streams = asked(engine.ontology, "?x a vocals:Stream")
    assert {"gps", "both", "out", "status"} <= streams


def test_units_of_features_in_qudt_and_ucum(engine: Engine) -> None:
    rows = engine.ontology.query_rows(
        PREFIXES + "SELECT ?qudt ?ucum { dyknow:speed :hasUnit ?text . "
        "?unit :hasName ?text ; a :Unit ; skos:exactMatch ?qudt ; qudt:ucumCode ?ucum }"
    )[1]
    assert [[str(term) for term in row] for row in rows] == [
        ["<http://qudt.org/vocab/unit/KiloM-PER-HR>", '"km/h"']
    ]
    # Every feature that is shipped with a unit has one there.
    assert asked(engine.ontology, "?x a :Feature ; :hasUnit ?t") == asked(
        engine.ontology, "?x a :Feature ; :hasUnit ?t . ?u a :Unit ; :hasName ?t"
    )


@pytest.mark.parametrize(
    ("text", "qudt", "factor"),
    [
        ("km.h-1", "KiloM-PER-HR", 1 / 3.6),
        ("kt", "KN", 1852 / 3600),
        ("ft.min-1", "FT-PER-MIN", 0.3048 / 60),
        ("mi.h-1", "MI-PER-HR", 1609.344 / 3600),
    ],
)
def test_a_unit_is_the_same_in_both(engine: Engine, text: str, qudt: str, factor: float) -> None:
    same = asked(engine.ontology, f'?u :hasName "{text}" ; skos:exactMatch ?x')
    assert same == {f"http://qudt.org/vocab/unit/{qudt}"}
    change = conversion(parse_unit(text), parse_unit("m.s-1"))
    assert change.factor == pytest.approx(factor)


def test_every_named_unit_is_a_unit(engine: Engine) -> None:
    _, rows = engine.ontology.query_rows("SELECT ?t { ?u a :Unit ; :hasName ?t }")
    assert len(rows) > 30
    for (text,) in rows:
        parse_unit(str(text).strip('"'))


def test_the_stream_space_stays_well_formed(engine: Engine) -> None:
    assert engine.ontology.validate().conforms
