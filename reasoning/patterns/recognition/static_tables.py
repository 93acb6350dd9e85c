"""The static triples of patterns, as tables of their solutions (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pyoxigraph import Literal, NamedNode

from ....continuous.algebra.from_sparql import Graphs, translate
from ....continuous.columns.relation import TermValues, as_terms
from ....continuous.operators.background import Background
from ....continuous.operators.executor import execute
from ....continuous.operators.sources import EmptyWindows, StaticSide
from ....converters.objects import object_name
from ....languages.mtl.checked import Kind
from ....rdf.datatypes import DURATIONS, NUMBERS
from ....rdf.dictionary import Term, TermDictionary
from ....rdf.namespaces import DYKNOW, XSD
from ....sparql import ast
from ....streams.time import parse_iso_duration, parse_time
from ..plans.plan import NO_VALUE
from ..plans.query import Keys, StaticJoin, object_key, text_key

Value: TypeAlias = str | float | int
Solution: TypeAlias = tuple[tuple[str | None, ...], tuple[Value | None, ...]]
"""The results, and the values that tests and calculations read."""
Table: TypeAlias = dict[tuple[Value, ...], list[Solution]]
"""Solutions, in order of results and values, by the values of the variables that the plan fills."""


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
    ) -> tuple[NDArray[np.int64], dict[str, NDArray[Any]]]:
        """Return the solutions for ``count`` rows of values, by variable: the number of the row of
        each, and their results and values, by output. Those of one row are in order of the texts of
        their results, then of their values."""
        table = self._table(join)
        columns = [
            [self._value(kind, each) for each in values[name].tolist()]
            for name, _, kind in join.variables
        ]
        rows = zip(*columns, strict=True) if columns else [()] * count
        found = [table.get(row, []) for row in rows]
        numbers = np.repeat(np.arange(count), np.array(list(map(len, found)), np.int64))
        solutions = [solution for solutions in found for solution in solutions]
        results: dict[str, NDArray[Any]] = {}
        for i, (_, output) in enumerate(join.results):
            texts = [each[i] for each, _ in solutions]
            told = [None if text is None else text_key(text) for text in texts]
            results[output] = self._column(Kind.TEXT, told)
        for i, (_, output, kind) in enumerate(join.values):
            results[output] = self._column(kind, [each[i] for _, each in solutions])
        return numbers, results

    def _column(self, kind: Kind, values: Sequence[Value | None]) -> NDArray[Any]:
        """Values as plans compare them."""
        if kind is Kind.NUMBER:
            return np.array([np.nan if each is None else each for each in values], np.float64)
        numbers = (self._keys.number(each) if isinstance(each, str) else each for each in values)
        return np.array([NO_VALUE if each is None else each for each in numbers], np.int64)

    def _value(self, kind: Kind, value: int | float) -> Value:
        return self._keys.key(int(value)) if kind in (Kind.OBJECT, Kind.TEXT) else value

    def _table(self, join: StaticJoin) -> Table:
        """The solutions by the values of the join's variables."""
        if self._background.version != self._version:
            self._version, self._tables = self._background.version, {}
        if join not in self._tables:
            self._tables[join] = self._solved(join)
        return self._tables[join]

    def _solved(self, join: StaticJoin) -> Table:
        dictionary = TermDictionary()
        terms = TermValues(dictionary)
        source = EmptyWindows(StaticSide(self._background, terms), (), False, None)
        relation = execute(translate(_query(join), {}, self._graphs).plan, source, terms)

        def of(name: str) -> list[Term]:
            ids = as_terms(relation.column(name), dictionary).values.tolist()
            return list(map(dictionary.term, ids))

        def values(of_kinds: Sequence[tuple[str, str, Kind]]) -> list[list[Value | None]]:
            return [[_value_of(term, kind) for term in of(name)] for name, _, kind in of_kinds]

        given, read = values(join.variables), values(join.values)
        told = [list(map(_text_of, of(name))) for name, _ in join.results]
        table: Table = {}
        for i in range(relation.rows):
            row = tuple(value for column in given for value in [column[i]] if value is not None)
            if len(row) == len(given):
                found = tuple(column[i] for column in told), tuple(column[i] for column in read)
                table.setdefault(row, []).append(found)
        for solutions in table.values():
            solutions.sort(key=_order)
        return table


def _order(solution: Solution) -> tuple[Any, ...]:
    """By texts, then by values: a variable has values of one kind, or none."""
    texts, values = solution
    return tuple(text or "" for text in texts), tuple(
        (each is not None, each or 0) for each in values
    )


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
            return _read(parse_time, text)
        case Kind.DURATION if datatype in DURATIONS:
            return _read(parse_iso_duration, text)
        case _:
            return None


def _text_of(term: Term) -> str | None:
    """A term as a result tells it: the name of an object, or the text of a literal."""
    if isinstance(term, NamedNode):
        return object_name(term.value, DYKNOW)
    return term.value if isinstance(term, Literal) else None


def _read(parse: Callable[[str], int], text: str) -> int | None:
    """A time or duration in ns; None for one that no sample can have."""
    try:
        return parse(text)
    except ValueError:
        return None
