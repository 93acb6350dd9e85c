"""Rows and watermarks in, windows that close out: when, and over what, a query is evaluated.

What is computed when a window closes is the business of who is told so: `evaluator` for one query,
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
from .contents import Contents, Due
from .grid import schedule

Closed = Callable[[int, bool], bool]
"""Told the end of a window that has closed and whether its result is reported; answers whether the
rows that were in it are read again."""
_BLOCK = 2**15


class Windowing:
    """The windows of a query over named inputs. Whoever lets them close says who is told of each,
    in order: nobody is held by them, so that an evaluator nobody needs is gone at once.

    Arguments, errors and law as of `evaluator.ContinuousEvaluator`.
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
        """Rows that came behind a watermark, or for a window that had closed, and were dropped."""
        self.schedule = schedule(query, self.inputs, options)
        self.contents = Contents(self.schedule, terms.dictionary, entailment)
        self.differs = query.operator is not StreamOperator.RSTREAM
        """Whether results are compared with those before, so that each one has to be known."""
        self._plain = options.report == "non-empty" and not self.differs
        """Whether windows with content alone are evaluated, and each of them is reported."""
        self.clock: Callable[[], int] | None = None
        """Tells ns, where it is measured what selecting the rows of a window costs."""
        self.turned = 0
        """What that was for the last one."""
        self.defers = False
        """Whether windows close by `close_next` only, not as soon as they can."""
        self.closed = 0
        """How many evaluations have come to their end."""
        self._settled: int | None = None
        self._watermarks: dict[str, int] = {}
        self._ended: set[str] = set()
        self._closed: int | None = None
        self._had_content = False

    def push(self, input: str, triples: TimedTriples) -> None:
        """Rows continue ``input``: none before its watermark. Their terms are of our dictionary."""
        if triples.dictionary is not self.terms.dictionary:
            raise ValueError("the triples are of another dictionary")
        self._ended.discard(input)
        limit = self.limit(input)
        entailed = self.entailment.of(triples.tables)
        if self.contents.push_plain(input, (*triples.tables, *entailed), limit):
            return
        for table in triples.tables:
            rows = self._relevant(table)
            if rows is not None:
                self.late += self.contents.push(input, rows, limit)
        for table in entailed:
            rows = self._relevant(table)
            if rows is not None:
                self.contents.push(input, rows, limit, entailed=True)

    def advance(self, input: str, watermark: int, closed: Closed) -> None:
        """Every later row of ``input`` has τ ≥ ``watermark``: some windows may close."""
        known = self._watermarks.get(input)
        if known is None or watermark > known:
            self._watermarks[input] = watermark
        self._close(closed)

    def end(self, input: str, closed: Closed) -> None:
        """``input`` has come to its end. After the last one every window with content closes."""
        self._ended.add(input)
        self._close(closed)

    @property
    def is_due(self) -> bool:
        """Whether a window can close."""
        return self._closable() is not None

    def close_next(self, closed: Closed) -> bool:
        """Close the next window that can; whether there was one."""
        due = self._closable()
        if due is not None:
            self._evaluate(due, closed)
        return due is not None

    def resume(self, input: str) -> None:
        """``input`` had come to its end and goes on: windows wait for it again."""
        self._ended.discard(input)

    def next_end(self) -> int | None:
        """No later window ends before this; None while that is unknown."""
        candidates = []
        pending = self._due()
        if pending is not None:
            candidates.append(pending.end)
        for one in self.schedule.windows:
            watermark = self._watermarks.get(one.input)
            if one.input not in self._ended and watermark is not None:
                candidates.append(self.schedule.first_end(one, watermark))
        if not candidates:
            return None
        least = -TIME_MAX
        if self._closed is not None:
            least = (
                self._closed if self.schedule.ends is None else self.schedule.after(self._closed)
            )
        return max(min(candidates), least) - self.schedule.shift

    def span(self, end: int) -> tuple[int, int]:
        """The start and end that the result at ``end`` is told with."""
        shift = self.schedule.shift
        lows = [one.bounds(end)[0] for one in self.schedule.windows if not one.lasts]
        return min(lows, default=end) - shift, end - shift

    def _relevant(self, table: TripleRows) -> TripleRows | None:
        """The rows that stand for a triple or say the sort of their subjects, each object in its
        canonical spelling (`patterns` see to that themselves)."""
        if self.contents.keeps:
            objects = {p: self.terms.canonical(column) for p, column in table.objects.items()}
            if any(objects[p] is not column for p, column in table.objects.items()):
                table = replace(table, objects=objects)
        nulls = [column.null for column in table.objects.values() if column.null is not None]
        if not table.objects:
            return None if table.sort is None else table
        if len(nulls) < len(table.objects) or not _meet(nulls):
            return table
        return table.take(~np.logical_and.reduce(nulls))

    def limit(self, input: str) -> int | None:
        """Rows of ``input`` with τ up to here come too late; None: none does."""
        limits = []
        if input in self._watermarks:
            limits.append(self._watermarks[input] - 1)
        if self._closed is not None:
            closed = self.contents.limit(input, self._closed)
            limits += [] if closed is None else [closed]
        return max(limits, default=None)

    def _watermark(self) -> int | None:
        """The least watermark over all inputs; None while one has neither begun nor ended."""
        least = TIME_MAX
        for name in self.inputs:
            if name in self._ended:
                continue
            if name not in self._watermarks:
                return None
            least = min(least, self._watermarks[name])
        return least

    def _close(self, closed: Closed) -> None:
        self._settled = None
        while not self.defers and self.close_next(closed):
            pass

    def _closable(self) -> Due | None:
        watermark = self._watermark()
        if watermark is None:
            return None
        if watermark != self._settled:
            self.contents.settle(watermark)
            self._settled = watermark
        if self._closed is not None and self.schedule.ends is not None:
            following = self.schedule.after(self._closed)
            if watermark <= following - self.schedule.shift:
                return None
        due = self._due()
        return None if due is None or watermark <= due.end - self.schedule.shift else due

    def _due(self) -> Due | None:
        """The next evaluation: one with content, or one that is asked for without."""
        due = self.contents.next(self._closed)
        if self._plain or self._closed is None or self.schedule.ends is None:
            return due
        following = Due(self.schedule.after(self._closed))
        if due is not None and due.end == following.end:
            return due
        if self.options.report == "close" and not self._is_over:
            return following
        # What has left the result is to be told, though nothing is there any more.
        leaves = self.differs or self.options.report == "change"
        return following if leaves and self._had_content else due

    @property
    def _is_over(self) -> bool:
        """Whether all inputs have ended, and no window has content any more."""
        return len(self._ended) == len(self.inputs) and self.contents.next(self._closed) is None

    def _evaluate(self, due: Due, closed: Closed) -> None:
        end, reports = due.end, True
        if not self._plain:
            content, changed = self.contents.changed(due, self._closed)
            wanted = {"non-empty": content, "change": changed, "close": not self._is_over}
            reports = wanted[self.options.report]
            self._had_content = content
        self._closed = end
        begin = 0 if self.clock is None else self.clock()
        self.contents.turn(due)
        self.turned = 0 if self.clock is None else self.clock() - begin
        try:
            again = closed(end, reports)
            self.contents.drop(end, raw=again)
        finally:
            self.closed += 1


def _meet(masks: Sequence[Mask]) -> bool:
    """Whether all masks are set in some row. Block by block: what is made on the way stays in a
    cache, and needs no pages of memory from the system."""
    for first in range(0, len(masks[0]), _BLOCK):
        part = masks[0][first : first + _BLOCK]
        for mask in masks[1:]:
            part = part & mask[first : first + _BLOCK]
        if part.any():
            return True
    return False
