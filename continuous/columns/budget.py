"""The budget for the evaluation of one window, and the Oxigraph that evaluates what columns cannot.

The budget counts rows, not seconds. The same input therefore exceeds it in the same window on every
machine, and in a replay. `OxigraphPort` may have a deadline as well (service/workers);
`oxigraph_port.DIRECT` has none.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Final, TypeVar

from .oxigraph_port import DIRECT, OxigraphPort
from .pauses import NO_PAUSES, Pauses

Item = TypeVar("Item")
VISITS_PER_ROW: Final = 4
"""The limit of rows that the compiled loop may visit per row that an operator may make. A visit is
cheap, but a filter that rejects all rows makes none, so made rows alone would be no limit."""
PACE: Final = 2_000
"""The number of steps in Python, some milliseconds, between two pauses."""
OVERRUNS: Final = 3
"""The number of windows in a row over budget after which evaluation stops."""


class BudgetExceeded(Exception):
    """A window exceeds the budget and has no result. The message tells users why."""


class Stopped(BudgetExceeded):
    """A window was stopped by its deadline, or with a process that died. This depends on the
    machine: a replay must be told to stop the window again."""


class Quarantined(Exception):
    """`OVERRUNS` windows in a row exceeded the budget, so evaluation stops."""


@dataclass(frozen=True, slots=True)
class Overrun:
    """A window without a result: its end (ns), and the reason, for users.

    ``number``: the number of windows closed before. ``is_stopped``: see `Stopped`.
    """

    end: int
    reason: str
    number: int = 0
    is_stopped: bool = False


@dataclass(frozen=True, slots=True)
class Budget:
    """Limits per window; None: no limit. ``rows``: rows that one operator makes; ``results``:
    solutions of one query; ``text``: characters that one aggregate concatenates. ``oxigraph``
    evaluates what columns cannot; operators call ``pauses`` between steps."""

    rows: int | None = None
    results: int | None = None
    text: int | None = None
    oxigraph: OxigraphPort = DIRECT
    pauses: Pauses = NO_PAUSES

    def check(self, rows: int, what: str) -> None:
        """Raise `BudgetExceeded` if an operator is about to make too many rows. Raises as
        `Pauses.pause`, too."""
        self.pauses.pause()
        if self.rows is not None and rows > self.rows:
            raise BudgetExceeded(
                f"{what} makes {rows} rows of a window, at most {self.rows} may be"
            )

    def check_result(self, rows: int) -> None:
        """Raise `BudgetExceeded` for too many solutions of one query: each becomes a sample."""
        self.pauses.pause()
        if self.results is not None and rows > self.results:
            raise BudgetExceeded(f"{rows} solutions, at most {self.results} may be")

    def check_text(self, characters: int, what: str) -> None:
        """Raise `BudgetExceeded` if an aggregate concatenates too much text."""
        if self.text is not None and characters > self.text:
            raise BudgetExceeded(
                f"{what} makes {characters} characters of a window, at most {self.text} may be"
            )

    def paced(self, items: Iterable[Item]) -> Iterator[Item]:
        """Yield ``items``, with a pause now and then. Raises as `Pauses.pause`."""
        for number, item in enumerate(items):
            if not number % PACE:
                self.pauses.pause()
            yield item

    @property
    def row_visits(self) -> int:
        """The limit of rows that the compiled loop visits per window; -1: none."""
        return -1 if self.rows is None else VISITS_PER_ROW * self.rows


UNLIMITED: Final = Budget()
