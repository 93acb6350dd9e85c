"""Functions that are called by their IRI: the accessors of time, and casts (SPEC §5).

``f:timestamp`` is the C-SPARQL engine's: τ, when a triple became known; ``dyknow-o:validTime`` is
ours. Of one variable they tell the time of the triple that binds it, of three terms that of the
triple ``(s, p, o)``. They are no SPARQL 1.1, so no engine looks after them: their calls are checked
here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Final

from pyoxigraph import NamedNode, Variable

from ...rdf.namespaces import PREFIXES, STREAM_SPACE, XSD
from ..errors import LanguageError, Span
from ..hints import did_you_mean
from .terms import iri_text, read_term
from .tokens import Kind, Token, closing, tokenize

TIMESTAMP: Final = "http://larkc.eu/csparql/sparql/jena/ext#timestamp"
VALID_TIME: Final = STREAM_SPACE + "validTime"
ACCESSORS: Final = (TIMESTAMP, VALID_TIME)
UNCALLED: Final[dict[NamedNode, Callable[..., Any]]] = {
    NamedNode(iri): lambda *_: None for iri in ACCESSORS
}
"""The accessors as functions for Oxigraph, which has to read their calls, but never makes one."""

QUERY_PREFIXES: Final[Mapping[str, str]] = {
    **PREFIXES,
    "f": TIMESTAMP.removesuffix("timestamp"),
}
"""Prefixes that need no declaration in a query text: the shared ones and the C-SPARQL engine's."""

# SPARQL 1.1 §17.1, then those that Oxigraph has besides.
_CASTS: Final = (
    *("boolean", "dateTime", "decimal", "double", "float", "integer", "string"),
    *("date", "time", "duration", "dayTimeDuration", "yearMonthDuration"),
    *("gDay", "gMonth", "gMonthDay", "gYear", "gYearMonth"),
)
_KNOWN: Final = ("f:timestamp", "dyknow-o:validTime", *(f"xsd:{name}" for name in _CASTS))
_IRIS: Final = frozenset({*ACCESSORS, *(XSD + name for name in _CASTS)})
# Oxigraph has functions of GeoSPARQL, and says itself which.
_GEOSPARQL: Final = "http://www.opengis.net/def/function/geosparql/"


def calls(tokens: Sequence[Token]) -> Iterator[int]:
    """The indexes of IRIs that are called.

    In an expression an IRI before ``(`` is a function, in a pattern a predicate whose object is a
    collection. Expressions are in brackets behind FILTER, BIND or a function, and in the head and
    the modifiers of a query.
    """
    expression = [True]
    for index, token in enumerate(tokens):
        if token.is_mark("{", "[", "("):
            expression.append(_opens_expression(tokens, index, expression[-1]))
        elif token.is_mark("}", "]", ")"):
            expression.pop()
        elif not _is_name(token) or index + 1 == len(tokens) or not tokens[index + 1].is_mark("("):
            continue
        elif expression[-1] or (index and tokens[index - 1].is_word("FILTER")):
            yield index


def _is_name(token: Token) -> bool:
    return token.kind in (Kind.IRI, Kind.PREFIXED)


def _opens_expression(tokens: Sequence[Token], index: int, inside: bool) -> bool:
    token, before = tokens[index], tokens[index - 1] if index else None
    if token.is_mark("{"):
        # The head and the modifiers of a sub-query; its WHERE is a bracket of its own.
        return index + 1 < len(tokens) and tokens[index + 1].is_word("SELECT")
    if token.is_mark("["):
        return False
    if inside or before is None:
        return True
    if before.kind is Kind.WORD:
        return not before.is_word("VALUES", "A")
    return _is_name(before) and index > 1 and tokens[index - 2].is_word("FILTER")


def check_functions(
    text: str, prefixes: Mapping[str, str], base: str, source: str, shift: int = 0
) -> None:
    """Raise `LanguageError` for a function that nobody has, or an accessor's wrong arguments.

    An offset in ``text`` plus ``shift`` is the offset in ``source``.
    """
    tokens = tokenize(text)
    for index in calls(tokens):
        token = tokens[index]
        place = Span(token.start + shift, token.end + shift)
        try:
            iri = iri_text(token, text, prefixes, base)
        except LanguageError as error:
            raise LanguageError(error.message, source, place, error.hint) from None
        if iri in ACCESSORS:
            message = _wrong_arguments(tokens, index, text, prefixes)
            if message:
                name = token.text
                hint = f"write `{name}(?x)` or `{name}(?s, ?p, ?o)`"
                raise LanguageError(f"`{name}` {message}", source, place, hint)
        elif iri not in _IRIS and not iri.startswith(_GEOSPARQL):
            hint = did_you_mean(token.text, _KNOWN) or (
                "known are f:timestamp, dyknow-o:validTime and casts like xsd:integer"
            )
            raise LanguageError(f"the function `{token.text}` is not known", source, place, hint)


def _wrong_arguments(
    tokens: Sequence[Token], index: int, text: str, prefixes: Mapping[str, str]
) -> str:
    """What is wrong with the arguments of an accessor; "" if nothing is."""
    arguments = _arguments(tokens, index + 1)
    if len(arguments) not in (1, 3):
        return f"takes 1 or 3 arguments, not {len(arguments)}"
    variables = 0
    for argument in arguments:
        try:
            term, end = read_term(argument, 0, text, prefixes)
        except LanguageError:
            return "takes variables and terms, no expressions"
        if end < len(argument):
            return "takes variables and terms, no expressions"
        variables += isinstance(term, Variable)
    if not variables:
        return "takes a variable" if len(arguments) == 1 else "takes at least one variable"
    return ""


def _arguments(tokens: Sequence[Token], open: int) -> list[Sequence[Token]]:
    """The tokens of each argument in the brackets at ``open``; an empty one is a token of none."""
    close = closing(tokens, open)
    arguments: list[Sequence[Token]] = []
    start = index = open + 1
    while index < close:
        if tokens[index].is_mark("(", "{", "["):
            index = closing(tokens, index)
        elif tokens[index].is_mark(","):
            arguments.append(tokens[start:index])
            start = index + 1
        index += 1
    if start < close:
        arguments.append(tokens[start:close])
    # SPARQL allows no empty argument, and its syntax has been checked.
    return [argument for argument in arguments if argument]
