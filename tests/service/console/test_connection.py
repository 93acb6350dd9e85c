"""The console while the service stops, starts anew, requires tokens, or sends much."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import httpx
import pytest
from asking import asking
from chromium import Browser, Page
from pydantic import SecretStr
from waiting import until

from dyknow.engine.engine import Engine
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.runtime.warm_up import WarmUp
from dyknow.service.server import running
from dyknow.service.turns.window_turns import WindowTurns

OPEN = Callable[..., Page]
READ, ADMIN = "read-0123456789-0123456789", "admin-0123456789-0123456789"
LINES = {"Content-Type": "application/x-ndjson"}


@contextmanager
def service(port: int = 0, epoch: str = "e1", tokens: str = "") -> Iterator[str]:
    settings = Settings(port=port, sse_ping=0, tokens=SecretStr(tokens))
    engine = Engine(epoch=epoch, turns=WindowTurns(5, 60))
    with running(create_app(engine, settings, time.time_ns), settings) as url:
        yield url


def declare(http: httpx.Client) -> None:
    """A stream of numbers, and a subscription to it."""
    fields = {"fields": {"id": "string", "v": "integer"}, "retention": 1_000_000}
    assert http.put("/streams/numbers", json=fields).status_code == 201
    assert http.post("/subscriptions", json={"stream": "numbers"}).status_code == 201


def publish(http: httpx.Client, first: int, count: int) -> None:
    now = time.time_ns()
    lines = (
        json.dumps({"valid": now + i, "id": f"o{i % 20}", "v": i})
        for i in range(first, first + count)
    )
    answer = http.post("/streams/numbers/samples", content="\n".join(lines), headers=LINES)
    assert answer.status_code == 202, answer.text


class CuttingProxy:
    """Passes bytes on to a port, and can cut all connections for a while."""

    def __init__(self, port: int) -> None:
        self._port = port
        self._sockets: list[socket.socket] = []
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.port = self._listening.getsockname()[1]
        self.is_cut = False
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listening.accept()
            except OSError:
                return
            if self.is_cut:
                client.close()
                continue
            try:
                server = socket.create_connection(("127.0.0.1", self._port))
            except OSError:  # the service has ended before its page
                client.close()
                continue
            self._sockets += [client, server]
            for one, other in ((client, server), (server, client)):
                threading.Thread(target=self._pass, args=(one, other), daemon=True).start()

    def _pass(self, one: socket.socket, other: socket.socket) -> None:
        try:
            while data := one.recv(1 << 16):
                other.sendall(data)
        except OSError:
            return
        finally:
            other.close()

    def cut(self) -> None:
        self.is_cut = True
        for each in self._sockets:
            # Closing alone would not wake the thread that reads from it.
            try:
                each.shutdown(socket.SHUT_RDWR)
            except OSError:
                continue
        self._sockets.clear()

    def close(self) -> None:
        self.cut()
        self._listening.close()


OPEN_FEED = "import('/console/feed.js').then((m) => m.following.value.includes('numbers'))"
FEED_STATE = "import('/console/feed.js').then((m) => m.feedState.value)"
ALL_ENDED = """import('/console/state.js').then(({ streams }) =>
  streams.value.every((each) => each.ended || each.name === 'status'))"""
SEEN = """(async () => { const { shown } = await import('/console/feed.js');
  return shown.value.events.filter((each) => !each.gap).map((each) => each.values.v); })()"""


def test_a_cut_connection_loses_no_sample(open_page: OPEN) -> None:
    with service() as url, asking(url) as http:
        declare(http)
        proxy = CuttingProxy(int(url.rpartition(":")[2]))
        # The browser's requests name the proxy's port, as those of a page behind a proxy do.
        page = open_page(f"http://127.0.0.1:{proxy.port}/#live")
        page.wait(OPEN_FEED)
        publish(http, 0, 100)
        page.wait(f"{SEEN}.then((each) => each.length === 100)")
        proxy.cut()
        page.wait_text("waiting")
        publish(http, 100, 300)
        proxy.is_cut = False
        page.wait(f"{SEEN}.then((each) => each.length >= 400)")
        publish(http, 400, 50)
        page.wait(f"{SEEN}.then((each) => each.length >= 450)")
        assert page.run(SEEN) == list(range(450))
        proxy.close()


TRACKS = """(async () => { const { shown } = await import('/console/feed.js');
  const of = ([id, track]) => [id, track.points.length, track.values.n];
  return [...shown.value.tracks].map(of).sort(); })()"""


def test_of_positions_the_newest_of_each_object_comes(open_page: OPEN) -> None:
    """A request for the same stream then brings all of its samples."""
    with service() as url, asking(url) as http:
        fields = {"id": "string", "lat": "float", "lon": "float", "n": "integer"}
        assert http.put("/streams/flights", json={"fields": fields}).status_code == 201
        ssl = "stream flights contains latitude(UAV) = lat, longitude(UAV) = lon for every UAV = id"
        assert http.post("/annotations", content=ssl).status_code == 201
        page = open_page(f"{url}/#live")
        page.wait(OPEN_FEED.replace("numbers", "flights"))

        def move(first: int) -> None:
            now = time.time_ns()
            lines = [
                {"valid": now + i, "id": f"o{i % 2}", "lat": 58.0, "lon": 15.0, "n": first + i}
                for i in range(200)
            ]
            body = "\n".join(map(json.dumps, lines))
            assert http.post("/streams/flights/samples", content=body, headers=LINES).is_success

        move(0)
        page.wait(f"{TRACKS}.then((each) => each.length === 2 && each[1][2] === 199)")
        assert page.run(TRACKS) == [["o0", 1, 198], ["o1", 1, 199]]
        assert http.post("/subscriptions", json={"stream": "flights"}).status_code == 201
        # A page looks for requests when the stream space changes.
        assert http.put("/streams/others", json={"fields": {"v": "integer"}}).status_code == 201
        page.wait("import('/console/state.js').then((m) => m.requests.value.length === 1)")
        page.wait(OPEN_FEED.replace("numbers", "flights"))
        move(200)
        page.wait(f"{TRACKS}.then((each) => each[1][2] === 399)")
        assert [count for _, count, _ in page.run(TRACKS)] == [101, 101]


HOLD_FOLLOWING = """window.own = window.own ?? window.fetch; window.asked = 0; window.go = false;
window.fetch = async (path, ...rest) => {
  if (String(path).includes('/follow')) {
    window.asked += 1;
    while (!window.go) await new Promise((done) => setTimeout(done, 20));
  }
  return window.own(path, ...rest);
}; true"""


def test_samples_come_while_other_streams_begin_to_be_followed(open_page: OPEN) -> None:
    with service() as url, asking(url) as http:
        page = open_page(f"{url}/#live")
        page.wait_text("streams")
        page.run(HOLD_FOLLOWING)
        declare(http)
        page.wait("window.asked === 1")
        publish(http, 0, 10)
        page.run("window.go = true")
        page.wait(f"{SEEN}.then((each) => each.length === 10)")
        page.run(HOLD_FOLLOWING)
        assert http.put("/streams/others", json={"fields": {"v": "integer"}}).status_code == 201
        assert http.post("/subscriptions", json={"stream": "others"}).status_code == 201
        page.wait("window.asked === 1")
        publish(http, 10, 10)
        page.run("window.go = true")
        page.wait(f"{SEEN}.then((each) => each.length === 20)")
        publish(http, 20, 10)
        page.wait(f"{SEEN}.then((each) => each.length === 30)")
        assert page.run(SEEN) == list(range(30))


@pytest.mark.parametrize("is_late", [False, True])
def test_a_service_that_begins_anew_is_followed_with_a_gap(open_page: OPEN, is_late: bool) -> None:
    """Also where the page learns first that its streams are not there yet (``is_late``)."""
    with service() as url, asking(url) as http:
        port = int(url.rpartition(":")[2])
        declare(http)
        page = open_page(f"{url}/#live")
        page.wait(OPEN_FEED)
        publish(http, 0, 10)
        page.wait(f"{SEEN}.then((each) => each.length === 10)")
        page.run("import('/console/pages/system.js').then(() => true)")
    page.wait_text("waiting")
    page.run("location.hash = 'system'")
    page.wait_text("No connection")
    page.wait("document.title.startsWith('(1) ')")
    with (
        service(port, "e2") as url,
        asking(url) as http,
    ):
        if is_late:
            page.wait("import('/console/state.js').then((m) => m.streams.value.length === 1)")
        declare(http)
        page.wait_text("Nothing is wrong")
        page.run("location.hash = 'live'")
        page.wait("document.querySelector('.line.gap') !== null")
        until = time.monotonic() + 60
        while page.run(SEEN)[-1] < 1_000:
            assert time.monotonic() < until
            publish(http, 1_000, 5)
            time.sleep(0.2)


FOLLOWED = """window.own = window.fetch; window.asked = 0;
window.fetch = (path, ...rest) => {
  if (String(path).includes('/follow')) window.asked += 1;
  return window.own(path, ...rest);
}; true"""


def test_streams_that_ended_are_no_lost_connection(open_page: OPEN) -> None:
    with service() as url, asking(url) as http:
        declare(http)
        assert http.put("/streams/others", json={"fields": {"v": "integer"}}).status_code == 201
        assert http.post("/subscriptions", json={"stream": "others"}).status_code == 201
        page = open_page(f"{url}/#live")
        page.wait(OPEN_FEED)
        publish(http, 0, 10)
        page.wait(f"{SEEN}.then((each) => each.length === 10)")
        page.run(FOLLOWED)
        assert http.post("/streams/others/end").is_success
        publish(http, 10, 10)  # one has ended, and the other goes on
        page.wait(f"{SEEN}.then((each) => each.length === 20)")
        assert page.run(FEED_STATE) == "open"
        assert http.post("/streams/numbers/end").is_success
        page.wait(f"{FEED_STATE}.then((each) => each === 'ended')")
        page.wait_text("ended")
        page.wait(ALL_ENDED)
        # Looks at the streams from before their end may have asked again; now it is known.
        asked = page.run("window.asked")
        time.sleep(2)
        assert page.run("window.asked") == asked
        assert "reconnecting" not in page.run("document.body.innerText")
        publish(http, 20, 10)  # it goes on
        page.wait(f"{SEEN}.then((each) => each.length === 30)")
        assert page.run(SEEN) == list(range(30))
        assert page.run(FEED_STATE) == "open"


def test_a_start_is_no_problem(open_page: OPEN) -> None:
    settings, go_on = Settings(port=0, sse_ping=0), threading.Event()
    app = create_app(Engine(epoch="e1", turns=WindowTurns(5, 60)), settings, time.time_ns)
    app.state.service.warming = WarmUp()
    app.state.service.warming.begin("loops", "being compiled", lambda: go_on.wait(60) and None)
    with running(app, settings) as url:
        page = open_page(f"{url}/#system")
        page.wait("document.querySelector('[role=status] a')?.innerText === 'starting'")
        page.wait_text("loops: being compiled")
        page.wait_text("Nothing is wrong")
        assert page.run("document.querySelector('.badge')") is None
        go_on.set()
        page.wait_text("connected")
        page.wait("!document.body.innerText.includes('being compiled')")


HELD = """window.own = window.fetch;
window.fetch = async (path, ...rest) => {
  while (!window.go) await new Promise((done) => setTimeout(done, 20));
  return window.own(path, ...rest);
};"""


def test_a_page_does_not_say_what_it_does_not_know_yet(browser: Browser) -> None:
    with service() as url:
        page = browser.page()
        page.call("Page.addScriptToEvaluateOnNewDocument", source=HELD)
        for name, text in (("live", "No requests run"), ("graph", "No streams yet")):
            page.open("about:blank")
            page.open(f"{url}/#{name}")
            page.wait_text("connecting")
            page.wait("document.querySelector('main section') !== null")
            shown = page.run("document.body.innerText")
            assert text not in shown
            assert "No stream has positions" not in shown
            page.run("window.go = true")
            page.wait_text(text)
        page.close()


def test_a_token_is_asked_for_and_decides_what_is_offered(open_page: OPEN) -> None:
    with service(tokens=f"read r {READ};admin a {ADMIN}") as url:
        page = open_page(f"{url}/#ask")
        page.wait_text("This service requires a token")
        page.choose("#token", "wrong")
        page.click("button.main", "Log in")
        page.wait("document.querySelector('.note.bad') !== null")
        page.choose("#token", READ)
        page.click("button.main", "Log in")
        page.wait_text("What would answer")
        page.wait_text("connected")
        page.wait_text("Your token may read only")
        starts = "[...document.querySelectorAll('button')].some((e) => e.innerText === 'Start')"
        assert not page.run(starts)
        page.click("button", "Log out")
        page.wait_text("This service requires a token")
        page.choose("#token", ADMIN)
        page.click("button.main", "Log in")
        page.wait(starts)


@pytest.mark.parametrize("rate", [10_000])
def test_many_events_a_second_leave_the_page_smooth(open_page: OPEN, rate: int) -> None:
    with service() as url, asking(url) as http:
        declare(http)
        page = open_page(f"{url}/#live")
        page.wait(OPEN_FEED)
        stopped = threading.Event()

        def send() -> None:
            for i in range(60):
                if stopped.wait(0.1):
                    return
                publish(http, i * rate // 10, rate // 10)

        sender = threading.Thread(target=send)
        sender.start()
        frames = page.run(
            """new Promise((done) => { const begun = performance.now(); let frames = 0;
              const step = () => { frames++;
                if (performance.now() - begun < 4000) requestAnimationFrame(step);
                else done(frames / 4); };
              requestAnimationFrame(step); })"""
        )
        # On a busy machine the page may ask for the newest only, before all have come.
        page.wait(
            "import('/console/feed.js')"
            f".then((m) => m.arrivals.value.total > {rate} || m.isThinned.value)"
        )
        page.wait("document.querySelectorAll('.line').length > 10")
        assert page.run("document.querySelectorAll('.line').length") <= 60
        stopped.set()
        sender.join()
        assert frames > 1  # 60 on an idle machine; beside others it is as slow as they make it


SLOW_CLOCK = """(() => { const own = performance.now.bind(performance); let ahead = 0;
  performance.now = () => own() + (ahead += 100); })()"""
"""A page for which each look at the clock takes 100 ms longer: it seems to read slowly."""


def test_a_page_that_reads_too_slowly_asks_for_the_newest_of_each_object(browser: Browser) -> None:
    with service() as url, asking(url) as http:
        declare(http)
        page = browser.page()
        page.call("Page.addScriptToEvaluateOnNewDocument", source=SLOW_CLOCK)
        page.open(f"{url}/#live")
        page.wait(OPEN_FEED)
        sent = 0

        def is_thinned() -> bool:
            nonlocal sent
            publish(http, sent, 40)
            sent += 40
            return page.run("document.body.innerText.includes('newest only')")

        until(is_thinned)

        def comes_thinned() -> bool:
            """What comes before the new connection has begun is read from what is kept, in full."""
            nonlocal sent
            first, sent = sent, sent + 400
            publish(http, first, 400)
            page.wait(f"{SEEN}.then((seen) => seen.includes({sent - 1}))")
            # The stream has no annotation: of it comes the newest sample, whatever its object.
            return [each for each in page.run(SEEN) if each >= first] == [sent - 1]

        until(comes_thinned)
        seen = page.run(SEEN)
        assert seen == sorted(set(seen))
        page.close()
