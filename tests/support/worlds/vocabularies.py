"""The vocabulary of a small ontology, for tests."""

from __future__ import annotations

from pyoxigraph import RdfFormat, parse

from dyknow.ontology.vocabulary import Vocabulary
from dyknow.rdf.namespaces import PREFIXES

PROLOGUE = "".join(f"@prefix {name}: <{iri}> .\n" for name, iri in PREFIXES.items())


def vocabulary_of(turtle: str) -> Vocabulary:
    """That of an ontology in Turtle, which may use the usual prefixes."""
    quads = parse(PROLOGUE + turtle, format=RdfFormat.TURTLE)
    return Vocabulary.from_triples(quad.triple for quad in quads)
