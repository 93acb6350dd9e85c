"""The bag on Oxigraph: a query in which equal triples of a window count each.

A store is a set of quads. So the n-th of equal triples stands in the n-th *copy graph* too, and a
triple pattern P of the query becomes ``GRAPH ?g {P}`` with a variable of its own: it matches once
a copy. `window_store` fills the copies; the default graph holds each triple once.

What counts solutions as a set anyway stays as it is, on the default graph: ``?x a Sort`` (a set of
facts, docs/explanation/semantics.md), FILTER with EXISTS, MINUS, and the paths ``p*``, ``p+`` and
``p?``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from pyoxigraph import BlankNode, NamedNode, Variable

from ...rdf.namespaces import RDF_TYPE
from ...sparql import ast
from ..algebra.unsupported import Unsupported

HIDDEN = "dyknow_copy_"
"""Variables of copy graphs begin with this; ``SELECT *`` would show them."""


def copy_graph(number: int) -> NamedNode:
    """The graph of the ``number``-th (from 0) of equal triples."""
    return NamedNode(f"urn:dyknow:copy:{number}")


def counting(query: ast.Query) -> ast.Query:
    """The query with each triple pattern asked of the copy graphs.

    Raises `Unsupported` for what this does not cover: GRAPH, other paths, DISTINCT over ``*``.
    Cost: one pass over the tree.
    """
    if query.where is None:
        raise Unsupported("a query without WHERE")
    if query.is_short:
        # A graph of triples as they are: there is nothing to count.
        return query
    return _Rewriter().query(query)


class _Rewriter:
    def __init__(self) -> None:
        self.patterns = 0
        self.nodes: dict[str, Variable] = {}

    def query(self, query: ast.Query) -> ast.Query:
        counts_all = ast.Aggregate("COUNT", None, distinct=True)
        own = (query.projection, query.having, query.order)
        if (query.modifier and query.selects_all) or counts_all in ast.walk(own):
            raise Unsupported("DISTINCT over *")
        assert query.where is not None, "only DESCRIBE has no WHERE"
        return replace(query, where=self.group(query.where))

    def group(self, group: ast.Group) -> ast.Group:
        return ast.Group(tuple(new for one in group.elements for new in self.element(one)))

    def element(self, element: ast.Element) -> Iterator[ast.Element]:
        match element:
            case ast.Triples(triples):
                yield from map(self.triple, triples)
            case ast.Group():
                yield self.group(element)
            case ast.Optional(group):
                yield ast.Optional(self.group(group))
            case ast.Union(groups):
                yield ast.Union(tuple(map(self.group, groups)))
            case ast.SubSelect(query):
                yield ast.SubSelect(self.query(query))
            case ast.Graph():
                raise Unsupported("GRAPH")
            case _:
                yield element

    def triple(self, triple: ast.Triple) -> ast.Element:
        subject, object = self.place(triple.subject), self.place(triple.object)
        pattern = ast.Triples((ast.Triple(subject, triple.predicate, object),))
        if not _counts(triple.predicate):
            return pattern
        self.patterns += 1
        return ast.Graph(Variable(f"{HIDDEN}{self.patterns}"), ast.Group((pattern,)))

    def place(self, term: ast.Place) -> ast.Place:
        """A term of a pattern. A blank node becomes a hidden variable: it stands in two graphs."""
        if not isinstance(term, BlankNode):
            return term
        return self.nodes.setdefault(term.value, Variable(f"{HIDDEN}node_{len(self.nodes)}"))


def _counts(verb: ast.Path | Variable) -> bool:
    """Whether a pattern with this predicate matches once a copy."""
    match verb:
        case NamedNode() | Variable():
            return verb != RDF_TYPE
        case ast.Repetition(NamedNode(), _):
            return False
    raise Unsupported("a property path")
