"""Continuous queries by their definition, with rdflib's SPARQL: windows as set comprehensions.

Written from SPEC §4-5 alone. Neither the parser nor the evaluator of the product is used: the
windows are read from the text by a regular expression, and what is left of it is asked of an
rdflib graph that holds the static side and the content of one window. So it has *set* semantics:
it equals the bag where no triple that a query can see is in a window twice, which the callers
see to (each observation has an IRI of its own).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal

import pyoxigraph
import rdflib
from rdflib.namespace import XSD
from rdflib.plugins.sparql import prepareQuery

_UNITS = {"ms": 1_000_000, "s": 1_000_000_000}
_FROM = re.compile(
    r"\bFROM\s+(?P<stream>STREAM\s+)?<(?P<iri>[^>]*)>"
    r"(\s*\[\s*RANGE\s+(?P<range>\d+)(?P<range_unit>ms|s)"
    r"\s+STEP\s+(?P<step>\d+)(?P<step_unit>ms|s)\s*\])?",
    re.IGNORECASE,
)
_REGISTER = re.compile(r"^\s*REGISTER\s+QUERY\s+\w+\s+AS\b", re.IGNORECASE)
_NUMBERS = {XSD.integer, XSD.int, XSD.decimal, XSD.double, XSD.float}

TimedTriple = tuple[int, object, object, object]


@dataclass(frozen=True)
class Reading:
    """A text: what each stream's window is, ``(RANGE, STEP)`` in ns, and its SPARQL."""

    windows: Mapping[str, tuple[int, int]]
    sparql: str


def read(text: str) -> Reading:
    """The FROM clauses of a text, and the text without them."""
    windows = {
        found["iri"]: (
            int(found["range"]) * _UNITS[found["range_unit"].lower()],
            int(found["step"]) * _UNITS[found["step_unit"].lower()],
        )
        for found in _FROM.finditer(text)
        if found["stream"]
    }
    return Reading(windows, _FROM.sub(" ", _REGISTER.sub("", text)))


def contents(
    streams: Mapping[str, Sequence[TimedTriple]],
    windows: Mapping[str, tuple[int, int]],
    origin: int = 0,
    bounds: str = "(]",
) -> Iterator[tuple[int, list[TimedTriple]]]:
    """Each evaluation with content: its time, and what the streams' windows hold then.

    Evaluated at each least STEP; a stream with a longer one gives its latest window that has ended.
    """
    times = [item[0] for items in streams.values() for item in items]
    least = min(step for _, step in windows.values())
    longest = max(range + step for range, step in windows.values())
    now = origin + (min(times) - origin) // least * least
    while now <= max(times) + longest + least:
        held = [
            item
            for name, (range, step) in windows.items()
            for end in [origin + (now - origin) // step * step]
            for item in streams[name]
            if (end - range < item[0] <= end if bounds == "(]" else end - range <= item[0] < end)
        ]
        if held:
            yield now, held
        now += least


def evaluate(
    text: str,
    streams: Mapping[str, Sequence[TimedTriple]],
    static: rdflib.Graph,
    origin: int = 0,
    bounds: str = "(]",
) -> Iterator[tuple[int, Counter]]:
    """The solutions of a SELECT per window with content, as `canonical` rows.

    ``static`` is given back as it was; that the content shares no triple with it is asserted.
    """
    reading = read(text)
    query = prepareQuery(reading.sparql)
    for end, held in contents(streams, reading.windows, origin, bounds):
        triples = {tuple(map(to_rdflib, item[1:])) for item in held}
        assert not any(triple in static for triple in triples)
        for triple in triples:
            static.add(triple)
        result = static.query(query)
        rows = Counter(canonical(binding.items()) for binding in result.bindings)
        for triple in triples:
            static.remove(triple)
        yield end, rows


def canonical(row: Iterable[tuple[object, object]]) -> frozenset:
    """A solution of either library, without what they may differ in.

    Numbers count by value (rdflib's quotient of doubles is a decimal) and to nine digits (a sum
    has no order), a blank node of the static side has no name of its own.
    """
    return frozenset((str(name).lstrip("?"), _canonical(to_rdflib(term))) for name, term in row)


def _canonical(term: object) -> object:
    if isinstance(term, rdflib.BNode):
        return "_:"
    if isinstance(term, rdflib.Literal):
        if term.datatype in _NUMBERS:
            return f"{float(Decimal(str(term))):.9g}"
        if term.datatype == XSD.string:
            return rdflib.Literal(str(term)).n3()
    return term.n3()


def to_rdflib(term: object) -> object:
    """A term of pyoxigraph as one of rdflib, in the spelling it has; rdflib's stay themselves."""
    if isinstance(term, pyoxigraph.NamedNode):
        return rdflib.URIRef(term.value)
    if isinstance(term, pyoxigraph.BlankNode):
        return rdflib.BNode(term.value)
    if isinstance(term, pyoxigraph.Literal):
        if term.language:
            return rdflib.Literal(term.value, lang=term.language)
        # rdflib tells "x" from "x"^^xsd:string, RDF 1.1 does not.
        datatype = rdflib.URIRef(term.datatype.value)
        plain = datatype == XSD.string
        return rdflib.Literal(term.value, datatype=None if plain else datatype, normalize=False)
    return term
