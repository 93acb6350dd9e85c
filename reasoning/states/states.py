"""States: the values of features of objects at valid times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from numpy.typing import NDArray

from ...streams.sample import Mask, Times

Term: TypeAlias = tuple[str, tuple[str, ...]]
"""A feature, and for each argument the IRI of its sort, or of the object in angle brackets."""


@dataclass(frozen=True, slots=True, eq=False)
class Values:
    """The values of a term at n states: shape ``(n, objects of each sort in order)``. ``known`` is
    false where there is none; the value there means nothing."""

    values: NDArray[Any]
    known: Mask

    def take(self, rows: Any) -> Values:
        return Values(self.values[rows], self.known[rows])


@dataclass(frozen=True, slots=True, eq=False)
class States:
    """Some states, in order of time.

    ``valid``: their valid times (ns), which increase strictly. ``horizon``: after the state comes,
    every later state is known to be valid after it; not less than ``valid``. ``objects``: the IRIs
    of each sort's objects; ``present``: whether each is there, shape ``(n, objects)``. Objects keep
    their places from batch to batch; new ones are added at the end.
    """

    valid: Times
    horizon: Times
    objects: Mapping[str, Sequence[str]]
    present: Mapping[str, Mask]
    values: Mapping[Term, Values]

    def take(self, rows: Any) -> States:
        return States(
            self.valid[rows],
            self.horizon[rows],
            self.objects,
            {sort: part[rows] for sort, part in self.present.items()},
            {term: part.take(rows) for term, part in self.values.items()},
        )
