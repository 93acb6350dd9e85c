"""The optimizer: the rules by name, tried in turn until none changes the plan.

Law: a rule's result has the same solutions, the same number of times.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from .expressions import Call, Const, Expression, Var, conjuncts, variables
from .logical import Aggregate, Distinct, Extend, Filter, Join, Plan, Project, outputs, walk

Rule = Callable[[Plan], Plan]


def flatten_joins(plan: Plan) -> Plan:
    """Join(Join(a, b), c) = Join(a, b, c); a Join of one is that one."""
    if isinstance(plan, Join):
        parts = [
            p for part in plan.parts for p in (part.parts if isinstance(part, Join) else (part,))
        ]
        return parts[0] if len(parts) == 1 else Join(tuple(parts))
    return plan


def split_filters(plan: Plan) -> Plan:
    """Filter(a && b, x) = Filter(a, Filter(b, x))."""
    if isinstance(plan, Filter):
        parts = conjuncts(plan.condition)
        if len(parts) > 1:
            child = plan.child
            for part in reversed(parts):
                child = Filter(part, child)
            return child
    return plan


def push_filters(plan: Plan) -> Plan:
    """A Filter over a Join goes to a part that binds all its variables, and below an Extend.

    Never below an Aggregate or Project: the names may mean something else there.
    """
    if not isinstance(plan, Filter):
        return plan
    needed = variables(plan.condition)
    child = plan.child
    if isinstance(child, Join) and needed:
        for i, part in enumerate(child.parts):
            if needed <= outputs(part) and not _may_be_unbound(part, needed):
                parts = (*child.parts[:i], Filter(plan.condition, part), *child.parts[i + 1 :])
                return Join(parts)
    if (
        isinstance(child, Extend)
        and child.variable not in needed
        and needed <= outputs(child.child)
    ):
        return replace(child, child=Filter(plan.condition, child.child))
    return plan


def merge_aggregations(plan: Plan) -> Plan:
    """The same function of the same argument, written twice (head and HAVING), is one."""
    if isinstance(plan, Filter | Extend | Project) and isinstance(_below(plan), Aggregate):
        aggregate = _below(plan)
        assert isinstance(aggregate, Aggregate)
        first: dict[tuple[str, Expression | None], str] = {}
        renamed: dict[str, str] = {}
        kept = []
        for one in aggregate.aggregations:
            name = first.setdefault((one.function, one.argument), one.variable)
            if name == one.variable:
                kept.append(one)
            else:
                renamed[one.variable] = name
        if renamed:
            return _rename(plan, renamed, replace(aggregate, aggregations=tuple(kept)))
    return plan


def drop_projections(plan: Plan) -> Plan:
    """Project over Project, and Project to what is there anyway."""
    if isinstance(plan, Project):
        child = plan.child
        if isinstance(child, Project) and set(plan.variables) <= set(child.variables):
            return Project(plan.variables, child.child)
    return plan


RULES: tuple[Rule, ...] = (
    flatten_joins,
    split_filters,
    push_filters,
    merge_aggregations,
    drop_projections,
)


def optimize(plan: Plan) -> Plan:
    """``plan`` under all `RULES`, from the leaves up, until nothing changes."""
    while True:
        better = _everywhere(plan)
        if better == plan:
            return plan
        plan = better


def _everywhere(plan: Plan) -> Plan:
    if isinstance(plan, Join):
        plan = Join(tuple(map(_everywhere, plan.parts)))
    elif isinstance(plan, Filter | Extend | Aggregate | Project | Distinct):
        plan = replace(plan, child=_everywhere(plan.child))
    for rule in RULES:
        plan = rule(plan)
    return plan


def _may_be_unbound(plan: Plan, names: frozenset[str]) -> bool:
    """Whether a variable could be bound by another part of the join only."""
    return any(isinstance(p, Extend | Aggregate | Project) for p in walk(plan)) and bool(names)


def _below(plan: Plan) -> Plan:
    while isinstance(plan, Filter | Extend | Project):
        plan = plan.child
    return plan


def _rename(plan: Plan, names: dict[str, str], bottom: Plan) -> Plan:
    match plan:
        case Filter(condition, child):
            return Filter(_renamed(condition, names), _rename(child, names, bottom))
        case Extend(variable, expression, child):
            return Extend(variable, _renamed(expression, names), _rename(child, names, bottom))
        case Project(_, child):
            return replace(plan, child=_rename(child, names, bottom))
        case _:
            return bottom


def _renamed(expression: Expression, names: dict[str, str]) -> Expression:
    match expression:
        case Var(name):
            return Var(names.get(name, name))
        case Call(name, arguments):
            return Call(name, tuple(_renamed(argument, names) for argument in arguments))
        case Const():
            return expression
