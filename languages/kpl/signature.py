"""All KPL declarations so far ([DyKnow10 Def. 5.13]): looked up, added to, taken from.

A signature with more in it is another signature, so a text that is refused has changed nothing.
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
    """All declarations so far, in an order in which each stands behind what it uses.

    A declaration's *key* is its name, a generator's label as text, ``sort NAME``, or
    ``foreach VARIABLE IN: LABELS``. A mediation or a foreach uses all generators of a feature, and
    stands behind one of them at least: it needs one, whichever it is.
    """

    declarations: tuple[CheckedDeclaration, ...] = ()

    @cached_property
    def by_key(self) -> dict[str, CheckedDeclaration]:
        return {declaration.key: declaration for declaration in self.declarations}

    def find(self, name_or_label: str) -> CheckedDeclaration | None:
        """The declaration of this key; of a sort by its bare name too, if nothing else has it."""
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
        """A sort that was declared; None for those of the language and the ontology."""
        found = self._of(SortDeclaration, f"sort {name}")
        return None if found is None else found.sort

    def _of(self, kind: type[_D], key: str) -> _D | None:
        found = self.by_key.get(key)
        return found if isinstance(found, kind) else None

    def with_declarations(self, new: Iterable[CheckedDeclaration]) -> Signature:
        """The same with ``new`` behind all; they were checked against it."""
        return Signature((*self.declarations, *new))

    def dependents(self, name_or_label: str) -> tuple[str, ...]:
        """Keys of all that cannot be without it, directly or not; users before what they use.

        A mediation or foreach can be without one generator as long as the feature has another, or
        a foreach that makes them. Empty for an unknown name. Cost: linear in the declarations.
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
        """Keys of what the declaration names directly; of a feature's streams all generators and
        all that make them."""
        found = (key for token in tokens_needed(declaration) for key in self._makers.get(token, ()))
        return tuple(dict.fromkeys(found))

    def without(self, names: Iterable[str]) -> Signature:
        """The same without these. Raises `ValueError` for a name that is not declared, and for
        one that something left behind needs; `dependents` tells them. What is left may change its
        place: it stands behind what it uses."""
        keys = set()
        for name in names:
            found = self.find(name)
            if found is None:
                raise ValueError(f"{name!r} is not declared")
            keys.add(found.key)
        others = [declaration for declaration in self.declarations if declaration.key not in keys]
        founded = in_dependency_order(others, self._makers.keys())
        if len(founded) < len(others):
            # The first in order lacks something that was named, as what it uses stands before it.
            founded_keys = {declaration.key for declaration in founded}
            first = next(
                declaration for declaration in others if declaration.key not in founded_keys
            )
            used = keys.intersection(self.uses(first))
            raise ValueError(f"{first.key!r} needs {min(used)!r}: remove it as well")
        return Signature(tuple(founded))

    @cached_property
    def _makers(self) -> dict[str, tuple[str, ...]]:
        """Keys of the declarations that make a token."""
        makers: dict[str, list[str]] = {}
        for declaration in self.declarations:
            for token in tokens_made(declaration):
                makers.setdefault(token, []).append(declaration.key)
        return {token: tuple(keys) for token, keys in makers.items()}
