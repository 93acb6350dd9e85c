"""Terms of a query without an answer that the service does not know, with names that are near."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from typing import Final

from ...rdf.namespaces import DYKNOW, PREFIXES, STREAM_SPACE, shorten
from ...sparql.tokens import Kind, tokenize
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
        names: dict[str, list[str]] = {}
        """Names by their spelling in lower case."""
        for each in _column(client, f"SELECT DISTINCT ?t {{ {named} }}"):
            names.setdefault(each.removeprefix(namespace).lower(), []).append(each)
        near = get_close_matches(iri.removeprefix(namespace).lower(), names, n=3)
        meant = f"; did you mean {', '.join(shorten(t) for key in near for t in names[key])}?"
        yield f"nothing is called {shorten(iri)}{meant if near else ''}"


def _our_terms(text: str) -> dict[str, None]:
    """The IRIs of our namespaces in a query that the service has answered, each once."""
    prefixes = dict(PREFIXES)
    found: dict[str, None] = {}
    tokens = tokenize(text)
    for before, token, after in zip((None, *tokens), tokens, (*tokens[1:], None), strict=False):
        prefix, _, local = token.text.partition(":")
        if token.kind is Kind.IRI:
            iri = token.text[1:-1]
        elif token.kind is not Kind.PREFIXED:
            continue
        elif before is not None and before.is_word("PREFIX") and after is not None:
            prefixes[prefix] = after.text[1:-1]
            continue
        else:
            iri = prefixes.get(prefix, "") + local
        if any(iri.startswith(each) and iri != each for each in _OURS):
            found[iri] = None
    return found


def _column(client: Client, query: str) -> list[str]:
    answer = client.sparql(query)
    assert isinstance(answer, dict)
    return [row["t"]["value"] for row in answer["results"]["bindings"]]
