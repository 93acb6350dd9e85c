"""Accessors of triples' times: ``f:timestamp(?x)`` and ``dyknow-o:validTime(?x)``.

Semantics (docs/explanation/semantics.md): for ``?x`` the result is the latest time of the stream
elements that the patterns with ``?x`` matched, for ``(?s, ?p, ?o)`` that of the element which this
very pattern matched. Patterns of the static side, and ``a``, have no time. So a time is one more
column of a scan, and an accessor becomes a variable.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from typing import Final

from pyoxigraph import Literal, NamedNode

from ...languages.csparql.functions import ACCESSORS, TIMESTAMP
from ...rdf.namespaces import XSD
from ...sparql import ast
from ...streams.time import format_time
from .expressions import Call, Const, Expression, Var
from .plan import (
    Aggregate,
    AnyScan,
    Distinct,
    Exists,
    Extend,
    Filter,
    Join,
    LeftJoin,
    Minus,
    Order,
    Plan,
    Position,
    Project,
    Scan,
    Slice,
    Union,
    expressions_of,
    walk,
    with_expressions,
    with_inputs,
)
from .plan_text import show

_AVAILABLE: Final = f"<{TIMESTAMP}>"
_ACCESSORS: Final = frozenset(f"<{iri}>" for iri in ACCESSORS)
LATEST: Final = "LATEST"
"""The function that returns the greatest of its bound arguments."""


def with_times(plan: Plan) -> Plan:
    """Replace each accessor by a variable that the plan's scans bind.

    Raises ``ValueError`` for an accessor that matches no pattern around it.
    """
    return _Times().plan(plan)


class _Times:
    def __init__(self) -> None:
        self.numbers = count(1)

    def plan(self, plan: Plan) -> Plan:
        plan = with_inputs(plan, self.plan)
        found = dict.fromkeys(a for e in expressions_of(plan) for a in _accessors(e))
        if not found:
            return plan
        values: dict[Call, Expression] = {}
        for accessor in found:
            plan, names = self._bound_below(accessor, plan)
            if not names:
                raise ValueError(
                    f"{show(accessor)}: no triple pattern of its group reads "
                    + ("this triple" if len(accessor.arguments) == 3 else "it from a stream")
                )
            variables = tuple(Var(name) for name in names)
            values[accessor] = variables[0] if len(variables) == 1 else Call(LATEST, variables)
        return with_expressions(plan, lambda e: _replaced(e, values))

    def _bound_below(self, accessor: Call, plan: Plan) -> tuple[Plan, list[str]]:
        names: list[str] = []

        def go(child: Plan) -> Plan:
            changed, more = self._bound(accessor, child)
            names.extend(more)
            return changed

        return with_inputs(plan, go), names

    def _bound(self, accessor: Call, plan: Plan) -> tuple[Plan, list[str]]:
        """Add a time column to each visible scan that matches; return the plan and their names."""
        names: list[str] = []

        def go(plan: Plan) -> Plan:
            match plan:
                case Scan() | AnyScan() if _fits(accessor, plan):
                    plan, name = self._column(accessor, plan)
                    names.append(name)
                    return plan
                case Join() | Union() | LeftJoin() | Filter() | Extend() | Order() | Slice():
                    return with_inputs(plan, go)
                case Minus() | Exists():
                    # Only the child's bindings are visible outside.
                    return replace(plan, child=go(plan.child))
                # Sub-queries and aggregates give solutions, and only stream elements have a time.
                case Project() | Distinct() | Aggregate() | _:
                    return plan

        return go(plan), names

    def _column(self, accessor: Call, scan: Scan | AnyScan) -> tuple[Scan | AnyScan, str]:
        times = scan.times
        known = times.available if accessor.name == _AVAILABLE else times.valid
        # Accessors of one time share its column.
        if known is not None:
            return scan, known
        name = f"\0t{next(self.numbers)}"
        if accessor.name == _AVAILABLE:
            return replace(scan, times=replace(times, available=name)), name
        return replace(scan, times=replace(times, valid=name)), name


def _fits(accessor: Call, scan: Scan | AnyScan) -> bool:
    places: tuple[Position, ...] = (scan.subject, scan.object)
    if isinstance(scan, AnyScan):
        places = (scan.subject, scan.predicate, scan.object)
    if len(accessor.arguments) == 1:
        return accessor.arguments[0] in places
    subject, predicate, object = accessor.arguments
    same = (subject, object) == (scan.subject, scan.object)
    if isinstance(scan, AnyScan):
        return same and predicate == scan.predicate
    return same and getattr(predicate, "term", None) == scan.predicate


def _accessors(expression: Expression) -> list[Call]:
    if not isinstance(expression, Call):
        return []
    if expression.name in _ACCESSORS:
        if len(expression.arguments) not in (1, 3):
            raise ValueError(f"{show(expression)} has one argument or three")
        return [expression]
    return [a for argument in expression.arguments for a in _accessors(argument)]


def _replaced(expression: Expression, values: dict[Call, Expression]) -> Expression:
    if not isinstance(expression, Call):
        return expression
    if expression in values:
        return values[expression]
    arguments = tuple(_replaced(argument, values) for argument in expression.arguments)
    return Call(expression.name, arguments)


def names_now(plan: Plan) -> bool:
    """Whether an expression in the plan calls NOW()."""
    return any(_has_now(e) for node in walk(plan) for e in expressions_of(node))


def at_time(plan: Plan, end: int) -> Plan:
    """Replace NOW() by the end of the window: no clock is read here."""
    now = Const(Literal(format_time(end), datatype=_DATE_TIME))
    values: dict[Call, Expression] = {_NOW: now}

    def go(plan: Plan) -> Plan:
        return with_expressions(with_inputs(plan, go), lambda e: _replaced(e, values))

    return go(plan)


def asks_for_times(tree: ast.Query) -> bool:
    """Whether a query contains an accessor."""
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.FunctionCall))
    return any(call.iri.value in ACCESSORS for call in calls)


_NOW: Final = Call("NOW", ())
_DATE_TIME: Final = NamedNode(XSD + "dateTime")


def _has_now(expression: Expression) -> bool:
    if not isinstance(expression, Call):
        return False
    return expression == _NOW or any(map(_has_now, expression.arguments))
