"""Late samples as streams of their own (docs/explanation/semantics.md, "Late samples").

``NAME_late`` has the samples that came too late for stream NAME, ``NAME_late_INPUT`` those of
stream INPUT that came too late for the unit that makes NAME: it had decided without them. Such a
stream comes into being when somebody asks for it by name, and takes what is late from then on;
where nobody asks, late samples are counted and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from ...streams.generator import StreamGenerator
from .base import ComputationalUnit

LATE: Final = "_late"
"""What names of these streams have behind the name of the stream that they belong to."""


@dataclass(frozen=True, slots=True, eq=False)
class _Origin:
    """Whose samples they are, and for which unit they were late; None: for their own stream."""

    source: StreamGenerator
    unit: ComputationalUnit | None

    @property
    def owner(self) -> str:
        """The name of the stream that they belong to."""
        return self.source.name if self.unit is None else self.unit.output.name


class LateStreams:
    """The streams of late samples that there are, by name.

    ``find`` gives a stream by its name or an alias, ``units`` those that make streams by these;
    ``add`` makes a stream of a name with the fields of another.
    """

    def __init__(
        self,
        find: Callable[[str], StreamGenerator | None],
        units: Mapping[str, ComputationalUnit],
        add: Callable[[str, StreamGenerator], StreamGenerator],
    ) -> None:
        self._find = find
        self._units = units
        self._add = add
        self._origins: dict[str, _Origin] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._origins

    def is_name(self, name: str) -> bool:
        """Whether `open` would make a stream of this name."""
        return next(self._read(name), None) is not None

    def open(self, name: str) -> StreamGenerator | None:
        """The stream called ``name``, which takes late samples from now on; None if that is no
        name of one. Contract: there is no stream of this name yet."""
        origin = next(self._read(name), None)
        if origin is None:
            return None
        side = self._add(name, origin.source)
        self._origins[name] = origin
        if origin.unit is None:
            origin.source.pass_late_to(side)
        else:
            origin.unit.pass_late_to(origin.source, side)
        return side

    def _read(self, name: str) -> Iterator[_Origin]:
        """What a name may mean."""
        if name.endswith(LATE):
            source = self._find(name.removesuffix(LATE))
            if source is not None and source.name not in self._origins:
                yield _Origin(source, None)
        parts = name.split(f"{LATE}_")
        for i in range(1, len(parts)):
            output = self._find(f"{LATE}_".join(parts[:i]))
            source = self._find(f"{LATE}_".join(parts[i:]))
            unit = None if output is None else self._units.get(output.name)
            if unit is not None and source is not None and source in unit.late_inputs:
                yield _Origin(source, unit)

    def belonging_to(self, name: str) -> tuple[str, ...]:
        """The streams of late samples that stream ``name`` has, itself or by the unit that makes
        it: they go with it. Cost: O(streams of late samples)."""
        return tuple(late for late, origin in self._origins.items() if origin.owner == name)

    def forget(self, name: str) -> None:
        """Stream ``name`` is removed: if it took late samples, they are only counted again."""
        origin = self._origins.pop(name, None)
        if origin is None:
            return
        if origin.unit is None:
            origin.source.late_stream = None
        else:
            origin.unit.forget_late(origin.source)

    def source_of(self, name: str) -> str | None:
        """The stream whose late samples stream ``name`` has; None if it has no such."""
        origin = self._origins.get(name)
        return None if origin is None else origin.source.name

    def maker_of(self, name: str) -> ComputationalUnit | None:
        """The unit for which the samples of stream ``name`` were late, or that made them; None if
        they are of a stream that no unit makes, or it has no late samples."""
        origin = self._origins.get(name)
        return None if origin is None else origin.unit or self._units.get(origin.owner)
