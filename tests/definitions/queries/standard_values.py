"""SPARQL's operators and aggregates on literals, as the standards define them.

Oxigraph calls them in the differential test where its own operators differ from SPARQL 1.1 or
stop at 64 bits (`CORRECTED` in ``tests/laws/continuous/test_differential.py``). Numbers are exact:
integers are Python's, decimals are fractions. Slow on purpose, and written without the product's
code. Where the standard leaves the answer open a function returns `ANY`, which equals any term.
Over 400 lines: one short function for each operator and aggregate.
"""

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fractions import Fraction
from functools import partial
from typing import Any

from pyoxigraph import BlankNode, Literal, NamedNode

Term = NamedNode | BlankNode | Literal

XSD = "http://www.w3.org/2001/XMLSchema#"
LANG_STRING = "http://www.w3.org/1999/02/22-rdf-syntax-ns#langString"
ERROR = NamedNode("urn:oracle:error")
ANY = NamedNode("urn:oracle:any")
KINDS = ("integer", "decimal", "float", "double")


class Undefined(Exception):
    """SPARQL's type error."""


class Open(Exception):
    """The standard leaves open what an expression over `ANY` gives."""


@dataclass(frozen=True)
class Number:
    kind: str
    value: Fraction | float

    @property
    def exact(self) -> bool:
        return self.kind in ("integer", "decimal")


def literal(kind: str, lexical: str) -> Literal:
    return Literal(lexical, datatype=NamedNode(XSD + kind))


def boolean(value: bool) -> Literal:
    return literal("boolean", "true" if value else "false")


def number(term: Term) -> Number | None:
    """The number of a well-formed numeric literal."""
    if not isinstance(term, Literal) or not term.datatype.value.startswith(XSD):
        return None
    kind = term.datatype.value.removeprefix(XSD)
    if kind not in KINDS:
        return None
    if kind in ("integer", "decimal"):
        return Number(kind, Fraction(term.value))
    return Number(kind, float(term.value))


def written(value: Number) -> Literal:
    """The canonical literal of a number; a decimal is cut behind its 18th place."""
    if value.kind == "integer":
        return literal("integer", str(int(value.value)))
    if value.kind == "decimal":
        return literal("decimal", decimal_text(Fraction(value.value)))
    double = single(value.kind, float(value.value))
    if math.isnan(double):
        return literal(value.kind, "NaN")
    if math.isinf(double):
        return literal(value.kind, "INF" if double > 0 else "-INF")
    return literal(value.kind, repr(double).replace("e", "E"))


def decimal_text(value: Fraction) -> str:
    scaled = abs(value) * 10**18
    whole, places = divmod(scaled.numerator // scaled.denominator, 10**18)
    text = f"{whole}.{places:018}".rstrip("0").rstrip(".")
    return f"-{text}" if value < 0 and text != "0" else text


def as_double(value: Number) -> float:
    if isinstance(value.value, float):
        return value.value
    try:
        return float(value.value)
    except OverflowError:
        return math.inf if value.value > 0 else -math.inf


def single(kind: str, value: float) -> float:
    """A float in single precision, a double as it is."""
    if kind != "float" or not math.isfinite(value):
        return value
    try:
        return float(struct.unpack("f", struct.pack("f", value))[0])
    except OverflowError:
        return math.copysign(math.inf, value)


# Effective boolean value (SPARQL 1.1, 17.2.2).


def effective_boolean(term: Term) -> bool:
    if term == ANY:
        raise Open
    found = number(term)
    if found is not None:
        return bool(found.value) and found.value == found.value
    if isinstance(term, Literal):
        if term.datatype.value == XSD + "boolean":
            return term.value in ("true", "1")
        if term.datatype.value in (XSD + "string", LANG_STRING):
            return term.value != ""
    raise Undefined


# Comparison (SPARQL 1.1, 17.3; XPath F&O 6.3, 9.2, 10.4).


def order(left: Term, right: Term) -> int | None:
    """Less, equal or greater of two ordered values of one kind; none for NaN."""
    a, b = number(left), number(right)
    if a is not None and b is not None:
        return compare_numbers(a, b)
    kind = kind_of(left)
    if kind != kind_of(right) or kind not in ("string", "boolean", "dateTime"):
        raise Undefined
    assert isinstance(left, Literal)
    assert isinstance(right, Literal)
    if kind == "dateTime":
        return compare_instants(left.value, right.value)
    return (left.value > right.value) - (left.value < right.value)


def compare_numbers(a: Number, b: Number) -> int | None:
    if a.exact and b.exact:
        return (a.value > b.value) - (a.value < b.value)
    kind = max(a.kind, b.kind, key=KINDS.index)
    x, y = single(kind, as_double(a)), single(kind, as_double(b))
    return None if math.isnan(x) or math.isnan(y) else (x > y) - (x < y)


def kind_of(term: Term) -> str:
    """The value space of a term: number, string, boolean, dateTime, language, node or unknown."""
    if not isinstance(term, Literal):
        return "node"
    if number(term) is not None:
        return "number"
    datatype = term.datatype.value
    if datatype == LANG_STRING:
        return "language"
    name = datatype.removeprefix(XSD)
    return (
        name
        if datatype.startswith(XSD) and name in ("string", "boolean", "dateTime")
        else "unknown"
    )


def compare_instants(left: str, right: str) -> int:
    """XML Schema 3.2.7.4: without a zone an instant is somewhere within 14 hours."""
    a, b = instant(left), instant(right)
    if (a.tzinfo is None) == (b.tzinfo is None):
        return (a > b) - (a < b)
    if a.tzinfo is None:
        return -compare_instants(right, left)
    local = b.replace(tzinfo=UTC)
    if a < local - timedelta(hours=14):
        return -1
    if a > local + timedelta(hours=14):
        return 1
    raise Open  # XPath's implicit timezone is the implementation's


def instant(text: str) -> datetime:
    return datetime.fromisoformat(text.replace("Z", "+00:00"))


def equal(left: Term, right: Term) -> bool:
    """`=`: by value where both kinds are known, else RDFterm-equal (17.4.1.7)."""
    if left == ANY or right == ANY:
        raise Open
    kinds = kind_of(left), kind_of(right)
    if kinds == ("number", "number") or kinds == ("dateTime", "dateTime"):
        return order(left, right) == 0
    if left == right:
        return True
    if "node" not in kinds and "unknown" in kinds:
        raise Undefined
    return False


def comparing(holds: Callable[[int], bool]) -> Callable[[Term, Term], Literal]:
    def compare(left: Term, right: Term) -> Literal:
        if left == ANY or right == ANY:
            raise Open
        found = order(left, right)
        return boolean(found is not None and holds(found))

    return compare


# Arithmetic (SPARQL 1.1, 17.3; XPath F&O 6.2, 6.4).


def arithmetic(symbol: str) -> Callable[[Term, Term], Literal]:
    def compute(left: Term, right: Term) -> Literal:
        if kind_of(left) == kind_of(right) == "dateTime":
            raise Open  # 17.3.1: an extension may know the difference of two instants
        a, b = operand(left), operand(right)
        kind = max(a.kind, b.kind, key=KINDS.index)
        if symbol == "/" and kind == "integer":
            kind = "decimal"
        if kind in ("integer", "decimal"):
            if symbol == "/" and b.value == 0:
                raise Undefined
            x, y = Fraction(a.value), Fraction(b.value)
            return written(Number(kind, EXACTLY[symbol](x, y)))
        return written(Number(kind, DOUBLES[symbol](as_double(a), as_double(b))))

    return compute


def operand(term: Term) -> Number:
    if term == ANY:
        raise Open
    found = number(term)
    if found is None:
        raise Undefined
    return found


def divide(x: float, y: float) -> float:
    """IEEE 754's division, which Python refuses by zero."""
    if y != 0 or math.isnan(x):
        return x / y if y != 0 else math.nan
    if x == 0:
        return math.nan
    return math.copysign(math.inf, x) * math.copysign(1, y)


EXACTLY: dict[str, Callable[[Fraction, Fraction], Fraction]] = {
    "+": lambda x, y: x + y,
    "-": lambda x, y: x - y,
    "*": lambda x, y: x * y,
    "/": lambda x, y: x / y,
}
DOUBLES: dict[str, Callable[[float, float], float]] = {
    "+": lambda x, y: x + y,
    "-": lambda x, y: x - y,
    "*": lambda x, y: x * y,
    "/": divide,
}


def on_number(function: Callable[[Fraction], int | Fraction]) -> Callable[[Term], Literal]:
    """A function of one number that keeps its datatype; NaN and INF stay."""

    def compute(term: Term) -> Literal:
        found = operand(term)
        if isinstance(found.value, float):
            if not math.isfinite(found.value):
                return written(Number(found.kind, SPECIAL[function](found.value)))
            return written(Number(found.kind, float(function(Fraction(found.value)))))
        return written(Number(found.kind, Fraction(function(found.value))))

    return compute


def half_up(value: Fraction) -> int:
    """fn:round: a half goes to the greater neighbour."""
    return math.floor(value + Fraction(1, 2))


def negated(value: Fraction) -> Fraction:
    return -value


def magnitude(value: Fraction) -> Fraction:
    return abs(value)


SPECIAL: dict[Callable[[Fraction], int | Fraction], Callable[[float], float]] = {
    magnitude: abs,
    negated: lambda value: -value,
    math.ceil: lambda value: value,
    math.floor: lambda value: value,
    half_up: lambda value: value,
}


# Aggregates (SPARQL 1.1, 18.5.1): what fails is the term ERROR.


def total(terms: list[Term]) -> Number:
    if ERROR in terms:
        raise Undefined
    numbers = [operand(term) for term in terms]
    kind = max((found.kind for found in numbers), key=KINDS.index, default="integer")
    if kind in ("integer", "decimal"):
        return Number(kind, sum((Fraction(found.value) for found in numbers), Fraction(0)))
    return Number(kind, double_sum([as_double(found) for found in numbers]))


def double_sum(values: list[float]) -> float:
    """The exact sum, rounded once (docs/explanation/semantics.md, How it is computed)."""
    special = [value for value in values if not math.isfinite(value)]
    if special:
        return sum(special)
    exact = sum((Fraction(value) for value in values), Fraction(0))
    return as_double(Number("decimal", exact))


def average(terms: list[Term]) -> Literal:
    if not terms:
        return literal("integer", "0")
    found = total(terms)
    if found.exact:
        return written(Number("decimal", Fraction(found.value) / len(terms)))
    doubles = [as_double(operand(term)) for term in terms]
    if math.isinf(found.value) and all(map(math.isfinite, doubles)):
        exact = sum(map(Fraction, doubles), Fraction(0)) / len(terms)
        return written(Number(found.kind, as_double(Number("decimal", exact))))
    return written(Number(found.kind, divide(float(found.value), len(terms))))


def extreme(sign: int) -> Callable[[list[Term]], Term]:
    """MIN (-1) or MAX (1); ANY where the order of ORDER BY is open.

    A NaN among numbers is the result, and of equal numbers the one of the first kind
    (docs/explanation/semantics.md).
    """

    def choose(terms: list[Term]) -> Term:
        if ERROR in terms or not terms:
            raise Undefined
        numbers = [value for value in map(number, terms) if value is not None]
        if len(numbers) == len(terms):
            terms = sorted(terms, key=lambda term: KINDS.index(of_kind(term)))
            odd = [value.kind for value in numbers if value.value != value.value]
            if odd:
                return literal(max(odd, key=KINDS.index), "NaN")
        best = terms[0]
        for term in terms[1:]:
            try:
                found = node_order(best, term)
            except Undefined:
                return ANY
            if found is None:
                return ANY
            if found * sign < 0:
                best = term
        return best

    return choose


def of_kind(term: Term) -> str:
    value = number(term)
    assert value is not None
    return value.kind


def node_order(left: Term, right: Term) -> int | None:
    """ORDER BY: IRIs before literals, of each kind by its own order."""
    a, b = isinstance(left, NamedNode), isinstance(right, NamedNode)
    if a != b:
        return -1 if a else 1
    if a and b:
        return (left.value > right.value) - (left.value < right.value)
    if left == right and number(left) is None:
        return 0
    found = order(left, right)
    if found == 0 and kind_of(left) == "dateTime":
        raise Undefined  # two spellings of one instant
    return found


def count(terms: list[Term]) -> Literal:
    return literal("integer", str(len([term for term in terms if term != ERROR])))


def latest(*graphs: NamedNode) -> Literal:
    """The latest time in the names of graphs of elements; static triples have none."""
    times = [int(text) for graph in graphs if (text := graph.value.rpartition(":")[2])]
    if not times:
        raise Undefined
    return literal("integer", str(max(times)))


FUNCTIONS: dict[str, Callable[..., Term]] = {
    "ebv": lambda term: boolean(effective_boolean(term)),
    "=": lambda left, right: boolean(equal(left, right)),
    "!=": lambda left, right: boolean(not equal(left, right)),
    "<": comparing(lambda found: found < 0),
    ">": comparing(lambda found: found > 0),
    "<=": comparing(lambda found: found <= 0),
    ">=": comparing(lambda found: found >= 0),
    **{symbol: arithmetic(symbol) for symbol in "+-*/"},
    "neg": on_number(negated),
    "ABS": on_number(magnitude),
    "CEIL": on_number(math.ceil),
    "FLOOR": on_number(math.floor),
    "ROUND": on_number(half_up),
    "latest": latest,
}
AGGREGATES: dict[str, Callable[[list[Term]], Term]] = {
    "SUM": lambda terms: written(total(terms)),
    "AVG": average,
    "MIN": extreme(-1),
    "MAX": extreme(1),
    "COUNT": count,
}


class Accumulator:
    """An aggregate as Oxigraph calls it: all terms first, then the result."""

    def __init__(self, function: Callable[..., Term | None], distinct: bool) -> None:
        self.function, self.distinct = function, distinct
        self.terms: list[Term] = []

    def accumulate(self, term: Term) -> None:
        self.terms.append(term)

    def finish(self) -> Term | None:
        return self.function(list(dict.fromkeys(self.terms)) if self.distinct else self.terms)


def iri(name: str) -> NamedNode:
    """The IRI by which the oracle's texts call a function: the name in hexadecimal."""
    return NamedNode("urn:oracle:" + name.encode().hex())


class Called:
    """The functions and aggregates for one query of Oxigraph.

    ``is_open`` afterwards says that the query needed a term that the standard leaves open, so that
    nothing can be said of its result.
    """

    def __init__(self, others: Mapping[str, Callable[..., Term]]) -> None:
        self.is_open = False
        given = {**FUNCTIONS, **others}
        self.functions = {iri(name): self.guarded(call) for name, call in given.items()}
        self.aggregates = {
            iri(name + distinct): partial(Accumulator, self.guarded(call), bool(distinct))
            for name, call in AGGREGATES.items()
            for distinct in ("", " DISTINCT")
        }

    def guarded(self, function: Callable[..., Term]) -> Callable[..., Term | None]:
        def call(*terms: Any) -> Term | None:
            try:
                return function(*terms)
            except Undefined:
                return None
            except Open:
                self.is_open = True
                return None

        return call
