"""The formats of ontology files, by suffix. It computes nothing: the command line needs it, too."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from .reading import TextFormat

FORMATS: Final[dict[str, TextFormat]] = {
    ".ttl": "turtle",
    ".rdf": "rdfxml",
    ".owl": "rdfxml",
    ".xml": "rdfxml",
    ".jsonld": "jsonld",
    ".nt": "ntriples",
}
"""The format of an ontology file, by its suffix."""
