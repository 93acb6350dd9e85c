"""A route class for JSON bodies that the framework reads; other routes read their bodies."""

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
    """A route that refuses a body with a repeated member, where JSON parsers differ."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        framework = super().get_route_handler()

        async def handle(request: Request) -> Response:
            return await framework(_JsonRequest(request.scope, request.receive))

        return handle
