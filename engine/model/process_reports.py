"""What a process says of its own output ([Introspection15 §4.2, §4.4]).

"A computational unit is able to determine when the quality of a stream drops, and can request the
semantics manager to change the quality property; similarly a change in semantics can be reported."
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias


@dataclass(frozen=True, slots=True)
class Report:
    """An answer together with what has changed about the stream that it goes to.

    ``answer`` is what the process would have given otherwise (None: no sample). ``quality`` (0..1)
    is how good the stream is from now on, ``contains`` what it contains from now on, as SSL writes
    it after `contains`: ``speed(UAV) = value [m.s-1] for every UAV = id``. None: as before.
    """

    answer: Any = None
    quality: float | None = None
    contains: str | None = None


OnReport: TypeAlias = Callable[[str, Report], None]
"""Called with the name of the stream, after the samples made before it were offered."""


def unheard(stream: str, report: Report) -> None:
    """Nobody listens: a rehearsal, a test."""
