"""What a client of an event stream asks for: where it begins, what a message holds, how often."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Projection:
    """The members of a sample's message: the values of ``fields`` (None: of all), and its RDF."""

    fields: tuple[str, ...] | None = None
    has_rdf: bool = True

    def names(self, there: Collection[str]) -> list[str]:
        """The fields among those that are ``there`` whose values a message holds, in order."""
        if self.fields is None:
            return list(there)
        return [name for name in self.fields if name in there]


WHOLE = Projection()
"""All members."""


@dataclass(frozen=True, slots=True)
class Delivery:
    """How a client gets a stream. ``since`` says where it begins, as in `Feeds.start`; ``last``
    begins with so many of the newest samples instead. ``every`` (ns) is the least time between two
    messages of one object (`conflation`); None: all samples."""

    since: str | None = None
    last: int | None = None
    projection: Projection = WHOLE
    every: int | None = None
