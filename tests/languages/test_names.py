"""Names that people give have at most 200 characters, in every language, and labels 1,000."""

from collections.abc import Callable

import pytest

from dyknow.languages.csparql import parse_query, parse_template
from dyknow.languages.errors import LanguageError
from dyknow.languages.kpl import parse_kpl
from dyknow.languages.specification import parse_specification
from dyknow.languages.ssl import parse_ssl

SPECIFICATION = (
    '<specification xmlns="http://www.dyknow.eu/ontology#Specification"><insertions>'
    '<cu name="{}" type="a"/></insertions></specification>'
)
SELECT = "COMPUTE EVERY 1s AS SELECT ?o WHERE {{ ?o a ?t }} WINDOW [RANGE 5s STEP 1s]"


@pytest.mark.parametrize(
    ("parse", "text"),
    [
        (parse_ssl, "stream {} contains speed(UAV) = v for every UAV = id"),
        (parse_ssl, "stream s contains speed({}) = v"),
        (parse_ssl, "stream s contains speed(car1) = {}"),
        (parse_ssl, "stream s contains speed(car1) = v [{}]"),
        (parse_kpl, "source float {}"),
        (parse_kpl, "source float s\nstrmgen {} = s"),
        (parse_kpl, "strmgen pos[{}] = s"),
        (parse_specification, SPECIFICATION),
        (parse_query, f"REGISTER QUERY {{}} {SELECT}"),
    ],
)
def test_a_name_has_200_characters(parse: Callable[[str], object], text: str) -> None:
    parse(text.format("a" * 200))
    with pytest.raises(LanguageError) as caught:
        parse(text.format("a" * 201))
    at = len(text.format("\0").partition("\0")[0])
    assert caught.value.span.start == at
    assert "20" in caught.value.message


def test_the_first_long_name_is_told() -> None:
    with pytest.raises(LanguageError) as caught:
        parse_kpl(f"source float {'a' * 300}\nsource float {'b' * 400}")
    assert caught.value.line == 1
    assert caught.value.message == "a name has at most 200 characters, and this one has 300"


def test_an_object_in_quotes_has_a_name_too() -> None:
    with pytest.raises(LanguageError, match="at most 200"):
        parse_kpl(f'strmgen pos["{"a " * 100}"] = s')


def test_a_label_has_1000_characters() -> None:
    def label(count: int) -> str:
        return f"strmgen pos[{', '.join(f'car{i:06}' for i in range(count))}] = s"

    parse_kpl(label(90))
    with pytest.raises(LanguageError, match="a label has at most 1000") as caught:
        parse_kpl(label(100))
    assert caught.value.span.start == len("strmgen ")


def test_the_iri_of_an_event_has_1000_characters() -> None:
    def template(name: str) -> str:
        return f"REGISTER TEMPLATE <http://x.org/{name}>(?o) {SELECT.format()}"

    parse_template(template("a" * 900))
    with pytest.raises(LanguageError, match="the IRI has more than 1000") as caught:
        parse_template(template("a" * 1000))
    assert caught.value.span.start == len("REGISTER TEMPLATE ")
