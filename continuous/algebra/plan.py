"""The logical plan of a continuous query: the result over named variables, not the way to it.

`from_sparql` makes it, `rewrite_rules` improve it, `plan_text` prints it, `executor` and
`aggregation` execute it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import TypeAlias, assert_never

from pyoxigraph import NamedNode

from ...rdf.dictionary import Term
from .expressions import Const, Expression, Var, variables

Position: TypeAlias = Var | Const

DEFAULT = ""
"""The graph outside GRAPH and WINDOW: the static side and the windows without names."""


@dataclass(frozen=True, slots=True)
class Times:
    """The variables that a scan binds to its element's available time (τ) and valid time, in ns."""

    available: str | None = None
    valid: str | None = None

    @property
    def names(self) -> frozenset[str]:
        return frozenset(name for name in (self.available, self.valid) if name is not None)


NO_TIMES = Times()


@dataclass(frozen=True, slots=True)
class Scan:
    """The triples of one predicate in a graph, of its windows and the static side together."""

    subject: Position
    predicate: NamedNode
    object: Position
    graph: str = DEFAULT
    times: Times = NO_TIMES


@dataclass(frozen=True, slots=True)
class TypeScan:
    """``?x a <Sort>``: a set of facts, from the static side, the stream, or rows' annotations."""

    subject: Position
    sort: Position
    graph: str = DEFAULT


@dataclass(frozen=True, slots=True)
class AnyScan:
    """The triples of every predicate, with those of rdf:type as in `TypeScan`."""

    subject: Position
    predicate: Var
    object: Position
    graph: str = DEFAULT
    times: Times = NO_TIMES


@dataclass(frozen=True, slots=True)
class Closure:
    """``p*``, ``p+``, ``p?``: each pair of ends once. ``step`` has the solutions of p, from `START`
    to `STOP`; ``zero``: a node reaches itself; ``more``: more than one step is allowed."""

    subject: Position
    object: Position
    step: Plan
    zero: bool
    more: bool
    graph: str = DEFAULT


START, STOP = "\0start", "\0stop"


@dataclass(frozen=True, slots=True)
class Values:
    """Rows of the query text; None is UNDEF."""

    variables: tuple[str, ...]
    rows: tuple[tuple[Term | None, ...], ...]


@dataclass(frozen=True, slots=True)
class Given:
    """Solutions that exist before the plan is executed (`executor.Source.ready`)."""

    variables: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Join:
    """The natural join of the parts; without parts, one solution that binds nothing."""

    parts: tuple[Plan, ...]


@dataclass(frozen=True, slots=True)
class LeftJoin:
    """OPTIONAL: the join where ``condition`` holds, and solutions of ``child`` without a match."""

    child: Plan
    optional: Plan
    condition: Expression | None


@dataclass(frozen=True, slots=True)
class Union:
    """The solutions of all parts, part by part."""

    parts: tuple[Plan, ...]


@dataclass(frozen=True, slots=True)
class Minus:
    """The solutions of ``child`` except those with a compatible solution of ``removed`` that shares
    a binding."""

    child: Plan
    removed: Plan


@dataclass(frozen=True, slots=True)
class Exists:
    """``variable`` bound to whether ``pattern`` has a solution that fits that of ``child``."""

    variable: str
    pattern: Plan
    child: Plan


@dataclass(frozen=True, slots=True)
class Filter:
    """The solutions for which ``condition`` is true."""

    condition: Expression
    child: Plan


@dataclass(frozen=True, slots=True)
class Extend:
    """``variable`` bound to the value of ``expression``; unbound if that is an error."""

    variable: str
    expression: Expression
    child: Plan


@dataclass(frozen=True, slots=True)
class Aggregation:
    """``function`` over ``argument`` (None: ``*``), as ``variable``.

    COUNT SUM AVG MIN MAX SAMPLE GROUP_CONCAT; ``distinct``: each value of a group once;
    ``separator``: that of GROUP_CONCAT.
    """

    variable: str
    function: str
    argument: Expression | None
    distinct: bool = False
    separator: str = " "


@dataclass(frozen=True, slots=True)
class Aggregate:
    """A row per group. ``implicit``: without GROUP BY, no solutions give one row, too."""

    keys: tuple[str, ...]
    aggregations: tuple[Aggregation, ...]
    child: Plan
    implicit: bool


@dataclass(frozen=True, slots=True)
class Project:
    """The solutions with these variables only."""

    variables: tuple[str, ...]
    child: Plan


@dataclass(frozen=True, slots=True)
class Distinct:
    """The distinct solutions."""

    child: Plan


@dataclass(frozen=True, slots=True)
class Order:
    """The solutions in order of the keys, each an expression and whether it is descending."""

    keys: tuple[tuple[Expression, bool], ...]
    child: Plan


@dataclass(frozen=True, slots=True)
class Slice:
    """The solutions from ``start`` on, ``length`` of them (None: all)."""

    start: int
    length: int | None
    child: Plan


AnyPattern: TypeAlias = Scan | TypeScan | AnyScan
Leaf: TypeAlias = AnyPattern | Values | Given
Plan: TypeAlias = (
    Leaf
    | Closure
    | Join
    | LeftJoin
    | Union
    | Minus
    | Exists
    | Filter
    | Extend
    | Aggregate
    | Project
    | Distinct
    | Order
    | Slice
)


@dataclass(frozen=True, slots=True)
class Select:
    """The head of a SELECT."""

    variables: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Blank:
    """A blank node of a template: a new one for each solution."""

    label: str

    def __str__(self) -> str:
        return f"_:{self.label}"


TemplatePosition: TypeAlias = Var | Const | Blank


@dataclass(frozen=True, slots=True, weakref_slot=True)
class Construct:
    """The head of a CONSTRUCT: its triple patterns."""

    template: tuple[tuple[TemplatePosition, TemplatePosition, TemplatePosition], ...]


@dataclass(frozen=True, slots=True)
class Ask:
    """The head of an ASK."""


Head: TypeAlias = Select | Construct | Ask


@dataclass(frozen=True, slots=True)
class Query:
    """A query: a head that uses the solutions of ``plan``."""

    head: Head
    plan: Plan


def inputs(plan: Plan) -> tuple[Plan, ...]:
    """Return the plans that ``plan`` reads."""
    match plan:
        case Scan() | TypeScan() | AnyScan() | Values() | Given():
            return ()
        case Closure():
            return (plan.step,)
        case Join(parts) | Union(parts):
            return parts
        case LeftJoin(child, optional):
            return (child, optional)
        case Minus(child, removed):
            return (child, removed)
        case Exists(_, pattern, child):
            return (child, pattern)
        case Filter() | Extend() | Aggregate() | Project() | Distinct() | Order() | Slice():
            return (plan.child,)
        case _:
            assert_never(plan)


def with_inputs(plan: Plan, change: Callable[[Plan], Plan]) -> Plan:
    """Return the same node over ``change(input)`` for each of its inputs; ``plan`` itself if no
    input changes."""
    is_same = True

    def recorded(child: Plan) -> Plan:
        nonlocal is_same
        changed = change(child)
        is_same &= changed is child
        return changed

    found = _over(plan, recorded)
    return plan if is_same else found


def _over(plan: Plan, change: Callable[[Plan], Plan]) -> Plan:
    match plan:
        case Scan() | TypeScan() | AnyScan() | Values() | Given():
            return plan
        case Closure():
            return replace(plan, step=change(plan.step))
        case Join(parts):
            return Join(tuple(change(part) for part in parts))
        case Union(parts):
            return Union(tuple(change(part) for part in parts))
        case LeftJoin(child, optional, condition):
            return LeftJoin(change(child), change(optional), condition)
        case Minus(child, removed):
            return Minus(change(child), change(removed))
        case Exists(variable, pattern, child):
            return Exists(variable, change(pattern), change(child))
        case Filter() | Extend() | Aggregate() | Project() | Distinct() | Order() | Slice():
            return replace(plan, child=change(plan.child))
        case _:
            assert_never(plan)


def expressions_of(node: Plan) -> tuple[Expression, ...]:
    """Return the expressions of one node, without those of its inputs."""
    match node:
        case Filter(condition) | Extend(_, condition):
            return (condition,)
        case LeftJoin(_, _, condition):
            return () if condition is None else (condition,)
        case Order(keys):
            return tuple(key for key, _ in keys)
        case Aggregate(_, aggregations):
            return tuple(a.argument for a in aggregations if a.argument is not None)
        case _:
            return ()


def with_expressions(node: Plan, change: Callable[[Expression], Expression]) -> Plan:
    """Return the same node over ``change(expression)`` for each of its expressions."""
    match node:
        case Filter(condition, child):
            return Filter(change(condition), child)
        case Extend(variable, expression, child):
            return Extend(variable, change(expression), child)
        case LeftJoin(child, optional, condition) if condition is not None:
            return LeftJoin(child, optional, change(condition))
        case Order(keys, child):
            return Order(tuple((change(key), down) for key, down in keys), child)
        case Aggregate():
            aggregations = tuple(
                a if a.argument is None else replace(a, argument=change(a.argument))
                for a in node.aggregations
            )
            return replace(node, aggregations=aggregations)
        case _:
            return node


def outputs(plan: Plan) -> frozenset[str]:
    """Return the variables that solutions of ``plan`` may bind."""
    match plan:
        case Scan(subject, _, object) | AnyScan(subject, _, object):
            own = (subject, object) if isinstance(plan, Scan) else (subject, plan.predicate, object)
            return _names(own) | plan.times.names
        case TypeScan(subject, object) | Closure(subject, object):
            return _names((subject, object))
        case Values(variables) | Given(variables) | Project(variables):
            return frozenset(variables)
        case Join(parts) | Union(parts):
            return frozenset().union(*map(outputs, parts))
        case LeftJoin(child, optional):
            return outputs(child) | outputs(optional)
        case Minus(child) | Filter(_, child) | Distinct(child) | Order(_, child):
            return outputs(child)
        case Slice():
            return outputs(plan.child)
        case Exists(variable, _, child) | Extend(variable, _, child):
            return outputs(child) | {variable}
        case Aggregate(keys, aggregations):
            return frozenset(keys) | {a.variable for a in aggregations}
        case _:
            assert_never(plan)


def certain(plan: Plan) -> frozenset[str]:
    """Return the variables that every solution of ``plan`` binds."""
    match plan:
        case Scan() | TypeScan() | Closure() | AnyScan():
            # Static triples have no time, so a time may be unbound.
            times = frozenset() if isinstance(plan, TypeScan | Closure) else plan.times.names
            return outputs(plan) - times
        case Values(variables, rows):
            bound = (all(row[i] is not None for row in rows) for i in range(len(variables)))
            return frozenset(v for v, every in zip(variables, bound, strict=True) if every)
        case Given():
            return frozenset()
        case Join(parts):
            return frozenset().union(*map(certain, parts))
        case Union(parts):
            return frozenset.intersection(*map(certain, parts)) if parts else frozenset()
        case LeftJoin(child) | Minus(child) | Filter(_, child) | Distinct(child):
            return certain(child)
        case Order() | Slice() | Extend():
            return certain(plan.child)
        case Exists(variable, _, child):
            return certain(child) | {variable}
        case Project(variables, child):
            return certain(child) & frozenset(variables)
        case Aggregate(keys, _, child):
            return certain(child) & frozenset(keys)
        case _:
            assert_never(plan)


def used_variables(node: Plan) -> frozenset[str]:
    """Return the variables in the expressions of one node."""
    return frozenset().union(*map(variables, expressions_of(node)))


def named_variables(plan: Plan) -> frozenset[str]:
    """Return the variables that a plan binds or uses. Cost: one pass over the plan."""
    return frozenset().union(*map(own_names, walk(plan)))


def own_names(node: Plan) -> frozenset[str]:
    """Return those of `named_variables` that ``node`` itself contributes, not its inputs."""
    match node:
        case Exists(variable) | Extend(variable):
            return used_variables(node) | {variable}
        case Join() | Union() | LeftJoin() | Minus() | Filter() | Distinct() | Order() | Slice():
            return used_variables(node)
        case _:
            return used_variables(node) | outputs(node)


def walk(plan: Plan) -> list[Plan]:
    """Return the plan and all plans in it, top first."""
    found = [plan]
    for child in inputs(plan):
        found.extend(walk(child))
    return found


def _names(positions: Iterable[Position]) -> frozenset[str]:
    return frozenset(p.name for p in positions if isinstance(p, Var))
