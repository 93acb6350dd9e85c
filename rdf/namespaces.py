"""The namespaces that every room shares (SPEC §2)."""

from __future__ import annotations

import re
from typing import Final

from pyoxigraph import NamedNode

DYKNOW: Final = "http://www.ida.liu.se/dyknow/"
"""Domain terms: ``dyknow:speed``, ``dyknow:UAV``, ``dyknow:uav1``, ``dyknow:HighSpeedEvent``."""
STREAM_SPACE: Final = "http://www.dyknow.eu/ontology#"
"""The stream-space ontology: ``dyknow-o:Stream``, ``dyknow-o:hasInput`` …"""
RDF: Final = "http://www.w3.org/1999/02/22-rdf-syntax-ns#"
RDFS: Final = "http://www.w3.org/2000/01/rdf-schema#"
OWL: Final = "http://www.w3.org/2002/07/owl#"
XSD: Final = "http://www.w3.org/2001/XMLSchema#"

PREFIXES: Final[dict[str, str]] = {
    "dyknow": DYKNOW,
    "dyknow-o": STREAM_SPACE,
    "rdf": RDF,
    "rdfs": RDFS,
    "owl": OWL,
    "xsd": XSD,
}
"""Prefixes that need no declaration in requests, SPARQL and templates sent to the service."""

RDF_TYPE: Final = NamedNode(RDF + "type")


def local_name(iri: str) -> str:
    """Return the part after the last ``#``, ``/`` or ``:``: ``UAV`` of ``dyknow:UAV``."""
    return re.split(r"[#/:]", iri.rstrip("#/:"))[-1] or iri


def shorten(iri: str) -> str:
    """Return ``prefix:local`` for an IRI in a shared namespace, else ``<iri>``: for messages."""
    for prefix, namespace in PREFIXES.items():
        local = iri.removeprefix(namespace)
        if local != iri and local.replace("_", "").replace("-", "").isalnum():
            return f"{prefix}:{local}"
    return f"<{iri}>"
