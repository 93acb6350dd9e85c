"""SPARQL 1.1 by rdflib and Oxigraph: syntax errors with their place, and the algebra.

rdflib's parser gives the algebra that `continuous` plans from. It is not thread-safe on first
use, so it stands behind a lock. Its text is made from our tokens: it would expand tabs, resolve
``\\u`` escapes before it knows what a string is, and count offsets in the result; here every
escape is resolved first and offsets are mapped back.
"""

from __future__ import annotations

import re
import threading
from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pyoxigraph import Literal
from pyparsing import ParseBaseException

from ...rdf.namespaces import PREFIXES
from ...rdf.sparql import check_sparql
from ..errors import LanguageError, Span
from ..remembered import remembered
from .functions import UNCALLED
from .terms import iri_text, string_text, term_text
from .tokens import Kind, Token, tokenize

if TYPE_CHECKING:
    from rdflib.plugins.sparql.sparql import Query

_LOCK: Final = threading.RLock()
_TERM_KINDS: Final = frozenset({Kind.IRI, Kind.PREFIXED, Kind.VARIABLE, Kind.STRING, Kind.NUMBER})
_KEYWORD: Final = re.compile(r"\b(?:[A-Z][A-Z_0-9]+|is[A-Z]\w+|has[A-Z]\w+|sameTerm)\b")
_OXIGRAPH_PLACE: Final = re.compile(r"error at (\d+):(\d+): ")


@dataclass(frozen=True, slots=True)
class _Rendered:
    """Text for rdflib, and for each piece of it where it begins here and in the source."""

    text: str
    here: tuple[int, ...]
    there: tuple[int, ...]

    def source_offset(self, offset: int) -> int:
        piece = bisect_right(self.here, offset) - 1
        if piece < 0:
            return 0
        # A piece may be longer here than in the source (an IRI for a prefixed name).
        after = self.there[piece + 1] if piece + 1 < len(self.there) else self.there[piece] + 1
        return min(self.there[piece] + offset - self.here[piece], max(after - 1, 0))


def _rendered(text: str) -> _Rendered:
    parts: list[str] = []
    here: list[int] = []
    there: list[int] = []
    length = 0
    position = 0

    def put(piece: str, origin: int) -> None:
        nonlocal length
        here.append(length)
        there.append(origin)
        parts.append(piece)
        length += len(piece)

    prefixes = _prefixes(text)
    before: Token | None = None
    for token in tokenize(text):
        # Gaps hold comments and tabs; neither means anything to the parser.
        put(re.sub(r"#[^\r\n]*", "", text[position : token.start]).replace("\t", " "), position)
        is_declared = before is not None and before.is_word("PREFIX")
        put(token.text if is_declared else _rendered_token(token, text, prefixes), token.start)
        position = token.end
        before = token
    # A failure at the end belongs behind the last token.
    put(" ", position)
    return _Rendered("".join(parts), tuple(here), tuple(there))


def _prefixes(text: str) -> dict[str, str]:
    """Prefix -> namespace as the text declares them, and the shared ones."""
    prefixes = dict(PREFIXES)
    tokens = tokenize(text)
    for word, name, iri in zip(tokens, tokens[1:], tokens[2:], strict=False):
        if word.is_word("PREFIX") and name.kind is Kind.PREFIXED and iri.kind is Kind.IRI:
            prefixes[name.text[:-1]] = iri.text[1:-1]
    return prefixes


def _rendered_token(token: Token, text: str, prefixes: Mapping[str, str]) -> str:
    """Strings with every escape resolved; prefixed names in full, since rdflib forgets a prefix
    when a second one is declared for its namespace.
    """
    if token.kind is Kind.PREFIXED:
        try:
            return f"<{iri_text(token, text, prefixes)}>"
        except LanguageError:
            # Relative to a BASE, or of a prefix that stands outside this stretch of the text.
            return token.text
    if token.kind is not Kind.STRING:
        return token.text
    value = string_text(token, text)
    # `\U00000075` is for readers that resolve escapes first; here nothing does.
    return term_text(Literal(value)).replace("\\U00000075", "u").replace("\\U00000055", "U")


def _parsed(text: str) -> object:
    """rdflib's parse tree, a new one each time: translating changes it in place.

    Raises pyparsing's or rdflib's own errors.
    """
    # Importing the grammar takes a second; only who parses pays for it.
    from rdflib.plugins.sparql import parser

    with _LOCK:
        return parser.Query.parse_string(_rendered(text).text, parse_all=True)


def check_syntax(text: str, source: str, shift: int = 0) -> None:
    """Raise `LanguageError` with a place in ``source`` if ``text`` is no SPARQL 1.1 query.

    An offset in ``text`` plus ``shift`` is the offset in ``source``.
    """
    try:
        _parsed(text)
        return
    except ParseBaseException as error:
        offset = max(_rendered(text).source_offset(error.loc), _oxigraph_offset(text))
    except RecursionError:
        span = Span(0, len(source))
        raise LanguageError("the query is nested too deeply to be read", source, span) from None
    except Exception as error:  # noqa: BLE001 - rdflib raises bare Exceptions from parse actions
        place = min(max(shift, 0), len(source))
        raise LanguageError(f"no SPARQL: {error}", source, Span(place, place)) from None
    raise _syntax_error(text, source, offset, shift)


def _syntax_error(text: str, source: str, offset: int, shift: int) -> LanguageError:
    tokens = tokenize(text)
    index = next((i for i, token in enumerate(tokens) if token.end > offset), len(tokens))
    if index == len(tokens):
        place = min(max(shift + (tokens[-1].end if tokens else 0), 0), len(source))
        return LanguageError(
            "the query ends too early", source, Span(place, place), "something is still missing"
        )
    token = tokens[index]
    before = tokens[index - 1] if index else None
    hint = "the text before it is understood; look at what should follow there"
    if before is not None and {token.kind, before.kind} <= _TERM_KINDS:
        hint = "is a `.` missing before it, to end the triple?"
    elif token.is_mark("}"):
        hint = "something is missing before the `}`: is a triple incomplete?"
    if token.is_word("STREAM", "ON"):
        hint = "name streams with `FROM STREAM <iri> […]` or `FROM NAMED WINDOW :w ON <iri> […]`"
    start = min(max(token.start + shift, 0), len(source))
    end = min(max(token.end + shift, start), len(source))
    # As written: a WINDOW group stands in the text as GRAPH.
    word = source[start:end]
    shown = word if len(word) <= 40 else word[:40] + "…"
    return LanguageError(f"`{shown}` cannot stand here", source, Span(start, end), hint)


def _oxigraph_offset(text: str) -> int:
    """A place that Oxigraph's parser gets to: rdflib's names the start of a FILTER or BIND only.

    Oxigraph tries a keyword by taking as many characters as it has, and reports the place after
    them; so where only keywords were tried, the shortest of them is counted back.
    """
    try:
        check_sparql(text, PREFIXES)
    except SyntaxError as error:
        place = _OXIGRAPH_PLACE.match(str(error))
        if place is None:
            return 0
        line, column = int(place[1]), int(place[2])
        start = 0
        for _ in range(line - 1):
            start = text.find("\n", start) + 1
        offset = min(start + column - 1, len(text))
        tried = re.sub(r"^expected (one of )?", "", str(error)[place.end() :]).replace("[_]", "")
        keywords = _KEYWORD.findall(tried)
        if keywords and not _KEYWORD.sub("", tried).replace(",", "").strip():
            offset = max(0, offset - min(map(len, keywords)))
        return offset if offset < len(text.rstrip()) else 0
    except (ValueError, RuntimeError, OSError):
        return 0
    return 0


def check_meaning(text: str, source: str, span: Span, prefixes: Mapping[str, str]) -> None:
    """Raise `LanguageError` at ``span`` if a text of right syntax is refused by an engine.

    Both are asked because either may evaluate it: rdflib for the algebra, Oxigraph per window.
    """
    try:
        check_sparql(text, prefixes, UNCALLED)
    except SyntaxError as error:
        reason = _OXIGRAPH_PLACE.sub("", str(error))
        known = [r for r in _REASONS if r in reason]
        said = _REASONS[known[0]] if known else "the query is not valid SPARQL 1.1"
        raise LanguageError(said, source, span, "" if known else reason[:200]) from None
    try:
        translated(text)
    except RecursionError:
        raise LanguageError("the query is nested too deeply to be read", source, span) from None
    except Exception as error:  # noqa: BLE001 - rdflib raises bare Exceptions from translation
        raise LanguageError(f"no SPARQL: {error}", source, span) from None


_NOT_GROUPED: Final = "SELECT names a variable that is neither grouped nor aggregated"
_REASONS: Final = {
    "The SELECT contains a variable that is unbound": _NOT_GROUPED,
    "The SELECT contains an expression with a variable that is unbound": _NOT_GROUPED,
}


@remembered
def translated(text: str) -> Query:
    """rdflib's algebra of a SPARQL 1.1 text; one object a text, so do not change it."""
    from rdflib.plugins.sparql.algebra import translateQuery

    with _LOCK:
        return translateQuery(_parsed(text))  # type: ignore[arg-type]
