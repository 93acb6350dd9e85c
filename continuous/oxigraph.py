"""Oxigraph a window: a fresh store with the window's content and the static triples it needs.

A long-lived store leaks under adding and removing, and a fresh one is exact. It merges equal
triples, so a query evaluated here has set semantics.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

from pyoxigraph import (
    BlankNode,
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    QueryBoolean,
    QuerySolutions,
    QueryTriples,
    Store,
)
from rdflib.plugins.sparql.parserutils import CompValue
from rdflib.term import URIRef

from ..rdf.dictionary import Term
from ..rdf.namespaces import RDF, RDF_TYPE
from ..rdf.timed import TimedTriples, TripleRows, from_terms
from .columns import TermValues, term_column
from .results import Solutions, WindowResult
from .sources import StaticSide, distinct_ids

_DEFAULT = DefaultGraph()


class OxigraphWindows:
    """Evaluates a SPARQL text over one window after the other.

    Cost a window: a Python object a triple of the window and of the static triples that the query
    can touch (chosen once a version of the background), then Oxigraph's. Memory: one such store.
    """

    def __init__(
        self, sparql: str, algebra: CompValue, static: StaticSide, terms: TermValues
    ) -> None:
        self.sparql = sparql
        self.static = static
        self.terms = terms
        self.predicates, self.classes = named(algebra)
        self._version: int | None = None
        self._quads: list[Quad] = []

    def solve(self, tables: Sequence[TripleRows], start: int, end: int) -> WindowResult:
        """The result of the query over ``tables`` and the static side."""
        store = Store()
        store.extend(self._static_quads())
        store.extend(self._content(tables))
        found = store.query(self.sparql)
        dictionary = self.terms.dictionary
        match found:
            case QueryBoolean():
                return WindowResult(start, end, answer=bool(found))
            case QueryTriples():
                triples = dict.fromkeys(
                    (end, _term(t.subject), t.predicate, _term(t.object)) for t in found
                )
                made = from_terms(triples, dictionary)
                return WindowResult(start, end, triples=TimedTriples(dictionary, made.tables))
            case QuerySolutions():
                names = tuple(variable.value for variable in found.variables)
                rows = [[solution[i] for i in range(len(names))] for solution in found]
                columns = {
                    name: term_column([_optional(row[i]) for row in rows], dictionary)
                    for i, name in enumerate(names)
                }
                solutions = Solutions(names, columns, dictionary, len(rows))
                return WindowResult(start, end, solutions=solutions)

    def _static_quads(self) -> list[Quad]:
        version = self.static.background.version
        if version != self._version:
            self._version = version
            self._quads = self.static.background.copy(self.predicates, self.classes)
        return self._quads

    def _content(self, tables: Sequence[TripleRows]) -> Iterator[Quad]:
        dictionary = self.terms.dictionary
        for _, subject, predicate, object in TimedTriples(dictionary, tuple(tables)):
            if not isinstance(subject, Literal):
                yield Quad(subject, predicate, object, _DEFAULT)
        for table in tables:
            if table.sort is None:
                continue
            sorts = [NamedNode(name) for name in self.static.supersorts(table.sort)]
            for id in distinct_ids([table.subject], len(dictionary)).tolist():
                subject = dictionary.term(id)
                if not isinstance(subject, Literal):
                    yield from (Quad(subject, RDF_TYPE, sort, _DEFAULT) for sort in sorts)


def named(
    algebra: Any,
) -> tuple[frozenset[NamedNode] | None, frozenset[NamedNode] | None]:
    """The predicates and the classes that a query names; None where it may touch any."""
    predicates: set[NamedNode] = set()
    classes: set[NamedNode] = set()
    anything = any_class = algebra.name == "DescribeQuery"
    for _, predicate, object in _patterns(algebra):
        if not isinstance(predicate, URIRef):
            anything = True
            continue
        predicates.add(NamedNode(str(predicate)))
        if str(predicate) == RDF + "type":
            if isinstance(object, URIRef):
                classes.add(NamedNode(str(object)))
            else:
                any_class = True
    return (
        None if anything else frozenset(predicates),
        None if any_class else frozenset(classes),
    )


def _patterns(node: Any) -> Iterator[tuple[Any, Any, Any]]:
    """Every triple pattern in an algebra, those of EXISTS too."""
    if isinstance(node, CompValue):
        for name, value in node.items():
            if name == "triples" and isinstance(value, Iterable):
                for entry in value:
                    entry = tuple(entry)
                    yield from zip(entry[0::3], entry[1::3], entry[2::3], strict=True)
            elif name != "template":
                yield from _patterns(value)
    elif isinstance(node, list | tuple):
        for part in node:
            yield from _patterns(part)


def _term(term: Any) -> Term:
    if isinstance(term, NamedNode | BlankNode | Literal):
        return term
    raise ValueError("quoted triples have no place in a stream")


def _optional(term: Any) -> Term | None:
    return None if term is None else _term(term)
