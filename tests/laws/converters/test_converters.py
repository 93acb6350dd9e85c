"""Laws of the converters: round trips lose nothing, whatever the annotation's shape."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from pyoxigraph import NamedNode, Triple

from dyknow.converters import SampleConverter, TripleConverter
from dyknow.converters.arrow.stream import (
    column_from_arrow,
    decode_arrow,
    encode_arrow,
)
from dyknow.converters.ndjson import decode_ndjson, encode_ndjson
from dyknow.converters.objects import ObjectTable, object_iri, object_name
from dyknow.languages.ssl.annotation import Content, Role, StreamAnnotation
from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.dictionary import TermDictionary
from dyknow.rdf.namespaces import DYKNOW, OWL, RDF, RDFS, STREAM_SPACE, XSD
from dyknow.rdf.terms_to_columns import from_terms
from dyknow.streams.sample import Field, FieldType, Schema, batch_from_rows
from dyknow.streams.string_pool import StringPool

LIMITS = settings(deadline=None, max_examples=100)
TIMES = st.integers(-(2**63), 2**63 - 1)
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=6)
INTEGERS = st.integers(-(2**63), 2**63 - 1)
FLOATS = st.floats(allow_nan=False, allow_infinity=False)
VALUES = {
    FieldType.FLOAT: FLOATS,
    FieldType.INTEGER: INTEGERS,
    FieldType.BOOLEAN: st.booleans(),
    FieldType.STRING: TEXTS,
}
EXACT = st.integers(-(2**53), 2**53)
# What a field of a type may be the feature of, and values that fit.
RANGES = {
    FieldType.FLOAT: [
        (None, FLOATS),
        (XSD + "double", FLOATS),
        (XSD + "float", FLOATS),
        (XSD + "decimal", FLOATS),
        (XSD + "integer", EXACT.map(float)),
        (XSD + "long", EXACT.map(float)),
    ],
    FieldType.INTEGER: [
        (None, INTEGERS),
        (XSD + "integer", INTEGERS),
        (XSD + "long", INTEGERS),
        (XSD + "short", st.integers(-(2**15), 2**15 - 1)),
        (XSD + "double", EXACT),
        (XSD + "dateTime", INTEGERS),
        (XSD + "string", INTEGERS),
        (DYKNOW + "Road", INTEGERS),
    ],
    FieldType.BOOLEAN: [(None, st.booleans()), (XSD + "boolean", st.booleans())],
    FieldType.STRING: [
        (None, TEXTS),
        (XSD + "string", TEXTS),
        (XSD + "anyURI", TEXTS),
        (DYKNOW + "Road", TEXTS.map(lambda t: object_name(object_iri(t, DYKNOW), DYKNOW))),
    ],
}
NAMES = TEXTS.map(lambda text: object_name(object_iri(text, DYKNOW), DYKNOW))


@given(st.one_of(TEXTS, st.sampled_from(["dyknow:a", "urn:x:y", "http://x.org/a#b", "a%20b"])))
@LIMITS
def test_a_name_and_its_iri_are_inverse(name):
    iri = object_iri(name, DYKNOW)
    NamedNode(iri)  # is one
    shortest = object_name(iri, DYKNOW)
    assert object_iri(shortest, DYKNOW) == iri
    assert object_name(object_iri(shortest, DYKNOW), DYKNOW) == shortest


def features(ranges):
    triples = []
    for name, iri in ranges.items():
        feature = NamedNode(DYKNOW + name)
        kinds = (OWL + "DatatypeProperty", STREAM_SPACE + "Feature")
        triples += [Triple(feature, NamedNode(RDF + "type"), NamedNode(kind)) for kind in kinds]
        if iri is not None:
            triples.append(Triple(feature, NamedNode(RDFS + "range"), NamedNode(iri)))
    return Vocabulary.from_triples(triples)


@st.composite
def annotated_streams(draw):
    """An annotation shaped like one of s1-s7, its schema, ranges, and samples that fit."""
    shape = draw(st.sampled_from(["s1", "s2", "s3", "s4", "s5", "s6", "s7"]))
    count = 1 if shape in ("s1", "s2", "s3") else draw(st.integers(1, 3))
    object = DYKNOW + "uav1"
    roles = {
        "s1": (Role(None, object, None),),
        "s2": (Role(None, object, "id"),),
        "s3": (Role(DYKNOW + "UAV", None, "id"),),
        "s4": (Role(DYKNOW + "UAV", None, "id"), Role(DYKNOW + "UAV", None, "id2")),
    }
    roles |= {"s7": roles["s1"], "s6": roles["s2"], "s5": roles["s3"]}
    fields, values, ranges, contents = [], {}, {}, []
    for role in roles[shape]:
        if role.id_field is not None:
            type = draw(st.sampled_from([FieldType.STRING, FieldType.INTEGER]))
            if role.object is not None:
                type = FieldType.STRING
            fields.append(Field(role.id_field, type))
            named = NAMES if type is FieldType.STRING else INTEGERS
            if role.object is not None:
                named = st.one_of(st.just("uav1"), NAMES)
            values[role.id_field] = named
    for i in range(count):
        type = draw(st.sampled_from(list(FieldType)))
        ranges[f"f{i}"], fitting = draw(st.sampled_from(RANGES[type]))
        fields.append(Field(f"v{i}", type))
        values[f"v{i}"] = fitting
        contents.append(Content(DYKNOW + f"f{i}", f"v{i}", (), roles[shape]))
    times = sorted(draw(st.sets(TIMES, max_size=8)))
    rows = []
    for time in times:
        row = {name: draw(st.none() | each) for name, each in values.items()}
        rows.append((time, draw(TIMES), row))
    annotation = StreamAnnotation("s", tuple(contents), "")
    return annotation, Schema(tuple(fields)), features(ranges), rows


def what_comes_back(annotation, rows):
    """The definition: per sample the fields that gave a triple, and their id fields."""
    for available, valid, values in rows:
        kept = dict.fromkeys(values)
        for content in annotation.contents:
            ids = [role for role in content.roles if role.id_field is not None]
            named = all(
                values[role.id_field] is not None
                and (role.object is None or values[role.id_field] == "uav1")
                for role in ids
            )
            if named and values[content.field] is not None:
                kept[content.field] = values[content.field]
                kept |= {role.id_field: values[role.id_field] for role in ids}
        if any(value is not None for value in kept.values()):
            yield available, valid, kept


@given(annotated_streams(), st.booleans(), st.integers(0, 8))
@LIMITS
def test_samples_to_triples_and_back_lose_nothing(stream, plain, cut):
    annotation, schema, vocabulary, rows = stream
    dictionary, pools = TermDictionary(), {}
    forth = SampleConverter(annotation, schema, vocabulary, dictionary)
    back = TripleConverter(annotation, schema, pools)
    found = []
    for part in (rows[:cut], rows[cut:]):
        triples = forth.convert(batch_from_rows(schema, part, pools))
        if plain:  # as a list of single triples: the wide rows are not needed
            listed = list(triples.with_valid())
            triples = from_terms(
                [(t, s, p, o) for t, _, s, p, o in listed], dictionary, [v for _, v, *_ in listed]
            )
        again = back.convert(triples)
        found.extend(again.rows())
        # Triples -> samples -> triples: the same bag.
        twice = forth.convert(again)
        assert sorted(map(str, twice.with_valid())) == sorted(map(str, triples.with_valid()))
    assert found == list(what_comes_back(annotation, rows))


@st.composite
def batches(draw):
    types = draw(st.lists(st.sampled_from(list(FieldType)), max_size=4))
    schema = Schema(tuple(Field(f"{type} {i}", type) for i, type in enumerate(types)))
    samples = st.tuples(
        TIMES,
        TIMES,
        st.fixed_dictionaries({f.name: st.none() | VALUES[f.type] for f in schema.fields}),
    )
    return schema, draw(st.lists(samples, min_size=1, max_size=6))


@given(batches())
@LIMITS
def test_wire_formats_are_lossless(drawn):
    schema, rows = drawn
    batch = batch_from_rows(schema, rows)
    for encode, decode in ((encode_ndjson, decode_ndjson), (encode_arrow, decode_arrow)):
        incoming = decode(encode(batch), schema, {})
        assert not incoming.stamped
        assert list(incoming.batch.rows()) == list(batch.rows())


@st.composite
def texts_in_arrow(draw):
    """A column of text in some chunks, plain or by dictionaries, also careless ones."""
    import pyarrow as pa

    texts = st.none() | st.sampled_from(["a", "b", "", "å", "dyknow:uav1"])
    kind = draw(st.sampled_from([pa.string(), pa.large_string(), None]))
    chunks = []
    for _ in range(draw(st.integers(1, 3))):
        if kind is not None:
            chunks.append(pa.array(draw(st.lists(texts, max_size=60)), kind))
            continue
        # Twice the same text, texts in no row, and null as an entry.
        entries = pa.array(draw(st.lists(texts, min_size=1, max_size=6)), pa.string())
        places = st.none() | st.integers(0, len(entries) - 1)
        indices = pa.array(draw(st.lists(places, max_size=60)), pa.int8())
        chunks.append(pa.DictionaryArray.from_arrays(indices, entries))
    return pa.chunked_array(chunks)


@given(texts_in_arrow(), st.lists(st.sampled_from(["b", "c"]), unique=True))
@LIMITS
def test_text_in_arrow_is_what_its_rows_say(column, known):
    """The definition: row by row, each text encoded as it is met."""
    pools = {"x": StringPool(known)}
    found = column_from_arrow(Field("x", FieldType.STRING), column, pools)
    texts = [text for chunk in column.chunks for text in chunk.to_pylist()]
    assert found.tolist() == texts
    assert list(pools["x"].strings()) == list(dict.fromkeys([*known, *filter(is_text, texts)]))


def is_text(value):
    return value is not None


@given(st.lists(st.lists(st.integers(-3, 40) | INTEGERS, max_size=12), max_size=4))
@LIMITS
def test_objects_called_by_integers_are_those_of_their_texts(batches):
    dictionary = TermDictionary()
    table = ObjectTable(dictionary, DYKNOW)
    for values in batches:
        found = table.of_integers(np.array(values, np.int64))
        size = len(dictionary)
        terms = [dictionary.term(id) for id in found.tolist()]
        assert terms == [NamedNode(object_iri(str(value), DYKNOW)) for value in values]
        assert table.of_integers(np.array(values, np.int64)).tolist() == found.tolist()
        assert len(dictionary) == size


@given(st.binary(max_size=60) | st.text(max_size=60).map(str.encode))
@LIMITS
def test_any_bytes_are_samples_or_a_wire_error(data):
    from dyknow.converters import WireError

    schema = Schema((Field("x", FieldType.FLOAT),))
    for decode in (decode_ndjson, decode_arrow):
        try:
            assert len(decode(data, schema, {}).batch)
        except WireError:
            continue


@given(st.lists(TIMES, max_size=30), st.integers(1, 8))
@LIMITS
def test_available_times_of_a_recording_are_the_least_that_do_not_decrease(times, cut):
    from dyknow.converters.recordings.recording import running_maximum

    expected = [max(times[: i + 1]) for i in range(len(times))]
    found, before = [], -(2**63)
    for start in range(0, len(times), cut):
        part = running_maximum(np.array(times[start : start + cut], np.int64), before)
        before = int(part[-1])
        found.extend(part.tolist())
    assert found == expected
