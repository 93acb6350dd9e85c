"""The value of a literal: sort, number, boolean value, canonical spelling (SPARQL 1.1 §17.1-17.2).

`relation.TermValues` caches it by the ids of a dictionary.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from decimal import Decimal
from enum import IntEnum

import numpy as np
from pyoxigraph import Literal, NamedNode, Quad, Store

from ...rdf.datatypes import INTEGERS
from ...rdf.dictionary import Term
from ...rdf.namespaces import RDF, XSD
from ...rdf.timed import DATATYPES, Kind, make_literal
from . import decimals


class Sort(IntEnum):
    """The sort of a term; up to ``BOOLEAN`` the numbers are those of `Kind`.

    ``LONG_INTEGER``, ``LONG_DECIMAL``: numbers that fit no column. ``ILL_TYPED``: a literal with
    the datatype of a number or boolean but no such value (`join_kernel.LONGS`: these three).
    """

    OTHER = 0
    INTEGER = 1
    DECIMAL = 2
    FLOAT = 3
    DOUBLE = 4
    BOOLEAN = 5
    NODE = 6
    STRING = 7
    TEXT = 8
    LONG_INTEGER = 9
    LONG_DECIMAL = 10
    ILL_TYPED = 11


_WHOLE = re.compile(r"[+-]?[0-9]+")
_DECIMAL = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)")
_NUMBER = re.compile(_DECIMAL.pattern + r"(?:[eE][+-]?[0-9]+)?|[+-]?INF|NaN")
_ANY = NamedNode(XSD + "any")
_FLOATS = {XSD + "float": Sort.FLOAT, XSD + "double": Sort.DOUBLE}
LONG = (Sort.LONG_INTEGER, Sort.LONG_DECIMAL)


@dataclass(frozen=True, slots=True)
class LiteralValue:
    """The value of a term: see `TermValues`; ``long``: that of a `LONG` number."""

    sort: Sort
    number: float = 0.0
    integer: int = 0
    true: bool = False
    long: Decimal | None = None


def value_of(term: Term) -> LiteralValue:
    """Return the value of a term; an IRI or blank node only has a sort."""
    if not isinstance(term, Literal):
        return LiteralValue(Sort.NODE)
    datatype, text = term.datatype.value, term.value
    if datatype == XSD + "string":
        return LiteralValue(Sort.STRING, true=bool(text))
    if datatype == RDF + "langString":
        return LiteralValue(Sort.TEXT, true=bool(text))
    if datatype == XSD + "boolean":
        if text not in ("true", "false", "1", "0"):
            return LiteralValue(Sort.ILL_TYPED)
        true = text in ("true", "1")
        return LiteralValue(Sort.BOOLEAN, integer=int(true), true=true)
    if datatype in _FLOATS:
        if not _NUMBER.fullmatch(text):
            return LiteralValue(Sort.ILL_TYPED)
        number = float(text)
        return LiteralValue(_FLOATS[datatype], number, true=number == number and number != 0)
    is_integer = datatype in INTEGERS
    if not is_integer and datatype != XSD + "decimal":
        return LiteralValue(Sort.OTHER)
    exact = decimals.parse(text) if (_WHOLE if is_integer else _DECIMAL).fullmatch(text) else None
    if exact is None:
        return LiteralValue(Sort.ILL_TYPED)
    number, true = float(exact) + 0.0, bool(exact)
    if is_integer:
        if -(2**63) <= exact < 2**63:
            return LiteralValue(Sort.INTEGER, number, int(exact), true)
        return LiteralValue(Sort.LONG_INTEGER, number, 0, true, exact)
    if np.isfinite(number) and decimals.of_code(number) == exact:
        return LiteralValue(Sort.DECIMAL, number, 0, true)
    return LiteralValue(Sort.LONG_DECIMAL, number, 0, true, exact)


def canonical(term: Term) -> Term:
    """Return the canonical spelling of a literal's value, as in Oxigraph's store: 1e2 becomes 100,
    3.0 becomes 3.

    All integer types become xsd:integer there. Strings, IRIs and literals without a value do not
    change.
    """
    if not isinstance(term, Literal) or term.language is not None:
        return term
    datatype = term.datatype.value
    if datatype == XSD + "string":
        return term
    found = value_of(term)
    match found.sort:
        case Sort.INTEGER:
            return Literal(str(found.integer), datatype=DATATYPES[Kind.INTEGER])
        case Sort.BOOLEAN:
            return Literal(bool(found.integer))
        case Sort.FLOAT | Sort.DOUBLE | Sort.DECIMAL:
            return make_literal(Kind(int(found.sort)), found.number)
        case Sort.LONG_INTEGER | Sort.LONG_DECIMAL:
            assert found.long is not None
            is_integer = found.sort is Sort.LONG_INTEGER
            return exact_literal(Kind.INTEGER if is_integer else Kind.DECIMAL, found.long)
        case Sort.ILL_TYPED:
            return term
    return _stored(term)


def exact_literal(kind: Kind, number: Decimal) -> Literal:
    """Return an INTEGER or DECIMAL of any size as a literal in canonical form."""
    return Literal(decimals.text(number), datatype=DATATYPES[kind])


def _stored(literal: Literal) -> Literal:
    """Store a literal in Oxigraph and read it back."""
    store = Store()
    store.add(Quad(_ANY, _ANY, literal))
    [quad] = store
    assert isinstance(quad.object, Literal)
    return quad.object
