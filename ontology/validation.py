"""Is the stream space well-formed? SHACL shapes say so, pyshacl checks (SPEC §2)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import rdflib
from pyoxigraph import Triple

from .closure import to_rdflib
from .shipped import shapes_text


@dataclass(frozen=True, slots=True)
class ShaclReport:
    """Whether the data conforms, and the report as text for people."""

    conforms: bool
    text: str


def validate(triples: Iterable[Triple]) -> ShaclReport:
    """Checks closed triples against shapes.ttl. Nothing is fetched or inferred."""
    # pyshacl takes a third of a second to import and is asked only by people.
    import pyshacl

    data = rdflib.Graph()
    for triple in triples:
        data.add(to_rdflib(triple))
    shapes = rdflib.Graph().parse(data=shapes_text(), format="turtle")
    conforms, _, text = pyshacl.validate(
        data, shacl_graph=shapes, inference="none", do_owl_imports=False, advanced=False, js=False
    )
    return ShaclReport(bool(conforms), str(text))
