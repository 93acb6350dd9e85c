"""Specifications in XML: what they say, and what is refused ([Introspection15 §3.2, Listing 1]).

Most errors are golden cases (`tests/cases/specification`); here is what a text file cannot show.
"""

import os
import re
from pathlib import Path

import pytest
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
    parser,
)
from dyknow.languages.specification.decoding import MAX_BYTES
from dyknow.languages.specification.markup import MAX_DEPTH, NAMESPACE

HERE = Span(0, 0)
PAGE = ROOT / "docs" / "reference" / "specifications.md"
CASES = TESTS / "cases" / "specification"
XSD = Path(parser.__file__).with_name("specification.xsd")


def whole(body: str, before: str = "") -> str:
    return f'{before}<spec:specification xmlns:spec="{NAMESPACE}">{body}</spec:specification>'


def insertions(body: str) -> str:
    return whole(f"<spec:insertions>{body}</spec:insertions>")


def unit(
    type: str, *inputs: UnitSpecification | StreamReference, name: str | None = None
) -> UnitSpecification:
    return UnitSpecification(type, name, (), inputs, HERE)


def refused(text: str | bytes) -> LanguageError:
    with pytest.raises(LanguageError) as caught:
        parse_specification(text)
    error = caught.value
    assert error.hint
    # Whatever is wrong, it can be shown.
    error.render().encode()
    assert 0 <= error.span.start <= error.span.end <= len(error.source)
    return error


def listing_1() -> str:
    return (CASES / "listing1.case").read_text().partition("\n")[2].partition("----\n")[0]


# -- what it says ------------------------------------------------------------------------------


def test_listing_1() -> None:
    fusion = unit("fusionRGBIR", unit("rgbCam"), unit("irCam"))
    result = unit("project2Dto3D", fusion, unit("GPSto3D", unit("gps")), name="result")
    specification = parse_specification(listing_1())
    assert specification == Specification((result,), (), "")
    assert specification.source == listing_1()


def test_listing_1_with_the_line_breaks_of_its_print_in_the_schema_location() -> None:
    text = listing_1()
    assert "ontology#\n      Specification\n  http://www.dyknow.eu/config.xsd" in text
    # They do not matter, for what is named there is not read.
    assert parse_specification(text.replace("config.xsd", "\n")) == parse_specification(text)


def test_every_part() -> None:
    text = whole(
        '<spec:removals><spec:cu name="pos[car 1]"/><spec:cu type=" gps "/></spec:removals>'
        '<spec:insertions><spec:cu type="a" name="x"><spec:stream name=" positions"/>'
        '<spec:parameter name="baseline" value=" 5s "/><spec:cu type="b"/></spec:cu>'
        "</spec:insertions>"
    )
    made = UnitSpecification(
        "a",
        "x",
        (Parameter("baseline", " 5s "),),
        (StreamReference("positions", HERE), unit("b")),
        HERE,
    )
    removals = (Removal("pos[car 1]", None, HERE), Removal(None, "gps", HERE))
    assert parse_specification(text) == Specification((made,), removals, "")


def test_spans_are_of_start_tags() -> None:
    text = insertions(
        '<spec:cu\n type="a"><!-- <spec:cu> --><spec:cu type="a"/>'
        '<spec:stream name="s"></spec:stream><spec:parameter name="p" value=">"/></spec:cu>'
    )
    specification = parse_specification(text)
    (made,) = specification.insertions
    spans = [made.span, *(part.span for part in made.inputs), made.parameters[0].span]
    assert [text[span.start : span.end] for span in spans if span] == [
        '<spec:cu\n type="a">',
        '<spec:cu type="a"/>',
        '<spec:stream name="s">',
        '<spec:parameter name="p" value=">"/>',
    ]


def test_a_part_may_be_left_out_or_empty() -> None:
    nothing = Specification((), (), "")
    for body in ("", "<spec:insertions/>", "<spec:removals> </spec:removals><spec:insertions/>"):
        assert parse_specification(whole(body)) == nothing


def test_names_of_what_there_is_are_any_text() -> None:
    name = 'pos["car  1"]\n/status é'
    text = insertions(f'<spec:cu type="a"><spec:stream name="{name}"/></spec:cu>')
    written = text.replace('["', "[&quot;").replace('"]', "&quot;]").replace("\n", "&#10;")
    assert parse_specification(written).insertions[0].inputs == (StreamReference(name, HERE),)


def test_comments_sections_and_instructions_say_nothing() -> None:
    text = "<!-- <!DOCTYPE a> --><?go <x>?>" + insertions(
        '<!-- & --><spec:cu type="a"><![CDATA[\n]]><?go?><!----></spec:cu><?go &no;?>'
    )
    assert parse_specification(text + "<!-- </a> -->\n<?go?>\n").insertions == (unit("a"),)


def test_windows_line_ends() -> None:
    text = listing_1().replace("\n", "\r\n")
    assert parse_specification(text) == parse_specification(listing_1())
    assert refused(text.replace("irCam", "")).line == 16


# -- how it is encoded -------------------------------------------------------------------------

ACCENTED = insertions('<spec:cu type="a"><spec:parameter name="p" value="é€𝄞"/></spec:cu>')
DECLARED = '<?xml version="1.0" encoding="{}"?>\n'


@pytest.mark.parametrize(
    ("declared", "codec"),
    [
        ("", "utf-8"),
        ("", "utf-8-sig"),
        ("", "utf-16"),
        ("", "utf-16-le"),
        ("", "utf-16-be"),
        ("UTF-8", "utf-8"),
        ("utf8", "utf-8-sig"),
        ("UTF-16", "utf-16"),
        ("UTF-16", "utf-16-be"),
    ],
)
def test_bytes(declared: str, codec: str) -> None:
    text = (DECLARED.format(declared) if declared else "") + ACCENTED
    specification = parse_specification(text.encode(codec))
    assert specification.insertions[0].parameters == (Parameter("p", "é€𝄞"),)
    assert specification.source == text


def test_characters_are_what_they_are_whatever_a_str_declares() -> None:
    for text in (DECLARED.format("ISO-8859-1") + ACCENTED, "\ufeff" + ACCENTED):
        assert parse_specification(text) == parse_specification(ACCENTED)
        # The span counts in the source, which has no byte order mark.
        assert parse_specification(text).source == text.removeprefix("\ufeff")


@pytest.mark.parametrize(
    ("text", "place", "message"),
    [
        (
            (DECLARED.format("ISO-8859-1") + ACCENTED[:-150]).encode("latin-1", "replace"),
            (1, 31),
            "the encoding `ISO-8859-1` is not supported",
        ),
        (
            (DECLARED.format("UTF-16") + ACCENTED).encode(),
            (1, 31),
            "the text is UTF-8, but declares the encoding `UTF-16`",
        ),
        (
            (DECLARED.format("utf-8") + ACCENTED).encode("utf-16"),
            (1, 31),
            "the text is UTF-16, but declares the encoding `utf-8`",
        ),
        (ACCENTED.encode("utf-32"), (1, 1), "the encoding `UTF-32` is not supported"),
        (ACCENTED.encode("utf-32-be"), (1, 1), "the encoding `UTF-32` is not supported"),
        (whole("\né\n").encode("latin-1"), (2, 1), "these bytes are not UTF-8"),
        (whole("\n é").encode("utf-16") + b"\0", (2, 24), "these bytes are not UTF-16"),
        (b"Lo\xa7\x94", (1, 3), "these bytes are not UTF-8"),
        (whole("\n \0"), (2, 2), "U+0000 is not an XML character"),
        (whole("\n \0").encode(), (2, 2), "U+0000 is not an XML character"),
        (whole("\n \ud800"), (2, 2), "U+D800 is not an XML character"),
        (whole("\n \uffff"), (2, 2), "U+FFFF is not an XML character"),
        (b"", (1, 1), "the text contains no specification"),
    ],
)
def test_what_is_no_text(text: str | bytes, place: tuple[int, int], message: str) -> None:
    error = refused(text)
    assert (error.line, error.column, error.message) == (*place, message)


# -- hostile texts -----------------------------------------------------------------------------


def test_a_million_laughs_are_not_heard() -> None:
    entities = "".join(f'<!ENTITY l{n} "{f"&l{n - 1};" * 10}">' for n in range(1, 10))
    document = f'<!DOCTYPE a [<!ENTITY l0 "ha">{entities}]>'
    error = refused(whole("&l9;", document))
    assert (error.message, error.line, error.column) == ("a DOCTYPE is refused", 1, 1)


def test_no_file_is_read(tmp_path: Path) -> None:
    secret = tmp_path / "secret"
    secret.write_text("secret")
    for document in (
        f'<!DOCTYPE a [<!ENTITY e SYSTEM "{secret.as_uri()}">]>',
        f'<!DOCTYPE a SYSTEM "{secret.as_uri()}">',
        f'\n<!-- a --> <!doctype a [<!ENTITY % e SYSTEM "{secret.as_uri()}"> %e;]>',
    ):
        error = refused(whole("&e;", document))
        assert error.message == "a DOCTYPE is refused"
        assert error.span.start == document.lower().index("<!doctype")


def test_schemas_that_the_text_names_are_not_read(tmp_path: Path) -> None:
    # Nobody writes into the pipe, so whoever opened it would wait for ever.
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    xsi = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
    for named in (
        f'{xsi} xsi:schemaLocation="{NAMESPACE} {pipe.as_uri()}"',
        f'{xsi} xsi:noNamespaceSchemaLocation="{pipe.as_uri()}"',
        f'{xsi} xsi:schemaLocation="no pair"',
    ):
        text = insertions(f'<spec:cu {named} type="a"/>')
        assert parse_specification(text).insertions == (unit("a"),)


def test_many_siblings() -> None:
    assert len(parse_specification(insertions("<spec:cu type='a'/>" * 20_000)).insertions) == 20_000
    wrong = "<spec:cu/>" * 20_000
    assert refused(insertions(wrong)).message == "`cu` has no `type`"


def test_depth_is_bounded() -> None:
    def nested(depth: int) -> str:
        return insertions('<spec:cu type="a">' * depth + "</spec:cu>" * depth)

    deepest = parse_specification(nested(MAX_DEPTH - 2))
    # What is read can be compared, shown and printed where the stack is this deep already.
    assert deepest == parse_specification(format_specification(deepest))
    assert repr(deepest).count("UnitSpecification") == MAX_DEPTH - 2
    for depth in (MAX_DEPTH - 1, 10_000):
        error = refused(nested(depth))
        assert error.message == f"elements are nested more than {MAX_DEPTH} deep"
        assert nested(depth)[: error.span.start].count("<spec:") == MAX_DEPTH


def test_a_value_deeper_than_any_text_can_be_printed() -> None:
    deep = unit("a")
    for _ in range(5000):
        deep = unit("a", deep)
    text = format_specification(Specification((deep,), (), ""))
    assert text.count("</spec:cu>") == 5000


@pytest.mark.parametrize("text", ["x" * (MAX_BYTES + 1), "é" * (MAX_BYTES // 2 + 1), b"<" * 10**7])
def test_size_is_bounded(text: str | bytes) -> None:
    error = refused(text)
    assert "and at most 2,097,152 are read" in error.message
    assert error.source == ""


@pytest.mark.parametrize(
    "text",
    [
        "<!--" * 400_000,
        "<![CDATA[" * 200_000,
        "<?" * 1_000_000,
        "<a " + " " * 2_000_000,
        "<a " + "x" * 2_000_000,
        '<a b="' * 300_000,
        "<a" + ' b=""' * 300_000,
        "<a>" + "&" * 1_000_000,
        "<a><b" * 300_000,
        "&a" * 1_000_000,
        whole("<spec:insertions/>" * 100_000),
        insertions(f'<spec:cu type="{"a" * 2_000_000}!"/>'),
        whole("\n" * 1_000_000 + "<spec:insertions>&#0;"),
    ],
    ids=lambda text: text[:10],
)
def test_broken_texts_cost_no_more_than_their_length(text: str) -> None:
    # A square of the length would take hours.
    assert len(refused(text).message) < 200


def test_lines_beyond_those_that_libxml2_counts() -> None:
    error = refused(whole("\n" * 100_000 + "  <spec:insertion/>"))
    assert (error.line, error.column) == (100_001, 4)
    error = refused(whole("\n" * 100_000 + "é<x:a/>"))
    assert (error.line, error.column) == (100_001, 3)


# -- the schema --------------------------------------------------------------------------------


def test_the_schema_has_the_last_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parser, "first_violation", lambda document: None)
    error = refused(whole("<spec:insertions>\n<spec:cu/></spec:insertions>"))
    assert error.message.startswith("the schema refuses the text: ")
    assert "line 2" in error.hint


def test_the_schema_says_what_each_thing_is() -> None:
    schema = etree.parse(str(XSD)).getroot()
    xs = "{http://www.w3.org/2001/XMLSchema}"
    assert schema.get("targetNamespace") == NAMESPACE
    for kind in ("element", "simpleType"):
        for declared in schema.iter(xs + kind):
            text = declared.findtext(f"{xs}annotation/{xs}documentation")
            assert (text or "").strip(), declared.get("name")


# -- printing ----------------------------------------------------------------------------------


def test_what_xml_cannot_hold_is_not_printed() -> None:
    made = UnitSpecification("a", None, (Parameter("p", "\0"),), (), HERE)
    with pytest.raises(ValueError, match="a character that XML cannot hold"):
        format_specification(Specification((made,), (), ""))


# -- the page ----------------------------------------------------------------------------------


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(), re.DOTALL)


def test_the_examples_of_the_page() -> None:
    (example,) = blocks("xml")
    assert format_specification(parse_specification(example)) == example
    for code in blocks("python"):
        exec(code, {})
    (error,) = blocks("text")
    text = insertions('\n\n    <spec:cu name="result" typ="gps"/>\n')
    assert refused(text).render() == error.rstrip()


def test_the_page_names_all_of_the_schema() -> None:
    schema = etree.parse(str(XSD)).getroot()
    xs = "{http://www.w3.org/2001/XMLSchema}"
    for kind in ("element", "attribute"):
        for declared in schema.iter(xs + kind):
            assert f"| `{declared.get('name')}` |" in PAGE.read_text()
