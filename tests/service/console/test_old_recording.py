"""A recording of 2019 on the page Live: playback and plot cover all that is kept of it."""

from __future__ import annotations

from collections.abc import Callable

import httpx
import pytest
from axe import violations
from cars import SECOND, SSL, TEXT, opened, publish
from chromium import Page

OPEN = Callable[..., Page]
BEGIN = 1_556_960_400 * SECOND
"""2019-05-04T09:00:00Z"""
SAMPLES, STEP = 240, 30
"""Two hours, a sample each half minute."""
MONITOR = "monitor slow(?x in Car) = speed(?x) < 100 with report verdicts"
SLIDER = "document.querySelector('.playback input[type=range]')"
HEADER = "(document.querySelector('.plot header')?.innerText ?? '')"
LABEL = "(document.querySelector('.plot .plotbox')?.ariaLabel ?? '')"


@pytest.fixture
def old(service: httpx.Client) -> httpx.Client:
    """A recorded stream, and a monitor that has read it."""
    assert service.put("/streams/cars", json={"fields": {"id": "string", "v": "float"}}).is_success
    assert service.post("/annotations", content=SSL, headers=TEXT).status_code == 201
    assert service.post("/queries", content=MONITOR, headers=TEXT).status_code == 201
    query = "REGISTER STREAM tops COMPUTE EVERY 30s AS CONSTRUCT { ?o dyknow:speed ?v }"
    query += " WHERE { ?o a dyknow:Car ; dyknow:speed ?v } WINDOW [RANGE 30s STEP 30s]"
    assert service.post("/queries", content=query, headers=TEXT).status_code == 201
    rows = []
    for number in range(SAMPLES):
        at = BEGIN + number * STEP * SECOND
        for name, speed in (("c1", 50.0 + number % 70), ("c2", 80.0)):
            rows.append({"valid": at, "available": at, "id": name, "v": speed})
    publish(service, "cars", *rows)
    assert service.post("/streams/cars/end").is_success
    return service


def test_the_slider_covers_what_is_kept(old: httpx.Client, open_page: OPEN) -> None:
    page = opened(open_page, old, "live/slow")
    page.wait("document.querySelector('.line') !== null")
    page.click("button", "Playback")
    page.wait(f"{SLIDER} !== null && Number({SLIDER}.min) < Number({SLIDER}.max)")
    first, last = (page.run(f"Number({SLIDER}.{name})") for name in ("min", "max"))
    end = BEGIN + (SAMPLES - 1) * STEP * SECOND
    assert first == BEGIN // 1_000_000
    assert last == end // 1_000_000
    middle = first + 3_600_000
    page.choose(".playback input[type=range]", str(middle))
    page.wait("document.querySelector('.playback time').innerText.startsWith('2019-05-04 ')")
    shown = f"new Date({middle}).toLocaleTimeString('en-GB', {{hour12: false}})"
    page.wait(f"document.querySelector('.line time')?.innerText === {shown}")
    # It plays on, and returns to the present after the newest sample.
    page.choose(".playback input[type=range]", str(last - 1_000))
    page.click("button[aria-label^=play]")
    page.wait("document.querySelector('.playback') === null")
    assert page.complaints == []


def test_the_plot_covers_what_is_kept(old: httpx.Client, open_page: OPEN) -> None:
    page = opened(open_page, old, "live/tops")
    page.wait("document.querySelector('.plot canvas') !== null")
    page.wait(f"({HEADER}).includes('2019-05-04 ')")
    until = f"new Date({(BEGIN + (SAMPLES - 1) * STEP * SECOND) // 1_000_000})"
    clock = f"{until}.toLocaleTimeString('en-GB', {{hour12: false}})"
    page.wait(f"({HEADER}).includes(' to ' + {clock})")
    page.wait(f"({LABEL}).includes('c1') && ({LABEL}).includes('c2')")
    drawn = """(() => { const c = document.querySelector('.plot canvas');
      const wide = Math.floor(c.width / 4), data = (x) =>
        [...c.getContext('2d').getImageData(x, 20, wide, c.height - 60).data];
      return [1, 2].map((part) => data(part * wide).some((each) => each > 0)); })()"""
    assert page.run(drawn) == [True, True]


def test_many_samples_are_plotted_as_intervals(old: httpx.Client, open_page: OPEN) -> None:
    page = opened(open_page, old, "live/tops")
    page.wait("import('/console/state.js').then(({ byName }) => byName.value.has('cars'))")
    lines = page.run(
        """(async () => { const { past } = await import('/console/feed.js');
          const { byName } = await import('/console/state.js');
          const stream = byName.value.get('cars');
          const all = await past(stream, 'v'), some = await past({ ...stream, kept: 1e6 }, 'v');
          return [all, some].map((found) => found.map(([name, points]) => [name, points.length]));
        })()"""
    )
    assert [sorted(each) for each in lines[:1]] == [[["c1", SAMPLES], ["c2", SAMPLES]]]
    assert {name for name, _ in lines[1]} == {"c1", "c2"}
    assert all(100 < number <= 301 for _, number in lines[1])


@pytest.mark.parametrize(("theme", "width"), [("light", 1000), ("dark", 390)])
def test_axe_finds_nothing(old: httpx.Client, open_page: OPEN, theme: str, width: int) -> None:
    page = opened(open_page, old, "live/tops", theme=theme, width=width)
    page.wait(f"({HEADER}).includes('2019-05-04 ')")
    page.click("button", "Playback")
    page.wait(f"{SLIDER} !== null")
    assert violations(page) == []
    # The slider and the line in place of the map do not cover each other.
    assert page.run("document.querySelector('.map summary').offsetHeight") < 40
    bottom, top = page.run(
        """[['.map summary', 'bottom'], ['.playback', 'top']].map(([name, side]) =>
          document.querySelector(name).getBoundingClientRect()[side])"""
    )
    assert width > 720 or bottom <= top
    assert page.run("document.documentElement.scrollWidth") <= width
