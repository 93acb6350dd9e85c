"""Streams as server-sent events: one stream, or several on one connection."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response

from ...engine.requests.adaptive_subscription import Rematch
from ..config.media_types import EVENT_STREAM
from ..http.problems import responses
from ..runtime.context import Context, Service
from ..sse.feeds import event_stream
from ..sse.multi_stream import MOST_STREAMS, follow_many
from .fast_route import direct

EVENTS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "server-sent events: sample, gap, end",
        "content": {EVENT_STREAM: {"schema": {"type": "string"}}},
    }
}

SINCE = (
    "`start` of the history, a time, a duration before the newest sample (`30s`), or the id of a "
    "sample"
)


async def _follow_directly(request: Request) -> Response | None:
    name = request.path_params.get("name")
    if name is None:
        return None
    since = request.query_params.get("since")
    return await follow(request.app.state.service, request, name, since)


router = APIRouter(tags=["streams"], route_class=direct(_follow_directly))


@router.get("/streams/{name}/events", responses={**EVENTS, **responses(404, 406, 410, 429, 503)})
async def follow_stream(
    name: str,
    request: Request,
    service: Context,
    since: str | None = Query(None, description=SINCE),
) -> Response:
    """Send the stream's samples as server-sent events, from now on.

    A client that resumes sends ``Last-Event-ID``; ``since`` begins elsewhere. Messages: `sample`,
    `gap` (samples that the stream no longer has), `end` (the stream has ended or was removed; the
    response ends with it).
    """
    return await follow(service, request, name, since)


async def follow(
    service: Service,
    request: Request,
    name: str,
    since: str | None,
    switches: Sequence[Rematch] | None = None,
) -> Response:
    """Return the event stream of ``name``; ``switches`` as in `event_stream`."""
    key = service.client_key(request)
    response = event_stream(service.feeds, request, key, name, since, switches)
    # The response names its start, which must be durable: a client may resume from it after a
    # restart.
    await service.commands.try_commit()
    return response


@router.get("/follow", responses={**EVENTS, **responses(404, 406, 410, 422, 429, 503)})
async def follow_streams(
    request: Request,
    service: Context,
    stream: Annotated[
        list[str],
        Query(min_length=1, max_length=MOST_STREAMS, description="a stream's name; repeat it"),
    ],
    since: str | None = Query(None, description=SINCE),
) -> Response:
    """Send the samples of several streams as server-sent events, on one connection.

    Messages are those of `/streams/{name}/events`; `data.stream` names the stream. An `id` is
    opaque: sent as `Last-Event-ID` with the same streams, it resumes all of them. `end` concerns
    one stream; the response ends with the last of them.
    """
    key = service.client_key(request)
    response = follow_many(service.feeds, request, key, stream, since)
    await service.commands.try_commit()
    return response
