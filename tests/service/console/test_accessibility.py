"""axe-core finds nothing on any page of the console, in both themes."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest
from axe import violations
from chromium import Page

OPEN = Callable[..., Page]
PAGES = {
    "live": "High speed event",
    "graph/adsb": "stream adsb contains",
    "ask": "What would answer",
    "query": "Which streams are there",
    "query/continuous": "Explain before you register",
    "system": "Samples a second",
}
"""The pages, and a text that each has when it is drawn."""
BROKEN = "document.body.append(document.createElement('img'), document.createElement('input'))"


@pytest.mark.parametrize(("theme", "width"), [("light", 1400), ("dark", 390)])
def test_axe_finds_nothing(flying: str, open_page: OPEN, theme: str, width: int) -> None:
    page = open_page(f"{flying}/#live", theme=theme, width=width)
    wrong = {}
    for name, text in PAGES.items():
        page.run(f"location.hash = {json.dumps(name)}")
        page.wait_text(text)
        if found := violations(page):
            wrong[name] = found
    assert wrong == {}


def test_axe_finds_what_is_wrong(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#live")
    page.wait_text(PAGES["live"])
    page.run(BROKEN)
    found = {each.partition(":")[0] for each in violations(page)}
    assert {"image-alt", "label"} <= found
