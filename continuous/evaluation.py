"""SPARQL expressions on columns: values, three-valued logic, errors as nulls (SPARQL 1.1 §17).

What is not here is asked of Oxigraph (`foreign`), once a distinct combination of values: functions
by name, and comparisons whose data columns cannot judge (dates, ordered strings, overflow).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping
from typing import Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ..languages.attached import attached
from ..rdf.dictionary import Term
from ..rdf.timed import Kind, ObjectColumn, split_term
from ..streams.sample import Mask
from .columns import NeedsOxigraph, Sort, TermValues, coalesce, either, scattered
from .decimals import rounded
from .expressions import INFIX, Call, Const, Expression, Var, variables
from .foreign import ask
from .timestamps import LATEST

_Parted: TypeAlias = tuple[Expression, tuple[tuple[str, Call], ...]]
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
NATIVE: Final = INFIX | {
    "!",
    "NEGATE",
    "BOUND",
    "ABS",
    "CEIL",
    "FLOOR",
    "ROUND",
    "ISIRI",
    "ISBLANK",
    "ISLITERAL",
    "ISNUMERIC",
    "SAMETERM",
    "IF",
    "COALESCE",
    LATEST,
}
"""What columns know; the rest is asked of Oxigraph."""


def evaluate(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    """The value of ``expression`` for each of ``rows`` rows; null is error or unbound.

    Cost: numpy a node, times the kinds of number that occur in a column; where Oxigraph is asked,
    Python a distinct combination of values.
    """
    native, strange = _parted(expression)
    if strange:
        answers = {name: ask(call, columns, rows, terms) for name, call in strange}
        columns = {**columns, **answers}
    try:
        return _native(*_chosen(native, columns, rows, terms), rows, terms)
    except NeedsOxigraph:
        return ask(expression, columns, rows, terms)


def foreign_calls(expression: Expression) -> tuple[Call, ...]:
    """The parts of an expression that Oxigraph is asked for."""
    return tuple(call for _, call in _parted(expression)[1])


def _parted(expression: Expression) -> _Parted:
    """The expression with a variable for each call that columns do not know, and these calls."""
    if not isinstance(expression, Call):
        return expression, ()
    if expression.name not in NATIVE:
        return Var("\0f0"), (("\0f0", expression),)
    return _parted_call(expression)


@attached
def _parted_call(expression: Call) -> _Parted:
    strange: dict[Call, str] = {}

    def go(expression: Expression) -> Expression:
        if not isinstance(expression, Call):
            return expression
        if expression.name not in NATIVE:
            return Var(strange.setdefault(expression, f"\0f{len(strange)}"))
        return Call(expression.name, tuple(go(argument) for argument in expression.arguments))

    native = go(expression)
    return native, tuple((name, call) for call, name in strange.items())


def _chosen(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> tuple[Expression, Mapping[str, ObjectColumn]]:
    """The expression with a column for each IF and COALESCE in it: what they give may be of several
    kinds, which `_native` tells apart in columns only."""
    found = dict(columns)

    def go(expression: Expression) -> Expression:
        if not isinstance(expression, Call):
            return expression
        call = Call(expression.name, tuple(go(argument) for argument in expression.arguments))
        if call.name not in ("IF", "COALESCE"):
            return call
        name = f"\0c{len(found)}"
        found[name] = _native(call, found, rows, terms)
        return Var(name)

    return go(expression), found


def _native(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    """By columns alone. A TERM column with numbers among its terms is split by what the terms are,
    so that each part is of one kind."""
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
    return scattered(places, parts, terms.dictionary)


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
            case Call("IF", (condition, yes, no)):
                return self._either(self.value(condition), self.value(yes), self.value(no))
            case Call("COALESCE", arguments):
                return self._first([self.value(argument) for argument in arguments])
            case Call("SAMETERM", (left, right)):
                return self._same_term(self.value(left), self.value(right))
            case Call(name, arguments) if name == LATEST:
                return self._latest([self.value(argument) for argument in arguments])
            case Call(name, (argument,)):
                return self._function(name, self.value(argument))
            case _:
                raise NeedsOxigraph(f"the expression {expression}")

    def _constant(self, term: Term) -> ObjectColumn:
        kind, value = split_term(term, self.terms.dictionary.transient_id)
        if kind is Kind.TERM:
            sort = int(self.terms.sorts(np.array([value], np.int32))[0])
            if Sort.INTEGER <= sort <= Sort.BOOLEAN:
                one = ObjectColumn(Kind.TERM, np.array([value], np.int32))
                kind = Kind(sort)
                value = self.terms.typed(one, kind).values[0]
        return ObjectColumn(kind, np.broadcast_to(np.array(value, kind.dtype), (self.rows,)))

    def _unbound(self) -> ObjectColumn:
        return _boolean(np.zeros(self.rows, np.bool_), np.ones(self.rows, np.bool_))

    def _either(self, condition: ObjectColumn, a: ObjectColumn, b: ObjectColumn) -> ObjectColumn:
        """IF: an error of the condition is one of the whole."""
        yes, error = truth(condition, self.terms)
        null = ~yes | ~a.present
        chosen = coalesce(
            ObjectColumn(a.kind, a.values, null),
            ObjectColumn(b.kind, b.values, yes | ~b.present),
            self.terms.dictionary,
        )
        null = ~chosen.present if error is None else error | ~chosen.present
        return ObjectColumn(chosen.kind, chosen.values, null if null.any() else None)

    def _first(self, columns: list[ObjectColumn]) -> ObjectColumn:
        chosen = self._unbound()
        for column in columns:
            # A kind is taken over where nothing was chosen yet, so that numbers stay numbers.
            nothing = chosen.null is not None and chosen.null.all()
            chosen = column if nothing else coalesce(chosen, column, self.terms.dictionary)
        return chosen

    def _same_term(self, a: ObjectColumn, b: ObjectColumn) -> ObjectColumn:
        null = either(a.null, b.null)
        if a.kind is b.kind and a.kind is not Kind.TERM and a.values.dtype == np.float64:
            same = (a.values == b.values) & (np.signbit(a.values) == np.signbit(b.values))
            return _boolean(same | (np.isnan(a.values) & np.isnan(b.values)), null)
        if a.kind is b.kind:
            return _boolean(a.values == b.values, null)
        # A TERM column here holds no numbers (`_native`): another kind is another term.
        return _boolean(np.zeros(self.rows, np.bool_), null)

    def _latest(self, columns: list[ObjectColumn]) -> ObjectColumn:
        """The greatest time that is there."""
        least = np.iinfo(np.int64).min
        values = np.full(self.rows, least)
        for column in columns:
            values = np.maximum(values, np.where(column.present, column.values, least))
        null = np.all([~column.present for column in columns], axis=0)
        return ObjectColumn(Kind.INTEGER, values, null if null.any() else None)

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
            greater = np.maximum(np.abs(a.values), np.abs(b.values)) if name in "+-" else None
            values = rounded(values, greater)
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
        nodes: NDArray[np.bool_] = a.present & (sorts == Sort.NODE)
        ids, inverse = np.unique(a.values[nodes], return_inverse=True)
        iris = [isinstance(self.terms.dictionary.term(id), NamedNode) for id in ids.tolist()]
        wanted = np.array(iris, np.bool_) == (name == "ISIRI")
        nodes[nodes] = wanted[inverse.reshape(-1)]
        return nodes


def _boolean(values: Any, null: Mask | None) -> ObjectColumn:
    return ObjectColumn(Kind.BOOLEAN, np.asarray(values, np.bool_), null)
