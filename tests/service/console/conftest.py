"""A service with flights, and a headless Chromium that looks at its console."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

import chromium
import httpx
import pytest
from asking import asking
from chromium import Browser, Page

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.cli.recordings.demonstration import flights
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.service.turns.window_turns import WindowTurns

FAST = "dyknow:HighSpeedEvent(?o, dyknow:Aircraft, 300)"


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    if chromium.PROGRAM is None:
        pytest.skip(chromium.MISSING)
    found = Browser(tmp_path_factory.mktemp("chromium"))
    yield found
    found.close()


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Opens a page of a size at an address, in a theme."""
    pages: list[Page] = []

    def page(url: str, *, theme: str = "light", width: int = 1400) -> Page:
        found = browser.page(width=width, height=900)
        source = f"localStorage.theme = '{theme}'"
        found.call("Page.addScriptToEvaluateOnNewDocument", source=source)
        found.open(url)
        found.wait("document.querySelector('.brand') !== null")
        pages.append(found)
        return found

    yield page
    for each in pages:
        each.close()


@pytest.fixture(scope="module")
def flying() -> Iterator[str]:
    """A service with recorded flights as of now, and a request for fast ones; its address."""
    engine = Engine(epoch="e1", turns=WindowTurns(5, 60))
    settings = Settings(port=0, sse_ping=0)
    stopped = threading.Event()
    with running(create_app(engine, settings, time.time_ns), settings) as url:
        player = threading.Thread(target=_fly, args=(url, stopped), daemon=True)
        player.start()
        until = time.monotonic() + 300
        while not _is_asked(url):
            assert time.monotonic() < until, "the flights do not begin"
            time.sleep(0.1)
        yield url
        stopped.set()
        player.join()


@pytest.fixture
def service() -> Iterator[httpx.Client]:
    """An empty service."""
    settings = Settings(port=0, sse_ping=0)
    engine = Engine(epoch="e1", turns=WindowTurns(5, 60))
    app = create_app(engine, settings, time.time_ns)
    with (
        running(app, settings) as url,
        asking(url) as http,
    ):
        yield http


def _fly(url: str, stopped: threading.Event) -> None:
    while not stopped.is_set():
        try:
            flights(url, stopped.is_set)
        except httpx.TransportError:
            # Where the machine is busy for seconds, the service takes a connection for an idle one.
            continue


def _is_asked(url: str) -> bool:
    try:
        return (
            httpx.post(f"{url}/events", content=FAST, trust_env=False, timeout=60).status_code
            == 201
        )
    except httpx.TransportError:
        return False
