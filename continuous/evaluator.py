"""The continuous evaluator: rows and watermarks in, a result a window out ([Events14 §III]).

Called by the engine's units and by `evaluate`. Time is an argument; the same rows give the same
results however they were cut into batches.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..languages.csparql import algebra, body_sparql, group_keys
from ..languages.csparql.ast import ContinuousQuery
from ..languages.errors import Span
from ..rdf.dictionary import TermDictionary
from ..rdf.timed import TimedTriples, TripleRows
from ..streams.time import TIME_MAX
from .background import Background
from .columns import NeedsOxigraph, Relation, TermValues
from .explain import Stages
from .heads import finish
from .incremental import Incremental
from .intake import Intake, Rows
from .logical import Plan, Query
from .options import Options
from .oxigraph import OxigraphWindows
from .relational import execute
from .results import WindowResult
from .rules import optimize
from .shapes import shape_of
from .sources import StaticSide, WindowSource
from .translate import Unsupported, translate
from .windows import schedule


class ContinuousEvaluator:
    """One continuous query over named inputs.

    ``inputs`` are the names of the input streams. An input that a FROM STREAM clause of the query
    names has that clause's window; any other has the query's WINDOW. Every input gives its rows in
    order of τ, a push at a time, and says by watermarks how far it has come. Raises ``ValueError``
    when no window is known, or the query makes no SPARQL (BIND of a parameter that is given).

    Law (tests/laws): results equal the definition's, and do not depend on how rows were cut into
    pushes or how often watermarks were told.

    Cost: see `incremental`, `relational` and `oxigraph`; `explain` says which serves the query.
    Memory: the rows of the open windows, or their partial aggregates; the dictionary's terms.
    """

    def __init__(
        self,
        query: ContinuousQuery,
        dictionary: TermDictionary,
        background: Background,
        inputs: Sequence[str],
        options: Options | None = None,
    ) -> None:
        self.query = query
        self.options = options or Options()
        self.inputs = tuple(inputs)
        self.late = 0
        """Rows that came behind a watermark, or for a window that had closed, and were dropped."""
        self.schedule = schedule(query, self.inputs, self.options)
        self._terms = TermValues(dictionary)
        self._static = StaticSide(background, self._terms)
        self._intakes = {name: Intake() for name in self.inputs}
        self._watermarks: dict[str, int] = {}
        self._ended: set[str] = set()
        self._closed: int | None = None
        self._translated: Query | None = None
        self._plan: Query | None = None
        self._rules: tuple[str, ...] = ()
        self._reason = ""
        self._incremental: Incremental | None = None
        self._no_increment = ""
        asked = _with_rows_only(query)
        tree = algebra(asked).algebra
        distinct = self.options.semantics == "set"
        self._oxigraph = OxigraphWindows(
            body_sparql(asked), tree, self._static, self._terms, distinct=distinct
        )
        try:
            bindings = {variable.value: term for variable, term in query.bindings.items()}
            self._translated = translate(tree, bindings)
            plan, self._rules = optimize(self._translated.plan)
            self._plan = Query(self._translated.head, plan)
            self._choose(plan)
        except Unsupported as unsupported:
            self._reason = str(unsupported)

    def push(self, input: str, triples: TimedTriples) -> None:
        """Rows continue ``input``: none before its watermark. Their terms are of our dictionary."""
        if triples.dictionary is not self._terms.dictionary:
            raise ValueError("the triples are of another dictionary")
        self._ended.discard(input)
        intake = self._intakes[input]
        limit = self._limit(input)
        for table in triples.tables:
            rows = self._relevant(table)
            if rows is not None:
                self.late += intake.push(rows, limit)

    def advance(self, input: str, watermark: int) -> list[WindowResult]:
        """Every later row of ``input`` has τ ≥ ``watermark``: the windows that close now."""
        known = self._watermarks.get(input)
        if known is None or watermark > known:
            self._watermarks[input] = watermark
        return self._close()

    def end(self, input: str) -> list[WindowResult]:
        """``input`` has come to its end. After the last one every window with content closes."""
        self._ended.add(input)
        return self._close()

    def next_end(self) -> int | None:
        """No later result is of a window that ends before this; None while that is unknown."""
        candidates = []
        pending = self._next()
        if pending is not None:
            candidates.append(pending)
        for i, name in enumerate(self.inputs):
            watermark = self._watermarks.get(name)
            if name not in self._ended and watermark is not None:
                candidates.append(self.schedule.first_end(i, watermark))
        if not candidates:
            return None
        return max(min(candidates), self._after_closed()) - self.schedule.shift

    def explain(self) -> str:
        """The query, its windows, its logical plan and how that is executed, for people."""
        oxigraph = self._oxigraph
        return str(
            Stages(
                self.query,
                oxigraph.sparql,
                self.options,
                self.inputs,
                self.schedule,
                self._translated,
                self._plan,
                self._rules,
                self._reason,
                self._no_increment if self._incremental is None else self._incremental.shape,
                "" if oxigraph.counting is not None else oxigraph.merges,
            )
        )

    def _choose(self, plan: Plan) -> None:
        if not self.schedule.uniform:
            self._no_increment = "the inputs have several windows"
            return
        shape = shape_of(plan, self._static)
        if isinstance(shape, str):
            self._no_increment = shape
            return
        panes = self.schedule.inputs[0].range // self.schedule.pane
        distinct = self.options.semantics == "set"
        self._incremental = Incremental(shape, self._static, self._terms, panes, distinct=distinct)

    def _relevant(self, table: TripleRows) -> TripleRows | None:
        """The rows that stand for a triple, each object in its canonical spelling."""
        objects = {p: self._terms.canonical(column) for p, column in table.objects.items()}
        if any(objects[p] is not column for p, column in table.objects.items()):
            table = replace(table, objects=objects)
        empty = None
        for column in table.objects.values():
            if column.null is None:
                return table
            empty = column.null if empty is None else empty & column.null
        if empty is None:
            return None
        return table.take(~empty) if empty.any() else table

    def _limit(self, input: str) -> int | None:
        """Rows of ``input`` up to here come too late."""
        limits = []
        if input in self._watermarks:
            limits.append(self._watermarks[input] - 1)
        if self._closed is not None:
            limits.append(self.schedule.inputs[self.inputs.index(input)].bounds(self._closed)[1])
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

    def _close(self) -> list[WindowResult]:
        watermark = self._watermark()
        results: list[WindowResult] = []
        while watermark is not None:
            end = self._next()
            if end is None or watermark <= end - self.schedule.shift:
                break
            result = self._evaluate(end)
            if result is not None:
                results.append(result)
        return results

    def _after_closed(self) -> int:
        return -TIME_MAX if self._closed is None else self._closed + self.schedule.ends.step

    def _next(self) -> int | None:
        """The next evaluation that may have content: found without stepping through a gap."""
        found: int | None = None
        for i, name in enumerate(self.inputs):
            intake, window = self._intakes[name], self.schedule.inputs[i]
            seen = -TIME_MAX
            if self._closed is not None:
                seen = window.bounds(self._closed)[1]
                following = self._closed + self.schedule.ends.step
                latest = intake.latest(seen)
                if latest is not None and latest > window.bounds(following)[0]:
                    return following
            time = intake.earliest(seen)
            if time is not None:
                end = self.schedule.first_end(i, time)
                found = end if found is None else min(found, end)
        return found

    def _evaluate(self, end: int) -> WindowResult | None:
        bounds = {
            name: window.bounds(end)
            for name, window in zip(self.inputs, self.schedule.inputs, strict=True)
        }
        if self._incremental is not None:
            self._fold(self._incremental, end)
        self._closed = end
        content = False
        for name, (low, high) in bounds.items():
            latest = self._intakes[name].latest(high)
            content |= latest is not None and latest > low
        result = self._solve(bounds, end) if content else None
        keeps = self._incremental is None or self._incremental.shape.retains
        for name, window in zip(self.inputs, self.schedule.inputs, strict=True):
            low = window.bounds(end + self.schedule.ends.step)[0]
            high = bounds[name][1]
            self._intakes[name].drop(min(low, high) if keeps else high, high)
        return result

    def _fold(self, incremental: Incremental, end: int) -> None:
        """The panes up to ``end`` that have content, oldest first; others are skipped."""
        done = self.schedule.inputs[0].bounds(end)[0]
        if self._closed is not None:
            done = max(done, self._closed)
        panes = self.schedule.inputs[0].grid
        while True:
            times = [intake.earliest(done) for intake in self._intakes.values()]
            time = min((time for time in times if time is not None), default=None)
            if time is None or time > end:
                break
            pane_end = time + (panes.origin - time) % self.schedule.pane
            tables = [
                table
                for intake in self._intakes.values()
                for table in intake.between(pane_end - self.schedule.pane, pane_end)
            ]
            incremental.fold(pane_end, tables)
            done = pane_end
        incremental.evict(self.schedule.inputs[0].bounds(end)[0])

    def _solve(self, bounds: dict[str, tuple[int, int]], end: int) -> WindowResult:
        start = min(low for low, _ in bounds.values()) - self.schedule.shift
        shown = end - self.schedule.shift
        retains = self._incremental is None or self._incremental.shape.retains
        tables = Rows(
            lambda: [
                table
                for name, (low, high) in bounds.items()
                if retains
                for table in self._intakes[name].between(low, high)
            ]
        )
        if self._plan is not None:
            try:
                source = _Source(tables, self._static, self.options, self._plan, self._incremental)
                relation = execute(self._plan.plan, source, self._terms)
                return finish(self._plan.head, relation, start, shown, self._terms)
            except NeedsOxigraph:
                # As exact there, bags too; what is not, the result says (`merged`).
                pass
        return self._oxigraph.solve(tables, start, shown)


def _with_rows_only(query: ContinuousQuery) -> ContinuousQuery:
    """An AGGREGATE over nothing gives no row, as one with group keys does ([Events14 §III.A])."""
    if not query.aggregations or group_keys(query):
        return query
    some = ("(COUNT(*) > 0)", Span(0, 0))
    return replace(query, aggregate_filters=(*query.aggregate_filters, some))


class _Source(WindowSource):
    """The window's leaves, and the incremental aggregate's groups where they are at hand."""

    def __init__(
        self,
        tables: Sequence[TripleRows],
        static: StaticSide,
        options: Options,
        plan: Query,
        incremental: Incremental | None,
    ) -> None:
        super().__init__(tables, static, distinct=options.semantics == "set")
        self.incremental = incremental

    def ready(self, plan: Plan) -> Relation | None:
        return None if self.incremental is None else self.incremental.ready(plan, self.tables)
