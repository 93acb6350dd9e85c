"""Points at which the evaluation of a window may pause, so that other requests go on meanwhile.

An evaluation names them itself: between operators, and around work that needs nothing of the
engine. The caller decides whether it pauses there (service/turns/window_turns); `NO_PAUSES` never
does.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Final, Protocol


class Pauses(Protocol):
    """The points at which one evaluation may pause."""

    def pause(self) -> None:
        """Let others go on here, if the time is over. Raises `continuous.columns.budget.Stopped`
        where the window has taken too long."""

    def released(self, *, waits: bool = False) -> AbstractContextManager[None]:
        """Let others go on during a block that touches only its own data; what follows the block
        waits for its turn. ``waits``: the block waits for another process. Raises at its end as
        `pause` does."""


class _NoPauses:
    def pause(self) -> None:
        return

    def released(self, *, waits: bool = False) -> AbstractContextManager[None]:
        return _ALWAYS


_ALWAYS: Final = nullcontext()
NO_PAUSES: Final[Pauses] = _NoPauses()
