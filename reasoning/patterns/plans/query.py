"""A pattern as a continuous query: what its rows are, and what becomes of its matches (SPEC §8).

The three languages compile to a `PatternQuery`. An evaluator needs streams for its sources, which
matching finds, and turns their samples into `rows.Rows`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ....languages.mtl.checked import Kind
from ....sparql.ast import Triple
from .plan import NO_VALUE, ColumnType, Constant, Key, Listed, PatternPlan

START, END = "start", "end"
"""Outputs that every plan has: the times (ns) at which a match starts and ends."""


class Part(StrEnum):
    """The part of a sample that a column of the rows has."""

    OBJECT = "object"
    """The object of an argument of the feature."""
    VALUE = "value"
    """The value of the feature, in the unit of the ontology."""
    BEFORE = "value before"
    """The value of the sample before, of the same objects; none for the first one."""
    FIELD = "field"
    """A field of the stream, by its name."""


@dataclass(frozen=True, slots=True)
class SourceColumn:
    """A ``column`` of the plan, and what fills it. ``kind``: of its values (None: that of the
    stream's field); ``argument``: which object (from 0), for `Part.OBJECT`; ``field``: its name,
    for `Part.FIELD`. ``as_key``: the column has keys, equal for equal values (`value_keys`), though
    values of the kind are none."""

    column: str
    part: Part
    kind: Kind | None = None
    argument: int = 0
    field: str = ""
    as_key: bool = False


@dataclass(frozen=True, slots=True)
class Argument:
    """Whose samples a source has: those of one ``object`` (an IRI), or of all objects of a ``sort``
    (an IRI). With both, the object is taken to belong to the sort."""

    sort: str | None = None
    object: str | None = None


@dataclass(frozen=True, slots=True)
class Source:
    """The samples that are rows of one ``kind``.

    ``concept``: the IRI of a feature, of an event or of a sort; of a sort they are the samples of
    all streams that tell something of its objects, except those that units make (``is_sort``).
    ``arguments``: the objects of the feature, at least the first one. A sample without a value is
    no row; of a sort, one without the object. A sample is one row of each source that it suits, so
    a query has one source for each concept: which objects an element means, where that differs, is
    a condition on their column. ``stream``: the name of the only stream that is read; empty: those
    that matching finds.
    """

    kind: str
    concept: str
    arguments: tuple[Argument, ...]
    columns: tuple[SourceColumn, ...]
    is_sort: bool = False
    stream: str = ""

    @property
    def has_changes(self) -> bool:
        """Whether the value before is read."""
        return any(each.part is Part.BEFORE for each in self.columns)


Kinds: TypeAlias = Mapping[tuple[str, str], Kind]
"""The kind of the values in a field, by the kind of the rows and the name of the field: known once
matching has found the streams."""


@dataclass(frozen=True, slots=True)
class Result:
    """A field of the results: the output of the plans with that ``name``, of ``kind``. Where it is
    an object of a `Source`, ``argument`` tells of which. ``predicate``: that of the triple (an IRI)
    whose object it is, and whose subject is the first result."""

    name: str
    kind: Kind
    argument: Argument | None = None
    predicate: str | None = None


@dataclass(frozen=True, slots=True)
class OutputArithmetic:
    """``left + right`` of outputs: the operator is one of ``+ - * /``. It has no value where a side
    has none, nor has a division by 0."""

    left: OutputTerm
    operator: str
    right: OutputTerm


OutputTerm: TypeAlias = str | OutputArithmetic
"""An output by its name, or a calculation."""


@dataclass(frozen=True, slots=True)
class OutputComparison:
    """``left < right`` of outputs of a plan; it does not hold where one has no value."""

    left: OutputTerm
    operator: str
    right: OutputTerm


@dataclass(frozen=True, slots=True)
class AllOf:
    tests: tuple[Test, ...]


@dataclass(frozen=True, slots=True)
class AnyOf:
    tests: tuple[Test, ...]


Test: TypeAlias = OutputComparison | AllOf | AnyOf


@dataclass(frozen=True, slots=True)
class Absence:
    """A match is a result only if no match of the earlier plan ``other`` has the same rows, in
    ``rows`` of (own element, element of the other). ``until``: the output that is the last time
    (ns) at which such a match may still be completed by a new row; None: no later than the match
    itself."""

    other: int
    rows: tuple[tuple[int, int], ...]
    until: str | None = None


@dataclass(frozen=True, slots=True)
class StaticJoin:
    """Triples of static graphs, each with its graph (None: those of FROM, or the ontology), that
    are joined to the matches of a plan: each match is a result once for each solution of them that
    passes all ``tests``. ``variables``: those that outputs of the plan fill, as (variable, output,
    kind). ``results``: those whose values the results have, as (variable, output); they are texts,
    and the plan has `NO_VALUE` there. ``values``: those that tests and calculations read, as
    (variable, output, kind). ``calculated``: results as (output, calculation)."""

    triples: tuple[tuple[Triple, str | None], ...]
    variables: tuple[tuple[str, str, Kind], ...]
    results: tuple[tuple[str, str], ...] = ()
    values: tuple[tuple[str, str, Kind], ...] = ()
    tests: tuple[Test, ...] = ()
    calculated: tuple[tuple[str, OutputTerm], ...] = ()


@dataclass(frozen=True, slots=True)
class Branch:
    """What becomes of the matches of one plan: those that pass all ``tests`` and ``absences`` are
    results if ``is_given``; otherwise only other branches read them."""

    tests: tuple[Test, ...] = ()
    absences: tuple[Absence, ...] = ()
    static: StaticJoin | None = None
    is_given: bool = True


@dataclass(frozen=True, slots=True)
class PatternQuery:
    """A compiled pattern. ``name`` is empty if the text gives none.

    Its results have the fields ``start``, ``end`` and ``results``. ``valid``: the output that is
    the valid time (ns) of a result. A column of numbers has values of `Kind.NUMBER`, one of
    integers truths (0 or 1) or times (ns), one of keys texts or IRIs, by `Keys`; a `Key`
    of the plans has such a text.

    ``branches``: one for each plan; without any the matches of all plans are results. ``graphs``:
    the static graphs of FROM and of FROM NAMED. ``max_delay`` (ns): how long after its valid time a
    sample is available at the latest; None: streams are in order, but for their lateness.
    """

    name: str
    sources: tuple[Source, ...]
    plans: tuple[PatternPlan, ...]
    results: tuple[Result, ...]
    valid: str = END
    branches: tuple[Branch, ...] = ()
    graphs: tuple[tuple[str, ...], tuple[str, ...]] = ((), ())
    max_delay: int | None = None


def lists_of(query: PatternQuery) -> frozenset[str]:
    """Return the names of the results that are lists (`plan.Listed`)."""
    outputs = (output for plan in query.plans for output in plan.outputs)
    return frozenset(output.name for output in outputs if isinstance(output.value, Listed))


def integers_of(query: PatternQuery) -> frozenset[str]:
    """Return the names of the results that are 64-bit integers in all plans, as counts are."""
    return frozenset.intersection(
        *(
            frozenset(
                output.name
                for output in plan.outputs
                if not isinstance(output.value, Listed) and plan.is_integer(output.value)
            )
            for plan in query.plans
        )
    )


def object_column(argument: int) -> str:
    """Return the column of an argument of a feature, counted from 0."""
    return f"object {argument + 1}"


def column_type(kind: Kind) -> ColumnType:
    """The type of a column with values of a kind."""
    match kind:
        case Kind.NUMBER:
            return ColumnType.NUMBER
        case Kind.TRUTH | Kind.TIME | Kind.DURATION:
            return ColumnType.INTEGER
        case Kind.TEXT | Kind.OBJECT:
            return ColumnType.KEY


class Keys:
    """Numbers for objects and texts. ``key`` of an object is its IRI in angle brackets, of a text
    the text after a double quote. Memory: an entry for each."""

    def __init__(self) -> None:
        self._numbers: dict[str, int] = {}
        self._keys: list[str] = []

    def number(self, key: str) -> int:
        """Return the number of a key; a new one gets the next."""
        number = self._numbers.setdefault(key, len(self._keys))
        if number == len(self._keys):
            self._keys.append(key)
        return number

    def find(self, key: str) -> int | None:
        """Return the number of a key; None if it has none."""
        return self._numbers.get(key)

    def key(self, number: int) -> str:
        """Return the key with this number."""
        return self._keys[number]


def object_key(iri: str) -> str:
    """Return the key of an object."""
    return f"<{iri}>"


def text_key(text: str) -> str:
    """Return the key of a text."""
    return f'"{text}'


def value_keys(values: NDArray[np.float64] | NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a key for each number, truth or time, equal for equal values; `NO_VALUE` for a missing
    one. Values of two kinds may share a key. No memory is needed, other than for `Keys`."""
    if values.dtype != np.float64:
        return values.astype(np.int64)
    # The bits of the number; adding 0 makes 0 of -0, which has those of `NO_VALUE`.
    numbers = values + 0.0
    return np.where(np.isnan(numbers), NO_VALUE, numbers.view(np.int64))


def with_numbers(plan: PatternPlan, keys: Keys) -> PatternPlan:
    """Return the plan with the numbers of `Key`s: evaluators need that."""
    changed: PatternPlan = _with_numbers(plan, keys)
    return changed


def _with_numbers(node: Any, keys: Keys) -> Any:
    if isinstance(node, Key):
        return Constant(keys.number(node.text))
    if isinstance(node, tuple):
        return tuple(_with_numbers(each, keys) for each in node)
    if not dataclasses.is_dataclass(node):
        return node
    fields = {each.name: getattr(node, each.name) for each in dataclasses.fields(node)}
    changed = {
        name: new
        for name, old in fields.items()
        if (new := _with_numbers(old, keys)) is not old and new != old
    }
    return replace(node, **changed) if changed else node  # type: ignore[type-var]
