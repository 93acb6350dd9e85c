"""All KPL declarations so far ([DyKnow10 Def. 5.13]).

A signature is immutable: adding to it makes another one, so a refused text changes nothing.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

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
from .dependencies import in_dependency_order, tokens_made, tokens_needed

_D = TypeVar("_D", bound=CheckedDeclaration)


@dataclass(frozen=True)
class Signature:
    """All declarations so far, each after those that it uses.

    The *key* of a declaration is its name, a generator's label as text, ``sort NAME``, or ``foreach
    VARIABLE IN: LABELS``. A mediation or a foreach uses all generators of a feature but needs only
    one of them, so it comes after one at least.
    """

    declarations: tuple[CheckedDeclaration, ...] = ()

    @cached_property
    def by_key(self) -> dict[str, CheckedDeclaration]:
        return {declaration.key: declaration for declaration in self.declarations}

    def find(self, name_or_label: str) -> CheckedDeclaration | None:
        """Return the declaration of this key. A bare name finds a sort if no other declaration has
        it."""
        return self.by_key.get(name_or_label) or self.by_key.get(f"sort {name_or_label}")

    def source(self, name: str) -> SourceDeclaration | None:
        return self._of(SourceDeclaration, name)

    def compunit(self, name: str) -> CompunitDeclaration | None:
        return self._of(CompunitDeclaration, name)

    def generator(self, label: Label | str) -> GeneratorDeclaration | None:
        return self._of(GeneratorDeclaration, str(label))

    def stream(self, name: str) -> StreamDeclaration | None:
        return self._of(StreamDeclaration, name)

    def sink(self, name: str) -> SinkDeclaration | None:
        return self._of(SinkDeclaration, name)

    def foreach(self, key: str) -> ForeachDeclaration | None:
        return self._of(ForeachDeclaration, key)

    def sort(self, name: str) -> ValueSort | None:
        """Return a declared sort; None for predefined sorts and those of the ontology."""
        found = self._of(SortDeclaration, f"sort {name}")
        return None if found is None else found.sort

    def _of(self, kind: type[_D], key: str) -> _D | None:
        found = self.by_key.get(key)
        return found if isinstance(found, kind) else None

    def with_declarations(self, new: Iterable[CheckedDeclaration]) -> Signature:
        """Return a signature with ``new`` at the end; they were checked against this one."""
        return Signature((*self.declarations, *new))

    def dependents(self, name_or_label: str) -> tuple[str, ...]:
        """Return the keys of all declarations that need it, directly or not; users before the used
        ones.

        A mediation or foreach does not need a generator as long as its feature has another, or a
        foreach that makes them. Empty for an unknown name. Cost: linear in the declarations.
        """
        found = self.find(name_or_label)
        if found is None:
            return ()
        others = [declaration for declaration in self.declarations if declaration.key != found.key]
        founded = {
            declaration.key for declaration in in_dependency_order(others, self._makers.keys())
        }
        return tuple(d.key for d in reversed(others) if d.key not in founded)

    def uses(self, declaration: CheckedDeclaration) -> tuple[str, ...]:
        """Return the keys of the declarations that this one names directly; for the streams of a
        feature, all its generators and the declarations that make them."""
        found = (key for token in tokens_needed(declaration) for key in self._makers.get(token, ()))
        return tuple(dict.fromkeys(found))

    def without(self, names: Iterable[str]) -> Signature:
        """Return a signature without these. Raises `ValueError` for an undeclared name, and for one
        that a remaining declaration needs (`dependents`). The remaining declarations may move,
        since each comes after those that it uses."""
        keys = set()
        for name in names:
            found = self.find(name)
            if found is None:
                raise ValueError(f"{name!r} is not declared")
            keys.add(found.key)
        others = [declaration for declaration in self.declarations if declaration.key not in keys]
        founded = in_dependency_order(others, self._makers.keys())
        if len(founded) < len(others):
            # The first remaining one lacks a named declaration, since those that it uses come
            # before it.
            founded_keys = {declaration.key for declaration in founded}
            first = next(
                declaration for declaration in others if declaration.key not in founded_keys
            )
            used = keys.intersection(self.uses(first))
            raise ValueError(f"{first.key!r} needs {min(used)!r}: remove it as well")
        return Signature(tuple(founded))

    @cached_property
    def _makers(self) -> dict[str, tuple[str, ...]]:
        """For each token, the keys of the declarations that make it."""
        makers: dict[str, list[str]] = {}
        for declaration in self.declarations:
            for token in tokens_made(declaration):
                makers.setdefault(token, []).append(declaration.key)
        return {token: tuple(keys) for token, keys in makers.items()}
