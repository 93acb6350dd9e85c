"""The stages in which a continuous query is computed, as text for users."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final, assert_never

from ...languages.csparql import format_query
from ...languages.csparql.ast import (
    ContinuousQuery,
    CountWindow,
    LandmarkWindow,
    StreamOperator,
    TimeWindow,
    Window,
)
from ...rdf.namespaces import shorten
from ...streams.time import format_duration, format_time
from ..algebra.options import Options
from ..algebra.plan import DEFAULT, Plan, Query, expressions_of, walk
from ..algebra.plan_text import describe, describe_query, show
from ..columns.expression_evaluation import foreign_calls
from ..estimation.costs import OperatorCost, cost_table, operator_costs
from ..estimation.estimates import estimate
from ..estimation.pattern_sizes import Known
from ..incremental.aggregate_shape import Shape
from ..operators.profile import Profile
from ..windows.grid import Schedule

_OTHER_ANSWERS: Final = (
    "other answers there: integers beyond 64 bits, decimals beyond 18 places, overflowing sums, "
    "MIN and MAX, COUNT of errors, MINUS in EXISTS (docs/explanation/semantics.md)"
)


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """text → AST → logical plan → rules → physical operators.

    ``translated`` and ``plan`` are None if the query runs on Oxigraph, for ``reason``. ``shape``
    describes the incremental computation, or says why there is none. ``merges`` says why Oxigraph
    counts equal triples once under bag semantics, or is "". ``known`` is the basis of the cost
    estimates, ``served`` the parts of the plan that a compiled loop evaluates. ``singly`` says why
    windows that are due at once are evaluated one by one, or is "". ``entailed`` is what the schema
    adds to the streams' triples, ``profile`` the measured costs, if any.
    """

    query: ContinuousQuery
    sparql: str
    options: Options
    schedule: Schedule
    translated: Query | None
    plan: Query | None
    rules: Sequence[str]
    reason: str
    shape: Shape | str
    merges: str
    known: Known
    served: Sequence[Plan]
    singly: str
    entailed: Sequence[str]
    profile: Profile | None = None

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def operators(self) -> tuple[OperatorCost, ...]:
        """The operators of the plan with their costs a window; none where Oxigraph evaluates."""
        if self.plan is None:
            return ()
        shape = None if isinstance(self.shape, str) else self.shape
        costs = estimate(self.plan.plan, self.known, shape, self.served)
        return operator_costs(self.plan.plan, costs, self.profile)

    def _lines(self) -> Iterator[str]:
        query = self.query
        name = f" {query.name}" if query.name else ""
        yield f"query{name} ({query.form}), {self.options.semantics} semantics"
        yield from _section("as read", format_query(query).splitlines())
        yield from _section("windows", self._windows())
        if self.entailed:
            yield from _section("entailed of each triple of a stream", self.entailed)
        if self.translated is None or self.plan is None:
            yield f"on Oxigraph, a fresh store a window, because of {self.reason}"
            yield f"  {_OTHER_ANSWERS}"
            yield from _section("SPARQL", self.sparql.splitlines())
            yield from self._equal_triples()
            return
        yield from _section("logical plan", describe_query(self.translated))
        if self.rules:
            names = ", ".join(rule.replace("_", " ") for rule in self.rules)
            yield from _section(f"improved by: {names}", describe_query(self.plan))
        table = cost_table(self.operators(), self.known)
        yield from _section("costs a window: rows out, own time (estimates are rough)", table)
        if isinstance(self.shape, str):
            yield f"in columns, each window anew: {self.shape}"
        else:
            yield from _section("in columns, incrementally", self._operators(self.shape))
            how = f"one by one, since {self.singly}" if self.singly else "in one pass"
            yield f"windows that are due at once: {how}"
        asked = sorted({name for node in walk(self.plan.plan) for name in _strange(node)})
        if asked:
            yield f"asked of Oxigraph, a distinct combination of values: {', '.join(asked)}"
        if self.query.operator is not StreamOperator.RSTREAM:
            yield f"{self.query.operator}: what is other than in the result before"

    def _windows(self) -> Iterator[str]:
        for one in self.schedule.windows:
            graph = "" if one.graph == DEFAULT else f" as {shorten(one.graph)}"
            bounds = "" if one.counted else f" {self.options.bounds}"
            yield f"{one.input}: {_window(one.window)}{bounds}{graph}"
        ends = self.schedule.ends
        if ends is None:
            yield "evaluated whenever a window has moved on"
        else:
            yield f"evaluated every {format_duration(ends.step)}"
        if self.options.report != "non-empty":
            yield f"reported: {self.options.report}"

    def _equal_triples(self) -> Iterator[str]:
        if self.options.semantics == "bag":
            if self.merges:
                yield f"  equal triples count once there, because of {self.merges}: `merged`"
            else:
                yield "  equal triples count each there: patterns are asked of a graph a copy"

    def _operators(self, shape: Shape) -> Iterator[str]:
        scan = shape.scan
        what = ", ".join("rows" if a is None else show(a) for a, _ in shape.arguments)
        pattern = f"{show(scan.subject)} {shorten(scan.predicate.value)} {show(scan.object)}"
        pane = format_duration(self.schedule.pane)
        yield f"fold {what} of {pattern} by subject, in panes of {pane}"
        for condition in shape.filters:
            yield f"  rows where {show(condition)}"
        distinct = ", equal triples once" if self.options.semantics == "set" else ""
        yield f"add what comes, take away what expires{distinct}"
        for sort in shape.sorts:
            yield f"keep subjects of sort {shorten(sort.value)}"
        for part in shape.rest:
            first, *below = describe(part)
            yield f"join {first}"
            yield from (f"  {line}" for line in below)
        for condition in shape.later:
            yield f"keep where {show(condition)}"
        keys = " ".join(f"?{key}" for key in shape.aggregate.keys) or "nothing"
        yield f"group by {keys}, then what stands above the aggregate in the plan"


def _section(title: str, lines: Iterator[str] | Sequence[str]) -> Iterator[str]:
    yield f"{title}:"
    yield from (f"  {line.rstrip()}" for line in lines if line.strip())


def _window(window: Window) -> str:
    match window:
        case TimeWindow(range, step):
            return f"RANGE {format_duration(range)} STEP {format_duration(step)}"
        case CountWindow(size, step):
            return f"TRIPLES {size} STEP {step}"
        case LandmarkWindow(start, step):
            since = "" if start is None else f" {format_time(start)}"
            return f"LANDMARK{since} STEP {format_duration(step)}"
        case _:
            assert_never(window)


def _strange(node: Plan) -> Iterator[str]:
    """Yield the functions in a node that columns do not implement."""
    for expression in expressions_of(node):
        yield from (call.name for call in foreign_calls(expression))
