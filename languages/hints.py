"""Hints that suggest similar names, shared by the languages."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence


def did_you_mean(name: str, candidates: Iterable[str]) -> str:
    """Return ``did you mean a or b?`` with the names similar to ``name``; empty if there
    is none."""
    return meant(difflib.get_close_matches(name, sorted(set(candidates)), n=3))


def meant(near: Sequence[str]) -> str:
    """Return ``did you mean a or b?``; empty for no name."""
    return f"did you mean {' or '.join(near)}?" if near else ""


def suggest_name(name: str, candidates: Iterable[str]) -> str:
    """Return `did_you_mean`; without a similar name list some of the candidates."""
    names = sorted(set(candidates))
    if not names:
        return "none is declared yet: declare it first"
    examples = ", ".join(names[:8]) + (" …" if len(names) > 8 else "")
    return did_you_mean(name, names) or f"known are {examples}"


def or_list(names: Sequence[str]) -> str:
    """Return ``a``, ``a or b``, ``a, b or c``."""
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


def count(number: int, what: str) -> str:
    """Return ``1 input`` or ``2 inputs``."""
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
