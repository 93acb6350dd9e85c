"""What checked KPL declarations mean, and all that is declared so far ([DyKnow10 Def. 5.13-5.20]).

Everything is frozen: a signature with more in it is another signature, so a text that is refused
has changed nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeAlias, TypeVar, assert_never

from ...streams.policy import Policy, SynchronizationPolicy
from ...streams.sample import Field, FieldType, Schema

PROCESSES: Final = ("join", "sync")
"""Process names that need no declaration: Def. 5.11's join, and synchronization (SPEC §1)."""


@dataclass(frozen=True, slots=True)
class ValueSort:
    """A set of values (Def. 5.13): ``float``, the range of a feature, a declared sort.

    A simple sort has one field, `VALUE`. ``fields`` None is an *open* sort, known by name only
    (the paper's ``pos``): the first sample decides its fields. ``feature`` is the IRI of the
    feature of the ontology that the sort is named after, else None.
    """

    name: str
    fields: tuple[Field, ...] | None
    feature: str | None = None

    @property
    def is_open(self) -> bool:
        return self.fields is None

    @property
    def simple_type(self) -> FieldType | None:
        """The type of a simple sort; None if the sort is structured or open."""
        if self.fields is None or [field.name for field in self.fields] != [VALUE]:
            return None
        return self.fields[0].type

    @property
    def schema(self) -> Schema | None:
        """The fields of its samples; None for an open sort."""
        return None if self.fields is None else Schema(self.fields)


VALUE: Final = "value"
"""What the only field of a simple sort is called."""


@dataclass(frozen=True, slots=True)
class Label:
    """Def. 5.17: a feature and the objects that it is of. ``str`` is its one spelling:
    ``pos[car1]``, ``pos`` without objects."""

    feature: str
    objects: tuple[str, ...] = ()

    def __str__(self) -> str:
        return f"{self.feature}[{', '.join(self.objects)}]" if self.objects else self.feature

    @property
    def identifier(self) -> str:
        """The label as one word, for names of fields: ``pos_car1``."""
        return "_".join((self.feature.replace(":", "_").replace("-", "_"), *self.objects))


@dataclass(frozen=True, slots=True)
class Term:
    """Def. 5.19: the stream that a generator makes for a subscription with this policy."""

    label: Label
    policy: Policy

    def __str__(self) -> str:
        return str(self.label)


@dataclass(frozen=True, slots=True)
class SourceDeclaration:
    """Def. 5.15: a process without inputs that gives samples of ``sort``."""

    name: str
    sort: ValueSort

    @property
    def key(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class CompunitDeclaration:
    """Def. 5.16: a function from samples of ``inputs`` to samples of ``sort``."""

    name: str
    sort: ValueSort
    inputs: tuple[ValueSort, ...]

    @property
    def key(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class FromSource:
    """``strmgen l = s``: what the source gives (Def. 5.33)."""

    name: str


@dataclass(frozen=True, slots=True)
class Compute:
    """``strmgen l = c(w1, …, wn)``: a computational unit over the join of streams (Def. 5.34)."""

    unit: str
    terms: tuple[Term, ...]


@dataclass(frozen=True, slots=True)
class JoinOf:
    """``strmgen l = join(w1, …, wn)``: the tuples of Def. 5.11 as they are. Ours."""

    terms: tuple[Term, ...]


@dataclass(frozen=True, slots=True)
class Synchronize:
    """``strmgen l = sync(w1, …, wn; policy)``: states (SPEC §1). Ours."""

    terms: tuple[Term, ...]
    policy: SynchronizationPolicy


Process: TypeAlias = FromSource | Compute | JoinOf | Synchronize


@dataclass(frozen=True, slots=True)
class GeneratorDeclaration:
    """Def. 5.18: a generator of streams, and the process instance that it belongs to.

    The sort of a join or synchronization is called like the label's feature, and has the inputs'
    fields under the names of `streams.tuples.flat_names` (open if an input's sort is).
    """

    label: Label
    sort: ValueSort
    process: Process

    @property
    def key(self) -> str:
        return str(self.label)

    @property
    def terms(self) -> tuple[Term, ...]:
        """The streams that the process subscribes to; none for a source."""
        return () if isinstance(self.process, FromSource) else self.process.terms


@dataclass(frozen=True, slots=True)
class StreamDeclaration:
    """Def. 5.20: a named stream that the application gives to the outside."""

    name: str
    sort: ValueSort
    term: Term

    @property
    def key(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class SortDeclaration:
    """Ours: what the values of a sort are. Its fields are never open."""

    sort: ValueSort

    @property
    def name(self) -> str:
        return self.sort.name

    @property
    def key(self) -> str:
        # Sorts and features may share a name, so a sort's key is told apart.
        return f"sort {self.sort.name}"


CheckedDeclaration: TypeAlias = (
    SourceDeclaration
    | CompunitDeclaration
    | GeneratorDeclaration
    | StreamDeclaration
    | SortDeclaration
)
_D = TypeVar("_D", bound=CheckedDeclaration)


@dataclass(frozen=True)
class Signature:
    """All declarations so far, in an order in which each stands behind what it uses.

    A declaration's *key* is its name, a generator's label as text, or ``sort NAME``.
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

        Empty for an unknown name. Cost: linear in the declarations.
        """
        found = self.find(name_or_label)
        if found is None:
            return ()
        needed = {found.key}
        dependents = []
        # Uses stand before users, so one pass finds them all.
        for declaration in self.declarations:
            if declaration.key not in needed and not needed.isdisjoint(self.uses(declaration)):
                needed.add(declaration.key)
                dependents.append(declaration.key)
        return tuple(reversed(dependents))

    def uses(self, declaration: CheckedDeclaration) -> tuple[str, ...]:
        """Keys of what the declaration names directly."""
        return tuple(key for key in _uses(declaration) if key in self.by_key)

    def without(self, names: Iterable[str]) -> Signature:
        """The same without these. Raises `ValueError` for a name that is not declared, and for
        one that something left behind needs; `dependents` tells them."""
        keys = set()
        for name in names:
            found = self.find(name)
            if found is None:
                raise ValueError(f"{name!r} is not declared")
            keys.add(found.key)
        for declaration in self.declarations:
            used = keys.intersection(self.uses(declaration))
            if declaration.key not in keys and used:
                raise ValueError(f"{declaration.key!r} needs {min(used)!r}: remove it as well")
        return Signature(tuple(d for d in self.declarations if d.key not in keys))


def _uses(declaration: CheckedDeclaration) -> Iterator[str]:
    match declaration:
        case SourceDeclaration():
            yield f"sort {declaration.sort.name}"
        case CompunitDeclaration():
            for sort in (declaration.sort, *declaration.inputs):
                yield f"sort {sort.name}"
        case GeneratorDeclaration():
            match declaration.process:
                case FromSource(name) | Compute(name):
                    yield name
                case JoinOf() | Synchronize():
                    pass
                case _:
                    assert_never(declaration.process)
            for term in declaration.terms:
                yield str(term.label)
        case StreamDeclaration():
            yield str(declaration.term.label)
        case SortDeclaration():
            # The fields were copied, so nothing else is needed any more.
            pass
        case _:
            assert_never(declaration)
