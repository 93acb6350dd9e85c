"""Event templates ([Events14 §IV]): register, read, replace, remove."""

from __future__ import annotations

from typing import Annotated, Any
from urllib.parse import quote

from fastapi import Header, Path, Request, Response
from fastapi.responses import JSONResponse, PlainTextResponse

from ...engine.durability.commands import RegisterTemplate, RemoveTemplate
from ...engine.model.errors import UnknownTemplate
from ...engine.model.views import TemplateView
from ...languages.templates import parse_any_template
from ...rdf.namespaces import local_name, shorten
from ..config.media_types import JSON, SPARQL_QUERY, TEXT
from ..http.entity_tags import names
from ..http.negotiation import accepted, text_body
from ..http.problems import Problem, responses
from ..http.routers import resource_router
from ..http.text_limits import parse_aside, parse_registration
from ..models import TemplateModel, text_schema
from ..runtime.context import Context, Service

router = resource_router("templates")

TEXTS = (TEXT, SPARQL_QUERY)
EXAMPLE = """REGISTER TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?avgSpeed}
FROM <http://www.ida.liu.se/dyknow/ontology.rdf>
WHERE { ?o a ?type . ?o dyknow:speed ?spd . }
AGGREGATE {(?avgSpeed, AVG, {?spd}) FILTER (?avgSpeed > ?threshold)}
WINDOW [RANGE 5s STEP 1s]"""
BODY = {
    "requestBody": {
        "required": True,
        "content": {
            kind: text_schema("a REGISTER TEMPLATE text, of a query or a formula", EXAMPLE)
            for kind in TEXTS
        },
    }
}
TEXT_RESPONSE: dict[int | str, dict[str, Any]] = {
    200: {"content": {TEXT: {"schema": {"type": "string"}}}}
}
Name = Annotated[str, Path(description="the event's local name or IRI")]
IfMatch = Annotated[str | None, Header(description="act only on this version (412 otherwise)")]
IfNoneMatch = Annotated[str | None, Header()]


@router.post(
    "/templates",
    status_code=201,
    response_model=TemplateModel,
    openapi_extra=BODY,
    responses=responses(409, 413, 415),
)
async def register_template(request: Request, service: Context) -> Response:
    """Register a template. It becomes a property of its event concept and survives a restart."""
    text = await text_body(request, TEXTS)
    await parse_aside(parse_registration, text)
    view = await service.do(RegisterTemplate(text))
    return _answer(view, 201)


@router.get(
    "/templates", response_model=list[TemplateModel], responses=TEXT_RESPONSE | responses(406)
)
async def list_templates(request: Request, service: Context) -> Response:
    """List all templates; for ``Accept: text/plain`` their source texts."""
    kind = accepted(request, (JSON, TEXT))
    views = service.engine.templates()
    if kind == TEXT:
        return PlainTextResponse("\n\n".join(view.source for view in views))
    return JSONResponse([TemplateModel.of(view).model_dump() for view in views])


@router.get(
    "/templates/{name:path}",
    response_model=TemplateModel,
    responses=TEXT_RESPONSE | responses(404, 406),
)
async def read_template(
    name: Name, request: Request, service: Context, if_none_match: IfNoneMatch = None
) -> Response:
    """Return one template; for ``Accept: text/plain`` its source text."""
    kind = accepted(request, (JSON, TEXT))
    view = service.engine.template(name)
    if names(if_none_match, view.etag):
        return Response(status_code=304, headers=_headers(view))
    if kind == TEXT:
        return PlainTextResponse(view.source, headers=_headers(view))
    return _answer(view, 200)


@router.put(
    "/templates/{name:path}",
    response_model=TemplateModel,
    openapi_extra=BODY,
    responses={201: {"model": TemplateModel}, **responses(404, 409, 412, 413, 415)},
)
async def put_template(
    name: Name,
    request: Request,
    service: Context,
    if_match: IfMatch = None,
    if_none_match: IfNoneMatch = None,
) -> Response:
    """Register the template of this name, or replace it. Running requests keep the old one."""
    text = await text_body(request, TEXTS)
    await parse_aside(parse_registration, text)
    registered = parse_any_template(text).name
    if name not in (registered, f"<{registered}>", shorten(registered), local_name(registered)):
        raise Problem(
            409,
            "conflict",
            f"the text registers <{registered}>, but the address names {name}",
            hint=f"PUT it to /templates/{local_name(registered)}",
        )
    old = _existing(service, name)
    _check(old, if_match, if_none_match)
    view = await service.do(RegisterTemplate(text, replace=True))
    return _answer(view, 201 if old is None else 200)


@router.delete("/templates/{name:path}", status_code=204, responses=responses(404, 409, 412))
async def remove_template(name: Name, service: Context, if_match: IfMatch = None) -> Response:
    """Remove a template and its event concept. 409: a request for the event runs."""
    if if_match is not None:
        _check(service.engine.template(name), if_match, None)
    await service.do(RemoveTemplate(name))
    return Response(status_code=204)


def _answer(view: TemplateView, status: int) -> Response:
    return JSONResponse(TemplateModel.of(view).model_dump(), status, headers=_headers(view))


def _headers(view: TemplateView) -> dict[str, str]:
    # Percent-encode: a name may have characters that a header or an address may not, such as `#`.
    location = f"/templates/{quote(view.local_name, safe='/:')}"
    return {"ETag": _quoted(view.etag), "Location": location}


def _existing(service: Service, name: str) -> TemplateView | None:
    try:
        return service.engine.template(name)
    except UnknownTemplate:
        return None


def _check(view: TemplateView | None, if_match: str | None, if_none_match: str | None) -> None:
    """Raises a 412 `Problem` unless the conditions hold for the present template."""
    if if_match is not None and (view is None or not names(if_match, view.etag)):
        now = "it does not exist" if view is None else f"it is {_quoted(view.etag)} now"
        raise Problem(
            412,
            "precondition failed",
            f"the template is not {if_match}: {now}",
            hint="read the template again, then decide",
        )
    if if_none_match is not None and view is not None and names(if_none_match, view.etag):
        raise Problem(412, "precondition failed", "the template exists already")


def _quoted(etag: str) -> str:
    return etag if etag.startswith('"') else f'"{etag}"'
