"""Hints: the known name that was probably meant. What the languages share of them."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def did_you_mean(name: str, candidates: Iterable[str]) -> str:
    """``did you mean a or b?`` from the names near ``name``; empty if none is."""
    suggest_name = difflib.get_close_matches(name, sorted(set(candidates)), n=3)
    return f"did you mean {' or '.join(suggest_name)}?" if suggest_name else ""


def suggest_name(name: str, candidates: Iterable[str]) -> str:
    """The same; where nothing is near, some of what there is."""
    names = sorted(set(candidates))
    if not names:
        return "none is declared yet: declare it first"
    listed = ", ".join(names[:8]) + (" …" if len(names) > 8 else "")
    return did_you_mean(name, names) or f"known are {listed}"


def count(number: int, what: str) -> str:
    """``1 input``, ``2 inputs``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
