"""Events on demand ([Events14 §V.B]): request, list, read, give up."""

from __future__ import annotations

from codecs import BOM_UTF8
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from ...engine.durability.accepted_commands import REQUEST
from ...engine.durability.commands import CancelEvent, RequestEvent
from ..config.media_types import JSON, TEXT
from ..http.json_lists import listed
from ..http.negotiation import content_type, json_value, utf8
from ..http.problems import responses
from ..models import (
    BEGINNING,
    EventIn,
    EventModel,
    Since,
    Strategy,
    schema_of,
    text_schema,
)
from ..runtime.context import Context

router = APIRouter(tags=["events"])

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
    """Request an event: the streams it needs are found or built.

    The same request twice shares one stream; ``position`` is the id of its last sample before
    this request, to follow with ``since=``. 404: no such event; 410: the streams have forgotten
    some of what ``since`` asks for; 422: no plan, ``missing`` says what would be needed.
    """
    kind = content_type(request, (JSON, TEXT))
    body = (await request.body()).removeprefix(BOM_UTF8)
    engine = service.engine
    # A body that came without a type may be either; JSON begins with a brace.
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
    """The requests that run, then those of an earlier run that wait (``state``)."""
    engine = service.engine
    waiting = [
        EventModel.waiting(each) for each in service.commands.deferred_by_name(REQUEST).values()
    ]
    return await listed(
        engine.event_ids(), lambda id: EventModel.of(engine.event(id), engine.epoch), waiting
    )


@router.get("/events/{id}", responses=responses(404))
async def read_event(id: str, service: Context) -> EventModel:
    """One request, with its plan if it runs."""
    if (waiting := service.commands.deferred_by_name(REQUEST).get(id)) is not None:
        return EventModel.waiting(waiting)
    return EventModel.of(service.engine.event(id), service.engine.epoch)


@router.delete("/events/{id}", status_code=204, responses=responses(404))
async def cancel_event(id: str, service: Context) -> Response:
    """Give a request up. A unit stops with its last user."""
    await service.do(CancelEvent(id))
    service.feeds.review()
    return Response(status_code=204)
