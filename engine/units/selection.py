"""One object's samples out of the stream of all ([Events14 §V.C])."""

from __future__ import annotations

from typing import Any

from ...converters.objects import ObjectTable
from ...rdf.dictionary import HeldTerms
from ...streams.generator import StreamGenerator
from ...streams.sample import SampleBatch
from .base import ComputationalUnit


class SelectionUnit(ComputationalUnit):
    """Selects one object's samples out of a stream of many ([Events14 §V.C]).

    Cost: a table look-up per sample; the table grows with the distinct ids of the stream.
    """

    def __init__(self, *args: Any, id_field: str, object: HeldTerms, objects: ObjectTable) -> None:
        super().__init__(*args)
        self._id_field = id_field
        self._object = object
        self._objects = objects

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        ids, present = self._objects.ids(batch.columns[self._id_field])
        chosen = (ids == self._object.ids[0]) & present
        if bool(chosen.any()):
            self.output.emit(batch.take(chosen))
