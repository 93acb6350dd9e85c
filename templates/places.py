"""Where a parameter stands in a template's body, and so what its argument must be."""

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
    """A position that restricts what may stand there."""

    SORT = "a sort"
    PREDICATE = "a feature"
    SUBJECT = "an object"
    NUMBER = "a number"


def is_numeric(datatype: str | None) -> bool:
    """The IRI is of a datatype whose values are numbers."""
    return datatype in NUMBERS


@ObjectCache
def places(query: ast.Query, vocabulary: Vocabulary) -> dict[str, frozenset[Place]]:
    """Variable name -> the restricting positions that it stands in, over the whole body.

    A number is due where a variable is calculated with, or compared with what is a number: a
    literal, a calculation, an aggregate, a feature whose range is numeric. Cost: found once.
    """
    found: dict[str, set[Place]] = {}
    for pattern in patterns(query):
        _note(found, pattern.subject, Place.SUBJECT)
        _note(found, pattern.predicate, Place.PREDICATE)
        if pattern.predicate == RDF_TYPE:
            _note(found, pattern.object, Place.SORT)
    numbers = _Numbers(query, vocabulary)
    for variable in numbers.demanded():
        _note(found, variable, Place.NUMBER)
    return {name: frozenset(kinds) for name, kinds in found.items()}


def _note(found: dict[str, set[Place]], term: Any, place: Place) -> None:
    if isinstance(term, Variable):
        found.setdefault(term.value, set()).add(place)


class _Numbers:
    """Which variables and expressions of a body are numbers."""

    def __init__(self, query: ast.Query, vocabulary: Vocabulary) -> None:
        self._nodes = list(ast.walk(query))
        self._known: set[Variable] = set()
        for pattern in patterns(query):
            predicate = pattern.predicate
            info = vocabulary.feature(predicate.value) if isinstance(predicate, NamedNode) else None
            is_number = info is not None and (is_numeric(info.range) or info.unit is not None)
            if is_number and isinstance(pattern.object, Variable):
                self._known.add(pattern.object)
        self._spread()

    def _spread(self) -> None:
        """Numbers through BIND, heads and aggregates, until nothing more is known."""
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
        while before != len(self._known):
            before = len(self._known)
            self._known.update(name for name, expression in named if self.is_number(expression))

    def is_number(self, expression: ast.Expression) -> bool:
        match expression:
            case Literal():
                return is_numeric(expression.datatype.value)
            case Variable():
                return expression in self._known
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

    def demanded(self) -> Iterator[Variable]:
        """The variables that are calculated with or compared with numbers."""
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
