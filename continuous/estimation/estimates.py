"""Estimated cost of each operator of a plan: rows out (`cardinality`) and time.

`explain` shows it beside the measured cost. One decision uses it: whether queries that differ in
constants are computed together (`similar_queries.break_even_count`), which changes no result.

Law (tests/laws/continuous/test_estimates.py): finite, never negative; exact for a pattern over the
static side alone; a join with a static pattern that has each key once gives at most the rows of the
other side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import assert_never

from ..algebra.expressions import Var, variables
from ..algebra.plan import Plan, expressions_of, inputs, walk
from ..columns.expression_evaluation import foreign_calls
from ..incremental.aggregate_shape import Shape
from .cardinality import MOST, Sizes, combinations, joined_all
from .pattern_sizes import Known, Size


class Way(StrEnum):
    """How an operator is computed (docs/explanation/semantics.md, "How it is computed")."""

    COLUMNS = "in columns"
    INCREMENTAL = "incrementally"
    FOLDED = "folded, each step"
    COMPILED = "one compiled loop"
    WITHIN = "within"


@dataclass(frozen=True, slots=True)
class Estimate:
    """Of one operator in a window: rows out (None where it makes none), its own time in ns (0
    ``WITHIN`` another), and how it is computed. ``FOLDED``: of a step."""

    rows: float | None
    nanoseconds: float
    way: Way


def estimate(
    plan: Plan, known: Known, shape: Shape | None = None, served: Sequence[Plan] = ()
) -> dict[int, Estimate]:
    """The estimates of the operators of ``plan``, by their identity.

    ``shape``: the part that is computed incrementally; ``served``: the parts that a compiled loop
    solves. Cost: it reads the rows of its patterns on the static side, once a version.
    """
    sizes = Sizes(known)
    ways = _ways(plan, shape, served)
    unmade = set() if shape is None else {id(n) for n in walk(shape.aggregate.child) if inputs(n)}
    found: dict[int, Estimate] = {}
    for node in walk(plan):
        way = ways[id(node)]
        rows = sizes.of(node).rows
        if shape is not None and node is shape.scan:
            rows = sizes.patterns.step(shape.scan)
        shown = None if id(node) in unmade else rows
        found[id(node)] = Estimate(shown, _time(node, way, rows, sizes, shape), way)
    return found


def _ways(plan: Plan, shape: Shape | None, served: Sequence[Plan]) -> dict[int, Way]:
    ways = {id(node): Way.COLUMNS for node in walk(plan)}
    tops: Sequence[Plan] = served
    if shape is not None:
        tops = [shape.having[0] if shape.having and shape.direct else shape.aggregate]
    for top in tops:
        ways |= {id(node): Way.WITHIN for node in walk(top)}
        ways[id(top)] = Way.COMPILED if shape is None else Way.INCREMENTAL
    if shape is not None:
        ways |= {id(part): Way.COLUMNS for part in shape.rest}
        ways[id(shape.scan)] = Way.FOLDED
    return ways


# -- time ----------------------------------------------------------------------------------

COST: Mapping[str, tuple[float, float]] = {
    "Scan": (25_000, 0.6),
    "TypeScan": (60_000, 150),
    "AnyScan": (60_000, 200),
    "Closure": (300_000, 1_700),
    "Values": (10_000, 1_000),
    "Given": (1_000, 0),
    "Join": (20_000, 150),
    "LeftJoin": (22_000, 150),
    "Union": (36_000, 1.2),
    "Minus": (20_000, 240),
    "Exists": (32_000, 160),
    "Filter": (44_000, 7),
    "Extend": (42_000, 1.7),
    "Aggregate": (120_000, 140),
    "Project": (5_000, 0.1),
    "Distinct": (24_000, 230),
    "Order": (12_000, 110),
    "Slice": (10_000, 1.3),
    "INCREMENTAL": (45_000, 12),
    "FOLDED": (60_000, 20),
    "COMPILED": (50_000, 31),
}
"""By operator or way: ns a call, and ns a row that goes in or out.
``python bench/queries/estimates.py`` measured them once, with 100 and 30,000 rows; they are rough
and depend on the machine."""
FOREIGN = 15_000.0
"""ns to have Oxigraph compute a function for one distinct combination of arguments."""


def _time(node: Plan, way: Way, rows: float, sizes: Sizes, shape: Shape | None) -> float:
    spent = 0.0
    match way:
        case Way.WITHIN:
            return 0.0
        case Way.FOLDED:
            spent = _cost(way.name, rows)
        case Way.COMPILED:
            leaves = (sizes.of(leaf).rows for leaf in walk(node) if not inputs(leaf))
            spent = _cost(way.name, rows + sum(leaves))
        case Way.INCREMENTAL:
            assert shape is not None
            spent = _cost(way.name, rows) + _kept(shape, sizes)
        case Way.COLUMNS:
            below = [sizes.of(part) for part in inputs(node)]
            spent = _cost(type(node).__name__, rows + sum(one.rows for one in below))
            for call in (c for e in expressions_of(node) for c in foreign_calls(e)):
                spent += FOREIGN * combinations(below[0], variables(call))
        case _:
            assert_never(way)
    return min(spent, MOST)


def _cost(name: str, rows: float) -> float:
    call, row = COST[name]
    return call + row * rows


def _kept(shape: Shape, sizes: Sizes) -> float:
    """The time to join the kept subjects with the rest, and to group them."""
    if not shape.rest:
        return 0.0
    scan, rest = shape.scan, [sizes.of(part) for part in shape.rest]
    subjects = Size(1.0, {})
    if isinstance(scan.subject, Var):
        v = sizes.of(scan).v(scan.subject.name)
        subjects = Size(v, {scan.subject.name: v})
    joined = joined_all([subjects, *rest]).rows
    moved = subjects.rows + sum(one.rows for one in rest) + joined
    return _cost("Join", moved) + _cost("Aggregate", joined)
