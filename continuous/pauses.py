"""Where the evaluation of a window may be interrupted, so that others go on meanwhile.

An evaluation says so itself: between operators, and around what touches nothing that others have.
Whoever runs it decides whether it pauses there (service/pausing); `STRAIGHT` never does.
"""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import Protocol


class Pauses(Protocol):
    """The moments of one thread's evaluations."""

    def breathe(self) -> None:
        """Others may go on here, and this later. Raises `budget.Stopped` where it has taken too
        long, or is not wanted any more."""

    def apart(self, *, waits: bool = False) -> AbstractContextManager[None]:
        """What is done within touches nothing but what is its own: others may go on meanwhile, and
        what comes after it waits for its turn. ``waits``: it is another process that does it.
        Raises at its end as `breathe` does."""


class Straight:
    """No pauses."""

    def breathe(self) -> None:
        return

    def apart(self, *, waits: bool = False) -> AbstractContextManager[None]:
        return _ALWAYS


_ALWAYS = nullcontext()
STRAIGHT = Straight()
