"""The kinds of names ([DyKnow10 Def. 5.13]): the checker's index of a signature."""

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
"""A placeholder for the variable of a ``foreach``, whose name does not matter."""


class Symbols:
    """Names by kind, and facts about each feature. `add` extends it.

    Sorts are separate from the other kinds, since a sort may share its name with a feature, as in
    Example 5.5.
    """

    def __init__(self, built_in: Iterable[str], declarations: Iterable[CheckedDeclaration]) -> None:
        self._kinds: dict[str, str] = {}
        self._sorts = set(built_in)
        self._labels: dict[str, Label] = {}
        """For each feature its first label, which shows its number of objects."""
        self._patterns: dict[str, Label] = {}
        """For each feature its first label in a ``foreach``."""
        self._sorts_by_feature: dict[str, list[ValueSort]] = {}
        """For each feature the sorts of its generators, each once."""
        self._edges: dict[str, set[str]] = {}
        """For each token of `dependencies`, the tokens that it needs."""
        self._mediated: dict[str, str] = {}
        """Tokens of features that a declaration reads for every object -> the label of the first
        such declaration."""
        self._configured: dict[tuple[str, Label], str] = {}
        """Members and pattern of each ``foreach``, with any variable -> its key."""
        for declaration in declarations:
            self.add(declaration)

    def clash(self, name: str, kind: str) -> str | None:
        """Return the other kind of ``name`` if it excludes this kind."""
        other = self._kinds.get(name)
        if kind == SORT:
            return None if other == FEATURE else other
        if other not in (None, kind):
            return other
        return SORT if kind != FEATURE and name in self._sorts else None

    def kind(self, name: str) -> str | None:
        """Return the kind of ``name`` in words; None if it has none yet."""
        return self._kinds.get(name) or (SORT if name in self._sorts else None)

    def use_sort(self, name: str) -> None:
        """Mark ``name`` as a value sort."""
        self._sorts.add(name)

    def is_used_sort(self, name: str) -> bool:
        return name in self._sorts

    def features(self) -> Iterable[str]:
        """Return the features of all generators."""
        return self._labels.keys()

    def example(self, feature: str) -> Label | None:
        """Return a label of the feature, which shows its number of objects; None before
        the first."""
        return self._labels.get(feature)

    def pattern(self, feature: str) -> Label | None:
        """Return the label with which a ``foreach`` makes generators of the feature, if
        one does."""
        return self._patterns.get(feature)

    def sorts(self, feature: str) -> tuple[ValueSort, ...]:
        """Return the sorts of the feature's generators, each once."""
        return tuple(self._sorts_by_feature.get(feature, ()))

    def reader(self, feature: str) -> str | None:
        """Return the label of a declaration that reads the feature's streams of all objects, if
        there is one."""
        return self._mediated.get(feature_token(feature))

    def foreach_key(self, members: Label, pattern: Label, variable: str) -> str | None:
        """Return the key of the ``foreach`` that makes these generators for these objects, if there
        is one."""
        return self._configured.get((str(members), pattern.bound(variable, _ANY)))

    def is_circle(self, feature: str, needs: Iterable[str]) -> bool:
        """Return whether a stream of the feature with these needs would be made from streams of the
        feature, through a mediation or a ``foreach``. Labels alone form no circle: they are
        declared before they are used. Cost: linear in the needed tokens, if a declaration reads the
        feature so."""
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
        """Add a generator of a ``foreach``, whose label contains the variable."""
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
        sorts = self._sorts_by_feature.setdefault(feature, [])
        if generator.sort not in sorts:
            sorts.append(generator.sort)

    def _read(self, needs: Iterable[str], reader: str) -> None:
        for token in needs:
            if token.startswith("feature "):
                self._mediated.setdefault(token, reader)
