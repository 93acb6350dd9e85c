"""The execution of a plan over successive windows.

A plan has up to three kinds of parts. An aggregate is folded as rows come; joins of patterns run in
a compiled loop; the rest is computed from all rows of each window.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property

import numpy as np

from ...rdf.namespaces import RDF_TYPE
from ...rdf.timed import Kind, ObjectColumn, TripleRows
from ...streams.jit import JIT
from ..algebra.plan import (
    DEFAULT,
    AnyScan,
    Closure,
    Plan,
    Scan,
    TypeScan,
    outputs,
    walk,
)
from ..algebra.triple_times import names_now
from ..algebra.volatile_functions import has_volatile
from ..columns.relation import NeedsOxigraph, Relation
from ..incremental.aggregate_shape import Shape, shape_of
from ..incremental.aggregation import IncrementalAggregate
from ..incremental.bulk_aggregation import CELLS, BulkAggregate, fitting
from ..operators.executor import Step, execute, run, steps_above, united
from ..operators.profile import Profile
from ..operators.result_forms import END
from ..operators.sources import StaticSide, WindowSource
from ..pattern_join.plan_cut import needed_outside, pattern_parts, served_parts
from ..pattern_join.solver import PatternSolver
from ..windows.contents import Contents
from ..windows.grid import Grid
from ..windows.window_schedule import OpenWindows

_SCANS = (Scan, TypeScan, AnyScan, Closure)


class Execution:
    """How ``plan`` is executed over ``windows``; other queries may read the same windows.

    ``folds``: compute an aggregate incrementally if possible.
    """

    def __init__(
        self, plan: Plan, windows: OpenWindows, static: StaticSide, *, folds: bool = True
    ) -> None:
        self.plan = plan
        self.windows = windows
        self.static = static
        self.names_now = names_now(plan)
        self.has_volatile = has_volatile(plan)
        self.distinct = windows.options.semantics == "set"
        self.incremental: IncrementalAggregate | None = None
        self.patterns: PatternSolver | None = None
        self.served: tuple[Plan, ...] = ()
        """The parts that the compiled loop evaluates."""
        self.steps: tuple[Step, ...] | None = None
        """The operators above the aggregate that `incremental` computes, if these are all."""
        self.not_folded = self._not_folded() if folds else "it is not to be folded"
        """Why `incremental` is None, or empty."""
        self._folded: int | None = None
        if not self.not_folded:
            self._fold_aggregate()

    @property
    def shape(self) -> Shape | str:
        """How the plan is computed incrementally, or why it is not."""
        return self.not_folded if self.incremental is None else self.incremental.shape

    @property
    def retains(self) -> bool:
        """Whether the rows of a window are needed after it has closed."""
        return self.incremental is None or self.incremental.shape.retains

    def join_patterns(self, shown: frozenset[str]) -> None:
        """Let a compiled loop evaluate those parts of the plan that are joins of patterns. The loop
        stores the rows in its own form, so no other query may read the windows. ``shown`` are the
        variables of the plan's result that the query uses."""
        windows = self.windows.schedule.windows
        counted = any(one.counted for one in windows)
        if (
            self.incremental is not None
            or not JIT
            or self.names_now
            or self.has_volatile
            or counted
        ):
            return
        plan = pattern_parts(self.plan)
        parts = tuple(served_parts(plan))
        if not parts:
            return
        self.plan, self.served = plan, parts
        graphs = [one.graph for one in windows]
        needed = needed_outside(plan, parts)
        wanted = [
            (part, names | (shown & outputs(part)))
            for part, names in zip(parts, needed, strict=True)
        ]
        self.patterns = PatternSolver(wanted, graphs, self.static, distinct=self.distinct)
        covered = {id(node) for part in parts for node in walk(part)}
        # If the loop evaluates every scan, it alone stores the rows.
        alone = all(id(node) in covered for node in walk(plan) if isinstance(node, _SCANS))
        self.windows.contents.attach_patterns(self.patterns, alone=alone)

    def fold(self, end: int, profile: Profile | None = None) -> None:
        """Fold the panes up to ``end`` in order, but skip empty ones. The first call folds the
        whole window. ``profile`` records the cost."""
        if self.incremental is None:
            return
        scan, rows = self.incremental.shape.scan, 0
        begin = 0 if profile is None else profile.clock()
        window = self.windows.schedule.windows[0]
        assert window.grid is not None
        low, _ = window.bounds(end)
        buffers = self.windows.contents.buffers.values()
        done = low if self._folded is None else max(low, self._folded)
        pane = self.windows.schedule.pane
        while done < end:
            # The usual case first: one pane has been completed.
            if end - done > pane:
                times = [buffer.earliest(done) for buffer in buffers]
                time = min((time for time in times if time is not None), default=None)
                if time is None or time > end:
                    break
                done = time + (window.grid.origin - time) % pane - pane
            done += pane
            tables = [t for buffer in buffers for t in buffer.between(done - pane, done)]
            if tables:
                self.incremental.fold(done, tables)
            if profile is not None:
                predicate = self.static.terms.dictionary.find(scan.predicate)
                columns = (table.objects.get(predicate) for table in tables)
                rows += sum(int(c.present.sum()) for c in columns if c is not None)
        self.incremental.evict(low)
        self._folded = end
        if profile is not None:
            profile.add(scan, rows, 0)
            profile.beside(scan, profile.clock() - begin)

    def in_bulk(self, ends: Sequence[int], most: int) -> tuple[BulkAggregate, Relation] | None:
        """Return the aggregate over windows that one pass covers, from the first of ``ends`` on,
        and its solutions for these. None if the pass covers fewer than two, or if they have more
        than ``most`` rows each. Changes nothing but the numbers of groups."""
        assert self.incremental is not None
        window = self.windows.schedule.windows[0]
        assert window.grid is not None
        assert window.range is not None
        low, _ = window.bounds(ends[0])
        folded = low if self._folded is None else max(low, self._folded)
        # Extremes of folded panes cannot be read back, so their rows are read again.
        since = low if self.incremental.has_extremes else folded
        tables = self._rows(since, ends[-1])
        if sum(map(len, tables)) > most * len(ends):
            return None
        pane = self.windows.schedule.pane
        count = fitting(
            self.incremental, len(ends), window.range // pane, window.grid.step // pane, tables
        )
        rest = self.incremental.shape.rest
        reach = self._rows(low, ends[count - 1]) if rest and count > 1 else []
        moving = [part for part in rest if self._moves(part, reach)]
        if moving:
            # Each window has rows of its own of these patterns.
            held = sum(map(len, reach)) * window.range // (ends[count - 1] - low)
            count = min(count, CELLS // max(1, held * len(moving)))
        if count < 2:
            return None
        ends = ends[:count]
        tables = self._rows(since, ends[-1])
        # A pattern without rows in these windows has the same solutions in each.
        relations = [self._solved(part, ends if part in moving else ends[:1]) for part in rest]
        panes = Grid(pane, window.grid.origin)
        bulk = BulkAggregate(self.incremental, ends, window.range, panes, folded, tables)
        relation = bulk.relation(relations)
        return None if relation is None else (bulk, relation)

    def _moves(self, part: Plan, tables: Sequence[TripleRows]) -> bool:
        """Whether a window over some of ``tables`` may have triples of the pattern ``part``."""
        find = self.static.terms.dictionary.find
        if isinstance(part, TypeScan):
            rdf_type = find(RDF_TYPE)
            return any(t.sort is not None or rdf_type in t.objects for t in tables)
        return isinstance(part, Scan) and any(find(part.predicate) in t.objects for t in tables)

    def _solved(self, part: Plan, ends: Sequence[int]) -> Relation:
        """Return the solutions of ``part`` for the windows at ``ends``, with the column `END` if
        there are several of these."""
        windows = (WindowRows(self.windows.contents, end) for end in ends)
        sources = (_Source(self, rows, None, None) for rows in windows)
        relations = [execute(part, source, self.static.terms) for source in sources]
        if len(ends) == 1:
            return relations[0]
        numbered = []
        for i, relation in enumerate(relations):
            window = ObjectColumn(Kind.INTEGER, np.full(relation.rows, i))
            numbered.append(Relation({END: window, **relation.columns}, relation.rows))
        return united(numbered, self.static.terms)

    def follow(self, bulk: BulkAggregate) -> None:
        """Bring the aggregate to the last window of ``bulk``, which `in_bulk` has evaluated."""
        assert self.incremental is not None
        end = bulk.ends[-1]
        if bulk.hand_over():
            self.incremental.evict(self.windows.schedule.windows[0].bounds(end)[0])
            self._folded = end
        else:
            self.fold(end)
        self.incremental.jump()

    def solutions(self) -> Relation | None:
        """Return the solutions of the plan for the window that `fold` has folded, if the steps
        above the aggregate need no other source; else None. Law: `execute` returns the same."""
        if self.incremental is None or self.steps is None:
            return None
        try:
            aggregated = self.incremental.solutions()
            if aggregated is None:
                return None
            return run(self.steps, aggregated, self.static.terms)
        except NeedsOxigraph:
            # `sources` has another way, which may suffice.
            return None

    def _rows(self, low: int, high: int) -> list[TripleRows]:
        """Return the rows with ``low`` < τ ≤ ``high`` that some window contains."""
        buffers = self.windows.contents.buffers.values()
        tables = [table for buffer in buffers for table in buffer.between(low, high)]
        window = self.windows.schedule.windows[0]
        assert window.grid is not None
        assert window.range is not None
        if window.range >= window.grid.step:
            return tables
        # `fold` skips what is between two windows: a group of such a row would be one too many.
        step, origin = window.grid.step, window.grid.origin
        return [table.take((origin - table.time) % step < window.range) for table in tables]

    def sources(self, rows: WindowRows, profile: Profile | None = None) -> Iterator[WindowSource]:
        """Yield the sources for an execution of the plan. The first uses the folded aggregate; the
        second reads the rows, for a window whose values cannot be folded. ``profile`` records the
        cost of the operators."""
        if self.incremental is not None:
            yield _Source(self, rows, self.incremental, profile)
        yield _Source(self, rows, None, profile)

    def _fold_aggregate(self) -> None:
        shape = shape_of(self.plan, self.static)
        if isinstance(shape, str):
            self.not_folded = shape
            return
        self.steps = steps_above(self.plan, shape.aggregate)
        schedule = self.windows.schedule
        window = schedule.windows[0].range
        assert window is not None
        self.incremental = IncrementalAggregate(
            shape,
            self.static,
            self.static.terms,
            window // schedule.pane,
            distinct=self.distinct,
        )

    def _not_folded(self) -> str:
        """Return why these windows cannot be folded pane by pane, or ""."""
        schedule = self.windows.schedule
        if not schedule.uniform:
            return "the windows are several, or not of time alone"
        if self.names_now:
            return "it asks for NOW()"
        if self.has_volatile:
            return "it asks for what is drawn anew for each window"
        for node in walk(self.plan):
            if not isinstance(node, _SCANS):
                continue
            if node.graph != schedule.windows[0].graph:
                return "it reads several graphs"
            if isinstance(node, TypeScan) and node.graph != DEFAULT:
                return "what a named window says of sorts is not folded"
            if isinstance(node, Scan) and node.times.names:
                return "it asks when triples were said"
        return ""


class WindowRows:
    """The rows of the windows at an end, collected on first use."""

    def __init__(self, contents: Contents, end: int) -> None:
        self.contents = contents
        self.end = end

    @cached_property
    def tables(self) -> Mapping[str, Sequence[TripleRows]]:
        """The rows by graph, input by input."""
        return self.contents.tables(self.end)


class _Source(WindowSource):
    """The windows as leaves of the plan, with the results that exist already: the groups of the
    incremental aggregate, the joins of patterns."""

    def __init__(
        self,
        execution: Execution,
        rows: WindowRows,
        incremental: IncrementalAggregate | None,
        profile: Profile | None,
    ) -> None:
        named = execution.windows.schedule.named
        super().__init__(execution.static, named, execution.distinct, profile)
        self.rows = rows
        self.incremental = incremental
        self.patterns = execution.patterns

    def tables(self, graph: str) -> Sequence[TripleRows]:
        return self.rows.tables.get(graph, ())

    def ready(self, plan: Plan) -> Relation | None:
        if self.incremental is not None:
            return self.incremental.ready(plan, self)
        return None if self.patterns is None else self.patterns.solve(plan)
