"""SPARQL expressions on columns: values, three-valued logic, errors as nulls (SPARQL 1.1 §17).

Oxigraph (`oxigraph_expressions`) evaluates the rest, once per distinct combination of values: other
functions, and comparisons of values whose order columns do not implement (dates, ordered strings,
overflow).

The file is long because it has a method for each kind of operator.
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
from ...rdf.dictionary import NO_TERM, Term
from ...rdf.timed import Kind, ObjectColumn, split_term
from ...streams.sample import Mask
from ..algebra.expressions import INFIX, Call, Const, Expression, Var, variables
from ..algebra.triple_times import LATEST
from ..values import decimals
from ..values.literals import LONG, Sort, canonical
from .oxigraph_expressions import ask
from .relation import TermValues, coalesce, either, exact_column, scatter

_Part: TypeAlias = tuple[NDArray[np.int64], list[ObjectColumn]]
_SPLIT: Final = np.array(
    [Sort.INTEGER <= sort <= Sort.BOOLEAN or sort in LONG for sort in sorted(Sort)], np.bool_
)
_Split: TypeAlias = tuple[Expression, tuple[tuple[str, Call], ...]]
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
"""Below this, integers and decimals that are equal as float64 are equal."""
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
"""The functions that columns implement; Oxigraph evaluates the others."""


def evaluate(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    """Return the value of ``expression`` for each of ``rows`` rows; null is error or unbound.

    Law: the value for a row depends on that row alone. Cost: numpy per node, times the number of
    kinds in a column; for Oxigraph, Python per distinct combination of values.
    """
    if isinstance(expression, Var) and expression.name in columns:
        return columns[expression.name]
    native, foreign = _split_foreign(expression)
    if foreign:
        values = {name: _evaluate_foreign(call, columns, rows, terms) for name, call in foreign}
        columns = {**columns, **values}
    return _native(native, columns, rows, terms)


def _evaluate_foreign(
    call: Call, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    """Let Oxigraph evaluate a call. Columns first evaluate the native parts of its arguments."""
    inputs = dict(columns)

    def go(expression: Expression) -> Expression:
        if not isinstance(expression, Call):
            return expression
        if expression.name in NATIVE:
            name = f"\0a{len(inputs)}"
            inputs[name] = evaluate(expression, columns, rows, terms)
            return Var(name)
        return Call(expression.name, tuple(go(argument) for argument in expression.arguments))

    return ask(go(call), inputs, rows, terms)


def foreign_calls(expression: Expression) -> tuple[Call, ...]:
    """Return the parts of an expression that Oxigraph evaluates."""
    return tuple(call for _, call in _split_foreign(expression)[1])


def _split_foreign(expression: Expression) -> _Split:
    """Replace each call that columns do not implement by a variable; return these calls too."""
    if not isinstance(expression, Call):
        return expression, ()
    if expression.name not in NATIVE:
        return Var("\0f0"), (("\0f0", expression),)
    return _split_foreign_call(expression)


@ObjectCache
def _split_foreign_call(expression: Call) -> _Split:
    foreign: dict[Call, str] = {}

    def go(expression: Expression) -> Expression:
        if not isinstance(expression, Call):
            return expression
        if expression.name not in NATIVE:
            return Var(foreign.setdefault(expression, f"\0f{len(foreign)}"))
        return Call(expression.name, tuple(go(argument) for argument in expression.arguments))

    native = go(expression)
    return native, tuple((name, call) for call, name in foreign.items())


def _native(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> ObjectColumn:
    """Evaluate by columns alone. Rows are split so that each column of a part has one kind."""
    if not isinstance(expression, Call):
        return _Rows(columns, rows, terms).value(expression)
    compared = _compared(expression, columns)
    if compared is not None:
        return compared
    names = sorted(name for name in variables(expression) if name in columns)
    parts = split_by_kind([columns[name] for name in names], terms)
    if parts is None:
        return _Rows(columns, rows, terms).value(expression)
    values = [
        _Rows(dict(zip(names, typed, strict=True)), len(at), terms).value(expression)
        for at, typed in parts
    ]
    return scatter([at for at, _ in parts], values, terms.dictionary)


def _compared(call: Call, columns: Mapping[str, ObjectColumn]) -> ObjectColumn | None:
    """Compare a variable's numbers with a constant in one call of numpy; None if ``call`` is
    something else or may need more than float64."""
    comparison = _comparison(call)
    if comparison is None:
        return None
    name, variable, numbers = comparison
    column = columns.get(variable)
    number = None if column is None else numbers.get(column.kind)
    if column is None or number is None:
        return None
    return ObjectColumn(Kind.BOOLEAN, _ORDER[name](column.values, number), column.null)


@ObjectCache
def _comparison(call: Call) -> tuple[str, str, Mapping[Kind, int | float]] | None:
    """Return the comparison, the variable, and the constant as a number by the kind of the
    variable's column, if the two compare as ``call`` does (§17.3: both become one type)."""
    match call:
        case Call(name, (Var(variable), Const(term))) if name in _ORDER:
            kind, value = split_term(canonical(term), lambda _: NO_TERM)
            if not kind.is_number:
                return None
            numbers: dict[Kind, int | float] = {Kind.FLOAT: float(value), Kind.DOUBLE: float(value)}
            if kind in numbers or abs(value) < _EXACT:
                numbers |= {Kind.INTEGER: float(value), Kind.DECIMAL: float(value)}
            numbers[kind] = value
            return name, variable, numbers
    return None


def split_by_kind(columns: Sequence[ObjectColumn], terms: TermValues) -> list[_Part] | None:
    """Split the rows by the sorts of the columns' terms. Return for each part its rows, and the
    columns with numbers and booleans as such; `LONG` numbers stay terms. None: no column has
    numbers or booleans as terms."""
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
        # Terms that are neither numbers nor booleans need no part of their own.
        both = signature * len(_SPLIT) + np.where(_SPLIT[sorts], sorts, 0)
        signature = np.unique(both, return_inverse=True)[1].reshape(-1)
    split = []
    for code in range(int(signature.max(initial=-1)) + 1):
        at = np.flatnonzero(signature == code)
        part = [column.take(at) for column in columns]
        for i, sorts in mixed.items():
            sort = int(sorts[at[0]])
            if Sort.INTEGER <= sort <= Sort.BOOLEAN:
                part[i] = terms.typed(part[i], Kind(sort))
        split.append((at, part))
    return split


def holds(
    expression: Expression, columns: Mapping[str, ObjectColumn], rows: int, terms: TermValues
) -> Mask:
    """Return which rows pass a FILTER with ``expression``: those where it is true."""
    compared = _compared(expression, columns) if isinstance(expression, Call) else None
    if compared is not None:
        yes, error = compared.values, compared.null
    else:
        yes, error = truth(evaluate(expression, columns, rows, terms), terms)
    return yes if error is None else yes & ~error


def truth(column: ObjectColumn, terms: TermValues) -> tuple[Mask, Mask | None]:
    """Return the effective boolean value (§17.2.2), and where it is an error."""
    if column.kind is Kind.BOOLEAN:
        return column.values.astype(np.bool_), column.null
    if column.kind is Kind.TERM:
        sorts = terms.sorts(column.values)
        none = (sorts == Sort.NODE) | (sorts == Sort.OTHER)
        return terms.true(column.values) & ~none, either(column.null, none)
    yes: Mask = (column.values != 0) & ~np.isnan(column.values)
    return yes, column.null


class _Rows:
    """Rows whose columns have one kind each: evaluates one expression."""

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
        """Apply an operator or function. Computed arguments may have several kinds: split again."""
        parts = split_by_kind(columns, self.terms)
        if parts is None:
            return self._operation(name, columns)
        values = [_Rows({}, len(at), self.terms)._operation(name, typed) for at, typed in parts]
        return scatter([at for at, _ in parts], values, self.terms.dictionary)

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
        """IF: an error of the condition is an error of the result."""
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
            # Take the kind of the first column with values, so that numbers stay numbers.
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
        # A TERM column here contains no numbers (`split_by_kind`): kinds differ, so terms do.
        return _boolean(np.zeros(self.rows, np.bool_), null)

    def _latest(self, columns: list[ObjectColumn]) -> ObjectColumn:
        """Return the greatest time of each row; null if it has none."""
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
        # An error does not matter if the other side is false (&&) or true (||) for certain.
        decides_a = (~a if name == "&&" else a) & ~a_error
        decides_b = (~b if name == "&&" else b) & ~b_error
        decided = decides_a | decides_b
        result = np.where(decided, name == "||", result)
        return _boolean(result, (a_error | b_error) & ~decided)

    def _number(self, column: ObjectColumn) -> Kind | None:
        """Return the kind of a column's numbers, or None."""
        if column.kind is not Kind.TERM:
            return column.kind if column.kind.is_number else None
        sort = int(self.terms.sorts(column.values[:1])[0]) if len(column) else Sort.OTHER
        # `split_by_kind` has separated long numbers: the first stands for all.
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
                    # Ill-typed literals and nodes have no order.
                    doubtful &= (one != Sort.ILL_TYPED) & (one != Sort.NODE)
        else:
            same, doubtful = np.zeros(self.rows, np.bool_), other
        if null is not None:
            doubtful = doubtful & ~null
        if not equality:
            certain = _boolean(same, np.ones(self.rows, np.bool_))
        else:
            certain = _boolean(same if name == "=" else ~same, null)
        return self._or_foreign(name, [a, b], certain, doubtful)

    def _or_foreign(
        self, name: str, columns: list[ObjectColumn], certain: ObjectColumn, doubtful: Mask
    ) -> ObjectColumn:
        """Return ``certain``, but Oxigraph's result of the operator in doubtful rows."""
        if not np.any(doubtful):
            return certain
        at, rest = np.flatnonzero(doubtful), np.flatnonzero(~doubtful)
        names = [f"\0v{i}" for i in range(len(columns))]
        inputs = {name: column.take(at) for name, column in zip(names, columns, strict=True)}
        call = Call(name, tuple(map(Var, names)))
        foreign = ask(call, inputs, len(at), self.terms)
        return scatter([at, rest], [foreign, certain.take(rest)], self.terms.dictionary)

    def _ordered(self, name: str, a: ObjectColumn, b: ObjectColumn, kind: Kind) -> Mask:
        """Compare numbers after promotion to ``kind``."""
        test = _ORDER[name]
        if a.kind is b.kind is not Kind.TERM:
            found: Mask = test(a.values, b.values)
            return found
        x, y = self.terms.approximate(a), self.terms.approximate(b)
        found = test(x, y)
        if kind in (Kind.FLOAT, Kind.DOUBLE):
            return found
        # Exact numbers are ordered as their floats, but distinct ones may have equal floats.
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
            return self._or_foreign(name, [a, b], self._unbound(), self._is_other(a, b))
        null, kind = either(a.null, b.null), max(left, right)
        if kind in (Kind.FLOAT, Kind.DOUBLE):
            x, y = self.terms.approximate(a), self.terms.approximate(b)
            with np.errstate(all="ignore"):
                return ObjectColumn(kind, _ARITHMETIC[name](x, y), null)
        if name == "/":
            # A long number is never 0, though its float may be.
            kind, zero = Kind.DECIMAL, (b.values == 0) & (b.kind is not Kind.TERM)
            if zero.any():
                null = either(null, zero)
                b = ObjectColumn(b.kind, np.where(zero, 1, b.values))
        if kind is Kind.INTEGER and a.kind is b.kind is Kind.INTEGER:
            with np.errstate(all="ignore"):
                size = np.abs(_ARITHMETIC[name](a.values.astype(np.float64), b.values))
            values, exact = _ARITHMETIC[name](a.values, b.values), size < 2.0**62
        else:
            found = self._combined(name, a, b, null)
            if found is None:
                values, exact = np.zeros(self.rows, kind.dtype), np.zeros(self.rows, np.bool_)
            else:
                values, exact = found
        column = ObjectColumn(kind, values, null)
        exact = exact if null is None else exact | null
        if exact.all():
            return column
        return self._or_exact(column, exact, lambda x, y: decimals.compute(name, x, y), [a, b])

    def _combined(
        self, name: str, a: ObjectColumn, b: ObjectColumn, null: Mask | None
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]] | None:
        """Return the codes of decimal results, and which are exact; None: none is."""
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
        return decimals.combine(name, *sides)

    def _or_exact(
        self,
        column: ObjectColumn,
        exact: NDArray[np.bool_],
        operation: Callable[..., Decimal | None],
        arguments: Sequence[ObjectColumn],
    ) -> ObjectColumn:
        """Return the column, but ``operation`` of Python decimals in rows that are not exact."""
        at, rest = np.flatnonzero(~exact), np.flatnonzero(exact)
        rows = at.tolist()
        sides = [self.terms.exact(argument, rows) for argument in arguments]
        values = [operation(*numbers) for numbers in zip(*sides, strict=True)]
        found = exact_column(column.kind, values, self.terms.dictionary.transient_id)
        return scatter([at, rest], [found, column.take(rest)], self.terms.dictionary)

    def _is_other(self, *columns: ObjectColumn) -> NDArray[np.bool_]:
        """Where all columns are bound, and one is a literal that Oxigraph may compute with."""
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
            return self._or_foreign(name, [a], self._unbound(), self._is_other(a))
        if a.kind is Kind.TERM or (a.kind is Kind.INTEGER and _is_least(name, a)):
            nothing = ObjectColumn(kind, np.zeros(self.rows, kind.dtype), a.null)
            exact = ~a.present
            return self._or_exact(nothing, exact, lambda x: decimals.round_number(name, x), [a])
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
    """Whether the function negates the least int64, which has no counterpart in 64 bits."""
    return name in ("NEGATE", "ABS") and bool(np.any(a.values == np.iinfo(np.int64).min))


def _round(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """ROUND of floats: halves round towards positive infinity, -0.4 to -0 (XPath F&O §4.4.4)."""
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
