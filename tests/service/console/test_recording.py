"""The console after a recording has been played: verdicts and matches in words, what has ended."""

from __future__ import annotations

import time
from collections.abc import Callable

import httpx
import pytest
from axe import violations
from cars import BEGIN, SECOND, TEXT, declare, opened, play, publish
from chromium import Page

from dyknow.service.client.client import Client

OPEN = Callable[..., Page]
MONITOR = "monitor slow(?x in Car) = speed(?x) < 100 with sample every 1s, max delay 0s"
MOOD = """@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix o: <http://www.dyknow.eu/ontology#> .
dyknow:mood a o:UnaryFeature ."""
SAD = "monitor sad(?x in Car) = mood(?x) < 3"
"""The feature has no range, so only a sample shows that it is no number."""


@pytest.fixture
def asked(service: httpx.Client) -> httpx.Client:
    """A formula and a pattern are requested, and a monitor is registered."""
    declare(service)
    for text in ("dyknow:Calm(?x, 100)", "dyknow:Faster(100)"):
        assert service.post("/events", content=text, headers=TEXT).status_code == 201
    assert service.post("/queries", content=MONITOR, headers=TEXT).status_code == 201
    return service


@pytest.fixture
def recorded(asked: httpx.Client) -> httpx.Client:
    play(asked)
    return asked


def answer(http: httpx.Client, event: str) -> str:
    """The stream that answers the request of a template."""
    found = http.get("/events").json()
    stream: str = next(each["stream"] for each in found if each["event"].endswith(event))
    return stream


FIRST = "document.querySelector('.line')?.innerText ?? ''"


def test_a_verdict_says_that_the_rule_is_broken_and_when(
    recorded: httpx.Client, open_page: OPEN
) -> None:
    page = opened(open_page, recorded, f"live/{answer(recorded, 'Calm')}")
    page.wait(f"({FIRST}).includes('violated')")
    rows = page.run("[...document.querySelectorAll('.line')].map((each) => each.innerText)")
    assert len(rows) == 3
    for word in ("no_unit", "verdict", "false", "decided", "2026"):
        assert not any(word in row for row in rows)
    assert [" at " in row for row in rows] == [False, True, True]  # the witness comes later
    page.wait(
        "document.querySelector('.ask-row[aria-pressed=true]').innerText.includes('violated at')"
    )


def test_a_decision_after_the_witness_is_said(service: httpx.Client, open_page: OPEN) -> None:
    declare(service)
    rule = "monitor m(?x in Car) = speed(?x) > 100 -> eventually [0s, 2s] speed(?x) < 60"
    text = f"{rule} with sample every 1s, max delay 0s"
    assert service.post("/queries", content=text, headers=TEXT).status_code == 201
    play(service)
    page = opened(open_page, service, "live/m")
    page.wait(f"({FIRST}).includes('violated decided ')")
    row = page.run(FIRST).split()
    assert row[0].endswith(":02")
    assert row[-1].endswith(":04")


def test_a_match_says_from_when_to_when(recorded: httpx.Client, open_page: OPEN) -> None:
    page = opened(open_page, recorded, f"live/{answer(recorded, 'Faster')}")
    page.wait(f"({FIRST}).includes('matched from')")
    row = page.run(FIRST)
    assert "c1" in row
    assert "reached 120" in row
    assert " to " not in row  # the row's own time
    listed = "document.querySelector('.ask-row[aria-pressed=true]').innerText"
    page.wait(f"({listed}).includes(' to ')")
    assert "2026" not in row


def test_events_of_formulas_and_patterns_are_explained(
    recorded: httpx.Client, open_page: OPEN
) -> None:
    page = opened(open_page, recorded, f"live/{answer(recorded, 'Calm')}")
    page.click(".line button.chip", "why?")
    page.wait("document.querySelector('dialog.why tbody') !== null")
    shown = page.run("document.querySelector('dialog.why').innerText")
    assert "c1: violated" in shown
    assert "event1" in shown
    page.click("dialog.why button", "Close")
    page.run(f"location.hash = 'live/{answer(recorded, 'Faster')}'")
    page.wait(f"({FIRST}).includes('matched')")
    page.click(".line button.chip", "why?")
    page.wait("document.querySelectorAll('dialog.why tbody tr').length === 2")
    shown = page.run("document.querySelector('dialog.why').innerText")
    assert "1 match" in shown
    assert "v 120" in shown
    assert page.complaints == []


def test_what_has_ended_looks_ended(recorded: httpx.Client, open_page: OPEN) -> None:
    page = opened(open_page, recorded, "live")
    page.wait_text("0 requests, 3 ended")
    page.wait_text("0.0/s in")
    page.wait_text("0.0/s out")
    groups = "[...document.querySelectorAll('.asks section')].map((each) => each.ariaLabel)"
    page.wait(f"({groups}).length === 1")
    assert page.run(groups) == ["ended requests"]
    requests = page.run("document.querySelector('.asks').innerText")
    assert "/s" not in requests
    page.run("location.hash = 'system'")
    rates = """[...document.querySelectorAll('[aria-label=streams] tbody tr')]
      .filter((each) => !each.innerText.startsWith('status'))
      .map((each) => each.children[2].innerText)"""
    page.wait(f"({rates}).length === 4")
    assert set(page.run(rates)) == {"ended"}


def test_what_failed_is_listed_and_counted_apart(asked: httpx.Client, open_page: OPEN) -> None:
    with Client(str(asked.base_url)) as client:
        client.load_ontology(MOOD, "http://example.org/mood")
    assert asked.put("/streams/moods", json={"fields": {"id": "string", "m": "string"}}).is_success
    ssl = "stream moods contains mood(Car) = m for every Car = id"
    assert asked.post("/annotations", content=ssl, headers=TEXT).status_code == 201
    assert asked.post("/queries", content=SAD, headers=TEXT).status_code == 201
    page = opened(open_page, asked, "live")
    page.wait_text("4 requests")
    play(asked)
    page.wait_text("1 request, 3 ended")
    publish(asked, "moods", {"valid": BEGIN, "available": BEGIN, "id": "c1", "m": "fine"})
    page.wait_text("1 failed")
    page.wait("document.querySelector('[aria-label=\"failed requests\"] .dot.bad') !== null")
    listed = "document.querySelectorAll('[aria-label=\"failed requests\"] .ask-row').length"
    assert page.run(listed) == 1


def test_the_top_bar_is_one_line(recorded: httpx.Client, open_page: OPEN) -> None:
    for width in (1400, 1151, 1000, 800, 721):
        page = opened(open_page, recorded, "live", width=width)
        page.wait_text("0 requests, 3 ended")
        spans = "[...document.querySelectorAll('.counts span')]"
        assert page.run(f"Math.max(...{spans}.map((each) => each.offsetHeight))") < 24, width
        assert page.run("document.documentElement.scrollWidth") <= width
        assert page.run("document.querySelector('.top').scrollWidth") <= width


def test_a_sample_of_the_future_is_said_to_be_one(service: httpx.Client, open_page: OPEN) -> None:
    fields = {"fields": {"id": "string", "v": "float"}, "ahead": "oo"}
    assert service.put("/streams/early", json=fields).is_success
    at = time.time_ns() + 14_430 * SECOND
    publish(service, "early", {"valid": at, "available": at, "id": "c1", "v": 1.0})
    page = opened(open_page, service, "graph/early")
    page.wait_text("in 4.0 h")
    page.run("location.hash = 'system'")
    page.wait_text("in 4.0 h")
    assert "0 ms" not in page.run("document.querySelector('[aria-label=streams]').innerText")


def test_a_plot_names_its_lines(recorded: httpx.Client, open_page: OPEN) -> None:
    page = opened(open_page, recorded, "graph/cars")
    page.wait("document.querySelector('.smallplot canvas') !== null")
    label = "document.querySelector('.smallplot .plotbox').ariaLabel"
    page.wait(f"({label}).includes('c1') && ({label}).includes('c2')")
    box = page.run(
        """(() => { const box = document.querySelector('.smallplot .u-over');
          box.scrollIntoView(); const { x, y, width, height } = box.getBoundingClientRect();
          return [x + width / 2, y + height * 0.1]; })()"""
    )
    page.call("Input.dispatchMouseEvent", type="mouseMoved", x=box[0], y=box[1])
    page.wait("document.querySelector('.pointed')?.innerText.startsWith('c1 120 at ')")


def test_a_service_without_positions_has_a_line_for_the_map(
    recorded: httpx.Client, open_page: OPEN
) -> None:
    page = opened(open_page, recorded, "live")
    page.wait_text("No stream has positions")
    assert page.run("document.querySelector('.map').offsetHeight") < 60
    page.click(".map summary")
    page.wait_text("latitude(Car)")
    page.click("button", "Playback")
    page.wait("document.querySelector('.map input[type=range]') !== null")
    assert page.complaints == []


@pytest.mark.parametrize(("theme", "width"), [("light", 1400), ("dark", 390)])
def test_axe_finds_nothing_after_a_recording(
    recorded: httpx.Client, open_page: OPEN, theme: str, width: int
) -> None:
    page = opened(open_page, recorded, "live", theme=theme, width=width)
    page.wait_text("ended")
    page.wait(f"({FIRST}).includes('violated')")
    page.click(".map summary")
    assert violations(page) == []
    assert page.run("document.documentElement.scrollWidth") <= width
    page.click(".line button.chip", "why?")
    page.wait("document.querySelector('dialog.why tbody') !== null")
    assert violations(page) == []
    page.click("dialog.why button", "Close")
    page.run("location.hash = 'graph/cars'")
    page.wait("document.querySelector('.smallplot canvas') !== null")
    assert violations(page) == []


def test_an_empty_page_proposes_what_works(service: httpx.Client, open_page: OPEN) -> None:
    page = opened(open_page, service, "live")
    page.wait_text("dyknow template add --library high_speed")
    assert not page.run("document.body.innerText.includes('See the ')")
    declare(service)
    page.wait_text("dyknow events 'dyknow:")
    command = page.run("document.querySelector('.asks code').innerText")
    event = command.removeprefix("dyknow events '").removesuffix("' --since start --keep")
    assert service.post("/events", content=event, headers=TEXT).status_code == 201


def test_samples_that_nothing_asks_for_are_linked(service: httpx.Client, open_page: OPEN) -> None:
    declare(service)
    page = opened(open_page, service, "live")
    page.wait_text("No requests run.")
    play(service)
    page.click(".asks a", "See the ")
    page.wait("location.hash.startsWith('#graph/')")


LONG = """monitor calm(?x in Car) = not historically [0s, 80s] speed(?x) > 20 [km.h-1]
with sample every 1s, max delay 0s"""
SEEN = """(() => { const [box, part, start] = ['.whytable', 'th', 'th.accent']
    .map((each) => document.querySelector(`dialog.why ${each}`).getBoundingClientRect());
  return box.left <= part.left && part.right <= start.left && start.right <= box.right + 1; })()"""


def test_why_begins_at_the_start_of_the_verdict_after_a_long_past(
    service: httpx.Client, open_page: OPEN
) -> None:
    declare(service)
    assert service.post("/queries", content=LONG, headers=TEXT).status_code == 201
    times = (BEGIN + second * SECOND for second in range(100))
    publish(service, "cars", *({"valid": at, "available": at, "id": "c1", "v": 30} for at in times))
    assert service.post("/streams/cars/end").is_success
    page = opened(open_page, service, "live/calm")
    page.click(".line button.chip", "why?")
    page.wait_text("60 of 81 states, around the start")
    page.wait(SEEN)
