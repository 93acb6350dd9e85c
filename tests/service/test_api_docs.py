"""docs/api.md, the routes and the OpenAPI schema say the same."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from fastapi import FastAPI

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.cli import app as commands
from dyknow.service.settings import Settings

DOCS = Path(__file__).parents[2] / "docs" / "api.md"
UNLISTED = {("GET", "/"), ("GET", "/static/{name}")}
"""Parts of the documentation page."""


@pytest.fixture(scope="module")
def app() -> FastAPI:
    return create_app(Engine(epoch="e1"), Settings(), lambda: 0)


def operations(app: FastAPI) -> dict[tuple[str, str], dict[str, Any]]:
    return {
        (method.upper(), path): operation
        for path, methods in app.openapi()["paths"].items()
        for method, operation in methods.items()
    }


def test_every_route_is_on_the_page_and_the_other_way_round(app: FastAPI) -> None:
    written = set(re.findall(r"^\| `([A-Z]+) (/[^`]*)` \|", DOCS.read_text(), re.MULTILINE))
    served = set(operations(app)) | {("GET", "/openapi.json"), ("GET", "/docs")}
    assert written == served - UNLISTED


def test_every_operation_is_described(app: FastAPI) -> None:
    for route, operation in operations(app).items():
        assert operation.get("description"), route
        assert operation.get("tags"), route
        assert any(status.startswith("2") for status in operation["responses"]), route
        for status, response in operation["responses"].items():
            if status >= "4" and route[1] != "/readyz":
                assert "application/problem+json" in response["content"], (route, status)


def test_bodies_are_described(app: FastAPI) -> None:
    for (method, path), operation in operations(app).items():
        takes = method in ("POST", "PUT") and not path.endswith("/end")
        assert ("requestBody" in operation) == takes, (method, path)


def test_no_reference_points_nowhere(app: FastAPI) -> None:
    schema = app.openapi()
    names = set(schema["components"]["schemas"])
    wanted = set(re.findall(r"#/components/schemas/(\w+)", str(schema)))
    assert wanted <= names
    assert "HTTPValidationError" not in names


def test_every_setting_is_on_the_page() -> None:
    written = set(re.findall(r"^\| `DYKNOW_([A-Z_]+)` \|", DOCS.read_text(), re.MULTILINE))
    assert written == {name.upper() for name in Settings.model_fields}


def test_every_command_is_on_the_page() -> None:
    text = DOCS.read_text()
    names = {command.name or command.callback.__name__ for command in commands.registered_commands}
    names |= {str(group.name) for group in commands.registered_groups}
    for name in names:
        assert f"| `dyknow {name}" in text, name
