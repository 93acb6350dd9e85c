"""What is in a recording: its fields, times, rate and order, for ``dyknow inspect``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from ...streams.sample import FieldType, SampleBatch, Schema, Times
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
    ``id_field`` names the objects (`_id_field`); None if no field does. ``objects`` is how many.
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
    """Read a recording once. Cost: O(n log n). Memory: columns of integers: the two times, and one
    for each field that may name the objects.

    Raises `WireError` with the line of a bad row.
    """
    schema = recording.schema
    named = next((name for name in schema.names if _is_id(name)), None)
    fields = _texts(schema) if named is None else [named]
    parts = [
        (b.valid, b.available, *(_objects(b, field) for field in fields)) for b in recording.read()
    ]
    valid, available, *objects = (np.concatenate(column) for column in zip(*parts, strict=True))
    by_field = dict(zip(fields, objects, strict=True))
    id_field = _id_field(valid, by_field) if named is None else named
    ids = np.zeros(len(valid), np.int64) if id_field is None else by_field[id_field]
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
    return names_objects(name) and not _is_frame(name)


def _is_frame(name: str) -> bool:
    # ROS calls coordinate systems frames: `header.frame_id` is that of the values.
    return name.endswith("frame_id")


def _texts(schema: Schema) -> list[str]:
    return [f.name for f in schema.fields if f.type is FieldType.STRING and not _is_frame(f.name)]


def _id_field(valid: Times, columns: Mapping[str, Times]) -> str | None:
    """The first field that tells apart the samples of each time, where the time alone does not."""
    if len(np.unique(valid)) == len(valid):
        return None
    for field, ids in columns.items():
        pairs = np.unique(np.stack([valid, ids]), axis=1)
        if pairs.shape[1] == len(valid) and not np.any(ids == _NONE):
            return field
    return None


def _objects(batch: SampleBatch, field: str) -> Times:
    """A number for the text of each row."""
    column = batch.columns[field]
    numbers = column.values.astype(np.int64)
    return numbers if column.null is None else np.where(column.null, _NONE, numbers)
