"""Property paths as plans (SPARQL 1.1 §9, §18.2.2.4): sequences join, alternatives unite, and only
repetition needs an operator of its own (`logical.Closure`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from pyoxigraph import NamedNode
from rdflib.paths import AlternativePath, InvPath, MulPath, NegatedPath, SequencePath
from rdflib.term import URIRef

from .expressions import Call, Const, Var
from .logical import START, STOP, Closure, Filter, Join, Plan, Position, Union
from .unsupported import Unsupported

Pattern: TypeAlias = Callable[[Position, Position, Position], Plan]


def path_plan(
    path: Any,
    subject: Position,
    object: Position,
    pattern: Pattern,
    fresh: Callable[[], str],
    graph: str,
) -> Plan:
    """The pairs of ends of ``path`` between ``subject`` and ``object``, in ``graph``.

    ``pattern`` makes the plan of one triple pattern, ``fresh`` a variable that no text names.
    """

    def go(path: Any, s: Position, o: Position) -> Plan:
        match path:
            case URIRef():
                return pattern(s, Const(NamedNode(str(path))), o)
            case InvPath():
                return go(path.arg, o, s)
            case SequencePath():
                return sequence(path.args, s, o)
            case AlternativePath():
                return Union(tuple(go(part, s, o) for part in path.args))
            case NegatedPath():
                return negated(path.args, s, o)
            case MulPath():
                step = go(path.path, Var(START), Var(STOP))
                return Closure(s, o, step, bool(path.zero), bool(path.more), graph)
            case _:
                raise Unsupported(f"the path {path}")

    def sequence(parts: Sequence[Any], s: Position, o: Position) -> Plan:
        places: list[Position] = [s, *(Var(fresh()) for _ in parts[1:]), o]
        steps = zip(parts, places, places[1:], strict=False)
        return Join(tuple(go(part, start, stop) for part, start, stop in steps))

    def negated(parts: Sequence[Any], s: Position, o: Position) -> Plan:
        forward = [str(part) for part in parts if isinstance(part, URIRef)]
        backward = [_inverted(part) for part in parts if not isinstance(part, URIRef)]
        found = []
        if forward or not backward:
            found.append(but(forward, s, o))
        if backward:
            found.append(but(backward, o, s))
        return Union(tuple(found))

    def but(predicates: Sequence[str], s: Position, o: Position) -> Plan:
        predicate = Var(fresh())
        plan = pattern(s, predicate, o)
        for iri in predicates:
            plan = Filter(Call("!=", (predicate, Const(NamedNode(iri)))), plan)
        return plan

    return go(path, subject, object)


def _inverted(part: Any) -> str:
    """The IRI of ``^iri`` inside a negated set."""
    if isinstance(part, InvPath) and isinstance(part.arg, URIRef):
        return str(part.arg)
    # rdflib's parser forgets which IRI stood there.
    raise Unsupported("an inverse in a negated path")
