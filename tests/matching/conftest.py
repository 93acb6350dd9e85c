"""A small closed ontology, written out: Thing ⊒ Aircraft ⊒ UAV ⊒ RMAX, Thing ⊒ Car."""

import pytest
from pyoxigraph import Literal, NamedNode, Triple

from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import DYKNOW, OWL, RDF, RDFS, STREAM_SPACE

SORTS = {
    "Thing": [],
    "Aircraft": ["Thing"],
    "UAV": ["Aircraft", "Thing"],
    "RMAX": ["UAV", "Aircraft", "Thing"],
    "Car": ["Thing"],
}
FEATURES = {
    "speed": ("km.h-1", []),
    "groundspeed": ("km.h-1", ["speed"]),
    "altitude": ("ft", []),
    "latitude": ("deg", []),
    "longitude": ("deg", []),
    "GPS": (None, []),
    "IMU": (None, []),
    "GeoLocation": (None, []),
    "xydist": ("m", []),
}
OBJECTS = {"uav1": "UAV", "car1": "Car"}


def _node(name: str) -> NamedNode:
    return NamedNode(DYKNOW + name)


@pytest.fixture(scope="session")
def vocabulary() -> Vocabulary:
    kind = NamedNode(RDF + "type")
    triples = []
    for name, wider in SORTS.items():
        triples.append(Triple(_node(name), kind, NamedNode(OWL + "Class")))
        triples += [Triple(_node(name), NamedNode(RDFS + "subClassOf"), _node(w)) for w in wider]
    for name, (unit, wider) in FEATURES.items():
        triples.append(Triple(_node(name), kind, NamedNode(STREAM_SPACE + "Feature")))
        triples += [Triple(_node(name), NamedNode(RDFS + "subPropertyOf"), _node(w)) for w in wider]
        if unit is not None:
            triples.append(Triple(_node(name), NamedNode(STREAM_SPACE + "hasUnit"), Literal(unit)))
    for name, sort in OBJECTS.items():
        triples += [Triple(_node(name), kind, _node(s)) for s in (sort, *SORTS[sort])]
    return Vocabulary.from_triples(triples)
