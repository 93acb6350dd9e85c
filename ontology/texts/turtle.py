"""Accepts Turtle as the papers print it ([Introspection15 Listings 2 and 3]).

The papers deviate from the standard in two ways. They declare no prefix, and ``:`` means the
stream-space ontology. A datatype may be a bare name: ``"fusionRGBIR"^^string``.
`to_standard_turtle` converts both; standard Turtle stays unchanged.
"""

from __future__ import annotations

import re
from typing import Final

from ...rdf.namespaces import PREFIXES, STREAM_SPACE, XSD

ALL_PREFIXES: Final[dict[str, str]] = {**PREFIXES, "": STREAM_SPACE}
"""Prefixes that need no declaration: the shared ones, and ``:`` for the stream space."""

_HEADER: Final = " ".join(f"@prefix {p}: <{iri}> ." for p, iri in ALL_PREFIXES.items()) + "\n"
HEADER_LINES: Final = 1
"""Lines that `to_standard_turtle` adds before the text; the line numbers of parsers
include them."""

# Strings, IRIs and comments match first, so that their contents stay unchanged. An open string
# extends to the end: trying again at each quote within it would cost quadratic time.
OPAQUE: Final = (
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"""|\Z)'
    r"|'''(?:[^'\\]|\\.|'(?!''))*+(?:'''|\Z)"
    r'|"(?:[^"\\\n]|\\.)*+"?'
    r"|'(?:[^'\\\n]|\\.)*+'?"
    r"|<[^<>\s]*+>"
    r"|#[^\n]*+"
)
"""Matches a string, an IRI or a comment of Turtle."""
_TOKEN: Final = re.compile(
    OPAQUE + r"|\^\^(?P<bare>string|integer|decimal|double|float|boolean|dateTime)(?![\w:.-]*:)\b",
    re.DOTALL,
)


def to_standard_turtle(text: str) -> str:
    """Return ``text`` as standard Turtle: `HEADER_LINES` lines of prefixes, then the text.

    A prefix that the text declares itself overrides the one in the header.
    """
    return _HEADER + _TOKEN.sub(_standard, text)


def _standard(match: re.Match[str]) -> str:
    bare = match["bare"]
    return match[0] if bare is None else f"^^<{XSD}{bare}>"
