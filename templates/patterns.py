"""What the body of a query says, read off its algebra: patterns with the sorts of their subjects.

`instantiate` asks where a parameter stands, `needs` which features of which objects are used.
rdflib's algebra is a tree of `CompValue`; only basic graph patterns and expressions matter here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, TypeAlias

from rdflib import URIRef
from rdflib.namespace import RDF
from rdflib.paths import InvPath, Path
from rdflib.plugins.sparql.parserutils import CompValue

from ..languages.attached import attached

Typing: TypeAlias = Mapping[Any, frozenset[Any]]
"""Subject -> the classes that every solution says it has."""

_ROOTS = ("SelectQuery", "ConstructQuery", "AskQuery", "DescribeQuery")


@dataclass(frozen=True, slots=True)
class Pattern:
    """A triple pattern in WHERE, in rdflib terms, and the classes required of its subject."""

    subject: Any
    predicate: Any
    object: Any
    classes: frozenset[Any]


@attached
def patterns(root: CompValue) -> tuple[Pattern, ...]:
    """The triple patterns over the default graph, in reading order of the algebra.

    A property path is a pattern for each of its steps. What is in GRAPH is not of the streams
    and left out. ``classes`` are those of ``?o a S`` patterns that must hold along with the
    pattern: not those in another branch of a UNION or in an OPTIONAL. Cost: found once a root.
    """
    return tuple(_patterns(root, {}, top=True))


def _patterns(node: CompValue, inherited: Typing, *, top: bool) -> Iterator[Pattern]:
    if node.name in ("Graph", "GraphGraphPattern"):
        return
    if node.name == "Project" and not top:
        # A sub-query is evaluated on its own; its variables are not those around it.
        inherited = {}
    classes = _joined(inherited, _required(node))
    for subject, predicate, object in _triples(node):
        for s, p, o in _steps(subject, predicate, object):
            yield Pattern(s, p, o, classes.get(s, frozenset()))
    for child in children(node):
        yield from _patterns(child, classes, top=top and node.name in (*_ROOTS, "Project"))


def _required(node: CompValue) -> Typing:
    """The classes that hold of a subject in each solution of ``node``."""
    match node.name:
        case "BGP" | "TriplesBlock":
            found: dict[Any, frozenset[Any]] = {}
            for subject, predicate, object in _triples(node):
                if predicate == RDF.type:
                    found[subject] = found.get(subject, frozenset()) | {object}
            return found
        case "GroupGraphPatternSub":
            blocks = (_required(part) for part in node.part if part.name == "TriplesBlock")
            return reduce(_joined, blocks, {})
        case "Join":
            return _joined(_required(node.p1), _required(node.p2))
        case "LeftJoin" | "Minus":
            return _required(node.p1)
        case "Union":
            left, right = _required(node.p1), _required(node.p2)
            return {subject: left[subject] & right[subject] for subject in left if subject in right}
        case "Project":
            return {s: c for s, c in _required(node.p).items() if s in node.PV}
        case "Graph":
            return {}
        case _:
            inner = node.p
            return _required(inner) if isinstance(inner, CompValue) else {}


def _triples(node: CompValue) -> Iterator[tuple[Any, Any, Any]]:
    """The triple patterns of a node that holds some.

    Inside EXISTS rdflib may leave the parse tree as it was: flat lists, three terms a pattern.
    """
    if node.name == "BGP":
        yield from node.triples
    elif node.name == "TriplesBlock":
        for flat in node.triples:
            terms = list(flat)
            yield from zip(terms[::3], terms[1::3], terms[2::3], strict=True)


def _joined(left: Typing, right: Typing) -> Typing:
    return {
        subject: left.get(subject, frozenset()) | right.get(subject, frozenset())
        for subject in (*left, *right)
    }


def _steps(subject: Any, predicate: Any, object: Any) -> Iterator[tuple[Any, Any, Any]]:
    """A pattern a predicate. Inside a path, subjects and objects have no names."""
    if not isinstance(predicate, Path):
        yield subject, predicate, object
        return
    for step in _path_predicates(predicate):
        yield (object if isinstance(predicate, InvPath) else None), step, None


def _path_predicates(path: Any) -> Iterator[Any]:
    if isinstance(path, URIRef):
        yield path
    elif isinstance(path, Path):
        # Sequences, alternatives and negations have args; inverses an arg; repetitions a path.
        parts = vars(path).values()
        for part in parts:
            for inner in part if isinstance(part, list) else [part]:
                yield from _path_predicates(inner)


def children(node: CompValue) -> Iterator[CompValue]:
    """The nodes directly below, expressions and the groups of EXISTS among them."""
    for value in node.values():
        yield from _nodes_in(value)


def _nodes_in(value: Any) -> Iterator[CompValue]:
    if isinstance(value, CompValue):
        yield value
    elif isinstance(value, Sequence) and not isinstance(value, str):
        for item in value:
            yield from _nodes_in(item)


def everything(node: CompValue) -> Iterator[CompValue]:
    """``node`` and all below it."""
    yield node
    for child in children(node):
        yield from everything(child)


def head_subjects(root: CompValue) -> tuple[Any, ...]:
    """The subjects of a CONSTRUCT head, each once; empty for other forms."""
    triples = root.template or []
    return tuple(dict.fromkeys(subject for subject, _, _ in triples))
