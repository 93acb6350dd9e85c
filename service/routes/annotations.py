"""Annotations of streams, sources and units in SSL ([Events14 §III.A])."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, TypeAlias

from fastapi import Request
from fastapi.responses import PlainTextResponse, Response
from pydantic import Field

from ...engine.catalog.annotation_turtle import format_annotations
from ...engine.catalog.iri_annotations import (
    DescribedStream,
    DescribedTransformation,
)
from ...engine.catalog.transformation_turtle import read_annotations
from ...engine.durability.commands import Annotate, Describe
from ...languages.ssl.ast import StreamDeclaration
from ..config.media_types import JSON, TEXT, TURTLE
from ..config.text_bounds import MOST_CONTENTS, MOST_DECLARATIONS
from ..http.encodings.json_lists import listed
from ..http.negotiation import accepted, content_type, json_value, utf8
from ..http.problems import Problem, responses
from ..http.routers import resource_router
from ..http.text_limits import check_length, check_number, read_ssl, too_long
from ..models import AnnotationModel, ContentsIn, schema_of, text_schema
from ..runtime.context import Context, Service
from ..workers.route_calls import while_connected

router = resource_router("annotations")

EXAMPLE = "stream s1 contains altitude(Aircraft) = alt [ft] for every Aircraft = icao24"
LISTING = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
:s1 a :Stream ; :hasAnnotation [ :hasOutputAnnotation [ :describesFeature dyknow:altitude ;
  :hasName "alt" ; :hasArguments ( [ :describesSort dyknow:Aircraft ; :hasIdField "icao24" ] ) ] ] .
"""
DESCRIBED = {
    "stream": "s1",
    "contents": [
        {
            "feature": "dyknow:altitude",
            "field": "alt",
            "unit": "ft",
            "of": [{"name": "dyknow:Aircraft", "id": "icao24"}],
        }
    ],
}
BODY = {
    "requestBody": {
        "required": True,
        "content": {
            TEXT: text_schema("declarations in SSL", EXAMPLE),
            TURTLE: text_schema("annotations in the form of Listing 3", LISTING),
            JSON: {
                "schema": {
                    "anyOf": [
                        schema_of(ContentsIn),
                        {
                            "type": "array",
                            "items": schema_of(ContentsIn),
                            "maxItems": MOST_DECLARATIONS,
                        },
                    ]
                },
                "example": DESCRIBED,
            },
        },
    }
}
Described: TypeAlias = ContentsIn | Annotated[list[ContentsIn], Field(max_length=MOST_DECLARATIONS)]


@router.post(
    "/annotations",
    status_code=201,
    openapi_extra=BODY,
    responses=responses(403, 404, 409, 413, 415, 422),
)
async def annotate(request: Request, service: Context) -> list[AnnotationModel]:
    """Annotate streams, sources and units in SSL, or streams in JSON.

    The request takes effect as a whole, or not at all. A new annotation replaces that of the same
    stream. In JSON, names may be IRIs that SSL cannot write. 404: an unknown feature.
    """
    kind = content_type(request, (TEXT, JSON, TURTLE))
    body = await request.body()
    check_length(body)
    quotas = service.gate.quotas
    if kind == TEXT:
        text = utf8(body)
        declared = await read_ssl(text)
        streams = [one.name for one in declared if isinstance(one, StreamDeclaration)]
        quotas.check_streams(streams)
        others = [one.name for one in declared if not isinstance(one, StreamDeclaration)]
        quotas.check_transformations(others)
        annotations = await service.do(Annotate(text))
        return [AnnotationModel.of(annotation) for annotation in annotations]
    if kind == TURTLE:
        turtle, documents = utf8(body), service.isolation.documents
        parsed = await while_connected(
            request, lambda: documents.run(lambda: read_annotations(turtle, documents))
        )
        check_number(parsed)
        return await _describe(service, parsed)
    described: ContentsIn | list[ContentsIn] = await json_value(body, Described)
    items = described if isinstance(described, list) else [described]
    if sum(len(each.contents or ()) for each in items) > MOST_CONTENTS:
        raise too_long(f"{MOST_CONTENTS} contents")
    try:
        descriptions = [each.described() for each in items]
    except ValueError as error:
        raise Problem(400, "wrong arguments", str(error)) from error
    return await _describe(service, descriptions)


async def _describe(
    service: Service, described: Sequence[DescribedStream | DescribedTransformation]
) -> list[AnnotationModel]:
    streams = tuple(one for one in described if isinstance(one, DescribedStream))
    others = tuple(one for one in described if isinstance(one, DescribedTransformation))
    service.gate.quotas.check_streams([one.stream for one in streams])
    service.gate.quotas.check_transformations([one.name for one in others])
    annotations = await service.do(Describe(streams, others))
    return [AnnotationModel.of(annotation) for annotation in annotations]


@router.get(
    "/annotations",
    response_model=list[AnnotationModel],
    responses={
        200: {"content": {kind: {"schema": {"type": "string"}} for kind in (TEXT, TURTLE)}},
        **responses(406),
    },
)
async def list_annotations(request: Request, service: Context) -> Response:
    """List all annotations, as JSON, as SSL (``Accept: text/plain``) or as Turtle.

    POST accepts each form.
    """
    kind = accepted(request, (JSON, TEXT, TURTLE))
    annotations = service.engine.annotations()
    if kind == TEXT:
        return PlainTextResponse("".join(f"{each.source.rstrip()}\n" for each in annotations))
    if kind == TURTLE:
        return Response(format_annotations(annotations), media_type=TURTLE)
    return await listed(annotations, AnnotationModel.of)
