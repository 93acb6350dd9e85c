"""Specifications applied ([Introspection15 §3.2]): start, share, stop, refuse, keep."""

import gc
from dataclasses import replace

import pytest
from feeding import feed, samples
from places import TESTS
from specifying import apply, listing_processes, run, state, text, units, world

from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import Conflict, Refused
from dyknow.languages.errors import LanguageError
from dyknow.languages.specification import parse_specification
from dyknow.ontology.registrations import Registrations

CASES = TESTS / "cases" / "specification"
COORDINATES = (
    "stream coordinates contains latitude(UAV) = lat, longitude(UAV) = lon for every UAV = id"
)
SPEED = '<cu type="coordinatesToSpeed"><stream name="coordinates"/></cu>'
PLACE = '<cu name="place" type="GPSto3D"><cu type="gps"/></cu>'


def listing_1():
    return (CASES / "listing1.case").read_text().partition("\n")[2].partition("----\n")[0]


def refused(engine, insertions="", removals=""):
    """The error of a text that is refused; it changes nothing."""
    return refused_text(engine, text(insertions, removals))


def refused_text(engine, given):
    before = state(engine)
    with pytest.raises(LanguageError) as caught:
        engine.apply_specification(given)
    assert state(engine) == before
    assert caught.value.hint
    return caught.value


def at(error, given):
    """The error stands at the first ``given`` of the text."""
    return error.source[error.span.start :].startswith(given)


def types(engine):
    return [transformation for transformation, _, _, _ in units(engine)]


def ask(engine, pattern):
    variables, rows = engine.ontology.query_rows(f"SELECT * WHERE {{ {pattern} }}")
    return [
        {name: term.value.split("#")[-1] for name, term in zip(variables, row, strict=True)}
        for row in rows
    ]


def world_of(path, processes=None):
    """The next run on the same data. Oxigraph lets its folder go when nothing refers to it."""
    gc.collect()
    return Engine(path, epoch="again", processes=processes or listing_processes())


@pytest.fixture
def listing():
    return world()


# -- what is started ---------------------------------------------------------------------------


def test_listing_1_as_printed_runs(listing):
    view = listing.apply_specification(listing_1())
    assert [unit.transformation for unit in view.started] == [
        "rgbCam",
        "irCam",
        "synchronize",
        "fusionRGBIR",
        "gps",
        "GPSto3D",
        "synchronize",
        "project2Dto3D",
    ]
    assert view.named == (("result", "result"),)
    run(listing, 3)
    # Pixels 20 + 3; 1000 m are 1 km for GPSto3D, and 1000 m again for project2Dto3D.
    assert samples(listing, "result") == [
        (second, {"human": "human1", "location": 1023.0}) for second in (0.0, 1.0, 2.0)
    ]
    assert listing.ontology.validate().conforms
    assert ask(
        listing,
        "?unit dyknow-o:hasOutput dyknow-o:result ; dyknow-o:instantiationOf ?of",
    ) == [{"unit": "dyknow_cu8", "of": "project2Dto3D"}]


def test_the_mirror_of_listing_1_is_listing_2(listing):
    """Both cameras are inputs of the fusion; what brings them together is how it is done."""
    listing.apply_specification(listing_1())
    fusion = "?unit dyknow-o:instantiationOf dyknow-o:fusionRGBIR ; "
    source = "?camera dyknow-o:hasOutput ?in ; dyknow-o:instantiationOf ?of"
    found = ask(listing, f"{fusion} dyknow-o:hasInput ?in . {source}")
    assert sorted(row["of"] for row in found) == ["irCam", "rgbCam"]
    (how,) = ask(listing, f"{fusion} dyknow-o:hasSynchronization/dyknow-o:instantiationOf ?how")
    assert how["how"] == "synchronize"
    assert listing.ontology.validate().conforms


def test_matching_gives_listing_1_before_anything_runs(listing):
    text = listing.match("dyknow:GeoLocation", sort="dyknow:Human").specification
    assert types(listing) == []
    (printed,) = parse_specification(listing_1()).insertions
    assert parse_specification(text).insertions == (replace(printed, name=None),)
    view = listing.apply_specification(text)
    assert len(view.started) == 8
    again = listing.match("dyknow:GeoLocation", sort="dyknow:Human", strategy="cost")
    assert again.cost == 0
    assert listing.apply_specification(again.specification).started == ()


def test_removing_what_was_inserted_releases_its_inputs(listing):
    before = units(listing), sorted(listing._parts.configuration.streams)
    mirrored = listing._parts.manager.assertions()
    listing.apply_specification(listing_1())
    view = apply(listing, removals='<cu name="result"/>')
    assert len(view.stopped) == 8
    assert (units(listing), sorted(listing._parts.configuration.streams)) == before
    assert listing._parts.manager.assertions() == mirrored
    assert listing.ontology.registered.specifications() == ""
    assert listing.insertions() == ()


def test_each_change_is_told_with_its_own_element(listing):
    listing.apply_specification(listing_1())
    apply(listing, removals='<cu name="result"/>')
    told = [values for _, values in samples(listing, "status")]
    started = {
        v["transformation"]: v["specification"] for v in told if v["change"] == "unit started"
    }
    namespace = 'xmlns:spec="http://www.dyknow.eu/ontology#Specification"'
    assert started["gps"] == f'<spec:cu {namespace} type="gps" />'
    assert started["fusionRGBIR"] == (
        f'<spec:cu {namespace} type="fusionRGBIR">\n'
        '  <spec:cu type="rgbCam" />\n'
        '  <spec:cu type="irCam" />\n'
        "</spec:cu>"
    )
    stopped = {v["specification"] for v in told if v["change"] == "unit stopped"}
    assert stopped == {f'<spec:cu {namespace} name="result" />'}


def test_the_ontology_says_how_a_unit_was_specified(listing):
    apply(listing, PLACE)
    (found,) = ask(
        listing,
        "?unit dyknow-o:hasOutput dyknow-o:place ; "
        "dyknow-o:hasSpecification/dyknow-o:hasName ?text",
    )
    assert 'type="GPSto3D"' in found["text"]


def test_a_long_element_is_told_without_what_is_in_its_inputs(listing):
    value = "1" + "0" * 5000
    inner = f'<cu type="GPSto3D"><cu type="gps"><parameter name="scale" value="{value}"/></cu></cu>'
    with pytest.raises(LanguageError):
        apply(listing, '<cu type="nothing"/>')
    apply(listing, inner.replace("1" + "0" * 5000, "0." + "0" * 5000))
    told = [v for _, v in samples(listing, "status") if v["transformation"] == "GPSto3D"]
    assert told[-1]["specification"].count("\n") == 2
    assert len(told[-1]["specification"]) < 200


# -- which field feeds which input -------------------------------------------------------------


def test_one_stream_feeds_all_inputs_by_feature(engine):
    engine.annotate(COORDINATES)
    apply(engine, SPEED)
    assert types(engine) == ["coordinatesToSpeed"]


def test_the_same_stream_for_each_input_is_one_for_all(engine):
    engine.annotate(COORDINATES)
    apply(engine, SPEED)
    twice = SPEED.replace('<stream name="coordinates"/>', '<stream name="coordinates"/>' * 2)
    view = apply(engine, twice)
    assert view.started == ()
    assert len(engine.insertions()) == 1


def test_a_sub_feature_feeds_an_input(listing):
    listing.annotate(
        "stream a contains RGB(RMAX) = r for every RMAX = id\n"
        "stream b contains NearIR(RMAX) = n for every RMAX = id"
    )
    apply(listing, '<cu name="f" type="fusionRGBIR"><stream name="a"/><stream name="b"/></cu>')
    feed(listing, "a", [(1, {"id": "u", "r": 2.0}), (2, {"id": "v", "r": 3.0})])
    feed(listing, "b", [(3, {"id": "u", "n": 40.0})])
    listing.end("a")
    listing.end("b")
    assert [values for _, values in samples(listing, "f")] == [{"human": "human1", "pixel": 42.0}]


def test_a_stream_without_annotation_feeds_inputs_of_its_fields_names(listing):
    from dyknow.engine.model.views import StreamDeclaration
    from dyknow.streams.sample import Field, FieldType

    listing.declare(StreamDeclaration("raw", (Field("fix", FieldType.FLOAT),)))
    apply(listing, '<cu name="p" type="GPSto3D"><stream name="raw"/></cu>')
    feed(listing, "raw", [(1, {"fix": 7.0})])
    listing.end("raw")
    # Nobody says in which unit it is: as it comes.
    assert samples(listing, "p") == [(1.0, {"place": 7.0})]


def test_units_of_measurement_are_converted(listing):
    listing.annotate("stream feet contains GPS(RMAX) = f [ft] for every RMAX = id")
    apply(listing, '<cu name="p" type="GPSto3D"><stream name="feet"/></cu>')
    feed(listing, "feet", [(1, {"id": "u", "f": 1000.0})])
    listing.end("feet")
    ((_, values),) = samples(listing, "p")
    assert values == {"id": "u", "place": pytest.approx(0.3048)}


# -- transformations of the system -------------------------------------------------------------


def test_select_object(engine):
    engine.annotate(COORDINATES)
    view = apply(
        engine,
        '<cu name="one" type="selectObject"><parameter name="field" value="id"/>'
        '<parameter name="object" value="dyknow:uav1"/><stream name="coordinates"/></cu>',
    )
    assert [unit.transformation for unit in view.started] == ["selectObject"]
    rows = [
        (1, {"id": "uav1", "lat": 1.0, "lon": 2.0}),
        (2, {"id": "uav2", "lat": 3.0, "lon": 4.0}),
    ]
    feed(engine, "coordinates", rows)
    assert [values["id"] for _, values in samples(engine, "one")] == ["uav1"]


def test_synchronize(listing):
    listing.annotate(
        "stream a contains RGB(RMAX) = x for every RMAX = id\n"
        "stream b contains IR(RMAX) = x for every RMAX = id"
    )
    apply(listing, '<cu name="both" type="synchronize"><stream name="a"/><stream name="b"/></cu>')
    feed(listing, "a", [(1, {"id": "u", "x": 2.0})])
    feed(listing, "b", [(2, {"id": "u", "x": 3.0})])
    listing.end("a")
    listing.end("b")
    assert samples(listing, "both") == [(2.0, {"x": 2.0, "x_2": 3.0, "id": "u"})]
    # And what it brings together feeds a unit.
    apply(listing, '<cu name="f" type="fusionRGBIR"><stream name="both"/></cu>')
    assert types(listing) == ["synchronize", "fusionRGBIR"]
    before = state(listing)
    listing.apply_specification(listing.current_specification())
    assert state(listing) == before


def test_policy(engine):
    engine.annotate("stream speeds contains speed(UAV) = spd for every UAV = id")
    made = (
        '<cu name="seldom" type="policy"><parameter name="policy" value="any change"/>'
        '<stream name="speeds"/></cu>'
    )
    apply(engine, made)
    # Both hold for each object by itself; a subscription of an earlier version does not.
    assert engine.subscribe("speeds", "any change", keyed=False).stream != "seldom"
    engine.unsubscribe("subscription1")
    subscription = engine.subscribe("speeds", "any change")
    assert subscription.stream == "seldom"
    feed(engine, "speeds", [(t, {"id": "u", "spd": float(t // 3)}) for t in range(1, 7)])
    # `any change` compares values and valid times.
    assert len(samples(engine, "seldom")) == 6
    assert "subscription2" in refused(engine, removals='<cu name="seldom"/>').message
    engine.unsubscribe(subscription.id)
    apply(engine, removals='<cu type="policy"/>')
    assert types(engine) == []


def test_a_unit_reads_what_a_policy_leaves(engine):
    engine.annotate(COORDINATES)
    adapted = (
        '<cu type="policy"><parameter name="policy" value="strict order"/>'
        '<stream name="coordinates"/></cu>'
    )
    apply(engine, f'<cu name="speed" type="coordinatesToSpeed">{adapted}</cu>')
    assert types(engine) == ["policy", "coordinatesToSpeed"]
    before = state(engine)
    engine.apply_specification(engine.current_specification())
    assert state(engine) == before


# -- parameters --------------------------------------------------------------------------------


def test_parameters_override_those_of_the_transformation(listing):
    scaled = '<cu type="gps"><parameter name="scale" value="2"/></cu>'
    apply(listing, f'<cu name="far" type="GPSto3D">{scaled}</cu>{PLACE}')
    run(listing, 1)
    assert samples(listing, "far") == [(0.0, {"place": 2.0})]
    assert samples(listing, "place") == [(0.0, {"place": 1.0})]
    # A transformation with other parameters is another; with its own it is the same.
    assert types(listing).count("gps") == 2
    view = apply(listing, '<cu type="gps"><parameter name="scale" value="1.0"/></cu>')
    assert view.started == ()


# -- names -------------------------------------------------------------------------------------


def test_a_stream_is_read_by_name_before_it_is_written(listing):
    reader = '<cu name="moved" type="GPSto3D"><stream name="fixes"/></cu>'
    apply(listing, f'{reader}<cu name="fixes" type="gps"/>')
    run(listing, 1)
    assert samples(listing, "moved")
    assert types(listing) == ["gps", "GPSto3D"]


def test_a_unit_that_runs_gets_a_further_name(listing):
    apply(listing, '<cu type="gps"/>')
    view = apply(listing, '<cu name="fixes" type="gps"/>')
    assert view.started == ()
    assert view.named == (("fixes", "dyknow_reserved1"),)
    run(listing, 1)
    assert samples(listing, "fixes")
    assert ask(listing, '?s dyknow-o:hasAlias "fixes"') == [{"s": "dyknow_reserved1"}]
    assert len(listing.insertions()) == 1
    apply(listing, removals='<cu name="fixes"/>')
    assert not listing._parts.configuration.has("fixes")
    assert ask(listing, "?s dyknow-o:hasAlias ?name") == []


def test_a_unit_may_have_several_names(listing):
    apply(listing, '<cu name="a" type="gps"/><cu name="b" type="gps"/>')
    assert types(listing) == ["gps"]
    error = refused(listing, removals='<cu name="a"/>')
    assert error.message == "`a` is needed by insertion `b`"
    current = listing.current_specification()
    other = world()
    other.apply_specification(current)
    assert other.current_specification() == current
    apply(listing, removals='<cu name="a"/><cu name="b"/>')
    assert types(listing) == []


def test_an_invented_name_only_ties_a_text_together(listing):
    apply(
        listing,
        '<cu name="dyknow_reserved7" type="gps"/>'
        '<cu type="GPSto3D"><stream name="dyknow_reserved7"/></cu>',
    )
    assert [output for _, _, output, _ in units(listing)] == [
        "dyknow_reserved1",
        "dyknow_reserved2",
    ]


def test_a_result_is_replaced_in_one_text(listing):
    apply(listing, '<cu name="result" type="gps"/>')
    view = apply(listing, '<cu name="result" type="rgbCam"/>', '<cu name="result"/>')
    assert [unit.transformation for unit in view.stopped] == ["gps"]
    assert types(listing) == ["rgbCam"]
    run(listing, 1)
    assert samples(listing, "result") == [(0.0, {"picture": 20.0})]
    assert parse_specification(listing.current_specification()).insertions[0].name == "result"


def test_what_is_removed_and_inserted_the_same_begins_anew(listing):
    apply(listing, PLACE)
    run(listing, 1)
    view = apply(listing, PLACE, '<cu name="place"/>')
    assert [unit.transformation for unit in view.started] == ["GPSto3D"]
    assert [unit.name for unit in view.stopped] == ["dyknow_cu2"]  # what it read goes on
    assert samples(listing, "place") == []
    assert len(listing.insertions()) == 1


def test_a_result_is_replaced_by_one_that_is_made_from_the_same(listing):
    apply(listing, '<cu name="result" type="gps"/>')
    apply(listing, PLACE.replace("place", "result"), '<cu name="result"/>')
    assert types(listing) == ["gps", "GPSto3D"]
    run(listing, 1)
    assert samples(listing, "result") == [(0.0, {"place": 1.0})]


# -- sharing -----------------------------------------------------------------------------------


def test_matching_shares_what_was_inserted(engine, high_speed):
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    apply(engine, SPEED)
    view = engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"))
    assert types(engine) == ["coordinatesToSpeed", "cSparql"]
    error = refused(engine, removals='<cu type="coordinatesToSpeed"/>')
    assert error.message == f"`dyknow_reserved1` is needed by {view.id}"
    assert at(error, '<cu type="coordinatesToSpeed"/></removals>')
    engine.cancel_event(view.id)
    assert types(engine) == ["coordinatesToSpeed"]
    apply(engine, removals='<cu type="coordinatesToSpeed"/>')
    assert types(engine) == []


def test_a_specification_shares_what_matching_made(engine, high_speed):
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    view = engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"))
    assert apply(engine, SPEED).started == ()
    engine.cancel_event(view.id)
    assert types(engine) == ["coordinatesToSpeed"]


@pytest.mark.parametrize("object", ["dyknow:uav1", "uav1"])
def test_a_selection_is_shared_with_that_of_matching(engine, high_speed, object):
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(dyknow:uav1, dyknow:UAV, 9)"))
    before = types(engine)
    selected = (
        '<cu type="selectObject"><parameter name="field" value="id"/>'
        f'<parameter name="object" value="{object}"/><stream name="coordinates"/></cu>'
    )
    view = apply(engine, f'<cu type="coordinatesToSpeed">{selected}</cu>')
    assert (view.started, types(engine)) == ((), before)


FUSION = '<cu type="fusionRGBIR"><cu type="rgbCam"/><cu type="irCam"/></cu>'


def test_the_nodes_are_those_of_matching(listing):
    """Sources, and inputs that are synchronized as a matter of course."""
    listing.subscribe_to_feature("PixelLocation", sort="Human")
    before = types(listing)
    assert before == ["merge", "rgbCam", "irCam", "synchronize", "fusionRGBIR"]
    assert apply(listing, FUSION).started == ()
    assert types(listing) == before
    listing.unsubscribe("subscription1")
    assert types(listing) == before[1:]
    listing.subscribe_to_feature("PixelLocation", sort="Human")
    assert types(listing) == [*before[1:], "merge"]
    message = refused(listing, removals='<cu type="fusionRGBIR"/>').message
    assert message == "`dyknow_reserved5` is needed by subscription2"
    # Nor may what it is made from go.
    message = refused(listing, removals='<cu type="irCam"/>').message
    assert message == "`dyknow_reserved3` is needed by insertion `dyknow_reserved5`, subscription2"


# -- what is refused, and where ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("insertions", "place", "message", "hint"),
    [
        (
            '<cu type="gsp"/>',
            '<cu type="gsp"/>',
            "there is no transformation called `gsp`",
            "did you mean gps",
        ),
        (
            '<cu type="GPSto3D"/>',
            '<cu type="GPSto3D"/>',
            "`GPSto3D` takes 1 input, and has none here",
            "fix (dyknow:GPS)",
        ),
        (
            '<cu type="fusionRGBIR"><cu type="rgbCam"/><cu type="irCam"/><cu type="gps"/></cu>',
            '<cu type="fusionRGBIR">',
            "`fusionRGBIR` takes 2 inputs, and has 3 here",
            "in order: rgb (dyknow:RGB), ir (dyknow:IR); or a single one",
        ),
        (
            '<cu type="gps"><cu type="rgbCam"/></cu>',
            '<cu type="gps">',
            "`gps` is a source and has no inputs",
            "leave its inputs out",
        ),
        (
            '<cu type="fusionRGBIR"><cu type="irCam"/><cu type="rgbCam"/></cu>',
            '<cu type="irCam"/>',
            "it contains no dyknow:RGB, which input `rgb` needs",
            "it contains dyknow:IR; its fields are picture",
        ),
        (
            '<cu type="fusionRGBIR"><cu type="rgbCam"/></cu>',
            '<cu type="rgbCam"/>',
            "it contains no dyknow:IR, which input `ir` needs",
            "its fields are picture",
        ),
        (
            '<cu type="GPSto3D"><stream name="posision"/></cu>',
            '<stream name="posision"/>',
            "there is no stream called `posision`, nor a `cu` of that name here",
            "did you mean position?",
        ),
        (
            '<cu type="GPSto3D"><stream name="hot"/></cu>',
            '<stream name="hot"/>',
            "input `fix` cannot be fed by `t`: K measures [temperature], but km measures [length]",
            "annotate",
        ),
        (
            '<cu name="a" type="GPSto3D"><stream name="b"/></cu>'
            '<cu name="b" type="GPSto3D"><cu type="GPSto3D"><stream name="a"/></cu></cu>',
            '<stream name="a"/>',
            "units read each other in a circle: `a` reads `b` reads `GPSto3D` reads `a`",
            "without it",
        ),
        (
            '<cu name="a" type="GPSto3D"><stream name="a"/></cu>',
            '<stream name="a"/>',
            "units read each other in a circle: `a` reads `a`",
            "without it",
        ),
        (
            '<cu name="position" type="gps"/>',
            '<cu name="position" type="gps"/>',
            "there is a stream called `position` already",
            "choose another name",
        ),
        (
            '<cu name="status" type="gps"/>',
            '<cu name="status" type="gps"/>',
            "there is a stream called `status` already",
            "choose another name",
        ),
        (
            '<cu name="dyknow_x" type="gps"/>',
            '<cu name="dyknow_x" type="gps"/>',
            "the system uses the name 'dyknow_x'",
            "choose another name",
        ),
        (
            '<cu type="gps"><parameter name="scale" value="wide"/></cu>',
            '<parameter name="scale" value="wide"/>',
            "no unit can be made of `gps`: parameter 'scale' must be a number, not 'wide'",
            "",
        ),
        (
            '<cu type="gps"><parameter name="scale" value="2"/><parameter name="x" value=""/></cu>',
            '<parameter name="x" value=""/>',
            "no unit can be made of `gps`: there is no parameter 'x'",
            "its parameters are: scale",
        ),
        (
            '<cu type="selectObject"><stream name="position"/></cu>',
            '<cu type="selectObject">',
            "`selectObject` has no `field`",
            '<spec:parameter name="field"',
        ),
        (
            '<cu type="selectObject"><parameter name="field" value="x"/>'
            '<parameter name="object" value="uav1"/><stream name="position"/></cu>',
            '<cu type="selectObject">',
            "its input has no field `x`",
            "its fields are id, p",
        ),
        (
            '<cu type="selectObject"><parameter name="field" value="p"/>'
            '<parameter name="object" value="uav1"/><stream name="position"/></cu>',
            '<cu type="selectObject">',
            "field `p` is a float and cannot name objects",
            "string or an integer",
        ),
        (
            '<cu type="selectObject"><parameter name="field" value="id"/>'
            '<parameter name="object" value="no name"/><stream name="position"/></cu>',
            '<parameter name="object" value="no name"/>',
            "`object`: ",
            "",
        ),
        (
            '<cu type="synchronize"><stream name="position"/></cu>',
            '<cu type="synchronize">',
            "`synchronize` has fewer than two different inputs here",
            "two or more",
        ),
        (
            '<cu type="policy"><parameter name="policy" value="any chance"/>'
            '<stream name="position"/></cu>',
            '<parameter name="policy" value="any chance"/>',
            "column 5 of the policy",
            "",
        ),
        (
            '<cu type="policy"><parameter name="policy" value=" "/><stream name="position"/></cu>',
            '<parameter name="policy" value=" "/>',
            "the policy has no constraint",
            "any change",
        ),
        (
            '<cu type="policy"><parameter name="policy" value="any change"/></cu>',
            '<cu type="policy">',
            "`policy` takes 1 input, and has none here",
            "one `cu` or `stream`",
        ),
        (
            '<cu type="policy"><parameter name="x" value=""/><stream name="position"/></cu>',
            '<parameter name="x" value=""/>',
            "`policy` has no parameter `x`",
            "its parameters are: policy",
        ),
    ],
)
def test_what_is_refused(listing, insertions, place, message, hint):
    listing.annotate(
        "stream position contains GPS(RMAX) = p for every RMAX = id\n"
        "stream hot contains GPS(self) = t"
    )
    hot = listing._parts.manager.annotations["hot"]
    from dataclasses import replace

    from dyknow.ontology.units import parse_unit

    contents = tuple(replace(content, unit=parse_unit("K")) for content in hot.contents)
    listing._parts.manager.annotations["hot"] = replace(hot, contents=contents)
    # What is right before it and behind it takes no effect either.
    error = refused(listing, f'<cu name="before" type="gps"/>\n  {insertions}\n<cu type="irCam"/>')
    assert message in error.message
    assert hint in error.hint
    assert at(error, place)
    assert error.line in (3, 2)


def test_what_speaks_of_one_and_of_two_objects_is_not_brought_together(engine):
    engine.annotate(
        "stream a contains speed(UAV) = s for every UAV = id\n"
        "stream b contains distance(UAV, Car) = d for every UAV = u, every Car = c"
    )
    both = '<cu type="synchronize"><stream name="a"/><stream name="b"/></cu>'
    assert "those of others about several" in refused(engine, both).message


def test_a_row_of_units_is_bounded(engine):
    engine.annotate("stream s contains speed(UAV) = v for every UAV = id")
    policy = '<cu name="n{}" type="policy"><parameter name="policy" value="strict order"/>{}</cu>'
    row = [policy.format(0, '<stream name="s"/>')]
    row += [policy.format(i, f'<stream name="n{i - 1}"/>') for i in range(1, 3000)]
    error = refused(engine, "\n".join(reversed(row)))
    assert error.message == "a chain of more than 90 units read each other here"
    apply(engine, "".join(row[:90]))
    assert len(types(engine)) == 90
    assert "a chain of more" in refused(engine, policy.format("x", '<stream name="n89"/>')).message
    before = state(engine)
    engine.apply_specification(engine.current_specification())
    assert state(engine) == before


def twice(level):
    """A unit that reads the one before it on two ways; nothing has a name of its own."""
    before = f'<stream name="dyknow_reserved{level}"/>'
    ways = "".join(f'<cu type="{way}">{before}</cu>' for way in ("up", "down"))
    return f'<cu name="dyknow_reserved{level + 1}" type="mix">{ways}</cu>'


def test_what_is_read_twice_costs_what_it_is_long(tmp_path):
    """Written in full the units would be 2^25 elements."""
    processes = listing_processes()
    for name, inputs in (("up", 1), ("down", 1), ("mix", 2)):
        processes.computational_unit("float", ["float"] * inputs, name=name)(
            lambda time, samples, state: (samples[0].value, state)
        )
    engine = world(tmp_path, processes)
    engine.annotate(
        "compunit up transforms fix:GPS to high:GPS\n"
        "compunit down transforms fix:GPS to low:GPS\n"
        "compunit mix transforms a:GPS, b:GPS to fix:GPS"
    )
    rows = '<cu name="dyknow_reserved0" type="gps"/>' + "".join(map(twice, range(25)))
    apply(engine, rows)
    assert len(types(engine)) == 1 + 25 * 4
    current = engine.current_specification()
    before = state(engine)
    engine.apply_specification(current)
    assert state(engine) == before
    kept = types(engine)
    del engine
    engine = world_of(tmp_path, processes)
    assert sorted(types(engine)) == sorted(kept)
    run(engine, 1)
    last = list(engine._parts.configuration.units)[-1]
    assert samples(engine, last) == [(0.0, {"fix": 1000.0})]


def test_what_has_failed_is_not_shared(listing):
    apply(listing, PLACE)
    unit = listing._parts.configuration.units["place"]
    unit.cut_off("out of order")
    assert "or failed:\n  dyknow_cu2 (GPSto3D) has failed -->" in listing.current_specification()
    assert listing.insertions()[0].failure == "out of order"
    error = refused(listing, '<cu type="GPSto3D"><stream name="place"/></cu>')
    assert error.message == "stream `place` gets no more samples: out of order"
    assert "already" in refused(listing, PLACE).message
    view = apply(listing, PLACE, '<cu name="place"/>')
    assert [unit.transformation for unit in view.started] == ["GPSto3D"]
    run(listing, 1)
    assert samples(listing, "place")


# -- removals ----------------------------------------------------------------------------------


def test_what_an_insertion_reads_is_not_removed(listing):
    apply(listing, '<cu name="place" type="GPSto3D"><cu name="fixes" type="gps"/></cu>')
    for removal in ('<cu name="fixes"/>', '<cu type="gps"/>', '<cu name="dyknow_cu1"/>'):
        error = refused(listing, removals=f'<cu name="place"/>{removal}'.replace("place", "none"))
        assert error.message == "there is no unit called `none`"
        error = refused(listing, '<cu type="irCam"/>', removal)
        assert error.message.endswith("is needed by insertion `place`")
        assert at(error, removal)
    apply(listing, removals='<cu type="gps"/><cu name="place"/>')
    assert types(listing) == []


def test_a_removal_by_type_is_of_insertions_only(engine, high_speed):
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"))
    error = refused(engine, removals='<cu type="coordinatesToSpeed"/>')
    assert error.message == "no specification inserted a unit of `coordinatesToSpeed`"
    error = refused(engine, removals='<cu name="dyknow_cu1"/>')
    assert error.message == "no specification inserted `dyknow_cu1`"
    assert "no unit of `gps`" in refused(engine, removals='<cu type="gps"/>').message


def test_what_another_insertion_reads_stays(listing):
    apply(listing, '<cu name="place" type="GPSto3D"><cu name="fixes" type="gps"/></cu>')
    apply(
        listing,
        '<cu name="other" type="GPSto3D"><parameter name="offset" value="1"/>'
        '<stream name="fixes"/></cu>',
    )
    view = apply(listing, removals='<cu name="place"/>')
    assert [unit.output for unit in view.stopped] == ["place"]
    run(listing, 1)
    assert samples(listing, "other") == [(0.0, {"place": 2.0})]
    assert samples(listing, "fixes")


def test_a_subscription_to_a_stream_as_it_is_needs_it(listing):
    apply(listing, '<cu name="place" type="GPSto3D"><cu name="fixes" type="gps"/></cu>')
    listing.subscribe("fixes")
    error = refused(listing, removals='<cu name="place"/>')
    assert error.message == "`place` is needed by subscription1"
    listing.unsubscribe("subscription1")
    apply(listing, removals='<cu name="place"/>')


def test_a_stream_that_is_removed_is_not_read(listing):
    apply(listing, PLACE)
    error = refused(listing, '<cu type="GPSto3D"><stream name="place"/></cu>', '<cu name="place"/>')
    assert error.message == "stream `place` is removed by this text"
    assert at(error, '<stream name="place"/>')


# -- one change or none ------------------------------------------------------------------------


UNITS = 8  # of Listing 1: a camera runs already, and `new` needs another


@pytest.mark.parametrize("fails_at", range(UNITS + 1))
def test_a_start_that_fails_half_way_is_undone(listing, monkeypatch, fails_at):
    apply(listing, '<cu name="result" type="gps"/><cu name="old" type="irCam"/>')
    run(listing, 2)
    before = state(listing)
    made = listing._parts.plans._build
    count = 0

    def fail(node, since):
        nonlocal count
        count += 1
        if count > fails_at:
            raise RuntimeError("no more units")
        return made(node, since)

    monkeypatch.setattr(listing._parts.plans, "_build", fail)
    insertions = listing_1().partition("<spec:insertions>")[2].partition("</spec:insertions>")[0]
    given = text(
        insertions.replace("spec:", "") + '<cu name="new" type="irCam"/>',
        '<cu name="result"/><cu name="old"/>',
    )
    if fails_at >= UNITS:
        listing.apply_specification(given)
        return
    with pytest.raises(RuntimeError, match="no more units"):
        listing.apply_specification(given)
    # But for what was told: that units started and stopped.
    assert state(listing)[:-1] == before[:-1]
    told = [v["change"] for _, v in samples(listing, "status")]
    assert told.count("unit started") - told.count("unit stopped") == 2
    run(listing, 1, start=2)
    assert len(samples(listing, "result")) == 3


def test_a_store_that_fails_leaves_everything(listing, monkeypatch):
    apply(listing, PLACE)
    before = state(listing)

    def fail(*_):
        raise OSError("no space left")

    monkeypatch.setattr(Registrations, "set_specifications", fail)
    with pytest.raises(OSError, match="no space left"):
        apply(listing, '<cu name="fixes" type="gps"/><cu type="irCam"/>', '<cu name="place"/>')
    assert state(listing)[:-1] == before[:-1]


def test_the_mirror_sees_one_change(listing, monkeypatch):
    changes = []
    mirror = listing.ontology.mirror
    monkeypatch.setattr(
        listing.ontology, "mirror", lambda *given: (changes.append(given), mirror(*given))
    )
    listing.apply_specification(listing_1())
    assert len(changes) == 1
    apply(listing, PLACE, '<cu name="result"/>')
    assert len(changes) == 2


# -- over a restart ----------------------------------------------------------------------------


def test_insertions_survive_a_restart(tmp_path):
    engine = world(tmp_path)
    engine.apply_specification(listing_1())
    apply(
        engine,
        '<cu name="log" type="GPSto3D"><stream name="fixes"/></cu>'
        '<cu name="fixes" type="gps"><parameter name="scale" value="3"/></cu>',
    )
    current = engine.current_specification()
    del engine
    engine = world_of(tmp_path)
    assert engine.current_specification() == current
    run(engine, 1)
    assert samples(engine, "log") == [(0.0, {"place": 3.0})]
    apply(engine, removals='<cu name="result"/><cu name="log"/><cu name="fixes"/>')
    del engine
    engine = world_of(tmp_path)
    assert types(engine) == []


def test_what_another_reads_survives_without_the_insertion_that_had_it(tmp_path):
    engine = world(tmp_path)
    apply(engine, '<cu name="place" type="GPSto3D"><cu name="fixes" type="gps"/></cu>')
    apply(
        engine,
        '<cu name="other" type="GPSto3D"><parameter name="offset" value="1"/>'
        '<stream name="fixes"/></cu>',
    )
    apply(engine, removals='<cu name="place"/>')
    del engine
    engine = world_of(tmp_path)
    assert [unit[2] for unit in units(engine)] == ["fixes", "other"]


def test_what_does_not_hold_any_more_is_told_and_kept(tmp_path):
    engine = world(tmp_path)
    apply(
        engine,
        f"{PLACE}{FUSION}"
        '<cu name="more" type="policy"><parameter name="policy" value="any change"/>'
        '<stream name="place"/></cu>',
    )
    del engine
    poorer = listing_processes()
    poorer.remove("GPSto3D")
    engine = world_of(tmp_path, poorer)
    assert types(engine) == ["rgbCam", "irCam", "synchronize", "fusionRGBIR"]
    lost = [view for view in engine.insertions() if view.stream is None]
    assert [view.name for view in lost] == ["place", "more"]
    assert "there is no transformation called `GPSto3D`" in lost[0].failure
    assert "there is no stream called `place`" in lost[1].failure
    told = [
        v["specification"] for _, v in samples(engine, "status") if v["change"] == "not restored"
    ]
    assert any('name="place" type="GPSto3D"' in reason for reason in told)
    # It is there again with its code, and with what was inserted meanwhile.
    apply(engine, '<cu name="infrared" type="irCam"/>')
    del engine
    engine = world_of(tmp_path)
    assert sorted(types(engine)) == sorted(
        ["rgbCam", "irCam", "synchronize", "fusionRGBIR", "gps", "GPSto3D", "policy"]
    )
    assert all(view.stream for view in engine.insertions())


def test_the_engine_starts_without_what_fails(tmp_path, monkeypatch):
    engine = world(tmp_path)
    apply(engine, PLACE)
    del engine

    def fail(*_):
        raise RuntimeError("no more units")

    with monkeypatch.context() as patched:
        patched.setattr("dyknow.engine.planning.plan_execution.Plans._build", fail)
        engine = world_of(tmp_path)
        assert [view.failure for view in engine.insertions()] == ["RuntimeError: no more units"]
    # Whoever fails to remove it has not forgotten it.
    monkeypatch.setattr(Registrations, "set_specifications", fail)
    with pytest.raises(RuntimeError):
        apply(engine, removals='<cu name="place"/>')
    assert len(engine.insertions()) == 1
    monkeypatch.undo()
    del engine
    assert types(world_of(tmp_path)) == ["gps", "GPSto3D"]


def test_what_was_not_restored_can_be_removed_or_replaced(tmp_path):
    engine = world(tmp_path)
    apply(
        engine,
        '<cu name="a" type="GPSto3D"><cu name="inner" type="gps"/></cu>'
        '<cu name="b" type="GPSto3D"><stream name="inner"/>'
        '<parameter name="offset" value="1"/></cu>'
        '<cu name="c" type="GPSto3D"><stream name="inner"/>'
        '<parameter name="offset" value="2"/></cu>',
    )
    del engine
    poorer = listing_processes()
    poorer.remove("GPSto3D")
    engine = world_of(tmp_path, poorer)
    assert [view.name for view in engine.insertions()] == ["a", "b", "c"]
    apply(engine, '<cu name="inner" type="irCam"/><cu name="c" type="rgbCam"/>', '<cu name="b"/>')
    assert {view.name for view in engine.insertions()} == {"a", "inner", "c"}
    del engine
    engine = world_of(tmp_path)
    assert [view.name for view in engine.insertions() if view.stream] == ["inner", "c"]
    apply(engine, removals='<cu type="GPSto3D"/>')
    assert {view.name for view in engine.insertions()} == {"inner", "c"}


def test_an_invented_name_of_an_earlier_run_means_nothing(tmp_path, high_speed):
    engine = world(tmp_path)
    engine.annotate(COORDINATES)
    engine.register_template(high_speed)
    view = engine.request_event(engine.parse_request("dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"))
    apply(
        engine,
        '<cu name="seldom" type="policy"><parameter name="policy" value="any change"/>'
        f'<stream name="{view.stream}"/></cu>',
    )
    assert f'<spec:stream name="{view.stream}" />' in engine.current_specification()
    assert "(cSparql) makes" in engine.current_specification()
    del engine
    engine = world_of(tmp_path)
    (lost,) = engine.insertions()
    assert f"there is no stream called `{view.stream}`" in lost.failure


# -- with everything else ----------------------------------------------------------------------


def test_a_named_stream_is_the_systems(listing):
    apply(listing, PLACE)
    with pytest.raises(Refused, match="a specification made"):
        listing.annotate("stream place contains speed(UAV) = place for every UAV = id")
    with pytest.raises(Refused, match="made by the system"):
        listing.add_kpl("source float place")
    with pytest.raises(Conflict, match="has units: "):
        listing.transformations.remove("GPSto3D")


def test_a_declared_stream_that_is_read_stays(engine):
    engine.annotate(COORDINATES)
    apply(engine, SPEED)
    with pytest.raises(Conflict, match="is read by insertion `dyknow_reserved1`"):
        engine.remove_stream("coordinates")


def test_kpl_streams_can_be_read(engine):
    engine.add_kpl("source float f\nstrmgen n = f\nstream s = n with any change")
    apply(
        engine,
        '<cu name="x" type="policy"><parameter name="policy" value="strict order"/>'
        '<stream name="s"/></cu>',
    )
    feed(engine, "f", [(1, {"value": 2.0})])
    assert samples(engine, "x") == [(1.0, {"value": 2.0})]
    assert "dyknow_cu1 (policy) makes s" in engine.current_specification()
    # KPL looks for units that read its streams, and a policy's is none to it.
    engine.remove_kpl("s")
    assert "dyknow_cu2 (policy) has failed" in engine.current_specification()
    assert engine.insertions()[0].failure
    assert 'type="policy"' in engine.ontology.registered.specifications()
    apply(
        engine,
        '<cu name="x" type="policy"><parameter name="policy" value="any change"/>'
        '<stream name="f"/></cu>',
        '<cu name="x"/>',
    )
    assert types(engine) == ["policy"]


def test_a_waiting_subscription_takes_what_is_inserted(listing):
    listing.transformations.change("GPSto3D", cost=5.0)
    subscription = listing.subscribe_to_feature("speed", sort="UAV")
    listing.annotate(COORDINATES)
    apply(listing, SPEED)
    assert listing.subscription(subscription.id).adaptive.state == "running"


@pytest.mark.parametrize("strategy", ["fast", "cost", "quality"])
def test_a_unit_with_parameters_of_its_own_is_not_what_matching_gives(strategy):
    """Others get the transformation as it was registered."""
    engine = world()
    apply(engine, '<cu name="far" type="gps"><parameter name="scale" value="2"/></cu>')
    stream = engine.subscribe_to_feature("GPS", sort="Thing", strategy=strategy).stream
    run(engine, 3)
    values = [next(reversed(values.values())) for *_, values in samples(engine, stream)]
    assert values == [1000, 1000, 1000]
