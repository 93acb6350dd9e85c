"""Continuous queries by their definition: windows as set comprehensions, solutions by nested loops.

Written from SPEC §4-5 and SPARQL 1.1, slow and obvious. It shares nothing with the evaluator.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction

from pyoxigraph import Literal, NamedNode

XSD = "http://www.w3.org/2001/XMLSchema#"
RDF_TYPE = NamedNode("http://www.w3.org/1999/02/22-rdf-syntax-ns#type")
SUB_CLASS = NamedNode("http://www.w3.org/2000/01/rdf-schema#subClassOf")


@dataclass(frozen=True)
class Element:
    """A timed triple; ``sort`` is what the annotation of its row says of the subject."""

    time: int
    subject: object
    predicate: NamedNode
    object: object
    sort: NamedNode | None = None
    valid: int = 0

    def __str__(self) -> str:
        told = f" (a {self.sort})" if self.sort else ""
        return f"{self.time}: {self.subject} {self.predicate} {self.object}{told}"


@dataclass(frozen=True)
class Spec:
    """A query as data. Variables are strings ``"?x"``; a filter is ``(left, operator, right)``.

    ``aggregates``: ``(alias, function, variable or "*")``; with them ``keys`` are grouped by.
    ``head``: variables for SELECT, triples for CONSTRUCT, None for ASK.
    """

    patterns: tuple
    filters: tuple = ()
    keys: tuple[str, ...] = ()
    aggregates: tuple = ()
    having: tuple = ()
    head: tuple | None = ()
    construct: bool = False
    bindings: dict = field(default_factory=dict)


def windows(
    elements: Sequence[Element], range: int, step: int, origin: int = 0, bounds: str = "(]"
) -> Iterator[tuple[int, list[Element]]]:
    """Every window with content: its end, and its elements by time."""
    times = [element.time for element in elements]
    if not times:
        return
    first = origin + (min(times) - origin) // step * step - step
    last = max(times) + range + 2 * step
    for end in iter_ends(first, last, step):
        if bounds == "(]":
            content = [e for e in elements if end - range < e.time <= end]
        else:
            content = [e for e in elements if end - range <= e.time < end]
        if content:
            yield end, sorted(content, key=lambda e: e.time)


def iter_ends(first: int, last: int, step: int) -> Iterator[int]:
    end = first
    while end <= last:
        yield end
        end += step


def answer(spec: Spec, content: Iterable[Element], static: Sequence[tuple], semantics: str):
    """The result of the query over one window: list of dicts, list of triples, or a bool."""
    triples = [(e.subject, e.predicate, e.object) for e in content if e.predicate != RDF_TYPE]
    triples += [t for t in static if t[1] != RDF_TYPE]
    if semantics == "set":
        triples = list(dict.fromkeys(triples))
    types = {(s, o) for s, p, o in static if p == RDF_TYPE}
    types |= {(e.subject, e.object) for e in content if e.predicate == RDF_TYPE}
    for element in content:
        if element.sort is not None:
            types |= {(element.subject, sort) for sort in closure(element.sort, static)}
    triples += [(s, RDF_TYPE, o) for s, o in types]
    solutions = [dict(spec.bindings)]
    for pattern in spec.patterns:
        solutions = [
            extended
            for solution in solutions
            for triple in triples
            if (extended := match(pattern, triple, solution)) is not None
        ]
    for condition in spec.filters:
        solutions = [solution for solution in solutions if test(condition, solution) is True]
    if spec.aggregates:
        solutions = [
            s for s in grouped(spec, solutions) if all(test(c, s) is True for c in spec.having)
        ]
    if spec.head is None:
        return bool(solutions)
    if spec.construct:
        made = {}
        for solution in solutions:
            for template in spec.head:
                triple = tuple(solution.get(t) if isinstance(t, str) else t for t in template)
                if None not in triple and isinstance(triple[0], NamedNode):
                    made[triple] = None
        return list(made)
    return [{v: s[v] for v in spec.head if s.get(v) is not None} for s in solutions]


def closure(sort: NamedNode, static: Sequence[tuple]) -> set[NamedNode]:
    """The sort and all its super-sorts by the static side."""
    reached = {sort}
    while True:
        more = {o for s, p, o in static if p == SUB_CLASS and s in reached} - reached
        if not more:
            return reached
        reached |= more


def match(pattern, triple, solution):
    extended = dict(solution)
    for position, term in zip(pattern, triple, strict=True):
        if isinstance(position, str):
            if extended.setdefault(position, term) != term:
                return None
        elif position != term:
            return None
    return extended


def number(term) -> tuple[str, Fraction] | None:
    """The datatype's local name and the exact value of a number."""
    if isinstance(term, Literal) and term.datatype.value.startswith(XSD):
        name = term.datatype.value.removeprefix(XSD)
        if name in ("integer", "decimal", "double", "float"):
            return name, Fraction(term.value)
    return None


ORDER = {
    "=": lambda a, b: a == b,
    "!=": lambda a, b: a != b,
    "<": lambda a, b: a < b,
    "<=": lambda a, b: a <= b,
    ">": lambda a, b: a > b,
    ">=": lambda a, b: a >= b,
}


def test(condition, solution):
    """Three-valued: True, False, or None for an error."""
    left, operator, right = condition
    if operator in ("&&", "||"):
        a, b = test(left, solution), test(right, solution)
        decisive = operator == "||"
        if a is decisive or b is decisive:
            return decisive
        return None if a is None or b is None else not decisive
    if operator == "!":
        value = test(left, solution)
        return None if value is None else not value
    a = solution.get(left) if isinstance(left, str) else left
    b = solution.get(right) if isinstance(right, str) else right
    if a is None or b is None:
        return None
    x, y = number(a), number(b)
    if x and y:
        return ORDER[operator](x[1], y[1])
    if operator in ("=", "!="):
        return (a == b) == (operator == "=")
    return None


def grouped(spec: Spec, solutions: list[dict]) -> list[dict]:
    groups: dict[tuple, list[dict]] = {}
    keys = (*spec.keys, *spec.bindings)
    for solution in solutions:
        groups.setdefault(tuple(solution.get(k) for k in keys), []).append(solution)
    if not keys and not groups:
        groups[()] = []
    found = []
    for key, members in groups.items():
        row = {k: v for k, v in zip(keys, key, strict=True) if v is not None}
        for alias, function, variable in spec.aggregates:
            terms = [None if variable == "*" else m.get(variable) for m in members]
            value = aggregate(function, terms, variable == "*")
            if value is not None:
                row[alias] = value
        found.append(row)
    return found


RANK = ["integer", "decimal", "float", "double"]


def aggregate(function: str, terms: list, star: bool):
    if function == "COUNT":
        return literal("integer", Fraction(len(terms)))
    numbers = [number(term) for term in terms]
    if None in numbers:
        return None
    if not numbers:
        return literal("integer", Fraction(0)) if function in ("SUM", "AVG") else None
    kind = max((n[0] for n in numbers), key=RANK.index)
    if function in ("MIN", "MAX"):
        best = (min if function == "MIN" else max)(n[1] for n in numbers)
        return next(t for t, n in zip(terms, numbers, strict=True) if n[1] == best)
    total = sum(n[1] for n in numbers)
    if function == "SUM":
        return literal(kind, total)
    return literal("decimal" if kind == "integer" else kind, total / len(numbers))


def literal(kind: str, value: Fraction) -> Literal:
    text = str(int(value)) if kind == "integer" else repr(float(value))
    return Literal(text, datatype=NamedNode(XSD + kind))
