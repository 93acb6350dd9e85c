"""What evaluators have in common whose results come window by window: rows and watermarks in.

What is computed when a window closes is theirs: `evaluator` for one query, `shared_windows` for
many.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import Generic, TypeVar

from ...languages.csparql.ast import ContinuousQuery
from ...rdf.dictionary import TermDictionary
from ...rdf.timed import TimedTriples
from ..algebra.options import Options
from ..algebra.unsupported import Unsupported
from ..columns.budget import (
    OVERRUNS,
    UNLIMITED,
    Budget,
    BudgetExceeded,
    Overrun,
    Quarantined,
    Stopped,
)
from ..columns.relation import TermValues
from ..operators.background import Background
from ..operators.entailment import Asked, StreamEntailment
from ..operators.sources import StaticSide
from ..windows.grid import schedule
from ..windows.window_schedule import Windowing
from .solver import Reading

Result = TypeVar("Result")


class WindowedEvaluator(ABC, Generic[Result]):
    """The windows of ``query`` over named inputs, before a static side, and a result each;
    arguments, errors and law as of `evaluator.ContinuousEvaluator`."""

    def __init__(
        self,
        query: ContinuousQuery,
        dictionary: TermDictionary,
        background: Background,
        inputs: Sequence[str],
        options: Options | None = None,
        budget: Budget = UNLIMITED,
    ) -> None:
        terms = TermValues(dictionary, budget)
        self.overruns: list[Overrun] = []
        """Windows that needed more than the budget, for who asks to take them away."""
        self.quarantine = ""
        """Why no window is evaluated any more; empty while they are."""
        self._in_a_row = 0
        self._stopped = ""
        """Why the next window has no result, where that is known before."""
        self.options = options or Options()
        self._results: list[Result] = []
        asks = partial(_asked, query, tuple(inputs), self.options)
        entailment = StreamEntailment(background, terms, asks)
        self._windows = Windowing(query, terms, inputs, self.options, entailment)
        self._static = StaticSide(background, terms)

    @property
    def late(self) -> int:
        """Rows that came behind a watermark, or for a window that had closed, and were dropped."""
        return self._windows.late

    @property
    def defers(self) -> bool:
        """Whether windows that can close wait for `close_next`; else they close at once."""
        return self._windows.defers

    @defers.setter
    def defers(self, defers: bool) -> None:
        self._windows.defers = defers

    @property
    def closed(self) -> int:
        """How many windows have closed."""
        return self._windows.closed

    def push(self, input: str, triples: TimedTriples) -> None:
        """Rows continue ``input``: none before its watermark. Their terms are of our dictionary."""
        self._windows.push(input, triples)

    def advance(self, input: str, watermark: int) -> list[Result]:
        """Every later row of ``input`` has τ ≥ ``watermark``: the windows that close now."""
        return self._until_quarantined(
            lambda: self._windows.advance(input, watermark, self._closing)
        )

    def end(self, input: str) -> list[Result]:
        """``input`` has come to its end. After the last one every window with content closes."""
        return self._until_quarantined(lambda: self._windows.end(input, self._closing))

    @property
    def is_due(self) -> bool:
        """Whether a window waits for `close_next`."""
        return not self.quarantine and self._windows.is_due

    def close_next(self, stopped: str = "") -> bool:
        """Close the next window that can; whether there was one. Its result is `taken`.

        With ``stopped`` it is known that it was stopped when it closed first, and why.
        """
        if self.quarantine:
            return False
        self._stopped = stopped
        try:
            return self._windows.close_next(self._closing)
        except Quarantined:
            return True
        finally:
            self._stopped = ""

    def taken(self) -> list[Result]:
        """The results of the windows that have closed since this was asked last."""
        taken, self._results = self._results, []
        return taken

    def next_end(self) -> int | None:
        """No later result is of a window that ends before this; None while that is unknown."""
        return self._windows.next_end()

    def resume(self, input: str) -> None:
        """``input`` had come to its end and goes on: windows wait for it again."""
        self._windows.resume(input)

    def limit(self, input: str) -> int | None:
        """Rows of ``input`` with τ up to here come too late; None: none does."""
        return self._windows.limit(input)

    def _closing(self, end: int, reports: bool) -> bool:
        number = self._windows.closed
        try:
            if self._stopped:
                raise Stopped(self._stopped)
            again = self._closed(end, reports)
        except BudgetExceeded as exceeded:
            self._in_a_row += 1
            is_stopped = isinstance(exceeded, Stopped)
            self.overruns.append(Overrun(end, str(exceeded), number, is_stopped))
            if self._in_a_row == OVERRUNS:
                self.quarantine = f"{OVERRUNS} windows in a row needed too much: {exceeded}"
                raise Quarantined(self.quarantine) from exceeded
            return True
        self._in_a_row = 0
        return again

    @abstractmethod
    def _closed(self, end: int, reports: bool) -> bool:
        """The window that ends at ``end`` has closed; whether its rows are read again."""

    def _until_quarantined(self, close: Callable[[], None]) -> list[Result]:
        """Close windows, up to the one after which none is; what those before it gave counts."""
        if not self.quarantine:
            with suppress(Quarantined):
                close()
        return self.taken()


def _asked(query: ContinuousQuery, inputs: Sequence[str], options: Options) -> Asked:
    """What the patterns of a query ask for, its parameters free."""
    try:
        return Asked.by(Reading.of(query, schedule(query, inputs, options)).translated({}).plan)
    except (Unsupported, ValueError):
        return Asked()
