"""Why a verdict is what it is: its states, with the value of each part of the formula there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from ...languages.mtl import ast, format_formula
from ...languages.mtl.ast import Monitor
from ...languages.mtl.checked import CheckedMonitor, ObjectVariable, Reading
from ...ontology.units import format_unit
from ...rdf.namespaces import shorten
from ..states.states import States
from .formulas import earliest, parts_of, reach_of, readings_of, sorts_of
from .nodes import Axes, Pass
from .windows import NEVER

MOST_ROWS: Final = 10_000
"""States that an explanation shows."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A feature with its unit, or a part of the formula: its text, how deep it stands, and its
    value at each state. Values of parts are true, false, unknown, or open: not known when the
    verdict was decided."""

    text: str
    depth: int
    values: tuple[object, ...]


@dataclass(frozen=True, slots=True)
class Explanation:
    """The states of a verdict's window, by valid time (ns), up to the one that decides it.

    ``verdict``: true, false, unknown, or open: not decided yet; ``decided`` is then None. With
    `robustness` a verdict is open until its intervals are over, though its parts may be known.
    """

    start: int
    verdict: str
    decided: int | None
    valid: tuple[int, ...]
    features: tuple[Shown, ...]
    formulas: tuple[Shown, ...]


class NoStart(LookupError):
    """There is no state at a time, or the objects are not there. ``near``: times of states (ns)."""

    def __init__(self, message: str, near: Sequence[int] = ()) -> None:
        super().__init__(message)
        self.near = tuple(near)


def explain_verdict(
    monitor: CheckedMonitor, text: Monitor, states: States, start: int, objects: Sequence[str]
) -> Explanation:
    """Explain the verdict that starts at time ``start`` (ns) of ``objects``, the IRIs of the
    parameters in order. ``states``: all of them. Raises `NoStart`. Cost: one evaluation of all
    states."""
    row = int(np.searchsorted(states.valid, start))
    if row == len(states.valid) or states.valid[row] != start:
        around = states.valid[max(0, row - 1) : row + 1].tolist()
        raise NoStart("there is no state at this time", around)
    places = _places(monitor, states, row, objects)
    sorts = sorts_of(monitor)
    once = Pass(states, sorts)
    explained = _Reader(once, places)
    root = explained.moments(monitor.formula)
    assert root is not None
    at = min(root.true[row], root.false[row], root.unknown[row])
    if monitor.robustness:
        at = max(at, once.over(reach_of(monitor.formula))[row])
    last = len(states.valid) - 1 if at == NEVER else int(at)
    first = int(earliest(monitor.formula, np.array([row]), once.back)[0])
    rows = slice(max(first, last + 1 - MOST_ROWS), last + 1)
    formulas = tuple(
        Shown(format_formula(part), depth, explained.values(checked, rows, last))
        for part, checked, depth in _parts(text.formula, monitor.formula, 0)
    )
    readings = dict.fromkeys(readings_of(monitor.formula))
    features = tuple(
        Shown(_words(reading), 0, values)
        for reading in readings
        if (values := explained.readings(reading, rows)) is not None
    )
    is_open = at == NEVER
    known = explained.values(monitor.formula, slice(row, row + 1), last)[0]
    verdict = "open" if is_open else known
    decided = None if is_open else int(states.valid[at])
    valid = tuple(states.valid[rows].tolist())
    return Explanation(start, str(verdict), decided, valid, features, formulas)


def _places(
    monitor: CheckedMonitor, states: States, row: int, objects: Sequence[str]
) -> dict[str, int]:
    """The place of each parameter's object."""
    found = {}
    for (name, sort), iri in zip(monitor.parameters, objects, strict=True):
        names = list(states.objects[sort])
        if iri not in names or not states.present[sort][row, names.index(iri)]:
            raise NoStart(f"{iri} is not there at this state, so it has no verdict")
        found[name] = names.index(iri)
    return found


@dataclass(frozen=True, slots=True)
class _Moments:
    """The moments of a part for one binding, by state: shape ``(n,)``."""

    true: NDArray[np.int64]
    false: NDArray[np.int64]
    unknown: NDArray[np.int64]


@dataclass(slots=True)
class _Reader:
    """Reads tables of moments for one binding."""

    once: Pass
    places: dict[str, int]

    def moments(self, formula: Any) -> _Moments | None:
        """The moments of a part; None for one that is about further objects."""
        lower, upper = self.once.node(formula, False), self.once.node(formula, True)
        if not {*lower.axes, *upper.axes} <= self.places.keys():
            return None
        return _Moments(
            self._column(lower.axes, lower.true),
            self._column(upper.axes, upper.false),
            np.maximum(self._column(lower.axes, lower.false), self._column(upper.axes, upper.true)),
        )

    def _column(self, axes: Axes, table: NDArray[Any]) -> NDArray[Any]:
        at: Any = (slice(None), *(self.places[name] for name in axes))
        found: NDArray[Any] = table[at]
        return found

    def values(self, formula: Any, rows: slice, last: int) -> tuple[object, ...]:
        """The value of a part at each state, as far as it was known at state ``last``."""
        found = self.moments(formula)
        if found is None:
            return ()
        words = np.full(self.once.rows, "open", object)
        words[found.unknown <= last] = "unknown"
        words[found.false <= last] = "false"
        words[found.true <= last] = "true"
        return tuple(words[rows].tolist())

    def readings(self, reading: Reading, rows: slice) -> tuple[object, ...] | None:
        """The values of a feature; None for one of further objects."""
        axes, values, known = self.once.value(reading)
        if not set(axes) <= self.places.keys():
            return None
        columns = (self._column(axes, table)[rows].tolist() for table in (values, known))
        shown = zip(*columns, strict=True)
        return tuple(value if is_known else None for value, is_known in shown)


def _parts(text: Any, checked: Any, depth: int) -> Iterator[tuple[Any, Any, int]]:
    """The parts of a formula as written, each with what it means; those under a quantifier are
    about further objects and are left out."""
    yield text, checked, depth
    meant = parts_of(checked)
    match text:
        case ast.Not(operand) | ast.Previous(operand) | ast.Within(_, _, operand):
            operands: tuple[Any, ...] = (operand,)
        case ast.And(left, right) | ast.Or(left, right) | ast.Until(_, _, left, right):
            operands = left, right
        case ast.Implies(left, right):
            # It is checked as `not left or right`.
            operands, meant = (left, right), (*parts_of(meant[0]), meant[1])
        case _:
            return
    for part, own in zip(operands, meant, strict=True):
        yield from _parts(part, own, depth + 1)


def _words(reading: Reading) -> str:
    arguments = (
        f"?{a.name}" if isinstance(a, ObjectVariable) else shorten(a.iri) for a in reading.arguments
    )
    unit = f" [{format_unit(reading.unit)}]" if reading.unit else ""
    return f"{shorten(reading.feature).removeprefix('dyknow:')}({', '.join(arguments)}){unit}"
