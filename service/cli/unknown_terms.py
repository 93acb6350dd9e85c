"""Unknown terms of a query without results, and similar names."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from typing import Final

from pyoxigraph import NamedNode

from ...ontology.texts.turtle import ALL_PREFIXES
from ...rdf.namespaces import DYKNOW, STREAM_SPACE, shorten
from ...sparql.ast import walk
from ...sparql.parser import parse_sparql
from ..client.client import Client

_OURS: Final = (DYKNOW, STREAM_SPACE)
"""The namespaces whose terms the service knows completely."""


def unknown_terms(client: Client, text: str) -> Iterator[str]:
    """Yield a hint for each unknown term of our namespaces in a query, with similar names."""
    # The base that the service resolves relative IRIs against.
    terms = " ".join(f"<{iri}>" for iri in _our_terms(f"BASE <{client.url}/sparql>\n{text}"))
    if not terms:
        return
    nowhere = "FILTER NOT EXISTS { { ?t ?p ?o } UNION { ?s ?t ?o } UNION { ?s ?p ?t } }"
    for iri in _column(client, f"SELECT ?t {{ VALUES ?t {{ {terms} }} {nowhere} }}"):
        namespace = next(each for each in _OURS if iri.startswith(each))
        named = f'?t a ?kind FILTER (STRSTARTS(STR(?t), "{namespace}"))'
        names: dict[str, list[str]] = {}
        """Names by their spelling in lower case."""
        for each in _column(client, f"SELECT DISTINCT ?t {{ {named} }}"):
            names.setdefault(each.removeprefix(namespace).lower(), []).append(each)
        near = get_close_matches(iri.removeprefix(namespace).lower(), names, n=3)
        similar = f"; did you mean {', '.join(shorten(t) for key in near for t in names[key])}?"
        yield f"nothing is called {shorten(iri)}{similar if near else ''}"


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
