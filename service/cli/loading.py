"""Loads user-written processes for commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from ...engine.processes.loading import load_processes
from .output import err, fail

Say = Callable[[str], None]
"""Reports a note to the user."""


def print_note(text: str) -> None:
    """Print a note on standard error."""
    err().print(text, markup=False)


def load(processes: Sequence[str], say: Say = print_note) -> None:
    """Load user-written processes, also those of installed packages. A module that ``processes``
    names must load; of an installed one a failure is only reported."""
    for report in load_processes(processes):
        if report.error and report.origin in processes:
            raise fail(f"{report.origin}: {report.error}")
        if report.error:
            say(f"not loaded: {report.origin}: {report.error}")
