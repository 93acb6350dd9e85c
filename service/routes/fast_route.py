"""A route class for frequent requests, for which the framework's own work is too slow."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute


def direct(answer: Callable[[Request], Awaitable[Response | None]]) -> type[APIRoute]:
    """Return a route class that lets ``answer`` handle the request first.

    The framework's dependencies, validation and models take as long as a small batch
    (docs/explanation/design/0005-arrival-to-event.md). If ``answer`` returns None, the framework
    handles the request, mostly to refuse it with its usual error.
    """

    class Direct(APIRoute):
        def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
            framework = super().get_route_handler()

            async def handle(request: Request) -> Response:
                response = await answer(request)
                return await framework(request) if response is None else response

            return handle

    return Direct
