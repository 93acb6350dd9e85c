"""Extracts the triple patterns of a query, with the sorts of their subjects.

`instantiate` looks up the places of a parameter; `needs` collects the used features of objects.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import reduce
from typing import TypeAlias

from pyoxigraph import NamedNode, Variable

from ..languages.object_cache import ObjectCache
from ..rdf.namespaces import RDF_TYPE
from ..sparql import ast
from ..sparql.algebra import split_group
from ..sparql.scope import projected_variables

Typing: TypeAlias = Mapping[ast.Place, frozenset[ast.Place]]
"""Subject -> the classes that it has in every solution."""


@dataclass(frozen=True, slots=True)
class Pattern:
    """A triple pattern in WHERE, and the classes required of its subject. Subjects and objects
    inside a path have no names: None."""

    subject: ast.Place | None
    predicate: NamedNode | Variable
    object: ast.Place | None
    classes: frozenset[ast.Place]


@ObjectCache
def patterns(query: ast.Query) -> tuple[Pattern, ...]:
    """Return the triple patterns over the default graph, in join order.

    A property path yields a pattern for each of its steps. GRAPH is left out, since streams do not
    feed it. ``classes`` are those of ``?o a S`` patterns that must match along with the pattern, so
    not those of an OPTIONAL or of another branch of a UNION. Cost: computed once for a query.
    """
    return tuple(_of_query(query, {}))


def _of_query(query: ast.Query, inherited: Typing) -> Iterator[Pattern]:
    if query.where is not None:
        yield from _of_group(query.where, inherited)
    for part in (query.projection, query.keys, query.having, query.order):
        for group in _existing(part):
            yield from _of_group(group, inherited)


def _of_group(
    group: ast.Group, inherited: Typing, *, is_optional: bool = False
) -> Iterator[Pattern]:
    classes = _union(inherited, _required_classes(group))
    parts, conditions = split_group(group)
    existing = [inner for condition in conditions for inner in _existing(condition)]
    tested = (found for inner in existing for found in _of_group(inner, classes))
    # A generator: what this loop yields, the last one does not yield again.
    if not is_optional:
        yield from tested
    for part in parts:
        yield from _of_part(part, classes)
    yield from tested


def _of_part(part: ast.Element, classes: Typing) -> Iterator[Pattern]:
    match part:
        case ast.Triples(triples):
            for triple in triples:
                yield from _steps(triple, classes)
        case ast.Group() | ast.Minus():
            yield from _of_group(part if isinstance(part, ast.Group) else part.group, classes)
        case ast.Optional(group):
            yield from _of_group(group, classes, is_optional=True)
        case ast.Union(groups):
            for group in groups:
                yield from _of_group(group, classes)
        case ast.SubSelect(query):
            # A sub-query is evaluated on its own; its variables are separate.
            yield from _of_query(query, {})
        case ast.Bind(expression, _):
            for group in _existing(expression):
                yield from _of_group(group, classes)
        case ast.Graph() | ast.Values() | ast.Filter():
            pass


def _existing(node: object) -> Iterator[ast.Group]:
    """Return the groups of EXISTS in an expression, without nested ones."""
    return (one.group for one in ast.walk(node, ast.Exists) if isinstance(one, ast.Exists))


def _required_classes(group: ast.Group) -> Typing:
    """Return the classes that a subject has in each solution of a group."""
    return reduce(_union, map(_classes_required_by, group.elements), {})


def _classes_required_by(element: ast.Element) -> Typing:
    match element:
        case ast.Triples(triples):
            found: dict[ast.Place, frozenset[ast.Place]] = {}
            for triple in triples:
                if triple.predicate == RDF_TYPE:
                    classes = found.get(triple.subject, frozenset())
                    found[triple.subject] = classes | {triple.object}
            return found
        case ast.Group():
            return _required_classes(element)
        case ast.Union(groups):
            return reduce(_intersection, map(_required_classes, groups))
        case ast.SubSelect(query) if query.where is not None:
            names = projected_variables(query)
            return {
                subject: classes
                for subject, classes in _required_classes(query.where).items()
                if isinstance(subject, Variable) and subject.value in names
            }
        case _:
            return {}


def _intersection(left: Typing, right: Typing) -> Typing:
    return {subject: left[subject] & right[subject] for subject in left if subject in right}


def _union(left: Typing, right: Typing) -> Typing:
    return {
        subject: left.get(subject, frozenset()) | right.get(subject, frozenset())
        for subject in (*left, *right)
    }


def _steps(triple: ast.Triple, classes: Typing) -> Iterator[Pattern]:
    """Yield a pattern for each predicate."""
    verb = triple.predicate
    if isinstance(verb, NamedNode | Variable):
        none: frozenset[ast.Place] = frozenset()
        yield Pattern(triple.subject, verb, triple.object, classes.get(triple.subject, none))
        return
    subject = triple.object if isinstance(verb, ast.Inverse) else None
    classes_of_end = frozenset() if subject is None else classes.get(subject, frozenset())
    for step in ast.walk(verb):
        if isinstance(step, NamedNode):
            yield Pattern(subject, step, None, classes_of_end)


def head_subjects(query: ast.Query) -> tuple[ast.Place, ...]:
    """Return the subjects of a CONSTRUCT head, each once; empty for other forms."""
    triples: Iterable[ast.Triple] = query.template or ()
    return tuple(dict.fromkeys(triple.subject for triple in triples))
