"""Semantic matching with the fast strategy ([Events14 §V.C], [Introspection15 §4.3])."""

import pytest

from dyknow.languages.ssl.annotation import (
    Argument,
    Content,
    PortAnnotation,
    Role,
    StreamAnnotation,
)
from dyknow.matching.fast_search import FastSearch
from dyknow.matching.goals import COMBINED
from dyknow.matching.match import (
    MAX_DEPTH,
    Outcome,
    UnknownStrategy,
    match,
    match_all,
    render,
)
from dyknow.matching.plan import (
    Compute,
    SelectObject,
    Synchronize,
    UseStream,
    annotation_of,
    contents_of,
    nodes_of,
    streams_of,
    wanted_annotation,
)
from dyknow.matching.space import StreamDescription, StreamSpace, TransformationDescription
from dyknow.matching.strategy import Strategy
from dyknow.matching.subject import Subject
from dyknow.matching.want import Want
from dyknow.ontology.units import parse_unit
from dyknow.rdf.namespaces import DYKNOW


def iri(name):
    return None if name is None else DYKNOW + name


def want(feature, sort=None, object=None):
    return Want(iri(feature), iri(sort), iri(object))


def stream(name, fields, sort=None, object=None, id=None):
    """``fields``: "feature=field unit, …"."""
    role = Role(iri(sort), iri(object), id)
    contents = []
    for text in fields.split(", "):
        names, _, unit = text.partition(" ")
        feature, _, field = names.partition("=")
        contents.append(Content(iri(feature), field, parse_unit(unit or "no_unit"), (role,)))
    return StreamAnnotation(name, tuple(contents), "")


def port(text, sort=None):
    names, _, unit = text.partition(" ")
    feature, _, field = names.partition("=")
    arguments = () if sort is None else (Argument(sort, iri(sort)),)
    return PortAnnotation(field or feature, iri(feature), parse_unit(unit or "no_unit"), arguments)


def unit(name, inputs, output, sort=None):
    ports = tuple(port(text, sort) for text in inputs.split(", ") if text)
    return TransformationDescription(name, ports, port(output, sort))


POSITIONS = stream("positions", "latitude=lat deg, longitude=lon deg", sort="UAV", id="icao24")
TO_SPEED = unit("coordinatesToSpeed", "latitude deg, longitude deg", "speed m.s-1")


def test_scenario_of_on_demand_events_with_one_object(vocabulary):
    """[Events14 §V.C]: no speed stream, coordinates of all UAVs; the speed of uav1 is wanted."""
    space = StreamSpace((POSITIONS,), (TO_SPEED,))
    found = match(want("speed", "UAV", "uav1"), space, vocabulary)
    (source,) = found.supply.sources
    assert [type(node) for node in nodes_of(source.node)] == [UseStream, SelectObject, Compute]
    assert source.port.conversion.factor == pytest.approx(3.6)
    assert source.roles == (Role(iri("UAV"), iri("uav1"), "icao24"),)
    assert found.supply.complete
    assert streams_of(found.supply) == ("positions",)
    assert render(found) == (
        "speed of dyknow:uav1 [km.h-1]\n"
        "└─ chosen: coordinatesToSpeed : latitude, longitude ⇒ speed   (m.s-1 → km.h-1 × 3.6)\n"
        "   └─ select icao24 = uav1\n"
        "      └─ stream positions : latitude [deg], longitude [deg] for every UAV = icao24"
    )


def test_annotation_of_a_unit_keeps_the_id_field(vocabulary):
    space = StreamSpace((POSITIONS,), (TO_SPEED,))
    (source,) = match(want("speed", "UAV"), space, vocabulary).supply.sources
    made = annotation_of(source.node, "dyknow_reserved35")
    role = Role(iri("UAV"), None, "icao24")
    assert made.contents == (Content(iri("speed"), "speed", parse_unit("m.s-1"), (role,)),)
    assert made.source == (
        "stream dyknow_reserved35 contains speed(UAV) = speed [m.s-1] for every UAV = icao24"
    )


def test_annotation_of_a_unit_over_a_constant_object_is_constant(vocabulary):
    own = stream("own", "latitude=lat deg, longitude=lon deg", object="uav1")
    (source,) = match(
        want("speed", object="uav1"), StreamSpace((own,), (TO_SPEED,)), vocabulary
    ).supply.sources
    assert annotation_of(source.node, "x").contents[0].roles == (Role(None, iri("uav1"), None),)


def test_a_stream_goes_before_a_transformation(vocabulary):
    speeds = stream("speeds", "speed=spd kt", sort="UAV", id="id")
    found = match(want("speed", "UAV"), StreamSpace((POSITIONS, speeds), (TO_SPEED,)), vocabulary)
    assert isinstance(found.supply.sources[0].node, UseStream)
    assert [alternative.outcome for alternative in found.tree] == [
        Outcome.CHOSEN,
        Outcome.UNTRIED,
    ]


def test_a_complete_unit_goes_before_a_stream_of_one_object(vocabulary):
    """A stream made for uav1 alone must not answer for every UAV."""
    one = stream("dyknow_reserved1", "speed=spd kt", object="uav1")
    found = match(want("speed", "UAV"), StreamSpace((one, POSITIONS), (TO_SPEED,)), vocabulary)
    assert found.supply.complete
    assert streams_of(found.supply) == ("positions",)


def test_sub_features_serve_under_the_wanted_name(vocabulary):
    speeds = stream("speeds", "groundspeed=gs kt", sort="UAV", id="id")
    supply = match(want("speed", "UAV"), StreamSpace((speeds,)), vocabulary).supply
    assert supply.sources[0].port.feature == iri("groundspeed")
    assert wanted_annotation(supply, supply.sources[0]).contents[0].feature == iri("speed")


def test_exact_features_go_before_sub_features(vocabulary):
    both = stream("both", "groundspeed=gs kt, speed=spd kt", sort="UAV", id="id")
    supply = match(want("speed", "UAV"), StreamSpace((both,)), vocabulary).supply
    assert supply.sources[0].port.source_field == "spd"


def test_a_super_feature_does_not_serve(vocabulary):
    speeds = stream("speeds", "speed=spd kt", sort="UAV", id="id")
    found = match(want("groundspeed", "UAV"), StreamSpace((speeds,)), vocabulary)
    assert found.supply is None
    assert found.missing == ("no stream and no transformation gives dyknow:groundspeed",)


@pytest.mark.parametrize(
    ("wanted", "sort", "complete"),
    [("UAV", "Aircraft", True), ("UAV", "UAV", True), ("Aircraft", "UAV", False)],
)
def test_sorts_subsume(vocabulary, wanted, sort, complete):
    speeds = stream("speeds", "speed=spd kt", sort=sort, id="id")
    supply = match(want("speed", wanted), StreamSpace((speeds,)), vocabulary).supply
    assert supply.complete is complete


def test_streams_of_parts_serve_together(vocabulary):
    space = StreamSpace(
        (
            stream("uavs", "speed=spd kt", sort="UAV", id="id"),
            stream("cars", "speed=v m.s-1", sort="Car", id="plate"),
            stream("rmaxes", "speed=spd kt", sort="RMAX", id="id"),
            stream("one", "speed=spd kt", object="uav1"),
        )
    )
    supply = match(want("speed"), space, vocabulary).supply
    # What every UAV covers would only count twice.
    assert streams_of(supply) == ("uavs", "cars")
    assert not supply.complete


def test_constant_streams_of_known_objects_serve_their_sort(vocabulary):
    space = StreamSpace(
        (
            stream("one", "speed=spd kt", object="uav1"),
            stream("car", "speed=spd kt", object="car1"),
            stream("unknown", "speed=spd kt", object="x9"),
        )
    )
    assert streams_of(match(want("speed", "UAV"), space, vocabulary).supply) == ("one",)
    assert streams_of(match(want("speed"), space, vocabulary).supply) == ("one", "car", "unknown")


def test_a_wrong_sort_is_the_reason(vocabulary):
    cars = stream("cars", "speed=v kt", sort="Car", id="id")
    found = match(want("speed", "UAV"), StreamSpace((cars,)), vocabulary)
    assert found.missing == ("stream cars: sort dyknow:Car is not a dyknow:UAV",)
    assert render(found) == (
        "speed of every dyknow:UAV\n"
        "└─ failed: stream cars : speed [kt] for every Car = id"
        " — sort dyknow:Car is not a dyknow:UAV"
    )


def test_a_condition_stream_is_selected_from(vocabulary):
    s2 = stream("s2", "altitude=alt ft", object="uav1", id="id")
    (source,) = match(
        want("altitude", object="uav1"), StreamSpace((s2,)), vocabulary
    ).supply.sources
    assert source.node == SelectObject(UseStream("s2", s2.contents), "id", iri("uav1"))
    other = match(want("altitude", object="uav2"), StreamSpace((s2,)), vocabulary)
    assert other.missing == ("stream s2: it speaks of dyknow:uav1, not of dyknow:uav2",)


def test_an_object_that_the_ontology_does_not_know(vocabulary):
    """The sort is what the query says; else it may be in any stream."""
    space = StreamSpace((stream("flights", "speed=kt kt", sort="Aircraft", id="icao24"),))
    said = match(want("speed", "UAV", "398564"), space, vocabulary).supply
    assert said.complete
    unsaid = match(want("speed", object="398564"), space, vocabulary).supply
    assert not unsaid.complete
    assert unsaid.sources == said.sources
    assert match(want("speed", "Car", "398564"), space, vocabulary).supply is None


def test_units_that_contradict_fail_with_the_reason(vocabulary):
    wrong = unit("wrong", "latitude deg, longitude deg", "speed kg")
    found = match(want("speed", "UAV"), StreamSpace((POSITIONS,), (wrong,)), vocabulary)
    assert found.supply is None
    assert "kg" in found.missing[0]


def test_inputs_are_converted(vocabulary):
    radians = unit("r", "latitude rad, longitude deg", "speed m.s-1")
    (source,) = match(
        want("speed", "UAV"), StreamSpace((POSITIONS,), (radians,)), vocabulary
    ).supply.sources
    latitude, longitude = source.node.inputs[0].ports
    assert latitude.conversion.factor == pytest.approx(0.017453292519943295)
    assert longitude.conversion.is_identity


def test_inputs_in_different_streams_are_synchronized(vocabulary):
    space = StreamSpace(
        (
            stream("lats", "latitude=v deg", sort="UAV", id="id"),
            stream("lons", "longitude=v deg", sort="UAV", id="id"),
        ),
        (TO_SPEED,),
    )
    found = match(want("speed", "UAV"), space, vocabulary)
    assert render(found) == (
        "speed of every dyknow:UAV [km.h-1]\n"
        "└─ chosen: coordinatesToSpeed : latitude, longitude ⇒ speed   (m.s-1 → km.h-1 × 3.6)\n"
        "   └─ synchronize\n"
        "      ├─ stream lats : latitude [deg] for every UAV = id\n"
        "      └─ stream lons : longitude [deg] for every UAV = id"
    )
    (source,) = found.supply.sources
    (edge,) = source.node.inputs
    assert isinstance(edge.node, Synchronize)
    assert [c.field for c in contents_of(edge.node)] == ["latitude", "longitude"]
    assert [port.target_field for port in edge.ports] == ["latitude", "longitude"]
    assert source.roles == (Role(iri("UAV"), None, "id"),)


def test_inputs_of_different_objects_do_not_come_together(vocabulary):
    """One stream, but the latitude of one object and the longitude of another."""
    (latitude,) = stream("m", "latitude=lat deg", object="uav1").contents
    (longitude,) = stream("m", "longitude=lon deg", object="car1").contents
    mixed = StreamAnnotation("m", (latitude, longitude), "")
    found = match(want("speed"), StreamSpace((mixed,), (TO_SPEED,)), vocabulary)
    assert found.missing == ("stream m: it holds only some of the objects",)


def test_what_a_transformation_lacks_is_told(vocabulary):
    space = StreamSpace((), (unit("GPSto3D", "GPS", "GeoLocation"),))
    found = match(want("GeoLocation", "UAV"), space, vocabulary)
    assert found.missing == ("no stream and no transformation gives dyknow:GPS",)


def test_gps_to_3d_over_an_annotated_gps_stream(vocabulary):
    """[Introspection15 §4.3], the part without self and synchronization."""
    space = StreamSpace(
        (stream("gps", "GPS=fix", object="uav1"),),
        (
            unit("GPSto3D", "GPS", "GeoLocation"),
            unit("IMUGPSto3D", "GPS, IMU", "GeoLocation"),
        ),
    )
    found = match(want("GeoLocation", object="uav1"), space, vocabulary)
    (source,) = found.supply.sources
    assert source.node.transformation == "GPSto3D"
    # The other would be possible with an IMU; fast did not look.
    assert [a.outcome for a in found.tree] == [Outcome.CHOSEN, Outcome.UNTRIED]


def test_a_transformation_for_a_sort_takes_no_other_objects(vocabulary):
    detector = unit("rmaxSpeed", "altitude ft", "speed m.s-1", sort="RMAX")
    uavs = stream("uavs", "altitude=a ft", sort="UAV", id="id")
    found = match(want("speed", "UAV"), StreamSpace((uavs,), (detector,)), vocabulary)
    assert found.missing == (
        "rmaxSpeed: it is for every dyknow:RMAX, and what is wanted is for every dyknow:UAV",
    )
    rmaxes = stream("rmaxes", "altitude=a ft", sort="RMAX", id="id")
    supply = match(
        want("speed", "UAV"), StreamSpace((uavs, rmaxes), (detector,)), vocabulary
    ).supply
    assert streams_of(supply) == ("rmaxes",)
    assert not supply.complete


def test_cycles_are_excluded(vocabulary):
    there = unit("there", "speed km.h-1", "altitude ft")
    back = unit("back", "altitude ft", "speed km.h-1")
    smooth = unit("smooth", "speed km.h-1", "speed km.h-1")
    found = match(want("speed", "UAV"), StreamSpace((), (there, back, smooth)), vocabulary)
    assert found.supply is None
    assert "a feature would stand twice on the path" in render(found)


def test_an_output_does_not_overwrite_the_id_field(vocabulary):
    clash = unit("clash", "latitude deg", "speed=icao24 m.s-1")
    found = match(want("speed", "UAV"), StreamSpace((POSITIONS,), (clash,)), vocabulary)
    (source,) = found.supply.sources
    assert source.roles == (Role(iri("UAV"), None, "icao24_of"),)
    assert source.node.carried == (("icao24", "icao24_of"),)


def test_one_stream_that_serves_both_wants_is_preferred(vocabulary):
    space = StreamSpace(
        (
            stream("a", "altitude=alt ft", sort="UAV", id="id"),
            stream("b", "speed=spd kt", sort="UAV", id="id"),
            stream("both", "speed=spd kt, altitude=alt ft", sort="UAV", id="id"),
        )
    )
    wants = [want("altitude", "UAV"), want("speed", "UAV")]
    found = match_all(wants, space, vocabulary)
    assert [streams_of(m.supply) for m in found] == [("both",), ("both",)]
    assert streams_of(match(wants[0], space, vocabulary).supply) == ("a",)


def test_first_argument_of_an_n_ary_feature_is_its_object(vocabulary):
    roles = (Role(iri("UAV"), None, "id1"), Role(iri("UAV"), None, "id2"))
    s4 = StreamAnnotation("s4", (Content(iri("xydist"), "dist", parse_unit("m"), roles),), "")
    (source,) = match(want("xydist", "UAV", "uav1"), StreamSpace((s4,)), vocabulary).supply.sources
    assert source.node == SelectObject(UseStream("s4", s4.contents), "id1", iri("uav1"))
    assert source.roles[1] == roles[1]


@pytest.mark.parametrize(
    ("strategy", "problem"),
    [
        ("best", "no strategy 'best'; there is: fast, cost, quality, weighted"),
        ("fast:cost=1", "fast has no parameter 'cost'; it has: none"),
        ("cost:quality=1", "it has: subscribers"),
        ("weighted:cost=x", "cost is a number, 0 or more, not 'x'"),
        ("weighted:cost=-1", "not '-1'"),
        ("weighted:cost=inf", "not 'inf'"),
    ],
)
def test_a_strategy_that_is_not_there(vocabulary, strategy, problem):
    with pytest.raises(UnknownStrategy, match=problem):
        match(want("speed"), StreamSpace(), vocabulary, strategy)


@pytest.mark.parametrize(
    "text", ["fast", "cost", "quality", "cost:subscribers=0.1", "weighted:cost=1,quality=10"]
)
def test_a_strategy_is_the_text_it_was_read_from(text):
    assert str(Strategy.parse(text)) == text


def test_diamonds_do_not_explode(vocabulary):
    """40 levels of two ways each: 2^40 plans, none of which ends in a stream."""
    units = tuple(
        unit(f"t{level}{way}", f"f{level + 1}", f"f{level}") for level in range(40) for way in "ab"
    )
    assert match(want("f0"), StreamSpace((), units), vocabulary).supply is None
    ends = stream("end", "f40=v", sort="Thing", id="id")
    supply = match(want("f0"), StreamSpace((ends,), units), vocabulary).supply
    assert len(list(nodes_of(supply.sources[0].node))) == 41


def test_depth_is_bounded(vocabulary):
    def chain(length):
        units = tuple(unit(f"t{i}", f"f{i + 1}", f"f{i}") for i in range(length))
        space = StreamSpace((stream("end", f"f{length}=v", sort="Thing", id="id"),), units)
        return match(want("f0"), space, vocabulary)

    assert render(chain(MAX_DEPTH)).count("⇒") == MAX_DEPTH
    too_long = chain(MAX_DEPTH + 1)
    assert too_long.missing == (f"more than {MAX_DEPTH} transformations would stand on one path",)
    assert chain(20_000).supply is None


def test_one_stream_of_a_large_space_is_found(vocabulary):
    streams = tuple(
        stream(f"s{i}", f"f{i % 50}=v, speed=spd kt", object=f"o{i}") for i in range(5000)
    )
    space = StreamSpace(streams, (TO_SPEED,))
    supply = match(want("speed", object="o4711"), space, vocabulary).supply
    assert streams_of(supply) == ("s4711",)


def test_a_stream_made_for_the_sort_goes_before_a_more_general_one(vocabulary):
    sorts = (("a1", "UAV"), ("a2", "RMAX"), ("a0", "Thing"))
    space = StreamSpace(
        tuple(stream(name, "speed=spd kt", sort=sort, id="id") for name, sort in sorts)
    )
    assert streams_of(match(want("speed", "RMAX"), space, vocabulary).supply) == ("a2",)
    assert streams_of(match(want("speed", "Aircraft"), space, vocabulary).supply) == ("a0",)


def test_how_many_combinations_of_parts_are_looked_at(vocabulary, monkeypatch):
    """Twelve objects, each or as one of a sort: 4,096 of them took a second."""
    solved = []
    solve = FastSearch.solve

    def counted(search, goal):
        solved.append(goal)
        return solve(search, goal)

    monkeypatch.setattr(FastSearch, "solve", counted)
    others = tuple(Subject(None, iri(f"a{number}")) for number in range(12))
    space = StreamSpace((stream("speeds", "speed=v", sort="UAV", id="id"),))
    assert match(Want(iri("speed"), None, iri("a"), others), space, vocabulary).supply is None
    assert COMBINED / 2 < len(solved) <= COMBINED + 1


# -- sorts in place of features, and named streams -----------------------------------------------

SPEEDS = stream("speeds", "speed=spd km.h-1, altitude=alt ft", sort="UAV", id="id")
HEIGHTS = stream("heights", "altitude=alt ft", sort="RMAX", id="nr")
CARS = stream("cars", "speed=spd km.h-1", sort="Car", id="id")
ALL = stream("all", "GPS=gps", sort="Thing", id="name")
ONE = stream("one", "altitude=alt ft", object="uav1")


def sources(found):
    return [(source.node, source.roles[0].id_field) for source in found.supply.sources]


@pytest.mark.parametrize("strategy", ["fast", "cost", "quality"])
def test_a_sort_is_the_samples_of_all_streams_with_its_objects(vocabulary, strategy):
    space = StreamSpace((SPEEDS, HEIGHTS, CARS, ALL, ONE), (TO_SPEED,))
    made = StreamDescription("made", SPEEDS.contents, maker="coordinatesToSpeed")
    space.put_stream(made)
    found = match(want("UAV", "UAV"), space, vocabulary, strategy)
    assert [
        (node.stream, id_field) for node, id_field in sources(found)
    ] == [("speeds", "id"), ("heights", "nr"), ("all", "name"), ("one", None)]  # fmt: skip


def test_a_sort_of_one_object(vocabulary):
    space = StreamSpace((SPEEDS, CARS, ONE))
    found = match(want("UAV", "UAV", "uav1"), space, vocabulary)
    streams = [UseStream("speeds", SPEEDS.contents), UseStream("one", ONE.contents)]
    selected = SelectObject(streams[0], "id", iri("uav1"))
    assert [node for node, _ in sources(found)] == [selected, streams[1]]


def test_no_stream_tells_of_a_sort(vocabulary):
    found = match(want("RMAX", "RMAX"), StreamSpace((CARS,), (TO_SPEED,)), vocabulary)
    assert found.supply is None
    assert found.missing == ("stream cars: sort dyknow:Car is not a dyknow:RMAX",)


@pytest.mark.parametrize(("wanted", "id_field"), [("altitude", "nr"), ("UAV", "nr")])
def test_a_stream_may_be_named(vocabulary, wanted, id_field):
    """Neither another stream nor a transformation is taken; the others are not asked."""
    space = StreamSpace((SPEEDS, HEIGHTS), (unit("toAltitude", "GPS", "altitude ft"),))
    named = Want(iri(wanted), iri("UAV"), streams=("heights",))
    assert [(node.stream, f) for node, f in sources(match(named, space, vocabulary))] == [
        ("heights", id_field)
    ]


def test_a_named_stream_that_does_not_have_it(vocabulary):
    space = StreamSpace((SPEEDS, HEIGHTS, POSITIONS), (TO_SPEED,))
    found = match(Want(iri("speed"), iri("UAV"), streams=("positions",)), space, vocabulary)
    assert found.supply is None
    assert found.missing == (
        "stream speeds: only positions is read",
        "coordinatesToSpeed: only positions is read",
    )
    found = match(Want(iri("speed"), iri("UAV"), streams=("height",)), space, vocabulary)
    assert found.missing == ("there is no stream height with an annotation: did you mean heights?",)
