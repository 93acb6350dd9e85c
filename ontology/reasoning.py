"""Whoever reads RDF texts and computes what they entail: this process, or one that can be stopped.

Both may take as long as they like with what a stranger wrote, and recurse into it. The service
gives `Ontology.prepare` one that has limits (service/workers); `DIRECT` has none.
"""

from __future__ import annotations

from typing import Final, Protocol

from pyoxigraph import NamedNode, Triple

from .closure import cached_closure
from .reading import TextFormat, read_triples


class Reasoning(Protocol):
    """Reads and entails."""

    def read(self, text: str, format: TextFormat, base: NamedNode) -> frozenset[Triple]:
        """See `reading.read_triples`."""

    def entailed(self, asserted: frozenset[Triple]) -> frozenset[Triple]:
        """See `closure.closure_of`."""


class DirectReasoning:
    """In this process."""

    def read(self, text: str, format: TextFormat, base: NamedNode) -> frozenset[Triple]:
        return read_triples(text, format, base)

    def entailed(self, asserted: frozenset[Triple]) -> frozenset[Triple]:
        return cached_closure(asserted)


DIRECT: Final = DirectReasoning()
