"""Binds the durations of EP-SPARQL templates, and finds how long a solution may last (SPEC §8).

Other parameters stand in the plans (`reasoning.patterns.compilation.epsparql_sources`). A duration
bounds the time for which samples are kept, so the plans need it as a constant.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ..errors import LanguageError
from ..mtl.checked import Constant, Kind, ObjectConstant
from ..rewriting import rewritten
from .checked import CheckedPattern, Duration, Filter, Group, Variable
from .expressions import bounds_of_duration


def bound_epsparql(
    pattern: CheckedPattern, arguments: Mapping[str, Constant | ObjectConstant]
) -> CheckedPattern:
    """Return the pattern with constants for the parameters that are durations. Raises
    `LanguageError` for a duration below zero."""
    durations = {
        name: Duration(int(value.value))
        for name, value in arguments.items()
        if isinstance(value, Constant) and value.kind is Kind.DURATION
    }
    if not durations:
        return pattern

    def bind(node: Any) -> Any:
        return durations.get(node.name, node) if isinstance(node, Variable) else node

    bound = replace(
        pattern,
        items=rewritten(pattern.items, bind),
        where=rewritten(pattern.where, bind),
        within=rewritten(pattern.within, bind),
    )
    check_horizon(bound.where, bound.source)
    return bound


def horizon(pattern: CheckedPattern) -> int | None:
    """Return the longest that a solution may last, in ns, by WITHIN and the conditions of the
    whole. Contract: `bound_epsparql` made it, if it has parameters."""
    bounds = [
        d
        for part in pattern.where.parts
        if isinstance(part, Filter)
        for d in bounds_of_duration(part.condition)
    ]
    if isinstance(pattern.within, Duration):
        bounds.append(pattern.within.value)
    return min(bounds, default=None)


def check_horizon(where: Group, source: str) -> None:
    """Raise `LanguageError` for a condition of the whole that lets a solution last less than no
    time."""
    for part in where.parts:
        if isinstance(part, Filter) and min(bounds_of_duration(part.condition), default=0) < 0:
            raise LanguageError("nothing lasts less than no time", source, part.span, "write `<=`")
