"""Query texts are parsed beside the event loop, which would stand still for a long one.

Their parsers remember the last texts (`languages.csparql`), so that the engine, which parses them
again, finds them read. How large a text may be is said in `languages.csparql.limits`.
"""

from __future__ import annotations

from collections.abc import Callable

import anyio
import anyio.to_thread

_TURN = anyio.CapacityLimiter(1)
"""The parser works one text at a time anyway."""


async def parse_aside(parse: Callable[[str], object], text: str) -> None:
    """Have ``parse`` read a text; raises what it raises, as the engine would."""
    await anyio.to_thread.run_sync(parse, text, limiter=_TURN)
