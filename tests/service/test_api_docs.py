"""docs/reference/http.md, the routes and the OpenAPI schema say the same."""

from __future__ import annotations

import re
import shutil
import subprocess
from typing import Any

import pytest
from fastapi import FastAPI
from places import ROOT
from waiting import HANGS

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.cli.main import COMMANDS
from dyknow.service.config.settings import Settings

DOCS = ROOT / "docs" / "reference" / "http.md"
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


def test_every_route_is_on_the_page_and_the_other_way_round(app: FastAPI) -> None:
    written = set(re.findall(r"^\| `([A-Z]+) (/[^`]*)` \|", DOCS.read_text(), re.MULTILINE))
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


def test_every_setting_is_on_the_page() -> None:
    written = set(re.findall(r"^\| `DYKNOW_([A-Z_]+)` \|", DOCS.read_text(), re.MULTILINE))
    assert written == {name.upper() for name in Settings.model_fields}


def test_every_command_is_on_the_page() -> None:
    text = DOCS.read_text()
    for name in COMMANDS:
        assert f"| `dyknow {name}" in text, name


@pytest.mark.skipif(shutil.which("curl") is None, reason="there is no curl")
def test_the_commands_on_the_page_run_from_top_to_bottom(url: str) -> None:
    page = DOCS.read_text()
    blocks = re.findall(r"^```sh\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    script = "".join(blocks).replace("http://127.0.0.1:8000", url)
    checked = 'set -euo pipefail\ncurl() { command curl -sS --fail-with-body "$@"; }\n'
    done = subprocess.run(
        ["bash", "-c", checked + script],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=HANGS,
    )
    assert done.returncode == 0, (done.stdout, done.stderr)
    # The last block shows the event, which the sample of the first makes.
    assert "event: sample" in done.stdout.rpartition("event: end")[0].rpartition('"plan"')[2]
