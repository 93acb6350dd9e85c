"""Events on demand ([Events14 §V.B]): request, list, read, cancel."""

from __future__ import annotations

from codecs import BOM_UTF8
from typing import Annotated, Any

from fastapi import Query, Request, Response

from ...engine.durability.accepted_commands import REQUEST
from ...engine.durability.commands import CancelEvent, RequestEvent
from ..config.media_types import JSON, TEXT
from ..http.encodings.json_lists import listed
from ..http.negotiation import content_type, json_value, utf8
from ..http.problems import responses
from ..http.routers import resource_router
from ..models import (
    BEGINNING,
    EventIn,
    EventModel,
    MatchesWhyModel,
    PartialMatchesModel,
    Since,
    Strategy,
    WhyModel,
    schema_of,
    text_schema,
)
from ..runtime.context import Context
from .reasoning import TABLE, Limit, Objects, ObjectsOfMatch, Start, partial_answer, why_answer

router = resource_router("events")

EXAMPLE = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"
BODY: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            JSON: {
                "schema": schema_of(EventIn),
                "example": {
                    "event": "dyknow:HighSpeedEvent",
                    "arguments": ["?o", "dyknow:UAV", "100"],
                    "strategy": "fast",
                },
            },
            TEXT: text_schema("a request as text", EXAMPLE),
        },
    }
}


@router.post(
    "/events",
    status_code=201,
    openapi_extra=BODY,
    responses=responses(404, 410, 413, 415, 422),
)
async def request_event(
    request: Request,
    response: Response,
    service: Context,
    strategy: Annotated[Strategy, Query(description="for a request as text")] = "fast",
    since: Annotated[Since, Query(description=f"for a request as text: {BEGINNING}")] = "now",
) -> EventModel:
    """Request an event: the service finds or builds the streams that it needs.

    Equal requests share one stream. ``position`` is the id of the last sample before this request:
    follow the stream with it as ``since``. 404: no such event; 410: the streams no longer have all
    samples from ``since`` on; 422: there is no plan, and ``missing`` lists what one would need.
    """
    kind = content_type(request, (JSON, TEXT))
    body = (await request.body()).removeprefix(BOM_UTF8)
    engine = service.engine
    # Without a content type the body may be either; JSON begins with a brace.
    if kind == TEXT or not ("content-type" in request.headers or body.lstrip().startswith(b"{")):
        command = RequestEvent(utf8(body), strategy=strategy, since=since)
    else:
        wanted = await json_value(body, EventIn)
        command = RequestEvent(
            None, wanted.event, tuple(wanted.arguments), wanted.strategy, wanted.since
        )
    view = await service.do(command)
    response.headers["Location"] = f"/events/{view.id}"
    return EventModel.of(view, engine.epoch)


@router.get("/events", response_model=list[EventModel])
async def list_events(service: Context) -> Response:
    """List the running requests, then the waiting ones of earlier runs (``state``)."""
    engine = service.engine
    waiting = [
        EventModel.waiting(each) for each in service.commands.deferred_by_name(REQUEST).values()
    ]
    return await listed(
        engine.event_ids(), lambda id: EventModel.of(engine.event(id), engine.epoch), waiting
    )


@router.get("/events/{id}", responses=responses(404))
async def read_event(id: str, service: Context) -> EventModel:
    """Return one request, with its plan if it runs."""
    if (waiting := service.commands.deferred_by_name(REQUEST).get(id)) is not None:
        return EventModel.waiting(waiting)
    return EventModel.of(service.engine.event(id), service.engine.epoch)


@router.get(
    "/events/{id}/why",
    response_model=WhyModel | MatchesWhyModel,
    responses=TABLE | responses(404, 406, 410),
)
async def explain_event(
    id: str, request: Request, service: Context, start: Start, object: Objects = None
) -> Response:
    """Explain one verdict or the matches of a requested event whose template is a formula or a
    pattern, as `GET /queries/{name}/why` does for a registered one. As JSON, or a table for
    ``Accept: text/plain``.

    400: the template is a query. 404: no such request, no state at this time, or no match; 410:
    the streams no longer have the samples.
    """
    engine = service.engine
    stream = engine.event(id).stream
    return await why_answer(request, service, engine.event_why, id, stream, object or [], start)


@router.get(
    "/events/{id}/partial",
    response_model=PartialMatchesModel,
    responses=TABLE | responses(404, 406),
)
async def list_partial_events(
    id: str,
    request: Request,
    service: Context,
    object: ObjectsOfMatch = None,
    limit: Limit = 20,
) -> Response:
    """List the partial matches of a requested event whose template is a pattern, as
    `GET /queries/{name}/partial` does for a registered one."""
    return partial_answer(request, id, service.engine.event_partial(id, object or [], limit))


@router.delete("/events/{id}", status_code=204, responses=responses(404))
async def cancel_event(id: str, service: Context) -> Response:
    """Cancel a request. A unit stops with its last user."""
    await service.do(CancelEvent(id))
    service.feeds.review()
    return Response(status_code=204)
