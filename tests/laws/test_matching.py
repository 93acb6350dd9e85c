"""Laws of semantic matching: plans are valid, and one is found iff the definition has one.

The definition here walks every path of the transformation tree ([Introspection15 §4.3]): a
subtree is valid iff its leaves are streams, and a feature occurs once on any path.
"""

from dataclasses import replace

from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import Literal, NamedNode, Triple

from dyknow.languages.ssl.annotation import Content, PortAnnotation, Role, StreamAnnotation
from dyknow.matching.fit import Fit, Sorts
from dyknow.matching.match import match
from dyknow.matching.plan import (
    Compute,
    SelectObject,
    UseStream,
    annotation_of,
    contents_of,
    nodes_of,
)
from dyknow.matching.space import StreamSpace, TransformationDescription
from dyknow.matching.want import Want
from dyknow.ontology.units import UnitError, conversion, parse_unit
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import DYKNOW, OWL, RDF, RDFS, STREAM_SPACE

LIMITS = settings(deadline=None, max_examples=200)
SORTS = {"Thing": (), "UAV": ("Thing",), "RMAX": ("UAV", "Thing"), "Car": ("Thing",)}
FEATURES = {"a": (), "a1": ("a",), "b": (), "b1": ("b",), "c": (), "d": ()}
OBJECTS = {"uav1": ("UAV", "Thing"), "car1": ("Car", "Thing"), "stranger": ()}
UNITS = [parse_unit(text) for text in ("m", "km", "s")]
METRE = parse_unit("m")


def _vocabulary():
    def node(name):
        return NamedNode(DYKNOW + name)

    kind = NamedNode(RDF + "type")
    triples = [Triple(node(s), kind, NamedNode(OWL + "Class")) for s in SORTS]
    triples += [Triple(node(f), kind, NamedNode(STREAM_SPACE + "Feature")) for f in FEATURES]
    triples += [
        Triple(node(name), NamedNode(RDFS + relation), node(wider))
        for relation, names in (("subClassOf", SORTS), ("subPropertyOf", FEATURES))
        for name, widers in names.items()
        for wider in widers
    ]
    triples += [Triple(node(o), kind, node(s)) for o, sorts in OBJECTS.items() for s in sorts]
    triples.append(Triple(node("a"), NamedNode(STREAM_SPACE + "hasUnit"), Literal("m")))
    return Vocabulary.from_triples(triples)


VOCABULARY = _vocabulary()
FEATURE = st.sampled_from([DYKNOW + name for name in FEATURES])
SORT = st.sampled_from([DYKNOW + name for name in SORTS])
OBJECT = st.sampled_from([DYKNOW + name for name in OBJECTS])
ROLE = st.one_of(
    st.builds(lambda sort, field: Role(sort, None, field), SORT, st.sampled_from(["id", "x"])),
    st.builds(
        lambda object, field: Role(None, object, field), OBJECT, st.sampled_from([None, "id"])
    ),
)
# Mostly metres and all things, or few transformations would fit together.
UNIT = st.sampled_from([METRE] * 6 + UNITS)
LOW_FEATURE = st.sampled_from([DYKNOW + name for name in ["b", "b1", "c", "d"]])
PORT = st.builds(PortAnnotation, st.sampled_from(["y", "y", "y", "x"]), FEATURE, UNIT)

INPUTS = st.one_of(*[st.lists(PORT, min_size=1, max_size=most) for most in (1, 1, 2)])


@st.composite
def spaces(draw):
    streams = []
    for i in range(draw(st.integers(1, 4))):
        role = st.sampled_from(draw(st.lists(ROLE, min_size=1, max_size=2)))
        contents = draw(st.lists(st.tuples(LOW_FEATURE, UNIT), min_size=1, max_size=3))
        streams.append(
            StreamAnnotation(
                f"s{i}",
                tuple(Content(f, f"f{k}", u, (draw(role),)) for k, (f, u) in enumerate(contents)),
                "",
            )
        )
    units = tuple(
        TransformationDescription(
            f"t{i}",
            tuple(draw(INPUTS)),
            draw(PORT),
            sort=draw(st.sampled_from([DYKNOW + "Thing"] * 4 + [DYKNOW + "UAV", DYKNOW + "RMAX"])),
        )
        for i in range(draw(st.integers(2, 8)))
    )
    return StreamSpace(tuple(streams), units)


WANTS = st.builds(
    Want,
    st.sampled_from([DYKNOW + name for name in ("a", "a", "a1", "b")]),
    st.one_of(st.none(), st.none(), SORT),
    st.one_of(st.none(), st.none(), OBJECT),
)


def serves(given_feature, given_unit, wanted_feature, wanted_unit):
    if wanted_feature not in VOCABULARY.superfeatures(given_feature):
        return False
    try:
        return wanted_unit is None or bool(conversion(given_unit, wanted_unit))
    except UnitError:
        return False


def obtainable(ask, path, want, space):
    """The definition: all roles for which ``ask`` ((feature, unit) …) stands in one stream."""
    sorts = Sorts(want, VOCABULARY)
    found = set()
    for stream in space.streams:
        for roles in {content.roles for content in stream.contents}:
            if all(
                any(
                    content.roles == roles and serves(content.feature, content.unit, *input)
                    for content in stream.contents
                )
                for input in ask
            ):
                found.add(roles)
    for t in space.transformations:
        below = path | {t.output.feature} | {feature for feature, _ in ask}
        if (
            all(serves(t.output.feature, t.output.unit, *input) for input in ask)
            and t.output.feature not in path
            and not any(port.feature in below for port in t.inputs)
        ):
            inputs = tuple((port.feature, port.unit) for port in t.inputs)
            found |= {
                roles
                for roles in obtainable(inputs, below, want, space)
                if sorts.allows(t.sort, roles) and roles[0].id_field != t.output.field
            }
    return found


def top(want):
    return ((want.feature, VOCABULARY.feature(want.feature).unit),)


@given(WANTS, spaces())
@LIMITS
def test_a_plan_is_found_iff_there_is_one(want, space):
    roles = obtainable(top(want), frozenset(), want, space)
    fits = {Sorts(want, VOCABULARY).fit(each)[0] for each in roles} - {Fit.NOT}
    found = match(want, space, VOCABULARY)
    assert (found.supply is not None) == bool(fits)
    assert bool(found.missing) == (found.supply is None)
    if found.supply is not None:
        assert found.supply.complete == (Fit.WHOLLY in fits)
        assert not found.supply.complete or len(found.supply.sources) == 1


@given(WANTS, spaces())
@LIMITS
def test_a_found_plan_is_valid(want, space):
    supply = match(want, space, VOCABULARY).supply
    for source in () if supply is None else supply.sources:
        check(source.node, (source.port,), ((want.feature, source.port.target),), (), want, space)
        held = [c for c in contents_of(source.node) if c.field == source.port.source_field]
        assert any(c.feature == source.port.feature and c.unit == source.port.source for c in held)
        assert source.roles in [c.roles for c in held]
        assert annotation_of(source.node, "x").contents == contents_of(source.node)
        if want.object is not None:
            assert all(r.object == want.object or r.id_field is None for r in source.roles)


def check(node, ports, ask, path, want, space):
    """The node exists, its ports answer the ask, and no feature came before."""
    for port, (feature, unit) in zip(ports, ask, strict=True):
        assert serves(port.feature, port.source, feature, unit)
        assert port.conversion == conversion(port.source, port.target)
        assert port.target == unit
    match node:
        case UseStream(stream, contents):
            assert any(s.stream == stream and s.contents == contents for s in space.streams)
            for port in ports:
                assert any(
                    (c.field, c.feature, c.unit) == (port.source_field, port.feature, port.source)
                    for c in contents
                )
        case SelectObject(source, id_field, object):
            assert isinstance(source, UseStream | SelectObject)
            assert want.object in (None, object)
            assert any(c.roles[0].id_field == id_field for c in contents_of(source))
            check(source, ports, ask, path, want, space)
        case Compute(name, (edge,), output):
            (unit,) = (t for t in space.transformations if t.name == name)
            assert output == unit.output
            here = {output.feature, *(feature for feature, _ in ask)}
            assert output.feature not in path
            assert not any(feature in path for feature, _ in ask)
            assert [port.target_field for port in edge.ports] == [p.field for p in unit.inputs]
            inner = tuple((port.feature, port.unit) for port in unit.inputs)
            assert not any(feature in here for feature, _ in inner)
            check(edge.node, edge.ports, inner, (*path, *here), want, space)


@given(WANTS, spaces())
@LIMITS
def test_matching_is_deterministic(want, space):
    again = StreamSpace(tuple(map(replace, space.streams)), space.transformations)
    first = match(want, space, VOCABULARY)
    assert first == match(want, again, VOCABULARY)
    if first.supply is not None:
        nodes = [node for source in first.supply.sources for node in nodes_of(source.node)]
        assert all(hash(node) is not None for node in nodes)
