"""Checked SASE+ patterns: types are concepts of the ontology, parts and results fit (SPEC §8).

Everything is a frozen value. What the attributes of a type are, is known once streams are found;
`reasoning.patterns.compilation.sase_plans` makes plans then.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from ...ontology.units import Unit
from ..mtl.checked import Kind, ObjectSlot
from . import ast

VALUE: Final = "value"
"""The attribute that is the value of a feature or event."""
TIME: Final = "valid"
"""The attribute that is the valid time."""
_ID: Final = re.compile(r"id([1-9][0-9]?)?")


@dataclass(frozen=True, slots=True)
class EventType:
    """A type of events: a feature, event or sort (IRI). ``kind`` and ``unit`` of its values; None:
    the ontology does not say. ``arity``: how many objects it tells of, if that is known."""

    concept: str
    is_sort: bool
    kind: Kind | None = None
    unit: Unit | None = None
    arity: int | None = None

    def argument(self, attribute: str) -> int | None:
        """Return which object (from 0) an attribute is, None if it is another value: ``id`` or
        ``id1`` is the first, ``id2`` the second."""
        found = _ID.fullmatch(attribute)
        if found is None or (attribute != "id" and self.is_sort):
            return None
        number = int(found[1] or 1)
        return None if self.arity is not None and number > self.arity else number - 1


@dataclass(frozen=True, slots=True)
class ObjectParameter:
    """A parameter of a template that stands for objects of a sort (IRI), or for one ``object``
    (IRI) that is taken to belong to it. ``defined_by``: the object of an event, or of all events
    of a repeated part, that equals it."""

    name: str
    sort: str
    defined_by: ast.Attribute
    object: str | None = None


@dataclass(frozen=True, slots=True)
class CheckedPattern:
    """A pattern. ``text`` has values in place of parameters, and IRIs as names of objects;
    ``types``: those of each part; ``source``: all of the text; ``stream``: the name of the stream
    of FROM, or empty."""

    text: ast.Pattern
    source: str
    types: tuple[tuple[EventType, ...], ...]
    objects: tuple[ObjectParameter, ...] = ()
    stream: str = ""

    @property
    def is_over_matches(self) -> bool:
        """Whether the results are aggregates over all matches that end with an event."""
        return any(map(is_over_matches, (leaf for _, leaf in self.returned())))

    def returned(self) -> Iterator[tuple[ast.Item, ast.Term]]:
        """The parts of the results that are no calculations."""
        for item in self.text.items:
            for leaf in leaves_of(item.term):
                yield item, leaf


@dataclass(frozen=True, slots=True)
class ValueSlot:
    """A parameter of a template that stands for a value; ``kind`` None: any, as the stream
    decides."""

    name: str
    kind: Kind | None


@dataclass(frozen=True, slots=True)
class CheckedTemplate:
    """A pattern with parameters, in the order of requests: objects, which may be free, and values,
    which a request gives. ``pattern`` is about all objects, and has the values as variables."""

    slots: tuple[ObjectSlot | ValueSlot, ...]
    pattern: CheckedPattern


def leaves_of(term: ast.Term) -> Iterator[ast.Term]:
    """The parts of a term that are no calculations, from left to right."""
    match term:
        case ast.Arithmetic(_, left, right):
            yield from leaves_of(left)
            yield from leaves_of(right)
        case ast.Negative(operand):
            yield from leaves_of(operand)
        case _:
            yield term


def terms_of(condition: ast.Condition) -> tuple[ast.Term, ...]:
    """The two sides of a comparison, or the value of an equivalence."""
    match condition:
        case ast.Comparison(_, left, right):
            return left, right
        case ast.Equivalence(_, value):
            return () if value is None else (value,)


def condition_leaves(condition: ast.Condition) -> list[ast.Term]:
    """The parts of a condition that are no calculations."""
    return [leaf for term in terms_of(condition) for leaf in leaves_of(term)]


def is_over_matches(leaf: ast.Term) -> bool:
    """Whether this is an aggregate over all matches: ``COUNT(*)``, ``SUM(a.x)``."""
    if isinstance(leaf, ast.Aggregate):
        return leaf.index is ast.Index.ONE
    return isinstance(leaf, ast.CountMatches)
