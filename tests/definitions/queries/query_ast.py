"""A small AST of SPARQL queries for the laws of continuous queries, and its text.

It shares nothing with the product's: what is drawn here is printed, and the product reads the text.
Variables are strings ``"?x"``, constants are terms of pyoxigraph.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pyoxigraph import BlankNode, Literal, NamedNode

ACCESSORS = {
    "timestamp": "<http://larkc.eu/csparql/sparql/jena/ext#timestamp>",
    "validTime": "<http://www.dyknow.eu/ontology#validTime>",
}


# --- paths


@dataclass(frozen=True)
class Sequence:
    first: Any
    second: Any


@dataclass(frozen=True)
class Inverse:
    path: Any


@dataclass(frozen=True)
class Alternative:
    first: Any
    second: Any


@dataclass(frozen=True)
class NotIn:
    """``!(<a>|<b>)``."""

    predicates: tuple[NamedNode, ...]


@dataclass(frozen=True)
class Repeated:
    """``path*``, ``path+``, ``path?``."""

    path: Any
    sign: str


PATHS = (Sequence, Inverse, Alternative, NotIn, Repeated)


# --- expressions


@dataclass(frozen=True)
class Call:
    """An operator (``=``, ``&&``, ``+`` …) or a function by its name."""

    name: str
    arguments: tuple

    def __init__(self, name: str, *arguments: Any) -> None:
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "arguments", arguments)


@dataclass(frozen=True)
class Exists:
    group: Group
    negated: bool = False


@dataclass(frozen=True)
class Aggregate:
    """``argument`` is an expression, or ``"*"`` (COUNT)."""

    function: str
    argument: Any
    distinct: bool = False
    separator: str | None = None


@dataclass(frozen=True)
class TimeOf:
    """``f:timestamp(?x)`` or ``dyknow-o:validTime(?x)``, or of ``(?s, ?p, ?o)``."""

    accessor: str
    arguments: tuple


# --- patterns: what stands in a group, in this order


@dataclass(frozen=True)
class Triple:
    """``predicate`` is a term, a variable or a path."""

    subject: Any
    predicate: Any
    object: Any


@dataclass(frozen=True)
class Group:
    members: tuple = ()

    def __init__(self, *members: Any) -> None:
        object.__setattr__(self, "members", members)


@dataclass(frozen=True)
class Optional:
    group: Group


@dataclass(frozen=True)
class Union:
    left: Group
    right: Group


@dataclass(frozen=True)
class Minus:
    group: Group


@dataclass(frozen=True)
class Filter:
    condition: Any


@dataclass(frozen=True)
class Bind:
    expression: Any
    variable: str


@dataclass(frozen=True)
class Values:
    """None is UNDEF."""

    variables: tuple[str, ...]
    rows: tuple[tuple, ...]


@dataclass(frozen=True)
class Named:
    """``GRAPH <w> {…}`` or ``GRAPH ?w {…}``."""

    name: Any
    group: Group


# --- queries


@dataclass(frozen=True)
class Select:
    """``head``: ``(variable, expression or None)``, ``keys``: ``(expression, alias or None)``.

    ``keys`` None is no GROUP BY. ``order``: ``(expression, descending)``.
    """

    head: tuple
    where: Group
    distinct: bool = False
    keys: tuple | None = None
    having: tuple = ()
    order: tuple = ()
    limit: int | None = None
    offset: int = 0


@dataclass(frozen=True)
class Construct:
    template: tuple[Triple, ...]
    where: Group


@dataclass(frozen=True)
class Ask:
    where: Group


def has_aggregate(expression: Any) -> bool:
    if isinstance(expression, Call):
        return any(map(has_aggregate, expression.arguments))
    return isinstance(expression, Aggregate)


def aggregated(query: Select) -> bool:
    """Whether the solutions of the query are groups (§18.2.4.1)."""
    used = [e for _, e in query.head] + list(query.having) + [e for e, _ in query.order]
    return query.keys is not None or any(map(has_aggregate, used))


# --- text

INFIX = ("=", "!=", "<", "<=", ">", ">=", "&&", "||", "+", "-", "*", "/")


def show(node: Any) -> str:
    """The SPARQL of any node."""
    match node:
        case str() | NamedNode() | Literal() | BlankNode():
            return str(node)
        case None:
            return "UNDEF"
        case Sequence(a, b):
            return f"({show(a)}/{show(b)})"
        case Alternative(a, b):
            return f"({show(a)}|{show(b)})"
        case Inverse(a):
            return f"(^{show(a)})"
        case NotIn(predicates):
            return f"(!({'|'.join(map(show, predicates))}))"
        case Repeated(a, sign):
            return f"({show(a)}{sign})"
        case Triple(s, p, o):
            return f"{show(s)} {show(p)} {show(o)} ."
        case Group(members):
            return "{ " + " ".join(map(show, members)) + " }"
        case Optional(group):
            return f"OPTIONAL {show(group)}"
        case Union(left, right):
            return f"{show(left)} UNION {show(right)}"
        case Minus(group):
            return f"MINUS {show(group)}"
        case Filter(condition):
            return f"FILTER ({show(condition)})"
        case Bind(expression, variable):
            return f"BIND ({show(expression)} AS {variable})"
        case Values(variables, rows):
            shown = " ".join("(" + " ".join(map(show, row)) + ")" for row in rows)
            return f"VALUES ({' '.join(variables)}) {{ {shown} }}"
        case Named(name, group):
            return f"GRAPH {show(name)} {show(group)}"
        case Select():
            return "{ " + show_select(node) + " }"
    return show_expression(node)


def show_expression(node: Any) -> str:
    match node:
        case Call("!", (a,)):
            return f"(! {show(a)})"
        case Call("IN" | "NOT IN" as name, (a, *rest)):
            return f"({show(a)} {name} ({', '.join(map(show, rest))}))"
        case Call(name, arguments) if name in INFIX:
            return f"({show(arguments[0])} {name} {show(arguments[1])})"
        case Call(name, arguments):
            return f"{name}({', '.join(map(show, arguments))})"
        case Exists(group, negated):
            return f"{'NOT ' if negated else ''}EXISTS {show(group)}"
        case Aggregate(function, argument, distinct, separator):
            inner = f"{'DISTINCT ' if distinct else ''}{show(argument)}"
            end = "" if separator is None else f'; SEPARATOR="{separator}"'
            return f"{function}({inner}{end})"
        case TimeOf(accessor, arguments):
            return f"{ACCESSORS[accessor]}({', '.join(map(show, arguments))})"
    raise TypeError(node)


def show_select(query: Select, clauses: str = "") -> str:
    """``clauses``: what stands between the head and WHERE."""
    head = " ".join(v if e is None else f"({show(e)} AS {v})" for v, e in query.head)
    text = (
        f"SELECT {'DISTINCT ' if query.distinct else ''}{head} {clauses}WHERE {show(query.where)}"
    )
    if query.keys:
        shown = [
            f"({show(e)} AS {alias})" if alias else (e if isinstance(e, str) else f"({show(e)})")
            for e, alias in query.keys
        ]
        text += f" GROUP BY {' '.join(shown)}"
    text += "".join(f" HAVING ({show(condition)})" for condition in query.having)
    if query.order:
        keys = [f"{'DESC' if down else 'ASC'}({show(e)})" for e, down in query.order]
        text += f" ORDER BY {' '.join(keys)}"
    if query.limit is not None:
        text += f" LIMIT {query.limit}"
    return text + (f" OFFSET {query.offset}" if query.offset else "")


def show_query(query: Select | Construct | Ask, clauses: str = "") -> str:
    match query:
        case Select():
            return show_select(query, clauses)
        case Construct(template, where):
            return f"CONSTRUCT {{ {' '.join(map(show, template))} }} {clauses}WHERE {show(where)}"
        case Ask(where):
            return f"ASK {clauses}WHERE {show(where)}"
    raise TypeError(query)
