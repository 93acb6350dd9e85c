"""The named graphs of the store, and the IRIs of what is kept in them.

The store's default graph is the merge of all of them (each triple once), and is what SPARQL sees;
the named graphs say where a triple is from, and `GRAPH` reaches them. docs/reference/ontology.md
explains.
"""

from __future__ import annotations

from typing import Final
from urllib.parse import quote

from pyoxigraph import NamedNode

from ..rdf.namespaces import DYKNOW

STREAM_SPACE_ONTOLOGY: Final = NamedNode("http://www.dyknow.eu/ontology")
"""dyknow.ttl: the terms of [Introspection15 §4.1]."""
DOMAIN_ONTOLOGY: Final = NamedNode(DYKNOW + "ontology.rdf")
"""domain.ttl: the sorts and features of aviation and UAVs; the papers' ``FROM`` names it."""

ALIGNMENTS: Final = "http://www.dyknow.eu/ontology/alignments/"
"""The files of alignments/: the stream space in the words of other vocabularies, a graph each."""

_ANNOTATION_NODES: Final = "http://www.dyknow.eu/annotations/"
_DECLARATION_NODES: Final = "http://www.dyknow.eu/declarations/"
_TRANSFORMATION_NODES: Final = "http://www.dyknow.eu/transformations/"
_QUERY_NODES: Final = "http://www.dyknow.eu/queries/"
_OWN: Final = "http://www.dyknow.eu/graphs/"
ENTAILMENTS: Final = NamedNode(_OWN + "entailments")
"""What OWL RL adds to the loaded ontologies."""
TEMPLATES: Final = NamedNode(_OWN + "templates")
"""Event concepts with their templates."""
ANNOTATIONS: Final = NamedNode(_OWN + "annotations")
"""SSL texts, one a subject."""
DECLARATIONS: Final = NamedNode(_OWN + "declarations")
"""Declared streams, one JSON text a stream."""
TRANSFORMATIONS: Final = NamedNode(_OWN + "transformations")
"""Registered transformations, one JSON text a transformation."""
KPL: Final = NamedNode(_OWN + "kpl")
"""All KPL declarations, as one text."""
QUERIES: Final = NamedNode(_OWN + "queries")
"""Registered continuous queries, one JSON text a query."""
SPECIFICATIONS: Final = NamedNode(_OWN + "specifications")
"""What specifications inserted, as one text."""
CONCEPT_ENTAILMENTS: Final = NamedNode(_OWN + "concept-entailments")
"""What the ontology entails of templates, annotations and declarations."""
STREAM_SPACE: Final = NamedNode(_OWN + "stream-space")
"""The live stream space: what runs now. Emptied when the store is opened."""
STREAM_SPACE_ENTAILMENTS: Final = NamedNode(_OWN + "stream-space-entailments")
"""What the ontology entails of the live stream space."""
CATALOG: Final = NamedNode(_OWN + "catalog")
"""Which ontologies are loaded, with the hash of each text; not part of the merge."""

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
"""Graphs that no loaded ontology may take the name of."""

LOADED: Final = NamedNode(_OWN + "catalog#loaded")
"""``<ontology graph> LOADED "sha256 of its text"``."""
CLOSED: Final = NamedNode(_OWN + "catalog#closed")
"""``<entailments graph> CLOSED "key"``: what the kept closure was computed from."""


def annotation_node(name: str) -> NamedNode:
    """The `:Annotation` that keeps the SSL text of the subject called ``name``."""
    return NamedNode(f"{_ANNOTATION_NODES}{quote(name, safe='')}")


def declaration_node(name: str) -> NamedNode:
    """The `:Specification` that keeps the declaration of the stream called ``name``."""
    return NamedNode(f"{_DECLARATION_NODES}{quote(name, safe='')}")


def transformation_node(name: str) -> NamedNode:
    """The `:Specification` that keeps the description of the transformation called ``name``."""
    return NamedNode(f"{_TRANSFORMATION_NODES}{quote(name, safe='')}")


def query_node(name: str) -> NamedNode:
    """The `:Specification` that keeps the registration of the query called ``name``."""
    return NamedNode(f"{_QUERY_NODES}{quote(name, safe='')}")


def ontology_graph(name: str) -> NamedNode:
    """The graph of the ontology called ``name``: an absolute IRI, or a name under ``dyknow:``."""
    return NamedNode(name if ":" in name else f"{DYKNOW}ontology/{name}")
