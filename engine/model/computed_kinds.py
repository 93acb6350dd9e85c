"""Infers the kind of number or boolean that an expression yields (SPARQL 1.1 §17.3-17.4).
`result_schema` types the fields of output streams by it, before there are data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from typing import Final

from pyoxigraph import Literal

from ...continuous.algebra.expressions import (
    ARITHMETIC,
    COMPARISONS,
    Call,
    Const,
    Expression,
    Var,
)
from ...languages.csparql.functions import ACCESSORS
from ...rdf.datatypes import INTEGERS
from ...rdf.timed import DATATYPES, Kind

_BOOLEANS: Final = frozenset(
    {*COMPARISONS, "&&", "||", "!", "BOUND", "SAMETERM", "ISIRI", "ISBLANK", "ISLITERAL"}
    | {"ISNUMERIC", "REGEX", "CONTAINS", "STRSTARTS", "STRENDS", "LANGMATCHES"}
)
_INTEGERS: Final = frozenset(
    {"STRLEN", "YEAR", "MONTH", "DAY", "HOURS", "MINUTES"} | {f"<{iri}>" for iri in ACCESSORS}
)
_SAME: Final = frozenset({"NEGATE", "ABS", "CEIL", "FLOOR", "ROUND"})
_KINDS: Final = {datatype.value: kind for kind, datatype in DATATYPES.items()}
_CASTS: Final = {f"<{datatype}>": kind for datatype, kind in _KINDS.items()}


def kind_of(
    expression: Expression, kinds: Mapping[str, Kind], others: Set[str] = frozenset()
) -> Kind | None:
    """Return the kind of the values of ``expression``; None if unknown, or if they are neither
    numbers nor booleans.

    ``kinds`` are the kinds of variables, ``others`` the variables with other values. Arithmetic on
    variables of unknown kind yields DOUBLE, which has room for any number.
    """
    match expression:
        case Var(name):
            return kinds.get(name)
        case Const(term):
            return kind_of_datatype(term.datatype.value) if isinstance(term, Literal) else None
        case Call(name, arguments):
            if name in _BOOLEANS:
                return Kind.BOOLEAN
            if name in _INTEGERS:
                return Kind.INTEGER
            if name in _CASTS:
                return _CASTS[name]
            if name == "RAND":
                return Kind.DOUBLE
            if name == "SECONDS":
                return Kind.DECIMAL
            if name in ("IF", "COALESCE"):
                results = arguments[1:] if name == "IF" else arguments
                return common_kind([kind_of(one, kinds, others) for one in results])
            if name in _SAME or name in ARITHMETIC:
                return _arithmetic_kind(name, arguments, kinds, others)
    return None


def common_kind(found: Sequence[Kind | None]) -> Kind | None:
    """Return the narrowest kind that holds the values of all of these; None if there is none."""
    kinds = {kind for kind in found if kind is not None}
    if None in found or not kinds:
        return None
    if len(kinds) > 1 and not all(kind.is_number for kind in kinds):
        return None
    return max(kinds)


def _arithmetic_kind(
    name: str, arguments: Sequence[Expression], kinds: Mapping[str, Kind], others: Set[str]
) -> Kind | None:
    if any(isinstance(one, Var) and one.name in others for one in arguments):
        return None
    found = [kind_of(one, kinds, others) for one in arguments]
    numbers = [kind for kind in found if kind is not None and kind.is_number]
    if len(numbers) < len(found):
        return Kind.DOUBLE if name in ARITHMETIC else None
    least = Kind.DECIMAL if name == "/" else Kind.INTEGER
    return max(least, *numbers)


def kind_of_datatype(datatype: str | None) -> Kind | None:
    """Return the kind of a datatype's values; None if they are neither numbers nor booleans. A
    datatype derived from xsd:integer has integers."""
    return Kind.INTEGER if datatype in INTEGERS else _KINDS.get(datatype or "")
