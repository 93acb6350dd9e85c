"""The example of [Introspection15 §4.3] as printed, SPEC §7.

Eight transformations, then IMUGPSto3D; who wants `GeoLocation` of every `Human` needs it of `self`.
"""

import pytest

from dyknow.languages.ssl import check_ssl, parse_ssl
from dyknow.matching.match import Outcome, match, render
from dyknow.matching.plan import Compute, nodes_of
from dyknow.matching.space import StreamSpace, TransformationDescription
from dyknow.matching.want import Want
from dyknow.ontology.ontology import Ontology
from dyknow.rdf.namespaces import DYKNOW

ONTOLOGY = """
@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
dyknow:GPS a :Feature . dyknow:IMU a :Feature . dyknow:RGB a :Feature . dyknow:IR a :Feature .
dyknow:Attitude a :Feature . dyknow:GeoLocation a :Feature . dyknow:PixelLocation a :Feature .
dyknow:Human a owl:Class ; rdfs:subClassOf dyknow:Thing .
dyknow:RMAX a owl:Class ; rdfs:subClassOf dyknow:UAV .
:self a dyknow:RMAX .
"""
EIGHT = """
source gps provides v:GPS(self)
source imu provides v:IMU(self)
source rgbCam provides v:RGB(self)
source irCam provides v:IR(self)
compunit attitude transforms imu:IMU(Thing) to v:Attitude(Thing)
compunit GPSto3D transforms gps:GPS(Thing) to v:GeoLocation(Thing)
compunit humanDetector transforms rgb:RGB(RMAX), ir:IR(RMAX) to v:PixelLocation(Human)
compunit humanCoordinates
  transforms pixel:PixelLocation(Human), place:GeoLocation(RMAX), attitude:Attitude(RMAX)
  to v:GeoLocation(Human)
"""
NINTH = "compunit IMUGPSto3D transforms gps:GPS(Thing), imu:IMU(Thing) to v:GeoLocation(Thing)"
QUALITIES = {"GPSto3D": 0.9, "IMUGPSto3D": 0.95}


@pytest.fixture(scope="module")
def vocabulary():
    ontology = Ontology.open(None)
    ontology.load(ONTOLOGY, name="http://example.org/paper")
    return ontology.vocabulary


@pytest.fixture(scope="module")
def space(vocabulary):
    def made(*without):
        text = EIGHT + NINTH
        annotations = check_ssl(parse_ssl(text), text, vocabulary)
        return StreamSpace(
            (),
            [
                TransformationDescription.of(each, quality=QUALITIES.get(each.name, 1.0))
                for each in annotations
                if each.name not in without
            ],
        )

    return made


def geolocation(sort=None, object=None):
    return Want(DYKNOW + "GeoLocation", None if sort is None else DYKNOW + sort, object)


def test_where_every_human_is(vocabulary, space):
    found = match(geolocation("Human"), space(), vocabulary)
    assert found.supply.complete
    assert (
        render(found)
        == """\
GeoLocation of every dyknow:Human
├─ chosen: humanCoordinates : PixelLocation, GeoLocation, Attitude ⇒ GeoLocation
│  └─ synchronize
│     ├─ humanDetector : RGB, IR ⇒ PixelLocation
│     │  └─ synchronize
│     │     ├─ rgbCam : ∅ ⇒ RGB
│     │     └─ irCam : ∅ ⇒ IR
│     ├─ GPSto3D : GPS ⇒ GeoLocation
│     │  └─ gps : ∅ ⇒ GPS
│     └─ attitude : IMU ⇒ Attitude
│        └─ imu : ∅ ⇒ IMU
├─ failed: GPSto3D : GPS[Thing] ⇒ GeoLocation[Thing]
│  └─ failed: dyknow:GPS of every dyknow:Human
│     └─ failed: gps : ∅ ⇒ GPS[self] — it speaks of dyknow-o:self, not of every dyknow:Human
└─ not tried: IMUGPSto3D : GPS[Thing], IMU[Thing] ⇒ GeoLocation[Thing]"""
    )


def test_humans_are_told_apart_and_self_is_not_named(vocabulary, space):
    """The detector finds the humans itself; whose camera saw them is the same for all."""
    (source,) = match(geolocation("Human"), space(), vocabulary).supply.sources
    (human,) = source.roles
    assert (human.sort, human.object, human.id_field) == (DYKNOW + "Human", None, "id")


def test_without_the_infrared_camera(vocabulary, space):
    found = match(geolocation("Human"), space("irCam"), vocabulary)
    assert found.supply is None
    assert (
        render(found)
        == """\
GeoLocation of every dyknow:Human
├─ failed: GPSto3D : GPS[Thing] ⇒ GeoLocation[Thing]
│  └─ failed: dyknow:GPS of every dyknow:Human
│     └─ failed: gps : ∅ ⇒ GPS[self] — it speaks of dyknow-o:self, not of every dyknow:Human
├─ failed: humanCoordinates : PixelLocation[Human], GeoLocation[RMAX], Attitude[RMAX] ⇒ \
GeoLocation[Human]
│  └─ failed: dyknow:PixelLocation of every dyknow:Human
│     └─ failed: humanDetector : RGB[RMAX], IR[RMAX] ⇒ PixelLocation[Human]
│        └─ failed: dyknow:IR of dyknow-o:self — no stream and no transformation gives dyknow:IR
└─ failed: IMUGPSto3D : GPS[Thing], IMU[Thing] ⇒ GeoLocation[Thing]
   ├─ failed: dyknow:GPS of every dyknow:Human
   │  └─ failed: gps : ∅ ⇒ GPS[self] — it speaks of dyknow-o:self, not of every dyknow:Human
   └─ failed: dyknow:IMU of every dyknow:Human
      └─ failed: imu : ∅ ⇒ IMU[self] — it speaks of dyknow-o:self, not of every dyknow:Human"""
    )
    assert found.missing == (
        "gps: it speaks of dyknow-o:self, not of every dyknow:Human",
        "no stream and no transformation gives dyknow:IR",
        "imu: it speaks of dyknow-o:self, not of every dyknow:Human",
    )


def test_where_self_is(vocabulary, space):
    found = match(geolocation(object=vocabulary.self_object), space(), vocabulary)
    assert found.supply.complete
    assert (
        render(found)
        == """\
GeoLocation of dyknow-o:self
├─ chosen: GPSto3D : GPS ⇒ GeoLocation
│  └─ gps : ∅ ⇒ GPS
├─ not tried: humanCoordinates : PixelLocation[Human], GeoLocation[RMAX], Attitude[RMAX] ⇒ \
GeoLocation[Human]
└─ not tried: IMUGPSto3D : GPS[Thing], IMU[Thing] ⇒ GeoLocation[Thing]"""
    )


def test_every_rmax_is_self_as_far_as_is_known(vocabulary, space):
    supply = match(geolocation("RMAX"), space(), vocabulary).supply
    assert not supply.complete
    assert [role.object for s in supply.sources for role in s.roles] == [vocabulary.self_object]


def test_an_rmax_is_no_human(vocabulary, space):
    """Nothing says that `self` is a human, so nobody tries to detect it."""
    found = match(geolocation(object=vocabulary.self_object), space("gps"), vocabulary)
    assert found.supply is None
    assert {a.outcome for a in found.tree} == {Outcome.FAILED}


@pytest.mark.parametrize("whose", ["self", "Human"])
@pytest.mark.parametrize(
    ("strategy", "chosen", "left_out"),
    [("cost", "GPSto3D", "IMUGPSto3D"), ("quality", "IMUGPSto3D", "GPSto3D")],
)
def test_cost_picks_gps_and_quality_picks_both(
    vocabulary, space, whose, strategy, chosen, left_out
):
    of_self = geolocation(object=vocabulary.self_object)
    wanted = of_self if whose == "self" else geolocation(whose)
    found = match(wanted, space(), vocabulary, strategy)
    (source,) = found.supply.sources
    units = {n.transformation for n in nodes_of(source.node) if isinstance(n, Compute)}
    assert chosen in units
    assert left_out not in units
    assert found.proven
