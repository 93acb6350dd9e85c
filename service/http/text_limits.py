"""Texts are bounded and parsed beside the event loop, which would stand still for a long one.

The parsers remember the last texts, so that the engine, which parses them again, finds them read.
What the engine then does for each declaration it does while everybody waits: so these are bounded,
too. How large a query text may be is said in `languages.csparql.limits`.
"""

from __future__ import annotations

from collections.abc import Callable, Sized
from typing import Final

import anyio
import anyio.to_thread

from ...languages.csparql import body_tree, parse_query, parse_template
from ...languages.kpl import parse_kpl
from ...languages.kpl.ast import Specification
from ...languages.ssl import parse_ssl
from ...languages.ssl.ast import Declaration
from ...templates.patterns import patterns
from ..config.text_bounds import LONGEST, MOST_DECLARATIONS, MOST_WORDS, words
from .problems import Problem

IN_PARTS: Final = (
    "send it in several parts, each behind what it needs: dyknow.Client, `dyknow annotate`, "
    "`dyknow kpl add` and `dyknow specification apply` do so by themselves"
)
"""What is said of a text that is too long."""
_QUERIES = anyio.CapacityLimiter(1)
"""Their parser works one text at a time anyway."""
_DECLARATIONS = anyio.CapacityLimiter(1)
"""A turn of their own: the longest query takes seconds, these a tenth of one."""


def check_length(body: bytes) -> None:
    """Raises a 413 `Problem` for a text that is longer than one of its language may be."""
    if len(body) > LONGEST:
        raise too_long(f"{LONGEST} bytes")


async def read_ssl(text: str) -> tuple[Declaration, ...]:
    """The declarations of an SSL text; raises `LanguageError`, and a 413 `Problem` for more of
    them than one text may have."""
    _check_words(text)
    found = await anyio.to_thread.run_sync(parse_ssl, text, limiter=_DECLARATIONS)
    check_number(found)
    return found


async def read_kpl(text: str) -> Specification:
    """The same of a KPL text."""
    _check_words(text)
    found = await anyio.to_thread.run_sync(parse_kpl, text, limiter=_DECLARATIONS)
    check_number(found.declarations)
    return found


def check_number(declared: Sized) -> None:
    """Raises a 413 `Problem` for more than one request may declare."""
    if len(declared) > MOST_DECLARATIONS:
        raise too_long(f"{MOST_DECLARATIONS} declarations")


def too_long(most: str) -> Problem:
    """What is said of a text that has more than ``most``."""
    return Problem(
        413,
        "text too long",
        f"such a text has at most {most}",
        hint=IN_PARTS,
    )


async def parse_aside(parse: Callable[[str], object], text: str) -> None:
    """Have ``parse`` read a query text; raises what it raises, as the engine would."""
    await anyio.to_thread.run_sync(parse, text, limiter=_QUERIES)


def parse_registration(text: str) -> None:
    """Parse a template, and what registering it reads of it: for `parse_aside`."""
    body_tree(parse_template(text).query)


def parse_continuous(text: str) -> None:
    """The same of a continuous query."""
    patterns(body_tree(parse_query(text)))


def _check_words(text: str) -> None:
    for number, _ in enumerate(words(text), 1):
        if number > MOST_WORDS:
            raise too_long(f"{MOST_WORDS} words and signs")
