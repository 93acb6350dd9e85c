"""User-written processes that commands load."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...engine.processes.loading import load_processes
from .output import err, fail

Say = Callable[[str], None]
"""Tells people something."""


def say_to_people(text: str) -> None:
    """To people who look on, beside the log."""
    err().print(text, markup=False)


def load(processes: Sequence[str], say: Say = say_to_people) -> None:
    """Load user-written processes, of installed packages too; a module that is named and cannot be
    loaded is an error, of an installed one it is said and left."""
    for report in load_processes(processes):
        if report.error and report.origin in processes:
            raise fail(f"{report.origin}: {report.error}")
        if report.error:
            say(f"not loaded: {report.origin}: {report.error}")
