"""The continuous evaluator: rows and watermarks in, a result a window out ([Events14 §III]).

Called by the engine's units and by `evaluate`. Time is an argument; the same rows give the same
results however they were cut into batches.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from ..languages.csparql import algebra, body_sparql, group_keys
from ..languages.csparql.ast import ContinuousQuery, StreamOperator
from ..languages.csparql.shape import query_shape
from ..languages.errors import Span
from ..rdf.dictionary import TermDictionary
from ..rdf.timed import TimedTriples, TripleRows
from ..streams.compiled import JIT
from ..streams.time import TIME_MAX
from .background import Background
from .columns import NeedsOxigraph, Relation, TermValues
from .contents import Contents, Due
from .explain import Stages
from .flows import Flow
from .heads import finish, head_variables
from .incremental import Incremental
from .intake import Rows
from .logical import DEFAULT, AnyScan, Closure, Plan, Query, Scan, TypeScan, outputs, walk
from .options import Options
from .oxigraph import OxigraphWindows
from .pattern_parts import needed_outside, pattern_parts, served_parts
from .pattern_sizes import Known
from .patterns import PatternSolver
from .profile import Profile
from .relational import execute
from .results import WindowResult
from .rules import optimize
from .shapes import shape_of
from .sources import StaticSide, WindowSource
from .stream_operators import Difference
from .timestamps import asks_for_times, at_time, names_now
from .translate import Graphs, translate
from .unsupported import Unsupported
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
        self.profile: Profile | None = None
        """Where it is set, it takes what the operators cost, and `explain` shows it."""
        self.late = 0
        """Rows that came behind a watermark, or for a window that had closed, and were dropped."""
        self.schedule = schedule(query, self.inputs, self.options)
        self._terms = TermValues(dictionary)
        self._static = StaticSide(background, self._terms)
        self._contents = Contents(self.schedule)
        self._watermarks: dict[str, int] = {}
        self._ended: set[str] = set()
        self._closed: int | None = None
        self._had_content = False
        self._difference: Difference | None = None
        if query.operator is not StreamOperator.RSTREAM:
            self._difference = Difference(query.operator, self._terms)
        self._translated: Query | None = None
        self._plan: Query | None = None
        self._rules: tuple[str, ...] = ()
        self._reason = ""
        self._incremental: Incremental | None = None
        self._patterns: PatternSolver | None = None
        self._served: tuple[Plan, ...] = ()
        self._no_increment = ""
        self._names_now = False
        self._spells = True
        self._prepare(query)

    def _prepare(self, query: ContinuousQuery) -> None:
        asked = _with_rows_only(query)
        tree = algebra(asked).algebra
        graphs = Graphs(self.schedule.named, query.static_named, query.window_variables)
        self._oxigraph = OxigraphWindows(
            body_sparql(asked),
            tree,
            self._static,
            self._terms,
            graphs,
            distinct=self.options.semantics == "set",
        )
        shape = query_shape(asked.sparql)
        try:
            bindings = {variable.value: term for variable, term in query.bindings.items()}
            self._translated = translate(
                tree, bindings, graphs, selects_all=shape is not None and shape.selects_all
            )
            plan, self._rules = optimize(self._translated.plan)
            self._plan = Query(self._translated.head, plan)
            self._choose(plan)
        except Unsupported as unsupported:
            self._reason = str(unsupported)
            if asks_for_times(tree):
                raise ValueError(
                    f"times of triples and {unsupported} do not go together in one query"
                ) from unsupported

    def push(self, input: str, triples: TimedTriples) -> None:
        """Rows continue ``input``: none before its watermark. Their terms are of our dictionary."""
        if triples.dictionary is not self._terms.dictionary:
            raise ValueError("the triples are of another dictionary")
        self._ended.discard(input)
        limit = self._limit(input)
        if self._contents.push_plain(input, triples.tables, limit):
            return
        for table in triples.tables:
            rows = self._relevant(table)
            if rows is not None:
                self.late += self._contents.push(input, rows, limit)

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

    def explain(self, flows: Mapping[str, Flow] | None = None) -> str:
        """The query, its windows, its logical plan, how that is executed and what it costs, for
        people; ``flows`` is what is known of the inputs, by name."""
        oxigraph = self._oxigraph
        return str(
            Stages(
                self.query,
                oxigraph.sparql,
                self.options,
                self.schedule,
                self._translated,
                self._plan,
                self._rules,
                self._reason,
                self._no_increment if self._incremental is None else self._incremental.shape,
                "" if oxigraph.counting is not None else oxigraph.merges,
                self.known(flows or {}),
                self._served,
                self.profile,
            )
        )

    def known(self, flows: Mapping[str, Flow]) -> Known:
        """What costs are estimated from."""
        distinct = self.options.semantics == "set"
        return Known(self.schedule, self._static, flows, distinct)

    def _choose(self, plan: Plan) -> None:
        self._names_now = names_now(plan)
        self._no_increment = self._not_folded(plan)
        if not self._no_increment:
            shape = shape_of(plan, self._static)
            if isinstance(shape, str):
                self._no_increment = shape
            else:
                window = self.schedule.windows[0].range
                assert window is not None
                self._incremental = Incremental(
                    shape,
                    self._static,
                    self._terms,
                    window // self.schedule.pane,
                    distinct=self.options.semantics == "set",
                )
        if self._incremental is None and JIT:
            self._join_patterns(plan)

    def _join_patterns(self, plan: Plan) -> None:
        """Have the parts of the plan that are joins of patterns solved by a compiled loop."""
        windows = self.schedule.windows
        if self._names_now or any(one.counted for one in windows):
            return
        plan = pattern_parts(plan)
        parts = tuple(served_parts(plan))
        if parts and self._plan is not None:
            self._served = parts
            self._plan = Query(self._plan.head, plan)
            graphs = [one.graph for one in windows]
            distinct = self.options.semantics == "set"
            shown = head_variables(self._plan.head)
            wanted = [
                (part, needed_outside(plan, part) | (shown & outputs(part))) for part in parts
            ]
            self._patterns = PatternSolver(wanted, graphs, self._static, distinct=distinct)
            covered = {id(node) for part in parts for node in walk(part)}
            scans = (Scan, TypeScan, AnyScan, Closure)
            alone = all(id(n) in covered for n in walk(plan) if isinstance(n, scans))
            self._contents.read_by(self._patterns, alone=alone)
            self._spells = not alone

    def _not_folded(self, plan: Plan) -> str:
        """Why windows cannot be folded pane by pane, whatever the plan computes."""
        if not self.schedule.uniform:
            return "the windows are several, or not of time alone"
        if self._difference is not None or self.options.report != "non-empty":
            return "windows without content are evaluated too"
        if self._names_now:
            return "it asks for NOW()"
        for node in walk(plan):
            if not isinstance(node, Scan | TypeScan | AnyScan | Closure):
                continue
            if node.graph != self.schedule.windows[0].graph:
                return "it reads several graphs"
            if isinstance(node, TypeScan) and node.graph != DEFAULT:
                return "what a named window says of sorts is not folded"
            if isinstance(node, Scan) and node.times.names:
                return "it asks when triples were said"
        return ""

    def _relevant(self, table: TripleRows) -> TripleRows | None:
        """The rows that stand for a triple, each object in its canonical spelling (`patterns` see
        to that themselves)."""
        if self._spells:
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
            closed = self._contents.limit(input, self._closed)
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

    def _close(self) -> list[WindowResult]:
        watermark = self._watermark()
        results: list[WindowResult] = []
        if watermark is None:
            return results
        self._contents.settle(watermark)
        while True:
            due = self._due()
            if due is None or watermark <= due.end - self.schedule.shift:
                break
            result = self._evaluate(due)
            if result is not None:
                results.append(result)
        return results

    def _due(self) -> Due | None:
        """The next evaluation: one with content, or one that is asked for without."""
        due = self._contents.next(self._closed)
        if self._closed is None or self.schedule.ends is None:
            return due
        following = Due(self.schedule.after(self._closed))
        if due is not None and due.end == following.end:
            return due
        ended = len(self._ended) == len(self.inputs)
        if self.options.report == "close":
            return None if due is None and ended else following
        # What has left the result is to be told, though nothing is there any more.
        leaves = self._difference is not None or self.options.report == "change"
        return following if leaves and self._had_content else due

    def _evaluate(self, due: Due) -> WindowResult | None:
        end = due.end
        if self._incremental is not None:
            self._fold(self._incremental, end)
        content, changed = self._contents.changed(due, self._closed)
        self._closed, self._had_content = end, content
        reports = {"non-empty": content, "change": changed, "close": True}[self.options.report]
        result = None
        begin = 0 if self.profile is None else self.profile.clock()
        self._contents.turn(due)
        if self.profile is not None and self._served:
            # All parts read what this selects: it is told with the first of them.
            self.profile.beside(self._served[0], self.profile.clock() - begin)
        if reports or self._difference is not None:
            result = self._solve(end)
        if result is not None and self._difference is not None:
            result = self._difference.of(result)
            result = result if reports or result.size else None
        keeps = self._incremental is None or self._incremental.shape.retains
        self._contents.drop(end, raw=keeps)
        return result

    def _fold(self, incremental: Incremental, end: int) -> None:
        """The panes up to ``end`` that have content, oldest first; others are skipped."""
        window = self.schedule.windows[0]
        assert window.grid is not None
        scan, rows = incremental.shape.scan, 0
        predicate = self._terms.dictionary.find(scan.predicate)
        begin = 0 if self.profile is None else self.profile.clock()
        intakes = self._contents.intakes.values()
        done = window.bounds(end)[0]
        if self._closed is not None:
            done = max(done, self._closed)
        while True:
            times = [intake.earliest(done) for intake in intakes]
            time = min((time for time in times if time is not None), default=None)
            if time is None or time > end:
                break
            pane_end = time + (window.grid.origin - time) % self.schedule.pane
            tables = [
                table
                for intake in intakes
                for table in intake.between(pane_end - self.schedule.pane, pane_end)
            ]
            incremental.fold(pane_end, tables)
            if self.profile is not None:
                columns = (t.objects.get(predicate) for t in tables)
                rows += sum(int(c.present.sum()) for c in columns if c is not None)
            done = pane_end
        incremental.evict(window.bounds(end)[0])
        if self.profile is not None:
            self.profile.add(scan, rows, 0)
            self.profile.beside(scan, self.profile.clock() - begin)

    def _span(self, end: int) -> tuple[int, int]:
        """The start and end that the result at ``end`` is told with."""
        shift = self.schedule.shift
        lows = [one.bounds(end)[0] for one in self.schedule.windows if not one.lasts]
        return min(lows, default=end) - shift, end - shift

    def _solve(self, end: int) -> WindowResult:
        start, shown = self._span(end)
        contents = _Windows(self._contents, end)
        if self._plan is not None:
            for incremental in dict.fromkeys((self._incremental, None)):
                try:
                    source = _Source(
                        contents,
                        self._static,
                        self.options,
                        self.schedule.named,
                        incremental,
                        self._patterns,
                    )
                    source.profile = self.profile
                    plan = self._plan.plan
                    plan = at_time(plan, shown) if self._names_now else plan
                    relation = execute(plan, source, self._terms)
                    return finish(self._plan.head, relation, start, shown, self._terms)
                except NeedsOxigraph:
                    # Not folded, columns may do; else Oxigraph is as exact, bags too; where it is
                    # not, the result says so (`merged`).
                    continue
        return self._oxigraph.solve(contents.tables, start, shown)


def _with_rows_only(query: ContinuousQuery) -> ContinuousQuery:
    """An AGGREGATE over nothing gives no row, as one with group keys does ([Events14 §III.A])."""
    if not query.aggregations or group_keys(query):
        return query
    some = ("(COUNT(*) > 0)", Span(0, 0))
    return replace(query, aggregate_filters=(*query.aggregate_filters, some))


class _Windows:
    """The rows of the windows at an end, brought together when somebody looks at them."""

    def __init__(self, contents: Contents, end: int) -> None:
        self.contents = contents
        self.end = end

    @cached_property
    def tables(self) -> Mapping[str, Sequence[TripleRows]]:
        return self.contents.tables(self.end)


class _Source(WindowSource):
    """The leaves of windows, and what is at hand without them: the groups of the incremental
    aggregate, the joins of patterns."""

    def __init__(
        self,
        windows_now: _Windows,
        static: StaticSide,
        options: Options,
        windows: Sequence[str],
        incremental: Incremental | None,
        patterns: PatternSolver | None,
    ) -> None:
        super().__init__({}, static, windows=windows, distinct=options.semantics == "set")
        self._windows_now = windows_now
        self.incremental = incremental
        self.patterns = patterns

    def tables(self, graph: str) -> Sequence[TripleRows]:
        return self._windows_now.tables.get(graph, ())

    def ready(self, plan: Plan) -> Relation | None:
        if self.incremental is not None:
            # Brought together only if the aggregate has to be joined with rows.
            shape = self.incremental.shape
            rows = Rows(lambda: list(self.tables(shape.scan.graph)) if shape.retains else [])
            return self.incremental.ready(plan, rows)
        return None if self.patterns is None else self.patterns.solve(plan)
