"""Query texts are parsed beside the event loop, which would stand still for a long one.

Their parsers remember the last texts (`languages.csparql`), so that the engine, which parses them
again, finds them read. How large a text may be is said in `languages.csparql.limits`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import anyio
import anyio.to_thread

from .problems import Problem

LONGEST: Final = 128 * 1024
"""Bytes of a text in SSL, KPL or XML: the engine parses it while everybody waits, and takes up to a
second for so much."""
_TURN = anyio.CapacityLimiter(1)
"""The parser works one text at a time anyway."""


def check_length(body: bytes) -> None:
    """Raises a 413 `Problem` for a text that is longer than one of its language may be."""
    if len(body) > LONGEST:
        raise Problem(
            413,
            "text too long",
            f"such a text has at most {LONGEST} bytes",
            hint="send it in several parts",
        )


async def parse_aside(parse: Callable[[str], object], text: str) -> None:
    """Have ``parse`` read a text; raises what it raises, as the engine would."""
    await anyio.to_thread.run_sync(parse, text, limiter=_TURN)
