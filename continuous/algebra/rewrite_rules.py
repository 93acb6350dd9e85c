"""The optimizer: a tuple of named rules, applied until none changes the plan.

Law: a rule preserves the solutions and their multiplicity.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from .expressions import conjuncts, variables
from .plan import (
    Extend,
    Filter,
    Join,
    Plan,
    Project,
    certain,
    outputs,
    with_inputs,
)

Rule = Callable[[Plan], Plan]


def flatten_joins(plan: Plan) -> Plan:
    """Join(Join(a, b), c) = Join(a, b, c); Join(a) = a."""
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
    """Move a Filter over a Join to a part that binds all its variables, and below an Extend.

    It never moves below an Aggregate or Project: names may have other meanings there.
    """
    if not isinstance(plan, Filter):
        return plan
    needed = variables(plan.condition)
    child = plan.child
    if isinstance(child, Join) and needed:
        for i, part in enumerate(child.parts):
            # If this part may leave a variable unbound, another part could bind it.
            if needed <= certain(part):
                parts = (*child.parts[:i], Filter(plan.condition, part), *child.parts[i + 1 :])
                return Join(parts)
    if (
        isinstance(child, Extend)
        and child.variable not in needed
        and needed <= outputs(child.child)
    ):
        return replace(child, child=Filter(plan.condition, child.child))
    return plan


def drop_projections(plan: Plan) -> Plan:
    """Project(v, Project(w, x)) = Project(v, x) if w contains v."""
    if isinstance(plan, Project):
        child = plan.child
        if isinstance(child, Project) and set(plan.variables) <= set(child.variables):
            return Project(plan.variables, child.child)
    return plan


RULES: tuple[Rule, ...] = (
    flatten_joins,
    split_filters,
    push_filters,
    drop_projections,
)


def optimize(plan: Plan) -> tuple[Plan, tuple[str, ...]]:
    """Apply all `RULES`, from the leaves up, until nothing changes. Return the plan, and the names
    of the rules that changed it, in the order of `RULES`.
    """
    applied: set[str] = set()
    while True:
        better = _everywhere(plan, applied)
        if better == plan:
            return plan, tuple(rule.__name__ for rule in RULES if rule.__name__ in applied)
        plan = better


def _everywhere(plan: Plan, applied: set[str]) -> Plan:
    plan = with_inputs(plan, lambda child: _everywhere(child, applied))
    for rule in RULES:
        better = rule(plan)
        if better != plan:
            applied.add(rule.__name__)
        plan = better
    return plan
