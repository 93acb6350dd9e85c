"""Oxigraph a window: a fresh store with the window's content and the static triples it needs.

A long-lived store leaks under adding and removing, and a fresh one is exact. A store merges equal
triples: under bag semantics a window that holds some is asked by `bag_rewrite.counting`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, TypeGuard

from pyoxigraph import BlankNode, DefaultGraph, Literal, NamedNode, Quad, Triple, Variable

from ...languages.csparql import body_with_rows
from ...languages.csparql.ast import ContinuousQuery
from ...rdf.dictionary import Term
from ...rdf.namespaces import RDF_TYPE, XSD
from ...rdf.timed import TimedTriples, TripleRows, from_terms
from ...sparql import ast
from ...sparql.printer import print_query
from ...sparql.terms import term_text
from ...streams.time import format_time
from ..algebra.from_sparql import Graphs
from ..algebra.plan import DEFAULT
from ..algebra.unsupported import Unsupported
from ..columns.oxigraph_port import NOTHING, Found, Kept, Table
from ..columns.relation import TermValues, term_column
from ..operators.results import Solutions, WindowResult
from ..operators.sources import StaticSide, distinct_ids
from ..values.literals import canonical
from .bag_rewrite import HIDDEN, copy_graph, counting
from .standard_rewrite import standard

_DEFAULT = DefaultGraph()


class OxigraphWindows:
    """Evaluates a query over one window after the other.

    Cost a window: a Python object a triple of the window and of the static triples that the query
    can touch (chosen once a version of the background), then Oxigraph's; under bag semantics a
    look-up a triple more, and twice the store where triples are equal. Memory: one such store.
    Blank nodes that the query makes are called by ``seed`` and the window. Oxigraph reads the text
    where it evaluates it, in the service another process (`oxigraph_port`). Nothing is printed
    before a window, or `explain`, needs it: most queries are evaluated in columns.
    """

    def __init__(
        self,
        query: ContinuousQuery,
        static: StaticSide,
        terms: TermValues,
        graphs: Graphs | None = None,
        *,
        distinct: bool,
        seed: str = "",
    ) -> None:
        self.graphs = graphs or Graphs()
        self.asked = query
        self.distinct = distinct
        self.static = static
        self.terms = terms
        self.seed = seed
        self._version: int | None = None
        self._quads: dict[Quad, None] = {}
        self._kept = NOTHING

    @cached_property
    def query(self) -> ast.Query:
        """What is asked, with the terms of parameters."""
        return _restricted(body_with_rows(self.asked), self.graphs)

    @cached_property
    def sparql(self) -> str:
        """The same as text, with the prefixes of the source."""
        return print_query(self.query, self.asked.prefixes)

    @cached_property
    def _text(self) -> _Text:
        return _Text(standard(self.query))

    @cached_property
    def _label(self) -> str:
        told = f"{self.sparql} {self.seed}".encode()
        return f"q{hashlib.blake2b(told, digest_size=8).hexdigest()}"

    @cached_property
    def _named(self) -> tuple[frozenset[NamedNode] | None, frozenset[NamedNode] | None]:
        return named(self.query)

    @cached_property
    def counting(self) -> _Text | None:
        """The text for windows that hold equal triples, None where they count once."""
        if self.distinct:
            return None
        try:
            return _Text(standard(counting(self.query)))
        except Unsupported as unsupported:
            self.merges = str(unsupported)
            return None

    merges: str = ""
    """Under bag semantics: why equal triples are merged nevertheless (`counting` is None)."""

    def solve(
        self, contents: Mapping[str, Sequence[TripleRows]], start: int, end: int
    ) -> WindowResult:
        """The result of the query over the content of windows, by graph, and the static side."""
        static = self._static_quads()
        content = list(self._content(contents.get(DEFAULT, ()), _DEFAULT))
        asked = list(content)
        again = False
        for name in self.graphs.windows:
            named = list(self._content(contents.get(name, ()), NamedNode(name)))
            again |= len(set(named)) < len(named)
            asked += named
        copies = [] if self.distinct else _copies(static, content)
        text = self._text
        if copies and self.counting is not None:
            asked += copies
            text = self.counting
        merged = (bool(copies) or (again and not self.distinct)) and self.counting is None
        budget = self.terms.budget
        with budget.pauses.released(waits=True):
            found = budget.asking.ask(text.at(end), self._kept, asked)
        found = self._named_again(found, end, asked)
        return replace(self._read(found, start, end), merged=merged)

    def _named_again(self, found: Found, end: int, asked: Iterable[Quad]) -> Found:
        """What was found, with blank nodes that the query has made named by the window: Oxigraph
        calls them otherwise each time, and a window may be computed again."""
        if isinstance(found, bool):
            return found
        rows = found.rows if isinstance(found, Table) else found
        made = dict.fromkeys(term for row in rows for term in row if isinstance(term, BlankNode))
        if not made:
            return found
        known = {t for q in (*asked, *self._kept.quads) for t in (q.subject, q.object)}
        names: dict[Any, Any] = {
            node: BlankNode(f"{self._label}t{end}n{number}".replace("-", "m"))
            for number, node in enumerate(node for node in made if node not in known)
        }
        if isinstance(found, Table):
            again = [[names.get(term, term) for term in row] for row in rows]
            return Table(found.variables, again)
        return [Triple(*(names.get(term, term) for term in triple)) for triple in found]

    def _read(self, found: Found, start: int, end: int) -> WindowResult:
        dictionary = self.terms.dictionary
        if isinstance(found, bool):
            return WindowResult(start, end, answer=found)
        if not isinstance(found, Table):
            triples = dict.fromkeys(
                (end, _term(t.subject), t.predicate, _term(t.object)) for t in found
            )
            made = from_terms(triples, dictionary)
            return WindowResult(start, end, triples=TimedTriples(dictionary, made.tables))
        places = {name: i for i, name in enumerate(found.variables) if not name.startswith(HIDDEN)}
        columns = {
            name: term_column([row[i] for row in found.rows], dictionary.transient_id)
            for name, i in places.items()
        }
        solutions = Solutions(tuple(places), columns, dictionary, len(found.rows))
        return WindowResult(start, end, solutions=solutions)

    def _static_quads(self) -> dict[Quad, None]:
        """The static triples that the query can touch, each once; those of named graphs aside."""
        background = self.static.background
        version = background.version
        if version != self._version:
            self._version = version
            copied = background.copy(*self._named)
            self._quads = dict.fromkeys(
                Quad(q.subject, q.predicate, _value(q.object), _DEFAULT) for q in copied
            )
            named_quads = [
                Quad(s, p, _value(o), NamedNode(name))
                for name in self.graphs.static
                for s, p, o in background.triples(name)
                if _is_node(s)
            ]
            self._kept = Kept([*self._quads, *named_quads])
        return self._quads

    def _content(
        self, tables: Sequence[TripleRows], graph: NamedNode | DefaultGraph
    ) -> Iterator[Quad]:
        dictionary = self.terms.dictionary
        for _, subject, predicate, object in TimedTriples(dictionary, tuple(tables)):
            if not isinstance(subject, Literal):
                yield Quad(subject, predicate, object, graph)
        for table in tables:
            if table.sort is None:
                continue
            sorts = [NamedNode(name) for name in self.static.supersorts(table.sort)]
            for id in distinct_ids([table.subject], len(dictionary)).tolist():
                subject = dictionary.term(id)
                if not isinstance(subject, Literal):
                    yield from (Quad(subject, RDF_TYPE, sort, graph) for sort in sorts)


class _Text:
    """A query as text, with NOW() as the end of a window: nothing here reads a clock."""

    def __init__(self, query: ast.Query) -> None:
        text = print_query(query)
        mark = "urn:dyknow:now"
        while mark in text:
            mark += "_"

        def marked(node: object) -> NamedNode | None:
            is_now = isinstance(node, ast.Call) and node.name == "NOW"
            return NamedNode(mark) if is_now else None

        self._parts = print_query(ast.rewrite(query, marked)).split(f"<{mark}>")

    def at(self, end: int) -> str:
        """The text for the window that ends then."""
        now = Literal(format_time(end), datatype=NamedNode(XSD + "dateTime"))
        return term_text(now).join(self._parts)


def _restricted(query: ast.Query, graphs: Graphs) -> ast.Query:
    """The query with the graphs that each ``GRAPH ?g`` may stand for: windows or static ones."""

    def change(node: object) -> ast.Group | None:
        if not isinstance(node, ast.Group):
            return None
        elements: list[ast.Element] = []
        for one in node.elements:
            if isinstance(one, ast.Graph) and isinstance(one.name, Variable):
                windows = one.name.value in graphs.window_variables
                names = graphs.windows if windows else graphs.static
                elements.append(ast.Values((one.name,), tuple((NamedNode(n),) for n in names)))
            elements.append(ast.rewrite(one, change))
        return ast.Group(tuple(elements), node.span)

    return ast.rewrite(query, change)


def _is_node(term: Any) -> TypeGuard[NamedNode | BlankNode]:
    return isinstance(term, NamedNode | BlankNode)


def _copies(static: Collection[Quad], content: Sequence[Quad]) -> list[Quad]:
    """Every triple once a copy graph, as often as it is there; empty if all are there once.

    A static triple is one more element. Types are a set of facts and have one copy.
    """
    counts = dict.fromkeys(static, 1)
    again = False
    for quad in content:
        known = counts.get(quad, 0)
        if known and quad.predicate == RDF_TYPE:
            continue
        again |= known > 0
        counts[quad] = known + 1
    if not again:
        return []
    return [
        Quad(quad.subject, quad.predicate, quad.object, copy_graph(number))
        for quad, count in counts.items()
        for number in range(count)
    ]


def _value(term: Any) -> Any:
    return canonical(term) if isinstance(term, Literal) else term


def named(
    query: ast.Query,
) -> tuple[frozenset[NamedNode] | None, frozenset[NamedNode] | None]:
    """The predicates and the classes that a query names; None where it may touch any."""
    predicates: set[NamedNode] = set()
    classes: set[NamedNode] = set()
    anything = any_class = query.form is ast.Form.DESCRIBE
    for node in ast.walk(replace(query, template=None)):
        if not isinstance(node, ast.Triple):
            continue
        if not isinstance(node.predicate, NamedNode):
            anything = True
            continue
        predicates.add(node.predicate)
        if node.predicate == RDF_TYPE:
            if isinstance(node.object, NamedNode):
                classes.add(node.object)
            else:
                any_class = True
    return (
        None if anything else frozenset(predicates),
        None if any_class else frozenset(classes),
    )


def _term(term: Any) -> Term:
    if isinstance(term, NamedNode | BlankNode | Literal):
        return term
    raise ValueError("quoted triples have no place in a stream")
