"""How many solutions the static triples of a pattern have, for each of its matches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import BlankNode, Literal, NamedNode, Variable

from ...continuous.operators.background import Background
from ...continuous.values.literals import canonical
from ...languages.mtl.checked import Kind
from ...rdf.dictionary import NO_TERM, Term
from ...rdf.namespaces import XSD
from ...rdf.timed import split_term
from ...reasoning.patterns.plan import NO_VALUE
from ...reasoning.patterns.query import Keys, StaticJoin
from ...sparql.ast import Triple
from ...streams.time import format_time

Known: TypeAlias = dict[str, Term]
"""The terms of variables; blank nodes are variables, too."""
_MOST_KEPT = 100_000


class StaticSolutions:
    """Counts the solutions of static joins by scans of the ``background``; see
    `combined.CombinedRows`. A variable without a value may be any term.

    Cost: a scan a triple and solution, once for each distinct combination of values; at most
    `_MOST_KEPT` results are kept, until the background changes.
    """

    def __init__(self, background: Background, keys: Keys) -> None:
        self._background = background
        self._keys = keys
        self._version: int | None = None
        self._counts: dict[tuple[object, ...], int] = {}

    def __call__(
        self, join: StaticJoin, values: Mapping[str, NDArray[Any]], count: int
    ) -> NDArray[np.int64]:
        version = self._background.version
        if version != self._version or len(self._counts) > _MOST_KEPT:
            self._version, self._counts = version, {}
        columns = [values[name].tolist() for name, _, _ in join.variables]
        found = np.empty(count, np.int64)
        for row in range(count):
            key = (join, *(column[row] for column in columns))
            if key not in self._counts:
                self._counts[key] = self._count(join, key[1:])
            found[row] = self._counts[key]
        return found

    def _count(self, join: StaticJoin, values: tuple[Any, ...]) -> int:
        known: Known = {}
        for (name, _, kind), value in zip(join.variables, values, strict=True):
            term = self._term(kind, value)
            if term is not None:
                known[name] = term
        return sum(1 for _ in self._solutions(join.triples, known))

    def _term(self, kind: Kind, value: Any) -> Term | None:
        if value == NO_VALUE or value != value:
            return None
        match kind:
            case Kind.OBJECT:
                return NamedNode(self._keys.key(value)[1:-1])
            case Kind.TEXT:
                return Literal(self._keys.key(value)[1:])
            case Kind.TRUTH:
                return Literal(bool(value))
            case Kind.TIME:
                return Literal(format_time(value), datatype=NamedNode(XSD + "dateTime"))
            case Kind.NUMBER:
                return Literal(float(value))

    def _solutions(
        self, triples: tuple[tuple[Triple, str | None], ...], known: Known
    ) -> Iterator[Known]:
        if not triples:
            yield known
            return
        (triple, graph), *rest = triples
        subject, object = _value(triple.subject, known), _value(triple.object, known)
        assert isinstance(triple.predicate, NamedNode)
        # Numbers are compared by value, so they are scanned for with all others.
        sought = None if _number(object) is not None else object
        for found in self._background.scan(subject, triple.predicate, sought, graph or ""):
            extended = dict(known)
            if all(
                _is_same(extended.setdefault(name, term), term) if name else _is_same(own, term)
                for name, own, term in zip(
                    (_name(triple.subject), _name(triple.object)),
                    (subject, object),
                    found,
                    strict=True,
                )
            ):
                yield from self._solutions(tuple(rest), extended)


def _name(place: object) -> str | None:
    match place:
        case Variable(value=name):
            return name
        case BlankNode(value=name):
            return f"_:{name}"
        case _:
            return None


def _value(place: Any, known: Known) -> Term | None:
    """The term of a place; None: any."""
    name = _name(place)
    return place if name is None else known.get(name)


def _is_same(own: Term | None, found: Term) -> bool:
    first, second = _number(own), _number(found)
    return own == found if first is None or second is None else first == second


def _number(term: Term | None) -> float | None:
    if not isinstance(term, Literal):
        return None
    kind, value = split_term(canonical(term), lambda _: NO_TERM)
    return float(value) if kind.is_number else None
