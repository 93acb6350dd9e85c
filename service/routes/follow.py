"""Several streams as server-sent events on one connection."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from ..context import Context
from ..following import MOST_STREAMS, follow_many
from ..problems import responses
from .streams import EVENTS

router = APIRouter(tags=["streams"])


@router.get("/follow", responses={**EVENTS, **responses(404, 406, 422, 429, 503)})
async def follow_streams(
    request: Request,
    service: Context,
    stream: Annotated[
        list[str],
        Query(min_length=1, max_length=MOST_STREAMS, description="a stream's name; repeat it"),
    ],
    since: str | None = Query(None, description="`start` of what is kept, or the id of a sample"),
) -> Response:
    """The samples of several streams as server-sent events, on one connection.

    Messages are those of `/streams/{name}/events`, of which `data.stream` tells the stream. An `id`
    is opaque: with it as `Last-Event-ID`, and the same streams, all of them go on where they were.
    `end` is of one stream; the answer ends with the last of them.
    """
    key = service.client_key(request)
    answer = follow_many(service.feeds, request, key, stream, since)
    await service.keeper.settled()
    return answer
