"""The partial matches of patterns on the console's pages."""

from __future__ import annotations

from collections.abc import Callable

import httpx
import pytest
from axe import violations
from cars import BEGIN, SECOND, TEXT, declare, opened, publish
from chromium import Page

OPEN = Callable[..., Page]
CLIMBING = """REGISTER STREAM climbing AS PATTERN SEQ(speed a, speed b, speed c)
WHERE [id] AND a.v < b.v AND b.v < c.v WITHIN 10 seconds RETURN a.id AS id, c.v AS v"""
CLIMBS = """REGISTER TEMPLATE dyknow:Climbs(?limit) AS PATTERN SEQ(speed a, speed b)
WHERE [id] AND a.v < b.v AND b.v > ?limit WITHIN 500 milliseconds RETURN a.id AS id, b.v AS v"""
REPEATED = """REGISTER STREAM repeated AS PATTERN SEQ(speed a, speed+ b[])
WHERE [id] WITHIN 10 seconds RETURN a.id AS id LIMIT 2"""
ROWS = """[...document.querySelectorAll('dialog.partial tbody tr')]
  .map((each) => [...each.children].map((cell) => cell.innerText))"""
SHOWN = "(document.querySelector('dialog.partial')?.innerText ?? '')"
LOCAL = f"new Date({BEGIN // 1_000_000}).toLocaleTimeString('en-GB', {{hour12: false}})"


def drive(http: httpx.Client, second: int, name: str, speed: float) -> None:
    """A sample; the one before it is then read, as no other of its time comes."""
    at = BEGIN + second * SECOND
    publish(http, "cars", {"valid": at, "available": at, "id": name, "v": speed})


@pytest.fixture
def climbing(service: httpx.Client) -> httpx.Client:
    """A registered pattern of cars, of which none has come."""
    declare(service)
    assert service.post("/queries", content=CLIMBING, headers=TEXT).status_code == 201
    return service


def listed(page: Page, number: int) -> list[list[str]]:
    """The rows of the table, as soon as it has so many partial matches."""
    page.wait(f"document.querySelectorAll('dialog.partial tbody').length === {number}")
    rows: list[list[str]] = page.run(ROWS)
    return rows


def test_a_person_sees_what_has_come_and_when_the_rest_may(
    climbing: httpx.Client, open_page: OPEN
) -> None:
    page = opened(open_page, climbing, "live/climbing")
    page.click("button", "Partial matches")
    page.wait(f"{SHOWN}.includes('has read no sample yet')")
    drive(climbing, 0, "c1", 10.0)
    drive(climbing, 1, "c2", 50.0)
    hour = page.run(LOCAL).split(":")[0]
    came = f"{hour}:00:00"
    # The table follows what comes, without a click.
    rows = listed(page, 1)
    assert rows[0] == ["1: 1 event of 3"]
    assert rows[1] == ["a", came, "id c1, v 10"]
    assert [(row[0], row[2]) for row in rows[2:]] == [("b", "may come"), ("c", "may come")]
    assert rows[3][1] == f"{came} to {hour}:00:10"
    drive(climbing, 2, "c1", 20.0)
    drive(climbing, 3, "c4", 10.0)
    rows = listed(page, 4)
    assert rows[0] == ["1: 2 events of 3"]
    assert rows[3] == ["c", f"{hour}:00:02 to {hour}:00:10", "may come"]
    assert "No event before 2026-05-04 " in page.run(SHOWN)
    page.choose("dialog.partial input", "c2")
    rows = listed(page, 1)
    assert rows[1][2] == "id c2, v 50"
    page.choose("dialog.partial input", "c3")
    page.wait(f"{SHOWN}.includes('No partial match has c3')")
    page.choose("dialog.partial input", "")
    assert climbing.post("/streams/cars/end").is_success
    page.wait(f"{SHOWN}.includes('The streams of the pattern have ended')")
    assert "2262" not in page.run(SHOWN)
    page.click("dialog.partial button", "Close")
    page.wait("document.querySelector('dialog.partial') === null")
    assert page.complaints == []


def test_while_the_page_is_held_the_table_does_not_move(
    climbing: httpx.Client, open_page: OPEN
) -> None:
    drive(climbing, 0, "c1", 10.0)
    drive(climbing, 1, "c1", 20.0)
    page = opened(open_page, climbing, "live/climbing")
    page.click("button", "Partial matches")
    rows = listed(page, 1)
    page.run("document.activeElement.blur()")
    page.press("p")
    page.wait_text("held, +")
    drive(climbing, 2, "c2", 20.0)
    asked = len([each for each in page.requested if "/partial" in each])
    polled = len([each for each in page.requested if each.endswith("/status")])
    while len([each for each in page.requested if each.endswith("/status")]) < polled + 3:
        page.run("new Promise((done) => setTimeout(done, 100))")
    assert len([each for each in page.requested if "/partial" in each]) == asked
    assert page.run(ROWS) == rows
    page.press("p")
    listed(page, 3)


def test_a_requested_pattern_of_a_short_window_shows_milliseconds(
    service: httpx.Client, open_page: OPEN
) -> None:
    declare(service)
    assert service.post("/templates", content=CLIMBS, headers=TEXT).status_code == 201
    request = service.post("/events", content="dyknow:Climbs(100)", headers=TEXT).json()
    for at in (BEGIN + 200_000_000, BEGIN + 300_000_000):
        for name in ("c1", "c2"):
            publish(service, "cars", {"valid": at, "available": at, "id": name, "v": 20.0})
    page = opened(open_page, service, f"graph/{request['stream']}")
    page.click("aside button", "Partial matches")
    rows = listed(page, 2)
    assert rows[2][1].endswith(":00:00.700")
    assert "v" in rows[1][2]


def test_what_has_none_says_why(service: httpx.Client, open_page: OPEN) -> None:
    declare(service)
    assert service.post("/queries", content=REPEATED, headers=TEXT).status_code == 201
    monitor = "monitor slow(?x in Car) = speed(?x) < 100"
    assert service.post("/queries", content=monitor, headers=TEXT).status_code == 201
    page = opened(open_page, service, "live/slow")
    page.wait("document.querySelector('.asks footer') !== null")
    assert "Partial matches" not in page.run("document.querySelector('.asks footer').innerText")
    page.run("location.hash = 'live/repeated'")
    page.click("button", "Partial matches")
    page.wait(f"{SHOWN}.includes('exponentially many partial matches')")
    assert "skip_till_next_match" in page.run(SHOWN)


@pytest.mark.parametrize(("theme", "width"), [("light", 1400), ("dark", 1000), ("light", 390)])
def test_axe_finds_nothing(climbing: httpx.Client, open_page: OPEN, theme: str, width: int) -> None:
    drive(climbing, 0, "c1", 10.0)
    drive(climbing, 1, "c1", 20.0)
    page = opened(open_page, climbing, "live/climbing", theme=theme, width=width)
    page.click("button", "Partial matches")
    listed(page, 1)
    assert violations(page) == []
    assert page.run("document.documentElement.scrollWidth") <= width
