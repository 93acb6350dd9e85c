"""What is in a recording: its fields, times, rate and order, for ``dyknow inspect``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from ...streams.sample import SampleBatch, Schema, Times
from ...streams.time import SECOND
from ..inference import names_objects
from .recording import Recording

_NONE: Final = -(2**63)
"""The object of a row without id."""


@dataclass(frozen=True, slots=True)
class Overview:
    """A recording at a glance. Times are in ns.

    ``first`` and ``last`` are the least and the greatest valid time. ``interval`` is the median
    time between two samples (of one object, where there are several); None if no two differ.
    ``id_field`` names the objects, by its name; None if no field does. ``objects`` is how many.
    ``out_of_order`` counts the rows that step back in available time.
    """

    schema: Schema
    samples: int
    first: int
    last: int
    interval: int | None
    out_of_order: int
    time_column: str
    has_available: bool
    id_field: str | None
    objects: int

    @property
    def rate(self) -> float | None:
        """Samples a second (of one object), by the median interval."""
        return None if self.interval is None else SECOND / self.interval


def overview(recording: Recording) -> Overview:
    """Read a recording once. Cost: O(n log n). Memory: three columns of integers.

    Raises `WireError` with the line of a bad row.
    """
    schema = recording.schema
    id_field = next((name for name in schema.names if _is_id(name)), None)
    parts = [(b.valid, b.available, _objects(b, id_field)) for b in recording.read()]
    valid, available, ids = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.lexsort((valid, ids))
    steps = np.diff(valid[order])[np.diff(ids[order]) == 0]
    steps = steps[steps > 0]
    return Overview(
        schema,
        len(valid),
        int(valid.min()),
        int(valid.max()),
        int(np.median(steps)) if len(steps) else None,
        int(np.count_nonzero(available < np.maximum.accumulate(available))),
        recording.time_column,
        recording.has_available,
        id_field,
        0 if id_field is None else len(np.unique(ids[ids != _NONE])),
    )


def _is_id(name: str) -> bool:
    # ROS calls coordinate systems frames: `header.frame_id` is that of the values.
    return names_objects(name) and not name.endswith("frame_id")


def _objects(batch: SampleBatch, id_field: str | None) -> Times:
    """A number for the object of each row; all rows have one if there is no ``id_field``."""
    if id_field is None:
        return np.zeros(len(batch), np.int64)
    column = batch.columns[id_field]
    numbers = column.values.astype(np.int64)
    return numbers if column.null is None else np.where(column.null, _NONE, numbers)
