"""Reports of a process about its own output ([Introspection15 §4.2, §4.4]).

"A computational unit is able to determine when the quality of a stream drops, and can request the
semantics manager to change the quality property; similarly a change in semantics can be reported."
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias


@dataclass(frozen=True, slots=True)
class Report:
    """The answer of a process, with a change of its output stream.

    ``answer`` is the usual answer of the process (None: no sample). ``quality`` (0..1) is the new
    quality of the stream. ``contains`` is its new content, as SSL has it after `contains`:
    ``speed(UAV) = value [m.s-1] for every UAV = id``. None: unchanged.
    """

    answer: Any = None
    quality: float | None = None
    contains: str | None = None


OnReport: TypeAlias = Callable[[str, Report], None]
"""Called with the name of the stream, after the samples before the report were offered."""


def ignore_report(stream: str, report: Report) -> None:
    """Do nothing: for a trial run or a test."""
