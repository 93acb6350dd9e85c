"""Defaults of the parameters of templates, in every language of bodies."""

from __future__ import annotations

import pytest
from default_drawing import VALUES

from dyknow.languages.arguments import Default, argument_text
from dyknow.languages.chronicle import format_chronicle_template
from dyknow.languages.csparql import parse_argument, parse_event_request, request_of
from dyknow.languages.epsparql.printer import format_epsparql
from dyknow.languages.errors import LanguageError, Span
from dyknow.languages.mtl.printer import format_formula_template
from dyknow.languages.sase import format_sase_template
from dyknow.languages.templates import parse_any_template

BODIES = {
    "C-SPARQL": "CONSTRUCT { ?o dyknow:speed ?s } "
    "WHERE { ?o dyknow:speed ?s FILTER (?s > ?limit) } WINDOW [RANGE 5s STEP 1s]",
    "formula": "always [0s, 2s] speed(?o) < ?limit [km.h-1]",
    "chronicle": "chronicle X(?o) { event(speed[?o]:(?, > ?limit), t); }",
    "SASE+": "PATTERN SEQ(speed a, speed b) WHERE [id = ?o] AND b.v > ?limit WITHIN 1 second",
    "EP-SPARQL": "SELECT ?o WHERE { ?o dyknow:speed ?v FILTER (?v > ?limit) } SEQ "
    "{ ?o dyknow:speed 3 } WITHIN 5 s",
}
PRINTERS = {
    "formula": format_formula_template,
    "chronicle": format_chronicle_template,
    "SASE+": format_sase_template,
    "EP-SPARQL": format_epsparql,
}
languages = pytest.mark.parametrize("language", BODIES)


def template(language: str, parameters: str) -> str:
    return f"REGISTER TEMPLATE dyknow:X({parameters}) AS {BODIES[language]}"


def default(value: object) -> Default:
    return Default(value, Span(0, 0))  # type: ignore[arg-type]


@languages
@pytest.mark.parametrize("value", VALUES, ids=str)
def test_a_default_is_any_argument(language: str, value: object) -> None:
    text = argument_text(value)  # type: ignore[arg-type]
    if text.startswith("dyknow:uav-"):
        text = str(value)
    found = parse_any_template(template(language, f"?o, ?limit = {text}"))
    assert found.defaults == (None, default(value))
    assert [parameter.value for parameter in found.parameters] == ["o", "limit"]
    assert found.defaults[1] is not None
    span = found.defaults[1].span
    assert found.source[span.start : span.end] == text
    if language in PRINTERS:
        printed = PRINTERS[language](found)  # type: ignore[operator]
        assert parse_any_template(printed).defaults == found.defaults


@languages
def test_brackets_in_texts_and_comments_are_no_brackets(language: str) -> None:
    head = '?o = <http://x.org/a#(b)>, # a (comment "\n ?limit = "(\\")"'
    found = parse_any_template(template(language, head))
    assert str(found.defaults[0]) == "<http://x.org/a#(b)>"
    assert str(found.defaults[1]) == '"(\\")"'


@languages
@pytest.mark.parametrize(
    ("head", "column", "message"),
    [
        ("?o = ?o, ?limit", 37, "`?limit` has no default, and `?o` before it has one"),
        ("?o, ?limit = ", 41, "`)` is not"),
        ("?o, ?limit = car1", 41, "`car1` is not a term"),
        ("?o, ?limit = 10 s", 44, "`s`"),
        ("?o, ?limit = 100 [km.h-1]", 45, "`[`"),
        ("?o, ?limit = nowhere:x", 41, "nowhere"),
    ],
)
def test_a_wrong_default_has_a_place(language: str, head: str, column: int, message: str) -> None:
    with pytest.raises(LanguageError) as error:
        parse_any_template(template(language, head))
    assert (error.value.line, error.value.column) == (1, column)
    assert message in error.value.message
    assert error.value.hint


@pytest.mark.parametrize("language", ["formula", "chronicle", "SASE+"])
def test_only_an_equals_sign_precedes_a_default(language: str) -> None:
    with pytest.raises(LanguageError, match="`<` is not allowed here"):
        parse_any_template(template(language, "?o, ?limit < 3"))


def test_arguments_may_name_their_parameters() -> None:
    text = "dyknow:X(?o, dyknow:UAV, ?limit = 100, ?time = ?t)"
    request = parse_event_request(text)
    assert list(map(str, request.arguments)) == ["?o", "<http://www.ida.liu.se/dyknow/UAV>"]
    assert [(name, str(value)) for name, value in request.named] == [
        ("limit", str(parse_argument("100"))),
        ("time", "?t"),
    ]
    texts = ["?o", "dyknow:UAV", "?limit = 100", "?time = ?t"]
    same = request_of("http://www.ida.liu.se/dyknow/X", texts)
    assert (same.arguments, same.named) == (request.arguments, request.named)


@pytest.mark.parametrize(
    ("text", "column", "message"),
    [
        ("X(?limit = 1, ?o)", 15, "an argument without a name follows one with a name"),
        ("X(?a = 1, ?a = 2)", 11, "?a is given twice"),
        ("X(?a = )", 8, "is not a term"),
    ],
)
def test_wrong_names_have_a_place(text: str, column: int, message: str) -> None:
    with pytest.raises(LanguageError) as error:
        parse_event_request(text)
    assert error.value.column == column
    assert message in error.value.message
