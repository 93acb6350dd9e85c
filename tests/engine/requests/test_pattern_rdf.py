"""The results of CONSTRUCT of a pattern as triples."""

import pytest
from feeding import feed

from dyknow.rdf.namespaces import DYKNOW

SSL = "stream s contains speed(Car) = v for every Car = id"
HEAD = (
    "REGISTER STREAM fast AS PREFIX d: <http://www.ida.liu.se/dyknow/> PREFIX e: <http://e.org/> "
    "CONSTRUCT { ?c e:reached ?w ; e:owner ?o ; e:is ?c } "
    "WHERE { ?c d:speed ?v } SEQ { ?c d:speed ?w ; e:owner ?o } FILTER (?w > ?v) WITHIN 5 s"
)


@pytest.fixture
def driving(engine):
    engine.annotate(SSL)
    engine.load_ontology(
        f"<{DYKNOW}car1> <http://e.org/owner> <{DYKNOW}ann> .",
        name="http://e.org/owners",
        format="turtle",
    )
    return engine


def test_the_triples_of_the_head(driving):
    driving.queries.register(HEAD)
    rows = [(1, {"id": "car1", "v": 10.0}), (2, {"id": "car1", "v": 20.5})]
    feed(driving, "s", rows)
    driving.end("s")
    converter = driving.queries.converter("fast")
    assert converter is not None
    triples = converter.convert(driving.generator("fast").stream.all())
    subject = f"<{DYKNOW}car1>"
    assert [(str(s), p.value, str(o)) for _, s, p, o in triples] == [
        (subject, "http://e.org/reached", '"20.5"^^<http://www.w3.org/2001/XMLSchema#double>'),
        (subject, "http://e.org/owner", '"ann"'),
        (subject, "http://e.org/is", subject),
    ]


def test_a_table_has_no_triples(driving):
    driving.queries.register(
        "REGISTER STREAM all AS PATTERN SEQ(speed a, speed b) WITHIN 5 seconds"
    )
    assert driving.queries.converter("all") is None
