"""The form of a specification in a worker's answer: one flat row per element, in text order.

A worker's answer is untrusted. Rows are not nested, and the parent of a row must be an earlier row,
so the rows always form a tree.
"""

from __future__ import annotations

from typing import Final, TypeAlias

from ...languages.errors import Span
from ...languages.specification import (
    Input,
    Parameter,
    Removal,
    Specification,
    StreamReference,
    UnitSpecification,
)
from .messages import BadAnswer, ElementRow

UNIT, _STREAM, _PARAMETER, _REMOVAL = range(4)
"""The kinds of rows."""
_TOP: Final = -1
_Part: TypeAlias = Input | Parameter


def rows_of(specification: Specification) -> list[ElementRow]:
    """Convert elements to rows, each after its parent. Contract: a text was parsed."""
    rows: list[ElementRow] = []
    waiting: list[tuple[_Part, int]] = [(unit, _TOP) for unit in specification.insertions[::-1]]
    while waiting:
        part, parent = waiting.pop()
        assert part.span is not None
        place = (part.span.start, part.span.end)
        match part:
            case UnitSpecification():
                rows.append((UNIT, parent, part.type, part.name, *place))
                number = len(rows) - 1
                waiting += [(each, number) for each in (*part.parameters, *part.inputs)[::-1]]
            case StreamReference():
                rows.append((_STREAM, parent, "", part.name, *place))
            case Parameter():
                rows.append((_PARAMETER, parent, part.value, part.name, *place))
    for removal in specification.removals:
        span = removal.span
        rows.append((_REMOVAL, _TOP, removal.type or "", removal.name, span.start, span.end))
    return rows


def specification_of(rows: list[ElementRow], source: str) -> Specification:
    """Convert rows to a specification of the text ``source``. Raises `BadAnswer`."""
    children: list[tuple[list[Parameter], list[Input]]] = [([], []) for _ in rows]
    insertions: list[UnitSpecification] = []
    removals: list[Removal] = []
    # Backwards, so that a unit's children exist before the unit.
    for number in range(len(rows) - 1, -1, -1):
        kind, parent, text, name, start, end = rows[number]
        if not (0 <= start <= end <= len(source) and _TOP <= parent < number):
            raise BadAnswer("an element with a wrong position or parent")
        span = Span(start, end)
        if parent == _TOP:
            if kind == UNIT:
                insertions.append(_unit(text, name, children[number], span))
            elif kind == _REMOVAL and (name is None) == bool(text):
                removals.append(Removal(name, text or None, span))
            else:
                raise BadAnswer("an element in a wrong place")
            continue
        if rows[parent][0] != UNIT:
            raise BadAnswer("an element whose parent is no unit")
        parameters, inputs = children[parent]
        if kind == UNIT:
            inputs.append(_unit(text, name, children[number], span))
        elif kind == _STREAM and name is not None:
            inputs.append(StreamReference(name, span))
        elif kind == _PARAMETER and name is not None:
            parameters.append(Parameter(name, text, span))
        else:
            raise BadAnswer("an element in a wrong place")
    return Specification(tuple(insertions[::-1]), tuple(removals[::-1]), source)


def _unit(
    type: str, name: str | None, children: tuple[list[Parameter], list[Input]], span: Span
) -> UnitSpecification:
    parameters, inputs = children
    return UnitSpecification(type, name, tuple(parameters[::-1]), tuple(inputs[::-1]), span)
