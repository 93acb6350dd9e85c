"""Turtle as the papers print it ([Introspection15 Listings 2 and 3]).

Two liberties are taken there: no prefix is declared, ``:`` meaning the stream-space ontology, and
a datatype may be a bare name, ``"fusionRGBIR"^^string``. `to_standard_turtle` makes standard Turtle of it;
standard Turtle stays what it is.
"""

from __future__ import annotations

import re
from typing import Final

from ..rdf.namespaces import PREFIXES, STREAM_SPACE, XSD

ALL_PREFIXES: Final[dict[str, str]] = {**PREFIXES, "": STREAM_SPACE}
"""What needs no declaration: the shared prefixes, and ``:`` for the stream space."""

_HEADER: Final = " ".join(f"@prefix {p}: <{iri}> ." for p, iri in ALL_PREFIXES.items()) + "\n"
HEADER_LINES: Final = 1
"""How many lines `to_standard_turtle` puts before the text: parsers count them too."""

# Strings, IRIs and comments are matched first so that nothing inside them is rewritten. What is not
# closed goes on to its end: tried again at each quote in it, it would cost the square.
_TOKEN: Final = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"""|\Z)'
    r"|'''(?:[^'\\]|\\.|'(?!''))*+(?:'''|\Z)"
    r'|"(?:[^"\\\n]|\\.)*+"?'
    r"|'(?:[^'\\\n]|\\.)*+'?"
    r"|<[^<>\s]*+>"
    r"|#[^\n]*"
    r"|\^\^(?P<bare>string|integer|decimal|double|float|boolean|dateTime)(?![\w:.-]*:)\b",
    re.DOTALL,
)


def to_standard_turtle(text: str) -> str:
    """Standard Turtle for ``text``: `HEADER_LINES` lines of prefixes, then the text.

    A text that declares a prefix itself overrides the one in the header.
    """
    return _HEADER + _TOKEN.sub(_standard, text)


def _standard(match: re.Match[str]) -> str:
    bare = match["bare"]
    return match[0] if bare is None else f"^^<{XSD}{bare}>"
