"""Laws of XML specifications: printing and parsing undo each other, errors are placed and typed,
and the rules in plain words are those of the schema."""

import re
from xml.sax.saxutils import quoteattr

import msgspec
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from lxml import etree
from places import ROOT, TESTS

from dyknow.languages.errors import LanguageError, Span
from dyknow.languages.specification import (
    Parameter,
    Removal,
    Specification,
    StreamReference,
    UnitSpecification,
    format_specification,
    parse_specification,
)
from dyknow.languages.specification.document import read_document
from dyknow.languages.specification.markup import BLANKS, NAMESPACE, scan
from dyknow.languages.specification.schema_rules import first_violation
from dyknow.service.workers.messages import BadAnswer, ElementRow
from dyknow.service.workers.xml_elements import rows_of, specification_of

HERE = Span(0, 0)
encode = msgspec.msgpack.encode
decode = msgspec.msgpack.Decoder(list[ElementRow]).decode
CASES = TESTS / "cases" / "specification"
ROOM = ROOT / "languages" / "specification"
SCHEMA = etree.XMLSchema(etree.parse(str(ROOM / "specification.xsd")))

# C0 controls, surrogates and two more are no characters of XML.
characters = st.characters(
    codec="utf-8", exclude_categories=["Cc"], exclude_characters="\ufffe\uffff"
) | st.sampled_from("\"'<>&\t\n\r ]-;\x7f\x85")
texts = st.text(characters, max_size=8)
names = st.from_regex(r"[A-Za-z_][A-Za-z0-9_.\-]{0,3}", fullmatch=True)
references = st.builds(lambda text, last: (text + last).strip(BLANKS), texts, names)
parameters = st.lists(
    st.builds(Parameter, names, texts), max_size=3, unique_by=lambda parameter: parameter.name
).map(tuple)
streams = st.builds(StreamReference, references, st.just(HERE))


def unit_of(inputs):
    made = st.lists(inputs, max_size=3).map(tuple)
    return st.builds(UnitSpecification, names, st.none(), parameters, made, st.just(HERE))


units = st.recursive(unit_of(streams), lambda inner: unit_of(inner | streams), max_leaves=6)
removals = st.builds(Removal, references, st.none(), st.just(HERE)) | st.builds(
    Removal, st.none(), names, st.just(HERE)
)


@st.composite
def specifications(draw) -> Specification:
    """Names of units are drawn last, each once."""
    inserted = draw(st.lists(units, max_size=3))
    free = draw(st.lists(names, max_size=4, unique=True))

    def named(made: UnitSpecification) -> UnitSpecification:
        name = free.pop() if free and draw(st.booleans()) else None
        inputs = tuple(
            named(one) if isinstance(one, UnitSpecification) else one for one in made.inputs
        )
        return UnitSpecification(made.type, name, made.parameters, inputs, HERE)

    removed = draw(st.lists(removals, max_size=3))
    return Specification(tuple(map(named, inserted)), tuple(removed), "")


@given(specifications())
def test_a_printed_specification_is_parsed_again(specification: Specification) -> None:
    printed = format_specification(specification)
    assert parse_specification(printed) == specification
    assert parse_specification(printed.encode()) == specification
    # The XML declaration says UTF-8, so it goes for UTF-16.
    body = printed.partition("\n")[2]
    assert parse_specification(body.encode("utf-16")) == specification
    assert format_specification(parse_specification(printed)) == printed


def refuse_or_parse(text: str | bytes) -> None:
    """Nothing but these two, and the error has a place, a hint and a picture."""
    error = None
    try:
        specification = parse_specification(text)
    except LanguageError as caught:
        error = caught
    if error is None:
        assert parse_specification(format_specification(specification)) == specification
        return
    assert 0 <= error.span.start <= error.span.end <= len(error.source)
    assert error.hint
    # No names in libxml2's way, no place told twice.
    assert "{http" not in error.message
    assert not re.search(r"line \d", error.message)
    error.render().encode()


INPUTS = [
    path.read_text(encoding="utf-8").partition("\n")[2].partition("----\n")[0]
    for path in sorted(CASES.glob("*.case"))
]
PIECES = ["<", ">", "/", "&", ";", '"', "'", "=", " ", "\n", "<!--", "-->", "]]>", "<![CDATA["]
PIECES += ["<?xml ?>", "<?", "?>", "<!DOCTYPE a>", "&#0;", "&#99999999;", "xmlns:", 'xmlns:spec=""']
PIECES += ["spec:", "xml:", "xsi:", "\0", "\ufeff", "\ud800", "é", ":", "name", "type='a'", "<a/>"]
PIECES += ["<?xml version='1.0' encoding='utf-7'?>", 'xmlns:a="u" xmlns:b="u" a:c="" b:c=""']


@settings(max_examples=400)
@given(st.data())
def test_a_changed_text_is_parsed_or_refused(data: st.DataObject) -> None:
    text = data.draw(st.sampled_from(INPUTS))
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        end = min(len(text), start + data.draw(st.sampled_from([0, 0, 1, 5, 40, 10**6])))
        piece = data.draw(st.sampled_from(["", *PIECES]) | st.text(max_size=3))
        text = text[:start] + piece + text[end:]
    refuse_or_parse(text)


@given(st.sampled_from(INPUTS), st.sampled_from(["utf-8", "utf-16", "utf-16-be"]), st.data())
def test_changed_bytes_are_parsed_or_refused(text: str, codec: str, data: st.DataObject) -> None:
    changed = bytearray(text.encode(codec))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(changed)))
        changed[place : place + 1] = data.draw(st.binary(max_size=3))
    refuse_or_parse(bytes(changed))


@given(st.lists(st.sampled_from([*PIECES, "<a>", "</a>", "<a", "b='c'"]) | st.text(max_size=2)))
def test_any_text_is_parsed_or_refused(pieces: list[str]) -> None:
    refuse_or_parse("".join(pieces))


# Well-formed texts of the words of specifications, most of them wrong somewhere.
WORDS = ["specification", "insertions", "removals", "cu", "stream", "parameter", "unit"]
prefixes = st.sampled_from(["s:"] * 12 + ["", "o:"])
attributes = st.dictionaries(
    st.sampled_from(["name", "type", "value"] * 4 + ["typ", "s:name", "xml:base", "xsi:type"])
    | st.sampled_from(["xsi:nil", "xsi:schemaLocation"]),
    st.sampled_from(["a", "b", " a", "a ", "", " ", "a b", "9", "pos[1]", "é", "s:cu", "true"]),
    max_size=3,
)
fillings = st.sampled_from(
    [""] * 8 + [" ", "\n", "<!-- -->", "&#32;", "x", "<![CDATA[ ]]>", "&#65;"]
)


def element(word, prefix, given_attributes, children, filling) -> str:
    name = prefix + word
    written = "".join(f" {key}={quoteattr(value)}" for key, value in given_attributes.items())
    return f"<{name}{written}>{filling}{filling.join(children)}</{name}>"


def elements(words, children):
    return st.builds(element, st.sampled_from(words), prefixes, attributes, children, fillings)


leaves = elements(["cu"] * 3 + ["stream", "parameter"], st.just([]))
trees = st.recursive(
    leaves, lambda inner: elements(["cu"] * 6 + WORDS, st.lists(inner, max_size=3)), max_leaves=5
)
plain = st.just({})
parts = st.builds(
    element, st.sampled_from(["insertions"] * 3 + ["removals"] * 2 + WORDS), prefixes,
    plain | attributes, st.lists(trees, max_size=3), fillings,
)  # fmt: skip
bodies = st.lists(parts, max_size=2).map("".join)


def whole(body: str) -> str:
    xsi = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
    return f'<s:specification xmlns:s="{NAMESPACE}" xmlns:o="urn:o" {xsi}>{body}</s:specification>'


@settings(max_examples=500)
@given(bodies)
def test_the_rules_in_plain_words_are_those_of_the_schema(body: str) -> None:
    text = whole(body)
    document = read_document(scan(text))
    accepted = SCHEMA.validate(document.tree)
    assert (first_violation(document) is None) == accepted, (text, SCHEMA.error_log)
    refuse_or_parse(text)


ATTRIBUTES = [" name='a'", " type='a'", " value='a'", " name=''", " name=' a '", " type='a b'"]
ATTRIBUTES += [" typ='a'", " xml:lang='en'", ""]
FILLINGS = ["<spec:cu type='a'/>", "<spec:stream name='a'/>", "<spec:parameter name='a' value=''/>"]
FILLINGS += ["<cu type='a'/>", "<spec:unit/>", "<spec:removals/>", "x", " ", "<!-- x -->", "&#32;"]


@settings(max_examples=300)
@given(specifications(), st.data())
def test_the_rules_are_the_schemas_for_texts_that_are_nearly_right(
    specification: Specification, data: st.DataObject
) -> None:
    """One attribute is left out, changed or set to another of the text, or something is put in."""
    text = format_specification(specification)
    places = list(re.finditer(r' (?:name|type|value)="[^"]*"|(?<=[ "]/>)|(?<=[\w"]>)', text))
    place = data.draw(st.sampled_from(places))
    there = [match[0] for match in places if match[0]]
    puts = st.sampled_from([*there, *ATTRIBUTES] if place[0] else FILLINGS)
    text = text[: place.start()] + data.draw(puts) + text[place.end() :]
    try:
        document = read_document(scan(text))
    except LanguageError:
        # It may have an attribute twice.
        reject()
    assert (first_violation(document) is None) == SCHEMA.validate(document.tree), text
    refuse_or_parse(text)


@given(bodies)
def test_tags_and_attributes_are_where_they_are_said_to_be(body: str) -> None:
    text = whole(body)
    markup = scan(text)
    nodes = list(etree.fromstring(text).iter(etree.Element))
    assert len(markup.tags) == len(nodes)
    for element, node in zip(read_document(markup).elements, nodes, strict=True):
        tag = element.tag
        assert text[tag.span.start] == "<"
        assert text[tag.span.end - 1] == ">"
        assert text[tag.name_span.start : tag.name_span.end] == tag.name
        assert (element.namespace or None, element.name) == (
            etree.QName(node).namespace,
            etree.QName(node).localname,
        )
        for name, value in element.attributes.items():
            place = value.place
            assert text[place.span.start : place.span.end] == name
            assert text[place.value.start : place.value.end] == value.text == node.get(name)


@given(specifications())
def test_what_a_worker_says_is_what_it_read(specification: Specification) -> None:
    printed = format_specification(specification)
    read_there = parse_specification(printed)
    rows = decode(encode(rows_of(read_there)))
    read_here = specification_of(rows, printed)
    assert read_here == read_there
    # Places are no part of what is equal, and stand in messages.
    assert repr(read_here) == repr(read_there)


numbers = st.integers(-2, 9)
strange = st.lists(
    st.tuples(
        numbers, numbers, st.sampled_from(["", "t"]), st.none() | st.just("n"), numbers, numbers
    ),
    max_size=6,
)


@given(strange)
def test_of_strange_rows_nothing_is_made_or_what_says_them(rows: list[ElementRow]) -> None:
    try:
        made = specification_of(rows, "xxxx")
    except BadAnswer:
        return
    again = rows_of(made)
    assert len(again) == len(rows)
    assert specification_of(again, "xxxx") == made
