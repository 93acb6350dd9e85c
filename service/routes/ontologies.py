"""Domain ontologies: sorts, features and objects that the service is told of while it runs."""

from __future__ import annotations

from typing import Annotated, Any

import anyio
import anyio.to_thread
from fastapi import APIRouter, Query, Request
from pyoxigraph import NamedNode

from ...engine.durability.commands import LoadOntology
from ...ontology.errors import OntologyError
from ...ontology.graphs import STREAM_SPACE_ONTOLOGY
from ...ontology.ontology import PreparedOntology
from ...ontology.reading import TextFormat
from ...ontology.reasoning import Reasoning
from ...rdf.namespaces import OWL, RDF_TYPE, shorten
from ..http.negotiation import ONTOLOGY_FORMATS, content_type, utf8
from ..http.problems import Problem, responses
from ..models import (
    OntologyModel,
    OntologyReportModel,
    ViolationModel,
    text_schema,
)
from ..runtime.context import Context
from ..workers.route_calls import while_connected

router = APIRouter(tags=["ontologies"])

EXAMPLE = """@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .
<http://example.org/harbour> a owl:Ontology .
dyknow:Ship a owl:Class ; rdfs:subClassOf dyknow:Vehicle ."""
BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            kind: text_schema("an ontology", EXAMPLE)
            if kind == "text/turtle"
            else {"schema": {"type": "string"}}
            for kind in ONTOLOGY_FORMATS
        },
    }
}
_ONTOLOGY = NamedNode(OWL + "Ontology")
# A name of nothing: what a text calls <> has no IRI of its own.
_NO_BASE = NamedNode("urn:dyknow:no-base:")
_ANOTHER = "the stream space is described in its terms; say more of them under another name"
_NAME_IT = "say what it is called: ?name=<IRI>, or --name IRI"


@router.post(
    "/ontologies", status_code=201, openapi_extra=BODY, responses=responses(403, 413, 415, 503)
)
async def load_ontology(
    request: Request,
    service: Context,
    name: Annotated[
        str | None,
        Query(
            min_length=1,
            max_length=2000,
            description="the ontology's IRI; else that of the one owl:Ontology in the text",
        ),
    ] = None,
) -> OntologyModel:
    """Add a domain ontology, or replace the one of this name. All of it counts, or nothing.

    Its sorts, features and objects are known from then on, also to requests that run. FROM means
    it by its name. Imports are not followed. What the ontologies entail is computed anew, by a
    process of its own; 400 for a text that needs more time, memory or triples than it may have.
    """
    format = ONTOLOGY_FORMATS[content_type(request, tuple(ONTOLOGY_FORMATS))]
    body = await request.body()
    text = utf8(body)
    # What it entails is computed for a second: not of what cannot be kept.
    service.commands.check_room(len(body))
    documents, ontology = service.isolation.documents, service.engine.ontology

    def prepare() -> tuple[str, PreparedOntology]:
        known = _own_name(text, format, documents) if name is None else name
        if known == STREAM_SPACE_ONTOLOGY.value:
            # Not by the engine: logs of earlier versions may have it.
            raise OntologyError(f"the name {known} is the system's own", hint=_ANOTHER)
        service.gate.quotas.check_ontology(known)
        return known, ontology.prepare(text, name=known, format=format, reasoning=documents)

    known, prepared = await while_connected(request, lambda: documents.run(prepare))
    await service.do(LoadOntology(text, known, format), prepared)
    return OntologyModel(name=prepared.graph.value)


@router.get("/ontologies")
async def list_ontologies(service: Context) -> list[str]:
    """The names of the ontologies that are loaded, those that come with the program included."""
    return list(service.engine.ontology.ontologies())


_ONE_AT_A_TIME = anyio.CapacityLimiter(1)


@router.get("/ontologies/report")
async def report(service: Context) -> OntologyReportModel:
    """Hold everything that SPARQL sees against the shapes of a well-formed stream space (SHACL).

    It takes about a second, longer with many streams; requests are answered meanwhile.
    """
    service.engine.measure()
    found = await anyio.to_thread.run_sync(service.engine.ontology.validate, limiter=_ONE_AT_A_TIME)
    return OntologyReportModel(
        conforms=found.conforms,
        violations=[
            ViolationModel(node=shorten(each.node), path=each.path, message=each.message)
            for each in found.violations
        ],
    )


def _own_name(text: str, format: TextFormat, reasoning: Reasoning) -> str:
    """The IRI of the one ontology that the text declares.

    Raises a 400 `Problem` for none or several, `OntologyError` for a text that cannot be read.
    """
    names = {
        triple.subject.value
        for triple in reasoning.read(text, format, _NO_BASE)
        if triple.predicate == RDF_TYPE
        and triple.object == _ONTOLOGY
        and isinstance(triple.subject, NamedNode)
    }
    if len(names) != 1:
        found = "no owl:Ontology with an IRI" if not names else f"{len(names)} ontologies"
        raise Problem(400, "ontology without a name", f"the text declares {found}", hint=_NAME_IT)
    name = names.pop()
    if name.startswith(_NO_BASE.value):
        raise Problem(
            400,
            "ontology without a name",
            "the text's owl:Ontology is a relative IRI",
            hint=_NAME_IT,
        )
    return name
