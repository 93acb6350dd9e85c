"""The static triples of patterns, as tables of their solutions (SPEC §8)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal, NamedNode

from ....continuous.algebra.from_sparql import Graphs, translate
from ....continuous.columns.relation import TermValues, as_terms
from ....continuous.operators.background import Background
from ....continuous.operators.executor import execute
from ....continuous.operators.sources import EmptyWindows, StaticSide
from ....languages.mtl.checked import Kind
from ....rdf.datatypes import NUMBERS
from ....rdf.dictionary import Term, TermDictionary
from ....rdf.namespaces import XSD
from ....sparql import ast
from ....streams.time import parse_time
from ..plans.query import Keys, StaticJoin, object_key, text_key

Value: TypeAlias = str | float | int
Table: TypeAlias = Counter[tuple[Value, ...]]


class StaticTables:
    """Answers the static joins of a query (`combined.StaticSolutions`) from ``background``, by the
    ``keys`` of the query's plans. ``named``: the graphs of FROM NAMED.

    Cost: for each version of the background one evaluation of the triples, and Python for each of
    their solutions; a look-up a match. Memory: an entry for each distinct solution.
    """

    def __init__(self, background: Background, keys: Keys, named: Sequence[str] = ()) -> None:
        self._background = background
        self._keys = keys
        self._graphs = Graphs(static=tuple(named))
        self._version: int | None = None
        self._tables: dict[StaticJoin, Table] = {}

    def __call__(
        self, join: StaticJoin, values: Mapping[str, NDArray[Any]], count: int
    ) -> NDArray[np.int64]:
        """Return the number of solutions for each of ``count`` rows of values, by variable."""
        table = self._table(join)
        columns = [
            [self._value(kind, each) for each in values[name].tolist()]
            for name, _, kind in join.variables
        ]
        rows = zip(*columns, strict=True) if columns else [()] * count
        return np.array([table[row] for row in rows], np.int64)

    def _value(self, kind: Kind, value: int | float) -> Value:
        return self._keys.key(int(value)) if kind in (Kind.OBJECT, Kind.TEXT) else value

    def _table(self, join: StaticJoin) -> Table:
        """The number of solutions by the values of the join's variables."""
        if self._background.version != self._version:
            self._version, self._tables = self._background.version, {}
        if join not in self._tables:
            self._tables[join] = self._counted(join)
        return self._tables[join]

    def _counted(self, join: StaticJoin) -> Table:
        dictionary = TermDictionary()
        terms = TermValues(dictionary)
        source = EmptyWindows(StaticSide(self._background, terms), (), False, None)
        relation = execute(translate(_query(join), {}, self._graphs).plan, source, terms)
        columns = []
        for name, _, kind in join.variables:
            ids = as_terms(relation.column(name), dictionary).values.tolist()
            columns.append([_value_of(dictionary.term(each), kind) for each in ids])
        rows = zip(*columns, strict=True) if columns else [()] * relation.rows
        return Counter(row for row in rows if None not in row)


def _query(join: StaticJoin) -> ast.Query:
    """All solutions of the triples, as a query."""
    elements: list[ast.Element] = []
    for triple, graph in join.triples:
        triples = ast.Triples((triple,))
        if graph is None:
            elements.append(triples)
        else:
            elements.append(ast.Graph(NamedNode(graph), ast.Group((triples,))))
    return ast.Query(ast.Form.SELECT, ast.Group(tuple(elements)))


def _value_of(term: Term, kind: Kind) -> Value | None:
    """The value of a term of this kind; None for another kind."""
    if isinstance(term, NamedNode):
        return object_key(term.value) if kind is Kind.OBJECT else None
    if not isinstance(term, Literal):
        return None
    datatype, text = term.datatype.value, term.value
    match kind:
        case Kind.NUMBER if datatype in NUMBERS:
            return float(text)
        case Kind.TEXT if datatype == XSD + "string":
            return text_key(text)
        case Kind.TRUTH if datatype == XSD + "boolean":
            return int(text in ("true", "1"))
        case Kind.TIME if datatype == XSD + "dateTime":
            return _time(text)
        case _:
            return None


def _time(text: str) -> int | None:
    """The time in ns; None for one that no sample can have."""
    try:
        return parse_time(text)
    except ValueError:
        return None
