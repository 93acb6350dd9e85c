"""How a continuous query is computed, stage by stage, for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..languages.csparql import format_query
from ..languages.csparql.ast import ContinuousQuery
from ..rdf.namespaces import shorten
from ..streams.time import format_duration
from .logical import Query, describe, show
from .options import Options
from .shapes import Shape
from .windows import Schedule


@dataclass(frozen=True, slots=True, eq=False)
class Stages:
    """text → AST → logical plan → rules → physical operators.

    ``translated`` and ``plan`` are None where the query runs on Oxigraph, ``reason`` says why;
    else ``shape`` is how it is computed incrementally, or why it is not. ``merges`` is why
    Oxigraph counts equal triples once although the bag is asked for, "" where it does not.
    """

    query: ContinuousQuery
    sparql: str
    options: Options
    inputs: Sequence[str]
    schedule: Schedule
    translated: Query | None
    plan: Query | None
    rules: Sequence[str]
    reason: str
    shape: Shape | str
    merges: str

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        query = self.query
        yield f"query {query.name} ({query.form}), {self.options.semantics} semantics"
        yield from _section("as read", format_query(query).splitlines())
        yield from _section("windows", self._windows())
        if self.translated is None or self.plan is None:
            yield f"on Oxigraph, a fresh store a window, because of {self.reason}"
            yield from _section("SPARQL", self.sparql.splitlines())
            yield from self._equal_triples()
            return
        yield from _section("logical plan", str(self.translated).splitlines())
        if self.rules:
            names = ", ".join(rule.replace("_", " ") for rule in self.rules)
            yield from _section(f"improved by: {names}", str(self.plan).splitlines())
        if isinstance(self.shape, str):
            yield f"in columns, each window anew: {self.shape}"
        else:
            yield from _section("in columns, incrementally", self._operators(self.shape))
        if isinstance(self.shape, str) or self.shape.retains:
            yield "on Oxigraph, a window whose data need it (dates, ordered strings, overflow)"
            yield from self._equal_triples()

    def _windows(self) -> Iterator[str]:
        for name, window in zip(self.inputs, self.schedule.inputs, strict=True):
            length, step = format_duration(window.range), format_duration(window.grid.step)
            yield f"{name}: RANGE {length} STEP {step} {self.options.bounds}"
        yield f"evaluated every {format_duration(self.schedule.ends.step)}"

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
