"""Annotations in SSL ([Events14 §III.A]): what streams, sources and units are about."""

from __future__ import annotations

from fastapi import APIRouter, Request
from fastapi.responses import JSONResponse, PlainTextResponse, Response

from ..context import Context
from ..models import AnnotationModel, text_schema
from ..negotiation import JSON, TEXT, accepted, text_body
from ..problems import responses

router = APIRouter(tags=["annotations"])

EXAMPLE = "stream s1 contains altitude(Aircraft) = alt [ft] for every Aircraft = icao24"
BODY = {
    "requestBody": {
        "required": True,
        "content": {TEXT: text_schema("declarations in SSL", EXAMPLE)},
    }
}


@router.post(
    "/annotations", status_code=201, openapi_extra=BODY, responses=responses(409, 413, 415)
)
async def annotate(request: Request, service: Context) -> list[AnnotationModel]:
    """Annotate streams, sources and units. All of the text takes effect, or none."""
    text = await text_body(request, (TEXT,))
    return [AnnotationModel.of(found) for found in service.engine.annotate(text)]


@router.get(
    "/annotations",
    response_model=list[AnnotationModel],
    responses={200: {"content": {TEXT: {"schema": {"type": "string"}}}}, **responses(406)},
)
async def list_annotations(request: Request, service: Context) -> Response:
    """All annotations; as SSL for ``Accept: text/plain``."""
    kind = accepted(request, (JSON, TEXT))
    found = [AnnotationModel.of(annotation) for annotation in service.engine.annotations()]
    if kind == TEXT:
        return PlainTextResponse("".join(f"{model.source.rstrip()}\n" for model in found))
    return JSONResponse([model.model_dump() for model in found])
