"""A wanted feature: the argument of semantic matching ([Introspection15 §4.3])."""

from __future__ import annotations

from dataclasses import dataclass

from ..ontology.vocabulary import THING
from ..rdf.namespaces import shorten
from .subject import Subjects

__all__ = ["THING", "Want"]


@dataclass(frozen=True, slots=True)
class Want:
    """A feature of one object, or of every object of a sort. All are IRIs.

    A sort in place of the feature stands for the samples of all streams that tell something of its
    objects, except those that units make.

    ``object`` None: of every object of ``sort`` (None: of all). With an object, ``sort`` is
    its sort as the request gives it (None: only as the ontology knows it). ``others`` are the
    further arguments of an n-ary feature; without them they may be anything. ``streams`` names
    the streams that may give it; empty: any.
    """

    feature: str
    sort: str | None = None
    object: str | None = None
    others: Subjects = ()
    streams: tuple[str, ...] = ()

    @property
    def wanted_sort(self) -> str:
        """The sort asked for; ``dyknow:Thing``, the sort of all objects, where none was named."""
        return THING if self.sort is None else self.sort

    def __str__(self) -> str:
        of = f" in {' or '.join(self.streams)}" if self.streams else ""
        return f"{shorten(self.feature)} of {self.whose}{of}"

    @property
    def whose(self) -> str:
        """``every dyknow:UAV``, ``dyknow:uav1``; several for an n-ary feature."""
        if self.object is not None:
            first = shorten(self.object)
        else:
            first = f"every {shorten(self.wanted_sort)}"
        return " and ".join((first, *map(str, self.others)))
