"""The unit that selects the samples of objects ([Events14 §V.C])."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from pyoxigraph import NamedNode

from ...converters.objects import ObjectTable
from ...rdf.dictionary import HeldTerms, TermDictionary
from ...streams.generator import StreamGenerator
from ...streams.sample import SampleBatch
from .base import ComputationalUnit


class SelectionUnit(ComputationalUnit):
    """Selects the samples of objects by their IRIs: of one object ([Events14 §V.C]), or of those
    that requests ask for, which come and go.

    Cost: a table look-up per sample; the table grows with the distinct ids of the stream. Memory:
    some 100 bytes for each object that was ever asked for, and a byte for each term.
    """

    def __init__(
        self, *args: Any, id_field: str, objects: ObjectTable, dictionary: TermDictionary
    ) -> None:
        super().__init__(*args)
        self._id_field = id_field
        self._objects = objects
        self._dictionary = dictionary
        self._asked: Counter[str] = Counter()
        """By the IRI of an object, how often it is asked for; 0 if it has left."""
        self._count = 0
        self._counts = "object" not in self.parameters
        """Whether its parameters have the number of its objects."""
        self._terms: HeldTerms | None = None
        """The objects that are asked for; None: to be made."""
        self._is_asked = np.zeros(1, np.bool_)
        """By the id of a term, whether it is one of them."""

    def add(self, object: str) -> None:
        """Select the samples of ``object`` (an IRI) from now on, too."""
        self._ask(object, 1)

    def remove(self, object: str) -> None:
        """Undo one `add`."""
        self._ask(object, -1)

    def can_enter(self, object: str) -> bool:
        """Whether the units behind this one know no samples of ``object`` from before a gap."""
        return self._asked.get(object) != 0

    def _ask(self, object: str, change: int) -> None:
        before = self._asked[object] > 0
        self._asked[object] += change
        if before != (self._asked[object] > 0):
            self._count += change
            self._terms = None
        if self._counts:
            self.parameters["objects"] = str(self._count)

    def process(self, source: StreamGenerator, batch: SampleBatch) -> None:
        ids, present = self._objects.ids(batch.columns[self._id_field])
        if self._terms is None:
            asked = (NamedNode(object) for object, count in self._asked.items() if count)
            self._terms = HeldTerms(self._dictionary, asked)
            # Ids after the greatest one find the last place.
            self._is_asked = np.zeros(int(self._terms.ids.max(initial=-1)) + 2, np.bool_)
            self._is_asked[self._terms.ids] = True
        selected = self._is_asked.take(ids, mode="clip") & present
        if bool(selected.any()):
            self.output.emit(batch.take(selected))
