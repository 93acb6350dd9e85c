"""Event requests: ``dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)`` ([Events14 §IV.B, §V.C])."""

from __future__ import annotations

from collections.abc import Mapping

from pyoxigraph import Variable

from ...rdf.dictionary import Term
from ...rdf.namespaces import DYKNOW, PREFIXES
from ..errors import LanguageError, Span
from .ast import EventRequest
from .limits import check_length
from .terms import iri_text, read_term
from .tokens import Kind, Token, tokenize

_EXAMPLE = "write `dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)`"


def parse_event_request(source: str, prefixes: Mapping[str, str] = PREFIXES) -> EventRequest:
    """The event and its arguments, each a term or a variable that stays open. An event without a
    prefix is ``dyknow:``'s, as [Events14 §V.C] writes them.

    Raises `LanguageError` with the place of what is no event name, no argument or no prefix.
    """
    check_length(source)
    tokens = tokenize(source)
    if not tokens or tokens[0].kind not in (Kind.IRI, Kind.PREFIXED, Kind.WORD):
        found = f", not `{tokens[0].text}`" if tokens else ""
        raise _error(f"the name of an event is due{found}", source, tokens, 0, _EXAMPLE)
    if tokens[0].kind is Kind.WORD:
        event = DYKNOW + tokens[0].text
    else:
        event = iri_text(tokens[0], source, prefixes)
    if len(tokens) == 1 or not tokens[1].is_mark("("):
        raise _error("`(` is due after the event's name", source, tokens, 1, _EXAMPLE)
    arguments: list[Term | Variable] = []
    index = 2
    while index < len(tokens) and not tokens[index].is_mark(")"):
        argument, index = read_term(tokens, index, source, prefixes)
        arguments.append(argument)
        if index < len(tokens) and tokens[index].is_mark(","):
            index += 1
            if tokens[index].is_mark(")"):
                raise _error("an argument is due after `,`", source, tokens, index, _EXAMPLE)
        elif not tokens[index].is_mark(")"):
            raise _error(
                f"`,` or `)` is due, not `{tokens[index].text}`", source, tokens, index, _EXAMPLE
            )
    if index + 1 < len(tokens):
        text = tokens[index + 1].text
        raise _error(f"`{text}` stands behind the request", source, tokens, index + 1)
    return EventRequest(event, tuple(arguments), source)


def parse_argument(text: str, prefixes: Mapping[str, str] = PREFIXES) -> Term | Variable:
    """One argument: ``?o``, ``dyknow:UAV``, ``100``, ``"x"@en``, ``<iri>``, ``true``, ``1.5e3``.

    Raises `LanguageError` if the text is not exactly one.
    """
    check_length(text)
    tokens = tokenize(text)
    if not tokens:
        raise _error("an argument is due", text, tokens, 0, "write a term, or a variable: `?o`")
    argument, index = read_term(tokens, 0, text, prefixes)
    if index < len(tokens):
        found = tokens[index].text
        raise _error(
            f"`{found}` stands behind the argument",
            text,
            tokens,
            index,
            'a text stands in quotes: `"two words"`',
        )
    return argument


def _error(
    message: str, source: str, tokens: tuple[Token, ...], index: int, hint: str = ""
) -> LanguageError:
    end = len(source.rstrip())
    span = tokens[index].span if index < len(tokens) else Span(end, end)
    return LanguageError(message, source, span, hint)
