"""Subscriptions to a feature over HTTP: what is asked, what is told of switches, and where."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from typing import Any

import httpx
import pytest
from asking import asking
from typer.testing import CliRunner

from dyknow.engine.engine import Engine
from dyknow.engine.requests.adaptive_subscription import Rematch
from dyknow.service.cli import app as commands
from dyknow.service.client.client import Client, Event
from dyknow.service.config.settings import Settings
from dyknow.service.sse.message_cache import BLOCK_SAMPLES
from dyknow.service.sse.switch_markers import SwitchMarkers
from dyknow.streams.time import SECOND

LINES = {"Content-Type": "application/x-ndjson"}
WANT = {"feature": "speed", "sort": "UAV"}
QUALITY = WANT | {"strategy": "quality", "hold_off": "0s"}


def annotate(http: httpx.Client, *names: str, feature: str = "speed") -> None:
    content = {"feature": feature, "field": "v", "of": [{"name": "UAV", "id": "id"}]}
    body = [{"stream": name, "contents": [content]} for name in names]
    answer = http.post("/annotations", json=body)
    assert answer.status_code == 201, answer.text


def publish(http: httpx.Client, stream: str, *seconds: int) -> None:
    body = "".join(
        json.dumps({"valid": t * SECOND, "available": t * SECOND, "id": "uav1", "v": float(t)})
        + "\n"
        for t in seconds
    )
    answer = http.post(f"/streams/{stream}/samples", content=body, headers=LINES)
    assert answer.status_code == 202, answer.text


def subscribe(http: httpx.Client, **wanted: Any) -> dict[str, Any]:
    answer = http.post("/subscriptions", json=wanted)
    assert answer.status_code == 201, answer.text
    found: dict[str, Any] = answer.json()
    return found


def quality(http: httpx.Client, stream: str, worth: float) -> None:
    answer = http.put(f"/streams/{stream}/quality", json={"quality": worth})
    assert answer.status_code == 204, answer.text


def told(event: Event) -> Any:
    """A number for a sample, what is read from then on for a switch."""
    if event.kind == "sample":
        return event.values["speed"]
    return event.data["after"] if event.kind == "rematched" else event.kind


def until(events: Iterator[Event], last: Any) -> list[Any]:
    """What is told up to ``last``."""
    found = []
    for event in events:
        found.append(told(event))
        if found[-1] == last:
            return found
    raise AssertionError(found)


# -- the places of switches --------------------------------------------------------------------


def switch(position: int, why: str = "") -> Rematch:
    return Rematch(0, position, why, (), ())


def test_each_switch_is_told_once_and_in_order() -> None:
    switches: list[Rematch] = [switch(0, "a"), switch(3, "b")]
    marks = SwitchMarkers(switches, 0)
    assert [each.why for each in marks.before(1)] == ["a"]
    assert marks.next == 3
    # Equal to another, and one more nevertheless.
    switches += [switch(3, "b"), switch(3, "c"), switch(7, "d")]
    assert list(marks.before(3)) == []
    assert [each.why for each in marks.before(4)] == ["b", "b", "c"]
    assert marks.next == 7
    assert [each.why for each in marks.before(99)] == ["d"]
    assert marks.next is None
    assert list(marks.before(99)) == []


def test_switches_before_the_beginning_are_past() -> None:
    marks = SwitchMarkers([switch(1, "a"), switch(2, "b"), switch(3, "c")], 2)
    assert [each.why for each in marks.before(10)] == ["b", "c"]


def test_switches_that_are_no_longer_kept_are_left_out() -> None:
    switches = [switch(1, "a")]
    marks = SwitchMarkers(switches, 0)
    assert marks.next == 1
    switches[:] = [switch(2, "c"), switch(3, "d")]
    assert [each.why for each in marks.before(10)] == ["a", "c", "d"]


# -- subscribing -------------------------------------------------------------------------------


def test_a_feature_is_subscribed_to(http: httpx.Client) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(
        http, **QUALITY, staleness="5s", min_quality=0.5, policy="max delay 2s", since="start"
    )
    assert view["events"] == f"/subscriptions/{view['id']}/events"
    assert view["adaptive"] == {
        "want": "dyknow:speed of every dyknow:UAV",
        "feature": "dyknow:speed",
        "sort": "dyknow:UAV",
        "objects": [],
        "strategy": "quality",
        "state": "running",
        "failure": None,
        "reads": ["s1"],
        "missing": [],
        "staleness": "5s",
        "min_quality": 0.5,
        "hold_off": "0ns",
        "rematches": 1,
    }
    assert view["policy"] == "max delay 2000"
    publish(http, "s1", 1)
    quality(http, "s1", 0.25)
    now = http.get(f"/subscriptions/{view['id']}").json()
    assert now["adaptive"]["reads"] == ["s2"]
    assert now["stream"] == view["stream"]
    first, second = http.get(f"/subscriptions/{view['id']}/rematches").json()
    assert (first["position"], first["before"], first["after"]) == (0, [], ["s1"])
    assert second == {
        "time": "2021-10-07T19:12:53Z",
        "position": 1,
        "why": "quality of s1 is 0.25",
        "before": ["s1"],
        "after": ["s2"],
        "lost": False,
    }
    # One to a stream has neither.
    plain = subscribe(http, stream="s1")
    assert plain["adaptive"] is None
    assert http.get(f"/subscriptions/{plain['id']}/rematches").json() == []
    assert [each["id"] for each in http.get("/subscriptions").json()] == [view["id"], plain["id"]]


def test_what_cannot_be_met_waits(http: httpx.Client) -> None:
    view = subscribe(http, **WANT)
    assert view["adaptive"]["state"] == "waiting"
    assert view["adaptive"]["missing"]
    annotate(http, "s1")
    publish(http, "s1", 1)
    now = http.get(f"/subscriptions/{view['id']}").json()["adaptive"]
    assert (now["state"], now["reads"], now["missing"]) == ("running", ["s1"], [])


@pytest.mark.parametrize(
    ("wanted", "status", "said"),
    [
        ({}, 400, "has neither"),
        (WANT | {"stream": "s1"}, 400, "has both"),
        ({"stream": "s1", "sort": "UAV"}, 400, "sort: only with a feature"),
        ({"stream": "s1", "staleness": "5s", "hold_off": "1s"}, 400, "hold_off, staleness"),
        ({"feature": "sped", "sort": "UAV"}, 404, "did you mean speed"),
        ({"feature": "speed", "sort": "UAW"}, 404, "UAV"),
        (WANT | {"strategy": "cheap"}, 400, "fast, cost, quality, weighted"),
        (WANT | {"staleness": "-1s"}, 422, "no duration"),
        (WANT | {"staleness": -1}, 422, "greater than or equal to 0"),
        (WANT | {"staleness": "0s"}, 400, "staleness must be greater than 0"),
        (WANT | {"hold_off": "soon"}, 422, "no duration"),
        (WANT | {"hold_off": 2**63}, 422, "less than"),
        (WANT | {"min_quality": 2}, 422, "less than or equal to 1"),
        (WANT | {"policy": "sample evry 1s"}, 400, "evry"),
        (WANT | {"objects": ["uav1"] * 17}, 422, "at most 16"),
        (WANT | {"quality": 1}, 422, "quality"),
    ],
)
def test_what_is_wrong(http: httpx.Client, wanted: Any, status: int, said: str) -> None:
    annotate(http, "s1")
    answer = http.post("/subscriptions", json=wanted)
    assert answer.status_code == status, answer.text
    assert said in answer.text
    if said.startswith("not"):
        assert "feature" in answer.json()["hint"]
    assert http.get("/subscriptions").json() == []
    assert [each["name"] for each in http.get("/streams").json()] == ["status", "s1"]


def test_no_number_is_no_quality(http: httpx.Client) -> None:
    body = b'{"feature": "speed", "min_quality": NaN}'
    answer = http.post("/subscriptions", content=body, headers={"Content-Type": "application/json"})
    assert answer.status_code == 422
    assert http.get("/subscriptions/nothing/rematches").status_code == 404


# -- events ------------------------------------------------------------------------------------


def test_a_switch_stands_between_the_samples(http: httpx.Client, client: Client) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(http, **QUALITY)
    publish(http, "s1", 1, 2)
    quality(http, "s1", 0.25)
    publish(http, "s2", 3, 4)
    events = client.subscription_events(view["id"], since="start")
    assert until(events, 4.0) == [["s1"], 1.0, 2.0, ["s2"], 3.0, 4.0]
    # The plain stream has the samples alone.
    plain = client.events(view["stream"], since="start")
    assert until(plain, 4.0) == [1.0, 2.0, 3.0, 4.0]


def test_the_message_has_the_documented_form(http: httpx.Client) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(http, **QUALITY)
    publish(http, "s1", 1)
    quality(http, "s1", 0.25)
    publish(http, "s2", 2)
    lines = []
    with http.stream("GET", f"{view['events']}?since=start") as answer:
        for line in answer.iter_lines():
            lines.append(line)
            if line == "id: e1-2":
                break
    place = lines.index("id: e1-1")
    rematched = lines[place + 4 : place + 7]
    assert rematched[0] == "event: rematched"
    assert json.loads(rematched[1].removeprefix("data: ")) == {
        "time": "2021-10-07T19:12:53Z",
        "position": 1,
        "why": "quality of s1 is 0.25",
        "before": ["s1"],
        "after": ["s2"],
        "lost": False,
    }
    assert rematched[2] == ""  # no id: Last-Event-ID stays a sample's


def test_switches_without_samples_wake_a_client(http: httpx.Client, client: Client) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(http, **QUALITY)
    publish(http, "s1", 1)
    events = client.subscription_events(view["id"], since="start")
    assert until(events, 1.0) == [["s1"], 1.0]
    quality(http, "s1", 0.5)
    assert told(next(events)) == ["s2"]
    quality(http, "s2", 0.25)
    assert told(next(events)) == ["s1"]
    publish(http, "s1", 2)
    assert told(next(events)) == 2.0


def test_two_switches_in_one_place_stand_in_order(http: httpx.Client, client: Client) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(http, **QUALITY)
    publish(http, "s1", 1)
    quality(http, "s1", 0.5)
    quality(http, "s2", 0.25)
    publish(http, "s1", 2)
    events = client.subscription_events(view["id"], since="start")
    assert until(events, 2.0) == [["s1"], 1.0, ["s2"], ["s1"], 2.0]


def test_one_that_resumes_is_told_of_the_switches_since(http: httpx.Client, client: Client) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(http, **QUALITY)
    publish(http, "s1", 1, 2)
    quality(http, "s1", 0.5)
    publish(http, "s2", 3, 4)
    quality(http, "s2", 0.25)

    def after(number: int, last: Any) -> list[Any]:
        return until(client.subscription_events(view["id"], since=f"e1-{number}"), last)

    assert after(1, ["s1"]) == [2.0, ["s2"], 3.0, 4.0, ["s1"]]
    assert after(2, ["s1"]) == [["s2"], 3.0, 4.0, ["s1"]]
    assert after(3, ["s1"]) == [4.0, ["s1"]]
    assert after(4, ["s1"]) == [["s1"]]


def test_pieces_are_cut_where_a_switch_stands(http: httpx.Client, client: Client) -> None:
    """Around the ends of pieces, by a client that reads alone and by one that shares them."""
    annotate(http, "s1", "s2")
    view = subscribe(http, **QUALITY)
    places = (1, BLOCK_SAMPLES - 2, BLOCK_SAMPLES - 1, BLOCK_SAMPLES, 2 * BLOCK_SAMPLES + 7)
    expected: list[Any] = [["s1"]]
    done, now, other = 0, "s1", "s2"
    for place in (*places, 3 * BLOCK_SAMPLES):
        publish(http, now, *range(done + 1, place + 1))
        expected += [float(i) for i in range(done + 1, place + 1)]
        quality(http, other, 1.0)
        quality(http, now, 0.5)
        done, now, other = place, other, now
        expected.append([now])
    publish(http, now, done + 1)
    expected.append(float(done + 1))
    for begin in (0, 1, BLOCK_SAMPLES - 1, BLOCK_SAMPLES, BLOCK_SAMPLES + 1):
        events = client.subscription_events(view["id"], since=f"e1-{begin}")
        place = 0 if begin == 0 else expected.index(float(begin)) + 1
        assert until(events, float(done + 1)) == expected[place:]
    plain = until(client.events(view["stream"], since="start"), float(done + 1))
    assert plain == [float(i) for i in range(1, done + 2)]


def test_one_that_waits_starts(http: httpx.Client, client: Client) -> None:
    view = subscribe(http, **WANT)
    events = client.subscription_events(view["id"], since="start")
    assert told(next(events)) == []
    annotate(http, "s1")
    assert told(next(events)) == ["s1"]
    publish(http, "s1", 1)
    assert told(next(events)) == 1.0


def test_a_stream_that_ends_is_replaced(http: httpx.Client, client: Client) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(http, **WANT)
    publish(http, "s1", 1)
    assert http.post("/streams/s1/end").status_code == 204
    publish(http, "s2", 2)
    events = list(_several(client.subscription_events(view["id"], since="start"), 4))
    assert [told(event) for event in events] == [["s1"], 1.0, ["s2"], 2.0]
    assert events[2].data["why"] == "s1 ended"
    assert events[2].id == events[1].id


def _several(events: Iterator[Event], number: int) -> Iterator[Event]:
    for _ in range(number):
        yield next(events)


def test_silence_is_noticed(http: httpx.Client, client: Client, clock: Any) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(http, **WANT, staleness="5s")
    publish(http, "s1", 1)
    publish(http, "s2", 1)
    events = client.subscription_events(view["id"], since="start")
    assert until(events, 1.0) == [["s1"], 1.0]
    clock.now += 4 * SECOND
    publish(http, "s2", 2)
    clock.now += 2 * SECOND
    switched = next(events)
    assert (switched.data["after"], switched.data["why"]) == (["s2"], "s1 fell silent")
    assert told(next(events)) == 2.0


def test_cancelled_while_followed(http: httpx.Client, client: Client) -> None:
    annotate(http, "s1")
    view = subscribe(http, **WANT)
    publish(http, "s1", 1)
    events = client.subscription_events(view["id"], since="start")
    assert until(events, 1.0) == [["s1"], 1.0]
    client.unsubscribe(view["id"])
    rest = list(events)
    assert [event.kind for event in rest] == ["end"]
    assert rest[0].data["reason"] == "removed"
    assert http.get(f"/subscriptions/{view['id']}/events").status_code == 404


def test_what_is_no_longer_kept_is_a_gap_and_its_switches_are_told(
    http: httpx.Client, client: Client, engine: Engine
) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(http, **QUALITY)
    stream = engine.generator(view["stream"]).stream
    stream.retention = type(stream.retention)(2)
    for second in (1, 2, 3):
        publish(http, "s1", second)
    quality(http, "s1", 0.5)
    for second in (4, 5, 6, 7):
        publish(http, "s2", second)
    first = client.stream(view["stream"])["first"]
    assert first > 4
    events = client.subscription_events(view["id"], since="e1-1")
    found = until(events, 7.0)
    assert found == ["gap", ["s2"], *[float(i) for i in range(first, 8)]]


class Breaking(httpx.BaseTransport):
    """The connection breaks whenever a switch has been told."""

    def __init__(self) -> None:
        self.inner = httpx.HTTPTransport()
        self.connections = 0

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        answer = self.inner.handle_request(request)
        if not request.url.path.endswith("/events"):
            return answer
        self.connections += 1
        stream = _Until(answer.stream, b"\x00" if self.connections > 2 else b"event: rematched")
        return httpx.Response(answer.status_code, headers=answer.headers, stream=stream)


class _Until(httpx.SyncByteStream):
    def __init__(self, inner: Any, word: bytes) -> None:
        self.inner = inner
        self.word = word

    def __iter__(self) -> Iterator[bytes]:
        for part in self.inner:
            yield part
            if self.word in part:
                raise httpx.ReadError("broken")

    def close(self) -> None:
        self.inner.close()


def test_the_client_gives_each_switch_once_though_connections_break(
    http: httpx.Client, url: str
) -> None:
    annotate(http, "s1", "s2")
    view = subscribe(http, **QUALITY)
    publish(http, "s1", 1)
    quality(http, "s1", 0.5)
    transport = Breaking()
    with Client(url, transport=transport, sleep=lambda seconds: None) as client:
        events = client.subscription_events(view["id"], since="start")
        assert until(events, ["s2"]) == [["s1"], 1.0, ["s2"]]
        publish(http, "s2", 2)
        assert told(next(events)) == 2.0
    assert transport.connections >= 2


# -- the client and the command ----------------------------------------------------------------


def test_the_client(http: httpx.Client, client: Client) -> None:
    annotate(http, "s1", "s2")
    view = client.subscribe_to(
        "speed", objects=["uav1"], strategy="quality", staleness="5s", min_quality=0.5, hold_off=0
    )
    assert view["adaptive"]["want"] == "dyknow:speed of dyknow:uav1"
    quality(http, "s1", 0.25)
    assert client.subscription(view["id"])["adaptive"]["reads"] == ["s2"]
    assert [each["after"] for each in client.rematches(view["id"])] == [["s1"], ["s2"]]


@pytest.mark.parametrize("as_json", [False, True])
def test_the_command(http: httpx.Client, url: str, client: Client, as_json: bool) -> None:
    annotate(http, "s1", "s2")
    publish(http, "s1", 1)

    is_over = threading.Event()

    def switch() -> None:
        with asking(url) as other:
            while not is_over.is_set() and not other.get("/subscriptions").json():
                pass
            quality(other, "s1", 0.25)
            publish(other, "s2", 2)

    arguments = ["follow", "--feature", "speed", "--sort", "UAV", "--strategy", "quality"]
    arguments += ["--hold-off", "0s", "--staleness", "1h", "--min-quality", "0.5"]
    arguments += ["--since", "start", "-n", "2", "--url", url]
    thread = threading.Thread(target=switch)
    thread.start()
    said = CliRunner().invoke(commands, [*arguments, *(["--json"] if as_json else [])])
    is_over.set()  # a command that ended early leaves no subscription to wait for
    thread.join()
    assert said.exit_code == 0, said.output
    if as_json:
        lines = [json.loads(line) for line in said.stdout.splitlines()]
        assert [line["event"] for line in lines] == ["rematched", "sample"] * 2
        assert lines[2]["after"] == ["s2"]
    else:
        assert [line.split("speed=")[1] for line in said.stdout.splitlines()] == [
            "1 km.h-1",
            "2 km.h-1",
        ]
        assert "s1 → s2: quality of s1 is 0.25" in said.stderr
        assert "nothing → s1" in said.stderr
    assert client.subscriptions() == []


def test_the_command_wants_a_stream_or_a_feature(url: str) -> None:
    for arguments in ([], ["s1", "--feature", "speed"], ["s1", "--sort", "UAV"]):
        said = CliRunner().invoke(commands, ["follow", *arguments, "--url", url])
        assert said.exit_code == 2, said.output


@pytest.fixture
def settings() -> Settings:
    return Settings(port=0, tick=0.02, sse_ping=0, body_limit=1 << 20)
