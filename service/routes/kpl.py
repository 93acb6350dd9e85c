"""KPL over HTTP: declare, show, remove ([DyKnow10 §5.2])."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Query, Request
from fastapi.responses import PlainTextResponse, Response

from ...engine.durability.commands import AddKpl, RemoveKpl
from ..config.media_types import JSON, TEXT
from ..http.encodings.json_lists import listed
from ..http.negotiation import accepted, text_body
from ..http.problems import responses
from ..http.routers import resource_router
from ..http.text_limits import check_length, read_kpl
from ..models import (
    DeclarationModel,
    OneDeclarationModel,
    RemovedModel,
    text_schema,
)
from ..runtime.context import Context

router = resource_router("kpl")

EXAMPLE = """source float pos_car1
strmgen pos[car1] = pos_car1
stream slow = pos[car1] with sample every 200, max delay 100"""
BODY = {
    "requestBody": {
        "required": True,
        "content": {TEXT: text_schema("declarations in KPL", EXAMPLE)},
    }
}
Unit = Annotated[
    Literal["ns", "us", "ms", "s"],
    Query(description="the unit of integers, if the text has no `unit`"),
]


@router.post(
    "/kpl", status_code=201, openapi_extra=BODY, responses=responses(403, 404, 409, 413, 415)
)
async def declare(request: Request, service: Context, unit: Unit = "ms") -> list[DeclarationModel]:
    """Declare sources, computational units, generators and streams, and start them.

    The text takes effect as a whole, or not at all. 400 with line and column; 404: a unit without
    code; 409: a stream or the code differs from the declaration. Returns the new declarations; an
    equal earlier declaration stays as it is.
    """
    check_length(await request.body())
    text = await text_body(request, (TEXT,))
    await read_kpl(text)
    return [DeclarationModel.of(view) for view in await service.do(AddKpl(text, unit))]


@router.get(
    "/kpl",
    response_model=list[DeclarationModel],
    responses={200: {"content": {TEXT: {"schema": {"type": "string"}}}}, **responses(406)},
)
async def list_declarations(request: Request, service: Context) -> Response:
    """List all declarations in order; as KPL for ``Accept: text/plain``, with integers in ms."""
    if accepted(request, (JSON, TEXT)) == TEXT:
        return PlainTextResponse(service.engine.kpl_text())
    return await listed(service.engine.kpl(), DeclarationModel.of)


@router.get("/kpl/{name:path}", responses=responses(404))
async def read_declaration(name: str, service: Context) -> OneDeclarationModel:
    """Return one declaration by name or label, with the declarations that depend on it."""
    view, used_by = service.engine.kpl_declaration(name)
    return OneDeclarationModel(**DeclarationModel.of(view).model_dump(), used_by=list(used_by))


@router.delete("/kpl/{name:path}", responses=responses(404, 409))
async def remove_declaration(
    name: str,
    service: Context,
    cascade: Annotated[bool, Query(description="remove what depends on it, too")] = False,
) -> RemovedModel:
    """Stop and remove a declaration and its streams; clients of these get `end`.

    409: other declarations depend on it, and ``cascade`` is false; or something outside of KPL
    reads one of the streams.
    """
    removed = await service.do(RemoveKpl(name, cascade))
    service.feeds.review()
    return RemovedModel(removed=list(removed))
