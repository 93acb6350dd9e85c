"""The open windows of a query: which windows close when, and over which rows.

The callback of the caller evaluates a window that closes: `evaluator` for one query,
`template_instances` for all instances of a template.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ...languages.csparql.ast import ContinuousQuery, StreamOperator
from ...rdf.timed import TimedTriples, TripleRows
from ...streams.sample import Mask
from ...streams.time import TIME_MAX
from ..algebra.options import Options
from ..columns.relation import TermValues
from ..operators.entailment import StreamEntailment
from .contents import Contents, DueEvaluation
from .grid import schedule

EvaluateWindow = Callable[[int, bool], bool]
"""A callback for a window that closes. Arguments: its end, and whether its result is reported.
Returns whether the window's rows are needed again."""
EvaluateWindows = Callable[[list[int]], tuple[int, bool] | None]
"""A callback for windows that close at once. Argument: their ends, ascending. Returns how many of
them, from the first on, it has evaluated in one pass, and whether the rows of the last one are
needed again; None if these windows must be evaluated one by one."""
_BLOCK = 2**15
FEWEST, MOST = 8, 512
"""The least and the greatest number of windows of a pass, which costs as much as seven at least
(`incremental.bulk_aggregation` knows its costs)."""


class OpenWindows:
    """The windows of a query over named inputs, and the watermarks that close them. The callback is
    an argument, not an attribute. It is a method of the evaluator: an attribute would be a cycle of
    references, and only the garbage collector would free an evaluator.

    Arguments, errors and law: see `evaluator.ContinuousEvaluator`.
    """

    def __init__(
        self,
        query: ContinuousQuery,
        terms: TermValues,
        inputs: Sequence[str],
        options: Options,
        entailment: StreamEntailment,
    ) -> None:
        self.options = options
        self.entailment = entailment
        self.inputs = tuple(inputs)
        self.terms = terms
        self.late = 0
        """The number of dropped rows: behind a watermark, or for a closed window."""
        self.schedule = schedule(query, self.inputs, options)
        self.contents = Contents(self.schedule, terms.dictionary, entailment)
        self.differs = query.operator is not StreamOperator.RSTREAM
        """Whether results are compared with previous ones: then every result is computed."""
        self._plain = options.report == "non-empty" and not self.differs
        """Whether only windows with content are evaluated, and all of them reported."""
        self.clock: Callable[[], int] | None = None
        """Returns ns; set if costs are measured."""
        self.select_ns = 0
        """The cost of selecting the rows of the last window, if `clock` is set."""
        self.defers = False
        """Whether only `close_next` closes windows; else they close as soon as they can."""
        self.closed = 0
        """The number of completed evaluations."""
        self._one_by_one_until: int | None = None
        """The last end of windows for which the callback wanted one evaluation each."""
        self._settled_watermark: int | None = None
        self._watermarks: dict[str, int] = {}
        self._ended: set[str] = set()
        self._last_end: int | None = None
        self._had_content = False

    def push(self, input: str, triples: TimedTriples) -> None:
        """Append rows to ``input``, none before its watermark. Their terms must be in the
        evaluator's dictionary."""
        if triples.dictionary is not self.terms.dictionary:
            raise ValueError("the triples have another dictionary than the evaluator")
        self._ended.discard(input)
        limit = self.limit(input)
        entailed = self.entailment.of(triples.tables)
        if self.contents.push_at_once(input, (*triples.tables, *entailed), limit):
            return
        for table in triples.tables:
            rows = self._relevant(table)
            if rows is not None:
                self.late += self.contents.push(input, rows, limit)
        for table in entailed:
            rows = self._relevant(table)
            if rows is not None:
                # A late row is counted once, and not again for the triples that it entails.
                self.contents.push(input, rows, limit, entailed=True)

    def advance(
        self,
        input: str,
        watermark: int,
        evaluate: EvaluateWindow,
        in_bulk: EvaluateWindows | None = None,
    ) -> None:
        """Promise that every later row of ``input`` has τ ≥ ``watermark``; close windows."""
        previous = self._watermarks.get(input)
        if previous is None or watermark > previous:
            self._watermarks[input] = watermark
        self._close(evaluate, in_bulk)

    def end(
        self, input: str, evaluate: EvaluateWindow, in_bulk: EvaluateWindows | None = None
    ) -> None:
        """End ``input``. After the last input has ended, every window with content closes."""
        self._ended.add(input)
        self._close(evaluate, in_bulk)

    @property
    def is_due(self) -> bool:
        """Whether a window can close."""
        return self._closable() is not None

    def close_next(
        self, evaluate: EvaluateWindow, in_bulk: EvaluateWindows | None = None, most: int = 1
    ) -> int:
        """Close the next window that can close, or with ``in_bulk`` up to ``most`` of them at once;
        return how many."""
        due = self._closable()
        if due is None:
            return 0
        if in_bulk is not None and most > 1:
            closed = self._evaluate_in_bulk(due.end, in_bulk, min(most, MOST))
            if closed:
                return closed
        self._evaluate(due, evaluate)
        return 1

    def resume(self, input: str) -> None:
        """Continue ``input``, which had ended: windows wait for it again."""
        self._ended.discard(input)

    def next_end(self) -> int | None:
        """Return a lower bound of the ends of later windows, or None if there is none yet."""
        candidates = []
        pending = self._due()
        if pending is not None:
            candidates.append(pending.end)
        for one in self.schedule.windows:
            watermark = self._watermarks.get(one.input)
            if one.input not in self._ended and watermark is not None:
                # A row may still come at the watermark itself.
                candidates.append(self.schedule.first_end(one, watermark))
        if not candidates:
            return None
        least = -TIME_MAX
        if self._last_end is not None:
            least = (
                self._last_end
                if self.schedule.ends is None
                else self.schedule.after(self._last_end)
            )
        return max(min(candidates), least) - self.schedule.shift

    def span(self, end: int) -> tuple[int, int]:
        """Return the start and end of the window that ends at ``end``, as its result gives them."""
        shift = self.schedule.shift
        lows = [one.bounds(end)[0] for one in self.schedule.windows if not one.lasts]
        return min(lows, default=end) - shift, end - shift

    def _relevant(self, table: TripleRows) -> TripleRows | None:
        """Return the rows that have a triple or the sort of their subjects, each object in its
        canonical spelling. The `PatternSolver` makes objects canonical itself."""
        if self.contents.keeps:
            objects = {p: self.terms.canonical(column) for p, column in table.objects.items()}
            if any(objects[p] is not column for p, column in table.objects.items()):
                table = replace(table, objects=objects)
        nulls = [column.null for column in table.objects.values() if column.null is not None]
        if not table.objects:
            return None if table.sort is None else table
        if len(nulls) < len(table.objects) or not _have_common_row(nulls):
            return table
        return table.take(~np.logical_and.reduce(nulls))

    def limit(self, input: str) -> int | None:
        """Return the τ up to which rows of ``input`` are late, or None if none is."""
        limits = []
        if input in self._watermarks:
            # A row at the watermark is in time.
            limits.append(self._watermarks[input] - 1)
        if self._last_end is not None:
            closed = self.contents.limit(input, self._last_end)
            limits += [] if closed is None else [closed]
        return max(limits, default=None)

    def _watermark(self) -> int | None:
        """Return the least watermark over all inputs; None while one has neither begun nor
        ended."""
        least = TIME_MAX
        for name in self.inputs:
            if name in self._ended:
                continue
            if name not in self._watermarks:
                return None
            least = min(least, self._watermarks[name])
        return least

    def _close(self, evaluate: EvaluateWindow, in_bulk: EvaluateWindows | None) -> None:
        self._settled_watermark = None
        while not self.defers and self.close_next(evaluate, in_bulk, MOST):
            pass

    def _closable(self) -> DueEvaluation | None:
        watermark = self._watermark()
        if watermark is None:
            return None
        if watermark != self._settled_watermark:
            # More triples may come at the watermark, so counting windows see the earlier ones only.
            self.contents.settle(watermark)
            self._settled_watermark = watermark
        # The usual case first: the watermark has not reached the next end on the grid.
        if self._last_end is not None and self.schedule.ends is not None:
            following = self.schedule.after(self._last_end)
            if watermark <= following - self.schedule.shift:
                return None
        due = self._due()
        # A window has the rows at its end, so it waits until the watermark is greater.
        return None if due is None or watermark <= due.end - self.schedule.shift else due

    def _due(self) -> DueEvaluation | None:
        """Return the next evaluation: with content, or without if the query's report needs it."""
        due = self.contents.next(self._last_end)
        # Windows without content count only on a grid, and only after the first content.
        if self._plain or self._last_end is None or self.schedule.ends is None:
            return due
        following = DueEvaluation(self.schedule.after(self._last_end))
        if due is not None and due.end == following.end:
            return due
        if self.options.report == "close" and not self._is_over:
            return following
        # The content has left the windows: that change is reported too.
        leaves = self.differs or self.options.report == "change"
        return following if leaves and self._had_content else due

    @property
    def _is_over(self) -> bool:
        """Whether all inputs have ended, and no window has content."""
        return len(self._ended) == len(self.inputs) and self.contents.next(self._last_end) is None

    def _evaluate_in_bulk(self, first: int, in_bulk: EvaluateWindows, most: int) -> int:
        """Evaluate windows that can close, from the end ``first`` on, in one pass; return how many,
        0 if they must be evaluated one by one. Contract: the schedule is `uniform`, and windows
        with content are reported (`BulkPlan` checks that)."""
        tried, watermark = self._one_by_one_until, self._watermark()
        assert watermark is not None
        greatest = watermark - 1 + self.schedule.shift
        # With a live stream one window is due at a time: the grid alone tells that.
        step = self.schedule.after(first) - first
        is_few = first + (FEWEST - 1) * step > greatest
        if is_few or (tried is not None and first <= tried):
            return 0
        ends = self.contents.ends_from(
            first, greatest, most, leaves=self.differs, follows=self._had_content
        )
        done = in_bulk(ends) if len(ends) >= FEWEST else None
        if done is None:
            # Another pass over some of these windows would fail for the same reason.
            self._one_by_one_until = ends[-1]
            return 0
        closed, retains = done
        self._last_end = ends[closed - 1]
        self.closed += closed
        if self.differs:
            self._had_content = self.contents.has_content(self._last_end)
        self.contents.select(DueEvaluation(self._last_end))
        self.contents.drop(self._last_end, raw=retains)
        return closed

    def _evaluate(self, due: DueEvaluation, evaluate: EvaluateWindow) -> None:
        end, reports = due.end, True
        if not self._plain:
            content, changed = self.contents.compare(due, self._last_end)
            wanted = {"non-empty": content, "change": changed, "close": not self._is_over}
            reports = wanted[self.options.report]
            self._had_content = content
        # A window that exceeds its budget has closed, too: it must not be due again.
        self._last_end = end
        begin = 0 if self.clock is None else self.clock()
        self.contents.select(due)
        self.select_ns = 0 if self.clock is None else self.clock() - begin
        try:
            retains = evaluate(end, reports)
            self.contents.drop(end, raw=retains)
        finally:
            self.closed += 1


def _have_common_row(masks: Sequence[Mask]) -> bool:
    """Whether all masks are set in some row. It works in blocks, so that temporary arrays stay in
    the processor's cache and need no fresh memory pages."""
    for first in range(0, len(masks[0]), _BLOCK):
        part = masks[0][first : first + _BLOCK]
        for mask in masks[1:]:
            part = part & mask[first : first + _BLOCK]
        if part.any():
            return True
    return False
