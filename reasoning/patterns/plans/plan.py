"""Pattern plans: what chronicles, EP-SPARQL and SASE+ compile to (SPEC §8).

A plan reads rows in order of (end, arrival): each row has the name of its source, a start, an end,
and named columns (`rows`). A *match* binds each element to one row, a Kleene element to one row or
more. Elements are numbered from 0; the negative number `OWN` stands for the row of a probe, or of
an element's own condition. All bounds are closed, in ns, so ``<`` of times is a bound of 1.

A missing value (`no_value`) is NaN in a column of numbers, and `NO_VALUE` in one of integers or
keys. No comparison and no equality holds with it.

Everything is a frozen value; `printer` prints it, `network` says what its times imply.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, TypeAlias, assert_never

from ....streams.time import TIME_MIN

MOST_ELEMENTS: Final = 16
MOST_PROBES: Final = 46
"""Elements and probes are bits of one 64-bit integer (`packing`)."""
OWN: Final = -1
"""Stands for the row of the probe, or of the element, that a condition belongs to."""
NO_VALUE: Final = TIME_MIN
"""A missing value in a column of 64-bit integers."""
OPERATORS: Final = ("<", "<=", ">", ">=", "=", "!=")
ARITHMETIC: Final = ("+", "-", "*", "/", "%")


class PlanError(ValueError):
    """A plan that cannot be evaluated. ``elements`` are the numbers of the elements concerned, so
    that a language can name the place; ``hint`` says what to do."""

    def __init__(self, message: str, hint: str = "", elements: tuple[int, ...] = ()) -> None:
        super().__init__(f"{message}; {hint}" if hint else message)
        self.message = message
        self.hint = hint
        self.elements = elements


class ColumnType(StrEnum):
    """The type of a column. Only keys are compared by `Same`; a key is the id of a term, object or
    text, and its order means nothing."""

    KEY = "key"
    INTEGER = "integer"
    NUMBER = "number"


@dataclass(frozen=True, slots=True)
class Column:
    """A column of the rows: 64-bit integers for keys and integers, 64-bit floats for numbers."""

    name: str
    type: ColumnType


# -- expressions -----------------------------------------------------------------------------


class Position(StrEnum):
    """Which row of a Kleene element is meant. Other elements have one row: `EACH`."""

    EACH = "i"
    """``a[i]``: each row in turn, as it is taken."""
    FIRST = "1"
    """``a[1]``."""
    PREVIOUS = "i-1"
    """``a[i-1]``: the row taken before; a condition with it holds for the first row."""
    LAST = "LEN"
    """``a[a.LEN]``: the last row of the match."""


class Function(StrEnum):
    """An aggregate function."""

    COUNT = "count"
    SUM = "sum"
    MIN = "min"
    MAX = "max"
    AVG = "avg"


@dataclass(frozen=True, slots=True)
class Value:
    """The value of a column in a row of an element."""

    element: int
    column: str
    position: Position = Position.EACH


@dataclass(frozen=True, slots=True)
class Time:
    """The earliest start, or the latest end, of all rows of these elements, in ns."""

    elements: tuple[int, ...]
    is_start: bool = False


@dataclass(frozen=True, slots=True)
class Constant:
    """A number; an int is exact beside integers, keys and times."""

    value: int | float


@dataclass(frozen=True, slots=True)
class Key:
    """An object or a text, before it has its number (`query.with_numbers`)."""

    text: str


@dataclass(frozen=True, slots=True)
class Arithmetic:
    """``left + right``; the operator is one of ``+ - * / %``. It is computed in 64-bit integers if
    both sides are integers and the operator is ``+ - *``, else in floats. A division by 0 is
    `no_value`."""

    operator: str
    left: Expression
    right: Expression


@dataclass(frozen=True, slots=True)
class Aggregate:
    """An aggregate over the rows of a Kleene element: ``avg(a[].x)``, or with ``is_before`` over
    those taken before the present one: ``avg(a[..i-1].x)``. A condition with the latter holds for
    the first row. ``column`` is None for ``count``."""

    function: Function
    element: int
    column: str | None
    is_before: bool = False


Expression: TypeAlias = Value | Time | Constant | Key | Arithmetic | Aggregate


@dataclass(frozen=True, slots=True)
class Condition:
    """``left < right``; the operator is one of ``< <= > >= = !=``.

    With ``a[i]`` of a Kleene element it must hold for each of its rows, and each pair of rows of
    two such elements; with ``a[a.LEN]`` or an aggregate over all rows, at the end of the match.
    """

    operator: str
    left: Expression
    right: Expression


@dataclass(frozen=True, slots=True)
class Listed:
    """``a[].x``: the values of all rows of a Kleene element. Only an output may be one."""

    element: int
    column: str


@dataclass(frozen=True, slots=True)
class Output:
    """A column of the matches."""

    name: str
    value: Expression | Listed


@dataclass(frozen=True, slots=True)
class Trend:
    """An aggregate over all matches that end at one row, such as ``COUNT(*)`` or ``SUM(b[].v)``
    grouped by that row. ``count`` without an element is the number of matches, without a column
    that of the element's rows in all matches."""

    name: str
    function: Function
    element: int | None = None
    column: str | None = None


# -- elements and constraints ----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Element:
    """Which rows may be bound: those of one of the sources ``kinds`` that meet the ``conditions``,
    which read `OWN` only. A Kleene element takes one row or more."""

    name: str
    kinds: tuple[str, ...]
    conditions: tuple[Condition, ...] = ()
    is_kleene: bool = False


@dataclass(frozen=True, slots=True)
class Point:
    """The end of an element, or its start: of a Kleene element the end of its last row, or the
    start of its first."""

    element: int
    is_start: bool = False


@dataclass(frozen=True, slots=True)
class Between:
    """``second - first in [least, most]`` in ns; None: no bound."""

    first: Point
    second: Point
    least: int | None = None
    most: int | None = None


@dataclass(frozen=True, slots=True)
class Same:
    """Equal keys, which is a shared variable. In a probe ``first`` is `OWN`."""

    first: int
    first_column: str
    second: int
    second_column: str


@dataclass(frozen=True, slots=True)
class Bound:
    """A time relative to a match, in ns."""

    point: Point
    offset: int = 0


@dataclass(frozen=True, slots=True)
class CountProbe:
    """The number of rows of ``what`` with an end in ``[low, high]`` is in ``[least, most]`` (None:
    no bound). ``noevent`` and ``~`` are at most 0. A row of the match itself counts, too."""

    what: Element
    low: Bound
    high: Bound
    least: int = 0
    most: int | None = 0
    same: tuple[Same, ...] = ()
    conditions: tuple[Condition, ...] = ()


@dataclass(frozen=True, slots=True)
class StateProbe:
    """The state at a time: of the rows of ``what`` with these keys and an end at ``at`` or before,
    the last one in order of (end, arrival) exists and meets the ``state``."""

    what: Element
    at: Bound
    same: tuple[Same, ...] = ()
    state: tuple[Condition, ...] = ()


Probe: TypeAlias = CountProbe | StateProbe


@dataclass(frozen=True, slots=True)
class EqualHulls:
    """The earliest start of both groups of elements is equal, and the latest end (EQUALS)."""

    left: tuple[int, ...]
    right: tuple[int, ...]


class Selection(StrEnum):
    """Which rows follow each other in a match (SASE+)."""

    ANY_MATCH = "skip_till_any_match"
    """Every combination of rows: chronicles and EP-SPARQL, too."""
    NEXT_MATCH = "skip_till_next_match"
    PARTITION_CONTIGUITY = "partition_contiguity"
    STRICT_CONTIGUITY = "strict_contiguity"


@dataclass(frozen=True, slots=True)
class PatternPlan:
    """A pattern as data; a match meets all of it.

    ``within``: the latest end minus the earliest start is at most this, in ns. ``has_intervals``:
    rows may last; otherwise their starts are not read. ``is_distinct``: two elements never take the
    same row. ``partition``: the keys whose rows follow each other under partition contiguity.
    ``trends``: instead of matches there is a result for each row that ends some.
    ``max_matches``: of the matches that one row completes no more are made, and that is counted.

    Raises `PlanError`.
    """

    columns: tuple[Column, ...]
    elements: tuple[Element, ...]
    between: tuple[Between, ...] = ()
    same: tuple[Same, ...] = ()
    conditions: tuple[Condition, ...] = ()
    probes: tuple[Probe, ...] = ()
    selection: Selection = Selection.ANY_MATCH
    within: int | None = None
    has_intervals: bool = False
    hulls: tuple[EqualHulls, ...] = ()
    is_distinct: bool = True
    outputs: tuple[Output, ...] = ()
    trends: tuple[Trend, ...] = ()
    partition: tuple[str, ...] = ()
    max_matches: int | None = None

    def __post_init__(self) -> None:
        _check(self)

    def type_of(self, column: str) -> ColumnType:
        """The type of a column of the rows."""
        return next(each.type for each in self.columns if each.name == column)

    def is_integer(self, expression: Expression) -> bool:
        """Whether an expression is computed in 64-bit integers."""
        match expression:
            case Value(_, column):
                return self.type_of(column) is not ColumnType.NUMBER
            case Time():
                return True
            case Constant(value):
                return isinstance(value, int)
            case Key():
                return True
            case Arithmetic(operator, left, right):
                return operator in "+-*" and self.is_integer(left) and self.is_integer(right)
            case Aggregate(function, _, column):
                if function in (Function.COUNT, Function.AVG):
                    return function is Function.COUNT
                return column is None or self.type_of(column) is not ColumnType.NUMBER
            case _:
                assert_never(expression)

    def kinds(self) -> tuple[str, ...]:
        """The sources that the plan reads, each once, in order of their first element or probe."""
        read = [*self.elements, *(probe.what for probe in self.probes)]
        return tuple(dict.fromkeys(kind for each in read for kind in each.kinds))


def leaves_of(expression: Expression) -> Iterator[Value | Time | Constant | Key | Aggregate]:
    """The parts of an expression that are no calculations, from left to right."""
    if isinstance(expression, Arithmetic):
        yield from leaves_of(expression.left)
        yield from leaves_of(expression.right)
    else:
        yield expression


def elements_of(condition: Condition) -> frozenset[int]:
    """The elements whose rows a condition reads, `OWN` among them."""
    found: set[int] = set()
    for leaf in (*leaves_of(condition.left), *leaves_of(condition.right)):
        match leaf:
            case Value(element) | Aggregate(_, element):
                found.add(element)
            case Time(elements):
                found.update(elements)
            case Constant() | Key():
                pass
            case _:
                assert_never(leaf)
    return frozenset(found)


# -- what a plan must be ---------------------------------------------------------------------


def _check(plan: PatternPlan) -> None:
    count = len(plan.elements)
    if not count:
        raise PlanError("a pattern has no event", "name one that must happen")
    if count > MOST_ELEMENTS:
        raise PlanError(
            f"a pattern has {count} events, and at most {MOST_ELEMENTS} are evaluated together",
            "divide it into patterns that read each other",
            tuple(range(MOST_ELEMENTS, count)),
        )
    if len(plan.probes) > MOST_PROBES:
        raise PlanError(
            f"a pattern asks {len(plan.probes)} things about what happened besides its events, and "
            f"at most {MOST_PROBES} are asked",
            "divide it into patterns that read each other",
        )
    kleene = tuple(i for i, each in enumerate(plan.elements) if each.is_kleene)
    is_listed = plan.selection is Selection.ANY_MATCH and not plan.trends
    if kleene and is_listed and plan.max_matches is None:
        raise PlanError(
            f"{plan.elements[kleene[0]].name}+ has exponentially many matches under "
            "skip_till_any_match",
            "aggregate over them, limit the matches of a row, or select the next match",
            kleene,
        )
    if plan.selection is Selection.PARTITION_CONTIGUITY and not plan.partition:
        raise PlanError("partition contiguity has no partition", "name its attribute: [attribute]")
    if plan.within is not None and plan.within < 0:
        raise PlanError("a pattern cannot last less than nothing", "write a duration from 0 on")
    for element in plan.elements:
        _check_conditions(plan, element.conditions, range(OWN, OWN + 1))
    _check_conditions(plan, plan.conditions, range(count))
    _check_same(plan, plan.same, range(count))
    for probe in plan.probes:
        _check_probe(plan, probe)
    for name in plan.partition:
        _check_column(plan, name, ColumnType.KEY)
    for trend in plan.trends:
        if trend.element is not None:
            _check_element(plan, trend.element, range(count))
        if trend.element is not None and trend.column is not None:
            _check_column(plan, trend.column)
        elif trend.function is not Function.COUNT:
            raise PlanError(f"{trend.function} needs a value", f"write {trend.function}(a[].x)")
    for output in plan.outputs:
        if isinstance(output.value, Listed):
            _check_column(plan, output.value.column)
        else:
            _check_expression(plan, output.value, range(count))


def _check_probe(plan: PatternPlan, probe: Probe) -> None:
    if probe.what.is_kleene:
        raise PlanError(f"{probe.what.name} is counted, and not taken again and again", "omit +")
    _check_conditions(plan, probe.what.conditions, range(OWN, OWN + 1))
    _check_same(plan, probe.same, range(OWN, len(plan.elements)))
    conditions = probe.conditions if isinstance(probe, CountProbe) else probe.state
    _check_conditions(plan, conditions, range(OWN, len(plan.elements)))
    if any(each.first != OWN or each.second == OWN for each in probe.same):
        raise PlanError(f"a key of {probe.what.name} must equal one of an event")


def _check_same(plan: PatternPlan, same: tuple[Same, ...], known: range) -> None:
    for each in same:
        for element, column in ((each.first, each.first_column), (each.second, each.second_column)):
            _check_element(plan, element, known)
            _check_column(plan, column, ColumnType.KEY)


def _check_conditions(plan: PatternPlan, conditions: tuple[Condition, ...], known: range) -> None:
    for each in conditions:
        if each.operator not in OPERATORS:
            raise PlanError(f"{each.operator} is no comparison", f"write {' '.join(OPERATORS)}")
        for side in (each.left, each.right):
            _check_expression(plan, side, known)


def _check_expression(plan: PatternPlan, expression: Expression, known: range) -> None:
    match expression:
        case Arithmetic(operator, left, right):
            if operator not in ARITHMETIC:
                raise PlanError(f"{operator} is no calculation", f"write {' '.join(ARITHMETIC)}")
            _check_expression(plan, left, known)
            _check_expression(plan, right, known)
        case Value(element, column, position):
            _check_element(plan, element, known)
            _check_column(plan, column)
            if position is not Position.EACH and not _is_kleene(plan, element):
                raise PlanError(f"{_name(plan, element)} is one event", "write + after its type")
        case Aggregate(function, element, column):
            _check_element(plan, element, known)
            if not _is_kleene(plan, element):
                raise PlanError(f"{_name(plan, element)} is one event", "write + after its type")
            if column is not None:
                _check_column(plan, column)
            elif function is not Function.COUNT:
                raise PlanError(f"{function} needs a value", f"write {function}(a[].x)")
        case Time(elements):
            for element in elements:
                _check_element(plan, element, known)
        case Constant() | Key():
            pass
        case _:
            assert_never(expression)


def _check_element(plan: PatternPlan, element: int, known: range) -> None:
    if element not in known:
        raise PlanError(f"there is no event {element} here", f"the plan has {len(plan.elements)}")


def _check_column(plan: PatternPlan, name: str, wanted: ColumnType | None = None) -> None:
    found = next((each for each in plan.columns if each.name == name), None)
    if found is None:
        names = ", ".join(each.name for each in plan.columns) or "none"
        raise PlanError(f"there is no column {name}", f"the columns are {names}")
    if wanted is not None and found.type is not wanted:
        raise PlanError(f"the column {name} is no {wanted} but a {found.type}")


def _is_kleene(plan: PatternPlan, element: int) -> bool:
    return element != OWN and plan.elements[element].is_kleene


def _name(plan: PatternPlan, element: int) -> str:
    return "the event" if element == OWN else plan.elements[element].name
