"""Results of queries as samples, and triples that no sample gave."""

from dataclasses import dataclass

import numpy as np
import pytest
from pyoxigraph import Literal, NamedNode

from dyknow.converters import (
    ConversionError,
    ResultConverter,
    TripleConverter,
    result_schema,
)
from dyknow.languages.ssl.annotation import Content, Role, StreamAnnotation
from dyknow.ontology.units import parse_unit
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW, XSD
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.rdf.timed import Kind, ObjectColumn, TimedTriples, TripleRows
from dyknow.streams.sample import Field, FieldType, Schema

SPEED, HEIGHT = DYKNOW + "speed", DYKNOW + "altitude"


def node(name):
    return NamedNode(name if ":" in name else DYKNOW + name)


def number(value, type="double"):
    return Literal(str(value), datatype=NamedNode(XSD + type))


def construct(predicates, ranges=None, **options):
    schema = result_schema(predicates=predicates, ranges=ranges)
    return ResultConverter(schema, {}, predicates=predicates, **options)


def triples(*listed):
    return from_terms([(9, node(s), NamedNode(p), o) for s, p, o in listed], TermDictionary())


def test_schema_of_a_construct():
    other = "http://x.org/speed"
    schema = result_schema(
        predicates=[SPEED, other, DYKNOW + "id", HEIGHT],
        ranges={SPEED: XSD + "double", HEIGHT: XSD + "integer"},
        kinds={HEIGHT: Kind.DECIMAL, other: Kind.BOOLEAN},
    )
    assert [(field.name, str(field.type)) for field in schema.fields] == [
        ("id", "string"),
        ("speed", "float"),
        ("speed_2", "boolean"),
        ("id_2", "string"),
        ("altitude", "float"),
    ]


def test_schema_of_select_and_ask():
    schema = result_schema(variables=["o", "n"], kinds={"n": Kind.INTEGER})
    assert [str(field.type) for field in schema.fields] == ["string", "integer"]
    assert result_schema(ask=True).names == ("answer",)


def test_construct_is_ordered_by_subject_text_then_values():
    converter = construct([SPEED], {SPEED: XSD + "double"})
    found = triples(
        ("uav2", SPEED, number(3)),
        ("uav10", SPEED, number(2)),
        ("uav2", SPEED, number(1, "integer")),
        ("http://x.org/a", SPEED, number(4)),
    )
    batch = converter.triples(found, 100, 7)
    assert list(batch.rows()) == [
        (7, 100, {"id": "http://x.org/a", "speed": 4.0}),
        (7, 100, {"id": "uav10", "speed": 2.0}),
        (7, 100, {"id": "uav2", "speed": 1.0}),
        (7, 100, {"id": "uav2", "speed": 3.0}),
    ]
    # A later window brings a name that comes before: ranks are made anew.
    again = converter.triples(triples(("a", SPEED, number(1)), ("uav2", SPEED, number(1))), 101, 11)
    assert again.columns["id"].tolist() == ["a", "uav2"]


def test_predicates_of_a_subject_are_one_sample_where_that_says_nothing_new():
    converter = construct([SPEED, HEIGHT], {SPEED: XSD + "double", HEIGHT: XSD + "integer"})
    found = triples(
        ("a", SPEED, number(1)),
        ("a", HEIGHT, number(2, "integer")),
        ("b", SPEED, number(3)),
        ("b", SPEED, number(4)),
        ("b", HEIGHT, number(5, "integer")),
        ("c", HEIGHT, number(6, "integer")),
    )
    assert [tuple(row[2].values()) for row in converter.triples(found, 0, 0).rows()] == [
        ("a", 1.0, 2),
        ("b", None, 5),
        ("b", 3.0, None),
        ("b", 4.0, None),
        ("c", None, 6),
    ]


def test_wide_rows_stay_rows():
    dictionary = TermDictionary()
    ids = dictionary.ids([node("a"), node("a")])
    columns = {
        dictionary.id(NamedNode(SPEED)): ObjectColumn(Kind.DOUBLE, np.array([2.0, 1.0])),
        dictionary.id(NamedNode(HEIGHT)): ObjectColumn(
            Kind.INTEGER, np.array([1, 5]), np.array([False, True])
        ),
    }
    times = np.array([3, 3])
    found = TimedTriples(dictionary, (TripleRows(times, times, ids, columns),))
    converter = construct([SPEED, HEIGHT], {SPEED: XSD + "double", HEIGHT: XSD + "integer"})
    assert [tuple(row[2].values()) for row in converter.triples(found, 0, 0).rows()] == [
        ("a", 1.0, None),
        ("a", 2.0, 1),
    ]


@dataclass(frozen=True)
class Solutions:
    variables: tuple
    columns: dict
    dictionary: TermDictionary
    length: int

    def __len__(self):
        return self.length


@dataclass(frozen=True)
class Result:
    end: int
    solutions: Solutions | None = None
    triples: TimedTriples | None = None
    answer: bool | None = None


def test_a_table_goes_column_by_column():
    dictionary = TermDictionary()
    columns = {
        "o": ObjectColumn(Kind.TERM, dictionary.ids([node("b"), Literal("x"), node("a")])),
        "n": ObjectColumn(
            Kind.DOUBLE, np.array([2.0, np.inf, 0.0]), np.array([False, False, True])
        ),
        "flag": ObjectColumn(Kind.BOOLEAN, np.array([True, False, True])),
    }
    solved = Solutions(("o", "n", "flag"), columns, dictionary, 3)
    schema = result_schema(
        variables=solved.variables, kinds={"n": Kind.DOUBLE, "flag": Kind.BOOLEAN}
    )
    rows = [
        (5, 9, {"o": "a", "n": None, "flag": True}),
        (5, 9, {"o": "b", "n": 2.0, "flag": True}),
        (5, 9, {"o": "x", "n": None, "flag": False}),
    ]
    converter = ResultConverter(schema, {})
    assert list(converter.convert(Result(9, solutions=solved), 5).rows()) == rows
    kept = ResultConverter(schema, {}, keep_order=True)
    assert kept.convert(Result(9, solutions=solved), 5).columns["o"].tolist() == ["b", "x", "a"]


def test_text_fields_take_any_term():
    dictionary = TermDictionary()
    converter = ResultConverter(result_schema(variables=["x"]), {})
    columns = {"x": ObjectColumn(Kind.INTEGER, np.array([7, -1]))}
    batch = converter.table(["x"], columns, dictionary, 0, 0)
    assert batch.columns["x"].tolist() == ["-1", "7"]


def test_an_answer_is_a_sample():
    converter = ResultConverter(result_schema(ask=True), {})
    assert list(converter.convert(Result(4, answer=True), 6).rows()) == [(6, 4, {"answer": True})]


def test_nothing_gives_no_sample():
    converter = construct([SPEED])
    empty = converter.convert(Result(4, triples=TimedTriples(TermDictionary(), ())), 6)
    assert len(empty) == 0
    assert tuple(empty.columns) == ("id", "speed")


@pytest.mark.parametrize(
    ("range", "object", "message"),
    [
        ("integer", number(1.5), "no integer"),
        ("integer", number("1.50"), "no integer value"),
        ("integer", number("NaN"), "no integer"),
        ("double", Literal("fast"), "no float value"),
        ("boolean", number(1), "no boolean value"),
        ("integer", number(2**64, "integer"), "no integer value"),
    ],
)
def test_an_object_that_its_field_cannot_hold(range, object, message):
    with pytest.raises(ConversionError, match=message):
        construct([SPEED], {SPEED: XSD + range}).triples(triples(("a", SPEED, object)), 0, 0)


@pytest.mark.parametrize(
    ("range", "objects", "values", "message"),
    [
        ("integer", [number(2**64, "integer"), number(7, "integer")], [None, 7], "18446744073709"),
        ("integer", [number(1.5), number(2.0)], [None, 2], '"1.5"'),
        ("integer", [number(1.5), number(2**60, "integer")], [None, 2**60], '"1.5"'),
        ("double", [Literal("fast"), number(1)], [None, 1.0], '"fast" is no float value'),
        ("boolean", [number(1), Literal(True)], [None, True], "is no boolean value"),
        ("integer", [number("1" * 900, "integer")], [None], "1…"),
    ],
)
def test_objects_that_their_field_cannot_hold_are_lost_alone(range, objects, values, message):
    converter = construct([SPEED], {SPEED: XSD + range})
    converter.lost = []
    found = triples(*((f"o{n}", SPEED, each) for n, each in enumerate(objects)))
    batch = converter.triples(found, 0, 0)
    assert [row["speed"] for _, _, row in batch.rows()] == values
    assert [each.field for each in converter.lost] == ["speed"]
    assert message in converter.lost[0].message
    assert len(converter.lost[0].message) < 200


def test_a_predicate_that_was_not_named():
    with pytest.raises(ConversionError, match=r"no field for <.*altitude>"):
        construct([SPEED]).triples(triples(("a", HEIGHT, number(1))), 0, 0)


SCHEMA = Schema((Field("id", FieldType.STRING), Field("spd", FieldType.FLOAT)))
EVERY = (Role(DYKNOW + "UAV", None, "id"),)
ANNOTATION = StreamAnnotation("s", (Content(SPEED, "spd", parse_unit("kt"), EVERY),), "")


def test_triples_of_one_time_must_agree():
    converter = TripleConverter(ANNOTATION, SCHEMA, {})
    with pytest.raises(ConversionError, match="τ = 9 give 'spd' two values"):
        converter.convert(triples(("a", SPEED, number(1)), ("a", SPEED, number(2))))
    same = converter.convert(triples(("a", SPEED, number(1)), ("a", SPEED, number(1))))
    assert list(same.rows()) == [(9, 9, {"id": "a", "spd": 1.0})]


def test_an_instant_of_several_objects_is_several_samples():
    converter = TripleConverter(ANNOTATION, SCHEMA, {})
    both = converter.convert(triples(("b", SPEED, number(1)), ("a", SPEED, number(2))))
    assert sorted(each["id"] for _, _, each in both.rows()) == ["a", "b"]
    assert both.available.tolist() == [9, 9]


def test_other_triples_are_left_out():
    converter = TripleConverter(ANNOTATION, SCHEMA, {})
    assert len(converter.convert(triples(("a", HEIGHT, number(1))))) == 0
    assert len(converter.convert(triples())) == 0


def test_units_are_converted_back():
    units = {SPEED: parse_unit("km.h-1")}
    converter = TripleConverter(ANNOTATION, SCHEMA, {}, units=units)
    batch = converter.convert(triples(("a", SPEED, number(185.2))))
    assert batch.columns["spd"].values == pytest.approx([100])


def test_integers_are_integers_again_after_their_unit_changed():
    schema = Schema((Field("id", FieldType.STRING), Field("spd", FieldType.INTEGER)))
    converter = TripleConverter(ANNOTATION, schema, {}, units={SPEED: parse_unit("km.h-1")})
    for knots in range(600):
        batch = converter.convert(triples(("a", SPEED, number(knots * 1.852))))
        assert batch.values_at(0) == {"id": "a", "spd": knots}
    with pytest.raises(ConversionError, match="no integer"):
        converter.convert(triples(("a", SPEED, number(1.0))))


def test_features_that_cannot_be_told_apart_are_refused():
    roles = [(Role(DYKNOW + "UAV", None, name),) for name in ("id", "id2")]
    schema = Schema(tuple(Field(name, FieldType.STRING) for name in ("id", "id2", "a", "b")))
    contents = (Content(SPEED, "a", (), roles[0]), Content(SPEED, "b", (), roles[1]))
    with pytest.raises(ConversionError, match="cannot be told apart"):
        TripleConverter(StreamAnnotation("s", contents, ""), schema, {})
