"""Samples that share an available time (SPEC §1)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .sample import Times

PlacesOf: TypeAlias = Callable[[Times], NDArray[np.int64]]
"""Returns the place of each sample of a batch in its instant, from 0, by their available times."""


def places_in_instants(available: Times) -> NDArray[np.int64]:
    """The place of each sample among those of its instant, from 0; ``available`` does not
    decrease.
    """
    rows = np.arange(len(available))
    begins = np.ones(len(available), np.bool_)
    np.not_equal(available[1:], available[:-1], out=begins[1:])
    return rows - np.maximum.accumulate(np.where(begins, rows, 0))


class Places:
    """`places_in_instants` of a stream whose batches may cut instants."""

    def __init__(self) -> None:
        self._last: tuple[int | None, int] = None, 0
        """The last instant, and how many samples of it there have been."""

    def of(self, available: Times) -> NDArray[np.int64]:
        """The places of the samples of the next batch."""
        places = places_in_instants(available)
        last, count = self._last
        if int(available[0]) == last:
            places[available == last] += count
        self._last = int(available[-1]), int(places[-1]) + 1
        return places
