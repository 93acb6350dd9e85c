"""Every page of the console in a browser: it shows what it should, and complains of nothing."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

import httpx
import pytest
from asking import asking
from chromium import Browser, Page
from waiting import until

from dyknow.engine.durability.durable_engine import RecordedEngine
from dyknow.journal.durability import Durability
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running

OPEN = Callable[..., Page]
PAGES = ("live", "graph", "graph/adsb", "ask", "query", "query/continuous", "system")
SHOWS = {
    "live": "High speed event",
    "graph": "coordinatesToSpeed",
    "graph/adsb": "stream adsb contains",
    "ask": "What would answer",
    "query": "Which streams are there",
    "query/continuous": "Explain before you register",
    "system": "Samples a second",
}
UNNAMED = """[...document.querySelectorAll('button, a, input, select, svg[role], canvas')]
  .filter((each) => each.offsetParent !== null || each instanceof SVGElement)
  .filter((each) => !each.closest('[role=img]') || each.getAttribute('role'))
  .filter((each) => !(each.getAttribute('aria-label') || each.textContent.trim()
    || each.labels?.length || each.title || each.getAttribute('aria-hidden')))
  .map((each) => each.outerHTML.slice(0, 200))"""
"""Elements without a name for people who do not see them."""


@pytest.mark.parametrize(("theme", "width"), [("light", 1400), ("dark", 390)])
def test_no_page_complains_or_asks_outside_or_scrolls_sideways(
    flying: str, open_page: OPEN, theme: str, width: int
) -> None:
    page = open_page(f"{flying}/#live", theme=theme, width=width)
    for name in PAGES:
        page.run(f"location.hash = {json.dumps(name)}")
        page.wait_text(SHOWS[name])
        page.wait("document.fonts.ready.then(() => true)")
        assert page.run("document.documentElement.scrollWidth") <= width, name
        assert page.run("document.documentElement.dataset.theme") == theme
        assert page.run(UNNAMED) == [], name
    assert page.complaints == []
    outside = [each for each in page.requested if not each.startswith((flying, "data:"))]
    assert outside == []


def test_live_shows_requests_events_a_map_and_a_plot(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#live")
    page.wait("document.querySelectorAll('.ask-row').length >= 1", 30)
    page.wait("document.querySelectorAll('.line .who').length >= 1", 30)
    page.wait("document.querySelector('.plot canvas') !== null", 30)
    drawn = """(() => { const c = document.querySelector('.map canvas');
      return c && c.width && c.getContext('2d').getImageData(0, 0, c.width, c.height)
        .data.some((each) => each > 0); })()"""
    page.wait(drawn)
    page.click(".line .who")
    page.wait("document.querySelector('.feed .chip.on') !== null")
    assert page.run("document.querySelectorAll('.line:not(.on)').length") == 0


def test_hold_stops_the_feed_and_going_on_shows_the_newest(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#live")
    first = "document.querySelector('.line')?.innerText"
    page.wait(first)
    page.run("document.activeElement.blur()")
    page.press("p")
    page.wait_text("held, +")
    held = page.run(first)
    page.wait("Number(document.querySelector('.feed header .accent').innerText.split('+')[1]) > 3")
    assert page.run(first) == held
    page.press("p")
    page.wait(f"{first} !== {json.dumps(held)}")


def test_leaving_the_newest_event_holds_and_returning_goes_on(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#live")
    page.wait("document.querySelector('.feed .scroll')?.scrollHeight > 1200")
    page.run("document.querySelector('.feed .scroll').scrollTop = 300")
    page.wait_text("held, +")
    assert page.run("document.querySelectorAll('.line').length") <= 60
    page.run("document.querySelector('.feed .scroll').scrollTop = 0")
    page.wait("!document.body.innerText.includes('held, +')")


def test_playback_shows_how_it_was(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#live")
    page.wait("document.querySelector('.line') !== null")
    page.click("button", "Playback")
    page.wait("document.querySelector('.playback input[type=range]') !== null")
    played = "document.querySelector('.playback time').innerText"
    newest = "document.querySelector('.line time')?.innerText ?? ''"
    page.wait(f"({newest}) <= {played}")
    page.click("button", "Now")
    page.wait(f"!document.querySelector('.playback') && ({newest}) > '00'")


def test_ask_shows_the_plan_starts_and_ends_a_request(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#ask")
    page.choose("#p-threshold", "777")
    page.wait("document.querySelector('.tree .step.chosen') !== null")
    page.wait_text("HighSpeedEvent(any, Aircraft, 777)")
    page.choose("#p-type", "Human")
    page.wait_text("Nothing answers this yet")
    page.wait("[...document.querySelectorAll('.step')].some((e) => e.innerText.includes('failed'))")
    assert page.run("document.querySelector('button.main').disabled")
    page.choose("#p-type", "Aircraft")
    page.wait("document.querySelector('button.main').disabled === false")
    page.click("button", "Try it on what is kept")
    page.wait_text("It would have fired ")
    asked = len(httpx.get(f"{flying}/events", timeout=60).json())
    page.click("button.main", "Start")
    page.wait_text("It runs as ")
    requests = httpx.get(f"{flying}/events", timeout=60).json()
    assert len(requests) == asked + 1
    assert requests[-1]["arguments"] == ["?o", "dyknow:Aircraft", "777"]
    page.run(f"location.hash = 'live/{requests[-1]['stream']}'")
    page.click("button.danger", "End it")
    page.wait_text("has ended")
    assert len(httpx.get(f"{flying}/events", timeout=60).json()) == asked
    page.click(".toast button", "Undo")
    page.wait("document.querySelector('.toast') === null")
    page.wait_text("777")
    (again,) = [
        each
        for each in httpx.get(f"{flying}/events", timeout=60).json()
        if "777" in each["arguments"]
    ]
    httpx.delete(f"{flying}/events/{again['id']}", timeout=60)


def test_the_graph_has_each_stream_and_its_chain(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#graph")
    names = {each["name"] for each in httpx.get(f"{flying}/streams", timeout=60).json()} - {
        "status"
    }
    shown = "[...document.querySelectorAll('.node')].map((each) => each.dataset.id)"
    page.wait(f"({shown}).length === {len(names)}")
    assert set(page.run(shown)) == names
    page.run("document.querySelector('[data-id=adsb]').focus()")
    page.press("Enter")
    page.wait("location.hash === '#graph/adsb'")
    units = httpx.get(f"{flying}/units", timeout=60).json()
    page.wait_text("feeds")
    details = page.run("document.querySelector('aside').innerText")
    for unit in units:
        assert unit["output"] in details
    page.press("ArrowRight")
    page.wait("location.hash !== '#graph/adsb' && location.hash.startsWith('#graph/')")
    page.press("ArrowLeft")
    page.wait("location.hash === '#graph/adsb'")


MANY_STREAMS = """(() => { const own = window.fetch;
  window.fetch = async (path, ...rest) => {
    const answer = await own(path, ...rest);
    if (path !== '/streams') return answer;
    const [first, ...others] = await answer.json();
    const copies = Array.from({length: 3200}, (_, i) => ({...first, name: `copy${i}`}));
    return new Response(JSON.stringify([first, ...others, ...copies]),
      {headers: {'content-type': 'application/json'}});
  }; })()"""
"""A page to which the service seems to have 3,200 streams more."""
DRAWN = """(() => { const net = document.querySelector('canvas.net');
  const { left, top } = net.getBoundingClientRect();
  const { data } = net.getContext('2d').getImageData(0, 0, net.width, net.height);
  const pixel = data.findIndex((value, i) => i % 4 === 3 && value === 255) >> 2;
  const [x, y] = [pixel % net.width, Math.floor(pixel / net.width)];
  return pixel < 0 ? [] : [left + x / devicePixelRatio, top + y / devicePixelRatio]; })()"""
"""The place of a pixel that something covers, [] without one."""


def test_a_graph_of_thousands_is_a_shape_on_a_canvas(
    service: httpx.Client, browser: Browser
) -> None:
    assert service.put("/streams/gps", json={"fields": {"v": "float"}}).status_code == 201
    page = browser.page(width=1400, height=900)
    page.call("Page.addScriptToEvaluateOnNewDocument", source=MANY_STREAMS)
    page.open(f"{service.base_url}/#graph")
    page.wait("document.querySelector('canvas.net')?.ariaLabel.startsWith('3201 streams')")
    # A click on a box shows the chain of its stream.
    x, y = page.wait(f"{DRAWN}.length && {DRAWN}")
    for kind in ("mousePressed", "mouseReleased"):
        page.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)
    page.wait("document.querySelectorAll('svg.net .node').length === 1")
    page.wait("location.hash.startsWith('#graph/')")
    page.close()


EDITOR = "document.querySelector('.editor .text').editor"


def typed(page: Page, text: str) -> None:
    """Replace the editor's text."""
    page.wait(f"Boolean({EDITOR})")
    page.run(
        f"(() => {{ const view = {EDITOR}; view.dispatch({{changes: {{from: 0,"
        f" to: view.state.doc.length, insert: {json.dumps(text)}}}}}); }})()"
    )


def test_a_query_is_run_kept_in_the_address_and_marked_where_it_is_wrong(
    flying: str, open_page: OPEN
) -> None:
    page = open_page(f"{flying}/#query")
    page.wait_text("Which streams are there")
    page.click("button.main", "Run")
    page.wait("document.querySelectorAll('.result tbody tr').length >= 3")
    typed(page, "SELECT ?x {\n  ?x a :Stream\n")
    page.click("button.main", "Run")
    page.wait_text("is not closed")
    mark = "document.querySelector('.editor .text').shadowRoot.querySelector('.cm-lintRange-error')"
    page.wait(f"Boolean({mark})")
    question = 'SELECT ?name { ?s a :Stream ; :hasName ?name FILTER (?name = "adsb") }'
    page.open("about:blank")
    page.open(f"{flying}/#query/once/{quote(question, safe='')}")
    page.click("button.main", "Run")
    page.wait_text("1 row")
    page.click(".result tbody a", "adsb")
    page.wait("location.hash === '#graph/adsb'")


def test_parameters_of_a_query_are_fields_and_in_the_address(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#query")
    page.click("button.item", "Which streams have a feature")
    page.wait("document.querySelectorAll('.parameters input').length === 1")
    page.click("button.main", "Run")
    page.wait_text("dyknow:altitude")
    page.choose(".parameters input", "dyknow:speed")
    page.run("document.querySelector('.parameters input').focus()")
    page.press("Enter")
    cells = "[...document.querySelectorAll('.result td')].map((each) => each.textContent)"
    page.wait(f"!{cells}.includes('dyknow:altitude')")
    page.wait_text("dyknow:speed")
    page.wait("location.hash.startsWith('#query/once%3Ffeature%3Ddyknow%253Aspeed/SELECT')")
    address = page.run("location.href")
    # A dollar in a comment or a text is no parameter; a value that is no term is a text.
    typed(page, 'ASK { ?s :hasName $name FILTER(?name != "$no") } # $none')
    page.wait("document.querySelector('.parameters label').textContent.includes('$name')")
    assert page.run("document.querySelectorAll('.parameters input').length") == 1
    page.choose(".parameters input", 'ads"b')
    page.click("button.main", "Run")
    page.wait("document.querySelector('.result h3')?.textContent === 'No'")
    page.choose(".parameters input", "adsb")
    page.click("button.main", "Run")
    page.wait("document.querySelector('.result h3')?.textContent === 'Yes'")
    page.choose(".parameters input", "nope:name")
    page.click("button.main", "Run")
    page.wait_text("$name is no term")
    page.open("about:blank")
    page.open(address)
    page.wait("document.querySelector('.parameters input')?.value === 'dyknow:speed'")


def test_a_graph_is_drawn(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#query")
    page.click(".item", "as a graph")
    page.click("button.main", "Run")
    page.wait("document.querySelectorAll('.resultnet .node').length > 2")
    page.click("button", "triples")
    page.wait("document.querySelectorAll('.result tbody tr').length > 2")


def test_a_continuous_query_is_explained_registered_read_and_ended(
    flying: str, open_page: OPEN
) -> None:
    page = open_page(f"{flying}/#query/continuous")
    page.click("button", "Explain")
    page.wait_text("There is a plan")
    page.click("button.main", "Register")
    page.wait_text("Last window of highest")
    page.wait("document.querySelectorAll('.result tbody tr').length > 3")
    page.run(SAVED)
    page.click("section.result button", "CSV")
    page.wait("window.saved.length === 1")
    name, content = page.run("window.saved[0]")
    assert name == "highest.csv"
    assert content.splitlines()[0] == "o,top"
    assert len(content.splitlines()) > 4
    page.click("button.danger", "End it")
    page.wait("!document.body.innerText.includes('Last window of')")
    assert httpx.get(f"{flying}/queries", timeout=60).json() == []


SAVED = """window.saved = []; window.blob = null;
const own = URL.createObjectURL;
URL.createObjectURL = (blob) => { window.blob = blob; return own(blob); };
HTMLAnchorElement.prototype.click = function () {
  const name = this.download;
  window.blob.text().then((text) => window.saved.push([name, text]));
}; true"""
"""The page's downloads, in place of a folder."""


def test_what_was_ended_runs_again_as_it_was_asked_for(flying: str, open_page: OPEN) -> None:
    with asking(flying) as http:
        text = (
            "REGISTER QUERY tops COMPUTE EVERY 1s AS SELECT ?o (MAX(?a) AS ?top) "
            "WHERE { ?o dyknow:altitude ?a } GROUP BY ?o WINDOW [RANGE 2s STEP 1s]"
        )
        asked = {"semantics": "set", "bounds": "[)", "report": "change", "since": "start"}
        assert http.post("/queries", content=text, params=asked).status_code == 201
        want = {
            "feature": "dyknow:altitude",
            "sort": "dyknow:Aircraft",
            "policy": "sample every 2s",
            "staleness": "1h",
            "min_quality": 0.25,
            "since": "start",
        }
        assert http.post("/subscriptions", json=want).status_code == 201
        assert http.post("/subscriptions", json={"stream": "adsb"}).status_code == 201

        def running() -> dict[str, list[Any]]:
            queries = [(each["name"], each["options"]) for each in http.get("/queries").json()]
            parts = "feature", "sort", "objects", "strategy", "staleness", "min_quality", "hold_off"
            subscriptions = [
                (
                    each["policy"],
                    each["since"],
                    each["adaptive"] and [each["adaptive"][part] for part in parts],
                    each["adaptive"] is None and each["source"],
                )
                for each in http.get("/subscriptions").json()
            ]
            return {"/queries": queries, "/subscriptions": sorted(subscriptions, key=str)}

        before = running()
        addresses = ["/queries/tops"]
        addresses += [f"/subscriptions/{each['id']}" for each in http.get("/subscriptions").json()]
        page = open_page(f"{flying}/#live")
        for path in addresses:
            stream = http.get(path).json()["stream"]
            page.run(f"location.hash = 'live/{stream}'")
            page.click("button.danger", "End it")
            page.wait_text("has ended")
            assert http.get(path).status_code == 404
            page.click(".toast button", "Undo")
            until(lambda: running() == before)
        for kind, list_of in (("/queries", "name"), ("/subscriptions", "id")):
            for each in http.get(kind).json():
                assert http.delete(f"{kind}/{each[list_of]}").status_code == 204


def test_every_continuous_example_has_a_plan(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#query")
    examples = page.run("import('/console/pages/query.js').then((page) => page.CONTINUOUS)")
    assert len(examples) == 5
    for title, text in examples:
        answer = httpx.post(
            f"{flying}/explain",
            json={"query": text},
            headers={"Accept": "application/json"},
            timeout=60,
        )
        assert answer.status_code == 200, (title, answer.text)
        assert answer.json()["found"], title


def test_a_verdict_is_explained(flying: str, open_page: OPEN) -> None:
    text = "monitor high(?x in Aircraft) = altitude(?x) > 100000 [ft]"
    assert httpx.post(f"{flying}/queries", content=text, timeout=60).status_code == 201
    page = open_page(f"{flying}/#live/high")
    page.wait_text("high has no numbers to plot")
    page.click(".line button.chip", "why?")
    page.wait("document.querySelector('dialog.why tbody') !== null")
    shown = page.run("document.querySelector('dialog.why').innerText")
    assert ": violated" in shown
    assert "altitude" in shown
    page.click("dialog.why button", "Close")
    page.wait("document.querySelector('dialog.why') === null")
    assert httpx.delete(f"{flying}/queries/high", timeout=60).status_code == 204


def test_questions_name_streams_of_this_system(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#query")
    made = httpx.get(f"{flying}/events", timeout=60).json()[0]["stream"]
    page.wait_text("What breaks if adsb stops?")
    page.wait_text(f"What are the first origins of {made}?")
    assert not page.run("/\\b(gps|both)\\b/.test(document.querySelector('.list').innerText)")
    page.click(".item", "What breaks if adsb stops?")
    page.click("button.main", "Run")
    page.wait(f"document.querySelector('.result tbody')?.innerText.includes('{made}')")


def test_questions_about_streams_that_are_not_there_are_left_out(
    service: httpx.Client, open_page: OPEN
) -> None:
    page = open_page(f"{service.base_url}/#query")
    page.wait_text("Which streams are there")
    listed = page.run("document.querySelector('.list').innerText")
    assert "What breaks if" not in listed
    assert "undefined" not in listed


def test_every_question_of_the_list_is_right(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#query")
    page.wait_text("Which streams are there")
    asked: dict[str, Any] = page.run(
        """import('/console/questions.js').then(async ({ QUESTIONS }) => {
          const found = {};
          for (const [title, query] of QUESTIONS) {
            const answer = await fetch('/sparql', { method: 'POST', body: query.join(''),
              headers: { 'Content-Type': 'application/sparql-query',
                Accept: 'application/sparql-results+json, application/ld+json;q=0.9' } });
            found[title.join('')] = answer.status;
          }
          return found; })"""
    )
    assert len(asked) == 23
    assert set(asked.values()) == {200}, asked


def test_system_counts_a_silent_stream(flying: str, open_page: OPEN) -> None:
    page = open_page(f"{flying}/#system")
    page.wait_text("Nothing is wrong")
    with asking(flying) as http:
        ssl = "stream quiet contains speed(Car) = v for every Car = id"
        fields = {"fields": {"id": "string", "v": "float"}}
        assert http.put("/streams/quiet", json=fields).status_code == 201
        assert http.post("/annotations", content=ssl).status_code == 201
        event = "dyknow:HighSpeedEvent(?o, dyknow:Car, 1)"
        request = http.post("/events", content=event).json()["id"]
        lines = json.dumps({"valid": time.time_ns(), "id": "c1", "v": 2.5})
        kind = {"Content-Type": "application/x-ndjson"}
        assert http.post("/streams/quiet/samples", content=lines, headers=kind).status_code == 202
        page.wait_text("quiet is silent", 40)
        page.wait("document.title.startsWith('(1) ')")
        page.click(".problem a", "Look")
        page.wait("location.hash === '#graph/quiet'")
        page.wait("document.querySelector('.node.warn') !== null")
        http.delete(f"/events/{request}")
        assert http.delete("/streams/quiet").status_code == 204


def test_system_shows_refused_requests_and_the_data_directory(flying: str, open_page: OPEN) -> None:
    assert httpx.get(f"{flying}/streams/no_such_stream", timeout=60).status_code == 404
    page = open_page(f"{flying}/#system")
    page.wait_text("/streams/no_such_stream")
    page.wait_text("unknown stream")
    page.wait_text("All is in memory")


def test_system_shows_what_is_declared_in_kpl(service: httpx.Client, open_page: OPEN) -> None:
    page = open_page(f"{service.base_url}/#system")
    page.wait_text("HTTP interface")
    assert not page.run("document.body.innerText.includes('Declarations')")
    kpl = "source float baro\nstrmgen pressure = baro"
    text = {"Content-Type": "text/plain"}
    assert service.post("/kpl", content=kpl, headers=text).status_code == 201
    page.wait_text("strmgen pressure = baro")


def test_system_shows_what_the_data_directory_holds(tmp_path: Path, open_page: OPEN) -> None:
    settings = Settings(port=0, sse_ping=0)
    recorded = RecordedEngine(tmp_path / "data", now=0, durability=Durability.WRITE)
    with running(create_app(recorded, settings, time.time_ns), settings) as url:
        page = open_page(f"{url}/#system")
        page.wait_text("a start replays")
        shown = page.run("document.querySelector('[aria-label=\"data directory\"]').innerText")
    assert "in 1 file" in shown
    assert "none yet" in shown
