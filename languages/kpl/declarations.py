"""Checked KPL declarations ([DyKnow10 Def. 4.6, 4.7, 5.13-5.20]).

`check` makes them, `printer` prints them, `signature` collects them, and the engine runs them. All
values are frozen. *Extension* marks additions to the paper.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final, TypeAlias, assert_never

from ...streams.policies.policy import Policy, SynchronizationPolicy
from ...streams.sample import Field, FieldType, Schema
from .ast import KEYWORDS

PROCESSES: Final = ("join", "sync", "aggregate", "select", "selectObject")
"""The predefined processes: the join of Def. 5.11, synchronization (SPEC §1), and the mediation
processes (Def. 4.7)."""

VALUE: Final = "value"
"""The name of the only field of a simple sort."""
OBJECT_FIELD: Final = "object"
"""The field of an aggregate's samples that names their object."""

_PLAIN_OBJECT: Final = re.compile(
    r"([A-Za-z0-9_]+|[A-Za-z_][A-Za-z0-9_-]*:[A-Za-z_][A-Za-z0-9_]*)\Z"
)


@dataclass(frozen=True, slots=True)
class ValueSort:
    """A set of values (Def. 5.13): ``float``, the range of a feature, a declared sort.

    A simple sort has one field, `VALUE`. ``fields`` is None for an *open* sort, which has only a
    name (the paper's ``pos``): the first sample determines its fields. ``feature`` is the IRI of
    the ontology's feature with this name, else None.
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
        """The schema of its samples; None for an open sort."""
        return None if self.fields is None else Schema(self.fields)

    @property
    def object_field(self) -> str | None:
        """The field that names a sample's object: ``object``, else ``id``, else the first text.
        None if there is none, or if the sort is open."""
        texts = [field.name for field in self.fields or () if field.type is FieldType.STRING]
        return object_field(texts)


def object_field(texts: Sequence[str]) -> str | None:
    """Return the text field that names a sample's object: ``object``, else ``id``, else the first.
    None if there is none."""
    return next((name for name in (OBJECT_FIELD, "id", *texts) if name in texts), None)


@dataclass(frozen=True, slots=True)
class Label:
    """Def. 5.17: a feature and its objects. ``str`` is the canonical form, which `parse_label`
    reads: ``pos[car1]``, ``pos`` without objects, ``pos["car 1"]``."""

    feature: str
    objects: tuple[str, ...] = ()

    def __str__(self) -> str:
        if not self.objects:
            return self.feature
        return f"{self.feature}[{', '.join(map(_object_text, self.objects))}]"

    @property
    def identifier(self) -> str:
        """The label as one word of letters, digits and ``_``, for names of fields: ``pos_car1``.
        Different labels may have the same identifier."""
        return re.sub(r"[^A-Za-z0-9_]", "_", "_".join((self.feature, *self.objects)))

    def bound(self, variable: str, object: str) -> Label:
        """Return the label with an object in place of the variable."""
        return Label(self.feature, tuple(object if o == variable else o for o in self.objects))


def _object_text(name: str) -> str:
    """Return an object's name, in quotes where it would parse as something else."""
    if _PLAIN_OBJECT.match(name) and name not in KEYWORDS:
        return name
    return json.dumps(name, ensure_ascii=False)


@dataclass(frozen=True, slots=True)
class Term:
    """Def. 5.19: the stream of a generator for a subscription with this policy."""

    label: Label
    policy: Policy

    def __str__(self) -> str:
        return str(self.label)

    def bound(self, variable: str, object: str) -> Term:
        """Return the term with an object in place of the variable."""
        return Term(self.label.bound(variable, object), self.policy)


# -- processes -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class FromSource:
    """``strmgen l = s``: the samples of the source (Def. 5.33)."""

    name: str


@dataclass(frozen=True, slots=True)
class Compute:
    """``strmgen l = c(w1, …, wn)``: a computational unit over the join of streams (Def. 5.34)."""

    unit: str
    terms: tuple[Term, ...]


@dataclass(frozen=True, slots=True)
class JoinOf:
    """``strmgen l = join(w1, …, wn)``: the tuples of Def. 5.11. An extension.

    ``names`` replaces the `identifier` of the labels in names of fields: the generators of a
    `ForeachDeclaration` have the same fields for all objects. ``inner_times`` (``; inner times``)
    adds the times of the inputs' samples as fields.
    """

    terms: tuple[Term, ...]
    names: tuple[str, ...] = ()
    inner_times: bool = False

    @property
    def identifiers(self) -> tuple[str, ...]:
        """The name of each input in names of fields."""
        return self.names or tuple(term.label.identifier for term in self.terms)


@dataclass(frozen=True, slots=True)
class Synchronize:
    """``strmgen l = sync(w1, …, wn; policy)``: states (SPEC §1). An extension. ``names`` as in
    `JoinOf`."""

    terms: tuple[Term, ...]
    policy: SynchronizationPolicy
    names: tuple[str, ...] = ()

    @property
    def identifiers(self) -> tuple[str, ...]:
        """The name of each input in names of fields."""
        return self.names or tuple(term.label.identifier for term in self.terms)


@dataclass(frozen=True, slots=True)
class Aggregate:
    """``strmgen l = aggregate(w foreach x in m)``, a mediation process (Def. 4.7). It merges all
    streams ``pattern``, where ``variable`` stands for the objects that ``members`` names now. A
    sample without the name of its object gets the field `OBJECT_FIELD`."""

    variable: str
    pattern: Term
    members: Term


@dataclass(frozen=True, slots=True)
class Select:
    """``strmgen l = select(w foreach x in m)``, a mediation process (Def. 4.7): the stream
    ``pattern`` of the object that ``members`` named last."""

    variable: str
    pattern: Term
    members: Term


@dataclass(frozen=True, slots=True)
class SelectObject:
    """``strmgen pos[car1] = selectObject(w)``: of a stream about many objects, the samples of the
    object in the generator's label. `ValueSort.object_field` names a sample's object. An extension
    ([Events14 §V.C])."""

    term: Term


Process: TypeAlias = FromSource | Compute | JoinOf | Synchronize | Aggregate | Select | SelectObject


# -- declarations --------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SourceDeclaration:
    """Def. 5.15: a process without inputs that produces samples of ``sort``."""

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
class GeneratorDeclaration:
    """Def. 5.18: a generator of streams, and its process instance.

    The sort of a join or synchronization has the name of the label's feature. Its fields are those
    of the inputs, named by `streams.tuples.flat_names`; it is open if the sort of an input is. The
    sort of a mediation is that of its inputs; an aggregate may add the field `OBJECT_FIELD`.
    """

    label: Label
    sort: ValueSort
    process: Process

    @property
    def key(self) -> str:
        return str(self.label)

    @property
    def terms(self) -> tuple[Term, ...]:
        """The streams that the process subscribes to; none for a source. For a mediation: the
        pattern, whose variable is not bound, and the members."""
        match self.process:
            case FromSource():
                return ()
            case Aggregate(_, pattern, members) | Select(_, pattern, members):
                return (pattern, members)
            case SelectObject(term):
                return (term,)
            case Compute(_, terms) | JoinOf(terms) | Synchronize(terms):
                return terms
            case _:
                assert_never(self.process)


@dataclass(frozen=True, slots=True)
class StreamDeclaration:
    """Def. 5.20: a named stream that the application offers to others."""

    name: str
    sort: ValueSort
    term: Term

    @property
    def key(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class SortDeclaration:
    """Extension: the values of a sort. Its fields are never open."""

    sort: ValueSort

    @property
    def name(self) -> str:
        return self.sort.name

    @property
    def key(self) -> str:
        # A sort and a feature may share a name, so the key of a sort has a prefix.
        return f"sort {self.sort.name}"


@dataclass(frozen=True, slots=True)
class ForeachDeclaration:
    """Extension, a configuration process (Def. 4.6): ``generators`` for each object that
    ``members`` names now, with the object in place of ``variable``. `instantiate` makes them."""

    variable: str
    members: Term
    generators: tuple[GeneratorDeclaration, ...]

    @property
    def key(self) -> str:
        """The key, from its objects and generators: ``foreach car in cars: pos[car],
        speed[car]``."""
        # Two with this key would make the same generators for the same objects.
        made = ", ".join(generator.key for generator in self.generators)
        head = f"foreach {self.variable} in {self.members.label}"
        return f"{head}: {made}" if made else head

    @property
    def terms(self) -> tuple[Term, ...]:
        """The streams that it and its generators subscribe to, each once, the members first,
        without its own."""
        own = {generator.label for generator in self.generators}
        read = [term for generator in self.generators for term in generator.terms]
        return tuple(dict.fromkeys((self.members, *(t for t in read if t.label not in own))))


@dataclass(frozen=True, slots=True)
class SinkDeclaration:
    """Extension: a process without output that receives the samples of ``terms`` (SPEC §1)."""

    name: str
    terms: tuple[Term, ...]

    @property
    def key(self) -> str:
        return self.name


CheckedDeclaration: TypeAlias = (
    SourceDeclaration
    | CompunitDeclaration
    | GeneratorDeclaration
    | StreamDeclaration
    | SortDeclaration
    | ForeachDeclaration
    | SinkDeclaration
)


# -- configuration -------------------------------------------------------------------------------


def instantiate(foreach: ForeachDeclaration, object: str) -> tuple[GeneratorDeclaration, ...]:
    """Return the generators of a configuration process for one object, each after those that it
    uses.

    Their sorts are those of the pattern: the samples of all objects have the same fields. Cost:
    linear in the terms.
    """
    return tuple(
        replace(
            generator,
            label=generator.label.bound(foreach.variable, object),
            process=_bound(generator.process, foreach.variable, object),
        )
        for generator in foreach.generators
    )


def _bound(process: Process, variable: str, object: str) -> Process:
    def each(terms: tuple[Term, ...]) -> tuple[Term, ...]:
        return tuple(term.bound(variable, object) for term in terms)

    match process:
        case FromSource():
            return process
        case Compute(unit, terms):
            return Compute(unit, each(terms))
        case JoinOf(terms):
            return JoinOf(each(terms), process.identifiers, process.inner_times)
        case Synchronize(terms, policy):
            return Synchronize(each(terms), policy, process.identifiers)
        case SelectObject(term):
            return SelectObject(term.bound(variable, object))
        case Aggregate(own, pattern, members) | Select(own, pattern, members):
            # `check` refuses a nested variable with the same name, but an object may have its name.
            free = own
            while free == object:
                free += "_"
            pattern = pattern.bound(own, free).bound(variable, object)
            members = members.bound(variable, object)
            return replace(process, variable=free, pattern=pattern, members=members)
        case _:
            assert_never(process)
