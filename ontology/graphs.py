"""The named graphs of the store, and the IRIs of the things stored in them.

The store's default graph is their merge (each triple once), and SPARQL queries read it. The named
graphs tell the origin of a triple; `GRAPH` reads them. docs/reference/ontology.md explains them.
"""

from __future__ import annotations

from typing import Final

from pyoxigraph import NamedNode

from ..rdf.namespaces import DYKNOW

STREAM_SPACE_ONTOLOGY: Final = NamedNode("http://www.dyknow.eu/ontology")
"""dyknow.ttl: the terms of [Introspection15 §4.1]."""
DOMAIN_ONTOLOGY: Final = NamedNode(DYKNOW + "ontology.rdf")
"""domain.ttl: the sorts and features of aviation and UAVs; the papers' ``FROM`` names it."""

ALIGNMENTS: Final = "http://www.dyknow.eu/ontology/alignments/"
"""The prefix of the graphs of alignments/, one for each file: the stream space in the terms of
other vocabularies."""

_OWN: Final = "http://www.dyknow.eu/graphs/"
ENTAILMENTS: Final = NamedNode(_OWN + "entailments")
"""The triples that OWL RL adds to the loaded ontologies."""
TEMPLATES: Final = NamedNode(_OWN + "templates")
"""Event concepts with their templates."""
ANNOTATIONS: Final = NamedNode(_OWN + "annotations")
"""SSL texts, one for each subject."""
DECLARATIONS: Final = NamedNode(_OWN + "declarations")
"""Declared streams, one JSON text each."""
TRANSFORMATIONS: Final = NamedNode(_OWN + "transformations")
"""Registered transformations, one JSON text each."""
KPL: Final = NamedNode(_OWN + "kpl")
"""All KPL declarations, as one text."""
QUERIES: Final = NamedNode(_OWN + "queries")
"""Registered continuous queries, one JSON text each."""
SPECIFICATIONS: Final = NamedNode(_OWN + "specifications")
"""The units that specifications inserted, as one text."""
CONCEPT_ENTAILMENTS: Final = NamedNode(_OWN + "concept-entailments")
"""The entailments of templates, annotations and declarations."""
STREAM_SPACE: Final = NamedNode(_OWN + "stream-space")
"""The live stream space: the running streams and units. Opening a store empties it."""
STREAM_SPACE_ENTAILMENTS: Final = NamedNode(_OWN + "stream-space-entailments")
"""The entailments of the live stream space."""
CATALOG: Final = NamedNode(_OWN + "catalog")
"""The loaded ontologies with the hash of each text; not part of the merge."""

SYSTEM: Final = frozenset(
    {
        ENTAILMENTS,
        TEMPLATES,
        ANNOTATIONS,
        DECLARATIONS,
        TRANSFORMATIONS,
        KPL,
        QUERIES,
        SPECIFICATIONS,
        CONCEPT_ENTAILMENTS,
        STREAM_SPACE,
        STREAM_SPACE_ENTAILMENTS,
        CATALOG,
    }
)
"""The system's graphs. An ontology cannot have one of these names."""

LOADED: Final = NamedNode(_OWN + "catalog#loaded")
"""``<ontology graph> LOADED "sha256 of its text"``."""
CLOSED: Final = NamedNode(_OWN + "catalog#closed")
"""``<entailments graph> CLOSED "key"``: the key of the texts that the stored closure was computed
from."""


def ontology_graph(name: str) -> NamedNode:
    """Return the graph of the ontology ``name``: an absolute IRI, or a name under ``dyknow:``."""
    return NamedNode(name if ":" in name else f"{DYKNOW}ontology/{name}")
