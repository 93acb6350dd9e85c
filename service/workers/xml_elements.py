"""Specifications between a worker and its parent: a flat row an element, in the order of the text.

Flat, because a worker's answer is a stranger's: nothing in it is nested, and each row may only name
one before it as what it stands in, so that what is made of it is a tree.
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
"""What a row is."""
_TOP: Final = -1
_Part: TypeAlias = Input | Parameter


def rows_of(specification: Specification) -> list[ElementRow]:
    """The elements as rows, each behind what it stands in. Contract: it was read from a text."""
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
    """The specification that rows are, of the text ``source``; raises `BadAnswer` for others."""
    held: list[tuple[list[Parameter], list[Input]]] = [([], []) for _ in rows]
    insertions: list[UnitSpecification] = []
    removals: list[Removal] = []
    # Children first: a unit is made of what it holds, which comes last first.
    for number in range(len(rows) - 1, -1, -1):
        kind, parent, text, name, start, end = rows[number]
        if not (0 <= start <= end <= len(source) and _TOP <= parent < number):
            raise BadAnswer("an element out of its place")
        span = Span(start, end)
        if parent == _TOP:
            if kind == UNIT:
                insertions.append(_unit(text, name, held[number], span))
            elif kind == _REMOVAL and (name is None) == bool(text):
                removals.append(Removal(name, text or None, span))
            else:
                raise BadAnswer("an element that cannot stand there")
            continue
        if rows[parent][0] != UNIT:
            raise BadAnswer("an element in one that holds none")
        parameters, inputs = held[parent]
        if kind == UNIT:
            inputs.append(_unit(text, name, held[number], span))
        elif kind == _STREAM and name is not None:
            inputs.append(StreamReference(name, span))
        elif kind == _PARAMETER and name is not None:
            parameters.append(Parameter(name, text, span))
        else:
            raise BadAnswer("an element that cannot stand there")
    return Specification(tuple(insertions[::-1]), tuple(removals[::-1]), source)


def _unit(
    type: str, name: str | None, held: tuple[list[Parameter], list[Input]], span: Span
) -> UnitSpecification:
    parameters, inputs = held
    return UnitSpecification(type, name, tuple(parameters[::-1]), tuple(inputs[::-1]), span)
