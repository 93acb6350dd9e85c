"""The parts of a plan that the compiled loop evaluates: patterns with constant predicates, their
joins, and numeric filters on them (see `solver`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

from pyoxigraph import NamedNode

from ...rdf.namespaces import RDF_TYPE
from ..algebra.expressions import (
    Call,
    Const,
    Expression,
    Var,
    conjuncts,
    postorder,
    variables,
)
from ..algebra.plan import (
    START,
    STOP,
    Aggregate,
    Closure,
    Distinct,
    Filter,
    Join,
    Plan,
    Project,
    Scan,
    TypeScan,
    inputs,
    outputs,
    used_variables,
    walk,
    with_inputs,
)
from .join_kernel import (
    ADD,
    AND,
    DIVIDE,
    EQUAL,
    GREATER,
    GREATER_EQUAL,
    LESS,
    LESS_EQUAL,
    MULTIPLY,
    NEGATE,
    NOT,
    OR,
    SUBTRACT,
    UNEQUAL,
)

OPERATIONS = {
    "+": ADD,
    "-": SUBTRACT,
    "*": MULTIPLY,
    "/": DIVIDE,
    "=": EQUAL,
    "!=": UNEQUAL,
    "<": LESS,
    "<=": LESS_EQUAL,
    ">": GREATER,
    ">=": GREATER_EQUAL,
    "&&": AND,
    "||": OR,
    "!": NOT,
    "NEGATE": NEGATE,
}
_HIGHEST = 60


@dataclass(frozen=True, slots=True)
class Slot:
    """A predicate in a graph; `RDF_TYPE` for classes."""

    graph: str
    predicate: NamedNode


def slot_of(leaf: Scan | TypeScan) -> Slot:
    return Slot(leaf.graph, RDF_TYPE if isinstance(leaf, TypeScan) else leaf.predicate)


def pattern_parts(plan: Plan) -> Plan:
    """Put the parts of each join that the loop can evaluate together into one join."""
    plan = with_inputs(plan, pattern_parts)
    if isinstance(plan, Join):
        served = tuple(part for part in plan.parts if _is_served(part))
        others = tuple(part for part in plan.parts if not _is_served(part))
        if len(served) > 1 and others:
            return Join((Join(served), *others))
    return plan


def served_parts(plan: Plan) -> Iterator[Plan]:
    """Yield the largest parts of ``plan`` that the loop can evaluate."""
    if _is_served(plan) and any(True for _ in leaves(plan)):
        yield plan
        return
    for part in inputs(plan):
        yield from served_parts(part)


def _is_served(plan: Plan) -> bool:
    match plan:
        case Scan():
            # The loop binds the ends of patterns, not the times of triples.
            return not plan.times.names
        case TypeScan():
            return True
        case Join(parts):
            return bool(parts) and all(_is_served(part) for part in parts)
        case Filter(condition, child):
            # A variable that the child does not bind is unbound in this filter, whatever its name.
            bound = variables(condition) <= outputs(child)
            return bound and _is_served(child) and _is_compiled(condition)
        case _:
            return False


def leaves(plan: Plan) -> Iterator[Scan | TypeScan]:
    if isinstance(plan, Scan | TypeScan):
        yield plan
    for part in inputs(plan):
        yield from leaves(part)


def conditions(plan: Plan) -> Iterator[Expression]:
    if isinstance(plan, Filter):
        yield from conjuncts(plan.condition)
    for part in inputs(plan):
        yield from conditions(part)


def _is_compiled(expression: Expression) -> bool:
    """Whether the loop implements all of it, and its stack suffices."""
    height = 0
    for one in postorder(expression):
        match one:
            case Var() | Const():
                height += 1
                if height > _HIGHEST:
                    return False
            case Call("!" | "NEGATE", (_,)):
                pass
            case Call(name, (_, _)) if name in OPERATIONS:
                height -= 1
            case _:
                return False
    return True


def needed_outside(plan: Plan, parts: Sequence[Plan]) -> list[frozenset[str]]:
    """Return for each of ``parts`` its variables that the rest of ``plan`` uses; all of them if it
    compares whole solutions. Cost: one pass over the plan, and one over each part."""
    nodes = {id(node): node for node in walk(plan)}
    uses = {number: _used_names(node) for number, node in nodes.items()}
    all_uses = Counter(chain.from_iterable(uses.values()))
    comparing = {number for number, node in nodes.items() if _compares_solutions(node)}
    needed = []
    for part in parts:
        inside = {id(node) for node in walk(part)}
        own = Counter(chain.from_iterable(uses[number] for number in inside))
        if comparing <= inside:
            # A variable that is used more often than within the part is used outside of it.
            needed.append(frozenset(n for n in outputs(part) if all_uses[n] > own[n]))
        else:
            needed.append(outputs(part))
    return needed


def _used_names(node: Plan) -> frozenset[str]:
    """Return the variables of its inputs that one node uses."""
    names = used_variables(node)
    if not inputs(node):
        names |= outputs(node)
    match node:
        case Project(shown):
            names |= set(shown)
        case Aggregate(keys):
            names |= set(keys)
        case Closure():
            names |= outputs(node) | {START, STOP}
    return names


def _compares_solutions(node: Plan) -> bool:
    """Whether a node compares whole solutions of its input."""
    match node:
        case Aggregate(_, aggregations):
            return any(one.distinct and one.argument is None for one in aggregations)
        case Distinct(child):
            return not isinstance(child, Project)
        case _:
            return False
