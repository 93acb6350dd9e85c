"""What is wrong with a text that Oxigraph's parser refuses, in words that help.

The parser says how far it got and what could have come there, of which most is of no help: it
tries a keyword by taking as many characters as that has, if there are so many, and tells the place
after them. So it is asked again with room behind the text, the keyword is counted back, and the
word that stands there is told. Called by `query_guard` with a text that it has found no fault in.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final

ROOM: Final = "\n" + 40 * " "
"""More than the longest keyword has."""
_PLACE: Final = re.compile(r"^error at (\d+):(\d+): ")
_KEYWORD: Final = re.compile(r"\b[A-Za-z]+(?:_[A-Z]+)*\b")
# Whole sentences among what was expected: rules of SPARQL that are no matter of its grammar.
_SENTENCE: Final = re.compile(r"(?:The|IRI|Invalid)(?: [\w']+){2,}")
_WORD: Final = re.compile(
    r"<[^<>\s]*>?|\"(?:[^\"\\\n]|\\.)*\"?|'(?:[^'\\\n]|\\.)*'?|[?$@]?[\w.:-]*\w|\S", re.DOTALL
)
_SPACE: Final = re.compile(r"(?:\s|#[^\n]*)*")
_CLOSING: Final = {")": "(", "]": "[", "}": "{"}
_STRINGS_AND_IRIS: Final = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*"""|\'\'\'(?:[^\'\\]|\\.|\'(?!\'\'))*\'\'\''
    r'|"(?:[^"\\\n]|\\.)*"|\'(?:[^\'\\\n]|\\.)*\'|<[^<>"{}|^`\\\s]*>|#[^\n]*',
    re.DOTALL,
)
HINT: Final = "the text before it is understood; look at what should follow there"


def explained(text: str, message: str, parse: Callable[[str], None]) -> tuple[str, int, str]:
    """What is wrong with ``text``, the offset of the place, and what to do next. ``message`` is
    that of the parser, ``parse``, which raises ``SyntaxError``. Cost: a parse."""
    sentence = _SENTENCE.search(message)
    if sentence is not None:
        offset = max(0, text.upper().find("SELECT"))
        return f"no SPARQL query: {sentence[0]}", offset, "see the SPARQL 1.1 recommendation"
    bracket = _unbalanced(text)
    if bracket is not None:
        sign = text[bracket]
        if sign in "\"'":
            said, hint = "this text in quotes is never closed", f"close it with {sign}"
        elif sign in _CLOSING:
            said, hint = f"this `{sign}` closes nothing", "leave it out, or open it before"
        else:
            said, hint = f"this `{sign}` is never closed", "close it"
        return f"no SPARQL query: {said}", bracket, hint
    try:
        parse(text + ROOM)
    except SyntaxError as error:
        message = str(error)
    offset = _offset(text + ROOM, message)
    word = _WORD.match(text, offset)
    if word is None:
        return (
            "no SPARQL query: something is missing at the end of the text",
            len(text.rstrip()),
            "such as SELECT * { ?s ?p ?o } LIMIT 10",
        )
    shown = word[0] if len(word[0]) <= 40 else f"{word[0][:40]}…"
    return f"no SPARQL query: `{shown}` cannot stand here", offset, HINT


def _offset(text: str, message: str) -> int:
    place = _PLACE.match(message)
    if place is None:
        return 0
    start = 0
    for _ in range(int(place[1]) - 1):
        start = text.find("\n", start) + 1
    offset = min(start + int(place[2]) - 1, len(text))
    tried = re.sub(r"^expected (one of )?", "", message[place.end() :]).replace("[_]", "")
    keywords = _KEYWORD.findall(tried)
    if keywords and not _KEYWORD.sub("", tried).replace(",", "").strip():
        offset = max(0, offset - min(map(len, keywords)))
    space = _SPACE.match(text, offset)
    return offset if space is None else space.end()


def _unbalanced(text: str) -> int | None:
    """Where a bracket or quote stands that has no other one."""
    blank = _STRINGS_AND_IRIS.sub(lambda match: " " * len(match[0]), text)
    opened: list[int] = []
    for offset, sign in enumerate(blank):
        if sign in "([{":
            opened.append(offset)
            continue
        closes = sign in _CLOSING and opened and blank[opened.pop()] == _CLOSING[sign]
        if sign in "\"'" or (sign in _CLOSING and not closes):
            return offset
    return opened[-1] if opened else None
