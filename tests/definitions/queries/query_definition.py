"""SPARQL queries over bags of timed triples by their definition: nested loops, SPARQL 1.1 §18.

Written from the recommendation and docs/explanation/semantics.md, slow and obvious; nothing of the
product is used. A solution carries the elements that its patterns matched, for ``f:timestamp``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cmp_to_key
from typing import Any

import query_ast as q
from continuous_definition import RDF_TYPE, Element, closure
from pyoxigraph import BlankNode, Literal, NamedNode
from query_values import (
    FUNCTIONS,
    Failed,
    OneOf,
    Undetermined,
    aggregate,
    boolean,
    effective,
    equal,
    literal,
    precedes,
)


@dataclass(frozen=True, eq=False)
class Fact:
    """A triple of a graph; ``time`` and ``valid`` are None unless it is from a stream."""

    subject: Any
    predicate: Any
    object: Any
    time: int | None = None
    valid: int | None = None

    @property
    def triple(self) -> tuple:
        return self.subject, self.predicate, self.object


@dataclass(frozen=True)
class Data:
    """The default graph, and the graphs of named windows."""

    default: list[Fact]
    named: Mapping[NamedNode, list[Fact]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Solution:
    terms: Mapping[str, Any]
    matched: tuple[tuple[q.Triple, Fact], ...] = ()


# --- data (docs/explanation/semantics.md, "Bag and set")


def graph(content: Iterable[Element], static: Sequence[tuple], told: Sequence[tuple], bag: bool):
    """The facts of a window with ``static`` beside it; ``told`` says which sort is under which."""
    content = list(content)
    facts = [
        Fact(e.subject, e.predicate, e.object, e.time, e.valid)
        for e in content
        if e.predicate != RDF_TYPE
    ]
    facts += [Fact(*triple) for triple in static if triple[1] != RDF_TYPE]
    if not bag:
        latest: dict[tuple, Fact] = {}
        for fact in facts:
            seen = latest.get(fact.triple)
            if seen is None or seen.time is None or (fact.time or -(10**9)) > seen.time:
                latest[fact.triple] = fact if seen is None or fact.time is not None else seen
        facts = list(latest.values())
    types = {(s, o) for s, p, o in static if p == RDF_TYPE}
    types |= {(e.subject, e.object) for e in content if e.predicate == RDF_TYPE}
    for element in content:
        if element.sort is not None:
            types |= {(element.subject, sort) for sort in closure(element.sort, told)}
    return facts + [Fact(s, RDF_TYPE, o) for s, o in types]


# --- patterns (§18.2.2, §18.5)


@dataclass(frozen=True)
class Scope:
    """Where a pattern is evaluated: the active graph of a dataset."""

    data: Data
    facts: list[Fact]


def solutions(group: q.Group, scope: Scope) -> list[Solution]:
    """The solutions of a group: its members joined in order, its filters last."""
    found = [Solution({})]
    conditions = []
    for member in group.members:
        if isinstance(member, q.Filter):
            conditions.append(member.condition)
        else:
            found = extended(found, member, scope)
    return [s for s in found if all(holds(c, s, scope) for c in conditions)]


def extended(found: list[Solution], member: Any, scope: Scope) -> list[Solution]:
    match member:
        case q.Optional(group):
            return left_join(found, group, scope)
        case q.Minus(group):
            others = solutions(group, scope)
            return [s for s in found if not any(removes(other, s) for other in others)]
        case q.Bind(expression, variable):
            return [bound(s, variable, expression, scope) for s in found]
        case q.Triple() if isinstance(member.predicate, q.PATHS):
            return join(found, path_solutions(member, scope))
        case q.Triple():
            return join(found, matches(member, scope))
    return join(found, alone(member, scope))


def alone(member: Any, scope: Scope) -> list[Solution]:
    match member:
        case q.Union(left, right):
            return solutions(left, scope) + solutions(right, scope)
        case q.Group():
            return solutions(member, scope)
        case q.Values(variables, rows):
            return [
                Solution({v: t for v, t in zip(variables, row, strict=True) if t is not None})
                for row in rows
            ]
        case q.Select():
            return [Solution(row) for row in select(member, scope)]
        case q.Named(NamedNode() as name, group):
            return solutions(group, Scope(scope.data, scope.data.named.get(name, [])))
        case q.Named(str() as variable, group):
            found = []
            for name, facts in scope.data.named.items():
                inner = solutions(group, Scope(scope.data, facts))
                found += join([Solution({variable: name})], inner)
            return found
    raise TypeError(member)


def join(left: list[Solution], right: list[Solution]) -> list[Solution]:
    return [merged(a, b) for a in left for b in right if compatible(a, b)]


def compatible(a: Solution, b: Solution) -> bool:
    return all(b.terms.get(variable, term) == term for variable, term in a.terms.items())


def merged(a: Solution, b: Solution) -> Solution:
    return Solution({**a.terms, **b.terms}, a.matched + b.matched)


def left_join(left: list[Solution], group: q.Group, scope: Scope) -> list[Solution]:
    """Filters of the group itself are conditions of the LeftJoin: they see both sides."""
    conditions = [m.condition for m in group.members if isinstance(m, q.Filter)]
    body = q.Group(*(m for m in group.members if not isinstance(m, q.Filter)))
    right = solutions(body, scope)
    found = []
    for a in left:
        both = [m for m in join([a], right) if all(holds(c, m, scope) for c in conditions)]
        found += both or [a]
    return found


def removes(other: Solution, solution: Solution) -> bool:
    return bool(other.terms.keys() & solution.terms.keys()) and compatible(other, solution)


def bound(
    solution: Solution, variable: str, expression: Any, scope: Scope, group: Any = None
) -> Solution:
    """Extend: unbound where the expression fails."""
    value = try_(expression, solution, scope, group)
    if value is None:
        return solution
    return Solution({**solution.terms, variable: value}, solution.matched)


def matches(pattern: q.Triple, scope: Scope) -> list[Solution]:
    positions = (pattern.subject, pattern.predicate, pattern.object)
    found = []
    for fact in scope.facts:
        terms = unify(positions, fact.triple)
        if terms is not None:
            found.append(Solution(terms, ((pattern, fact),)))
    return found


def unify(positions: Iterable, values: Iterable) -> dict | None:
    terms: dict[str, Any] = {}
    for position, value in zip(positions, values, strict=True):
        if isinstance(position, str):
            if terms.setdefault(position, value) != value:
                return None
        elif position != value:
            return None
    return terms


# --- paths (§18.4): pairs of nodes


def path_solutions(pattern: q.Triple, scope: Scope) -> list[Solution]:
    ends = pattern.subject, pattern.object
    constants = [end for end in ends if not isinstance(end, str)]
    found = (unify(ends, pair) for pair in pairs(pattern.predicate, scope.facts, constants))
    return [Solution(terms) for terms in found if terms is not None]


def pairs(path: Any, facts: list[Fact], constants: list) -> list[tuple]:
    """A bag of pairs; a path of no steps also joins a constant to itself."""
    match path:
        case NamedNode():
            return [(f.subject, f.object) for f in facts if f.predicate == path]
        case q.NotIn(predicates):
            return [(f.subject, f.object) for f in facts if f.predicate not in predicates]
        case q.Inverse(inner):
            return [(b, a) for a, b in pairs(inner, facts, constants)]
        case q.Alternative(first, second):
            return pairs(first, facts, constants) + pairs(second, facts, constants)
        case q.Sequence(first, second):
            right = pairs(second, facts, constants)
            return [(a, d) for a, b in pairs(first, facts, constants) for c, d in right if b == c]
        case q.Repeated(inner, sign):
            return sorted(repeated(inner, sign, facts, constants), key=str)
    raise TypeError(path)


def repeated(inner: Any, sign: str, facts: list[Fact], constants: list) -> set[tuple]:
    step = set(pairs(inner, facts, constants))
    nodes = {f.subject for f in facts} | {f.object for f in facts} | set(constants)
    none = {(node, node) for node in nodes}
    if sign == "?":
        return step | none
    reached = set(step)
    while more := {(a, d) for a, b in reached for c, d in step if b == c} - reached:
        reached |= more
    return reached | none if sign == "*" else reached


# --- expressions (§17)


def holds(condition: Any, solution: Solution, scope: Scope, group: Any = None) -> bool:
    try:
        return effective(evaluate(condition, solution, scope, group))
    except Failed:
        return False


def evaluate(
    expression: Any, solution: Solution, scope: Scope, group: list[Solution] | None = None
) -> Any:
    """The term, or Failed. ``group``: the members of the group that ``solution`` stands for."""

    def value(inner: Any) -> Any:
        return evaluate(inner, solution, scope, group)

    match expression:
        case str():
            if expression not in solution.terms:
                raise Failed
            return solution.terms[expression]
        case NamedNode() | Literal():
            return expression
        case q.Exists(inner, negated):
            found = solutions(substituted(inner, solution.terms), scope)
            return boolean(bool(found) != negated)
        case q.Aggregate():
            assert group is not None
            return over(expression, group, scope)
        case q.TimeOf():
            return time_of(expression, solution)
        case q.Call("BOUND", (variable,)):
            return boolean(not isinstance(variable, str) or variable in solution.terms)
        case q.Call("&&" | "||" as sign, (a, b)):
            return connected(sign == "||", [truth(value, a), truth(value, b)])
        case q.Call("IF", (condition, yes, no)):
            return value(yes) if effective(value(condition)) else value(no)
        case q.Call("COALESCE", arguments):
            for argument in arguments:
                try:
                    return value(argument)
                except Failed:
                    continue
            raise Failed
        case q.Call("IN" | "NOT IN" as name, (a, *rest)):
            sought = value(a)
            tests = [truth(lambda r: boolean(equal(sought, value(r))), r) for r in rest]
            found = connected(True, tests) if tests else boolean(False)
            return found if name == "IN" else FUNCTIONS["!"](found)
        case q.Call(name, arguments):
            terms = [value(argument) for argument in arguments]
            if any(isinstance(term, OneOf) for term in terms):
                raise Undetermined
            return FUNCTIONS[name](*terms)
    raise TypeError(expression)


def truth(value: Any, expression: Any) -> bool | None:
    """Three-valued: None is an error."""
    try:
        return effective(value(expression))
    except Failed:
        return None


def connected(decisive: bool, tests: list[bool | None]) -> Literal:
    """``||`` (True decides) or ``&&`` (False decides), §17.2."""
    if decisive in tests:
        return boolean(decisive)
    if None in tests:
        raise Failed
    return boolean(not decisive)


def time_of(expression: q.TimeOf, solution: Solution) -> Literal:
    arguments = expression.arguments
    times = []
    for pattern, fact in solution.matched:
        places = (pattern.subject, pattern.predicate, pattern.object)
        meant = places == arguments if len(arguments) == 3 else arguments[0] in places
        at = fact.time if expression.accessor == "timestamp" else fact.valid
        if meant and at is not None and pattern.predicate != RDF_TYPE:
            times.append(at)
    if not times:
        raise Failed
    return literal("integer", max(times))


def substituted(node: Any, terms: Mapping[str, Any]) -> Any:
    """The pattern with every variable of the solution replaced by its term (§18.6)."""
    if isinstance(node, str):
        return terms.get(node, node)
    if isinstance(node, tuple):
        return tuple(substituted(part, terms) for part in node)
    if isinstance(node, q.Call):
        return q.Call(node.name, *substituted(node.arguments, terms))
    if isinstance(node, q.Group):
        return q.Group(*substituted(node.members, terms))
    if isinstance(node, (q.Bind, q.Values, q.Select)):
        raise TypeError(f"{type(node).__name__} inside EXISTS: substitution is not defined for it")
    if isinstance(node, (q.Triple, q.Optional, q.Union, q.Minus, q.Filter, q.Exists, q.Named)):
        parts = {name: substituted(getattr(node, name), terms) for name in node.__match_args__}
        return replace(node, **parts)
    return node


# --- queries (§18.2.4)


def select(query: q.Select, scope: Scope) -> list[dict[str, Any]]:
    """The rows, in order if there is one. Undetermined where a slice is one of several."""
    found = solutions(query.where, scope)
    members: list[list[Solution] | None] = [None] * len(found)
    if q.aggregated(query):
        found, members = grouped(query.keys or (), found, scope)
    whole = []
    for solution, group in zip(found, members, strict=True):
        if not all(holds(c, solution, scope, group) for c in query.having):
            continue
        for variable, expression in query.head:
            if expression is not None:
                solution = bound(solution, variable, expression, scope, group)
        keys = [try_(expression, solution, scope, group) for expression, _ in query.order]
        whole.append((solution.terms, keys))
    rows = [({v: terms[v] for v, _ in query.head if v in terms}, keys) for terms, keys in whole]
    if query.order:
        rows = in_order(rows, [down for _, down in query.order])
    if query.distinct:
        rows = distinct(rows)
    if query.limit is not None or query.offset:
        if any(isinstance(term, OneOf) for row, _ in rows for term in row.values()):
            raise Undetermined
        end = None if query.limit is None else query.offset + query.limit
        if not total(rows):
            raise Undetermined
        rows = rows[query.offset : end]
    return [row for row, _ in rows]


def try_(expression: Any, solution: Solution, scope: Scope, group: Any = None) -> Any:
    try:
        return evaluate(expression, solution, scope, group)
    except Failed:
        return None


def grouped(keys: tuple, found: list[Solution], scope: Scope) -> tuple[list, list]:
    groups: dict[tuple, list[Solution]] = {} if keys else {(): []}
    for solution in found:
        key = tuple(try_(expression, solution, scope) for expression, _ in keys)
        groups.setdefault(key, []).append(solution)
    names = [alias or expression for expression, alias in keys]
    made = []
    for key in groups:
        terms = {n: t for n, t in zip(names, key, strict=True) if isinstance(n, str)}
        made.append(Solution({n: t for n, t in terms.items() if t is not None}))
    return made, list(groups.values())


def over(expression: q.Aggregate, group: list[Solution], scope: Scope) -> Any:
    if expression.argument == "*":
        values: list = [frozenset(s.terms.items()) for s in group]
    else:
        values = [try_(expression.argument, s, scope) for s in group]
    if expression.distinct:
        values = list(dict.fromkeys(values))
    return aggregate(expression.function, values, expression.separator)


def distinct(rows: list) -> list:
    if any(isinstance(term, OneOf) for row, _ in rows for term in row.values()):
        raise Undetermined
    return list({frozenset(row.items()): (row, keys) for row, keys in reversed(rows)}.values())[
        ::-1
    ]


def in_order(rows: list, downs: list[bool]) -> list:
    """Sorted by what the text says of order; where it says nothing, somehow."""

    def compare(one: tuple, other: tuple) -> int:
        for a, b, down in zip(one[1], other[1], downs, strict=True):
            if isinstance(a, OneOf) or isinstance(b, OneOf):
                raise Undetermined
            first, second = (b, a) if down else (a, b)
            if precedes(first, second):
                return -1
            if precedes(second, first):
                return 1
        return 0

    # A relation with gaps does not sort; `total` has the last word.
    return sorted(rows, key=cmp_to_key(compare))


def total(rows: list) -> bool:
    """Whether any two different rows have their places by the keys."""
    for i, (row, keys) in enumerate(rows):
        for other, others in rows[i + 1 :]:
            if row != other and not decided(keys, others):
                return False
    return True


def decided(keys: list, others: list) -> bool:
    for a, b in zip(keys, others, strict=True):
        if a != b:
            return precedes(a, b) is not None and (precedes(a, b) or precedes(b, a)) is True
    return False


def construct(query: q.Construct, scope: Scope) -> set[tuple]:
    """A graph; the blank nodes of the template are other ones for each solution."""
    made = set()
    for solution in solutions(query.where, scope):
        fresh: dict[BlankNode, BlankNode] = {}
        for pattern in query.template:
            triple = []
            for part in (pattern.subject, pattern.predicate, pattern.object):
                if isinstance(part, BlankNode):
                    part = fresh.setdefault(part, BlankNode())
                triple.append(solution.terms.get(part) if isinstance(part, str) else part)
            s, p, _ = triple
            if None not in triple and not isinstance(s, Literal) and isinstance(p, NamedNode):
                made.add(tuple(triple))
    return made


def answer(query: Any, data: Data) -> Iterator | list | set | bool:
    """Rows, triples or a truth value."""
    scope = Scope(data, data.default)
    match query:
        case q.Select():
            return select(query, scope)
        case q.Construct():
            return construct(query, scope)
        case q.Ask(where):
            return bool(solutions(where, scope))
    raise TypeError(query)
