"""Event requests: ``dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)`` ([Events14 §IV.B, §V.C])."""

from __future__ import annotations

from pyoxigraph import Variable

from ...rdf.dictionary import Term
from ...rdf.namespaces import DYKNOW, PREFIXES
from ...sparql.cursor import Cursor
from ...sparql.tokens import Kind
from .ast import EventRequest
from .limits import check_length

_EXAMPLE = "write `dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)`"


def parse_event_request(source: str) -> EventRequest:
    """Parse an event and its arguments, each a term or a free variable. An event without a prefix
    belongs to ``dyknow:``, as in [Events14 §V.C].

    Raises `LanguageError` with the place of a malformed name or argument, or an unknown prefix.
    """
    check_length(source)
    at = Cursor(source, PREFIXES)
    name = at.here
    if name is None or name.kind not in (Kind.IRI, Kind.PREFIXED, Kind.WORD):
        found = "" if name is None else f", found `{at.text_of(name)}`"
        raise at.error(f"expected the name of an event{found}", name, _EXAMPLE)
    at.take()
    event = DYKNOW + name.text if name.kind is Kind.WORD else at.iri_of(name)
    if not at.accept_mark("("):
        raise at.error("expected `(` after the event's name", at.here, _EXAMPLE)
    arguments: list[Term | Variable] = []
    while not at.is_mark(")"):
        arguments.append(at.term())
        if at.accept_mark(","):
            if at.is_mark(")"):
                raise at.error("expected an argument after `,`", at.here, _EXAMPLE)
        elif not at.is_mark(")"):
            raise at.expected("`,` or `)`", _EXAMPLE)
    at.take()
    if at.here is not None:
        raise at.error(f"`{at.text_of(at.here)}` follows the request", at.here)
    return EventRequest(event, tuple(arguments), source)


def parse_argument(text: str) -> Term | Variable:
    """Parse one argument: ``?o``, ``dyknow:UAV``, ``100``, ``"x"@en``, ``<iri>``, ``true``,
    ``1.5e3``.

    Raises `LanguageError` if the text is anything else.
    """
    check_length(text)
    at = Cursor(text, PREFIXES)
    if at.at_end:
        raise at.error("expected an argument", None, "write a term, or a variable: `?o`")
    argument = at.term()
    if at.here is not None:
        raise at.error(
            f"`{at.text_of(at.here)}` follows the argument",
            at.here,
            'put a text in quotes: `"two words"`',
        )
    return argument
