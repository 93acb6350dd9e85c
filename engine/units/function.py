"""Units with vectorized implementations of transformations ([DyKnow10 Def. 5.10])."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...ontology.units import Conversion
from ...streams.generator import StreamGenerator
from ...streams.key_numbering import TextNumbering
from ...streams.sample import Column, FieldType, Mask, SampleBatch, Times
from .base import ComputationalUnit

UnitFunction = Callable[..., tuple[np.ndarray[Any, Any], Mask]]
"""An implementation: ``f(objects, valid, *inputs) -> (values, present)``, all shape ``(n,)``.

``objects`` are integer keys of the samples' objects, ``valid`` times in ns, ``inputs`` a float
array for each input of the transformation. The function keeps its own state between calls.
"""


@dataclass(frozen=True, slots=True)
class InputPort:
    """The field that feeds an input of the implementation, and the conversion to its unit."""

    field: str
    conversion: Conversion


class FunctionUnit(ComputationalUnit):
    """Applies a function to the samples of one stream, with a state for each object.

    ``id_fields`` distinguish the objects of the input. ``carried`` are pairs of an id field of the
    input and its field of the output. The output has these fields, the value, and the times of the
    input. A sample without a value or an object is dropped.
    """

    def __init__(
        self,
        *args: Any,
        function: UnitFunction,
        ports: Sequence[InputPort],
        id_fields: Sequence[str],
        carried: Sequence[tuple[str, str]],
        output_field: str,
    ) -> None:
        super().__init__(*args)
        self._function = function
        self._ports = tuple(ports)
        self._id_fields = tuple(id_fields)
        self._carried = tuple(carried)
        self._output_field = output_field
        self._texts = [TextNumbering() for _ in id_fields]
        self._keys: dict[tuple[int, ...], int] = {}

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        needed = [batch.columns[port.field] for port in self._ports]
        needed += [batch.columns[field] for field in self._id_fields]
        complete = np.logical_and.reduce([column.present for column in needed])
        if not bool(complete.all()):
            batch = batch.take(complete)
        if not len(batch):
            return
        inputs = [
            port.conversion.apply(batch.columns[port.field].values.astype(np.float64))
            for port in self._ports
        ]
        values, present = self._function(self._objects(batch), batch.valid, *inputs)
        present = present & np.isfinite(values)
        columns = {self._output_field: Column(FieldType.FLOAT, values[present])}
        for field, output in self._carried:
            columns[output] = batch.columns[field].take(present)
        result = SampleBatch(batch.available[present], batch.valid[present], columns)
        self.output.emit(result)

    def _objects(self, batch: SampleBatch) -> Times:
        """Return a number for each sample's object, or tuple of objects of an n-ary feature."""
        columns = []
        for field, texts in zip(self._id_fields, self._texts, strict=True):
            values, pool = batch.columns[field].values, batch.columns[field].pool
            columns.append(values.astype(np.int64) if pool is None else texts.of(values, pool))
        if not columns:
            return np.zeros(len(batch), np.int64)
        if len(columns) == 1:
            return columns[0]
        tuples = zip(*(column.tolist() for column in columns), strict=True)
        return np.array([self._keys.setdefault(key, len(self._keys)) for key in tuples], np.int64)
