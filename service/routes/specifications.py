"""Specifications in XML: what runs, and how it is to change ([Introspection15 §3.2, Listing 1])."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request, Response

from ...engine.durability.commands import ApplySpecification
from ..config.media_types import TEXT_XML, XML
from ..http.negotiation import content_type
from ..http.problems import responses
from ..http.text_limits import check_length
from ..models import InsertionModel, SpecificationModel, text_schema
from ..runtime.context import Context
from ..workers.route_calls import while_connected

router = APIRouter(tags=["specifications"])

EXAMPLE = """<?xml version="1.0" encoding="UTF-8"?>
<spec:specification xmlns:spec="http://www.dyknow.eu/ontology#Specification">
  <spec:insertions>
    <spec:cu name="speed" type="coordinatesToSpeed">
      <spec:parameter name="baseline" value="10s"/>
      <spec:stream name="positions"/>
    </spec:cu>
  </spec:insertions>
</spec:specification>"""
KINDS = (XML, TEXT_XML)
BODY = {
    "requestBody": {
        "required": True,
        "content": {kind: text_schema("a specification", EXAMPLE) for kind in KINDS},
    }
}
ANSWER: dict[int | str, dict[str, Any]] = {200: {"content": {XML: {"schema": {"type": "string"}}}}}


@router.post(
    "/specifications", openapi_extra=BODY, responses=responses(403, 404, 409, 413, 415, 422, 503)
)
async def apply(request: Request, service: Context) -> SpecificationModel:
    """Insert and remove units, all that the text says as one change, or nothing.

    400 with line and column for a text that is none, or speaks of what is not there. Applied again
    it changes nothing. What was inserted survives a restart.
    """
    content_type(request, KINDS)
    # Bytes: the text says itself how it is encoded.
    body = await request.body()
    check_length(body)
    specification = await while_connected(
        request, lambda: service.isolation.specifications.read(body)
    )
    if specification.insertions:
        service.memory.check()
    view = await service.do(ApplySpecification(body), specification)
    service.feeds.review()
    return SpecificationModel.of(view)


@router.get("/specifications", responses=responses())
async def list_insertions(service: Context) -> list[InsertionModel]:
    """What specifications inserted, in order, and what became of it."""
    return [InsertionModel.of(view) for view in service.engine.insertions()]


@router.get("/specifications/current", response_class=Response, responses=ANSWER)
async def current(service: Context) -> Response:
    """The running configuration as a specification; what none can express stands in a comment."""
    return Response(service.engine.current_specification(), media_type=XML)
