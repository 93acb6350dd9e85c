"""The outputs of matches, in columns."""

from __future__ import annotations

from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from .conditions import COLUMNS, END, START
from .plan import (
    NO_VALUE,
    Aggregate,
    Arithmetic,
    ColumnType,
    Constant,
    Expression,
    Key,
    Listed,
    Output,
    PatternPlan,
    PlanError,
    Time,
    Value,
)
from .rows import Values


def output_columns(
    plan: PatternPlan, columns: tuple[str, ...], table: NDArray[np.int64], rows: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Return the plan's outputs for matches of one row an element: ``rows`` are their places in
    the table of records, shape ``(m, n)``."""
    reader = _Reader(plan, columns, table, rows)
    return {each.name: reader.output(each) for each in plan.outputs}


class _Reader:
    def __init__(
        self,
        plan: PatternPlan,
        columns: tuple[str, ...],
        table: NDArray[np.int64],
        rows: NDArray[np.int64],
    ) -> None:
        self._plan = plan
        self._places = {name: COLUMNS + i for i, name in enumerate(columns)}
        self._table = table
        self._rows = rows

    def output(self, output: Output) -> NDArray[Any]:
        if isinstance(output.value, Listed):
            raise PlanError(f"{output.name} is a list, but no event is repeated")
        return self.value(output.value)

    def value(self, expression: Expression) -> Values:
        match expression:
            case Value(element, column):
                found: NDArray[np.int64] = self._table[self._rows[:, element], self._places[column]]
                is_number = self._plan.type_of(column) is ColumnType.NUMBER
                return found.view(np.float64) if is_number else found
            case Time(elements, is_start):
                word = START if is_start else END
                times = self._table[self._rows[:, list(elements)], word]
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
            case Aggregate():
                raise PlanError("an aggregate has no place in a pattern without repetition")
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
