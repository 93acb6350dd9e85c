"""The recent HTTP requests."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query

from ...config.logs import mask
from ...config.recent_requests import KEPT
from ...http.routers import resource_router
from ...models import HttpRequestModel
from ...runtime.context import Context

router = resource_router("status")


@router.get("/requests")
async def list_http_requests(
    service: Context,
    status: Annotated[
        int, Query(ge=100, le=599, description="only those with this status or a greater one")
    ] = 100,
    limit: Annotated[int, Query(ge=1, le=KEPT, description="requests at most")] = 200,
) -> list[HttpRequestModel]:
    """Return the newest answered HTTP requests, newest first; the service keeps a thousand.

    `GET /requests?status=400` has the refused ones, each with the type of its problem. Requests
    without an end yet, such as followers, are not in it. `GET /events` lists requests for events.
    """
    return [
        HttpRequestModel(
            time=each.time.isoformat(),
            id=each.id,
            method=each.method,
            path=mask(each.path),
            route=each.route or None,
            status=each.status,
            milliseconds=round(each.seconds * 1000, 1),
            size=each.size,
            problem=each.problem,
        )
        for each in service.recent_requests.newest(status, limit)
    ]
