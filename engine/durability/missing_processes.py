"""User-written processes that an earlier run had, and this one has not.

A start without a module that the state needs goes on without the processes of it: what was declared
with them is told and kept, and comes back at a start with the module.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from ..processes.registry import Processes


def origins(processes: Processes) -> dict[str, str]:
    """The module of each process, by the process's name."""
    return {each.name: each.code.__module__ for each in processes.all()}


def missing(
    known: Mapping[str, str], processes: Processes, spoken_of: Iterable[bytes]
) -> dict[str, str]:
    """Of the ``known`` processes (name → module) those that are not there and are named in one of
    the texts ``spoken_of``. Cost: linear in the texts, for each that is not there."""
    gone = {name: module for name, module in known.items() if name not in processes}
    texts = tuple(spoken_of) if gone else ()
    return {
        name: module
        for name, module in gone.items()
        if any(re.search(rb"\b" + name.encode() + rb"\b", text) for text in texts)
    }


def told(name: str, module: str) -> str:
    """What people are told of one that is missing."""
    return (
        f"the user-written process {name!r} of module {module!r} is missing: what was declared "
        f"with it waits; start with --processes {module} (or its .py file), and it goes on"
    )
