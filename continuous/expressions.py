"""SPARQL expressions on columns (SPARQL 1.1 §17): values, three-valued logic, errors as nulls.

What is not here goes to Oxigraph: either the whole query (a function that is not known, found
when the query is planned) or one window (`NeedsOxigraph`: dates, ordered strings, overflow).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray

from ..rdf.dictionary import Term
from ..rdf.timed import Kind, ObjectColumn, split_term
from ..streams.sample import Mask
from .columns import NeedsOxigraph, Sort, TermValues, concatenate, either


@dataclass(frozen=True, slots=True)
class Var:
    name: str

    def __str__(self) -> str:
        return f"?{self.name}"


@dataclass(frozen=True, slots=True)
class Const:
    term: Term

    def __str__(self) -> str:
        return str(self.term)


@dataclass(frozen=True, slots=True)
class Call:
    """An operator or function, by its SPARQL name in upper case, on its arguments."""

    name: str
    arguments: tuple[Expression, ...]

    def __str__(self) -> str:
        if self.name in INFIX and len(self.arguments) == 2:
            return f"({self.arguments[0]} {self.name} {self.arguments[1]})"
        return f"{self.name}({', '.join(map(str, self.arguments))})"


Expression: TypeAlias = Var | Const | Call

_ORDER: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_ARITHMETIC: Final[dict[str, Callable[[Any, Any], Any]]] = {
    "+": operator.add,
    "-": operator.sub,
    "*": operator.mul,
    "/": operator.truediv,
}
INFIX: Final = frozenset({*_ORDER, *_ARITHMETIC, "&&", "||"})
FUNCTIONS: Final = frozenset(
    {"!", "NEGATE", "BOUND", "ABS", "CEIL", "FLOOR", "ROUND"}
    | {"ISIRI", "ISBLANK", "ISLITERAL", "ISNUMERIC"}
)
"""What `evaluate` knows beside `INFIX`."""


def variables(expression: Expression) -> frozenset[str]:
    """The variables that ``expression`` names."""
    match expression:
        case Var(name):
            return frozenset({name})
        case Const():
            return frozenset()
        case Call(_, arguments):
            return frozenset().union(*map(variables, arguments))
        case _:
            assert_never(expression)


def conjuncts(expression: Expression) -> tuple[Expression, ...]:
    """The parts of a conjunction: a FILTER with them is a FILTER each."""
    if isinstance(expression, Call) and expression.name == "&&":
        return tuple(part for side in expression.arguments for part in conjuncts(side))
    return (expression,)


def evaluate(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    """The value of ``expression`` for each of ``rows`` rows; null is error or unbound.

    A TERM column with numbers among its terms is split by what the terms are, so that each part
    is of one kind. Cost: numpy a node, times the kinds that occur.
    """
    mixed = []
    for name in sorted(variables(expression)):
        column = columns.get(name)
        if column is not None and column.kind is Kind.TERM:
            sorts = terms.sorts(column.values)
            if np.any((sorts >= Sort.INTEGER) & (sorts <= Sort.BOOLEAN)):
                mixed.append((name, column, sorts))
    if not mixed:
        return _Rows(columns, rows, terms).value(expression)
    signature = np.zeros(rows, np.int64)
    for _, _, sorts in mixed:
        signature = signature * 16 + sorts
    places, parts = [], []
    for code in np.unique(signature).tolist():
        at = np.flatnonzero(signature == code)
        part = {name: column.take(at) for name, column in columns.items()}
        for name, _, sorts in mixed:
            sort = int(sorts[at[0]])
            if Sort.INTEGER <= sort <= Sort.BOOLEAN:
                part[name] = terms.typed(part[name], Kind(sort))
        places.append(at)
        parts.append(_Rows(part, len(at), terms).value(expression))
    whole = concatenate(parts, terms.dictionary)
    back = np.empty(rows, np.int64)
    back[np.concatenate(places)] = np.arange(rows)
    return whole.take(back)


def holds(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> Mask:
    """Where a FILTER with ``expression`` lets rows through: true, and no error."""
    yes, error = truth(evaluate(expression, columns, rows, terms), terms)
    return yes if error is None else yes & ~error


def truth(column: ObjectColumn, terms: TermValues) -> tuple[Mask, Mask | None]:
    """The effective boolean value (§17.2.2) and where it is an error."""
    if column.kind is Kind.BOOLEAN:
        return column.values.astype(np.bool_), column.null
    if column.kind is Kind.TERM:
        sorts = terms.sorts(column.values)
        if np.any(column.present & (sorts == Sort.OTHER)):
            raise NeedsOxigraph("the boolean value of a literal of another datatype")
        text = (sorts == Sort.STRING) | (sorts == Sort.TEXT)
        return text & terms.filled(column.values), either(column.null, ~text)
    yes: Mask = (column.values != 0) & ~np.isnan(column.values)
    return yes, column.null


class _Rows:
    """One evaluation: columns of one kind each."""

    def __init__(self, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues) -> None:
        self.columns = columns
        self.rows = rows
        self.terms = terms

    def value(self, expression: Expression) -> ObjectColumn:
        match expression:
            case Var(name):
                column = self.columns.get(name)
                return self._unbound() if column is None else column
            case Const(term):
                return self._constant(term)
            case Call("&&" | "||" as name, (left, right)):
                return self._logical(name, left, right)
            case Call("BOUND", (argument,)):
                return _boolean(self.value(argument).present, None)
            case Call("!", (argument,)):
                yes, error = truth(self.value(argument), self.terms)
                return _boolean(~yes, error)
            case Call(name, (left, right)) if name in _ORDER:
                return self._compare(name, self.value(left), self.value(right))
            case Call(name, (left, right)) if name in _ARITHMETIC:
                return self._arithmetic(name, self.value(left), self.value(right))
            case Call(name, (argument,)):
                return self._function(name, self.value(argument))
            case _:
                raise NeedsOxigraph(f"the expression {expression}")

    def _constant(self, term: Term) -> ObjectColumn:
        kind, value = split_term(term, self.terms.dictionary)
        if kind is Kind.TERM:
            sort = int(self.terms.sorts(np.array([value], np.int32))[0])
            if Sort.INTEGER <= sort <= Sort.BOOLEAN:
                one = ObjectColumn(Kind.TERM, np.array([value], np.int32))
                kind = Kind(sort)
                value = self.terms.typed(one, kind).values[0]
        return ObjectColumn(kind, np.broadcast_to(np.array(value, kind.dtype), (self.rows,)))

    def _unbound(self) -> ObjectColumn:
        return _boolean(np.zeros(self.rows, np.bool_), np.ones(self.rows, np.bool_))

    def _logical(self, name: str, left: Expression, right: Expression) -> ObjectColumn:
        a, a_error = truth(self.value(left), self.terms)
        b, b_error = truth(self.value(right), self.terms)
        result = a & b if name == "&&" else a | b
        if a_error is None and b_error is None:
            return _boolean(result, None)
        none = np.zeros(self.rows, np.bool_)
        a_error = none if a_error is None else a_error
        b_error = none if b_error is None else b_error
        # An error is overruled only by a certain false under &&, a certain true under ||.
        decides_a = (~a if name == "&&" else a) & ~a_error
        decides_b = (~b if name == "&&" else b) & ~b_error
        decided = decides_a | decides_b
        result = np.where(decided, name == "||", result)
        return _boolean(result, (a_error | b_error) & ~decided)

    def _compare(self, name: str, a: ObjectColumn, b: ObjectColumn) -> ObjectColumn:
        null = either(a.null, b.null)
        if (a.kind.is_number and b.kind.is_number) or (a.kind is b.kind is Kind.BOOLEAN):
            return _boolean(_ORDER[name](a.values, b.values), null)
        equality = name in ("=", "!=")
        if a.kind is not Kind.TERM and b.kind is not Kind.TERM:
            never = np.full(self.rows, name == "!=")
            return _boolean(never, null if equality else np.ones(self.rows, np.bool_))
        sorts = [self.terms.sorts(c.values) for c in (a, b) if c.kind is Kind.TERM]
        other = np.zeros(self.rows, np.bool_)
        for one in sorts:
            other |= one == Sort.OTHER
        if a.kind is b.kind:
            same = a.values == b.values
            doubtful = other & ~same
            if not equality:
                text = (sorts[0] == Sort.STRING) & (sorts[1] == Sort.STRING)
                doubtful = other | text
        else:
            same, doubtful = np.zeros(self.rows, np.bool_), other
        if null is not None:
            doubtful = doubtful & ~null
        if np.any(doubtful):
            raise NeedsOxigraph("a comparison of strings or literals of other datatypes")
        if not equality:
            return _boolean(same, np.ones(self.rows, np.bool_))
        return _boolean(same if name == "=" else ~same, null)

    def _numbers(self, *columns: ObjectColumn) -> bool:
        for column in columns:
            if column.kind is Kind.TERM and np.any(
                column.present & (self.terms.sorts(column.values) == Sort.OTHER)
            ):
                raise NeedsOxigraph("arithmetic on literals of other datatypes")
        return all(column.kind.is_number for column in columns)

    def _arithmetic(self, name: str, a: ObjectColumn, b: ObjectColumn) -> ObjectColumn:
        if not self._numbers(a, b):
            return self._unbound()
        null = either(a.null, b.null)
        kind = max(a.kind, b.kind)
        with np.errstate(all="ignore"):
            values = _ARITHMETIC[name](a.values.astype(np.float64), b.values.astype(np.float64))
            if kind is Kind.INTEGER and name != "/":
                if np.any(np.abs(values) >= 2.0**62):
                    raise NeedsOxigraph("an integer beyond 62 bits")
                return ObjectColumn(kind, _ARITHMETIC[name](a.values, b.values), null)
        if kind in (Kind.INTEGER, Kind.DECIMAL):
            kind = Kind.DECIMAL
            if name == "/" and np.any(b.values == 0):
                null = either(null, b.values == 0)
                values = np.where(b.values == 0, 0.0, values)
        return ObjectColumn(kind, values, null)

    def _function(self, name: str, a: ObjectColumn) -> ObjectColumn:
        if name in ("ISIRI", "ISBLANK", "ISLITERAL", "ISNUMERIC"):
            return _boolean(self._is(name, a), a.null)
        if not self._numbers(a):
            return self._unbound()
        values = a.values
        match name:
            case "NEGATE":
                values = -values
            case "ABS":
                values = np.abs(values)
            case "CEIL" | "FLOOR" | "ROUND" if a.kind is Kind.INTEGER:
                pass
            case "CEIL":
                values = np.ceil(values)
            case "FLOOR":
                values = np.floor(values)
            case "ROUND":
                values = np.floor(values + 0.5)
            case _:
                raise NeedsOxigraph(f"the function {name}")
        return ObjectColumn(a.kind, values, a.null)

    def _is(self, name: str, a: ObjectColumn) -> NDArray[np.bool_]:
        if a.kind is not Kind.TERM:
            return np.full(
                self.rows, name == "ISLITERAL" or (name == "ISNUMERIC" and a.kind.is_number)
            )
        sorts = self.terms.sorts(a.values)
        if name == "ISLITERAL":
            return np.asarray(sorts != Sort.NODE)
        if name == "ISNUMERIC":
            return np.zeros(self.rows, np.bool_)
        from pyoxigraph import NamedNode

        wanted = [isinstance(self.terms.dictionary.term(i), NamedNode) for i in np.unique(a.values)]
        nodes = np.array(wanted, np.bool_)[np.unique(a.values, return_inverse=True)[1].reshape(-1)]
        return np.asarray((sorts == Sort.NODE) & (nodes == (name == "ISIRI")))


def _boolean(values: Any, null: Mask | None) -> ObjectColumn:
    return ObjectColumn(Kind.BOOLEAN, np.asarray(values, np.bool_), null)
