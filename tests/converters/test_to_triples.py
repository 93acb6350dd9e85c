"""s1-s7 of [Events14 Listings 2 and 5] as triples, ranges, units, and what is refused."""

import numpy as np
import pytest
from pyoxigraph import Literal, NamedNode, Triple

from dyknow.converters import ConversionError, SampleConverter, TripleConverter
from dyknow.languages.ssl.annotation import Content, Role, StreamAnnotation
from dyknow.ontology.units import parse_unit
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW, OWL, RDF, RDFS, XSD
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows

UAV, UAV1 = DYKNOW + "UAV", DYKNOW + "uav1"
EVERY = Role(UAV, None, "id")


def vocabulary(**ranges):
    found = []
    for name, iri in ranges.items():
        feature = NamedNode(DYKNOW + name)
        found.append(Triple(feature, NamedNode(RDF + "type"), NamedNode(OWL + "DatatypeProperty")))
        feature_class = "http://www.dyknow.eu/ontology#UnaryFeature"
        found.append(Triple(feature, NamedNode(RDF + "type"), NamedNode(feature_class)))
        base = "http://www.dyknow.eu/ontology#Feature"
        found.append(Triple(feature, NamedNode(RDF + "type"), NamedNode(base)))
        if iri is not None:
            found.append(Triple(feature, NamedNode(RDFS + "range"), NamedNode(iri)))
    return Vocabulary.from_triples(found)


def schema(**types):
    return Schema(tuple(Field(name, FieldType(type)) for name, type in types.items()))


def content(feature, field, *roles, unit=()):
    return Content(DYKNOW + feature, field, unit, roles)


def convert(contents, fields, rows, ranges=None, **options):
    annotation = StreamAnnotation("s", tuple(contents), "")
    converter = SampleConverter(
        annotation, fields, vocabulary(**(ranges or {})), TermDictionary(), **options
    )
    samples = [(t, v, dict(zip(fields.names, values, strict=True))) for t, v, *values in rows]
    return converter.convert(batch_from_rows(fields, samples))


def texts(triples):
    return [
        (t, v, s.value.removeprefix(DYKNOW), p.value.removeprefix(DYKNOW), str(o))
        for t, v, s, p, o in triples.with_valid()
    ]


def test_s1_and_s7_speak_of_one_object_in_every_sample():
    found = convert(
        [content("altitude", "alt", Role(None, UAV1, None))],
        schema(alt="integer"),
        [(5, 4, 100), (7, 6, None)],
    )
    assert texts(found) == [(5, 4, "uav1", "altitude", f'"100"^^<{XSD}integer>')]


def test_s2_and_s6_take_only_samples_of_the_object():
    fields = schema(id="string", alt="float", spd="float")
    role = Role(None, UAV1, "id")
    found = convert(
        [content("altitude", "alt", role), content("speed", "spd", role)],
        fields,
        [
            (1, 1, "uav1", 2.0, 3.0),
            (2, 2, "uav2", 4.0, 5.0),
            (3, 3, None, 6.0, 7.0),
            (4, 4, "dyknow:uav1", None, 8.0),
            (5, 5, "uav1", None, None),
        ],
    )
    (table,) = found.tables
    assert table.time.tolist() == [1, 4]
    assert [(t, p) for t, _, _, p, _ in texts(found)] == [
        (1, "altitude"),
        (1, "speed"),
        (4, "speed"),
    ]


def test_s3_and_s5_name_the_object_and_its_sort():
    found = convert(
        [content("altitude", "alt", EVERY), content("speed", "spd", EVERY)],
        schema(id="string", alt="float", spd="float"),
        [(1, 0, "a b", 2.0, 3.0), (2, 0, "http://x.org/y", 2.0, None)],
        {"speed": XSD + "decimal"},
    )
    (table,) = found.tables
    assert found.dictionary.term(table.sort) == NamedNode(UAV)
    assert texts(found) == [
        (1, 0, "a%20b", "altitude", f'"2"^^<{XSD}double>'),
        (2, 0, "http://x.org/y", "altitude", f'"2"^^<{XSD}double>'),
        (1, 0, "a%20b", "speed", f'"3"^^<{XSD}decimal>'),
    ]


def test_s4_makes_a_node_with_value_and_ordered_arguments():
    roles = (Role(UAV, None, "id1"), Role(UAV, None, "id2"))
    fields = schema(id1="string", id2="string", dist="float")
    contents = [content("xydist", "dist", *roles)]
    found = convert(contents, fields, [(0, 0, "a", "b", 7.5), (1, 1, "a", None, 1.0)])
    node = f"{DYKNOW}s/xydist.0/1970-01-01T00:00:00Z"
    assert {tuple(map(str, triple[1:])) for triple in found} == {
        (f"<{DYKNOW}a>", f"<{DYKNOW}xydist>", f"<{node}>"),
        (f"<{node}>", f"<{RDF}value>", f'"7.5"^^<{XSD}double>'),
        (f"<{node}>", f"<{RDF}_1>", f"<{DYKNOW}a>"),
        (f"<{node}>", f"<{RDF}_2>", f"<{DYKNOW}b>"),
    }
    sorts = {
        found.dictionary.term(int(s)).value
        for table in found.tables
        if table.sort is not None
        for s in table.subject
    }
    assert sorts == {DYKNOW + "a", DYKNOW + "b"}
    back = TripleConverter(StreamAnnotation("s", tuple(contents), ""), fields, {}).convert(found)
    assert list(back.rows()) == [(0, 0, {"id1": "a", "id2": "b", "dist": 7.5})]


@pytest.mark.parametrize(
    ("range", "type", "value", "object"),
    [
        ("double", "integer", 3, '"3"^^<{}double>'),
        ("float", "float", 0.1, '"0.1"^^<{}float>'),
        ("integer", "float", -4.0, '"-4"^^<{}integer>'),
        ("unsignedByte", "integer", 255, '"255"^^<{}unsignedByte>'),
        ("nonNegativeInteger", "float", 9.0, '"9"^^<{}nonNegativeInteger>'),
        ("boolean", "boolean", True, '"true"^^<{}boolean>'),
        ("anyURI", "string", "http://x/", '"http://x/"^^<{}anyURI>'),
        ("dateTime", "integer", 1_500_000_000, '"1970-01-01T00:00:01.5Z"^^<{}dateTime>'),
        ("dateTime", "string", "2020-01-01T00:00:00Z", '"2020-01-01T00:00:00Z"^^<{}dateTime>'),
    ],
)
def test_the_range_gives_the_datatype(range, type, value, object):
    fields = schema(x=type)
    contents = [content("f", "x", Role(None, UAV1, None))]
    found = convert(contents, fields, [(1, 1, value)], {"f": XSD + range})
    ((_, _, _, _, text),) = texts(found)
    assert text == object.format(XSD)
    back = TripleConverter(StreamAnnotation("s", tuple(contents), ""), fields, {}).convert(found)
    assert back.values_at(0) == {"x": value}


def test_a_class_as_range_makes_objects():
    fields = schema(id="string", on="string")
    contents = [content("on", "on", EVERY)]
    found = convert(contents, fields, [(1, 1, "car1", "road 7")], {"on": DYKNOW + "Road"})
    assert texts(found) == [(1, 1, "car1", "on", f"<{DYKNOW}road%207>")]
    back = TripleConverter(StreamAnnotation("s", tuple(contents), ""), fields, {}).convert(found)
    assert back.values_at(0) == {"id": "car1", "on": "road 7"}


def test_units_are_converted_on_the_edge():
    fields = schema(id="string", spd="integer")
    contents = [content("speed", "spd", EVERY, unit=parse_unit("kt"))]
    found = convert(
        contents,
        fields,
        [(1, 1, "a", 100)],
        {"speed": XSD + "double"},
        units={DYKNOW + "speed": parse_unit("km.h-1")},
    )
    (table,) = found.tables
    assert next(iter(table.objects.values())).values == pytest.approx([185.2])


def test_only_the_features_asked_for():
    found = convert(
        [content("altitude", "alt", EVERY), content("speed", "spd", EVERY)],
        schema(id="string", alt="float", spd="float"),
        [(1, 0, "a", 2.0, 3.0)],
        features={DYKNOW + "speed"},
    )
    assert [triple[3] for triple in texts(found)] == ["speed"]


@pytest.mark.parametrize(
    ("range", "type", "value", "message"),
    [
        ("integer", "float", 1.5, "row 1: field 'x' is no integer: 1.5"),
        ("integer", "float", 1e19, "row 1: field 'x' is no integer"),
        ("byte", "integer", 128, "row 1: field 'x' is no xsd:byte: 128"),
        ("double", "integer", 2**53 + 1, "row 1: field 'x' has more digits than a float64 holds"),
        ("double", "integer", 2**63 - 1, "row 1: field 'x' has more digits than a float64 holds"),
    ],
)
def test_a_value_that_is_no_object_names_its_row(range, type, value, message):
    contents = [content("f", "x", Role(None, UAV1, "id"))]
    rows = [(1, 1, "other", value), (2, 2, "uav1", value)]
    with pytest.raises(ConversionError, match=message):
        convert(contents, schema(id="string", x=type), rows, {"f": XSD + range})


@pytest.mark.parametrize(
    ("contents", "fields", "ranges", "options", "message"),
    [
        ([content("f", "y", EVERY)], {"id": "string"}, {}, {}, "names a field 'y'"),
        ([content("f", "x", EVERY)], {"x": "float"}, {}, {}, "names a field 'id'"),
        ([content("f", "x", EVERY)], {"id": "float", "x": "float"}, {}, {}, "names objects"),
        ([content("f", "x", Role(UAV, None, None))], {"x": "float"}, {}, {}, "for every UAV"),
        ([content("f", "id", EVERY)], {"id": "string"}, {"f": XSD + "double"}, {}, "xsd:double"),
        (
            [content("f", "x", EVERY, unit=parse_unit("ft"))],
            {"id": "string", "x": "integer"},
            {"f": XSD + "integer"},
            {"units": {DYKNOW + "f": parse_unit("m")}},
            "cannot change its unit",
        ),
        (
            [content("f", "x", EVERY, unit=parse_unit("ft"))],
            {"id": "string", "x": "float"},
            {},
            {"units": {DYKNOW + "f": parse_unit("h")}},
            "measures",
        ),
    ],
)
def test_an_annotation_that_does_not_fit_is_refused_at_once(
    contents, fields, ranges, options, message
):
    with pytest.raises(ConversionError, match=message):
        convert(contents, schema(**fields), [], ranges, **options)


def test_a_growing_pool_keeps_its_ids():
    fields = schema(id="string", x="float")
    annotation = StreamAnnotation("s", (content("f", "x", EVERY),), "")
    dictionary, pools = TermDictionary(), {}
    converter = SampleConverter(annotation, fields, vocabulary(), dictionary)
    first = batch_from_rows(fields, [(1, 1, {"id": "a", "x": 1.0})], pools)
    pools = {"id": first.columns["id"].pool}
    second = batch_from_rows(fields, [(2, 2, {"id": i, "x": 1.0}) for i in ("b", None, "a")], pools)
    ids = [converter.convert(batch).tables[0].subject for batch in (first, second)]
    assert ids[0][0] == ids[1][1]
    names = [dictionary.term(i) for i in np.concatenate(ids).tolist()]
    assert names == [NamedNode(DYKNOW + n) for n in "aba"]


def test_all_null_text_over_an_empty_pool_is_no_triple():
    found = convert(
        [content("f", "x", EVERY)],
        schema(id="string", x="string"),
        [(1, 1, None, None), (2, 2, None, None)],
    )
    assert len(found) == 0
    assert not found.tables


def test_string_literals():
    found = convert([content("f", "x", Role(None, UAV1, None))], schema(x="string"), [(1, 1, "hé")])
    assert [o for *_, o in found] == [Literal("hé")]
