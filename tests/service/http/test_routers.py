"""What all routes have in common."""

from __future__ import annotations

import pytest
from fastapi import FastAPI
from fastapi.routing import APIRoute

from dyknow.engine.engine import Engine
from dyknow.service.app import RESOURCES, create_app
from dyknow.service.config.settings import Settings

ROUTES = [
    route
    for resource in RESOURCES
    for route in resource.router.routes
    if isinstance(route, APIRoute)
]


@pytest.mark.parametrize("route", ROUTES, ids=lambda route: f"{min(route.methods)} {route.path}")
def test_each_route_tells_the_common_problems_and_takes_bodies_without_a_type(
    route: APIRoute,
) -> None:
    assert {400, 401, 403, 421, 429, 503} <= route.responses.keys()
    assert route.strict_content_type is False


def test_an_application_has_the_routes_themselves() -> None:
    app: FastAPI = create_app(Engine(epoch="e1"), Settings(), lambda: 0)
    assert len(ROUTES) > 50
    assert set(map(id, ROUTES)) <= set(map(id, app.routes))
