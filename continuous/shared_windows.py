"""Windows that many queries read: rows and watermarks in, one value a window out for all of them.

What is computed over them is the business of `instances` (of a template) and `alike` (queries that
differ in constants).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from ..languages.csparql.ast import ContinuousQuery, StreamOperator, TimeWindow
from ..rdf.dictionary import TermDictionary
from ..rdf.timed import TimedTriples
from .background import Background
from .columns import TermValues
from .foreign import is_volatile
from .instance_results import InstanceResults
from .logical import Blank, Construct, Order, Query, expressions_of, walk
from .options import Options
from .sources import StaticSide
from .windowing import Windowing
from .windows import Schedule


def own_windows(query: ContinuousQuery, schedule: Schedule, options: Options) -> str:
    """Why what is in the windows of a query, or which it reports, is its own: it depends on when
    the query began. "" where it does not."""
    if query.operator is not StreamOperator.RSTREAM:
        return f"{query.operator} compares results with those before, of its own"
    if options.report != "non-empty":
        return f"what it reports ({options.report}) depends on when it began"
    if not all(isinstance(one.window, TimeWindow) for one in schedule.windows):
        return "what is in a window that counts or lasts depends on when it began"
    return ""


def own_solutions(query: Query) -> str:
    """Why the solutions of a query are its own, in the same windows as others; "" where not."""
    nodes = walk(query.plan)
    if any(isinstance(node, Order) for node in nodes):
        return "ORDER BY orders the solutions of one query"
    if any(is_volatile(each) for node in nodes for each in expressions_of(node)):
        return "it asks for what is another value each time"
    head = query.head
    if isinstance(head, Construct) and any(isinstance(p, Blank) for t in head.template for p in t):
        return "its head names blank nodes by the solutions before"
    return ""


class SharedWindows(ABC):
    """The windows of ``query`` over named inputs; arguments and methods as of
    `ContinuousEvaluator`."""

    def __init__(
        self,
        query: ContinuousQuery,
        dictionary: TermDictionary,
        background: Background,
        inputs: Sequence[str],
        options: Options | None = None,
    ) -> None:
        self._results: list[InstanceResults] = []
        terms = TermValues(dictionary)
        self._windows = Windowing(query, terms, inputs, options or Options(), self._closed)
        self._static = StaticSide(background, terms)

    @property
    def late(self) -> int:
        """Rows that came too late and were dropped."""
        return self._windows.late

    def resume(self, input: str) -> None:
        """``input`` had come to its end and goes on: windows wait for it again."""
        self._windows.resume(input)

    def limit(self, input: str) -> int | None:
        """Rows of ``input`` with τ up to here come too late; None: none does."""
        return self._windows.limit(input)

    def push(self, input: str, triples: TimedTriples) -> None:
        """Rows continue ``input``: none before its watermark."""
        self._windows.push(input, triples)

    def advance(self, input: str, watermark: int) -> list[InstanceResults]:
        """Every later row of ``input`` has τ ≥ ``watermark``: the windows that close now."""
        self._windows.advance(input, watermark)
        return self._taken()

    def end(self, input: str) -> list[InstanceResults]:
        """``input`` has come to its end. After the last one every window with content closes."""
        self._windows.end(input)
        return self._taken()

    def next_end(self) -> int | None:
        """No later result is of a window that ends before this; None while that is unknown."""
        return self._windows.next_end()

    @abstractmethod
    def remove(self, instance: int) -> None:
        """Forget a query, by its number; raises ``KeyError`` if it is not there."""

    @abstractmethod
    def explain(self) -> str:
        """What is shared, and how it is computed."""

    @abstractmethod
    def _closed(self, end: int, reports: bool) -> bool:
        """The window that ends at ``end`` has closed; whether its rows are read again."""

    def _taken(self) -> list[InstanceResults]:
        taken, self._results = self._results, []
        return taken
