"""The interface for parsing RDF texts and closing them, in this process or in another.

On a stranger's text both may take long and recurse deeply. The service therefore gives
`Ontology.prepare` an implementation with limits (service/workers). `DIRECT` has none.
"""

from __future__ import annotations

from typing import Final, Protocol

from pyoxigraph import NamedNode, Triple

from .entailment.closure import cached_closure
from .texts.reading import TextFormat, read_triples


class Reasoning(Protocol):
    """Parses texts and computes closures."""

    def read(self, text: str, format: TextFormat, base: NamedNode) -> frozenset[Triple]:
        """See `reading.read_triples`."""

    def entail(self, asserted: frozenset[Triple]) -> frozenset[Triple]:
        """See `closure.closure_of`."""


class DirectReasoning:
    """Parses and reasons in this process, without limits."""

    def read(self, text: str, format: TextFormat, base: NamedNode) -> frozenset[Triple]:
        return read_triples(text, format, base)

    def entail(self, asserted: frozenset[Triple]) -> frozenset[Triple]:
        return cached_closure(asserted)


DIRECT: Final = DirectReasoning()
