"""Law of what the rest of a plan needs of a part: as each part is looked at by itself."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from logical_plans import plans

from dyknow.continuous.algebra.plan import (
    START,
    STOP,
    Aggregate,
    Closure,
    Distinct,
    Plan,
    Project,
    inputs,
    outputs,
    used_variables,
    walk,
)
from dyknow.continuous.pattern_join.plan_cut import needed_outside


def defined(plan: Plan, part: Plan) -> frozenset[str]:
    inside = {id(node) for node in walk(part)}
    names: set[str] = set()
    for node in walk(plan):
        if id(node) in inside:
            continue
        if not inputs(node):
            names |= outputs(node)
        names |= used_variables(node)
        match node:
            case Project(shown):
                names |= set(shown)
            case Aggregate(keys, aggregations):
                names |= set(keys)
                if any(one.distinct and one.argument is None for one in aggregations):
                    return outputs(part)
            case Closure():
                names |= outputs(node) | {START, STOP}
            case Distinct(child) if not isinstance(child, Project):
                return outputs(part)
    return outputs(part) & names


@given(plans, st.data())
def test_all_parts_at_once_are_each_by_itself(plan, data):
    parts = data.draw(st.lists(st.sampled_from(walk(plan)), max_size=6))
    assert needed_outside(plan, parts) == [defined(plan, part) for part in parts]
