"""Versions of streams, so that a page that polls gets only the changed ones (routes/streams)."""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterable
from typing import Final

from ..models import StreamModel

START: Final = "start"
"""The position before all versions."""
_OF_TIME: Final = {"silent_for", "watermark"}
"""Members that time alone changes."""


class StreamVersions:
    """The versions of all streams as `note` has last seen them.

    Law: a stream has a greater version than a position if and only if `note` saw it changed after
    that position. Memory: two numbers for each stream. Cost: the JSON of the stream.
    """

    def __init__(self, epoch: str) -> None:
        self.lock = asyncio.Lock()
        """Held from the first `note` for an answer to its `position`: a change that is noted for
        another answer in between would be missed."""
        self._epoch = epoch
        self._last = 0
        self._known: dict[str, tuple[int, int]] = {}
        """By name: the hash of the stream's JSON, and its version."""

    @property
    def position(self) -> str:
        """The position after all versions."""
        return f"{self._epoch}-{self._last}"

    def after(self, position: str) -> int:
        """The version of a position; 0 for `START`, and for one of another run of the service."""
        epoch, _, digits = position.rpartition("-")
        version = int(digits) if digits.isascii() and digits.isdigit() else 0
        return version if epoch == self._epoch and version <= self._last else 0

    def note(self, model: StreamModel) -> int:
        """Return the version of a stream, a new one if it has changed."""
        state = hash(model.model_dump_json(exclude=_OF_TIME))
        known = self._known.get(model.name)
        if known is None or known[0] != state:
            self._last += 1
            known = self._known[model.name] = state, self._last
        return known[1]

    def keep(self, names: Iterable[str]) -> None:
        """Forget all streams but these: another one may get the name of a removed one."""
        there: Collection[str] = set(names)
        for name in self._known.keys() - there:
            del self._known[name]
