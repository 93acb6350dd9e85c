"""Functions of SPARQL 1.1 that Oxigraph implements otherwise, for it to call (§17.2.2, §17.3).

In Oxigraph a text with a language has no boolean value, booleans have no order, but IRIs and texts
with a language do; integers have 64 bits. `standard_rewrite` puts calls of these functions into a
query instead.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from decimal import Decimal
from typing import Any, Final

from pyoxigraph import Literal, NamedNode, QuerySolutions, Store

from ...rdf.dictionary import Term
from ...sparql.terms import term_text
from .decimals import of_code
from .literals import LiteralValue, Sort, value_of

TRUTH: Final = NamedNode("urn:dyknow:truth")
ORDER: Final = {
    sign: NamedNode(f"urn:dyknow:{name}")
    for sign, name in (("<", "less"), (">", "greater"), ("<=", "at-most"), (">=", "at-least"))
}
_TESTS: Final[dict[str, Callable[[Any, Any], bool]]] = {
    "<": operator.lt,
    ">": operator.gt,
    "<=": operator.le,
    ">=": operator.ge,
}


def _truth(term: Term) -> Literal | None:
    value = value_of(term)
    return None if value.sort in (Sort.NODE, Sort.OTHER) else Literal(value.true)


def _ordering(sign: str) -> Callable[[Term, Term], Literal | None]:
    test = _TESTS[sign]

    def ordered(left: Term, right: Term) -> Literal | None:
        a, b = value_of(left), value_of(right)
        if a.sort is b.sort is Sort.BOOLEAN:
            return Literal(test(a.integer, b.integer))
        if a.sort is b.sort is Sort.STRING:
            return Literal(test(left.value, right.value))
        x, y = _number(a), _number(b)
        if x is not None and y is not None:
            is_float = isinstance(x, float) or isinstance(y, float)
            return Literal(test(float(x), float(y)) if is_float else test(x, y))
        return _oxigraph(sign, left, right) if a.sort is b.sort is Sort.OTHER else None

    return ordered


def _number(value: LiteralValue) -> Decimal | float | None:
    """Return the value of a number, as a decimal if it is exact; None for other terms."""
    match value.sort:
        case Sort.LONG_INTEGER | Sort.LONG_DECIMAL:
            return value.long
        case Sort.INTEGER:
            return Decimal(value.integer)
        case Sort.DECIMAL:
            return of_code(value.number)
        case Sort.FLOAT | Sort.DOUBLE:
            return value.number
    return None


def _oxigraph(sign: str, left: Term, right: Term) -> Literal | None:
    """Compare dates and durations, which Oxigraph does as the standard says."""
    text = f"SELECT ({term_text(left)} {sign} {term_text(right)} AS ?found) WHERE {{}}"
    found = Store().query(text)
    assert isinstance(found, QuerySolutions)
    answer = next(found)["found"]
    return answer if isinstance(answer, Literal) else None


FUNCTIONS: Final[dict[NamedNode, Callable[..., Any]]] = {
    TRUTH: _truth,
    **{iri: _ordering(sign) for sign, iri in ORDER.items()},
}
"""Functions of terms that return a boolean, or None for an error."""
