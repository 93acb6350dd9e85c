"""Domain ontologies, loaded while the service runs: sorts, features and objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import anyio
import anyio.to_thread
from fastapi import Path, Query, Request, Response
from fastapi.responses import PlainTextResponse
from pyoxigraph import Literal, NamedNode, Store

from ...engine.durability.commands import LoadOntology, RemoveOntology
from ...engine.model.errors import UnknownOntology
from ...ontology.errors import OntologyError
from ...ontology.graphs import STREAM_SPACE_ONTOLOGY
from ...ontology.ontology import PreparedOntology
from ...ontology.reasoning import Reasoning
from ...ontology.texts.reading import TextFormat
from ...ontology.units import format_unit
from ...ontology.vocabulary import Vocabulary
from ...rdf.namespaces import OWL, PREFIXES, RDF_TYPE, RDFS, shorten
from ..config.media_types import TURTLE
from ..http.negotiation import ONTOLOGY_FORMATS, accepted, content_type, utf8
from ..http.problems import Problem, responses
from ..http.routers import resource_router
from ..models import (
    FeatureModel,
    OntologyModel,
    OntologyReportModel,
    SortModel,
    ViolationModel,
    VocabularyModel,
    text_schema,
)
from ..runtime.context import Context
from ..workers.route_calls import while_connected

router = resource_router("ontologies")

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
TEXT_RESPONSE: dict[int | str, dict[str, Any]] = {
    200: {"content": {TURTLE: {"schema": {"type": "string"}}}}
}
_ONTOLOGY = NamedNode(OWL + "Ontology")
_COMMENT = NamedNode(RDFS + "comment")
# The base of relative IRIs: an ontology that a text calls <> has no IRI of its own.
_NO_BASE = NamedNode("urn:dyknow:no-base:")
_OTHER_NAME_HINT = (
    "the system describes the stream space in it; load your ontology under another name"
)
_NAME_HINT = "name it: ?name=<IRI>, or --name IRI"
Name = Annotated[str, Path(description="the ontology's IRI, or its short name")]


@router.get("/vocabulary")
async def read_vocabulary(service: Context) -> VocabularyModel:
    """Return the sorts, features and events that annotations, requests and queries may name."""
    ontology = service.engine.ontology
    vocabulary, store = ontology.vocabulary, ontology.static_store
    sorts = _domain_sorts(vocabulary)
    features = [vocabulary.feature(iri) for iri in vocabulary.features()]
    return VocabularyModel(
        sorts=[
            SortModel(
                name=shorten(sort), parents=[*map(shorten, _parents(sort, sorts, vocabulary))]
            )
            for sort in sorts
        ],
        features=[
            FeatureModel(
                name=shorten(each.iri),
                unit=None if each.unit is None else format_unit(each.unit) or None,
                domain=None if each.domain is None else shorten(each.domain),
                arity=each.arity,
                doc=_comment(each.iri, store),
            )
            for each in features
            if each is not None
        ],
        events=[*map(shorten, vocabulary.events())],
        prefixes=dict(PREFIXES),
    )


def _comment(iri: str, store: Store) -> str | None:
    for quad in store.quads_for_pattern(NamedNode(iri), _COMMENT, None):
        if isinstance(quad.object, Literal):
            return quad.object.value
    return None


def _domain_sorts(vocabulary: Vocabulary) -> list[str]:
    return [each for each in vocabulary.sorts() if vocabulary.is_domain_sort(each)]


def _parents(sort: str, sorts: Sequence[str], vocabulary: Vocabulary) -> list[str]:
    """Those of ``sorts`` right above ``sort``: above it, and above no other of them."""
    above = {each for each in vocabulary.supersorts(sort) if each != sort}.intersection(sorts)
    farther = {up for each in above for up in vocabulary.supersorts(each) if up != each}
    return sorted(above - farther)


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
            description="the ontology's IRI; default: the IRI of the one owl:Ontology in the text",
        ),
    ] = None,
) -> OntologyModel:
    """Add a domain ontology, or replace the one of this name, as a whole or not at all.

    Its sorts, features and objects are known at once, also to running requests. FROM refers to it
    by its name. Imports are not followed. A separate process computes the entailments of all
    ontologies. 400: the text needs more time, memory or triples than it may.
    """
    format = ONTOLOGY_FORMATS[content_type(request, tuple(ONTOLOGY_FORMATS))]
    body = await request.body()
    text = utf8(body)
    # First: computing the entailments takes a second, in vain if the log has no room.
    service.commands.check_room(len(body))
    documents, ontology = service.isolation.documents, service.engine.ontology

    def prepare() -> tuple[str, PreparedOntology]:
        iri = _own_name(text, format, documents) if name is None else name
        if iri == STREAM_SPACE_ONTOLOGY.value:
            # Checked here, not in the engine: logs of earlier versions may contain it.
            raise OntologyError(f"the name {iri} is the system's own", hint=_OTHER_NAME_HINT)
        service.gate.quotas.check_ontology(iri)
        return iri, ontology.prepare(text, name=iri, format=format, reasoning=documents)

    iri, prepared = await while_connected(request, lambda: documents.run(prepare))
    await service.do(LoadOntology(text, iri, format), prepared)
    return OntologyModel(name=prepared.graph.value)


@router.get("/ontologies")
async def list_ontologies(service: Context) -> list[str]:
    """List the names of the loaded ontologies, including the shipped ones."""
    return list(service.engine.ontology.ontologies())


_ONE_AT_A_TIME = anyio.CapacityLimiter(1)


@router.get("/ontologies/report")
async def report(service: Context) -> OntologyReportModel:
    """Validate all that SPARQL sees against the SHACL shapes of a well-formed stream space.

    It takes about a second, longer with many streams; the service answers other requests meanwhile.
    """
    service.engine.measure()
    report = await anyio.to_thread.run_sync(
        service.engine.ontology.validate, limiter=_ONE_AT_A_TIME
    )
    return OntologyReportModel(
        conforms=report.conforms,
        violations=[
            ViolationModel(node=shorten(each.node), path=each.path, message=each.message)
            for each in report.violations
        ],
    )


@router.get(
    "/ontologies/{name:path}",
    response_class=PlainTextResponse,
    responses=TEXT_RESPONSE | responses(404, 406),
)
async def read_ontology(name: Name, request: Request, service: Context) -> Response:
    """Return a loaded ontology's triples as Turtle. Comments of the loaded text are not kept."""
    accepted(request, (TURTLE,))
    ontology = service.engine.ontology
    graph = ontology.loaded(name)
    if graph is None:
        raise UnknownOntology(
            f"there is no ontology {name!r}", "GET /ontologies lists the loaded ones"
        )
    text = await anyio.to_thread.run_sync(ontology.turtle, graph, limiter=_ONE_AT_A_TIME)
    return PlainTextResponse(text, media_type=TURTLE)


@router.delete("/ontologies/{name:path}", status_code=204, responses=responses(403, 404, 409, 503))
async def remove_ontology(name: Name, request: Request, service: Context) -> Response:
    """Remove a loaded ontology; its terms are unknown at once. 403: a shipped one. 409: something
    names its terms; ``used_by`` lists templates, annotations, queries, requests and so on.

    A separate process computes the entailments of the other ontologies.
    """
    documents, ontology = service.isolation.documents, service.engine.ontology
    prepared: PreparedOntology | None = None
    # One that is not loaded may wait since a restart: the command removes it then.
    if ontology.loaded(name) is not None:
        iri = service.engine.removable_ontology(name)
        prepared = await while_connected(
            request,
            lambda: documents.run(lambda: ontology.prepare_removal(iri, reasoning=documents)),
        )
    await service.do(RemoveOntology(name), prepared)
    return Response(status_code=204)


def _own_name(text: str, format: TextFormat, reasoning: Reasoning) -> str:
    """Return the IRI of the one ontology that the text declares.

    Raises a 400 `Problem` for none or several, `OntologyError` for a malformed text.
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
        raise Problem(400, "ontology without a name", f"the text declares {found}", hint=_NAME_HINT)
    name = names.pop()
    if name.startswith(_NO_BASE.value):
        raise Problem(
            400,
            "ontology without a name",
            "the text's owl:Ontology is a relative IRI",
            hint=_NAME_HINT,
        )
    return name
