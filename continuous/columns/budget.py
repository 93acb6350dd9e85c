"""What the evaluation of one window may cost, and who evaluates what columns cannot.

Rows are counted, not seconds: the same input exceeds its budget in the same window wherever and
whenever it is evaluated, and so does a replay of it. What only Oxigraph can say is its `Asking`'s,
which may have a deadline as well (service/workers); `oxigraph_port.DIRECT` waits as long as it
takes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, TypeVar

from .oxigraph_port import DIRECT, Asking
from .pauses import NO_PAUSES, Pauses

Item = TypeVar("Item")
LOOKS: Final = 4
"""The compiled loop may look at so many rows for each that an operator may make: a look is cheap,
and where a filter refuses everything there is nothing else to count."""


PACE: Final = 2_000
"""After so many steps in Python, some milliseconds, others may have a moment."""


OVERRUNS: Final = 3
"""After so many windows in a row that need more than they may, no more are evaluated."""


class BudgetExceeded(Exception):
    """A window needs more than it may: it has no result. The message says what, for people."""


class Stopped(BudgetExceeded):
    """A window was stopped because of what the machine did: of time, or with a process that died.
    The same rows may do with it another time, so whoever does them again has to be told."""


class Quarantined(Exception):
    """So many windows in a row needed more than they may that no more are evaluated."""


@dataclass(frozen=True, slots=True)
class Overrun:
    """A window without a result: its end (ns), and why, for people.

    ``number``: so many windows had closed before. ``is_stopped``: see `Stopped`.
    """

    end: int
    reason: str
    number: int = 0
    is_stopped: bool = False


@dataclass(frozen=True, slots=True)
class Budget:
    """``rows``: how many one operator may make of one window; ``results``: how many solutions a
    query may have of one; ``text``: how many characters one aggregate may put together; None for
    any number. ``asking`` evaluates what columns cannot;
    ``pauses`` are taken on the way."""

    rows: int | None = None
    results: int | None = None
    text: int | None = None
    asking: Asking = DIRECT
    pauses: Pauses = NO_PAUSES

    def check(self, rows: int, what: str) -> None:
        """Raises `BudgetExceeded` where an operator is about to make more rows than it may, and as
        `Pauses.pause` does."""
        self.pauses.pause()
        if self.rows is not None and rows > self.rows:
            raise BudgetExceeded(
                f"{what} makes {rows} rows of a window, at most {self.rows} may be"
            )

    def check_result(self, rows: int) -> None:
        """Raises `BudgetExceeded` for so many solutions of one query: each becomes a sample."""
        self.pauses.pause()
        if self.results is not None and rows > self.results:
            raise BudgetExceeded(f"{rows} solutions, at most {self.results} may be")

    def check_text(self, characters: int, what: str) -> None:
        """Raises `BudgetExceeded` where an aggregate puts more text together than it may."""
        if self.text is not None and characters > self.text:
            raise BudgetExceeded(
                f"{what} makes {characters} characters of a window, at most {self.text} may be"
            )

    def paced(self, items: Iterable[Item]) -> Iterator[Item]:
        """``items``, with a moment for others now and then. Raises as `Pauses.pause` does."""
        for number, item in enumerate(items):
            if not number % PACE:
                self.pauses.pause()
            yield item

    @property
    def looks(self) -> int:
        """How many rows the compiled loop may look at for one window; -1 for any number."""
        return -1 if self.rows is None else LOOKS * self.rows


UNLIMITED: Final = Budget()
