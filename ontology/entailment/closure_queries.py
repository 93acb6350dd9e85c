"""Answers users' SPARQL: over several graphs as over their merge, and over a store with deep
hierarchies as if it contained all their pairs.

For deep hierarchies it rewrites each triple pattern that may match a pair: a UNION of the pattern
and of a path over the marks (`deep_hierarchies`) that yields each missing pair once. The result
depends only on the marks in the graph that the pattern reads, so GRAPH and FROM need no rule of
their own. A variable predicate, a negated path and DESCRIBE see the pairs but not the marks.

Law (tests/laws/ontology/test_deep_hierarchies.py): the answers equal those over the pairs, with
three exceptions. In `(rdfs:subClassOf/path)+`, a repeated sequence, a class of a cycle is its own
sub-class; the terms above owl:Thing may be standard terms; and a repeated path over the entailments
without the graph that states a pair sees that pair.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain, count
from typing import TypeAlias

from pyoxigraph import (
    BlankNode,
    DefaultGraph,
    NamedNode,
    Quad,
    QueryBoolean,
    QuerySolutions,
    QueryTriples,
    Store,
    Variable,
)

from ...sparql import ast
from ...sparql.printer import print_query
from ...sparql.scope import projected_variables, visible_variables
from ..texts.query_guard import Dataset, read_query
from ..texts.turtle import ALL_PREFIXES
from .deep_hierarchies import MARKERS, Marks, deep_kinds, missing_pairs

QueryResults: TypeAlias = QuerySolutions | QueryBoolean | QueryTriples


def answer(store: Store, text: str, dataset: Dataset | None = None, base: str = "") -> QueryResults:
    """Check a query (`query_guard`) and evaluate it; ``dataset`` replaces the one of its FROM
    clauses, ``base`` resolves relative IRIs.

    Raises `QueryRefused`, and the errors of Oxigraph. Cost: the query's. Over deep hierarchies the
    text is also printed and parsed once more; several graphs in the default graph are copied
    first, with the named ones of the dataset.
    """
    query, stated = read_query(text, base)
    dataset = dataset or stated
    kinds = deep_kinds(store)
    if not kinds:
        return _evaluate(store, text, dataset, base)
    found = _evaluate(store, print_query(with_pairs(query, kinds)), dataset, base)
    if query.form is ast.Form.DESCRIBE:
        assert isinstance(found, QueryTriples)
        return _replace_marks(store, found)
    return found


def _evaluate(store: Store, text: str, dataset: Dataset | None, base: str) -> QueryResults:
    if dataset is None:
        return store.query(text, prefixes=ALL_PREFIXES, base_iri=base or None)
    default, named = dict.fromkeys(dataset[0]), dict.fromkeys(dataset[1])
    default_graphs: list[NamedNode | BlankNode | DefaultGraph] = list(default)
    if len(default) > 1:
        store, default_graphs = _merged(store, default, named), [DefaultGraph()]
    # Both lists, even if empty: for a missing one Oxigraph takes those of FROM or of the store.
    return store.query(
        text,
        prefixes=ALL_PREFIXES,
        base_iri=base or None,
        default_graph=default_graphs,
        named_graphs=list(named),
    )


def _merged(store: Store, default: Iterable[NamedNode], named: Iterable[NamedNode]) -> Store:
    """Return the graphs ``named``, with the merge of the graphs ``default`` as the default graph.
    Over several graphs Oxigraph itself yields a triple once for each graph that has it."""
    found = Store()
    for graph in default:
        quads = store.quads_for_pattern(None, None, None, graph)
        found.extend(Quad(quad.subject, quad.predicate, quad.object) for quad in quads)
    for graph in named:
        found.extend(store.quads_for_pattern(None, None, None, graph))
    return found


def _replace_marks(store: Store, found: QueryTriples) -> QueryResults:
    """Replace the marks in the result of a DESCRIBE by the pairs of the described nodes."""
    triples = list(found)
    described = {triple.subject for triple in triples if triple.predicate in MARKERS}
    described_store = Store()
    described_store.extend(
        Quad(t.subject, t.predicate, t.object) for t in triples if t.predicate not in MARKERS
    )
    for node in described:
        assert isinstance(node, NamedNode | BlankNode)
        described_store.extend(Quad(*pair) for pair in missing_pairs(store, node, None, None, None))
    return described_store.query("CONSTRUCT { ?s ?p ?o } WHERE { ?s ?p ?o }")


def with_pairs(query: ast.Query, kinds: Iterable[Marks]) -> ast.Query:
    """Rewrite ``query`` so that it yields over the marks what it yields over the pairs."""
    return _Rewriter(query, tuple(kinds)).query(query)


class _Rewriter:
    def __init__(self, query: ast.Query, kinds: tuple[Marks, ...]) -> None:
        self._marks = {predicate: marks for marks in kinds for predicate in marks.kind}
        names = ast.variables_of(query)
        self._free = (
            Variable(name) for number in count() if (name := f"step_{number}") not in names
        )
        self._nodes: dict[BlankNode, Variable] = {}
        parts = (one for one in ast.walk(query) if isinstance(one, ast.Triple | ast.Values))
        self._uses = Counter(name for part in parts for name in ast.variables_of(part))
        """For each variable, the number of patterns and tables that contain it."""

    def query(self, query: ast.Query) -> ast.Query:
        """Rewrite a query. ``*`` and the short form are written out first: they would expose the
        added variables."""
        query = ast.rewrite(query, _expand_star)
        if query.is_short:
            query = replace(query, is_short=False)
        return ast.rewrite(query, self._change)

    def _change(self, node: object) -> ast.Group | None:
        if not isinstance(node, ast.Group):
            return None
        elements: list[ast.Element] = []
        for element in node.elements:
            if isinstance(element, ast.Triples):
                elements += chain.from_iterable(map(self._triple, element.triples))
            else:
                elements.append(ast.rewrite(element, self._change))
        return ast.Group(tuple(elements), node.span)

    def _triple(self, triple: ast.Triple) -> Iterator[ast.Element]:
        subject, object = self._place(triple.subject), self._place(triple.object)
        verb = triple.predicate
        if isinstance(verb, Variable):
            yield self._any(subject, verb, object)
        elif self._touches(verb):
            yield from self._path(subject, verb, object)
        else:
            yield _triples(subject, verb, object)

    def _place(self, term: ast.Place) -> ast.Place:
        """Replace a blank node by a variable, since it may now stand in several groups."""
        if not isinstance(term, BlankNode):
            return term
        if term not in self._nodes:
            self._nodes[term] = next(self._free)
        return self._nodes[term]

    def _touches(self, path: ast.Path) -> bool:
        return any(isinstance(p, ast.NegatedSet) or p in self._marks for p in ast.walk(path))

    # -- patterns ------------------------------------------------------------------------------

    def _any(self, subject: ast.Place, verb: Variable, object: ast.Place) -> ast.Union:
        no_marks = ast.Filter(ast.In(verb, tuple(sorted(MARKERS, key=str)), negated=True))
        groups = [ast.Group((_triples(subject, verb, object), no_marks))]
        for predicate in self._marks:
            missing = self._missing(subject, predicate, object)
            binding = ast.Values((verb,), ((predicate,),))
            groups.append(ast.Group((binding, missing)))
        return ast.Union(tuple(groups))

    def _missing(self, subject: ast.Place, predicate: NamedNode, object: ast.Place) -> ast.Group:
        """Return a group that yields the pairs of ``predicate`` missing in the store, each once."""
        marks = self._marks[predicate]
        stored_as = marks.inclusion if predicate == marks.kind[0] else marks.equivalence
        assert not isinstance(subject, BlankNode)
        assert not isinstance(object, BlankNode)
        conditions: tuple[ast.Expression, ...] = (
            ast.Unary("!", ast.Call("SAMETERM", (subject, object))),
            ast.Exists(ast.Group((_triples(subject, stored_as, object),)), negated=True),
        )
        lower = _triples(subject, marks.lower, subject)
        pair = _triples(subject, _edges(marks, predicate), object)
        ends = [place for place in (subject, object) if isinstance(place, Variable)]
        if len(ends) == 2 and self._uses[ends[1].value] == 1:
            # Oxigraph finds all pairs of a path at once, but the pairs of given nodes one by one.
            return ast.Group((lower, pair, *map(ast.Filter, conditions)))
        is_lower = ast.Exists(ast.Group((lower,)), negated=False)
        found = ast.Group((pair, *map(ast.Filter, (*conditions, is_lower))))
        # From a constant the path yields its pairs at once. A sub-query keeps Oxigraph from testing
        # each end that the rest of the query yields.
        return _sub_select(found, ends) if len(ends) == 1 else found

    # -- paths ---------------------------------------------------------------------------------

    def _path(self, subject: ast.Place, path: ast.Path, object: ast.Place) -> Iterator[ast.Element]:
        """Yield elements that bind the ends of ``path`` with the multiplicity of the path."""
        match path:
            case NamedNode() if path in self._marks:
                stored = ast.Group((_triples(subject, path, object),))
                yield ast.Union((stored, self._missing(subject, path, object)))
            case ast.Inverse(inner):
                yield from self._path(object, inner, subject)
            case ast.Sequence(parts):
                places = [subject, *(next(self._free) for _ in parts[1:]), object]
                for part, start, stop in zip(parts, places, places[1:], strict=False):
                    yield from self._path(start, part, stop)
            case ast.Alternative(parts):
                groups = [ast.Group(tuple(self._path(subject, p, object))) for p in parts]
                yield self._distinct(subject, groups, object)
            case ast.NegatedSet():
                yield self._negated_path(subject, path, object)
            case ast.Repetition(inner, sign):
                yield _triples(subject, ast.Repetition(self._steps(inner), sign), object)
            case _:
                yield _triples(subject, path, object)

    def _distinct(
        self, subject: ast.Place, groups: Iterable[ast.Group], object: ast.Place
    ) -> ast.Group:
        """Return each solution of ``groups`` once: Oxigraph's alternatives are sets of pairs."""
        ends = [place for place in (subject, object) if isinstance(place, Variable)]
        found = ast.Group((ast.Union(tuple(groups)),))
        return _sub_select(found, dict.fromkeys(ends or [next(self._free)]), "DISTINCT")

    def _negated_path(
        self, subject: ast.Place, path: ast.NegatedSet, object: ast.Place
    ) -> ast.Element:
        groups: list[ast.Group] = []
        for no_marks, but, is_inverse in _directions(path):
            start, stop = (object, subject) if is_inverse else (subject, object)
            groups.append(ast.Group((_triples(start, no_marks, stop),)))
            groups += (self._missing(start, p, stop) for p in self._marks if p not in but)
        if path.forward and path.backward:
            return self._distinct(subject, groups, object)
        return ast.Union(tuple(groups))

    def _steps(self, path: ast.Path) -> ast.Path:
        """Rewrite a repeated path, of which only the set of pairs matters."""

        def change(path: object) -> ast.Path | None:
            if isinstance(path, ast.NegatedSet):
                parts: list[ast.Path] = []
                for no_marks, but, is_inverse in _directions(path):
                    found = [
                        no_marks,
                        *(_step(m, p) for p, m in self._marks.items() if p not in but),
                    ]
                    parts += map(ast.Inverse, found) if is_inverse else found
                return ast.Alternative(tuple(parts))
            if isinstance(path, NamedNode) and path in self._marks:
                return ast.Alternative((path, _step(self._marks[path], path)))
            return None

        return ast.rewrite(path, change)


def _triples(subject: ast.Place, verb: ast.Path | Variable, object: ast.Place) -> ast.Triples:
    return ast.Triples((ast.Triple(subject, verb, object),))


def _sub_select(where: ast.Group, variables: Iterable[Variable], modifier: str = "") -> ast.Group:
    projection = tuple(map(ast.SelectItem, variables))
    query = ast.Query(ast.Form.SELECT, where, modifier=modifier, projection=projection)
    return ast.Group((ast.SubSelect(query),))


def _edges(marks: Marks, predicate: NamedNode) -> ast.Path:
    """Return the path over marks that yields the pairs of ``predicate``. It also yields each node
    of a cycle with itself, and the nodes above standard terms."""
    if predicate == marks.kind[1]:
        return ast.Sequence((marks.component, ast.Inverse(marks.component)))
    edges = (marks.inclusion, marks.equivalence, ast.Inverse(marks.equivalence))
    return ast.Repetition(ast.Alternative(edges), "+")


def _step(marks: Marks, predicate: NamedNode) -> ast.Path:
    """Return `_edges` without the nodes above standard terms. Oxigraph evaluates such a sequence
    from each start even if the end is known, so it serves repetitions only."""
    return ast.Sequence((marks.lower, _edges(marks, predicate)))


def _directions(
    path: ast.NegatedSet,
) -> Iterator[tuple[ast.NegatedSet, tuple[NamedNode, ...], bool]]:
    """Yield the directions of a negated path: the path without marks, the predicates that it
    excludes, and whether it is inverse."""
    markers = tuple(sorted(MARKERS, key=str))
    if path.forward or not path.backward:
        yield ast.NegatedSet((*path.forward, *markers), ()), path.forward, False
    if path.backward:
        yield ast.NegatedSet((*path.backward, *markers), ()), path.backward, True


def _expand_star(query: object) -> ast.Query | None:
    """Write ``*`` out as all variables, ordered as Oxigraph orders them."""
    if not (isinstance(query, ast.Query) and query.selects_all and query.where is not None):
        return None
    if query.form is ast.Form.DESCRIBE:
        names = {
            **visible_variables(query.where),
            **(visible_variables(query.values) if query.values else {}),
        }
        described = tuple(map(Variable, sorted(names)))
        return ast.rewrite(replace(query, described=described), _expand_star) if names else None
    projection = tuple(
        ast.SelectItem(Variable(name)) for name in sorted(projected_variables(query))
    )
    return ast.rewrite(replace(query, projection=projection), _expand_star) if projection else None
