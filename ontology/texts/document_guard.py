"""Bounds on RDF texts of strangers, checked in one pass before a parser reads the text.

The parsers behind `reading` recurse: some thousand levels of brackets overflow their stack, which
kills the process. Entities can make a short text expand to a long one.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

from ..errors import OntologyError
from .turtle import OPAQUE

DEEPEST: Final = 100
"""The greatest depth of nested brackets or elements."""
LONGEST_EXPANSION: Final = 16 * 1024 * 1024
"""The greatest number of characters that the entities of a text may expand to."""

# An open string extends to the end of the text. Trying again at each quote within it would cost
# quadratic time.
_JSON: Final = re.compile(r'"(?:[^"\\]|\\.)*+"?|[\[\]{}]', re.DOTALL)
# Strings, IRIs and comments match first, so that their contents do not count.
_TURTLE: Final = re.compile(OPAQUE + r"|<<|[\[\](){}]", re.DOTALL)
_XML: Final = re.compile(
    r"<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<\?.*?(?:\?>|\Z)"
    r"|<(?P<end>/)?[^\s<>/!?](?:[^<>\"']|\"[^\"]*+(?:\"|\Z)|'[^']*+(?:'|\Z))*+>?",
    re.DOTALL,
)
MOST_ENTITIES: Final = 100
_ENTITY: Final = re.compile(r"<!ENTITY\s++(%?)\s*+([^\s%]++)\s++(?:\"([^\"]*)\"|'([^']*)'|(\w+))")
_OPENING: Final = frozenset("[({")


def check_document(text: str, format: str) -> None:
    """Raise `OntologyError` for a text that nests too deeply or expands too far. Cost: one pass."""
    _CHECKS[format](text)


def _json(text: str) -> None:
    depth = 0
    for match in _JSON.finditer(text):
        depth = _next_depth(depth, match[0], text, match.start())


def _turtle(text: str) -> None:
    depth = 0
    for match in _TURTLE.finditer(text):
        if match[0] == "<<":
            line, column = _place(text, match.start())
            raise OntologyError("triples about triples (RDF 1.2) are not supported", line, column)
        depth = _next_depth(depth, match[0], text, match.start())


def _next_depth(depth: int, token: str, text: str, position: int) -> int:
    """Return the depth after a token. Tokens of one character are brackets, or open quotes."""
    if token in _OPENING:
        if depth == DEEPEST:
            raise _too_deep("brackets", text, position)
        return depth + 1
    return depth - 1 if token in ("]", ")", "}") else depth


def _xml(text: str) -> None:
    expanded = 0
    declared = _ENTITY.findall(text)
    if len(declared) > MOST_ENTITIES:
        raise OntologyError(f"the text declares more than {MOST_ENTITIES} entities")
    for parameter, name, double, single, external in declared:
        value = double or single
        line, column = _place(text, text.index(name))
        if parameter or external:
            raise OntologyError(
                f"the entity {name} is an external or a parameter entity",
                line,
                column,
                'declare the text itself: <!ENTITY name "text">',
            )
        if "&" in value:
            raise OntologyError(f"the entity {name} refers to other entities", line)
        expanded += len(value) * text.count(f"&{name};")
        if expanded > LONGEST_EXPANSION:
            raise OntologyError(
                f"the entities expand to more than {LONGEST_EXPANSION} characters", line, column
            )
    depth = 0
    for match in _XML.finditer(text):
        tag = match[0]
        if tag.startswith(("<!", "<?")) or tag.endswith("/>"):
            continue
        if match["end"]:
            depth -= 1
        elif depth == DEEPEST:
            raise _too_deep("elements", text, match.start())
        else:
            depth += 1


def _too_deep(what: str, text: str, position: int) -> OntologyError:
    line, column = _place(text, position)
    return OntologyError(f"{what} are nested more than {DEEPEST} deep", line, column)


def _place(text: str, position: int) -> tuple[int, int]:
    return text.count("\n", 0, position) + 1, position - text.rfind("\n", 0, position)


_CHECKS: Final[dict[str, Callable[[str], None]]] = {
    "turtle": _turtle,
    "ntriples": _turtle,
    "jsonld": _json,
    "rdfxml": _xml,
}
