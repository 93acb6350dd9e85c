"""Where a parameter stands in a template's body, and so what its argument must be."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum
from typing import Any

from rdflib import Literal, URIRef, Variable
from rdflib.namespace import RDF
from rdflib.plugins.sparql.parserutils import CompValue

from ..languages.attached import attached
from ..ontology.vocabulary import Vocabulary
from ..rdf.datatypes import NUMBERS
from .patterns import everything, patterns

_ARITHMETIC = ("AdditiveExpression", "MultiplicativeExpression", "UnaryMinus", "UnaryPlus")
_NUMERIC_CALLS = ("Builtin_ABS", "Builtin_CEIL", "Builtin_FLOOR", "Builtin_ROUND", "Builtin_STRLEN")
_COUNTING = ("Aggregate_Count", "Aggregate_Sum", "Aggregate_Avg")
_SAME_KIND = ("Aggregate_Min", "Aggregate_Max", "Aggregate_Sample")


class Place(StrEnum):
    """A position that restricts what may stand there."""

    SORT = "a sort"
    PREDICATE = "a feature"
    SUBJECT = "an object"
    NUMBER = "a number"


def is_numeric(datatype: str | None) -> bool:
    """The IRI is of a datatype whose values are numbers."""
    return datatype in NUMBERS


@attached
def places(root: CompValue, vocabulary: Vocabulary) -> dict[str, frozenset[Place]]:
    """Variable name -> the restricting positions that it stands in, over the whole body.

    A number is due where a variable is calculated with, or compared with what is a number: a
    literal, a calculation, an aggregate, a feature whose range is numeric. Cost: found once.
    """
    found: dict[str, set[Place]] = {}
    for pattern in patterns(root):
        _note(found, pattern.subject, Place.SUBJECT)
        _note(found, pattern.predicate, Place.PREDICATE)
        if pattern.predicate == RDF.type:
            _note(found, pattern.object, Place.SORT)
    numbers = _Numbers(root, vocabulary)
    for variable in numbers.demanded():
        _note(found, variable, Place.NUMBER)
    return {name: frozenset(kinds) for name, kinds in found.items()}


def _note(found: dict[str, set[Place]], term: Any, place: Place) -> None:
    if isinstance(term, Variable):
        found.setdefault(str(term), set()).add(place)


class _Numbers:
    """Which variables and expressions of a body are numbers."""

    def __init__(self, root: CompValue, vocabulary: Vocabulary) -> None:
        self._nodes = list(everything(root))
        # rdflib renames what an aggregate query takes along: SAMPLE of a variable is the variable.
        self._meant: dict[Any, Any] = {
            node.res: node.vars for node in self._nodes if node.name == "Aggregate_Sample"
        }
        self._known: set[Any] = set()
        for pattern in patterns(root):
            info = (
                vocabulary.feature(str(pattern.predicate))
                if isinstance(pattern.predicate, URIRef)
                else None
            )
            if info is not None and (is_numeric(info.range) or info.unit is not None):
                self._known.add(pattern.object)
        self._spread()

    def _spread(self) -> None:
        """Numbers through BIND and aggregates, until nothing more is known."""
        before = -1
        while before != len(self._known):
            before = len(self._known)
            for node in self._nodes:
                if (node.name == "Extend" and self.is_number(node.expr)) or (
                    node.name in _SAME_KIND and self.is_number(node.vars)
                ):
                    self._known.add(node.var if node.name == "Extend" else node.res)
                elif node.name in _COUNTING:
                    self._known.add(node.res)

    def is_number(self, expression: Any) -> bool:
        if isinstance(expression, Literal):
            return is_numeric(str(expression.datatype))
        if isinstance(expression, CompValue):
            return expression.name in (*_ARITHMETIC, *_NUMERIC_CALLS)
        return expression in self._known or self._meant.get(expression) in self._known

    def demanded(self) -> Iterable[Any]:
        """The variables that are calculated with or compared with numbers."""
        for node in self._nodes:
            if node.name in _ARITHMETIC:
                # A sign is around one operand, a sum or product around one and a list.
                rest = node.other
                operands = [node.expr, *(rest if isinstance(rest, list | tuple) else ())]
                yield from map(self._variable, operands)
            elif node.name == "RelationalExpression":
                yield from map(self._variable, self._compared(node))
            elif node.name in ("Aggregate_Sum", "Aggregate_Avg"):
                yield self._variable(node.vars)

    def _compared(self, node: CompValue) -> list[Any]:
        left, right = node.expr, node.other
        if isinstance(right, list | tuple):  # IN
            return [left] if all(self.is_number(item) for item in right) else []
        operands = []
        if self.is_number(right):
            operands.append(left)
        if self.is_number(left):
            operands.append(right)
        return operands

    def _variable(self, expression: Any) -> Any:
        if isinstance(expression, Variable):
            return self._meant.get(expression, expression)
        return None
