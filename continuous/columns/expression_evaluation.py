"""SPARQL expressions on columns: values, three-valued logic, errors as nulls (SPARQL 1.1 §17).

What is not here is asked of Oxigraph (`oxigraph_expressions`), once a distinct combination of
values: functions by name, and comparisons whose data columns cannot judge (dates, ordered strings,
overflow).
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Mapping, Sequence
from decimal import Decimal
from typing import Any, Final, TypeAlias, assert_never

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import NamedNode

from ...languages.object_cache import ObjectCache
from ...rdf.dictionary import Term
from ...rdf.timed import Kind, ObjectColumn, split_term
from ...streams.sample import Mask
from ..algebra.expressions import INFIX, Call, Const, Expression, Var, variables
from ..algebra.triple_times import LATEST
from ..values import decimals
from ..values.literals import LONG, Sort, canonical
from .oxigraph_expressions import ask
from .relation import TermValues, coalesce, either, exact_column, scattered

_Part: TypeAlias = tuple[NDArray[np.int64], list[ObjectColumn]]
_SPLIT: Final = np.array(
    [Sort.INTEGER <= sort <= Sort.BOOLEAN or sort in LONG for sort in sorted(Sort)], np.bool_
)
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
_LONG_KINDS: Final[dict[int, Kind]] = {
    Sort.LONG_INTEGER: Kind.INTEGER,
    Sort.LONG_DECIMAL: Kind.DECIMAL,
}
_EXACT: Final = 2.0**53
"""Below, integers and decimals of columns that are equal as float64 are equal."""
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

    Law: the value for a row depends on that row alone. Cost: numpy a node, times the kinds of
    number that occur in a column; where Oxigraph is asked, Python a distinct combination of values.
    """
    native, strange = _parted(expression)
    if strange:
        answers = {name: _asked(call, columns, rows, terms) for name, call in strange}
        columns = {**columns, **answers}
    return _native(native, columns, rows, terms)


def _asked(
    call: Call, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    """A call that Oxigraph is asked for; what columns know of its arguments is computed first."""
    found = dict(columns)

    def go(expression: Expression) -> Expression:
        if not isinstance(expression, Call):
            return expression
        if expression.name in NATIVE:
            name = f"\0a{len(found)}"
            found[name] = evaluate(expression, columns, rows, terms)
            return Var(name)
        return Call(expression.name, tuple(go(argument) for argument in expression.arguments))

    return ask(go(call), found, rows, terms)


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


@ObjectCache
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


def _native(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    """By columns alone, a part of the rows after the other: in each, a column is of one kind."""
    if not isinstance(expression, Call):
        return _Rows(columns, rows, terms).value(expression)
    names = sorted(name for name in variables(expression) if name in columns)
    parts = parted([columns[name] for name in names], terms)
    if parts is None:
        return _Rows(columns, rows, terms).value(expression)
    values = [
        _Rows(dict(zip(names, typed, strict=True)), len(at), terms).value(expression)
        for at, typed in parts
    ]
    return scattered([at for at, _ in parts], values, terms.dictionary)


def parted(columns: Sequence[ObjectColumn], terms: TermValues) -> list[_Part] | None:
    """The rows by what the terms of the columns are: places, and there the columns, those of
    numbers and booleans as such; `LONG` ones stay apart as terms. None where no term is one."""
    mixed: dict[int, NDArray[np.int8]] = {}
    for i, column in enumerate(columns):
        if column.kind is Kind.TERM:
            sorts = np.where(column.present, terms.sorts(column.values), np.int8(Sort.OTHER))
            if np.any(_SPLIT[sorts]):
                mixed[i] = sorts
    if not mixed:
        return None
    signature = np.zeros(len(columns[0]), np.int64)
    for sorts in mixed.values():
        # What is no number and no boolean needs no part of its own.
        both = signature * len(_SPLIT) + np.where(_SPLIT[sorts], sorts, 0)
        signature = np.unique(both, return_inverse=True)[1].reshape(-1)
    found = []
    for code in range(int(signature.max(initial=-1)) + 1):
        at = np.flatnonzero(signature == code)
        part = [column.take(at) for column in columns]
        for i, sorts in mixed.items():
            sort = int(sorts[at[0]])
            if Sort.INTEGER <= sort <= Sort.BOOLEAN:
                part[i] = terms.typed(part[i], Kind(sort))
        found.append((at, part))
    return found


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
        none = (sorts == Sort.NODE) | (sorts == Sort.OTHER)
        return terms.true(column.values) & ~none, either(column.null, none)
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
            case Call("IF", (condition, yes, no)):
                return self._either(self.value(condition), self.value(yes), self.value(no))
            case Call("COALESCE", arguments):
                return self._first([self.value(argument) for argument in arguments])
            case Call(name, arguments) if name == LATEST:
                return self._latest([self.value(argument) for argument in arguments])
            case Call(name, arguments):
                return self._applied(name, [self.value(argument) for argument in arguments])
            case _:
                assert_never(expression)

    def _applied(self, name: str, columns: list[ObjectColumn]) -> ObjectColumn:
        """An operator or function of columns; those that were computed may be of several kinds."""
        parts = parted(columns, self.terms)
        if parts is None:
            return self._operation(name, columns)
        values = [_Rows({}, len(at), self.terms)._operation(name, typed) for at, typed in parts]
        return scattered([at for at, _ in parts], values, self.terms.dictionary)

    def _operation(self, name: str, columns: list[ObjectColumn]) -> ObjectColumn:
        match columns:
            case [left, right] if name in _ORDER:
                return self._compare(name, left, right)
            case [left, right] if name in _ARITHMETIC:
                return self._arithmetic(name, left, right)
            case [left, right] if name == "SAMETERM":
                return self._same_term(left, right)
            case [one]:
                return self._function(name, one)
        raise AssertionError(f"{name} of {len(columns)} arguments")

    def _constant(self, term: Term) -> ObjectColumn:
        kind, value = split_term(canonical(term), self.terms.dictionary.transient_id)
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
        # A TERM column here holds no numbers (`parted`): another kind is another term.
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

    def _number(self, column: ObjectColumn) -> Kind | None:
        """Of which kind the numbers of a column are; None: they are none."""
        if column.kind is not Kind.TERM:
            return column.kind if column.kind.is_number else None
        sort = int(self.terms.sorts(column.values[:1])[0]) if len(column) else Sort.OTHER
        # `parted` has put long numbers apart: one is as all.
        return _LONG_KINDS.get(sort)

    def _compare(self, name: str, a: ObjectColumn, b: ObjectColumn) -> ObjectColumn:
        null = either(a.null, b.null)
        left, right = self._number(a), self._number(b)
        if left is not None and right is not None:
            return _boolean(self._ordered(name, a, b, max(left, right)), null)
        if a.kind is b.kind is Kind.BOOLEAN:
            return _boolean(_ORDER[name](a.values, b.values), null)
        equality = name in ("=", "!=")
        if a.kind is not Kind.TERM and b.kind is not Kind.TERM:
            never = np.full(self.rows, name == "!=")
            return _boolean(never, null if equality else np.ones(self.rows, np.bool_))
        sorts = [self.terms.sorts(c.values) for c in (a, b) if c.kind is Kind.TERM]
        other = np.zeros(self.rows, np.bool_)
        for one in sorts:
            other |= (one == Sort.OTHER) | (equality & (one == Sort.ILL_TYPED))
        if a.kind is b.kind:
            same = a.values == b.values
            doubtful = other & ~same
            if not equality:
                text = (sorts[0] == Sort.STRING) & (sorts[1] == Sort.STRING)
                doubtful = other | text
                for one in sorts:
                    # What is ill-typed has no order, nor has a node.
                    doubtful &= (one != Sort.ILL_TYPED) & (one != Sort.NODE)
        else:
            same, doubtful = np.zeros(self.rows, np.bool_), other
        if null is not None:
            doubtful = doubtful & ~null
        if not equality:
            known = _boolean(same, np.ones(self.rows, np.bool_))
        else:
            known = _boolean(same if name == "=" else ~same, null)
        return self._or_asked(name, [a, b], known, doubtful)

    def _or_asked(
        self, name: str, columns: list[ObjectColumn], known: ObjectColumn, doubtful: Mask
    ) -> ObjectColumn:
        """What is known, and for the doubtful rows what Oxigraph says of the operator."""
        if not np.any(doubtful):
            return known
        at, rest = np.flatnonzero(doubtful), np.flatnonzero(~doubtful)
        names = [f"\0v{i}" for i in range(len(columns))]
        given = {name: column.take(at) for name, column in zip(names, columns, strict=True)}
        call = Call(name, tuple(map(Var, names)))
        asked = ask(call, given, len(at), self.terms)
        return scattered([at, rest], [asked, known.take(rest)], self.terms.dictionary)

    def _ordered(self, name: str, a: ObjectColumn, b: ObjectColumn, kind: Kind) -> Mask:
        """A comparison of numbers that are promoted to ``kind``."""
        test = _ORDER[name]
        if a.kind is b.kind is not Kind.TERM:
            found: Mask = test(a.values, b.values)
            return found
        x, y = self.terms.approximate(a), self.terms.approximate(b)
        found = test(x, y)
        if kind in (Kind.FLOAT, Kind.DOUBLE):
            return found
        # Exact numbers are in order where their floats are; equal floats may stand for two.
        doubtful = np.flatnonzero(x == y)
        if a.kind is not Kind.TERM and b.kind is not Kind.TERM:
            doubtful = doubtful[np.abs(x[doubtful]) >= _EXACT]
        if len(doubtful):
            rows = doubtful.tolist()
            pairs = zip(self.terms.exact(a, rows), self.terms.exact(b, rows), strict=True)
            found[doubtful] = [test(left, right) for left, right in pairs]
        return found

    def _arithmetic(self, name: str, a: ObjectColumn, b: ObjectColumn) -> ObjectColumn:
        left, right = self._number(a), self._number(b)
        if left is None or right is None:
            return self._or_asked(name, [a, b], self._unbound(), self._is_other(a, b))
        null, kind = either(a.null, b.null), max(left, right)
        if kind in (Kind.FLOAT, Kind.DOUBLE):
            x, y = self.terms.approximate(a), self.terms.approximate(b)
            with np.errstate(all="ignore"):
                return ObjectColumn(kind, _ARITHMETIC[name](x, y), null)
        if name == "/":
            # A long number is not 0, though its float may be.
            kind, zero = Kind.DECIMAL, (b.values == 0) & (b.kind is not Kind.TERM)
            if zero.any():
                null = either(null, zero)
                b = ObjectColumn(b.kind, np.where(zero, 1, b.values))
        if kind is Kind.INTEGER and a.kind is b.kind is Kind.INTEGER:
            with np.errstate(all="ignore"):
                size = np.abs(_ARITHMETIC[name](a.values.astype(np.float64), b.values))
            values, known = _ARITHMETIC[name](a.values, b.values), size < 2.0**62
        else:
            found = self._combined(name, a, b, null)
            if found is None:
                values, known = np.zeros(self.rows, kind.dtype), np.zeros(self.rows, np.bool_)
            else:
                values, known = found
        column = ObjectColumn(kind, values, null)
        known = known if null is None else known | null
        if known.all():
            return column
        return self._or_exact(column, known, lambda x, y: decimals.computed(name, x, y), [a, b])

    def _combined(
        self, name: str, a: ObjectColumn, b: ObjectColumn, null: Mask | None
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]] | None:
        """The codes of decimals that arithmetic gives, and which are known; None: none is."""
        sides = []
        for column in (a, b):
            values = column.values
            if column.kind is Kind.TERM:
                return None
            if null is not None:
                values = np.where(null, 1, values)
            if column.kind is Kind.INTEGER:
                side = decimals.mantissas_of(values)
            else:
                side = decimals.mantissas(values)
            if side is None:
                return None
            sides.append(side)
        return decimals.combined(name, *sides)

    def _or_exact(
        self,
        column: ObjectColumn,
        known: NDArray[np.bool_],
        operation: Callable[..., Decimal | None],
        arguments: Sequence[ObjectColumn],
    ) -> ObjectColumn:
        """The column, and for the rows that are not known what ``operation`` gives of decimals."""
        at, rest = np.flatnonzero(~known), np.flatnonzero(known)
        rows = at.tolist()
        sides = [self.terms.exact(argument, rows) for argument in arguments]
        values = [operation(*numbers) for numbers in zip(*sides, strict=True)]
        found = exact_column(column.kind, values, self.terms.dictionary.transient_id)
        return scattered([at, rest], [found, column.take(rest)], self.terms.dictionary)

    def _is_other(self, *columns: ObjectColumn) -> NDArray[np.bool_]:
        """Where all are there, and one is a literal whose arithmetic Oxigraph may know."""
        other = np.zeros(self.rows, np.bool_)
        for column in columns:
            if column.kind is Kind.TERM:
                other |= self.terms.sorts(column.values) == Sort.OTHER
        for column in columns:
            other &= column.present
        return other

    def _function(self, name: str, a: ObjectColumn) -> ObjectColumn:
        if name in ("ISIRI", "ISBLANK", "ISLITERAL", "ISNUMERIC"):
            return _boolean(self._is(name, a), a.null)
        kind = self._number(a)
        if kind is None:
            return self._or_asked(name, [a], self._unbound(), self._is_other(a))
        if a.kind is Kind.TERM or (a.kind is Kind.INTEGER and _is_least(name, a)):
            nothing = ObjectColumn(kind, np.zeros(self.rows, kind.dtype), a.null)
            known = ~a.present
            return self._or_exact(nothing, known, lambda x: decimals.rounded(name, x), [a])
        if a.kind is Kind.INTEGER and name in ("CEIL", "FLOOR", "ROUND"):
            return a
        values = _FUNCTIONS[name](a.values)
        # A decimal has no -0.
        return ObjectColumn(a.kind, values + 0.0 if a.kind is Kind.DECIMAL else values, a.null)

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


def _is_least(name: str, a: ObjectColumn) -> bool:
    """Whether a value has no counterpart of the other sign in 64 bits, and needs one."""
    return name in ("NEGATE", "ABS") and bool(np.any(a.values == np.iinfo(np.int64).min))


def _round(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """ROUND of floats: a half goes towards positive infinity, -0.4 to -0 (XPath F&O §4.4.4)."""
    with np.errstate(all="ignore"):
        below = np.floor(values)
        found = below + (values - below >= 0.5)
    return np.where(found == 0, np.copysign(found, values), found)


_FUNCTIONS: Final[dict[str, Callable[[Any], Any]]] = {
    "NEGATE": operator.neg,
    "ABS": np.abs,
    "CEIL": np.ceil,
    "FLOOR": np.floor,
    "ROUND": _round,
}
