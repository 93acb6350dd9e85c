"""Specifications in XML: read and change the configuration ([Introspection15 §3.2, Listing 1])."""

from __future__ import annotations

from typing import Any

from fastapi import Request, Response

from ...engine.durability.commands import ApplySpecification
from ..config.media_types import TEXT_XML, XML
from ..http.negotiation import content_type
from ..http.problems import responses
from ..http.routers import resource_router
from ..http.text_limits import check_length
from ..models import InsertionModel, SpecificationModel, text_schema
from ..runtime.context import Context
from ..workers.route_calls import while_connected

router = resource_router("specifications")

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
    """Insert and remove units: one change, as a whole or not at all.

    400 with line and column: a malformed text, or a reference to something that does not exist.
    Applying a text again changes nothing. Insertions survive a restart.
    """
    content_type(request, KINDS)
    # Bytes, not text: the XML declares its own encoding.
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
    """List what specifications inserted, in order, with its present state."""
    return [InsertionModel.of(view) for view in service.engine.insertions()]


@router.get("/specifications/current", response_class=Response, responses=ANSWER)
async def current(service: Context) -> Response:
    """Return the running configuration as a specification, with comments where XML has no form."""
    return Response(service.engine.current_specification(), media_type=XML)
