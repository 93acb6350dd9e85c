"""Names of streams and fields made of what files call them: letters, digits and ``_``."""

from __future__ import annotations

import re
from collections.abc import Collection


def valid_name(text: str, prefix: str) -> str:
    """``text`` as a name of letters, digits and ``_``; ``prefix`` where it begins with no letter.

    ``q[0]`` is ``q_0``.
    """
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text.rstrip("]"))
    return name if re.match(r"[A-Za-z]", name) else f"{prefix}_{name.lstrip('_')}"


def distinct(name: str, taken: Collection[str]) -> str:
    """``name``, with ``_2``, ``_3`` … after it when it is ``taken``."""
    found, number = name, 1
    while found in taken:
        number += 1
        found = f"{name}_{number}"
    return found
