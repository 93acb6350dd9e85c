"""Routes that are asked so often that what the framework does for each request counts."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute


def direct(answer: Callable[[Request], Awaitable[Response | None]]) -> type[APIRoute]:
    """Routes whose requests ``answer`` answers itself: the framework's dependencies, validation and
    models take as long as a small batch (docs/explanation/design/0005-arrival-to-event.md). Where
    it gives None, the framework is asked, which refuses what is to be refused.
    """

    class Direct(APIRoute):
        def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
            usual = super().get_route_handler()

            async def handle(request: Request) -> Response:
                found = await answer(request)
                return await usual(request) if found is None else found

            return handle

    return Direct
