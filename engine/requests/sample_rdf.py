"""Converts samples of streams to triples, by the stream's annotation or that of an answer."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...converters.rdf.sample_texts import sample_texts
from ...converters.term_tables import TermTexts
from ...converters.to_triples import ToTriples, node_names
from ...languages.ssl.annotation import StreamAnnotation
from ...rdf.dictionary import TermDictionary
from ...streams.instants import PlacesOf, places_in_instants
from ...streams.sample import SampleBatch
from ..catalog.declared_streams import DeclaredStreams
from ..catalog.semantics_manager import SemanticsManager
from ..configuration.configuration import Configuration


class SampleRdf:
    """The converters of streams, made on first use.

    ``annotation_of_answer`` returns the annotation for the samples of an answer, and ``query`` the
    converter of a registered query's stream; both return None for other streams.
    """

    def __init__(
        self,
        configuration: Configuration,
        declared: DeclaredStreams,
        manager: SemanticsManager,
        dictionary: TermDictionary,
        annotation_of_answer: Callable[[str], StreamAnnotation | None],
        query: Callable[[str], ToTriples | None],
    ) -> None:
        self._configuration = configuration
        self._declared = declared
        self._manager = manager
        self._annotation_of_answer = annotation_of_answer
        self._query_converter = query
        self._converters: dict[str, ToTriples] = {}
        self._texts = TermTexts(dictionary)

    def of(self, name: str, batch: SampleBatch, places: PlacesOf = places_in_instants) -> list[str]:
        """Return each sample of stream ``name`` as N-Triples; an empty text if it has no
        triples. ``places`` returns the place of each sample in its instant, from 0, which names
        its nodes; without it the batch begins with an instant."""
        converter = self.converter(name)
        if converter is None or not len(batch):
            return [""] * len(batch)
        times = batch.available
        names = node_names(times, places(times)) if converter.makes_nodes else None
        # Convert with row numbers in place of times, since samples of one instant share a time.
        numbered = batch.with_available(np.arange(len(batch)))
        return sample_texts(converter.convert(numbered, names), len(batch), self._texts)

    def converter(self, name: str) -> ToTriples | None:
        """Return the converter of a stream; None if it has no annotation and is none of RDF."""
        source = self._configuration.late.source_of(name)
        if source is not None:  # late samples have the meaning of their stream's samples
            return self.converter(source)
        found = self._converters.get(name)
        if found is None:
            found = self._query_converter(name)
        if found is None:
            generator = self._configuration.stream(name)
            if generator.name in self._configuration.statements:
                found = self._converters[name] = self._declared.statements(generator.name)
                return found
            annotation = self._annotation_of_answer(name) or self._manager.annotations.get(name)
            if annotation is None:
                return None
            namespace = self._configuration.namespaces[name]
            found = self._declared.compile(annotation, generator.schema, namespace)
            self._converters[name] = found
        return found

    def forget(self, name: str) -> None:
        """Drop the converter of a stream that has changed."""
        self._converters.pop(name, None)

    def forget_all(self) -> None:
        """Drop all converters, after a change of the ontology."""
        self._converters.clear()
