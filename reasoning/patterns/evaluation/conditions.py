"""Conditions of a plan as arrays that the compiled loops read, and the function that tests one.

A row is a record of 64-bit words in a table (`store`): end, start, number, then the columns of the
plan; the same table read as floats gives the numbers. In a plan of n elements ``bound[e]`` is the
place of element e's row, ``bound[n]`` that of the probe's or the element's own row (`OWN`). Of a
Kleene element ``bound[e]`` is the row ``a[i]``, ``bound[n + 1 + e]`` the first one, and
``bound[2n + 1 + e]`` the last one, which is ``a[i-1]`` while a row is taken. ``bound[3n + 1]`` is a
row whose words are the aggregates of the plan.

A comparison of one value with one value or constant is tested at once. Any other condition is a
program in postfix notation, on a stack of integers and one of floats.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, Final, assert_never

import numpy as np
from numpy.typing import NDArray

from ..plans.plan import (
    NO_VALUE,
    OPERATORS,
    OWN,
    Aggregate,
    Arithmetic,
    ColumnType,
    Condition,
    Constant,
    Expression,
    Key,
    PatternPlan,
    PlanError,
    Position,
    Time,
    Value,
)

END, START, NUMBER, COLUMNS = range(4)
"""The words of a record; its columns begin at `COLUMNS`."""

# A condition: its form and operator, then either two values (element, column, whether it is a
# number) and an integer to add, or the program's first and last instruction.
FORM, OPERATOR, LEFT, LEFT_COLUMN, LEFT_NUMBER, RIGHT, RIGHT_COLUMN, RIGHT_NUMBER, ADDED = range(9)
FIRST, LAST = LEFT, RIGHT
INTEGERS, NUMBERS, INTEGER_PROGRAM, NUMBER_PROGRAM = range(4)
"""The forms: whether integers or floats are compared, and whether by a program."""
NOTHING: Final = -2
"""In place of an element: the right side is a constant."""
# The instructions of a program: code, element, column; of a Time the elements as bits.
PUSH_INTEGER, PUSH_NUMBER, PUSH_EARLIEST, PUSH_LATEST, INTEGER, FLOAT, TO_FLOAT = range(7)
ADD_INTEGERS, SUBTRACT_INTEGERS, MULTIPLY_INTEGERS, ADD, SUBTRACT, MULTIPLY, DIVIDE, REMAINDER = (
    range(7, 15)
)
STACK: Final = 32
"""The greatest depth of a program."""
_MIRRORED: Final = {"<": ">", "<=": ">=", ">": "<", ">=": "<=", "=": "=", "!=": "!="}
_CODES: Final = {"+": ADD, "-": SUBTRACT, "*": MULTIPLY, "/": DIVIDE, "%": REMAINDER}
_INTEGER_CODES: Final = {"+": ADD_INTEGERS, "-": SUBTRACT_INTEGERS, "*": MULTIPLY_INTEGERS}


@dataclass(frozen=True, slots=True)
class ConditionArrays:
    """All conditions of a plan. ``factors``: factor and summand of the right value."""

    conditions: NDArray[np.int64]
    factors: NDArray[np.float64]
    code: NDArray[np.int64]
    constants: NDArray[np.float64]


@dataclass(slots=True)
class ConditionPacker:
    """Collects conditions; each gets a number."""

    plan: PatternPlan
    places: dict[str, int]
    """The word of each column in a record."""
    aggregates: dict[Aggregate, int] = field(default_factory=dict)
    """The word of each aggregate in the row of aggregates."""
    _conditions: list[list[int]] = field(default_factory=list)
    _factors: list[tuple[float, float]] = field(default_factory=list)
    _code: list[tuple[int, int, int]] = field(default_factory=list)
    _constants: list[float] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self._conditions)

    def extend(self, conditions: Iterable[Condition]) -> tuple[int, int]:
        """Add conditions; return the number of the first and the one after the last."""
        first = len(self)
        for each in conditions:
            self._add(each)
        return first, len(self)

    def slot(self, element: int, position: Position = Position.EACH) -> int:
        """The place in ``bound`` of a row of an element."""
        count = len(self.plan.elements)
        if element == OWN:
            return count
        if position is Position.EACH or not self.plan.elements[element].is_kleene:
            return element
        return element + (count if position is Position.FIRST else 2 * count) + 1

    def slot_at(self, element: int, *, is_start: bool) -> int:
        """The place in ``bound`` of the row with which an element starts or ends."""
        return self.slot(element, Position.FIRST if is_start else Position.LAST)

    def aggregate(self, aggregate: Aggregate) -> int:
        """The word of an aggregate, over all rows taken so far."""
        whole = replace(aggregate, is_before=False)
        return self.aggregates.setdefault(whole, len(self.aggregates))

    def arrays(self) -> ConditionArrays:
        """All conditions added so far."""
        return ConditionArrays(
            np.array(self._conditions, np.int64).reshape(-1, ADDED + 1),
            np.array(self._factors, np.float64).reshape(-1, 2),
            np.array(self._code, np.int64).reshape(-1, 3),
            np.array(self._constants, np.float64),
        )

    def _add(self, condition: Condition) -> None:
        if not isinstance(condition.left, Value | Time):
            condition = Condition(_MIRRORED[condition.operator], condition.right, condition.left)
        is_integer = all(map(self.plan.is_integer, (condition.left, condition.right)))
        operator = OPERATORS.index(condition.operator)
        right = self._linear(condition.right, is_integer)
        if right is None or not isinstance(condition.left, Value | Time):
            self._add_program(condition, operator, is_integer)
            return
        value, factor, summand = right
        form = INTEGERS if is_integer else NUMBERS
        sides = [*self._operand(condition.left), *self._operand(value)]
        if NO_VALUE in sides:
            self._add_program(condition, operator, is_integer)
            return
        added = int(summand) if is_integer else 0
        self._conditions.append([form, operator, *sides, added])
        self._factors.append((float(factor), float(summand)))

    def _linear(
        self, side: Expression, is_integer: bool
    ) -> tuple[Value | Time | None, int | float, int | float] | None:
        """``factor * value + summand``, computed just as it is written; None: another form."""
        match side:
            case Value() | Time():
                return side, 1, 0
            case Constant(value):
                return None, 0, value
            case Arithmetic("*", Constant(factor), Value() as value) if not is_integer:
                return value, factor, 0
            case Arithmetic("*", Value() as value, Constant(factor)) if not is_integer:
                return value, factor, 0
            case Arithmetic("+" | "-" as sign, Value() | Time() as value, Constant(summand)):
                return value, 1, summand if sign == "+" else -summand
        return None

    def _operand(self, value: Value | Time | None) -> tuple[int, int, int]:
        """The element, the word, whether it is a number; `NO_VALUE` if it is several rows'."""
        match value:
            case None:
                return NOTHING, 0, 0
            case Value(element, column, position):
                is_number = self.plan.type_of(column) is ColumnType.NUMBER
                return self.slot(element, position), self.places[column], int(is_number)
            case Time((element,), is_start):
                return self.slot_at(element, is_start=is_start), START if is_start else END, 0
            case Time():
                return NO_VALUE, 0, 0
            case _:
                assert_never(value)

    def _add_program(self, condition: Condition, operator: int, is_integer: bool) -> None:
        first = len(self._code)
        depth = 0
        for side in (condition.left, condition.right):
            depth = max(depth, self._push(side))
            if not is_integer and self.plan.is_integer(side):
                self._emit(TO_FLOAT)
        if depth + 1 > STACK:
            raise PlanError("a calculation is nested too deeply", f"at most {STACK} levels")
        form = INTEGER_PROGRAM if is_integer else NUMBER_PROGRAM
        self._conditions.append([form, operator, first, 0, 0, len(self._code), 0, 0, 0])
        self._factors.append((0.0, 0.0))

    def _emit(self, code: int, element: int = 0, column: int = 0, constant: float = 0.0) -> None:
        self._code.append((code, element, column))
        self._constants.append(constant)

    def _push(self, expression: Expression) -> int:
        """Add the instructions that push a value; return the depth of the stack they need."""
        match expression:
            case Constant(int() as value):
                self._emit(INTEGER, value)
                return 1
            case Constant(value):
                self._emit(FLOAT, constant=value)
                return 1
            case Value(element, column, position):
                is_number = self.plan.type_of(column) is ColumnType.NUMBER
                code = PUSH_NUMBER if is_number else PUSH_INTEGER
                self._emit(code, self.slot(element, position), self.places[column])
                return 1
            case Time(elements, is_start):
                bits = sum(1 << self.slot_at(each, is_start=is_start) for each in set(elements))
                self._emit(PUSH_EARLIEST if is_start else PUSH_LATEST, bits)
                return 1
            case Arithmetic(operator, left, right):
                is_integer = self.plan.is_integer(expression)
                depth = 0
                for i, side in enumerate((left, right)):
                    depth = max(depth, i + self._push(side))
                    if not is_integer and self.plan.is_integer(side):
                        self._emit(TO_FLOAT)
                self._emit(_INTEGER_CODES[operator] if is_integer else _CODES[operator])
                return depth
            case Key():
                raise PlanError(f"{expression.text} has no number yet")
            case Aggregate():
                code = PUSH_INTEGER if self.plan.is_integer(expression) else PUSH_NUMBER
                row = 3 * len(self.plan.elements) + 1
                self._emit(code, row, self.aggregate(expression))
                return 1
            case _:
                assert_never(expression)


# -- in the compiled loops -------------------------------------------------------------------


def compares(operator: int, left: Any, right: Any) -> Any:
    """Whether ``left operator right`` holds; the operator is a place in `OPERATORS`."""
    if operator == 0:
        return left < right
    if operator == 1:
        return left <= right
    if operator == 2:
        return left > right
    if operator == 3:
        return left >= right
    if operator == 4:
        return left == right
    return left != right


def holds(
    which: int,
    bound: Any,
    table: Any,
    floats: Any,
    conditions: Any,
    factors: Any,
    code: Any,
    constants: Any,
    integers: Any,
    numbers: Any,
) -> Any:
    """Whether a condition holds of the rows that are bound; ``integers`` and ``numbers`` are the
    stacks."""
    form, operator = conditions[which, FORM], conditions[which, OPERATOR]
    if form == INTEGERS:
        left = table[bound[conditions[which, LEFT]], conditions[which, LEFT_COLUMN]]
        right = conditions[which, ADDED]
        if conditions[which, RIGHT] != NOTHING:
            value = table[bound[conditions[which, RIGHT]], conditions[which, RIGHT_COLUMN]]
            if value == NO_VALUE:
                return False
            right += value
        return left != NO_VALUE and compares(operator, left, right)
    if form == NUMBERS:
        x = number_at(
            table,
            floats,
            bound[conditions[which, LEFT]],
            conditions[which, LEFT_COLUMN],
            conditions[which, LEFT_NUMBER],
        )
        y = factors[which, 1]
        if conditions[which, RIGHT] != NOTHING:
            value = number_at(
                table,
                floats,
                bound[conditions[which, RIGHT]],
                conditions[which, RIGHT_COLUMN],
                conditions[which, RIGHT_NUMBER],
            )
            y += factors[which, 0] * value
        return x == x and y == y and compares(operator, x, y)
    top = 0
    for at in range(conditions[which, FIRST], conditions[which, LAST]):
        do = code[at, 0]
        if do <= PUSH_NUMBER:
            row = bound[code[at, 1]]
            if do == PUSH_NUMBER:
                numbers[top] = floats[row, code[at, 2]]
            else:
                integers[top] = table[row, code[at, 2]]
                if integers[top] == NO_VALUE:
                    return False
            top += 1
        elif do == INTEGER:
            integers[top] = code[at, 1]
            top += 1
        elif do == FLOAT:
            numbers[top] = constants[at]
            top += 1
        elif do <= PUSH_LATEST:
            is_first, e = True, 0
            while code[at, 1] >> e:
                if (code[at, 1] >> e) & 1:
                    time = table[bound[e], START if do == PUSH_EARLIEST else END]
                    is_better = (
                        time < integers[top] if do == PUSH_EARLIEST else time > integers[top]
                    )
                    if is_first or is_better:
                        integers[top] = time
                    is_first = False
                e += 1
            top += 1
        elif do == TO_FLOAT:
            numbers[top - 1] = float(integers[top - 1])
        else:
            top -= 1
            if do == ADD_INTEGERS:
                integers[top - 1] += integers[top]
            elif do == SUBTRACT_INTEGERS:
                integers[top - 1] -= integers[top]
            elif do == MULTIPLY_INTEGERS:
                integers[top - 1] *= integers[top]
            elif do == ADD:
                numbers[top - 1] += numbers[top]
            elif do == SUBTRACT:
                numbers[top - 1] -= numbers[top]
            elif do == MULTIPLY:
                numbers[top - 1] *= numbers[top]
            elif numbers[top] == 0.0:
                return False
            elif do == DIVIDE:
                numbers[top - 1] /= numbers[top]
            else:
                numbers[top - 1] = np.fmod(numbers[top - 1], numbers[top])
    if form == INTEGER_PROGRAM:
        return compares(operator, integers[0], integers[1])
    return (
        numbers[0] == numbers[0]
        and numbers[1] == numbers[1]
        and (compares(operator, numbers[0], numbers[1]))
    )


def number_at(table: Any, floats: Any, row: int, column: int, is_number: int) -> Any:
    """A value as a float; NaN if it is missing."""
    if is_number:
        return floats[row, column]
    value = table[row, column]
    return np.nan if value == NO_VALUE else float(value)
