"""The pages on the service's interfaces say what the program does: routes, settings, commands."""

from __future__ import annotations

import importlib.util
import re
import shutil
from typing import Any

import pytest
from fastapi import FastAPI
from places import ROOT
from serving import shell

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.cli.main import COMMANDS
from dyknow.service.client.client import Client
from dyknow.service.config.settings import Settings

REFERENCE = ROOT / "docs" / "reference"
HTTP = REFERENCE / "http.md"
SCRIPT = ROOT / "docs" / "http_reference.py"
HIDDEN = {("GET", "/openapi.json"), ("GET", "/docs"), ("GET", "/")}
"""Served, and not in the schema."""


@pytest.fixture(scope="module")
def app() -> FastAPI:
    return create_app(Engine(epoch="e1"), Settings(), lambda: 0)


def operations(app: FastAPI) -> dict[tuple[str, str], dict[str, Any]]:
    return {
        (method.upper(), path): operation
        for path, methods in app.openapi()["paths"].items()
        for method, operation in methods.items()
    }


def test_the_page_of_the_routes_is_current() -> None:
    spec = importlib.util.spec_from_file_location("http_reference", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    assert HTTP.read_text() == script.render(), "run .venv/bin/python docs/http_reference.py"


def test_every_route_is_on_the_page_and_the_other_way_round(app: FastAPI) -> None:
    written = set(re.findall(r"^\| `([A-Z]+) (/[^`]*)` \|", HTTP.read_text(), re.MULTILINE))
    assert written == set(operations(app)) | HIDDEN


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
        takes = method in ("POST", "PUT", "PATCH") and not path.endswith("/end")
        assert ("requestBody" in operation) == takes, (method, path)


def test_no_reference_points_nowhere(app: FastAPI) -> None:
    schema = app.openapi()
    names = set(schema["components"]["schemas"])
    wanted = set(re.findall(r"#/components/schemas/(\w+)", str(schema)))
    assert wanted <= names
    assert "HTTPValidationError" not in names


def test_every_setting_is_on_its_page() -> None:
    page = (REFERENCE / "settings.md").read_text()
    written = set(re.findall(r"^\| `DYKNOW_([A-Z_]+)` \|", page, re.MULTILINE))
    assert written == {name.upper() for name in Settings.model_fields}


def test_every_command_is_on_its_page() -> None:
    text = (REFERENCE / "command-line.md").read_text()
    for name in COMMANDS:
        assert f"| `dyknow {name}" in text, name


def test_every_method_of_the_client_is_on_its_page() -> None:
    text = (REFERENCE / "python-client.md").read_text()
    written = set(re.findall(r"`(\w+)\([^`]*\)`", text))
    assert written - {"Client"} == {name for name in dir(Client) if not name.startswith("_")}


@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl")
def test_the_commands_on_the_page_run_from_top_to_bottom(url: str) -> None:
    page = HTTP.read_text()
    blocks = re.findall(r"^```sh\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    told = shell("".join(blocks), ROOT, url)
    # The last block shows the event, which the sample of the first makes.
    assert "event: sample" in told.rpartition("event: end")[0].rpartition('"plan"')[2]
