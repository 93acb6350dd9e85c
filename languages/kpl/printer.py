"""Prints checked KPL. Law: parsing and checking the text returns the declarations."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from typing import Final, assert_never

from ...streams.policies.policy import (
    AnyChange,
    AnyUpdate,
    Approximation,
    ChangeBy,
    Order,
    Policy,
    SampleEvery,
    SynchronizationPolicy,
)
from ...streams.time import format_duration
from .constraints import UNITS
from .declarations import (
    Aggregate,
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    ForeachDeclaration,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    Select,
    SelectObject,
    SinkDeclaration,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
    Term,
    ValueSort,
)

DEFAULT_UNIT: Final = "ms"


def format_kpl(
    declarations: CheckedDeclaration | Sequence[CheckedDeclaration], unit: str = DEFAULT_UNIT
) -> str:
    """Return a line for each declaration, several for a ``foreach``. Integers are in ``unit``,
    which the first line states unless it is ms."""
    if not isinstance(declarations, Sequence):
        declarations = (declarations,)
    lines = [] if unit == DEFAULT_UNIT else [f"unit {unit}"]
    return "\n".join([*lines, *(_declaration(declaration, unit) for declaration in declarations)])


def format_policy(policy: Policy | SynchronizationPolicy, unit: str = DEFAULT_UNIT) -> str:
    """Return ``sample every 200, max delay 50, from 0 to oo`` without defaults, so the default
    policy is empty. A synchronization always states its change."""
    parts = []
    match policy.change:
        case AnyUpdate():
            # A synchronization has no default: it must state the times of its states.
            parts += ["any update"] if isinstance(policy, SynchronizationPolicy) else []
        case AnyChange():
            parts.append("any change")
        case ChangeBy(difference):
            parts.append(f"change by {_number(difference)}")
        case SampleEvery(period):
            parts.append(f"sample every {_time(period, unit)}")
        case _:
            assert_never(policy.change)
    if policy.max_delay is not None:
        parts.append(f"max delay {_time(policy.max_delay, unit)}")
    duration = policy.duration
    ends = [] if duration.start is None else [f"from {_time(duration.start, unit)}"]
    if duration.end is not None:
        ends.append(f"to {_time(duration.end, unit)}")
    elif duration.to_oo:
        ends.append("to oo")
    if ends:
        parts.append(" ".join(ends))
    if policy.order is not Order.ANY:
        parts.append(policy.order.value)
    if policy.approximation is not Approximation.NONE:
        parts.append(policy.approximation.value)
    return ", ".join(parts)


def format_term(term: Term, unit: str = DEFAULT_UNIT) -> str:
    """Return ``pos[car1] with sample every 200``."""
    policy = format_policy(term.policy, unit)
    return f"{term.label} with {policy}" if policy else str(term.label)


def _declaration(declaration: CheckedDeclaration, unit: str) -> str:
    match declaration:
        case SourceDeclaration(name, sort):
            return f"source {sort.name} {name}"
        case CompunitDeclaration(name, sort, inputs):
            return f"compunit {sort.name} {name}({', '.join(i.name for i in inputs)})"
        case GeneratorDeclaration():
            return f"strmgen {declaration.label} = {_process(declaration, unit)}"
        case StreamDeclaration(name, _, term):
            return f"stream {name} = {format_term(term, unit)}"
        case SortDeclaration(sort):
            return f"sort {sort.name} = {_value(sort)}"
        case ForeachDeclaration(variable, members, generators):
            lines = (f"  {_declaration(generator, unit)}\n" for generator in generators)
            return f"foreach {variable} in {format_term(members, unit)} {{\n{''.join(lines)}}}"
        case SinkDeclaration(name, terms):
            return f"sink {name}({', '.join(format_term(term, unit) for term in terms)})"
        case _:
            assert_never(declaration)


def _process(generator: GeneratorDeclaration, unit: str) -> str:
    terms = ", ".join(format_term(term, unit) for term in generator.terms)
    match generator.process:
        case FromSource(name):
            return name
        case Compute(name):
            return f"{name}({terms})"
        case JoinOf():
            return f"join({terms}{'; inner times' if generator.process.inner_times else ''})"
        case Synchronize(_, policy):
            return f"sync({terms}; {format_policy(policy, unit)})"
        case SelectObject():
            return f"selectObject({terms})"
        case Aggregate(variable, pattern, members) | Select(variable, pattern, members):
            name = "select" if isinstance(generator.process, Select) else "aggregate"
            objects = f"foreach {variable} in {format_term(members, unit)}"
            return f"{name}({format_term(pattern, unit)} {objects})"
        case _:
            assert_never(generator.process)


def _value(sort: ValueSort) -> str:
    if sort.simple_type is not None:
        return sort.simple_type.value
    return f"({', '.join(f'{field.name} {field.type.value}' for field in sort.fields or ())})"


def _number(number: float) -> str:
    """Return the shortest digits that parse to ``number``, without an exponent."""
    text = format(Decimal(repr(number)), "f")
    return text.removesuffix(".0")


def _time(time: int, unit: str) -> str:
    """Return an integer in ``unit`` if that is exact, else a duration in the coarsest
    exact unit."""
    quotient, rest = divmod(time, UNITS[unit])
    if not rest:
        return str(quotient)
    return f"{'-' if time < 0 else ''}{format_duration(abs(time))}"
