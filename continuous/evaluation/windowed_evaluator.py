"""The common base of evaluators: it takes rows and watermarks, and closes windows.

Subclasses compute the result of a window: `evaluator` for one query, `shared_windows` for many.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

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
from ..operators.entailment import PatternNeeds, StreamEntailment
from ..operators.sources import StaticSide
from ..windows.grid import schedule
from ..windows.window_schedule import EvaluateWindows, OpenWindows
from .solver import QueryBody


class Results(Protocol):
    """The results of one window, or of several that were evaluated in one pass."""

    def windows(self) -> Iterator[Any]:
        """Yield those of each window."""
        ...


Result = TypeVar("Result", bound=Results)


class WindowedEvaluator(ABC, Generic[Result]):
    """The windows of ``query`` over named inputs and a static side, and a result for each.
    Arguments, errors and law: see `evaluator.ContinuousEvaluator`."""

    splits = True
    """Whether each window has a result of its own; else windows that were evaluated in one pass
    have one together."""

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
        """Windows that exceeded the budget; the caller removes them."""
        self.quarantine = ""
        """Why evaluation has stopped for good, or empty."""
        self._in_a_row = 0
        self._stopped = ""
        """Why a replay skips the next window: it was stopped when it closed first. Or empty."""
        self.options = options or Options()
        self._results: list[Result] = []
        find_needs = partial(_pattern_needs, query, tuple(inputs), self.options)
        entailment = StreamEntailment(background, terms, find_needs)
        self._windows = OpenWindows(query, terms, inputs, self.options, entailment)
        self._static = StaticSide(background, terms)

    @property
    def late(self) -> int:
        """The number of dropped rows: behind a watermark, or for a closed window."""
        return self._windows.late

    @property
    def defers(self) -> bool:
        """Whether closable windows wait for `close_next`; else they close at once."""
        return self._windows.defers

    @defers.setter
    def defers(self, defers: bool) -> None:
        self._windows.defers = defers

    @property
    def closed(self) -> int:
        """The number of closed windows."""
        return self._windows.closed

    def push(self, input: str, triples: TimedTriples) -> None:
        """Append rows to ``input``, none before its watermark. Their terms must be in the
        evaluator's dictionary."""
        self._windows.push(input, triples)

    def advance(self, input: str, watermark: int) -> list[Result]:
        """Promise that every later row of ``input`` has τ ≥ ``watermark``; return the results of
        the windows that close now."""
        return self._until_quarantined(
            lambda: self._windows.advance(input, watermark, self._close_window, self._in_bulk())
        )

    def end(self, input: str) -> list[Result]:
        """End ``input``. After the last input has ended, every window with content closes."""
        return self._until_quarantined(
            lambda: self._windows.end(input, self._close_window, self._in_bulk())
        )

    @property
    def is_due(self) -> bool:
        """Whether a window waits for `close_next`."""
        return not self.quarantine and self._windows.is_due

    def close_next(self, stopped: str = "", most: int = 1) -> int:
        """Close the next window that can close, or up to ``most`` of them in one pass; return how
        many. `take_results` returns their results.

        ``stopped``: a replay knows that this window was stopped when it closed first, and why.
        """
        if self.quarantine:
            return 0
        self._stopped = stopped
        try:
            return self._windows.close_next(self._close_window, self._in_bulk(), most)
        except Quarantined:
            # The window that caused the quarantine has closed, too.
            return 1
        finally:
            self._stopped = ""

    def take_results(self) -> list[Result]:
        """Remove and return the results since the last call."""
        results, self._results = self._results, []
        return [each for one in results for each in one.windows()] if self.splits else results

    def next_end(self) -> int | None:
        """Return a lower bound of the ends of later windows, or None if there is none yet."""
        return self._windows.next_end()

    def resume(self, input: str) -> None:
        """Continue ``input``, which had ended: windows wait for it again."""
        self._windows.resume(input)

    def limit(self, input: str) -> int | None:
        """Return the τ up to which rows of ``input`` are late, or None if none is."""
        return self._windows.limit(input)

    def _close_window(self, end: int, reports: bool) -> bool:
        number = self._windows.closed
        try:
            if self._stopped:
                raise Stopped(self._stopped)
            retains = self._evaluate(end, reports)
        except BudgetExceeded as exceeded:
            self._in_a_row += 1
            is_stopped = isinstance(exceeded, Stopped)
            self.overruns.append(Overrun(end, str(exceeded), number, is_stopped))
            if self._in_a_row == OVERRUNS:
                self.quarantine = f"{OVERRUNS} windows in a row needed too much: {exceeded}"
                raise Quarantined(self.quarantine) from exceeded
            # The rows may not have been folded, so they stay as long as the window needs them.
            return True
        self._in_a_row = 0
        return retains

    def _in_bulk(self) -> EvaluateWindows | None:
        """Return what evaluates windows that are due at once. By default they are evaluated one by
        one."""
        return None

    @abstractmethod
    def _evaluate(self, end: int, reports: bool) -> bool:
        """Evaluate the window that ends at ``end``; return whether its rows are needed again."""

    def _until_quarantined(self, close: Callable[[], None]) -> list[Result]:
        """Close windows until the quarantine begins; the results before it count."""
        if not self.quarantine:
            with suppress(Quarantined):
                close()
        return self.take_results()


def _pattern_needs(query: ContinuousQuery, inputs: Sequence[str], options: Options) -> PatternNeeds:
    """Return what the patterns of the query read, with its parameters unbound."""
    try:
        return PatternNeeds.of(
            QueryBody.of(query, schedule(query, inputs, options)).translate({}).plan
        )
    except (Unsupported, ValueError):
        return PatternNeeds()
