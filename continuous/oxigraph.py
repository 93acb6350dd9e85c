"""Oxigraph a window: a fresh store with the window's content and the static triples it needs.

A long-lived store leaks under adding and removing, and a fresh one is exact. A store merges equal
triples: under bag semantics a window that holds some is asked by `bag.counting`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeGuard

from pyoxigraph import (
    BlankNode,
    DefaultGraph,
    Literal,
    NamedNode,
    Quad,
    Triple,
)
from rdflib.plugins.sparql.parserutils import CompValue
from rdflib.term import URIRef

from ..languages.csparql import term_text
from ..languages.csparql.body import Edit, apply_edits
from ..languages.csparql.functions import UNCALLED
from ..languages.csparql.tokens import Kind as TokenKind
from ..languages.csparql.tokens import closing, tokenize
from ..rdf.dictionary import Term
from ..rdf.namespaces import RDF, RDF_TYPE, XSD
from ..rdf.sparql import check_sparql
from ..rdf.timed import TimedTriples, TripleRows, from_terms
from ..streams.time import format_time
from .asking import NOTHING, Found, Kept, Table
from .bag import HIDDEN, copy_graph, counting
from .columns import TermValues, canonical, term_column
from .logical import DEFAULT
from .results import Solutions, WindowResult
from .sources import StaticSide, distinct_ids
from .translate import Graphs
from .unsupported import Unsupported

_DEFAULT = DefaultGraph()


class OxigraphWindows:
    """Evaluates a SPARQL text over one window after the other.

    Cost a window: a Python object a triple of the window and of the static triples that the query
    can touch (chosen once a version of the background), then Oxigraph's; under bag semantics a
    look-up a triple more, and twice the store where triples are equal. Memory: one such store.
    Raises ``ValueError`` for a text that Oxigraph does not take. Blank nodes that the query makes
    are called by ``seed`` and the window.
    """

    def __init__(
        self,
        sparql: str,
        algebra: CompValue,
        static: StaticSide,
        terms: TermValues,
        graphs: Graphs | None = None,
        *,
        distinct: bool,
        seed: str = "",
    ) -> None:
        _parsed(sparql)
        self.graphs = graphs or Graphs()
        self.sparql = _restricted(sparql, self.graphs)
        self.distinct = distinct
        self.static = static
        self.terms = terms
        self.predicates, self.classes = named(algebra)
        self._label = (
            f"q{hashlib.blake2b(f'{self.sparql} {seed}'.encode(), digest_size=8).hexdigest()}"
        )
        self._version: int | None = None
        self._quads: dict[Quad, None] = {}
        self._kept = NOTHING

    @cached_property
    def counting(self) -> str | None:
        """The text for windows that hold equal triples, None where they count once."""
        if self.distinct:
            return None
        try:
            text = counting(self.sparql)
            _parsed(text)
            return text
        except ValueError:
            self.merges = "its text"
            return None
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
        sparql = self.sparql
        if copies and self.counting is not None:
            asked += copies
            sparql = self.counting
        merged = (bool(copies) or (again and not self.distinct)) and self.counting is None
        budget = self.terms.budget
        with budget.pauses.apart(waits=True):
            found = budget.asking.ask(_at_time(sparql, end), self._kept, asked)
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
            copied = background.copy(self.predicates, self.classes)
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


def _restricted(sparql: str, graphs: Graphs) -> str:
    """The text with the graphs that each ``GRAPH ?g`` may stand for: windows or static ones."""
    if "graph" not in sparql.lower():  # most: their tokens are many
        return sparql
    edits = []
    for word, name in pairwise(tokenize(sparql)):
        if word.is_word("GRAPH") and name.kind is TokenKind.VARIABLE:
            windows = name.text[1:] in graphs.window_variables
            names = graphs.windows if windows else graphs.static
            listed = " ".join(term_text(NamedNode(iri)) for iri in names)
            edits.append(Edit(word.start, word.start, f"VALUES {name.text} {{ {listed} }} "))
    return apply_edits(sparql, edits)


def _at_time(sparql: str, end: int) -> str:
    """The text with NOW() as the end of the window: nothing here reads a clock."""
    edits = []
    tokens = tokenize(sparql)
    for word, following in pairwise(tokens):
        if word.is_word("NOW") and following.is_mark("("):
            close = tokens[closing(tokens, tokens.index(following))].end
            now = Literal(format_time(end), datatype=NamedNode(XSD + "dateTime"))
            edits.append(Edit(word.start, close, term_text(now)))
    return apply_edits(sparql, edits)


def _is_node(term: Any) -> TypeGuard[NamedNode | BlankNode]:
    return isinstance(term, NamedNode | BlankNode)


def _parsed(sparql: str) -> None:
    """Raises ``ValueError`` for a text that Oxigraph does not take: now, not at some window."""
    try:
        check_sparql(sparql, {}, UNCALLED)
    except SyntaxError as error:
        raise ValueError(f"Oxigraph refuses the query: {error}") from error


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
