"""Whose features a stream holds, and whether that is what was wanted (sorts and objects)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import TypeAlias

from ..languages.ssl.annotation import Role
from ..ontology.vocabulary import THING, Vocabulary
from ..rdf.namespaces import OWL, STREAM_SPACE, shorten
from .want import Want

Roles: TypeAlias = tuple[Role, ...]
"""Whose a content is: one role, but for n-ary features."""

_TOPS = frozenset({THING, OWL + "Thing", STREAM_SPACE + "Sort"})


class Fit(IntEnum):
    """How well a stream's objects are the wanted ones."""

    NOT = 0
    PARTLY = 1
    """It holds some of the wanted objects, or may hold the wanted object."""
    WHOLLY = 2
    """It holds every wanted object."""


@dataclass(frozen=True, slots=True)
class Sorts:
    """Questions about sorts and objects on behalf of one want."""

    want: Want
    vocabulary: Vocabulary

    def within(self, sub: str, sup: str) -> bool:
        """``sub ⊑ sup``; everything is within the sort of all things."""
        return sub == sup or sup in _TOPS or self.vocabulary.is_subsort(sub, sup)

    def is_a(self, object: str, sort: str) -> bool:
        """The ontology knows that ``object`` is of ``sort``, or the asker said so."""
        if sort in _TOPS or sort in self.vocabulary.sorts_of(object):
            return True
        said = object == self.want.object and self.want.sort is not None
        return said and self.within(self.want.wanted_sort, sort)

    def fit(self, roles: Roles) -> tuple[Fit, str]:
        """How well features of ``roles`` fit the want, and where they do not, why."""
        # The first argument of an n-ary feature is the subject of its triples.
        role = roles[0]
        if self.want.object is not None:
            return self._fit_object(role, self.want.object)
        wanted = self.want.wanted_sort
        if role.object is not None:
            if self.is_a(role.object, wanted):
                return Fit.PARTLY, ""
            return Fit.NOT, f"{shorten(role.object)} is not known to be a {shorten(wanted)}"
        sort = role.sort or THING
        if self.within(wanted, sort):
            return Fit.WHOLLY, ""
        if self.within(sort, wanted):
            return Fit.PARTLY, ""
        return Fit.NOT, f"sort {shorten(sort)} is not a {shorten(wanted)}"

    def _fit_object(self, role: Role, wanted: str) -> tuple[Fit, str]:
        if role.object is not None:
            if role.object == wanted:
                return Fit.WHOLLY, ""
            return Fit.NOT, f"it speaks of {shorten(role.object)}, not of {shorten(wanted)}"
        sort = role.sort or THING
        if self.is_a(wanted, sort):
            return Fit.WHOLLY, ""
        if self.within(sort, self.want.wanted_sort):
            return Fit.PARTLY, ""
        return Fit.NOT, f"{shorten(wanted)} is not known to be a {shorten(sort)}"

    def allows(self, sort: str, roles: Roles) -> bool:
        """A transformation for objects of ``sort`` may be fed with features of ``roles``.

        There must be no other objects among them: a unit does not look at sorts.
        """
        if sort in _TOPS:
            return True
        if self.want.object is not None and self.is_a(self.want.object, sort):
            roles = roles[1:]
        return all(
            self.is_a(role.object, sort)
            if role.object is not None
            else self.within(role.sort or THING, sort)
            for role in roles
        )

    def covers(self, wider: Roles, narrower: Roles) -> bool:
        """Every object of ``narrower`` is one of ``wider``."""
        if wider[1:] != narrower[1:]:
            return False
        wide, narrow = wider[0], narrower[0]
        if wide.object is not None:
            return wide.object == narrow.object
        sort = wide.sort or THING
        if narrow.object is not None:
            return self.is_a(narrow.object, sort)
        return self.within(narrow.sort or THING, sort)
