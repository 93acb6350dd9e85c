"""A service over the real engine, with a clock that tests move by hand."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from asking import asking
from typer.testing import CliRunner, Result

from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.engine.engine import Engine
from dyknow.journal.durability import Durability
from dyknow.service.app import create_app
from dyknow.service.cli import app
from dyknow.service.client.client import Client
from dyknow.service.config.logs import LOG_NAME
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.service.turns.window_turns import WindowTurns
from dyknow.streams.time import SECOND

START = 1_633_633_973 * SECOND
"""2021-10-07T19:12:53Z"""


class HandClock:
    """Time stands still until it is moved."""

    def __init__(self) -> None:
        self.now = START

    def __call__(self) -> int:
        return self.now


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


@pytest.fixture
def settings() -> Settings:
    return Settings(port=0, tick=0.02, sse_ping=0, body_limit=1 << 20, slow_request=60)


@pytest.fixture
def recorded(request: pytest.FixtureRequest, tmp_path: Path) -> RecordedEngine | None:
    """With ``--recorded`` (tests/conftest.py) every service has a data directory."""
    if not request.config.getoption("--recorded"):
        return None
    found = RecordedEngine(
        tmp_path / "data", now=0, durability=Durability.WRITE, turns=WindowTurns(5, 60)
    )
    found.engine.epoch = "e1"
    return found


@pytest.fixture
def engine(recorded: RecordedEngine | None) -> Engine:
    return Engine(epoch="e1", turns=WindowTurns(5, 60)) if recorded is None else recorded.engine


@pytest.fixture
def url(
    engine: Engine, recorded: RecordedEngine | None, settings: Settings, clock: HandClock
) -> Iterator[str]:
    """A live service in a thread, at a free port of this machine."""
    with running(create_app(recorded or engine, settings, clock), settings) as address:
        yield address


@pytest.fixture
def http(url: str) -> Iterator[httpx.Client]:
    """Plain HTTP, as a client written from the documentation would speak it."""
    with asking(url) as client:
        yield client


@pytest.fixture
def client(url: str) -> Iterator[Client]:
    with Client(url, timeout=120) as client:
        yield client


@pytest.fixture(autouse=True)
def logger() -> Iterator[logging.Logger]:
    """The service's logger, for tests that `configure` it; afterwards all that it changes is as it
    was."""
    all_of_them = [logging.getLogger(name) for name in (LOG_NAME, "uvicorn", None)]
    before = [(each.handlers[:], each.propagate, each.level) for each in all_of_them]
    hooks = sys.excepthook, threading.excepthook
    yield all_of_them[0]
    for each, (handlers, propagate, level) in zip(all_of_them, before, strict=True):
        each.handlers, each.propagate, each.level = handlers, propagate, level
    sys.excepthook, threading.excepthook = hooks
    logging.captureWarnings(False)


@pytest.fixture
def dyknow(url: str) -> Any:
    """Runs a command against the live service; asserts its status."""

    def run(*arguments: str, status: int = 0, **environment: str) -> Result:
        variables = {"DYKNOW_URL": url, **environment}
        result = CliRunner().invoke(app, list(arguments), env=variables)
        assert result.exit_code == status, (result.output, result.exception)
        return result

    return run
