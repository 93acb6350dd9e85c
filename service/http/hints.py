"""The default hint of a problem, by its title: what to do next (service/http/problems)."""

from __future__ import annotations

from typing import Final

HINTS: Final = {
    "already exists": "remove the one that is there first, or use another name",
    "bad Accept header": "send media types such as Accept: application/json, text/csv;q=0.5",
    "bad JSON": "send JSON in UTF-8, not nested deeply, with each member once",
    "bad ontology": "send Turtle, RDF/XML, JSON-LD or N-Triples, as Content-Type says",
    "bad samples": "GET /streams/{name} lists the fields; docs/how-to/publish-samples.md has "
    "examples",
    "bad unit": "write units as SSL does: km.h-1, m.s-2",
    "conflict": "GET what is there, and send what agrees with it, or remove it first",
    "conversion failed": "GET /streams/{name} has the annotation and its fields",
    "internal error": "send it again; the log of the service has the cause, by instance",
    "journal broken": "send it again later, with the same Idempotency-Key; /readyz has the reason",
    "memory is short": "remove streams or requests that are not needed, keep less history "
    "(retention), or start the service with a larger DYKNOW_MEMORY_LIMIT; then send it again",
    "no plan": "GET /streams and /transformations list the parts of plans",
    "no result yet": "ask again when a window has closed",
    "no tokens": "send requests without logging in: a service without tokens is open",
    "precondition failed": "GET it for its ETag, and send that as If-Match",
    "query failed": "the query is valid, and failed on these data: FILTER them",
    "query needs too much": "ask for less: LIMIT, FILTER, fewer patterns without a common variable",
    "query refused": "the query is SPARQL 1.1; GET /explain shows how a text is read",
    "query too slow": "ask for less: LIMIT, FILTER, fewer patterns without a common variable",
    "result too large": "ask for less: LIMIT, or fewer variables",
    "stream without annotation": "POST /annotations says in SSL what the stream contains",
    "syntax error": "line, column and excerpt give the place",
    "unknown declaration": "GET /kpl lists the declarations",
    "unknown event": "GET /templates lists the templates, whose names are those of events",
    "unknown node": "GET /graph lists the names of all that runs",
    "unknown object": "GET /objects lists the known ones",
    "unknown query": "GET /queries lists the running queries",
    "unknown request": "GET /events and /subscriptions list the running requests",
    "unknown stream": "GET /streams lists the streams; PUT /streams/{name} declares one",
    "unknown template": "GET /templates lists the templates; POST /templates adds one",
    "unknown term": "ask the ontology for its terms, GET /sparql: SELECT * { ?s a owl:Class }",
    "unknown transformation": "GET /transformations lists the transformations",
    "values do not fit": "the schema of each route is at /docs and in /openapi.json",
    "wrong arguments": "the parameters of each route are at /docs and in /openapi.json",
}
GENERAL: Final = "docs/reference/http.md and /docs describe the input of each route"


def hint_for(title: str) -> str:
    """The hint for a problem with this ``title``."""
    return HINTS.get(title, GENERAL)
