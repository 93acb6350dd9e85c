"""Transformations at work ([Introspection15 §3.1, §4.3]): user-written code with annotations."""

import gc

import pytest
from feeding import feed, samples

from dyknow.engine.catalog.iri_annotations import (
    DescribedArgument,
    DescribedPort,
    DescribedTransformation,
)
from dyknow.engine.catalog.transformation_turtle import read_transformations
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import (
    AlreadyExists,
    BadArguments,
    Conflict,
    Refused,
    UnknownFeature,
    UnknownTransformation,
)
from dyknow.engine.model.process_reports import Report
from dyknow.engine.processes.registry import Processes
from dyknow.languages.errors import LanguageError
from dyknow.streams.time import SECOND

ONTOLOGY = """
@prefix : <http://www.dyknow.eu/ontology#> .
@prefix d: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
@prefix xsd: <http://www.w3.org/2001/XMLSchema#> .
d:GPS a :Feature ; rdfs:range xsd:double . d:IMU a :Feature ; rdfs:range xsd:double .
d:RGB a :Feature ; rdfs:range xsd:double . d:IR a :Feature ; rdfs:range xsd:double .
d:Attitude a :Feature ; rdfs:range xsd:double . d:GeoLocation a :Feature ; rdfs:range xsd:double .
d:PixelLocation a :Feature ; rdfs:range xsd:double .
d:Human a owl:Class ; rdfs:subClassOf d:Thing . d:RMAX a owl:Class ; rdfs:subClassOf d:UAV .
:self a d:RMAX .
"""
PAPER = """
source gps provides v:GPS(self)
source imu provides v:IMU(self)
source rgbCam provides v:RGB(self)
source irCam provides v:IR(self)
compunit attitude transforms v:IMU(Thing) to v:Attitude(Thing)
compunit GPSto3D transforms v:GPS(Thing) to v:GeoLocation(Thing)
compunit humanDetector transforms rgb:RGB(RMAX), ir:IR(RMAX) to v:PixelLocation(Human)
  for every Human = who
compunit humanCoordinates
  transforms pixel:PixelLocation(Human), place:GeoLocation(RMAX), attitude:Attitude(RMAX)
  to v:GeoLocation(Human)
"""
"""The eight transformations of [Introspection15 §4.3]."""


@pytest.fixture
def processes():
    registry = Processes()
    for name, base in (("gps", 100), ("imu", 0), ("rgbCam", 1000), ("irCam", 2000)):
        code = lambda time, base=base: float(base + time // SECOND)  # noqa: E731
        registry.sampled("x", "1s", name=name)(code)

    @registry.computational_unit("x", ["x"], name="attitude")
    def attitude(time, samples, state):
        return samples[0].value * 2, state

    @registry.computational_unit("x", ["x"], name="GPSto3D")
    def locate(time, samples, state, *, scale: float = 1.0):
        return samples[0]["v"] * scale, state

    @registry.computational_unit("x", ["x", "x"], name="humanDetector")
    def detect(time, samples, state):
        rgb, ir = samples
        return {"who": f"human{int(rgb['rgb']) % 2}", "v": rgb["rgb"] + ir["ir"]}, state

    @registry.computational_unit("x", ["x", "x", "x"], name="humanCoordinates")
    class Coordinates:
        def __init__(self):
            self.count = 0

        def __call__(self, time, samples, state):
            self.count += 1
            return sum(sample.value for sample in samples) + self.count / 100, state

    return registry


@pytest.fixture
def robot(processes):
    engine = Engine(epoch="test", processes=processes)
    engine.load_ontology(ONTOLOGY, name="http://example.org/robot")
    return engine


def run(engine, seconds):
    for tick in range(1, seconds * 10 + 1):
        engine.tick(tick * SECOND // 10)


def test_the_papers_example_runs(robot):
    """Sources are started, inputs synchronized, each human keeps an instance of its own."""
    robot.annotate(PAPER)
    view = robot.subscribe_to_feature("GeoLocation", sort="Human")
    assert view.adaptive.state == "running"
    assert view.adaptive.reads == ("rgbCam", "irCam", "gps", "imu")
    run(robot, 4)
    found = [(values["object"], values["GeoLocation"]) for _, values in samples(robot, view.stream)]
    # pixel 3000 + 2t, place 100 + t, attitude 2t, and how many of this human there were.
    assert found == [
        ("human0", 3100.01),
        ("human1", 3105.01),
        ("human0", 3110.02),
        ("human1", 3115.02),
    ]
    assert robot.ontology.validate().conforms
    robot.unsubscribe(view.id)
    assert not robot._parts.configuration.units


def test_sources_and_units_that_two_need_run_once(robot):
    robot.annotate(PAPER)
    robot.subscribe_to_feature("GeoLocation", sort="Human")
    before = len(robot._parts.configuration.units)
    robot.subscribe_to_feature("Attitude", objects=["self"])
    assert len(robot._parts.configuration.units) == before + 1  # the merge of the new subscription


def test_parameters_make_another_transformation(robot):
    robot.annotate("source gps provides v:GPS(self)")
    ssl = "compunit twice transforms v:GPS to v:GeoLocation"
    view = robot.transformations.register_annotated(
        ssl, implementation="GPSto3D", parameters={"scale": "2"}, cost=3, quality=0.5
    )
    assert (view.parameters, view.cost, view.quality) == ({"scale": "2"}, 3, 0.5)
    view = robot.subscribe_to_feature("GeoLocation", objects=["self"])
    run(robot, 2)
    assert [v["GeoLocation"] for _, v in samples(robot, view.stream)] == [200.0, 202.0]


@pytest.mark.parametrize(
    ("arguments", "error", "problem"),
    [
        ({"implementation": "nobody"}, UnknownFeature, "no implementation called 'nobody'"),
        ({"implementation": "gps"}, Conflict, "gps takes no input"),
        ({"implementation": "humanDetector"}, Conflict, "takes 2 inputs"),
        ({"parameters": {"size": "1"}}, BadArguments, "no parameter 'size'"),
        ({"parameters": {"scale": "big"}}, BadArguments, "'scale' must be a number, not 'big'"),
        ({"quality": 2.0}, BadArguments, "from 0 to 1"),
        ({"quality": float("nan")}, BadArguments, "from 0 to 1"),
        ({"cost": -1.0}, BadArguments, "0 or more"),
    ],
)
def test_what_does_not_fit_is_refused(robot, arguments, error, problem):
    ssl = "compunit place transforms v:GPS to v:GeoLocation"
    with pytest.raises(error, match=problem):
        robot.transformations.register_annotated(ssl, **{"implementation": "GPSto3D", **arguments})
    with pytest.raises(UnknownTransformation):
        robot.transformations.view("place")


def test_names_that_are_taken(robot):
    register = robot.transformations.register_annotated
    register("compunit GPSto3D transforms v:GPS to v:GeoLocation")
    with pytest.raises(AlreadyExists):
        register("compunit GPSto3D transforms x:IMU to v:GeoLocation")
    with pytest.raises(Refused):
        register("compunit policy transforms v:GPS to v:GeoLocation", implementation="GPSto3D")
    with pytest.raises(BadArguments):
        register("stream s contains GPS(self) = v")
    with pytest.raises(LanguageError):
        register("compunit")


def test_a_description_in_names(robot):
    robot.transformations.register_described(
        DescribedTransformation(
            "humanDetector",
            (
                DescribedPort("RGB", "rgb", None, (DescribedArgument("RMAX"),)),
                DescribedPort("dyknow:IR", "ir", None, (DescribedArgument("RMAX"),)),
            ),
            DescribedPort("PixelLocation", "v", None, (DescribedArgument("Human", id="who"),)),
        )
    )
    view = robot.transformations.view("humanDetector")
    assert view.text == "humanDetector : RGB[RMAX], IR[RMAX] ⇒ PixelLocation[Human]"
    assert view.lacks == ""
    with pytest.raises(UnknownFeature, match="no feature dyknow:UV"):
        robot.transformations.register_described(
            DescribedTransformation("x", (DescribedPort("UV"),), DescribedPort("RGB"))
        )


LISTING_3 = """
:fusionRGBIR a :Transformation ;
  :hasAnnotation [
    :hasOutputAnnotation [ :describesFeature dyknow:PixelLocation ; :describesSort dyknow:Human ] ;
    :hasInputAnnotation [
      :describesFeature dyknow:RGB ; :describesSort :self ;
      :nextSegment [
        :hasInputAnnotation [ :describesFeature dyknow:IR ; :describesSort :self ] ] ] ] ;
  :hasImplementation [ :hasName "humanDetector" ] ; :hasQuality 0.8 ; :hasCost 2 ;
  :hasName "fusionRGBIR"^^string .
"""


def test_listing_3_describes_a_transformation(robot):
    (described,) = read_transformations(LISTING_3)
    view = robot.transformations.register_described(described)
    assert view.text == "fusionRGBIR : RGB[self], IR[self] ⇒ PixelLocation[Human]"
    assert (view.implementation, view.cost, view.quality) == ("humanDetector", 2.0, 0.8)
    _, rows = robot.ontology.query_rows(
        "SELECT ?second { dyknow-o:fusionRGBIR dyknow-o:hasAnnotation/dyknow-o:hasInputAnnotation/"
        "dyknow-o:nextSegment/dyknow-o:hasInputAnnotation/dyknow-o:describesFeature ?second }"
    )
    assert rows[0][0].value.endswith("IR")


def test_registered_transformations_survive_a_restart(processes, tmp_path):
    first = Engine(tmp_path, processes=processes)
    first.load_ontology(ONTOLOGY, name="http://example.org/robot")
    first.transformations.register_annotated(
        "compunit place transforms v:GPS(RMAX as r) no_unit to v:GeoLocation(RMAX as r)",
        implementation="GPSto3D",
        parameters={"scale": "3"},
        quality=0.7,
    )
    before = first.transformations.view("place")
    del first
    gc.collect()
    again = Engine(tmp_path, processes=processes)
    assert again.transformations.view("place") == before
    del again
    gc.collect()
    without = Engine(tmp_path, processes=Processes())
    assert "no implementation called 'GPSto3D'" in without.transformations.view("place").lacks
    told = [values["change"] for _, values in samples(without, "status")]
    assert "not restored" in told


def test_a_unit_in_use_is_not_forgotten(robot):
    robot.annotate("source gps provides v:GPS(self)")
    view = robot.subscribe_to_feature("GPS", objects=["self"])
    with pytest.raises(Conflict, match="has units: dyknow_cu"):
        robot.transformations.remove("gps")
    robot.unsubscribe(view.id)
    robot.transformations.remove("gps")
    with pytest.raises(Conflict, match="is built in"):
        robot.transformations.remove("coordinatesToSpeed")


# -- what a process says of its own stream ---------------------------------------------------


def test_a_unit_reports_the_quality_of_its_stream(robot, processes):
    @processes.computational_unit("x", ["x"], name="doubtful")
    def doubtful(time, samples, state):
        value = samples[0].value
        return Report(value, quality=0.25) if value == 102 else value, state

    robot.annotate(
        "source gps provides v:GPS(self) compunit doubtful transforms v:GPS to v:GeoLocation"
    )
    view = robot.subscribe_to_feature("GeoLocation", objects=["self"])
    run(robot, 5)
    assert len(samples(robot, view.stream)) == 5
    told = [v for _, v in samples(robot, "status") if v["change"] == "quality changed"]
    assert [values["specification"] for values in told] == ["quality 0.25"]
    _, rows = robot.ontology.query_rows(
        "SELECT ?q { ?s a dyknow-o:Stream ; dyknow-o:hasQuality ?q }"
    )
    assert [row[0].value for row in rows] == ["0.25"]


def test_a_unit_reports_what_its_stream_means(robot, processes):
    @processes.computational_unit("x", ["x"], name="turning")
    def turning(time, samples, state):
        value = samples[0].value
        if value == 101:
            return Report(value, contains="Attitude(self) = v"), state
        return Report(value, contains="nonsense" if value == 100 else None), state

    robot.annotate(
        "source gps provides v:GPS(self) compunit turning transforms v:GPS to v:GeoLocation"
    )
    view = robot.subscribe_to_feature("GeoLocation", objects=["self"])
    run(robot, 3)
    assert [r.why for r in robot.rematches(view.id)][-1].endswith("means something else")
    assert robot.subscription(view.id).adaptive.state == "waiting"
    assert len(samples(robot, view.stream)) == 2
    assert "report refused" in [values["change"] for _, values in samples(robot, "status")]


def test_a_report_that_is_none_is_an_error_of_the_unit(robot, processes):
    @processes.computational_unit("x", ["x"], name="wrong", on_error="skip")
    def wrong(time, samples, state):
        return Report(1.0, quality=7), state

    robot.annotate(
        "source gps provides v:GPS(self) compunit wrong transforms v:GPS to v:GeoLocation"
    )
    view = robot.subscribe_to_feature("GeoLocation", objects=["self"])
    run(robot, 2)
    assert not samples(robot, view.stream)
    told = [v for _, v in samples(robot, "status") if v["change"] == "unit failed"]
    assert "a number from 0 to 1, not 7" in told[0]["specification"]


def test_rates_are_mirrored_for_who_asks(robot):
    robot.annotate("stream fast contains GPS(self) = v")
    feed(robot, "fast", [(i / 10, {"v": 1.0}) for i in range(100)])
    robot.measure()
    _, rows = robot.ontology.query_rows(
        "SELECT ?rate { dyknow-o:fast dyknow-o:hasRate ?rate ; dyknow-o:hasSubscriberCount 0 }"
    )
    assert [float(row[0].value) for row in rows] == [10.0]
    assert robot.ontology.validate().conforms
