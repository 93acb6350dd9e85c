"""Subjects of features: objects, sorts of objects, and how they contain each other.

[Introspection15 §4.3] matches over subsumption: `RMAX ⊑ UAV ⊑ Thing`. A want asks for a `Subject`;
a stream holds a `Role` (of its annotation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from ..languages.ssl.annotation import Role
from ..ontology.vocabulary import SELF, THING, Vocabulary
from ..rdf.namespaces import OWL, STREAM_SPACE, shorten

TOPS = frozenset({THING, OWL + "Thing", STREAM_SPACE + "Sort"})
"""The sorts of all things."""

Roles: TypeAlias = tuple[Role, ...]
"""The roles of a content: one, or several for an n-ary feature."""


class Subject(NamedTuple):
    """Every object of ``sort``; ``object``; or ``object``, taken to be of ``sort``. IRIs.

    ``bounds`` are sorts to which all objects in a stream for every object of ``sort`` must belong:
    a transformation for a sort does not check sorts, so its inputs may have no others.
    """

    sort: str | None
    object: str | None
    bounds: tuple[str, ...] = ()

    def __str__(self) -> str:
        return (
            f"every {shorten(self.sort or THING)}" if self.object is None else shorten(self.object)
        )


Subjects: TypeAlias = tuple[Subject, ...]
"""The subjects of a wanted feature: one, or several for an n-ary feature."""


@dataclass(frozen=True, slots=True, eq=False)
class Sorts:
    """Questions about subjects, answered by the ontology."""

    vocabulary: Vocabulary

    def within(self, sub: str, sup: str) -> bool:
        """``sub ⊑ sup``; everything is within the sorts of all things."""
        return sub == sup or sup in TOPS or self.vocabulary.is_subsort(sub, sup)

    def is_sort(self, feature: str) -> bool:
        """Whether a sort stands in place of a feature."""
        vocabulary = self.vocabulary
        is_feature = vocabulary.is_feature(feature) or vocabulary.is_event(feature)
        return vocabulary.is_sort(feature) and not is_feature

    def canonical(self, object: str) -> str:
        """The object's name: ``self`` may have one of its own."""
        return self.vocabulary.self_object if object == SELF else object

    def belongs(self, subject: Subject, sort: str) -> bool:
        """Whether each object of ``subject`` is known, or given, to be of ``sort``."""
        if sort in TOPS:
            return True
        if subject.object is not None and sort in self.vocabulary.sorts_of(subject.object):
            return True
        return subject.sort is not None and self.within(subject.sort, sort)

    def bounded(self, subject: Subject, sort: str) -> Subject:
        """``subject`` with ``sort`` as a bound. Contract: it belongs to ``sort``."""
        if subject.object is not None or sort in TOPS or subject.sort is None:
            return subject
        narrower = [bound for bound in subject.bounds if not self.within(sort, bound)]
        if any(self.within(bound, sort) for bound in narrower):
            return subject
        return subject._replace(bounds=tuple(sorted((*narrower, sort))))

    def holds(self, roles: Roles, subjects: Subjects) -> bool:
        """Whether a content of ``roles`` holds the feature of all objects of ``subjects``.

        Roles beyond the subjects may be any: the distance of `uav1` without a second argument is
        its distance to each object.
        """
        return len(roles) >= len(subjects) and all(
            self._holds(role, subject) for role, subject in zip(roles, subjects, strict=False)
        )

    def _holds(self, role: Role, subject: Subject) -> bool:
        if role.object is not None:
            return role.object == subject.object
        sort = role.sort or THING
        if subject.object is not None:
            return self.belongs(subject, sort)
        wanted = subject.sort or THING
        return self.within(wanted, sort) and (
            sort == wanted or all(self.within(sort, bound) for bound in subject.bounds)
        )

    def part(self, held: Subject, wanted: Subject) -> Subject | None:
        """The part of ``wanted`` that features of ``held`` may serve; None if there is none.

        Of every object of a sort, those of a narrower sort, or a single one. Of an object that is
        not known to be of the held sort, that object, assumed to be of it.
        """
        if held.object is not None:
            own = Subject(None, held.object)
            if wanted.object is not None:
                return own if held.object == wanted.object else None
            return own if self.belongs(own, wanted.sort or THING) else None
        sort = held.sort or THING
        if wanted.object is None:
            return Subject(sort, None) if self.within(sort, wanted.sort or THING) else None
        if self.belongs(wanted, sort) or not self.within(sort, wanted.sort or THING):
            return None
        # An object that is known to be a car may be a taxi, but hardly a bird.
        known = self.vocabulary.sorts_of(wanted.object) - TOPS
        if known and not any(self.within(sort, one) for one in known):
            return None
        return Subject(sort, wanted.object)

    def why_not_all(self, roles: Roles, subjects: Subjects) -> str:
        """Why a content of ``roles`` holds nothing of the feature of ``subjects``; empty if it
        holds it, or a part of it."""
        if len(roles) < len(subjects):
            return f"it speaks of {len(roles)} at once, and {len(subjects)} are wanted"
        reasons = (self.why_not(role, s) for role, s in zip(roles, subjects, strict=False))
        return next((reason for reason in reasons if reason), "")

    def why_not(self, role: Role, subject: Subject) -> str:
        """Why a content of ``role`` does not hold the feature of ``subject``; empty if it does."""
        held = Subject(role.sort, role.object)
        if self._holds(role, subject) or self.part(held, subject) is not None:
            return ""
        sort = role.sort or THING
        if subject.object is not None:
            if role.object is not None:
                return f"it speaks of {shorten(role.object)}, not of {shorten(subject.object)}"
            return f"{shorten(subject.object)} is not known to be a {shorten(sort)}"
        wanted = subject.sort or THING
        if role.object is not None:
            return f"{shorten(role.object)} is not known to be a {shorten(wanted)}"
        if self.within(wanted, sort):
            bound = next(b for b in subject.bounds if not self.within(sort, b))
            return f"it speaks of every {shorten(sort)}, also of those that are no {shorten(bound)}"
        return f"sort {shorten(sort)} is not a {shorten(wanted)}"

    def covers(self, wider: Subject, narrower: Subject) -> bool:
        """Whether every object of ``narrower`` is one of ``wider``."""
        if wider.object is None:
            return self.belongs(narrower, wider.sort or THING)
        if wider.object != narrower.object:
            return False
        return wider.sort is None or (
            narrower.sort is not None and self.within(narrower.sort, wider.sort)
        )


def whose(subjects: Sequence[Subject]) -> str:
    """``every dyknow:UAV``, ``dyknow:uav1``; several of an n-ary feature."""
    return " and ".join(map(str, subjects))


def named_objects(subjects: Sequence[Subject]) -> dict[str | None, Subject]:
    """The subject that names each object; of several the first that gives a sort."""
    named: dict[str | None, Subject] = {}
    for subject in subjects:
        object = subject.object
        if object is not None and (object not in named or named[object].sort is None):
            named[object] = subject
    return named


def unified(subjects: Subjects) -> Subjects:
    """The same subjects, where an object is the same subject in all its places."""
    named = named_objects(subjects)
    return tuple(named.get(subject.object, subject) for subject in subjects)
