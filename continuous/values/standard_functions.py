"""Functions of SPARQL 1.1 that Oxigraph has otherwise, for it to call (§17.2.2, §17.3).

It gives a text with a language no boolean value, booleans no order, and IRIs and texts with a
language one; it has no integers beyond 64 bits. `standard_rewrite` puts calls of these functions
into a query instead.
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
from .literals import Sort, Worth, value_of

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
    worth = value_of(term)
    return None if worth.sort in (Sort.NODE, Sort.OTHER) else Literal(worth.true)


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


def _number(worth: Worth) -> Decimal | float | None:
    """The value of a number, an exact one as a decimal; None of what is none."""
    match worth.sort:
        case Sort.LONG_INTEGER | Sort.LONG_DECIMAL:
            return worth.long
        case Sort.INTEGER:
            return Decimal(worth.integer)
        case Sort.DECIMAL:
            return of_code(worth.number)
        case Sort.FLOAT | Sort.DOUBLE:
            return worth.number
    return None


def _oxigraph(sign: str, left: Term, right: Term) -> Literal | None:
    """The order of dates and durations, which it has as the standard."""
    text = f"SELECT ({term_text(left)} {sign} {term_text(right)} AS ?found) WHERE {{}}"
    found = Store().query(text)
    assert isinstance(found, QuerySolutions)
    answer = next(found)["found"]
    return answer if isinstance(answer, Literal) else None


FUNCTIONS: Final[dict[NamedNode, Callable[..., Any]]] = {
    TRUTH: _truth,
    **{iri: _ordering(sign) for sign, iri in ORDER.items()},
}
"""Terms in, a boolean out; None where there is an error."""
