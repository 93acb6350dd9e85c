"""The logical plan of a continuous query: what is computed over named variables, not how.

Made by `translate`, improved by `rules`, printed by `describe`, executed by `relational` and
`incremental`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias, assert_never

from pyoxigraph import Literal, NamedNode

from ..rdf.dictionary import Term
from ..rdf.namespaces import shorten
from .expressions import Call, Const, Expression, Var

Position: TypeAlias = Var | Const


@dataclass(frozen=True, slots=True)
class Scan:
    """The triples of one predicate, of the window and of the static side together."""

    subject: Position
    predicate: NamedNode
    object: Position


@dataclass(frozen=True, slots=True)
class TypeScan:
    """``?x a <Sort>``: a set of facts, static, told by the stream, or by the annotation of rows."""

    subject: Position
    sort: Position


@dataclass(frozen=True, slots=True)
class Values:
    """Rows given in the query; None is UNDEF."""

    variables: tuple[str, ...]
    rows: tuple[tuple[Term | None, ...], ...]


@dataclass(frozen=True, slots=True)
class Join:
    """The natural join of the parts; of none: one solution that binds nothing."""

    parts: tuple[Plan, ...]


@dataclass(frozen=True, slots=True)
class Filter:
    """The solutions for which ``condition`` is true."""

    condition: Expression
    child: Plan


@dataclass(frozen=True, slots=True)
class Extend:
    """``variable`` bound to the value of ``expression``, unbound where that is an error."""

    variable: str
    expression: Expression
    child: Plan


@dataclass(frozen=True, slots=True)
class Aggregation:
    """``function`` (COUNT SUM AVG MIN MAX) over ``argument`` (None: ``*``), as ``variable``."""

    variable: str
    function: str
    argument: Expression | None


@dataclass(frozen=True, slots=True)
class Aggregate:
    """A row a group. ``implicit``: no GROUP BY was written, so nothing gives one row too."""

    keys: tuple[str, ...]
    aggregations: tuple[Aggregation, ...]
    child: Plan
    implicit: bool


@dataclass(frozen=True, slots=True)
class Project:
    """Only these variables go on."""

    variables: tuple[str, ...]
    child: Plan


@dataclass(frozen=True, slots=True)
class Distinct:
    """No two solutions equal."""

    child: Plan


Plan: TypeAlias = Scan | TypeScan | Values | Join | Filter | Extend | Aggregate | Project | Distinct


@dataclass(frozen=True, slots=True)
class Select:
    """The head of a SELECT."""

    variables: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Construct:
    """The head of a CONSTRUCT: its triple patterns."""

    template: tuple[tuple[Position, Position, Position], ...]


@dataclass(frozen=True, slots=True)
class Ask:
    """The head of an ASK."""


Head: TypeAlias = Select | Construct | Ask


@dataclass(frozen=True, slots=True)
class Query:
    """A whole query: what is shown of the solutions of ``plan``."""

    head: Head
    plan: Plan

    def __str__(self) -> str:
        return "\n".join([_head(self.head), *(f"  {line}" for line in describe(self.plan))])


def inputs(plan: Plan) -> tuple[Plan, ...]:
    """The plans that ``plan`` reads."""
    match plan:
        case Scan() | TypeScan() | Values():
            return ()
        case Join(parts):
            return parts
        case Filter() | Extend() | Aggregate() | Project() | Distinct():
            return (plan.child,)
        case _:
            assert_never(plan)


def outputs(plan: Plan) -> frozenset[str]:
    """The variables that solutions of ``plan`` may bind."""
    match plan:
        case Scan(subject, _, object) | TypeScan(subject, object):
            return frozenset(p.name for p in (subject, object) if isinstance(p, Var))
        case Values(variables):
            return frozenset(variables)
        case Join(parts):
            return frozenset().union(*map(outputs, parts))
        case Filter(_, child) | Distinct(child):
            return outputs(child)
        case Extend(variable, _, child):
            return outputs(child) | {variable}
        case Aggregate(keys, aggregations):
            return frozenset(keys) | {a.variable for a in aggregations}
        case Project(variables):
            return frozenset(variables)
        case _:
            assert_never(plan)


def walk(plan: Plan) -> list[Plan]:
    """The plan and all plans in it, top first."""
    found = [plan]
    for child in inputs(plan):
        found.extend(walk(child))
    return found


def describe(plan: Plan) -> list[str]:
    """The plan as an indented tree, a line a node."""
    match plan:
        case Scan(subject, predicate, object):
            line = f"Scan {show(subject)} {shorten(predicate.value)} {show(object)}"
        case TypeScan(subject, sort):
            line = f"TypeScan {show(subject)} a {show(sort)}"
        case Values(variables, rows):
            line = f"Values ({' '.join(variables)}) of {len(rows)}"
        case Join():
            line = "Join"
        case Filter(condition):
            line = f"Filter {show(condition)}"
        case Extend(variable, expression):
            line = f"Extend ?{variable} := {show(expression)}"
        case Aggregate(keys, aggregations):
            shown = ", ".join(
                f"?{a.variable} := {a.function}({'*' if a.argument is None else show(a.argument)})"
                for a in aggregations
            )
            line = f"Aggregate by ({' '.join(f'?{key}' for key in keys)}): {shown}"
        case Project(variables):
            line = f"Project {' '.join(f'?{name}' for name in variables)}"
        case Distinct():
            line = "Distinct"
        case _:
            assert_never(plan)
    return [line, *(f"  {below}" for child in inputs(plan) for below in describe(child))]


def show(expression: Expression) -> str:
    """The expression for people: IRIs shortened."""
    match expression:
        case Const(NamedNode() as node):
            return shorten(node.value)
        case Const(Literal() as literal) if literal.datatype.value.endswith(
            ("#integer", "#decimal", "#double", "#boolean")
        ):
            return literal.value
        case Call(name, (left, right)) if not name.isalpha():
            return f"({show(left)} {name} {show(right)})"
        case Call(name, arguments):
            return f"{name}({', '.join(map(show, arguments))})"
        case Const() | Var():
            return str(expression)
        case _:
            assert_never(expression)


def _head(head: Head) -> str:
    match head:
        case Select(variables):
            return f"Select {' '.join(f'?{name}' for name in variables)}"
        case Construct(template):
            return "Construct " + " . ".join(" ".join(map(show, triple)) for triple in template)
        case Ask():
            return "Ask"
        case _:
            assert_never(head)
