"""User-written processes that an earlier run had and this one lacks.

A start without such a module runs without its processes. It reports the declarations that use them
and keeps them, so that a later start with the module restores them.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from ..processes.registry import Processes


def process_modules(processes: Processes) -> dict[str, str]:
    """Return the module of each process by the process's name."""
    return {each.name: each.code.__module__ for each in processes.all()}


def missing_processes(
    known: Mapping[str, str], processes: Processes, texts: Iterable[bytes]
) -> dict[str, str]:
    """Return the ``known`` processes (name → module) that are not loaded and that one of ``texts``
    names. Cost: linear in the texts, for each process that is not loaded."""
    absent = {name: module for name, module in known.items() if name not in processes}
    searched = tuple(texts) if absent else ()
    return {
        name: module
        for name, module in absent.items()
        if any(re.search(rb"\b" + name.encode() + rb"\b", text) for text in searched)
    }


def missing_message(name: str, module: str) -> str:
    """Return the message to users about a missing process."""
    return (
        f"the user-written process {name!r} of module {module!r} is missing: declarations that use "
        f"it wait; start with --processes {module} (or its .py file) to restore them"
    )
