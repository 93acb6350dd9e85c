"""The logical plan of a continuous query: what is computed over named variables, not how.

Made by `from_sparql`, improved by `rewrite_rules`, printed by `plan_text`, executed by `executor`
and `aggregation`.
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
"""The graph outside GRAPH and WINDOW: the static side and the windows without a name."""


@dataclass(frozen=True, slots=True)
class Times:
    """The variables that a scan binds to when its element was available (τ) and valid, in ns."""

    available: str | None = None
    valid: str | None = None

    @property
    def names(self) -> frozenset[str]:
        return frozenset(name for name in (self.available, self.valid) if name is not None)


NO_TIMES = Times()


@dataclass(frozen=True, slots=True)
class Scan:
    """The triples of one predicate in a graph: of its windows and of the static side together."""

    subject: Position
    predicate: NamedNode
    object: Position
    graph: str = DEFAULT
    times: Times = NO_TIMES


@dataclass(frozen=True, slots=True)
class TypeScan:
    """``?x a <Sort>``: a set of facts, static, told by the stream, or by the annotation of rows."""

    subject: Position
    sort: Position
    graph: str = DEFAULT


@dataclass(frozen=True, slots=True)
class AnyScan:
    """The triples of every predicate, those of rdf:type as `TypeScan` has them."""

    subject: Position
    predicate: Var
    object: Position
    graph: str = DEFAULT
    times: Times = NO_TIMES


@dataclass(frozen=True, slots=True)
class Closure:
    """``p*``, ``p+``, ``p?``: each pair of ends once. ``step`` are the solutions of p, from `START`
    to `STOP`; ``zero``: a node reaches itself; ``more``: by more than one step too."""

    subject: Position
    object: Position
    step: Plan
    zero: bool
    more: bool
    graph: str = DEFAULT


START, STOP = "\0start", "\0stop"


@dataclass(frozen=True, slots=True)
class Values:
    """Rows given in the query; None is UNDEF."""

    variables: tuple[str, ...]
    rows: tuple[tuple[Term | None, ...], ...]


@dataclass(frozen=True, slots=True)
class Given:
    """Solutions that are at hand when the plan is executed (`executor.Source.ready`)."""

    variables: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Join:
    """The natural join of the parts; of none: one solution that binds nothing."""

    parts: tuple[Plan, ...]


@dataclass(frozen=True, slots=True)
class LeftJoin:
    """OPTIONAL: the join where ``condition`` holds, and the solutions of ``child`` without any."""

    child: Plan
    optional: Plan
    condition: Expression | None


@dataclass(frozen=True, slots=True)
class Union:
    """The solutions of one part after the other."""

    parts: tuple[Plan, ...]


@dataclass(frozen=True, slots=True)
class Minus:
    """The solutions of ``child`` but those that share a binding with, and contradict no, solution
    of ``removed``."""

    child: Plan
    removed: Plan


@dataclass(frozen=True, slots=True)
class Exists:
    """``variable`` bound to whether ``pattern`` has a solution that fits the one of ``child``."""

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
    """``variable`` bound to the value of ``expression``, unbound where that is an error."""

    variable: str
    expression: Expression
    child: Plan


@dataclass(frozen=True, slots=True)
class Aggregation:
    """``function`` over ``argument`` (None: ``*``), as ``variable``.

    COUNT SUM AVG MIN MAX SAMPLE GROUP_CONCAT; ``distinct``: each value of a group once;
    ``separator`` is GROUP_CONCAT's.
    """

    variable: str
    function: str
    argument: Expression | None
    distinct: bool = False
    separator: str = " "


@dataclass(frozen=True, slots=True)
class Aggregate:
    """A row a group. ``implicit``: no GROUP BY was written, so nothing gives one row too."""

    keys: tuple[str, ...]
    aggregations: tuple[Aggregation, ...]
    child: Plan
    implicit: bool


@dataclass(frozen=True, slots=True)
class Project:
    """Only these variables go on."""

    variables: tuple[str, ...]
    child: Plan


@dataclass(frozen=True, slots=True)
class Distinct:
    """No two solutions equal."""

    child: Plan


@dataclass(frozen=True, slots=True)
class Order:
    """The solutions in order of the keys, each an expression and whether it descends."""

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
    """A blank node of a template: another one for each solution."""

    label: str

    def __str__(self) -> str:
        return f"_:{self.label}"


TemplatePosition: TypeAlias = Var | Const | Blank


@dataclass(frozen=True, slots=True)
class Construct:
    """The head of a CONSTRUCT: its triple patterns."""

    template: tuple[tuple[TemplatePosition, TemplatePosition, TemplatePosition], ...]


@dataclass(frozen=True, slots=True)
class Ask:
    """The head of an ASK."""


Head: TypeAlias = Select | Construct | Ask


@dataclass(frozen=True, slots=True)
class Query:
    """A whole query: what is shown of the solutions of ``plan``."""

    head: Head
    plan: Plan


def inputs(plan: Plan) -> tuple[Plan, ...]:
    """The plans that ``plan`` reads."""
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
    """The same node over ``change(input)`` for each of its inputs: ``plan`` itself where no input
    becomes another."""
    is_same = True

    def noted(child: Plan) -> Plan:
        nonlocal is_same
        found = change(child)
        is_same &= found is child
        return found

    found = _over(plan, noted)
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
    """The expressions of one node, not of its inputs."""
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
    """The same node over ``change(expression)`` for each of its expressions."""
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
    """The variables that solutions of ``plan`` may bind."""
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
    """The variables that every solution of ``plan`` binds."""
    match plan:
        case Scan() | TypeScan() | Closure() | AnyScan():
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


def asked(node: Plan) -> frozenset[str]:
    """The variables in the expressions of one node."""
    return frozenset().union(*map(variables, expressions_of(node)))


def mentioned(plan: Plan) -> frozenset[str]:
    """The variables that a plan binds or asks about. Cost: one pass over the plan."""
    return frozenset().union(*map(own_names, walk(plan)))


def own_names(node: Plan) -> frozenset[str]:
    """Those of `mentioned` that are not because of an input of ``node``."""
    match node:
        case Exists(variable) | Extend(variable):
            return asked(node) | {variable}
        case Join() | Union() | LeftJoin() | Minus() | Filter() | Distinct() | Order() | Slice():
            return asked(node)
        case _:
            return asked(node) | outputs(node)


def walk(plan: Plan) -> list[Plan]:
    """The plan and all plans in it, top first."""
    found = [plan]
    for child in inputs(plan):
        found.extend(walk(child))
    return found


def _names(positions: Iterable[Position]) -> frozenset[str]:
    return frozenset(p.name for p in positions if isinstance(p, Var))
