"""Limits of texts, and parsing them in a thread: a long text would block the event loop.

The parsers cache the last texts: the engine, which parses them again, takes them from the cache.
The engine does its work for each declaration on the event loop, so a request has a limited number
of them. `languages.csparql.limits` has the limits of query texts.
"""

from __future__ import annotations

from collections.abc import Callable, Sized
from typing import Final

import anyio
import anyio.to_thread

from ...engine.planning.registrations import parse_registered
from ...languages.csparql import body_tree
from ...languages.csparql.ast import ContinuousQuery, Template
from ...languages.kpl import parse_kpl
from ...languages.kpl.ast import Specification
from ...languages.ssl import parse_ssl
from ...languages.ssl.ast import Declaration
from ...languages.templates import parse_any_template
from ...templates.patterns import patterns
from ..config.text_bounds import LONGEST, MOST_DECLARATIONS, MOST_WORDS, words
from .problems import Problem

IN_PARTS: Final = (
    "send it in several parts, each behind what it needs: dyknow.Client, `dyknow annotate`, "
    "`dyknow kpl add` and `dyknow specification apply` do so by themselves"
)
"""The hint for a text that is too long."""
_QUERIES = anyio.CapacityLimiter(1)
"""One text at a time: a parser holds the interpreter."""
_DECLARATIONS = anyio.CapacityLimiter(1)
"""Apart from queries: the longest query takes seconds, these a tenth of one."""


def check_length(body: bytes) -> None:
    """Raises a 413 `Problem` for a text with more than `LONGEST` bytes."""
    if len(body) > LONGEST:
        raise too_long(f"{LONGEST} bytes")


async def read_ssl(text: str) -> tuple[Declaration, ...]:
    """Parse an SSL text. Raises `LanguageError`, and a 413 `Problem` for too many declarations."""
    _check_words(text)
    found = await anyio.to_thread.run_sync(parse_ssl, text, limiter=_DECLARATIONS)
    check_number(found)
    return found


async def read_kpl(text: str) -> Specification:
    """Parse a KPL text. Raises as `read_ssl`."""
    _check_words(text)
    found = await anyio.to_thread.run_sync(parse_kpl, text, limiter=_DECLARATIONS)
    check_number(found.declarations)
    return found


def check_number(declared: Sized) -> None:
    """Raises a 413 `Problem` for more declarations than a request may have."""
    if len(declared) > MOST_DECLARATIONS:
        raise too_long(f"{MOST_DECLARATIONS} declarations")


def too_long(most: str) -> Problem:
    """The problem of a text with more than ``most``."""
    return Problem(
        413,
        "text too long",
        f"such a text has at most {most}",
        hint=IN_PARTS,
    )


async def parse_aside(parse: Callable[[str], object], text: str) -> None:
    """Run ``parse`` on a query text in a thread. Raises the errors that the engine would raise."""
    await anyio.to_thread.run_sync(parse, text, limiter=_QUERIES)


def parse_registration(text: str) -> None:
    """Parse a template, and its body as registering it does: for `parse_aside`."""
    template = parse_any_template(text)
    if isinstance(template, Template):
        body_tree(template.query)


def parse_continuous(text: str) -> None:
    """Parse a text as registering it does: for `parse_aside`."""
    parsed = parse_registered(text)
    if isinstance(parsed, ContinuousQuery):
        patterns(body_tree(parsed))


def _check_words(text: str) -> None:
    for number, _ in enumerate(words(text), 1):
        if number > MOST_WORDS:
            raise too_long(f"{MOST_WORDS} words and signs")
