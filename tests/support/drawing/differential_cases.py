"""Cases of the differential test: a query, its windows and options, and all triples."""

from dataclasses import dataclass
from functools import cached_property

from differential_queries import TIMESTAMP, Call, Query, parts_of
from pyoxigraph import Literal, NamedNode
from standard_values import XSD
from standard_values import Term as RdfTerm

BASE = "http://example.org/"
SECOND = 1_000_000_000


def typed(kind: str, *texts: str) -> list[Literal]:
    return [Literal(text, datatype=NamedNode(XSD + kind)) for text in texts]


INTEGERS = typed("integer", "-2", "-1", "0", "1", "2", "3", "7")
DECIMALS = typed("decimal", "-1.5", "0.0", "0.5", "1.0", "2.25")
DOUBLES = typed("double", "-1.5E0", "0.0E0", "0.5E0", "1.0E0", "2.0E0", "100.0E0")
FLOATS = typed("float", "-2", "0.5", "1", "1.5")
SPECIAL = [*typed("double", "NaN", "INF", "-INF"), *typed("float", "NaN", "INF")]
HUGE = [
    *typed("integer", "9223372036854775807", "-9223372036854775808", "9007199254740993"),
    *typed("integer", "4611686018427387904", "9007199254740992"),
    *typed("double", "1E308", "-1E308", "9007199254740992", "0.49999999999999994"),
    *typed("decimal", "9007199254740992.0", "9007199254740993.0", "123456789012345678.5"),
]
BOOLEANS = typed("boolean", "true", "false")
STRINGS = typed("string", "", "a", "b", "1", "B")
TAGGED = [Literal("a", language="en"), Literal("b", language="en"), Literal("a", language="de")]
INSTANTS = typed(
    "dateTime", "2021-10-07T19:12:53Z", "2021-10-07T19:12:54Z", "2021-10-07T21:12:53+02:00"
)
FLOATING = typed("dateTime", "2021-10-07T19:12:53", "2021-11-01T00:00:00")


@dataclass(frozen=True)
class Element:
    """A timed triple of the stream ``:s{stream}``, in order of arrival."""

    stream: int
    time: int
    subject: RdfTerm
    predicate: RdfTerm
    object: RdfTerm


@dataclass(frozen=True)
class WindowOf:
    """``range`` and ``step`` in ns; without a name the window is in the default graph."""

    name: str
    stream: int
    range: int
    step: int


@dataclass(frozen=True)
class Case:
    """``lateness``: none where the streams are given as collections, which are sorted first."""

    query: Query
    windows: tuple[WindowOf, ...]
    elements: tuple[Element, ...]
    static: tuple[tuple[RdfTerm, RdfTerm, RdfTerm], ...] = ()
    operator: str = "RSTREAM"
    every: int = 0
    semantics: str = ""
    bounds: str = "(]"
    origin: int = 0
    lateness: int | None = None
    report: str = "non-empty"
    exact: bool = True

    @cached_property
    def timed(self) -> bool:
        return any(
            isinstance(part, Call) and part.name == TIMESTAMP for part in parts_of(self.query)
        )

    @property
    def bag(self) -> bool:
        named = any(window.name for window in self.windows)
        return (
            self.semantics or ("set" if named or self.operator != "RSTREAM" else "bag")
        ) == "bag"
