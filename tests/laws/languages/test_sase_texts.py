"""Printing and parsing undo each other for any text of SASE+."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st
from sase_drawing import TextDrawing

from dyknow.languages.sase import (
    format_sase,
    format_sase_template,
    is_sase,
    parse_sase,
    parse_sase_template,
)


@settings(deadline=None, max_examples=400)
@given(st.integers(0, 2**32))
def test_what_is_printed_is_read_back(seed: int) -> None:
    drawing = TextDrawing(seed)
    pattern, template = drawing.pattern(), drawing.template()
    texts = format_sase(pattern), format_sase_template(template)
    assert parse_sase(texts[0]) == pattern
    assert parse_sase_template(texts[1]) == template
    assert all(map(is_sase, texts))
