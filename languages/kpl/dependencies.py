"""The dependencies between declarations ([DyKnow10 Def. 4.6, 4.7, 5.13-5.20]).

A declaration *makes* and *needs* tokens: keys of declarations, and ``feature pos`` for any
generator of a feature. `signature` removes declarations by them; `check` detects circles.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from collections.abc import Set as AbstractSet
from typing import assert_never

from .declarations import (
    Aggregate,
    CheckedDeclaration,
    CompunitDeclaration,
    Compute,
    ForeachDeclaration,
    FromSource,
    GeneratorDeclaration,
    JoinOf,
    Select,
    SelectObject,
    SinkDeclaration,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    Synchronize,
)


def feature_token(feature: str) -> str:
    """Return the token that each generator of the feature makes."""
    return f"feature {feature}"


def tokens_made(declaration: CheckedDeclaration) -> tuple[str, ...]:
    """Return the tokens that a declaration makes, each once."""
    match declaration:
        case GeneratorDeclaration():
            return (declaration.key, feature_token(declaration.label.feature))
        case ForeachDeclaration():
            made = (feature_token(generator.label.feature) for generator in declaration.generators)
            return (declaration.key, *dict.fromkeys(made))
        case (
            SourceDeclaration()
            | CompunitDeclaration()
            | StreamDeclaration()
            | SortDeclaration()
            | SinkDeclaration()
        ):
            return (declaration.key,)
        case _:
            assert_never(declaration)


def tokens_needed(declaration: CheckedDeclaration) -> tuple[str, ...]:
    """Return the tokens that a declaration needs, each once. A needed sort may be undeclared."""
    own = tokens_made(declaration)
    return tuple(token for token in dict.fromkeys(_needs(declaration)) if token not in own)


def _needs(declaration: CheckedDeclaration) -> Iterator[str]:
    match declaration:
        case SourceDeclaration():
            yield f"sort {declaration.sort.name}"
        case CompunitDeclaration():
            for sort in (declaration.sort, *declaration.inputs):
                yield f"sort {sort.name}"
        case GeneratorDeclaration():
            yield from generator_needs(declaration)
        case StreamDeclaration():
            yield str(declaration.term.label)
        case ForeachDeclaration():
            yield str(declaration.members.label)
            for generator in declaration.generators:
                yield from generator_needs(generator, declaration.variable)
        case SinkDeclaration():
            for term in declaration.terms:
                yield str(term.label)
        case SortDeclaration():
            # Its fields are copies, so it needs no other sort.
            pass
        case _:
            assert_never(declaration)


def generator_needs(generator: GeneratorDeclaration, *variables: str) -> Iterator[str]:
    """Yield the tokens that a generator needs. A label with one of ``variables`` needs any
    generator of its feature."""
    match generator.process:
        case FromSource(name) | Compute(name):
            yield name
        case Aggregate(variable) | Select(variable):
            variables = (*variables, variable)
        case JoinOf() | Synchronize() | SelectObject():
            pass
        case _:
            assert_never(generator.process)
    for term in generator.terms:
        if set(variables).isdisjoint(term.label.objects):
            yield str(term.label)
        else:
            yield feature_token(term.label.feature)


def in_dependency_order(
    declarations: Iterable[CheckedDeclaration], known: AbstractSet[str]
) -> list[CheckedDeclaration]:
    """Return the declarations whose needs among the tokens ``known`` are met, each after those that
    it uses, otherwise in the given order. Cost: linear; in the worst case once more for each
    declaration that moves."""
    waiting, done = list(declarations), list[CheckedDeclaration]()
    available: set[str] = set()
    while waiting:
        left = []
        for declaration in waiting:
            if all(
                token in available or token not in known for token in tokens_needed(declaration)
            ):
                available.update(tokens_made(declaration))
                done.append(declaration)
            else:
                left.append(declaration)
        if len(left) == len(waiting):
            break
        waiting = left
    return done


def reaches(start: Iterable[str], wanted: str, edges: Mapping[str, AbstractSet[str]]) -> bool:
    """Return whether ``start`` needs ``wanted``, directly or not. Cost: linear in the needed
    tokens."""
    visited, todo = set[str](), list(start)
    while todo:
        token = todo.pop()
        if token == wanted:
            return True
        if token not in visited:
            visited.add(token)
            todo.extend(edges.get(token, ()))
    return False
