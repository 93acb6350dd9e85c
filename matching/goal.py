"""Goals and their answers: the nodes of the transformation tree ([Introspection15 §4.3]).

A `Goal` is features of the same objects that a unit or a query needs together. Its answers are the
*alternatives* of the paper: a stream that holds them all (an `Offer`), a transformation whose
output is the feature (a `Through`), or, of several features, parts that are synchronized (an
`Apart`). The goals that an answer needs in turn are its *conjunction*.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

from ..languages.ssl.annotation import Content
from .space import Ask, StreamDescription, TransformationDescription, unit_text
from .subject import Roles, Sorts, Subject, Subjects, unified
from .want import Want


class Goal(NamedTuple):
    """Features of the same objects, in samples that belong together.

    ``joined``: its consumer synchronizes it with others, so parts of it need no synchronization of
    their own. ``streams`` names the streams that may answer it; empty: all streams and
    transformations.
    """

    asks: tuple[Ask, ...]
    subjects: Subjects
    joined: bool = False
    streams: tuple[str, ...] = ()


class Offer(NamedTuple):
    """A stream that holds all asks; ``contents`` has one for each ask, all of the same roles."""

    stream: StreamDescription
    contents: tuple[Content, ...]

    @property
    def roles(self) -> Roles:
        return self.contents[0].roles


class Through(NamedTuple):
    """A transformation fed with ``needs``: input ``i`` with ask ``k`` of ``needs[j]``, where
    ``feeds[i]`` is ``(j, k)``."""

    unit: TransformationDescription
    needs: tuple[Goal, ...]
    feeds: tuple[tuple[int, int], ...]


class Apart(NamedTuple):
    """Several asks answered by different streams; ``needs[j]`` answers those at ``places[j]``."""

    needs: tuple[Goal, ...]
    places: tuple[tuple[int, ...], ...]


Answer: TypeAlias = Offer | Through | Apart


def goal_of(want: Want, sorts: Sorts) -> Goal:
    """The goal of a want: the feature in its own unit, of all that is wanted. What a sort stands
    for are the samples of its objects."""
    info = sorts.vocabulary.feature(want.feature)
    unit = None if info is None or info.unit is None else unit_text(info.unit)
    sort = want.feature if sorts.is_sort(want.feature) else want.sort
    own = Subject(sort, sorts.canonical(want.object)) if want.object else None
    first = own or Subject(want.wanted_sort, None)
    others = (
        other._replace(object=sorts.canonical(other.object)) if other.object else other
        for other in want.others
    )
    return Goal((Ask(want.feature, unit),), unified((first, *others)), streams=want.streams)
