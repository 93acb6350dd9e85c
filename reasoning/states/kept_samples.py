"""The samples of a term that states to come may need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...streams.sample import Times
from ...streams.time import TIME_MAX, TIME_MIN


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """Samples of a term, in order of available time: shape ``(n,)``; ``places`` has shape
    ``(n, variables of the term)``: the places of their objects (`StateMaker.place`). ``life``: the
    number of the life of its stream that each is of; None: it does not matter."""

    available: Times
    valid: Times
    places: NDArray[np.int64]
    values: NDArray[Any]
    life: NDArray[np.int64] | None = None

    def take(self, rows: Any) -> Rows:
        life = None if self.life is None else self.life[rows]
        return Rows(
            self.available[rows], self.valid[rows], self.places[rows], self.values[rows], life
        )


class WaitingSamples:
    """Samples of a term that are not before the watermark."""

    def __init__(self, variables: int) -> None:
        self._variables = variables
        self._none = _no_rows(variables)
        self._rows: list[tuple[int, Rows]] = []
        """With their sources."""

    def __len__(self) -> int:
        return sum(len(rows.valid) for _, rows in self._rows)

    def add(self, source: int, rows: Rows) -> None:
        self._rows.append((source, rows))

    def take(self, watermark: int) -> Rows:
        """Remove the samples that are available before ``watermark``; return them in order of
        available time, source and arrival."""
        if not self._rows:
            return self._none
        due, rest = [], []
        for source, rows in sorted(self._rows, key=lambda each: each[0]):
            cut = int(rows.available.searchsorted(watermark, "left"))
            if cut:
                due.append(rows.take(slice(None, cut)))
            if cut < len(rows.available):
                rest.append((source, rows.take(slice(cut, None))))
        self._rows = rest
        found = _joined(due, self._variables)
        # Stable: parts of one source came in order.
        return found.take(np.argsort(found.available, kind="stable")) if len(due) > 1 else found

    def drop(self, place: int) -> None:
        """Forget the samples with this first place."""
        self._rows = [
            (source, rows.take(rows.places[:, 0] != place)) for source, rows in self._rows
        ]


class KeptSamples:
    """The samples of one term that states may need."""

    def __init__(self, variables: int, last: int = TIME_MAX) -> None:
        """``last``: the time (ns) of the last state that there may be."""
        self._variables = variables
        self._last = last
        self._waiting = WaitingSamples(variables)
        self._rows = _no_rows(variables)
        """Those of one valid time in order of available time, source and arrival."""

    def __len__(self) -> int:
        return len(self._rows.valid) + len(self._waiting)

    def add(self, source: int, rows: Rows) -> None:
        self._waiting.add(source, rows)

    def enter(self, watermark: int) -> Rows:
        """Let the samples in that are available before ``watermark``; return them."""
        new = self._waiting.take(watermark)
        # Samples that are valid later count for no state.
        kept = new.take(new.valid <= self._last) if self._last < TIME_MAX else new
        self._rows = _joined([self._rows, kept], self._variables)
        return new

    def at(
        self, due: Times, left: Times, shape: tuple[int, ...], ends: Times | None = None
    ) -> tuple[NDArray[Any], NDArray[np.int64], NDArray[np.int64] | None]:
        """The value at each state, and its sample's valid time (`TIME_MIN`: none); shape
        ``(n, *shape)``. With the ``ends`` of lives also that of its sample's life (`TIME_MIN`:
        none). Forgets the samples that no later state needs."""
        rows, count = self._rows, len(due)
        if bool((rows.valid[1:] < rows.valid[:-1]).any()):
            rows = rows.take(np.argsort(rows.valid, kind="stable"))
        # The first state that a sample counts for: it is valid then, and has come.
        first = np.maximum(
            due.searchsorted(rows.valid, "left"),
            left.searchsorted(rows.available, "left"),
        )
        cells = int(np.prod(shape, dtype=np.int64))
        cell = _cell_of(rows.places, shape)
        best = np.full((count, cells), -1, np.int64)
        counts = np.flatnonzero(first < count)
        # Of several rows of one cell the last one stays.
        best[first[counts], cell[counts]] = counts
        np.maximum.accumulate(best, axis=0, out=best)
        until = None
        if len(first):
            values = rows.values[best]
            valid = np.where(best < 0, TIME_MIN, rows.valid[best])
            if ends is not None:
                until = np.where(best < 0, TIME_MIN, ends[rows.life][best]).reshape(count, *shape)
        else:
            values = np.zeros(best.shape, rows.values.dtype)
            valid = np.full(best.shape, TIME_MIN, np.int64)
        keep = first >= count
        winners = best[-1]
        keep[winners[winners >= 0]] = True
        self._rows = rows.take(keep)
        return values.reshape(count, *shape), valid.reshape(count, *shape), until


def _no_rows(variables: int) -> Rows:
    none = np.empty(0, np.int64)
    return Rows(none, none, np.empty((0, variables), np.int64), np.empty(0))


def _joined(parts: Sequence[Rows], variables: int) -> Rows:
    parts = [part for part in parts if len(part.valid)]
    if len(parts) < 2:
        return parts[0] if parts else _no_rows(variables)
    lives = [part.life for part in parts if part.life is not None]
    return Rows(
        np.concatenate([part.available for part in parts]),
        np.concatenate([part.valid for part in parts]),
        np.concatenate([part.places for part in parts]),
        np.concatenate([part.values for part in parts]),
        np.concatenate(lives) if lives else None,
    )


def _cell_of(places: NDArray[np.int64], shape: tuple[int, ...]) -> NDArray[np.int64]:
    """The index of each row's objects in a flattened table of this shape."""
    cell = np.zeros(len(places), np.int64)
    for axis, size in enumerate(shape):
        cell = cell * size + places[:, axis]
    return cell
