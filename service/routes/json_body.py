"""Routes whose bodies are JSON: here, and nowhere else, the framework has them read."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from fastapi import Request, Response
from fastapi.routing import APIRoute

from ..http.negotiation import read_json


class _JsonRequest(Request):
    async def json(self) -> Any:
        return await read_json(await self.body())


class JsonRoute(APIRoute):
    """A route that refuses a body in which a member stands twice."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        usual = super().get_route_handler()

        async def handle(request: Request) -> Response:
            return await usual(_JsonRequest(request.scope, request.receive))

        return handle
