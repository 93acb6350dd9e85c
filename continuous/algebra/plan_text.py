"""Prints logical plans for `explain`: an indented tree, a line per node."""

from __future__ import annotations

from typing import assert_never

from pyoxigraph import Literal, NamedNode

from ...rdf.namespaces import shorten
from .expressions import INFIX, Call, Const, Expression, Var
from .plan import (
    DEFAULT,
    Aggregate,
    Aggregation,
    AnyScan,
    Ask,
    Blank,
    Closure,
    Construct,
    Distinct,
    Exists,
    Extend,
    Filter,
    Given,
    Head,
    Join,
    LeftJoin,
    Minus,
    Order,
    Plan,
    Project,
    Query,
    Scan,
    Select,
    Slice,
    Times,
    TypeScan,
    Union,
    Values,
    inputs,
)


def describe_query(query: Query) -> list[str]:
    """Return the head, and the plan below it."""
    return [_head(query.head), *(f"  {line}" for line in describe(query.plan))]


def describe(plan: Plan) -> list[str]:
    """Return the plan as an indented tree, a line per node, in the order of `plan.walk`."""
    below = [f"  {line}" for child in inputs(plan) for line in describe(child)]
    return [_line(plan), *below]


def _line(plan: Plan) -> str:
    match plan:
        case Scan(subject, predicate, object, graph, times):
            shown = f"{show(subject)} {shorten(predicate.value)} {show(object)}"
            return f"Scan {shown}{_graph(graph)}{_times(times)}"
        case AnyScan(subject, variable, object, graph, times):
            shown = f"{show(subject)} {show(variable)} {show(object)}"
            return f"AnyScan {shown}{_graph(graph)}{_times(times)}"
        case TypeScan(subject, sort, graph):
            return f"TypeScan {show(subject)} a {show(sort)}{_graph(graph)}"
        case Closure(subject, object, _, zero, more, graph):
            mark = "*" if zero and more else "+" if more else "?"
            return f"Closure {show(subject)} ({mark}) {show(object)}{_graph(graph)}"
        case Values(variables, rows):
            return f"Values ({' '.join(variables)}) of {len(rows)}"
        case Given(variables):
            return f"Given ({' '.join(variables)})"
        case Filter(condition):
            return f"Filter {show(condition)}"
        case LeftJoin(_, _, condition):
            return "LeftJoin" if condition is None else f"LeftJoin where {show(condition)}"
        case Extend(variable, expression):
            return f"Extend {show(Var(variable))} := {show(expression)}"
        case Exists(variable):
            return f"Exists {show(Var(variable))} := whether the second has a solution"
        case Aggregate(keys, aggregations):
            shown = ", ".join(map(_aggregation, aggregations))
            return f"Aggregate by ({' '.join(show(Var(key)) for key in keys)}): {shown}"
        case Project(variables):
            return f"Project {' '.join(show(Var(name)) for name in variables)}"
        case Order(keys):
            directions = (f"{'DESC' if down else 'ASC'} {show(key)}" for key, down in keys)
            return f"Order by {', '.join(directions)}"
        case Slice(start, length):
            return f"Slice from {start}" + ("" if length is None else f", {length} of them")
        case Join() | Union() | Minus() | Distinct():
            return type(plan).__name__
        case _:
            assert_never(plan)


def _aggregation(one: Aggregation) -> str:
    argument = "*" if one.argument is None else show(one.argument)
    distinct = "DISTINCT " if one.distinct else ""
    return f"{show(Var(one.variable))} := {one.function}({distinct}{argument})"


def _graph(graph: str) -> str:
    return "" if graph == DEFAULT else f" in {shorten(graph)}"


def _times(times: Times) -> str:
    named = (("at", times.available), ("valid", times.valid))
    return "".join(f", {word} {show(Var(name))}" for word, name in named if name is not None)


def show(expression: Expression | Blank) -> str:
    """Print an expression for users: IRIs are shortened, internal variables marked by a dot."""
    match expression:
        case Const(NamedNode() as node):
            return shorten(node.value)
        case Const(Literal() as literal) if literal.datatype.value.endswith(
            ("#integer", "#decimal", "#double", "#boolean")
        ):
            return literal.value
        case Call(name, (left, right)) if name in INFIX:
            return f"({show(left)} {name} {show(right)})"
        case Call(name, arguments):
            return f"{name}({', '.join(map(show, arguments))})"
        case Var(name):
            return f"?{name}".replace("\0", ".")
        case Const() | Blank():
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
