"""The shape of an aggregate that can be computed incrementally, found when a query is planned."""

from __future__ import annotations

from dataclasses import dataclass

from pyoxigraph import Literal, NamedNode

from ..algebra.expressions import (
    COMPARISONS,
    Call,
    Const,
    Expression,
    Var,
    variables,
)
from ..algebra.plan import (
    Aggregate,
    Extend,
    Filter,
    Join,
    Plan,
    Scan,
    TypeScan,
    Values,
    outputs,
    walk,
)
from ..operators.sources import StaticSide


@dataclass(frozen=True, slots=True)
class Shape:
    """How an Aggregate is computed incrementally.

    The rows of ``scan`` that pass ``filters`` are folded. Subjects must be of all ``sorts``. For
    each window ``rest`` is joined, then the ``later`` filters apply. ``arguments``: the aggregated
    expressions (None if there is only ``*``), each with whether it needs extremes. ``retains``: raw
    rows stay as long as their window, since the rest or a fallback may read them. ``having``: the
    Filters on the aggregate, the outermost first.
    """

    aggregate: Aggregate
    scan: Scan
    sorts: tuple[NamedNode, ...]
    rest: tuple[Plan, ...]
    filters: tuple[Expression, ...]
    later: tuple[Expression, ...]
    arguments: tuple[tuple[Expression | None, bool], ...]
    retains: bool
    having: tuple[Filter, ...]

    @property
    def plain(self) -> bool:
        """Whether rows can be folded without selection or computed arguments."""
        return (
            isinstance(self.scan.subject, Var)
            and isinstance(self.scan.object, Var)
            and not self.filters
            and all(argument in (None, self.scan.object) for argument, _ in self.arguments)
        )

    @property
    def direct(self) -> bool:
        """Whether the subjects are the groups."""
        subject = self.scan.subject
        return (
            isinstance(subject, Var)
            and self.aggregate.keys == (subject.name,)
            and not self.rest
            and not self.later
        )


def shape_of(plan: Plan, static: StaticSide) -> Shape | str:
    """Return how ``plan`` can be computed incrementally, or why it cannot."""
    aggregates = [node for node in walk(plan) if isinstance(node, Aggregate)]
    if len(aggregates) != 1:
        return "it has no aggregate" if not aggregates else "it has several aggregates"
    aggregate = aggregates[0]
    leaves: list[Plan] = []
    conditions: list[Expression] = []
    if not _flat(aggregate.child, leaves, conditions):
        return "there is more than patterns, FILTER and VALUES under the aggregate"
    scans = [leaf for leaf in leaves if isinstance(leaf, Scan)]
    # Try first a predicate without static triples: it probably comes from the stream.
    scans.sort(key=lambda scan: static.background.has(scan.predicate))
    reason = "there is no pattern to fold"
    for scan in scans:
        found = _try(plan, aggregate, scan, leaves, conditions)
        if isinstance(found, Shape):
            return found
        reason = found
    return reason


def _flat(plan: Plan, leaves: list[Plan], conditions: list[Expression]) -> bool:
    match plan:
        case Scan() | TypeScan() | Values():
            leaves.append(plan)
            return True
        case Filter(condition, child):
            conditions.append(condition)
            return _flat(child, leaves, conditions)
        case Join(parts):
            flat = [_flat(part, leaves, conditions) for part in parts]
            return all(flat)
        case _:
            return False


def _try(
    plan: Plan, aggregate: Aggregate, scan: Scan, leaves: list[Plan], conditions: list[Expression]
) -> Shape | str:
    own = outputs(scan)
    subject = scan.subject.name if isinstance(scan.subject, Var) else None
    value = scan.object.name if isinstance(scan.object, Var) else None
    if subject is not None and subject == value:
        return "subject and object are one variable"
    others = [leaf for leaf in leaves if leaf is not scan]
    elsewhere = frozenset().union(*map(outputs, others))
    # A fold keeps no single values, so none is left to join or group by.
    if value is not None and (value in elsewhere or value in aggregate.keys):
        return f"?{value} is joined or grouped by"
    wanted: dict[Expression | None, bool] = {}
    for one in aggregate.aggregations:
        if one.distinct or one.function not in ("COUNT", "SUM", "AVG", "MIN", "MAX"):
            return f"{one.function}{' DISTINCT' if one.distinct else ''} needs all values"
        if one.argument is not None and not variables(one.argument) <= own:
            return f"{one.function} is not over the folded pattern alone"
        extreme = one.function in ("MIN", "MAX")
        wanted[one.argument] = wanted.get(one.argument, False) or extreme
    # The rows of any other argument, errors included, are those of COUNT(*).
    if len(wanted) > 1 and None in wanted:
        del wanted[None]
    # Groups without aggregates still have to be known, so their rows are counted.
    if not wanted:
        wanted[None] = False
    filters = tuple(c for c in conditions if variables(c) <= own)
    later = tuple(c for c in conditions if not variables(c) <= own)
    if value is not None and any(value in variables(c) for c in later):
        return f"a FILTER compares ?{value} with another pattern"
    sorts, rest = [], []
    for leaf in others:
        if (
            isinstance(leaf, TypeScan)
            and leaf.subject == scan.subject
            and isinstance(leaf.sort, Const)
            and isinstance(leaf.sort.term, NamedNode)
        ):
            sorts.append(leaf.sort.term)
        else:
            rest.append(leaf)
    # Folded rows may go only if no window of the query can need another way.
    certain = (
        not rest
        and not filters
        and not later
        and all(a in (None, scan.object) and not extreme for a, extreme in wanted.items())
        and _certain_above(plan, aggregate)
    )
    return Shape(
        aggregate,
        scan,
        tuple(sorts),
        tuple(rest),
        filters,
        later,
        tuple(wanted.items()),
        retains=not certain,
        having=_filters_on(aggregate, plan),
    )


def _filters_on(aggregate: Aggregate, plan: Plan) -> tuple[Filter, ...]:
    for node in walk(plan):
        filters: list[Filter] = []
        below = node
        while isinstance(below, Filter):
            filters.append(below)
            below = below.child
        if below is aggregate:
            return tuple(filters)
    return ()


def _certain_above(plan: Plan, aggregate: Aggregate) -> bool:
    """Whether all steps above the aggregate only compare numbers, which never needs Oxigraph."""
    numbers = {one.variable for one in aggregate.aggregations}
    for node in walk(plan):
        if node is aggregate:
            return True
        if isinstance(node, Filter) and not _certain(node.condition, numbers):
            return False
        if isinstance(node, Extend) and not isinstance(node.expression, Var | Const):
            return False
        if isinstance(node, Join):
            return False
        if isinstance(node, Extend):
            expression = node.expression
            if isinstance(expression, Var) and expression.name in numbers:
                numbers.add(node.variable)
    return True


def _certain(expression: Expression, numbers: set[str]) -> bool:
    match expression:
        case Var(name):
            return name in numbers
        case Const(Literal() as literal):
            return literal.datatype.value.endswith(("#integer", "#decimal", "#double", "#boolean"))
        case Call(name, arguments):
            can_compute = name in (*COMPARISONS, "&&", "||", "!")
            return can_compute and all(_certain(argument, numbers) for argument in arguments)
        case _:
            return False
