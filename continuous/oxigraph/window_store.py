"""Evaluation of windows by Oxigraph: a fresh store per window, with its content and the static
triples that the query needs.

A long-lived store would leak memory under additions and removals. A store merges equal triples: if
a window has some under bag semantics, `bag_rewrite.count_copies` rewrites the query.
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
from ...rdf.terms_to_columns import from_terms
from ...rdf.timed import TimedTriples, TripleRows
from ...sparql import ast
from ...sparql.printer import print_query
from ...sparql.terms import term_text
from ...streams.time import format_time
from ..algebra.from_sparql import Graphs
from ..algebra.plan import DEFAULT
from ..algebra.unsupported import Unsupported
from ..columns.oxigraph_port import NO_QUADS, SparqlResult, StoredQuads, Table
from ..columns.relation import TermValues, term_column
from ..operators.results import Solutions, WindowResult
from ..operators.sources import StaticSide, distinct_ids
from ..values.literals import canonical
from .bag_rewrite import HIDDEN, copy_graph, count_copies
from .standard_rewrite import rewrite_to_standard

_DEFAULT = DefaultGraph()


class OxigraphWindows:
    """Evaluates a query for successive windows.

    Cost per window: a Python object per triple of the window and per static triple that the query
    can match (selected once per version of the background), and Oxigraph's own cost. Under bag
    semantics add a look-up per triple, and a store twice as large if there are equal triples.
    Memory: one such store.

    The query's new blank nodes get names from ``seed`` and the window. Oxigraph parses the text
    where it evaluates it: in the service in another process (`oxigraph_port`). The text is only
    made when a window, or `explain`, needs it, since most queries are evaluated in columns.
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
        self.source = query
        self.distinct = distinct
        self.static = static
        self.terms = terms
        self.seed = seed
        self._version: int | None = None
        self._quads: dict[Quad, None] = {}
        self._kept = NO_QUADS

    @cached_property
    def query(self) -> ast.Query:
        """The SPARQL query, with the terms of parameters."""
        return _restricted(body_with_rows(self.source), self.graphs)

    @cached_property
    def sparql(self) -> str:
        """The SPARQL text, with the prefixes of the source."""
        return print_query(self.query, self.source.prefixes)

    @cached_property
    def _text(self) -> _Text:
        return _Text(rewrite_to_standard(self.query))

    @cached_property
    def _label(self) -> str:
        text = f"{self.sparql} {self.seed}".encode()
        return f"q{hashlib.blake2b(text, digest_size=8).hexdigest()}"

    @cached_property
    def _named(self) -> tuple[frozenset[NamedNode] | None, frozenset[NamedNode] | None]:
        return named_predicates(self.query)

    @cached_property
    def bag_text(self) -> _Text | None:
        """The text for windows with equal triples; None if they count once."""
        if self.distinct:
            return None
        try:
            return _Text(rewrite_to_standard(count_copies(self.query)))
        except Unsupported as unsupported:
            self.merges = str(unsupported)
            return None

    merges: str = ""
    """Why equal triples are merged although the query has bag semantics (`bag_text` is None)."""

    def solve(
        self, contents: Mapping[str, Sequence[TripleRows]], start: int, end: int
    ) -> WindowResult:
        """Return the result of the query over the windows' content, by graph, and the static
        side."""
        static = self._static_quads()
        content = list(self._content(contents.get(DEFAULT, ()), _DEFAULT))
        quads = list(content)
        has_equal = False
        for name in self.graphs.windows:
            named = list(self._content(contents.get(name, ()), NamedNode(name)))
            has_equal |= len(set(named)) < len(named)
            quads += named
        copies = [] if self.distinct else _copies(static, content)
        text = self._text
        if copies and self.bag_text is not None:
            quads += copies
            text = self.bag_text
        merged = (bool(copies) or (has_equal and not self.distinct)) and self.bag_text is None
        budget = self.terms.budget
        with budget.pauses.released(waits=True):
            result = budget.oxigraph.ask(text.at(end), self._kept, quads)
        result = self._rename_nodes(result, end, quads)
        return replace(self._read(result, start, end), merged=merged)

    def _rename_nodes(self, result: SparqlResult, end: int, quads: Iterable[Quad]) -> SparqlResult:
        """Rename the blank nodes that the query created, by window and order. Oxigraph names them
        randomly, but a window that is computed again must give the same result."""
        if isinstance(result, bool):
            return result
        rows = result.rows if isinstance(result, Table) else result
        nodes = dict.fromkeys(term for row in rows for term in row if isinstance(term, BlankNode))
        if not nodes:
            return result
        existing = {t for q in (*quads, *self._kept.quads) for t in (q.subject, q.object)}
        names: dict[Any, Any] = {
            node: BlankNode(f"{self._label}t{end}n{number}".replace("-", "m"))
            for number, node in enumerate(node for node in nodes if node not in existing)
        }
        if isinstance(result, Table):
            renamed = [[names.get(term, term) for term in row] for row in rows]
            return Table(result.variables, renamed)
        return [Triple(*(names.get(term, term) for term in triple)) for triple in result]

    def _read(self, result: SparqlResult, start: int, end: int) -> WindowResult:
        dictionary = self.terms.dictionary
        if isinstance(result, bool):
            return WindowResult(start, end, answer=result)
        if not isinstance(result, Table):
            triples = dict.fromkeys(
                (end, _term(t.subject), t.predicate, _term(t.object)) for t in result
            )
            rows = from_terms(triples, dictionary)
            return WindowResult(start, end, triples=TimedTriples(dictionary, rows.tables))
        places = {name: i for i, name in enumerate(result.variables) if not name.startswith(HIDDEN)}
        columns = {
            name: term_column([row[i] for row in result.rows], dictionary.transient_id)
            for name, i in places.items()
        }
        solutions = Solutions(tuple(places), columns, dictionary, len(result.rows))
        return WindowResult(start, end, solutions=solutions)

    def _static_quads(self) -> dict[Quad, None]:
        """Return the static triples of the default graph that the query can match, each once."""
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
            self._kept = StoredQuads([*self._quads, *named_quads])
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
    """A query as text, with NOW() as the end of a window: no clock is read here."""

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
        """Return the text for the window that ends at ``end``."""
        now = Literal(format_time(end), datatype=NamedNode(XSD + "dateTime"))
        return term_text(now).join(self._parts)


def _restricted(query: ast.Query, graphs: Graphs) -> ast.Query:
    """Restrict each ``GRAPH ?g`` to the graphs that it may mean: windows or static ones."""

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
    """Return every triple in as many copy graphs as it has copies; nothing if all occur once.

    A static triple is one more copy. Types are a set of facts and have one copy.
    """
    counts = dict.fromkeys(static, 1)
    has_equal = False
    for quad in content:
        count = counts.get(quad, 0)
        if count and quad.predicate == RDF_TYPE:
            continue
        has_equal |= count > 0
        counts[quad] = count + 1
    if not has_equal:
        return []
    return [
        Quad(quad.subject, quad.predicate, quad.object, copy_graph(number))
        for quad, count in counts.items()
        for number in range(count)
    ]


def _value(term: Any) -> Any:
    return canonical(term) if isinstance(term, Literal) else term


def named_predicates(
    query: ast.Query,
) -> tuple[frozenset[NamedNode] | None, frozenset[NamedNode] | None]:
    """Return the predicates and the classes that a query names; None if it may read any."""
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
