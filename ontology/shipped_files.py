"""The ontologies and shapes that the package contains."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from pyoxigraph import NamedNode, Triple

from . import graphs
from .texts.reading import read_triples

_HERE = Path(__file__).parent
SHIPPED_CLOSURE = _HERE / "closure.nt"
"""The triples that the shipped ontologies entail. The first line is a comment with their key
(`closure_key`)."""


@dataclass(frozen=True, slots=True)
class ShippedOntology:
    """A Turtle file of this room, and the graph for its triples."""

    graph: NamedNode
    file: Path

    def text(self) -> str:
        return self.file.read_text(encoding="utf-8")

    def triples(self) -> frozenset[Triple]:
        return read_triples(self.text(), "turtle", self.graph)


def shipped_ontologies() -> tuple[ShippedOntology, ...]:
    """Return the ontologies of the stream space and of aviation, and the alignments with other
    vocabularies."""
    alignments = sorted((_HERE / "alignments").glob("*.ttl"))
    return (
        ShippedOntology(graphs.STREAM_SPACE_ONTOLOGY, _HERE / "dyknow.ttl"),
        ShippedOntology(graphs.DOMAIN_ONTOLOGY, _HERE / "domain.ttl"),
        *(ShippedOntology(NamedNode(graphs.ALIGNMENTS + f.stem), f) for f in alignments),
    )


def shipped_hashes() -> dict[str, str]:
    """Return the hash of each shipped ontology's text, by its graph."""
    return {each.graph.value: text_hash(each.text()) for each in shipped_ontologies()}


def is_shipped(graph: NamedNode) -> bool:
    """Return whether the package contains the ontology of this graph; each start loads it."""
    return any(ontology.graph == graph for ontology in shipped_ontologies())


def shapes_text() -> str:
    """Return the SHACL shapes of a well-formed stream space, as Turtle."""
    return (_HERE / "shapes.ttl").read_text(encoding="utf-8")


def text_hash(text: str) -> str:
    """Return a hash that identifies a version of an ontology text."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()
