"""Aggregates over all matches by their definition: list the matches, then add up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pattern_definition import Match, Step
from pattern_run_definition import AnyDefinition, Binding

from dyknow.reasoning.patterns.plans.plan import Function, PatternPlan, Time, Trend


def trends(plan: PatternPlan, steps: Sequence[Step]) -> list[Match]:
    """The results, one a row that ends matches, in order of these rows."""
    definition = AnyDefinition(plan, steps)
    matches: dict[int, list[Binding]] = {}
    for match in definition.all_matches():
        matches.setdefault(match.last.number, []).append(match)
    found = []
    for number, those in sorted(matches.items()):
        outputs = []
        for output in plan.outputs:
            if isinstance(output.value, Time) and output.value.is_start:
                outputs.append(min(definition.start(match) for match in those))
            else:
                outputs.append(definition.output(output.value, those[0]))
        outputs += [total(trend, those) for trend in plan.trends]
        end = those[0].last.end
        found.append(Match((number,), end, definition.step_of[number], tuple(outputs)))
    return found


def total(trend: Trend, matches: list[Binding]) -> Any:
    if trend.element is None:
        return len(matches)
    rows = [row for match in matches for row in match.rows[trend.element]]
    if trend.column is None:
        return len(rows)
    values = [v for row in rows if (v := row.values[trend.column]) is not None]
    if trend.function is Function.COUNT:
        return len(values)
    if not values:
        return None
    match trend.function:
        case Function.SUM:
            return float(sum(values))
        case Function.AVG:
            return sum(values) / len(values)
        case Function.MIN:
            return min(values)
        case _:
            return max(values)
