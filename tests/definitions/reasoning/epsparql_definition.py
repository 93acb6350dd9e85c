"""The solutions of an EP-SPARQL query by their definition: the algebra over all samples.

It reads the AST of the text, and none of the code that checks, compiles or evaluates one. A
solution is a mapping with an interval (Anicic et al., WWW 2011). Values carry their kind.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from dyknow.languages.epsparql import ast
from dyknow.sparql import ast as sparql
from dyknow.streams.time import parse_duration, parse_time

Value = tuple[str, Any]
"""Kind and value: objects by their IRIs, times and durations in ns."""
COMPARISONS: dict[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "=": operator.eq,
    "!=": operator.ne,
}


Fact = tuple[Value, str, Value, str | None]
"""A static triple: subject, predicate (IRI), object, graph."""


class NoValue(Exception):
    """An expression has no value: SPARQL's error."""


@dataclass(frozen=True)
class Sample:
    """A sample of a feature (IRI) of an object (IRI)."""

    number: int
    feature: str
    object: str
    value: Value
    start: int
    end: int


@dataclass(frozen=True)
class Solution:
    """``samples``: their numbers, in order of the text; ``due``: from when on (ns) no new sample
    excludes it; before its last sample that means nothing."""

    values: Mapping[str, Value]
    start: float
    end: float
    samples: tuple[int, ...]
    due: float = -math.inf

    def joined(self, other: Solution) -> Solution | None:
        """Both together; None if a variable has two values."""
        if any(other.values.get(name, value) != value for name, value in self.values.items()):
            return None
        return Solution(
            {**self.values, **other.values},
            min(self.start, other.start),
            max(self.end, other.end),
            self.samples + other.samples,
            max(self.due, other.due),
        )


@dataclass(frozen=True)
class Definition:
    """The meaning of a query over ``samples``. ``static`` triples have a graph, or None."""

    query: ast.EpSparqlQuery
    samples: Sequence[Sample]
    arguments: Mapping[str, Value]
    static: Sequence[Fact] = ()

    def solutions(self) -> list[Solution]:
        """All solutions, without those that last too long."""
        return self.group(self.query.where)

    def results(self) -> list[tuple[Solution, dict[str, Value | None]]]:
        """Each solution with the values of the head; None: no value."""
        found = []
        for each in self.solutions():
            row: dict[str, Value | None] = {}
            for item in self.query.projection or ():
                try:
                    row[item.variable.value] = self.value(item.expression or item.variable, each)
                except NoValue:
                    row[item.variable.value] = None
            found.append((each, row))
        return found

    @property
    def within(self) -> float:
        """The longest that a solution may last: by WITHIN, or by a condition of the whole."""
        bounds = [math.inf if self.query.within is None else self.query.within]
        for part in self.query.where.parts:
            if isinstance(part, ast.Filter):
                bounds += bounds_of(part.condition, is_negated=False)
        return min(bounds)

    # -- groups --------------------------------------------------------------------------------

    def group(self, group: ast.Group) -> list[Solution]:
        found = [Solution({}, math.inf, -math.inf, ())]
        for part in group.parts:
            if isinstance(part, sparql.Triples):
                for triple in part.triples:
                    found = self.together(found, self.of_triple(triple))
            elif isinstance(part, ast.Graph):
                for triple in part.triples:
                    found = self.together(found, self.of_static(triple, part.name.value))
            elif isinstance(part, ast.Group | ast.Operation):
                found = self.together(found, self.operand(part))
        for part in group.parts:
            if isinstance(part, ast.Bind):
                found = [new for each in found for new in self.bound(part, each)]
            elif isinstance(part, ast.Filter):
                found = [each for each in found if self.holds(part.condition, each) is True]
        return found

    def operand(self, part: ast.Group | ast.Operation) -> list[Solution]:
        if isinstance(part, ast.Group):
            return self.group(part)
        left, right = self.operand(part.left), self.group(part.right)
        if part.operator == "UNION":
            return left + right
        pairs = [
            (i, j, both)
            for i, a in enumerate(left)
            for j, b in enumerate(right)
            if follows(part.operator, a, b) and (both := self.pair(a, b)) is not None
        ]
        found = [both for _, _, both in pairs]
        if part.operator == "OPTIONALSEQ":
            used = {j for _, j, _ in pairs}
            found += [each for j, each in enumerate(right) if j not in used]
        elif part.operator == "EQUALSOPTIONAL":
            used = {i for i, _, _ in pairs}
            found += [
                replace(each, due=max(each.due, each.end + 1))
                for i, each in enumerate(left)
                if i not in used
            ]
        return found

    def together(self, left: list[Solution], right: list[Solution]) -> list[Solution]:
        pairs = (self.pair(a, b) for a in left for b in right)
        return [each for each in pairs if each is not None]

    def pair(self, a: Solution, b: Solution) -> Solution | None:
        both = a.joined(b)
        return None if both is None or both.end - both.start > self.within else both

    def of_static(self, triple: sparql.Triple, graph: str | None) -> list[Solution]:
        """The solutions of a static triple, which have no time."""
        return [
            Solution(values, math.inf, -math.inf, ())
            for subject, predicate, object, where in self.static
            if predicate == triple.predicate.value and where == graph
            for values in [self.fitted(triple, subject, object)]
            if values is not None
        ]

    def of_triple(self, triple: sparql.Triple) -> list[Solution]:
        if any(predicate == triple.predicate.value for _, predicate, _, _ in self.static):
            return self.of_static(triple, None)
        found = []
        for each in self.samples:
            if each.feature != triple.predicate.value or each.end - each.start > self.within:
                continue
            values = self.fitted(triple, ("object", each.object), each.value)
            if values is not None:
                found.append(Solution(values, each.start, each.end, (each.number,)))
        return found

    def fitted(
        self, triple: sparql.Triple, subject: Value, object: Value
    ) -> dict[str, Value] | None:
        """The values of the variables of a triple pattern; None if it does not fit."""
        values: dict[str, Value] = {}
        for term, value in ((triple.subject, subject), (triple.object, object)):
            name = self.name(term)
            wanted = self.constant(term) if name is None else values.setdefault(name, value)
            if wanted != value:
                return None
        return values

    def name(self, term: Any) -> str | None:
        """The name of a variable that is not given."""
        if isinstance(term, BlankNode):
            return f"_:{term.value}"
        is_free = isinstance(term, Variable) and term.value not in self.arguments
        return term.value if is_free else None

    def constant(self, term: Any) -> Value:
        return self.arguments[term.value] if isinstance(term, Variable) else constant(term)

    def bound(self, bind: ast.Bind, solution: Solution) -> Iterator[Solution]:
        try:
            value = self.value(bind.expression, solution)
        except NoValue:
            yield solution
            return
        name = bind.variable.value
        if solution.values.get(name, value) == value:
            yield replace(solution, values={**solution.values, name: value})

    # -- expressions ---------------------------------------------------------------------------

    def holds(self, node: Any, solution: Solution) -> bool | None:
        """Whether a condition holds; None: an error."""
        match node:
            case sparql.Logical("&&", operands):
                found = [self.holds(each, solution) for each in operands]
                return False if False in found else None if None in found else True
            case sparql.Logical(_, operands):
                found = [self.holds(each, solution) for each in operands]
                return True if True in found else None if None in found else False
            case sparql.Unary("!", operand):
                inside = self.holds(operand, solution)
                return None if inside is None else not inside
            case sparql.In(operand, options, negated):
                equal = sparql.Logical(
                    "||", tuple(sparql.Comparison("=", operand, each) for each in options)
                )
                inside = self.holds(equal, solution)
                return None if inside is None else inside != negated
            case sparql.Call("BOUND", (Variable(value=name),)):
                return name in solution.values or name in self.arguments
        try:
            if isinstance(node, sparql.Comparison):
                left, right = self.value(node.left, solution), self.value(node.right, solution)
                if left[0] != right[0]:  # of static triples: those of samples are of one kind
                    return None
                return COMPARISONS[node.operator](left[1], right[1])
            return bool(self.value(node, solution)[1])
        except NoValue:
            return None

    def value(self, node: Any, solution: Solution) -> Value:
        match node:
            case Variable(value=name):
                if name in self.arguments:
                    return self.arguments[name]
                if name not in solution.values:
                    raise NoValue
                return solution.values[name]
            case NamedNode() | Literal():
                return constant(node)
            case sparql.Call(name):
                if not solution.samples:
                    raise NoValue
                times = {
                    "getDURATION": ("duration", solution.end - solution.start),
                    "getSTARTTIME": ("time", solution.start),
                    "getENDTIME": ("time", solution.end),
                }
                return times[name]
            case sparql.Unary(sign, operand):
                kind, value = self.value(operand, solution)
                return kind, -value if sign == "-" else value
            case sparql.Arithmetic(first, rest):
                found = self.value(first, solution)
                for sign, each in rest:
                    found = calculated(sign, found, self.value(each, solution))
                return found
        raise AssertionError(node)


def bounds_of(condition: Any, *, is_negated: bool) -> list[int]:
    """Each d of the conditions ``getDURATION() <= d`` that must all hold."""
    match condition:
        case sparql.Logical(sign, operands) if (sign == "&&") != is_negated:
            return [d for each in operands for d in bounds_of(each, is_negated=is_negated)]
        case sparql.Unary("!", operand):
            return bounds_of(operand, is_negated=not is_negated)
        case sparql.Comparison(sign, sparql.Call("getDURATION"), Literal(value=text)):
            less = {"<": 1, "<=": 0} if not is_negated else {">=": 1, ">": 0}
            return [parse_duration(text) - less[sign]] if sign in less else []
    return []


def follows(operator: ast.Operator, a: Solution, b: Solution) -> bool:
    if operator in ("SEQ", "OPTIONALSEQ"):
        return a.end < b.start
    return (a.start, a.end) == (b.start, b.end)


def calculated(sign: str, left: Value, right: Value) -> Value:
    kinds = left[0], right[0]
    if not {*kinds} <= {"number", "time", "duration"} or (
        "number" in kinds and kinds[0] != kinds[1]
    ):
        raise NoValue
    kind = kinds[0]
    if kinds == ("time", "time"):
        kind = "duration"
    elif "time" in kinds:
        kind = "time"
    if sign == "/" and right[1] == 0:
        raise NoValue
    function = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv}
    return kind, function[sign](left[1], right[1])


def constant(term: Any) -> Value:
    if isinstance(term, NamedNode):
        return "object", term.value
    datatype = term.datatype.value.rpartition("#")[2]
    match datatype:
        case "string":
            return "text", term.value
        case "boolean":
            return "truth", term.value in ("true", "1")
        case "dateTime":
            return "time", parse_time(term.value)
        case "duration":
            return "duration", parse_duration(term.value)
        case _:
            return "number", float(term.value)
