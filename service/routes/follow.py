"""Streams as server-sent events: one, or several on one connection."""

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
    "`start` of what is kept, a time, a duration before the newest sample (`30s`), or the id of a "
    "sample"
)


async def _followed(request: Request) -> Response | None:
    name = request.path_params.get("name")
    if name is None:
        return None
    since = request.query_params.get("since")
    return await follow(request.app.state.service, request, name, since)


router = APIRouter(tags=["streams"], route_class=direct(_followed))


@router.get("/streams/{name}/events", responses={**EVENTS, **responses(404, 406, 410, 429, 503)})
async def follow_stream(
    name: str,
    request: Request,
    service: Context,
    since: str | None = Query(None, description=SINCE),
) -> Response:
    """The stream's samples as server-sent events, from now on.

    After ``Last-Event-ID`` when a client resumes, or from ``since``. Messages: `sample`, `gap`
    (samples that are no longer kept), `end` (the stream has ended or was removed; the answer
    ends with it).
    """
    return await follow(service, request, name, since)


async def follow(
    service: Service,
    request: Request,
    name: str,
    since: str | None,
    switches: Sequence[Rematch] | None = None,
) -> Response:
    """The event stream of ``name``; ``switches`` as `event_stream` takes them."""
    key = service.client_key(request)
    answer = event_stream(service.feeds, request, key, name, since, switches)
    # It says where it begins, and that is to be so after a restart, too.
    await service.commands.try_commit()
    return answer


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
    """The samples of several streams as server-sent events, on one connection.

    Messages are those of `/streams/{name}/events`, of which `data.stream` tells the stream. An `id`
    is opaque: with it as `Last-Event-ID`, and the same streams, all of them go on where they were.
    `end` is of one stream; the answer ends with the last of them.
    """
    key = service.client_key(request)
    answer = follow_many(service.feeds, request, key, stream, since)
    await service.commands.try_commit()
    return answer
