"""Event requests: ``dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)`` ([Events14 §IV.B, §V.C])."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pyoxigraph import Variable

from ...rdf.namespaces import DYKNOW, PREFIXES
from ...sparql.cursor import Cursor
from ...sparql.tokens import Kind
from ..arguments import Argument
from .ast import EventRequest
from .limits import check_length

_EXAMPLE = "write `dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)`"


def parse_event_request(source: str) -> EventRequest:
    """Parse an event and its arguments, each a term or a free variable. The last ones may name
    their parameters: ``?threshold = 100``. An event without a prefix belongs to ``dyknow:``, as in
    [Events14 §V.C].

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
    arguments: list[Argument] = []
    named: list[tuple[str, Argument]] = []
    while not at.is_mark(")"):
        _read_argument(at, arguments, named)
        if at.accept_mark(","):
            if at.is_mark(")"):
                raise at.error("expected an argument after `,`", at.here, _EXAMPLE)
        elif not at.is_mark(")"):
            raise at.expected("`,` or `)`", _EXAMPLE)
    at.take()
    if at.here is not None:
        raise at.error(f"`{at.text_of(at.here)}` follows the request", at.here)
    return EventRequest(event, tuple(arguments), source, tuple(named))


def request_of(event: str, texts: Sequence[str]) -> EventRequest:
    """Return the request of an event (an IRI) with the texts of its arguments, as in
    `parse_event_request`. Raises `LanguageError`."""
    arguments: list[Argument] = []
    named: list[tuple[str, Argument]] = []
    for text in texts:
        at = _begun(text)
        _read_argument(at, arguments, named)
        _check_end(at)
    source = f"{event}({', '.join(texts)})"
    return EventRequest(event, tuple(arguments), source, tuple(named))


def parse_argument(text: str, prefixes: Mapping[str, str] = PREFIXES) -> Argument:
    """Parse one argument: ``?o``, ``dyknow:UAV``, ``100``, ``"x"@en``, ``<iri>``, ``true``,
    ``1.5e3``.

    Raises `LanguageError` if the text is anything else.
    """
    at = _begun(text, prefixes)
    argument = at.term()
    _check_end(at)
    return argument


def _begun(text: str, prefixes: Mapping[str, str] = PREFIXES) -> Cursor:
    check_length(text)
    at = Cursor(text, prefixes)
    if at.at_end:
        raise at.error("expected an argument", None, "write a term, or a variable: `?o`")
    return at


def _check_end(at: Cursor) -> None:
    if at.here is not None:
        raise at.error(
            f"`{at.text_of(at.here)}` follows the argument",
            at.here,
            'put a text in quotes: `"two words"`',
        )


def _read_argument(
    at: Cursor, arguments: list[Argument], named: list[tuple[str, Argument]]
) -> None:
    """Read an argument, or one with the name of its parameter."""
    first = at.here
    argument = at.term()
    if isinstance(argument, Variable) and at.accept_mark("="):
        if any(name == argument.value for name, _ in named):
            raise at.error(f"{argument} is given twice", first, "leave one of the two out")
        named.append((argument.value, at.term()))
    elif named:
        raise at.error(
            "an argument without a name follows one with a name",
            first,
            "write it first, or name its parameter: `?threshold = 100`",
        )
    else:
        arguments.append(argument)
