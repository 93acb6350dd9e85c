"""Samples of streams as triples: by their annotation, or as what the system answers is written."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...converters.to_triples import SampleConverter, node_names
from ...languages.ssl.annotation import StreamAnnotation
from ...streams.instants import places_in_instants
from ...streams.sample import SampleBatch
from ..catalog.declared_streams import DeclaredStreams
from ..catalog.semantics_manager import SemanticsManager
from ..configuration.configuration import Configuration


class SampleRdf:
    """Converters of streams, made when first needed.

    ``answered`` tells of a stream that the system makes how its samples are written, and ``query``
    gives the converter of a registered query's stream; None where it is no such stream.
    """

    def __init__(
        self,
        configuration: Configuration,
        declared: DeclaredStreams,
        manager: SemanticsManager,
        answered: Callable[[str], StreamAnnotation | None],
        query: Callable[[str], SampleConverter | None],
    ) -> None:
        self._configuration = configuration
        self._declared = declared
        self._manager = manager
        self._answered = answered
        self._query = query
        self._converters: dict[str, SampleConverter] = {}

    def of(self, name: str, batch: SampleBatch) -> list[str]:
        """Each sample of stream ``name`` as N-Triples; empty text where it says nothing."""
        converter = self.converter(name)
        if converter is None or not len(batch):
            return [""] * len(batch)
        lines: list[list[str]] = [[] for _ in range(len(batch))]
        names = node_names(batch.available, places_in_instants(batch.available))
        # Rows stand for times, since samples of one instant share theirs.
        numbered = batch.with_available(np.arange(len(batch)))
        for row, subject, predicate, object in converter.convert(numbered, names):
            lines[row].append(f"{subject} {predicate} {object} .")
        return ["\n".join(triples) for triples in lines]

    def converter(self, name: str) -> SampleConverter | None:
        """Converts the samples of a stream; None where nothing says what they mean."""
        source = self._configuration.late.source_of(name)
        if source is not None:  # a late sample says what it would have said in time
            return self.converter(source)
        found = self._converters.get(name)
        if found is None:
            found = self._query(name)
        if found is None:
            generator = self._configuration.stream(name)
            annotation = self._answered(name) or self._manager.annotations.get(name)
            if annotation is None:
                return None
            namespace = self._configuration.namespaces[name]
            found = self._declared.compile(annotation, generator.schema, namespace)
            self._converters[name] = found
        return found

    def forget(self, name: str) -> None:
        """Something of a stream has changed."""
        self._converters.pop(name, None)

    def forget_all(self) -> None:
        """The ontology has changed."""
        self._converters.clear()
