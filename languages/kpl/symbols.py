"""Which names stand for what ([DyKnow10 Def. 5.13]): the checker's index of a signature."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, assert_never

from .declarations import (
    CheckedDeclaration,
    CompunitDeclaration,
    ForeachDeclaration,
    GeneratorDeclaration,
    Label,
    SinkDeclaration,
    SortDeclaration,
    SourceDeclaration,
    StreamDeclaration,
    ValueSort,
)
from .dependencies import feature_token, generator_needs, reaches, tokens_needed

SOURCE: Final = "a source"
COMPUNIT: Final = "a computational unit"
STREAM: Final = "a stream"
SINK: Final = "a sink"
FEATURE: Final = "a feature"
OBJECT: Final = "an object"
SORT: Final = "a sort"
_ANY: Final = "\0"
"""Stands for the variable of a ``foreach``, whatever it is called."""


class Symbols:
    """Names by kind, and what is known of each feature. It grows with `add`.

    Sorts are apart from the other kinds, since one may share its name with a feature, as in
    Example 5.5.
    """

    def __init__(self, built_in: Iterable[str], declarations: Iterable[CheckedDeclaration]) -> None:
        self._kinds: dict[str, str] = {}
        self._sorts = set(built_in)
        self._labels: dict[str, Label] = {}
        """For each feature the first label, which shows how many objects it has."""
        self._patterns: dict[str, Label] = {}
        """The same of those that a ``foreach`` makes."""
        self._made: dict[str, list[ValueSort]] = {}
        """For each feature the sorts of its generators, each once."""
        self._edges: dict[str, set[str]] = {}
        """What the tokens of `dependencies` need."""
        self._mediated: dict[str, str] = {}
        """Tokens of features that are read for every object -> the first label that does."""
        self._configured: dict[tuple[str, Label], str] = {}
        """Members and pattern of each ``foreach``, whatever its variable is called -> its key."""
        for declaration in declarations:
            self.add(declaration)

    def clash(self, name: str, kind: str) -> str | None:
        """What else ``name`` is, if it cannot be of this kind too."""
        other = self._kinds.get(name)
        if kind == SORT:
            return None if other == FEATURE else other
        if other not in (None, kind):
            return other
        return SORT if kind != FEATURE and name in self._sorts else None

    def kind(self, name: str) -> str | None:
        """What ``name`` is, in words; None if it is nothing yet."""
        return self._kinds.get(name) or (SORT if name in self._sorts else None)

    def use_sort(self, name: str) -> None:
        """``name`` is a value sort from now on."""
        self._sorts.add(name)

    def is_used_sort(self, name: str) -> bool:
        return name in self._sorts

    def features(self) -> Iterable[str]:
        """Features of all generators."""
        return self._labels.keys()

    def example(self, feature: str) -> Label | None:
        """A label of the feature, which shows how many objects it has; None before the first."""
        return self._labels.get(feature)

    def pattern(self, feature: str) -> Label | None:
        """A label under which a ``foreach`` makes generators of the feature, if one does."""
        return self._patterns.get(feature)

    def sorts(self, feature: str) -> tuple[ValueSort, ...]:
        """The sorts of the feature's generators, each once."""
        return tuple(self._made.get(feature, ()))

    def reader(self, feature: str) -> str | None:
        """The label of one that reads the feature's streams of all objects, if any does."""
        return self._mediated.get(feature_token(feature))

    def configured(self, members: Label, pattern: Label, variable: str) -> str | None:
        """The key of the ``foreach`` that makes these generators for these objects, if one does."""
        return self._configured.get((str(members), pattern.bound(variable, _ANY)))

    def is_circle(self, feature: str, needs: Iterable[str]) -> bool:
        """Whether a stream of the feature that needs these tokens would be made out of streams of
        the feature, by way of a mediation or a ``foreach``. Labels alone make no circle: they are
        declared before they are used. Cost: linear in what is needed, if the feature is so read."""
        token = feature_token(feature)
        needs = tuple(needs)
        return (token in needs or token in self._mediated) and reaches(needs, token, self._edges)

    # -- growing ---------------------------------------------------------------------------

    def add(self, declaration: CheckedDeclaration) -> None:
        match declaration:
            case SourceDeclaration(name, sort):
                self._kinds[name] = SOURCE
                self._sorts.add(sort.name)
            case CompunitDeclaration(name, sort, inputs):
                self._kinds[name] = COMPUNIT
                self._sorts.update(each.name for each in (sort, *inputs))
            case GeneratorDeclaration():
                self._generator(declaration, declaration.label.objects)
                needs = tokens_needed(declaration)
                self._edges[declaration.key] = set(needs)
                token = feature_token(declaration.label.feature)
                self._edges.setdefault(token, set()).add(declaration.key)
                self._read(needs, declaration.key)
            case StreamDeclaration(name):
                self._kinds[name] = STREAM
            case SinkDeclaration(name):
                self._kinds[name] = SINK
            case SortDeclaration():
                self._sorts.add(declaration.name)
            case ForeachDeclaration(variable, members, generators):
                for generator in generators:
                    self.add_pattern(generator, variable, members.label)
                    pattern = generator.label.bound(variable, _ANY)
                    self._configured[str(members.label), pattern] = declaration.key
            case _:
                assert_never(declaration)

    def add_pattern(self, generator: GeneratorDeclaration, variable: str, members: Label) -> None:
        """A generator of a ``foreach``: its label has the variable among its objects."""
        feature = generator.label.feature
        self._patterns.setdefault(feature, generator.label)
        self._generator(generator, (o for o in generator.label.objects if o != variable))
        needs = {str(members), *generator_needs(generator, variable)}
        self._edges.setdefault(feature_token(feature), set()).update(needs)
        self._read(needs, generator.key)

    def _generator(self, generator: GeneratorDeclaration, objects: Iterable[str]) -> None:
        feature = generator.label.feature
        self._kinds[feature] = FEATURE
        self._kinds.update((object, OBJECT) for object in objects)
        self._labels.setdefault(feature, generator.label)
        sorts = self._made.setdefault(feature, [])
        if generator.sort not in sorts:
            sorts.append(generator.sort)

    def _read(self, needs: Iterable[str], reader: str) -> None:
        for token in needs:
            if token.startswith("feature "):
                self._mediated.setdefault(token, reader)
