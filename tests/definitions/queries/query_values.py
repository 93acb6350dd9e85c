"""Expressions of SPARQL by their definition (SPARQL 1.1 §17, §18.5.1).

A number is its datatype and a value; integers and decimals are exact, quotients as
docs/explanation/semantics.md says. Where SPARQL leaves room, the choice is stated: terms of
different known datatypes are unequal, not an error (§17.3.1 allows it).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from datetime import datetime
from fractions import Fraction
from typing import Any

from pyoxigraph import BlankNode, Literal, NamedNode

XSD = "http://www.w3.org/2001/XMLSchema#"
KINDS = ("integer", "decimal", "float", "double")
TRUE, FALSE = Literal(True), Literal(False)


class Failed(Exception):
    """The expression has no value: an error in the sense of §17.2."""


class Undetermined(Exception):
    """The definition admits several results (an order that is not total)."""


def kind_of(term: Any) -> str | None:
    if isinstance(term, Literal) and term.datatype.value.startswith(XSD):
        return term.datatype.value.removeprefix(XSD)
    return None


def number(term: Any) -> tuple[str, Any] | None:
    """The datatype's local name and the value: exact, or a float where it is not finite."""
    kind = kind_of(term)
    if kind not in KINDS:
        return None
    text = term.value
    if kind in ("float", "double"):
        return kind, float(text.replace("INF", "inf"))
    return kind, Fraction(text)


def literal(kind: str, value: Any) -> Literal:
    datatype = NamedNode(XSD + kind)
    if kind == "integer":
        return Literal(str(int(value)), datatype=datatype)
    if kind == "decimal":
        return Literal(decimal_text(Fraction(value)), datatype=datatype)
    rounded = nearest(value)
    if math.isnan(rounded):
        return Literal("NaN", datatype=datatype)
    if math.isinf(rounded):
        return Literal("INF" if rounded > 0 else "-INF", datatype=datatype)
    text = str(int(rounded)) if rounded == int(rounded) else repr(rounded)
    return Literal(
        "-0" if rounded == 0 and math.copysign(1, rounded) < 0 else text, datatype=datatype
    )


def nearest(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return math.inf if value > 0 else -math.inf


def decimal_text(value: Fraction) -> str:
    """All digits of a decimal that ends."""
    places = next(k for k in range(2000) if (value * 10**k).denominator == 1)
    digits = str(abs(value.numerator * 10**places // value.denominator)).rjust(places + 1, "0")
    text = digits[: len(digits) - places] + ("." + digits[len(digits) - places :] if places else "")
    return "-" + text if value < 0 else text


def quotient(a: Fraction, b: Fraction) -> Fraction:
    """Exact within 18 digits after the point or 15 significant ones; else rounded, half to even, to
    15 significant digits, or to an integer where that keeps more
    (docs/explanation/semantics.md)."""
    found = a / b
    for places in range(60):
        digits = found * 10**places
        if digits.denominator == 1 and (places <= 18 or abs(digits) < 10**15):
            return found
    places = next(k for k in range(60) if abs(found) * 10**k >= 10**14)
    return Fraction(round(found * 10**places), 10**places)


def boolean(value: bool) -> Literal:
    return TRUE if value else FALSE


def effective(term: Any) -> bool:
    """The effective boolean value (§17.2.2): plain literals are those with a language, too; an
    ill-typed number or boolean is false."""
    kind = kind_of(term)
    if kind == "boolean":
        return term.value == "true"
    if kind == "string" or (isinstance(term, Literal) and term.language):
        return term.value != ""
    found = number(term)
    if found is None:
        raise Failed
    return found[1] != 0 and found[1] == found[1]


def instant(term: Literal) -> Fraction:
    """A dateTime with a time zone, in seconds, however many digits its seconds have."""
    whole, _, rest = term.value.partition(".")
    if not rest:
        return Fraction(int(datetime.fromisoformat(whole.replace("Z", "+00:00")).timestamp()))
    digits = rest.rstrip("Z")
    at = int(datetime.fromisoformat(whole + "+00:00").timestamp())
    return at + Fraction(int(digits), 10 ** len(digits))


def comparable(term: Any) -> tuple[str, Any] | None:
    """A value space and the place in it, of what ``<`` knows (§17.3)."""
    found = number(term)
    if found is not None:
        return "number", found[1]
    kind = kind_of(term)
    if kind == "string":
        return "string", term.value
    if kind == "boolean":
        return "boolean", term.value == "true"
    if kind == "dateTime":
        return "dateTime", instant(term)
    return None


def promoted(a: Any, b: Any) -> tuple:
    """What ``<`` compares: two numbers are doubles if one is (§17.3)."""
    x, y = comparable(a), comparable(b)
    if x and y and x[0] == y[0] == "number" and float in map(type, (x[1], y[1])):
        return ("number", nearest(x[1])), ("number", nearest(y[1]))
    return x, y


def equal(a: Any, b: Any) -> bool:
    x, y = promoted(a, b)
    if x and y and x[0] == y[0]:
        return x[1] == y[1]
    return a == b


def less(a: Any, b: Any) -> bool:
    x, y = promoted(a, b)
    if not x or not y or x[0] != y[0]:
        raise Failed
    return x[1] < y[1]


def not_less(a: Any, b: Any) -> bool:
    """``a >= b``, false for NaN."""
    return less(b, a) or equal(a, b)


def arithmetic(sign: str, a: Any, b: Any) -> Literal:
    x, y = number(a), number(b)
    if x is None or y is None:
        raise Failed
    kind = max(x[0], y[0], key=KINDS.index)
    if kind in ("float", "double"):
        return literal(kind, inexact(sign, nearest(x[1]), nearest(y[1])))
    if sign == "/":
        if y[1] == 0:
            raise Failed
        return literal("decimal", quotient(x[1], y[1]))
    return literal(kind, OPERATIONS[sign](x[1], y[1]))


OPERATIONS: dict[str, Callable[[Any, Any], Any]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "/": lambda a, b: a / b,
}


def inexact(sign: str, a: float, b: float) -> float:
    if sign == "/" and b == 0:
        sign_of = math.copysign(1, a) * math.copysign(1, b)
        return math.nan if a == 0 or math.isnan(a) else math.copysign(math.inf, sign_of)
    return OPERATIONS[sign](a, b)


def text_of(term: Any) -> str:
    """STR()."""
    if isinstance(term, BlankNode):
        raise Failed
    if kind_of(term) in ("float", "double") and abs(float(term.value)) >= 1e15:
        # A literal is its value; with or without an exponent, the spelling is open.
        raise Undetermined
    return term.value


def string(term: Any) -> str:
    """The text of an argument that must be a string, of a language or of none."""
    if not isinstance(term, Literal) or (kind_of(term) != "string" and not term.language):
        raise Failed
    return term.value


def two_strings(a: Any, b: Any) -> tuple[str, str]:
    """The texts of compatible arguments (§17.4.3.1.2)."""
    x, y = string(a), string(b)
    if b.language and a.language != b.language:
        raise Failed
    return x, y


def upper(term: Any) -> Literal:
    text = string(term).upper()
    return Literal(text, language=term.language) if term.language else Literal(text)


def absolute(term: Any) -> Literal:
    found = number(term)
    if found is None:
        raise Failed
    return literal(found[0], abs(found[1]))


def rounding(exact: Callable[[Fraction], int]) -> Callable[[Any], Literal]:
    """CEIL, FLOOR or ROUND; of a double the sign stays (XPath F&O §4.4)."""

    def rounded(term: Any) -> Literal:
        found = number(term)
        if found is None:
            raise Failed
        kind, value = found
        if isinstance(value, float):
            if not math.isfinite(value):
                return literal(kind, value)
            return literal(kind, math.copysign(exact(Fraction(value)), value))
        return literal(kind, exact(value))

    return rounded


def datatype(term: Any) -> NamedNode:
    if not isinstance(term, Literal):
        raise Failed
    return term.datatype


def language(term: Any) -> Literal:
    if not isinstance(term, Literal):
        raise Failed
    return Literal(term.language or "")


def concatenation(*terms: Any) -> Literal:
    texts = [string(term) for term in terms]
    tags = {term.language for term in terms}
    tag = tags.pop() if len(tags) == 1 else None
    return Literal("".join(texts), language=tag) if tag else Literal("".join(texts))


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "=": lambda a, b: boolean(equal(a, b)),
    "!=": lambda a, b: boolean(not equal(a, b)),
    "<": lambda a, b: boolean(less(a, b)),
    ">": lambda a, b: boolean(less(b, a)),
    "<=": lambda a, b: boolean(not_less(b, a)),
    ">=": lambda a, b: boolean(not_less(a, b)),
    "+": lambda a, b: arithmetic("+", a, b),
    "-": lambda a, b: arithmetic("-", a, b),
    "*": lambda a, b: arithmetic("*", a, b),
    "/": lambda a, b: arithmetic("/", a, b),
    "!": lambda a: boolean(not effective(a)),
    "sameTerm": lambda a, b: boolean(a == b),
    "isIRI": lambda a: boolean(isinstance(a, NamedNode)),
    "isLiteral": lambda a: boolean(isinstance(a, Literal)),
    "isBlank": lambda a: boolean(isinstance(a, BlankNode)),
    "isNumeric": lambda a: boolean(number(a) is not None),
    "STR": lambda a: Literal(text_of(a)),
    "STRLEN": lambda a: literal("integer", len(string(a))),
    "UCASE": upper,
    "ABS": absolute,
    "CEIL": rounding(math.ceil),
    "FLOOR": rounding(math.floor),
    "ROUND": rounding(lambda value: math.floor(value + Fraction(1, 2))),
    "DATATYPE": datatype,
    "LANG": language,
    "CONCAT": concatenation,
    "CONTAINS": lambda a, b: boolean((t := two_strings(a, b))[1] in t[0]),
    "STRSTARTS": lambda a, b: boolean((t := two_strings(a, b))[0].startswith(t[1])),
}


# --- order (§15.1) and aggregates (§18.5.1)


def precedes(a: Any, b: Any) -> bool | None:
    """Whether ``a`` stands before ``b`` in ORDER BY; None where the text does not say."""
    if a == b:
        return False
    ranks = [rank(a), rank(b)]
    if ranks[0] != ranks[1]:
        return ranks[0] < ranks[1]
    if isinstance(a, NamedNode):
        return a.value < b.value
    try:
        if less(a, b):
            return True
        return False if less(b, a) else None
    except Failed:
        return None


def rank(term: Any) -> int:
    if term is None:
        return 0
    return 1 if isinstance(term, BlankNode) else 2 if isinstance(term, NamedNode) else 3


class OneOf:
    """Any of these is right (SAMPLE, extremes that are tied, an order of concatenation)."""

    def __init__(self, terms: list) -> None:
        self.terms = terms


def aggregate(function: str, values: list, separator: str | None) -> Any:
    """The value over a group; ``values`` holds None for an expression that failed."""
    if function == "COUNT":
        return literal("integer", sum(value is not None for value in values))
    if function == "SAMPLE":
        found = [value for value in values if value is not None]
        if not found:
            raise Failed
        return OneOf(found)
    if None in values:
        raise Failed
    if function == "GROUP_CONCAT":
        return joined([string(value) for value in values], " " if separator is None else separator)
    if function in ("MIN", "MAX"):
        return extreme(values, function == "MIN")
    total = literal("integer", 0)
    numbers = [number(value) for value in values]
    if None in numbers:
        raise Failed
    if numbers:
        kind = max((n[0] for n in numbers), key=KINDS.index)
        total = literal(kind, exact_sum([n[1] for n in numbers]))
        if function == "AVG":
            total = arithmetic("/", total, literal("integer", len(numbers)))
    return total


def exact_sum(values: list) -> Any:
    """Doubles are added exactly and rounded once; infinities and NaN as floats are."""
    odd = [v for v in values if isinstance(v, float) and not math.isfinite(v)]
    return sum(odd) if odd else sum(map(Fraction, values))


def joined(texts: list[str], separator: str) -> Any:
    """Any order: so of all that have these parts, compared as sorted parts."""
    if len(texts) < 2:
        return Literal(separator.join(texts))
    return AnyOrder(texts, separator)


class AnyOrder(OneOf):
    """The parts of a GROUP_CONCAT in any order; no part holds the separator."""

    def __init__(self, texts: list[str], separator: str) -> None:
        super().__init__([Literal(separator.join(texts))])
        self.parts, self.separator = sorted(texts), separator


def extreme(values: list, least: bool) -> Any:
    """Those that nothing else certainly precedes (or follows)."""
    if not values:
        raise Failed
    found = [number(value) for value in values]
    if None not in found:
        # A NaN is the extreme of numbers, as of fn:min and fn:max.
        odd = [kind for kind, value in found if value != value]
        if odd:
            return literal(max(odd, key=KINDS.index), math.nan)
    unequal = list(dict.fromkeys(values))
    best = [
        a
        for a in unequal
        if not any((precedes(b, a) if least else precedes(a, b)) is True for b in unequal)
    ]
    if all(number(term) and equal(term, best[0]) for term in best):
        # Of equal numbers the one of the first kind.
        return min(best, key=lambda term: KINDS.index(kind_of(term) or ""))
    return best[0] if len(best) == 1 else OneOf(best)
