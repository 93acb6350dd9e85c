"""Walks over the groups of a pattern, and the sorts that they state (SPEC §8)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from typing import Final, TypeAlias

from ...ontology.vocabulary import THING
from ...sparql import ast as sparql
from ...sparql.ast import variables_of
from . import ast
from .triples import Read, Reading, Sorts, Term

Classes: TypeAlias = Mapping[Term, frozenset[str]]
"""The sorts (IRIs) that an object has in each solution."""
_NOTHING: Final[frozenset[str]] = frozenset()


def parts_in(part: ast.Part) -> Iterator[ast.Part]:
    """Yield a part and all within it, in reading order."""
    yield part
    match part:
        case ast.Group(parts):
            for each in parts:
                yield from parts_in(each)
        case ast.Operation(_, left, right):
            yield from parts_in(left)
            yield from parts_in(right)


def variables_in(part: ast.Part) -> dict[str, None]:
    """Return the variables of a part itself, without those of groups in it."""
    match part:
        case sparql.Triples():
            return variables_of(part)
        case ast.Filter(condition):
            return variables_of(condition)
        case ast.Bind(expression):
            return variables_of(expression)
        case ast.Graph(_, triples):
            return variables_of(triples)
        case _:
            return {}


def classes_of(part: ast.Part, reads: Callable[[sparql.Triples], tuple[Read, ...]]) -> Classes:
    """Return the sorts of the objects in each solution of a part of a group. An object of a sample
    is at least a `THING`."""
    found: dict[Term, frozenset[str]] = {}
    match part:
        case sparql.Triples():
            for read in reads(part):
                match read:
                    case Reading():
                        found = union(found, dict.fromkeys(read.arguments, frozenset({THING})))
                    case Sorts(subject, sort):
                        found = union(found, {subject: frozenset({sort})})
        case ast.Group(parts):
            for each in parts:
                found = union(found, classes_of(each, reads))
        case ast.Operation(operator, left, right):
            one, other = classes_of(left, reads), classes_of(right, reads)
            match operator:
                case ast.Operator.UNION:
                    return {name: one[name] & other[name] for name in one if name in other}
                case ast.Operator.OPTIONALSEQ:
                    return other
                case ast.Operator.EQUALSOPTIONAL:
                    return one
            return union(one, other)
    return found


def union(left: Classes, right: Classes) -> dict[Term, frozenset[str]]:
    """Return the sorts of both."""
    names = dict.fromkeys([*left, *right])
    return {name: left.get(name, _NOTHING) | right.get(name, _NOTHING) for name in names}


def triples_in(part: ast.Part) -> Iterator[sparql.Triples]:
    """Yield the triples of a part, without those of GRAPH, in reading order."""
    match part:
        case sparql.Triples():
            yield part
        case ast.Group(parts):
            for each in parts:
                yield from triples_in(each)
        case ast.Operation(_, left, right):
            yield from triples_in(left)
            yield from triples_in(right)
