"""Patterns that differ in one object, evaluated as one with that object left free (SPEC §8).

The request for all objects has a column with the object, which a request for one has not. Without
this column, and without what compares it, both must be the same pattern: then the matches of an
object are those of the rows in which the column has it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from .plan import (
    OWN,
    Aggregate,
    Arithmetic,
    Condition,
    CountProbe,
    Element,
    Key,
    Listed,
    Output,
    PatternPlan,
    Position,
    Probe,
    Same,
    Selection,
    Value,
    leaves_of,
)
from .query import Argument, Branch, Part, PatternQuery, Source, object_key

PART: Final = "part of the match"
"""The output that tells which object a match is of. It is no name of a result."""


@dataclass(frozen=True, slots=True)
class PatternByObject:
    """A pattern of each object by itself. ``query`` has the object in ``column``, and in the output
    `PART`; ``objects`` are the results that are the object."""

    query: PatternQuery
    column: str
    objects: tuple[str, ...]


def pattern_by_object(free: PatternQuery, own: PatternQuery, object: str) -> PatternByObject | None:
    """Return the pattern that serves ``own``, which is ``free`` for one ``object`` (an IRI); None
    if there is none.

    There is none with more than one plan, with a maximal delay, over the streams of a sort, or
    where another object is compared with this one.
    """
    if (
        free.max_delay is not None
        or any(source.is_sort for source in free.sources)
        or len(free.plans) != 1
        or len(own.plans) != 1
        or any(branch != Branch() for branch in free.branches)
    ):
        return None
    (plan,) = free.plans
    column = _column_of(free, own, object)
    if column is None or not _is_everywhere(plan, column) or column in _columns_compared(plan):
        return None
    rest, own_rest = (
        [each for each in query.plans[0].columns if each.name != column] for query in (free, own)
    )
    if rest != own_rest or _without(free, free, column, object) != _without(
        own, free, column, object
    ):
        return None
    objects = tuple(each.name for each in plan.outputs if _is_value_of(each, column))
    # Aggregates over all matches know the last row only.
    which = Position.LAST if plan.elements[-1].is_kleene else Position.EACH
    part = Output(PART, Value(len(plan.elements) - 1, column, which))
    parted = replace(plan, outputs=(*plan.outputs, part))
    if plan.selection is Selection.STRICT_CONTIGUITY:
        # The next row of all is the next one of the object.
        contiguous = Selection.PARTITION_CONTIGUITY
        parted = replace(parted, selection=contiguous, partition=(column,))
    elif plan.selection is Selection.PARTITION_CONTIGUITY and column not in plan.partition:
        return None
    return PatternByObject(replace(free, plans=(parted,)), column, objects)


def within_part(plan: PatternPlan, column: str) -> PatternPlan:
    """Return the plan for rows that have this column equal: without what compares it."""
    return replace(
        plan,
        same=_same_without(plan.same, column),
        probes=tuple(replace(each, same=_same_without(each.same, column)) for each in plan.probes),
    )


def _column_of(free: PatternQuery, own: PatternQuery, object: str) -> str | None:
    """The column that has the object in each source; None if there is none."""
    if len(free.sources) != len(own.sources):
        return None
    columns: set[str] = set()
    for source, mine in zip(free.sources, own.sources, strict=True):
        places = [i for i, each in enumerate(mine.arguments) if each.object == object]
        found = [
            each.column
            for each in source.columns
            if each.part is Part.OBJECT and each.argument in places
        ]
        if len(places) != 1 or len(found) != 1 or len(source.arguments) != len(mine.arguments):
            return None
        columns.update(found)
    return columns.pop() if len(columns) == 1 else None


def _columns_compared(plan: PatternPlan) -> set[str]:
    """The columns in conditions, calculations, aggregates and lists."""
    read = [*plan.elements, *(probe.what for probe in plan.probes)]
    conditions = [*plan.conditions, *(each for element in read for each in element.conditions)]
    for probe in plan.probes:
        conditions += probe.conditions if isinstance(probe, CountProbe) else probe.state
    sides = [side for each in conditions for side in (each.left, each.right)]
    sides += [each.value for each in plan.outputs if isinstance(each.value, Arithmetic | Aggregate)]
    leaves = [leaf for side in sides for leaf in leaves_of(side)]
    listed = [each.column for each in plan.trends if each.column is not None]
    listed += [each.value.column for each in plan.outputs if isinstance(each.value, Listed)]
    columns = (leaf.column for leaf in leaves if isinstance(leaf, Value | Aggregate))
    return {*listed, *(column for column in columns if column is not None)}


def _is_everywhere(plan: PatternPlan, column: str) -> bool:
    """Whether all elements and probes have the column equal."""
    linked, more = {0}, True
    pairs = [(each.first, each.second) for each in plan.same if _is_of(each, column)]
    while more:
        new = {a for pair in pairs for a in pair if not linked.isdisjoint(pair)} - linked
        linked, more = linked | new, bool(new)
    return len(linked) == len(plan.elements) and all(
        any(_is_of(same, column) for same in probe.same) for probe in plan.probes
    )


def _is_value_of(output: Output, column: str) -> bool:
    return isinstance(output.value, Value) and output.value.column == column


def _is_of(same: Same, column: str) -> bool:
    return same.first_column == same.second_column == column


def _without(
    query: PatternQuery, free: PatternQuery, column: str, object: str
) -> tuple[tuple[Source, ...], PatternPlan, PatternQuery]:
    """What is left of a pattern without what the column compares, with the object in its place.
    Contract: the columns are those of ``free``, with or without this one."""
    (plan,), (free_plan,) = query.plans, free.plans
    key = Key(object_key(object))
    sources = tuple(
        _source_without(source, open, column, object)
        for source, open in zip(query.sources, free.sources, strict=True)
    )
    outputs = tuple(
        replace(each, value=key) if _is_value_of(each, column) else each for each in plan.outputs
    )
    are_objects = {each.name for each in free_plan.outputs if _is_value_of(each, column)}
    results = tuple(
        replace(each, argument=None) if each.name in are_objects else each for each in query.results
    )
    left = replace(
        plan,
        columns=free_plan.columns,
        elements=tuple(_element_without(each, column, key) for each in plan.elements),
        same=_same_without(plan.same, column),
        probes=tuple(_probe_without(each, column, key) for each in plan.probes),
        outputs=outputs,
    )
    return sources, left, replace(query, sources=(), plans=(), results=results)


def _source_without(source: Source, free: Source, column: str, object: str) -> Source:
    (place,) = (each.argument for each in free.columns if each.column == column)
    arguments = list(source.arguments)
    arguments[place] = Argument(None, object)
    columns = tuple(each for each in source.columns if each.column != column)
    return replace(source, arguments=tuple(arguments), columns=columns)


def _element_without(element: Element, column: str, key: Key) -> Element:
    is_object = Condition("=", Value(OWN, column), key)
    return replace(
        element, conditions=tuple(each for each in element.conditions if each != is_object)
    )


def _same_without(same: tuple[Same, ...], column: str) -> tuple[Same, ...]:
    return tuple(each for each in same if not _is_of(each, column))


def _probe_without(probe: Probe, column: str, key: Key) -> Probe:
    return replace(
        probe,
        what=_element_without(probe.what, column, key),
        same=_same_without(probe.same, column),
    )
