"""Names of streams and fields from the names in files: letters, digits and ``_``."""

from __future__ import annotations

import re
from collections.abc import Collection


def valid_name(text: str, prefix: str) -> str:
    """``text`` as a name of letters, digits and ``_``; ``prefix`` unless it begins with a letter.

    ``q[0]`` is ``q_0``.
    """
    name = re.sub(r"[^A-Za-z0-9_]+", "_", text.rstrip("]"))
    return name if re.match(r"[A-Za-z]", name) else f"{prefix}_{name.lstrip('_')}"


def distinct(name: str, taken: Collection[str]) -> str:
    """``name``, followed by ``_2``, ``_3`` … if it is ``taken``."""
    found, number = name, 1
    while found in taken:
        number += 1
        found = f"{name}_{number}"
    return found
