"""A chronicle that is printed can be read, and is the same."""

from chronicle_texts import ChronicleTexts
from hypothesis import given
from hypothesis import strategies as st

from dyknow.languages.chronicle import (
    format_chronicle,
    format_chronicle_template,
    is_chronicle,
    parse_chronicle,
    parse_chronicle_template,
)


@given(st.integers(0, 2**32))
def test_parse_of_print(seed: int) -> None:
    chronicle = ChronicleTexts(seed).chronicle()
    text = format_chronicle(chronicle)
    assert is_chronicle(text)
    assert parse_chronicle(text) == chronicle


@given(st.integers(0, 2**32))
def test_parse_of_printed_template(seed: int) -> None:
    template = ChronicleTexts(seed).template()
    text = format_chronicle_template(template)
    assert is_chronicle(text)
    assert parse_chronicle_template(text) == template
