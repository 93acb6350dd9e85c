"""Terms of a query without an answer that the service does not know, with names that are near."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from typing import Final

from pyoxigraph import NamedNode

from ...ontology.turtle import ALL_PREFIXES
from ...rdf.namespaces import DYKNOW, STREAM_SPACE, shorten
from ...sparql.ast import walk
from ...sparql.parser import parse_sparql
from ..client.client import Client

_OURS: Final = (DYKNOW, STREAM_SPACE)
"""The namespaces of terms that the service knows where they exist."""


def unknown_terms(client: Client, text: str) -> Iterator[str]:
    """Terms of our namespaces in a query that the service does not know, with names near them."""
    asked = " ".join(f"<{iri}>" for iri in _our_terms(text))
    if not asked:
        return
    nowhere = "FILTER NOT EXISTS { { ?t ?p ?o } UNION { ?s ?t ?o } UNION { ?s ?p ?t } }"
    for iri in _column(client, f"SELECT ?t {{ VALUES ?t {{ {asked} }} {nowhere} }}"):
        namespace = next(each for each in _OURS if iri.startswith(each))
        named = f'?t a ?kind FILTER (STRSTARTS(STR(?t), "{namespace}"))'
        names = [
            each.removeprefix(namespace)
            for each in _column(client, f"SELECT DISTINCT ?t {{ {named} }}")
        ]
        near = get_close_matches(iri.removeprefix(namespace), names, n=3)
        meant = f"; did you mean {', '.join(shorten(namespace + name) for name in near)}?"
        yield f"nothing is called {shorten(iri)}{meant if near else ''}"


def _our_terms(text: str) -> dict[str, None]:
    """Return the IRIs of our namespaces in a query that the service has answered, each once."""
    iris = (
        one.value for one in walk(parse_sparql(text, ALL_PREFIXES)) if isinstance(one, NamedNode)
    )
    return {iri: None for iri in iris if any(iri.startswith(o) and iri != o for o in _OURS)}


def _column(client: Client, query: str) -> list[str]:
    answer = client.sparql(query)
    assert isinstance(answer, dict)
    return [row["t"]["value"] for row in answer["results"]["bindings"]]
