"""The places of a parameter in a template's body, which restrict its argument."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from enum import StrEnum
from typing import Any, Final

from pyoxigraph import Literal, NamedNode, Variable

from ..languages.object_cache import ObjectCache
from ..ontology.vocabulary import Vocabulary
from ..rdf.datatypes import NUMBERS
from ..rdf.namespaces import RDF_TYPE
from ..sparql import ast
from .patterns import patterns

_NUMERIC_CALLS: Final = ("ABS", "CEIL", "FLOOR", "ROUND", "STRLEN")
_COUNTING: Final = ("COUNT", "SUM", "AVG")
_SAME_KIND: Final = ("MIN", "MAX", "SAMPLE")


class Place(StrEnum):
    """A position that restricts its term."""

    SORT = "a sort"
    PREDICATE = "a feature"
    SUBJECT = "an object"
    NUMBER = "a number"


def is_numeric(datatype: str | None) -> bool:
    """Return whether the values of the datatype are numbers."""
    return datatype in NUMBERS


@ObjectCache
def places(query: ast.Query, vocabulary: Vocabulary) -> dict[str, frozenset[Place]]:
    """Return variable name -> its restricting positions, over the whole body.

    A variable must be a number if an operator calculates with it or compares it with a number: a
    literal, a calculation, an aggregate, or a feature with a numeric range. Cost: computed once for
    a query.
    """
    found: dict[str, set[Place]] = {}
    for pattern in patterns(query):
        _note(found, pattern.subject, Place.SUBJECT)
        _note(found, pattern.predicate, Place.PREDICATE)
        if pattern.predicate == RDF_TYPE:
            _note(found, pattern.object, Place.SORT)
    numbers = _Numbers(query, vocabulary)
    for variable in numbers.required_numbers():
        _note(found, variable, Place.NUMBER)
    return {name: frozenset(kinds) for name, kinds in found.items()}


def _note(found: dict[str, set[Place]], term: Any, place: Place) -> None:
    if isinstance(term, Variable):
        found.setdefault(term.value, set()).add(place)


class _Numbers:
    """The variables and expressions of a body that are numbers."""

    def __init__(self, query: ast.Query, vocabulary: Vocabulary) -> None:
        self._nodes = list(ast.walk(query))
        self._numbers: set[Variable] = set()
        for pattern in patterns(query):
            predicate = pattern.predicate
            info = vocabulary.feature(predicate.value) if isinstance(predicate, NamedNode) else None
            is_number = info is not None and (is_numeric(info.range) or info.unit is not None)
            if is_number and isinstance(pattern.object, Variable):
                self._numbers.add(pattern.object)
        self._spread()

    def _spread(self) -> None:
        """Propagate numbers through BIND, heads and aggregates to a fixed point."""
        named = [
            (node.variable, node.expression)
            for node in self._nodes
            if isinstance(node, ast.Bind | ast.SelectItem) and node.expression is not None
        ]
        named += [
            (node.alias, node.expression)
            for node in self._nodes
            if isinstance(node, ast.Key) and node.alias is not None
        ]
        before = -1
        while before != len(self._numbers):
            before = len(self._numbers)
            self._numbers.update(name for name, expression in named if self.is_number(expression))

    def is_number(self, expression: ast.Expression) -> bool:
        match expression:
            case Literal():
                return is_numeric(expression.datatype.value)
            case Variable():
                return expression in self._numbers
            case ast.Arithmetic() | ast.Unary("-" | "+", _):
                return True
            case ast.Call(name, _):
                return name in _NUMERIC_CALLS
            case ast.Aggregate(function, argument):
                if function in _COUNTING:
                    return True
                return function in _SAME_KIND and argument is not None and self.is_number(argument)
            case _:
                return False

    def required_numbers(self) -> Iterator[Variable]:
        """Yield the variables that must be numbers."""
        for node in self._nodes:
            for operand in self._operands(node):
                if isinstance(operand, Variable):
                    yield operand

    def _operands(self, node: Any) -> Iterable[ast.Expression]:
        match node:
            case ast.Arithmetic(first, rest):
                return [first, *(one for _, one in rest)]
            case ast.Unary("-" | "+", operand):
                return [operand]
            case ast.Comparison(_, left, right):
                found = [left] if self.is_number(right) else []
                return [*found, right] if self.is_number(left) else found
            case ast.In(operand, options, _):
                return [operand] if all(map(self.is_number, options)) else []
            case ast.Aggregate("SUM" | "AVG", argument, _, _) if argument is not None:
                return [argument]
            case _:
                return []
