"""Property paths as plans (SPARQL 1.1 §9, §18.2.2.4): sequences join, alternatives unite, and only
repetition needs an operator of its own (`plan.Closure`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias, assert_never

from pyoxigraph import NamedNode

from ...sparql import ast
from .expressions import Call, Const, Var
from .plan import START, STOP, Closure, Filter, Join, Plan, Position, Union

Pattern: TypeAlias = Callable[[Position, Position, Position], Plan]


def path_plan(
    path: ast.Path,
    subject: Position,
    object: Position,
    pattern: Pattern,
    fresh: Callable[[], str],
    graph: str,
) -> Plan:
    """The pairs of ends of ``path`` between ``subject`` and ``object``, in ``graph``.

    ``pattern`` makes the plan of one triple pattern, ``fresh`` a variable that no text names.
    """

    def go(path: ast.Path, s: Position, o: Position) -> Plan:
        match path:
            case NamedNode():
                return pattern(s, Const(path), o)
            case ast.Inverse(inner):
                return go(inner, o, s)
            case ast.Sequence(parts):
                return sequence(parts, s, o)
            case ast.Alternative(parts):
                return Union(tuple(go(part, s, o) for part in parts))
            case ast.NegatedSet(forward, backward):
                return negated(forward, backward, s, o)
            case ast.Repetition(inner, sign):
                step = go(inner, Var(START), Var(STOP))
                return Closure(s, o, step, sign != "+", sign != "?", graph)
            case _:
                assert_never(path)

    def sequence(parts: Sequence[ast.Path], s: Position, o: Position) -> Plan:
        places: list[Position] = [s, *(Var(fresh()) for _ in parts[1:]), o]
        steps = zip(parts, places, places[1:], strict=False)
        return Join(tuple(go(part, start, stop) for part, start, stop in steps))

    def negated(
        forward: Sequence[NamedNode], backward: Sequence[NamedNode], s: Position, o: Position
    ) -> Plan:
        found = []
        if forward or not backward:
            found.append(but(forward, s, o))
        if backward:
            found.append(but(backward, o, s))
        return Union(tuple(found))

    def but(predicates: Sequence[NamedNode], s: Position, o: Position) -> Plan:
        predicate = Var(fresh())
        plan = pattern(s, predicate, o)
        for iri in predicates:
            plan = Filter(Call("!=", (predicate, Const(iri))), plan)
        return plan

    return go(path, subject, object)
