"""Arguments of requests, and the defaults that a template gives them ([Events14 §IV.B]).

A default is written as an argument is: ``REGISTER TEMPLATE dyknow:Fast(?o, ?limit = 100) AS …``.
All languages of bodies read it here, with the tokens and terms of SPARQL.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from pyoxigraph import Literal, NamedNode, Variable

from ..rdf.dictionary import Term
from ..rdf.namespaces import PREFIXES, XSD, shorten
from ..sparql.cursor import Cursor
from .errors import LanguageError, Span

Argument: TypeAlias = Term | Variable
"""A term, or a variable, which leaves its parameter free."""
PARAMETERS: Final = r'\((?>"(?:[^"\\\r\n]|\\.)*"|<[^<>\s]*>|(?:#|//)[^\n\r]*|[^()"#])*\)'
"""A regular expression for the parameters of a template in their parentheses. Cost: linear in the
text, since each alternative is atomic and an unclosed text or bracket ends the match."""

_SHORT: Final = {
    XSD + "integer": re.compile(r"[+-]?[0-9]+"),
    XSD + "decimal": re.compile(r"[+-]?[0-9]+\.[0-9]+"),
    XSD + "double": re.compile(r"[+-]?[0-9]+(?:\.[0-9]+)?[eE][+-]?[0-9]+"),
    XSD + "boolean": re.compile(r"true|false"),
}
"""The literals that SPARQL can write without quotes and datatype."""


@dataclass(frozen=True, slots=True)
class Default:
    """The argument of a parameter that a request leaves out, and its place in the text."""

    value: Argument
    span: Span = field(compare=False)

    def __str__(self) -> str:
        """The default as the printers of templates write it: IRIs have no prefix."""
        return str(self.value) if isinstance(self.value, NamedNode) else argument_text(self.value)


Defaults: TypeAlias = tuple[Default | None, ...]
"""The defaults of the parameters of a template, in order; None: a parameter without one."""
DEFAULT_HINT: Final = (
    'a default is an argument as of a request, without a unit: `100`, `"10s"`, `dyknow:UAV`, `?x`'
)


def default_at(at: Cursor) -> Default:
    """Read the default at a cursor. Raises `LanguageError`."""
    start = len(at.source) if at.here is None else at.here.start
    value = at.term()
    return Default(value, Span(start, at.last_token.end))


def default_in(source: str, span: Span, prefixes: Mapping[str, str]) -> Default:
    """Read the default that stands at a place of a text. Raises `LanguageError`."""
    try:
        # The spaces keep the places of the errors.
        at = Cursor(" " * span.start + source[span.start : span.end], {**PREFIXES, **prefixes})
        found = default_at(at)
        if at.here is not None:
            raise at.error(
                f"`{at.text_of(at.here)}` follows the default",
                at.here,
                DEFAULT_HINT,
            )
    except LanguageError as error:
        raise LanguageError(error.message, source, error.span, error.hint) from None
    return found


def check_order(names: Sequence[tuple[str, Span]], defaults: Defaults, source: str) -> None:
    """Refuse a parameter without a default after one with a default. ``names``: the parameters and
    their places. Raises `LanguageError`."""
    before: str | None = None
    for (name, span), default in zip(names, defaults, strict=True):
        if default is not None:
            before = name
        elif before is not None:
            raise LanguageError(
                f"`?{name}` has no default, and `?{before}` before it has one",
                source,
                span,
                f"write `?{name}` first, or give it a default, too",
            )


def argument_text(argument: Argument) -> str:
    """Write an argument as in the text of a request; parsing it gives the same term."""
    if isinstance(argument, Literal):
        pattern = _SHORT.get(argument.datatype.value)
        if pattern is not None and pattern.fullmatch(argument.value):
            return argument.value
    text = str(argument)
    return shorten(text[1:-1]) if text.startswith("<") else text
