"""Late samples as streams of their own (docs/explanation/semantics.md, "Late samples").

``NAME_late`` has the samples that were late for stream NAME. ``NAME_late_INPUT`` has the samples of
stream INPUT that were late for the unit that makes NAME. The first request by name makes such a
stream, which has the late samples from then on. Without a request they are only counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from ...streams.generator import StreamGenerator
from .base import ComputationalUnit

LATE: Final = "_late"
"""The suffix of these names."""


@dataclass(frozen=True, slots=True, eq=False)
class _Origin:
    """The source of late samples, and the unit for which they were late; None: for the source."""

    source: StreamGenerator
    unit: ComputationalUnit | None

    @property
    def owner(self) -> str:
        """The name of the stream that the late samples belong to."""
        return self.source.name if self.unit is None else self.unit.output.name


class LateStreams:
    """The existing streams of late samples, by name.

    ``find`` returns a stream by its name or an alias. ``units`` are the units by the name of their
    output. ``add`` makes a stream of the given name with the fields of another.
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
        """Make the stream of late samples with this name; return None if the name has another form.
        Contract: there is no stream of this name yet."""
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
        """Return the possible meanings of a name; names may contain ``_late`` themselves."""
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
        """Return the streams of samples that were late for stream ``name`` or the unit that makes
        it; they are removed with it. Cost: O(streams of late samples)."""
        return tuple(late for late, origin in self._origins.items() if origin.owner == name)

    def forget(self, name: str) -> None:
        """Forget stream ``name``, which is removed; its late samples are only counted again."""
        origin = self._origins.pop(name, None)
        if origin is None:
            return
        if origin.unit is None:
            origin.source.late_stream = None
        else:
            origin.unit.drop_late(origin.source)

    def source_of(self, name: str) -> str | None:
        """Return the stream whose late samples stream ``name`` has; None for another stream."""
        origin = self._origins.get(name)
        return None if origin is None else origin.source.name

    def maker_of(self, name: str) -> ComputationalUnit | None:
        """Return the unit for which the samples of stream ``name`` were late, or the unit that
        makes their source. None if there is neither, or for a stream without late samples."""
        origin = self._origins.get(name)
        return None if origin is None else origin.unit or self._units.get(origin.owner)
