"""The form of a template begins with the defaults of its parameters."""

from __future__ import annotations

from collections.abc import Callable

import httpx
from cars import TEXT, declare, opened
from chromium import Page

OPEN = Callable[..., Page]
STEADY = """REGISTER TEMPLATE dyknow:Steady(?x in Car = ?x, ?limit = 120.5) AS
speed(?x) < ?limit [km.h-1] with report violations"""
TWICE = """REGISTER TEMPLATE dyknow:Twice(?limit = 90, ?time = "5s") AS
PATTERN SEQ(speed a, speed b) WHERE [id] AND b.value > ?limit WITHIN ?time RETURN a.id AS id"""


def test_the_form_has_the_defaults_and_starts_with_them(
    service: httpx.Client, open_page: OPEN
) -> None:
    declare(service)
    for text in (STEADY, TWICE):
        assert service.post("/templates", content=text, headers=TEXT).status_code == 201
    page = opened(open_page, service, "ask")
    page.click(".card", "Twice")
    page.wait("document.querySelector('#p-limit')?.value === '90'")
    assert page.run("document.querySelector('#p-time').value") == "5s"
    assert "the default" in page.run("document.querySelector('[aria-label=form]').innerText")
    page.click(".card", "Steady")
    page.wait("document.querySelector('#p-limit')?.value === '120.5'")
    assert page.run("document.querySelector('#p-x').value") == ""
    page.wait_text("Steady(any, 120.5)")
    page.click("button.main", "Start")
    page.wait_text("It runs as ")
    (request,) = service.get("/events").json()
    assert request["arguments"] == ["?x", "120.5"]
    same = service.post("/events", content="dyknow:Steady()", headers=TEXT).json()
    assert same["stream"] == request["stream"]
    page.choose("#p-limit", "80")
    page.wait_text("default 120.5")
    page.click("button.main", "Start")
    page.wait_text("3 requests")
    assert [each["arguments"][1] for each in service.get("/events").json()][-1] == "80"
    assert page.complaints == []
