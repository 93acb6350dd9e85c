"""Prints chronicles. Law: ``parse_chronicle(format_chronicle(c)) == c``, up to spans."""

from __future__ import annotations

from collections.abc import Iterator
from typing import assert_never

from ...streams.time import format_duration
from ..mtl.ast import Binding
from ..mtl.printer import format_formula, format_slot
from . import ast


def format_chronicle(chronicle: ast.Chronicle) -> str:
    """Return the chronicle as text, a line a clause. Law: `parse_chronicle` reads it back."""
    register = f"REGISTER STREAM {chronicle.stream} AS\n" if chronicle.stream else ""
    return register + "\n".join(_lines(chronicle))


def format_chronicle_template(template: ast.ChronicleTemplate) -> str:
    """Return the template as text. Law: `parse_chronicle_template` reads it back."""
    slots = ", ".join(map(format_slot, template.slots))
    return (
        f"REGISTER TEMPLATE <{template.name}>({slots}) AS\n{format_chronicle(template.chronicle)}"
    )


def _lines(chronicle: ast.Chronicle) -> Iterator[str]:
    slots = ", ".join(map(format_slot, chronicle.parameters))
    yield f"chronicle {chronicle.name}{f'({slots})' if slots else ''} {{"
    yield from (f"  {_clause(each)};" for each in chronicle.clauses)
    if chronicle.emitted is not None:
        names = ", ".join(f"?{slot.variable.name}" for slot in chronicle.parameters)
        event = f"{chronicle.name}[{names}]" if names else chronicle.name
        yield f"  when recognized {{ emit event({event}, {chronicle.emitted.name}); }}"
    delay = chronicle.max_delay
    yield "}" if delay is None else f"}} with max delay {format_duration(delay)}"


def _clause(clause: ast.Clause) -> str:
    match clause:
        case ast.Event(message, point):
            return f"event({_message(message)}, {point.name})"
        case ast.Occurs(0, 0, message, start, end):
            return f"noevent({_message(message)}, {_interval(start, end)})"
        case ast.Occurs(least, most, message, start, end):
            times = f"({least}, {'oo' if most is None else most})"
            return f"occurs({times}, {_message(message)}, {_interval(start, end)})"
        case ast.Hold(message, start, end):
            # Without brackets `P:uav1` would be one name.
            series = _series(message) if message.arguments else f"{message.concept.text}[]"
            state = f"{series}:{_test(message.value)}"
            return f"hold({state}, {_interval(start, end)})"
        case ast.Distance():
            return _distance(clause)
        case ast.Comparison(left, operator, right):
            return f"?{left.name} {operator} {format_formula(right)}"
        case Binding(variable, sort):
            return f"?{variable.name} in {sort.text}"
        case _:
            assert_never(clause)


def _distance(distance: ast.Distance) -> str:
    first, second = distance.first.name, distance.second.name
    match distance.least, distance.most:
        case 1, None:
            return f"{first} < {second}"
        case 0, None:
            return f"{first} <= {second}"
        case 0, 0:
            return f"{first} = {second}"
        case least, most:
            low = "-oo" if least is None else _duration(least)
            high = "oo" if most is None else _duration(most)
            return f"{second} - {first} in [{low}, {high}]"


def _message(message: ast.Message) -> str:
    if message.before is None and message.value is None:
        return _series(message)
    return f"{_series(message)}:({_test(message.before)}, {_test(message.value)})"


def _series(message: ast.Message) -> str:
    arguments = ", ".join(
        "?" if each is None else format_formula(each) for each in message.arguments
    )
    return f"{message.concept.text}[{arguments}]" if arguments else message.concept.text


def _test(test: ast.Test | None) -> str:
    if test is None:
        return "?"
    operand = format_formula(test.operand)
    return operand if test.operator == "=" else f"{test.operator} {operand}"


def _interval(start: ast.Moment, end: ast.Moment) -> str:
    return f"({_moment(start)}, {_moment(end)})"


def _moment(moment: ast.Moment) -> str:
    if isinstance(moment.offset, ast.Given):
        given = moment.offset
        return f"{moment.point.name} {'-' if given.sign < 0 else '+'} ?{given.variable.name}"
    if not moment.offset:
        return moment.point.name
    sign = "-" if moment.offset < 0 else "+"
    return f"{moment.point.name} {sign} {_duration(abs(moment.offset))}"


def _duration(duration: ast.Duration) -> str:
    if isinstance(duration, ast.Given):
        sign = "-" if duration.sign < 0 else ""
        more = ""
        if duration.offset:
            size = format_duration(abs(duration.offset))
            more = f" {'-' if duration.offset < 0 else '+'} {size}"
        return f"{sign}?{duration.variable.name}{more}"
    if not duration:
        return "0s"
    return f"-{format_duration(-duration)}" if duration < 0 else format_duration(duration)
