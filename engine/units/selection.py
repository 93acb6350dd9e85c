"""The unit that selects the samples of one object ([Events14 §V.C])."""

from __future__ import annotations

from typing import Any

from ...converters.objects import ObjectTable
from ...rdf.dictionary import HeldTerms
from ...streams.generator import StreamGenerator
from ...streams.sample import SampleBatch
from .base import ComputationalUnit


class SelectionUnit(ComputationalUnit):
    """Selects the samples of one object by its IRI ([Events14 §V.C]).

    Cost: a table look-up per sample; the table grows with the distinct ids of the stream.
    """

    def __init__(self, *args: Any, id_field: str, object: HeldTerms, objects: ObjectTable) -> None:
        super().__init__(*args)
        self._id_field = id_field
        self._object = object
        self._objects = objects

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        ids, present = self._objects.ids(batch.columns[self._id_field])
        selected = (ids == self._object.ids[0]) & present
        if bool(selected.any()):
            self.output.emit(batch.take(selected))
