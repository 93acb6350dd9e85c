"""A printed chronicle can be read, and is the same; other texts have errors with a place."""

import re
from random import Random

from chronicle_texts import ChronicleTexts
from chronicle_worlds import ChronicleWorld, vocabulary
from hypothesis import given
from hypothesis import strategies as st

from dyknow.languages.chronicle import (
    check_chronicle,
    format_chronicle,
    format_chronicle_template,
    is_chronicle,
    parse_chronicle,
    parse_chronicle_template,
)
from dyknow.languages.errors import LanguageError
from dyknow.reasoning.patterns.compilation.chronicle_plans import chronicle_query

VOCABULARY = vocabulary()
PIECES = """?x ?v ? t0 t1 t9 event noevent hold occurs when emit in oo true 3 3s 1e9 40000d a uav1
speed near Seen Car Nobody "q" ( ) [ ] { } : ; , - + < <= != = [kt] <http://a.org/b> # // é"""


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


@given(st.integers(0, 2**32))
def test_a_changed_text_has_a_meaning_or_an_error_with_a_place(seed: int) -> None:
    draw = Random(seed)
    text = ChronicleWorld(seed).text
    for _ in range(draw.randint(1, 3)):
        old = draw.choice(list(re.finditer(r"[A-Za-z0-9_?]+|\S|$", text)))
        text = text[: old.start()] + draw.choice([*PIECES.split(), "", "\0"]) + text[old.end() :]
    error = None
    try:
        chronicle = parse_chronicle(text)
        assert parse_chronicle(format_chronicle(chronicle)) == chronicle
        chronicle_query(check_chronicle(chronicle, text, VOCABULARY), text, VOCABULARY)
    except LanguageError as found:
        error = found
    assert error is None or 0 <= error.span.start <= len(text)
