"""Parts of a checked formula: what it reads, and how far it looks ahead."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...languages.mtl.checked import (
    And,
    Atom,
    Calculation,
    CheckedMonitor,
    Formula,
    Not,
    ObjectVariable,
    Or,
    Previous,
    Quantified,
    Reading,
    Until,
    Within,
)


def parts_of(node: Any) -> tuple[Any, ...]:
    """Return the operands of a formula or value."""
    match node:
        case Not(operand) | Previous(operand):
            return (operand,)
        case Within(_, _, operand) | Quantified(_, _, _, operand):
            return (operand,)
        case And(left, right) | Or(left, right):
            return left, right
        case Until(_, _, left, right) | Atom(_, left, right) | Calculation(_, left, right):
            return left, right
        case _:
            return ()


def readings_of(node: Any) -> list[Reading]:
    """Return the features that a formula or value reads, with repetitions."""
    if isinstance(node, Reading):
        return [node]
    return [found for part in parts_of(node) for found in readings_of(part)]


def bound_sorts(formula: Any) -> dict[str, str]:
    """Return the sorts of the variables that quantifiers bind."""
    own = {formula.variable: formula.sort} if isinstance(formula, Quantified) else {}
    for part in parts_of(formula):
        own |= bound_sorts(part)
    return own


def sorts_of(monitor: CheckedMonitor) -> dict[str, str]:
    """Return the sort of each variable, an IRI."""
    return {**dict(monitor.parameters), **bound_sorts(monitor.formula)}


def compares_objects(node: Any) -> bool:
    """Whether a formula or value reads a variable as an object, and not only features of it."""
    return isinstance(node, ObjectVariable) or any(map(compares_objects, parts_of(node)))


def is_of_one_object(monitor: CheckedMonitor) -> bool:
    """Whether a formula is about the object of its one parameter alone."""
    if len(monitor.parameters) != 1 or bound_sorts(monitor.formula):
        return False
    own = (ObjectVariable(monitor.parameters[0][0]),)
    return all(reading.arguments == own for reading in readings_of(monitor.formula))


def objects_have_states(monitor: CheckedMonitor) -> bool:
    """Whether each object of a monitor has states of its own, at its own samples."""
    return monitor.policy.period is None and is_of_one_object(monitor)


def is_of_past(formula: Formula) -> bool:
    """Whether the formula's own operator is one of the past."""
    match formula:
        case Previous():
            return True
        case Until(is_past):
            return is_past
        case Within(operator):
            return operator.is_past
        case _:
            return False


def looks_back(formula: Any) -> bool:
    """Whether the formula has an operator of the past."""
    return is_of_past(formula) or any(map(looks_back, parts_of(formula)))


def is_of_state(formula: Any) -> bool:
    """Whether the formula has no temporal operator: it is about single states."""
    own = isinstance(formula, Previous | Within | Until)
    return not own and all(map(is_of_state, parts_of(formula)))


def is_remembered(formula: Any) -> bool:
    """Whether the formula is `once` or `historically` without an end, of a formula about single
    states: of the past it needs the first state that decides it, and no other."""
    match formula:
        case Within(operator, interval, operand):
            return operator.is_past and interval.end is None and is_of_state(operand)
        case _:
            return False


def remembered_by(monitor: CheckedMonitor) -> tuple[Within, ...]:
    """Return the parts of a monitor's formula that are remembered. A margin is the greatest, or
    least, of all states: with robustness there are none."""
    return () if monitor.robustness else _remembered_in(monitor.formula)


def _remembered_in(formula: Any) -> tuple[Within, ...]:
    if is_remembered(formula):
        return (formula,)
    return tuple(found for part in parts_of(formula) for found in _remembered_in(part))


def earliest(formula: Any, rows: Any, back: Callable[[Formula, Any], Any]) -> Any:
    """Return the first row that the formula looks at from each of the ``rows`` or later ones.
    ``back``: the first one that an operator of the past looks at from each."""
    if is_of_past(formula):
        rows = back(formula, rows)
    for part in parts_of(formula):
        rows = np.minimum(rows, earliest(part, rows, back))
    return rows


def subformulas(formula: Formula) -> tuple[Formula, ...]:
    """Return the operands of a formula that are formulas themselves."""
    return () if isinstance(formula, Atom) else parts_of(formula)


def count_of(formula: Formula) -> int:
    """Return the number of operators and atoms."""
    return 1 + sum(map(count_of, subformulas(formula)))


def reach_of(formula: Any) -> int | None:
    """Return how long after its start (ns) a verdict is decided at the latest; None: no bound."""
    return _reach(formula, is_past=False)


def past_reach_of(formula: Any, remembered: Sequence[Formula]) -> int | None:
    """Return how long before its start (ns) a verdict looks back at most; None: no bound. The state
    that `previous` looks at may be any time before, as may those that are ``remembered``."""
    return _reach(formula, is_past=True, without=remembered)


def _reach(formula: Any, *, is_past: bool, without: Sequence[Formula] = ()) -> int | None:
    """How far the intervals of the past, or of the future, reach together; None: no bound."""
    if formula in without:
        return 0
    below = [_reach(part, is_past=is_past, without=without) for part in parts_of(formula)]
    if None in below:
        return None
    inner = max((each for each in below if each is not None), default=0)
    match formula:
        case Within(_, interval) | Until(_, interval) if is_of_past(formula) is is_past:
            return None if interval.end is None else interval.end + inner
        case _:
            return inner
