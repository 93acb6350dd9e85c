"""Text, JSON and Turtle of an annotation are one thing (SPEC §3): each is read back from each."""

from __future__ import annotations

import json

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from dyknow.engine.catalog.annotation_turtle import format_annotations
from dyknow.engine.catalog.iri_annotations import Describer
from dyknow.engine.catalog.transformation_turtle import read_annotations
from dyknow.engine.engine import Engine
from dyknow.engine.model.errors import BadArguments
from dyknow.languages.ssl import (
    Content,
    Role,
    SourceAnnotation,
    StreamAnnotation,
    TransformationAnnotation,
    check_ssl,
    parse_ssl,
)
from dyknow.languages.ssl.annotation_text import format_annotation
from dyknow.ontology.units import parse_unit
from dyknow.rdf.namespaces import DYKNOW
from dyknow.service.models import AnnotationModel, ContentsIn

FLEET = "http://example.org/fleet#"
VOCABULARY = Engine(epoch="law").ontology.vocabulary
SORTS = [DYKNOW + name for name in ("UAV", "Car", "Thing")]
OBJECTS = [DYKNOW + "uav1", DYKNOW + "398564", DYKNOW + "self", FLEET + "uav1", FLEET + "ä(b)"]
FIELDS = ["a", "b", "id", "every", "alt (ft)", "ä"]
UNITS = {"speed": ["km.h-1", "m.s-1"], "altitude": ["ft", "m"], "onGround": ["no_unit"]}
UNITS |= {"distance": ["m"]}

fields = st.sampled_from(FIELDS)
roles = st.builds(Role, st.sampled_from(SORTS), st.none(), fields) | st.builds(
    Role, st.none(), st.sampled_from(OBJECTS), st.none() | fields
)


@st.composite
def contents(draw: st.DrawFn) -> Content:
    feature = draw(st.sampled_from(sorted(UNITS)))
    arity = draw(st.integers(0, 3)) if feature == "distance" else 1
    named = draw(
        st.lists(roles, min_size=arity, max_size=arity, unique_by=lambda role: role.id_field)
        if arity > 1
        else st.lists(roles, min_size=arity, max_size=arity)
    )
    unit = parse_unit(draw(st.sampled_from(UNITS[feature])))
    return Content(DYKNOW + feature, draw(fields), unit, tuple(named))


streams = st.builds(
    StreamAnnotation,
    st.just("s"),
    st.lists(contents(), min_size=1, max_size=4, unique_by=lambda c: (c.feature, c.roles)).map(
        tuple
    ),
    st.just(""),
)


def read_text(text: str) -> StreamAnnotation | SourceAnnotation | TransformationAnnotation:
    (found,) = check_ssl(parse_ssl(text), text, VOCABULARY)
    return found


def through_json(
    annotation: StreamAnnotation | SourceAnnotation | TransformationAnnotation,
) -> StreamAnnotation | SourceAnnotation | TransformationAnnotation:
    """What is read of what GET /annotations writes."""
    written = AnnotationModel.of(annotation).model_dump_json(by_alias=True)
    described = ContentsIn.model_validate(json.loads(written)).described()
    describer = Describer(VOCABULARY)
    if isinstance(annotation, StreamAnnotation):
        return describer.stream(described)
    return describer.transformation(described).annotation


def through_turtle(
    annotation: StreamAnnotation | SourceAnnotation | TransformationAnnotation,
) -> StreamAnnotation | SourceAnnotation | TransformationAnnotation:
    (described,) = read_annotations(format_annotations([annotation]))
    describer = Describer(VOCABULARY)
    if isinstance(annotation, StreamAnnotation):
        return describer.stream(described)
    return describer.transformation(described).annotation


def without_source(annotation: object) -> object:
    return {name: getattr(annotation, name) for name in annotation.__slots__ if name != "source"}


@given(streams)
def test_a_stream_annotation_is_read_back_from_text_and_json(wanted: StreamAnnotation) -> None:
    try:
        written = through_json(wanted)
    except BadArguments:
        assume(False)
    assert without_source(written) == without_source(wanted)
    assert through_turtle(wanted) == written
    assert read_text(written.source) == written
    assert format_annotation(read_text(written.source), VOCABULARY) == written.source


@pytest.mark.parametrize(
    "text",
    [
        "source gps provides spd:speed(UAV) [m.s-1]",
        "source gps provides spd:speed(self)",
        'source gps provides "my field":speed(UAV) for every UAV = "who (id)"',
        "compunit f transforms a:speed(UAV as x), b:altitude(Car) to d:distance(UAV as x, Car)",
        "compunit f transforms a:speed(<http://example.org/fleet#uav1>) to b:speed(uav1 as u)",
        "compunit f transforms a:latitude, b:longitude to c:speed",
        "compunit f transforms a:speed(Car) to c:speed(Human) for every Human = who",
        "compunit f transforms a:speed(dyknow:398564) to c:altitude(dyknow:398564)",
        "compunit f transforms a:onGround to c:onGround no_unit",
    ],
)
def test_a_transformation_is_read_back_from_text_and_json(text: str) -> None:
    said = read_text(text)
    written = through_json(said)
    assert without_source(written) == without_source(said)
    assert through_turtle(said) == written
    assert without_source(read_text(written.source)) == without_source(said)
    assert format_annotation(read_text(written.source), VOCABULARY) == written.source
