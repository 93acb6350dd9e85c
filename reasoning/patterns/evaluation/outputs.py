"""The outputs of matches, in columns."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from ..plans.plan import (
    NO_VALUE,
    Aggregate,
    Arithmetic,
    ColumnType,
    Constant,
    Expression,
    Function,
    Key,
    Listed,
    Output,
    PatternPlan,
    PlanError,
    Position,
    Time,
    Value,
)
from ..plans.rows import Values
from .conditions import COLUMNS, END, START

Integers = NDArray[np.int64]


def output_columns(
    plan: PatternPlan,
    columns: tuple[str, ...],
    table: Integers,
    rows: Integers,
    repetition: Repetition | None = None,
) -> dict[str, NDArray[Any]]:
    """Return the plan's outputs for matches: ``rows`` are the places of each element's first row in
    the table of records, shape ``(m, n)``; ``repetition`` has what Kleene elements have beside."""
    reader = _Reader(plan, columns, table, rows, repetition)
    return {each.name: reader.output(each) for each in plan.outputs}


class Repetition(ABC):
    """What matches have of their Kleene elements."""

    @property
    @abstractmethod
    def last_rows(self) -> Integers:
        """The places of the last row of each element, shape ``(m, n)``."""

    @abstractmethod
    def aggregate(self, element: int, word: int | None, function: Function) -> Values:
        """An aggregate over the rows of an element; ``word``: that of the column."""

    @abstractmethod
    def rows(self, element: int) -> list[Integers]:
        """The places of all rows of an element, an array a match."""


class _Reader:
    def __init__(
        self,
        plan: PatternPlan,
        columns: tuple[str, ...],
        table: Integers,
        rows: Integers,
        repetition: Repetition | None,
    ) -> None:
        self._plan = plan
        self._places = {name: COLUMNS + i for i, name in enumerate(columns)}
        self._table = table
        self._rows = rows
        self._last_rows = rows if repetition is None else repetition.last_rows
        self._repetition = repetition

    def output(self, output: Output) -> NDArray[Any]:
        match output.value, self._repetition:
            case Listed(element, column), Repetition() as repetition:
                lists = np.empty(len(self._rows), object)
                for i, rows in enumerate(repetition.rows(element)):
                    lists[i] = self.column(rows, column)
                return lists
            case Listed(), _:
                raise PlanError(f"{output.name} is a list, but no event is repeated")
            case expression, _:
                return self.value(expression)

    def column(self, rows: Integers, column: str) -> Values:
        found: Integers = self._table[rows, self._places[column]]
        is_number = self._plan.type_of(column) is ColumnType.NUMBER
        return found.view(np.float64) if is_number else found

    def value(self, expression: Expression) -> Values:
        match expression:
            case Value(element, column, position):
                rows = self._last_rows if position is Position.LAST else self._rows
                return self.column(rows[:, element], column)
            case Time(elements, is_start):
                word = START if is_start else END
                rows = self._rows if is_start else self._last_rows
                times = self._table[rows[:, list(elements)], word]
                found = times.min(axis=1) if is_start else times.max(axis=1)
                return np.asarray(found, np.int64)
            case Constant(value):
                if isinstance(value, int):
                    return np.full(len(self._rows), value, np.int64)
                return np.full(len(self._rows), value, np.float64)
            case Arithmetic(operator, left, right):
                a, b = self.value(left), self.value(right)
                if self._plan.is_integer(expression):
                    return _of_integers(operator, a, b)
                return _of_numbers(operator, _as_numbers(a), _as_numbers(b))
            case Key():
                raise PlanError(f"{expression.text} has no number yet")
            case Aggregate(function, element, aggregated):
                if self._repetition is None:
                    raise PlanError("an aggregate has no place in a pattern without repetition")
                place = None if aggregated is None else self._places[aggregated]
                return self._repetition.aggregate(element, place, function)
            case _:
                assert_never(expression)


def _of_integers(operator: str, a: Values, b: Values) -> Values:
    known = (a != NO_VALUE) & (b != NO_VALUE)
    match operator:
        case "+":
            found = a + b
        case "-":
            found = a - b
        case _:
            found = a * b
    return np.where(known, found, NO_VALUE)


def _of_numbers(
    operator: str, a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    with np.errstate(all="ignore"):
        match operator:
            case "+":
                return a + b
            case "-":
                return a - b
            case "*":
                return a * b
            case "/":
                return np.where(b == 0, np.nan, a / b)
            case _:
                return np.where(b == 0, np.nan, np.fmod(a, b))


def _as_numbers(values: Values) -> NDArray[np.float64]:
    if values.dtype == np.float64:
        return values.astype(np.float64, copy=False)
    return np.where(values == NO_VALUE, np.nan, values.astype(np.float64))
