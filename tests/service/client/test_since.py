"""Requests, queries and subscriptions that begin at a time or a duration of the past: over HTTP, by
the client, and on the command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from dyknow.service.client.client import Client, ServiceError

TEMPLATE = """REGISTER TEMPLATE dyknow:FastEvent(?o, ?limit) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?v}
WHERE { ?o dyknow:speed ?v . FILTER (?v > ?limit) }
WINDOW [RANGE 1s STEP 1s]
"""
QUERY = """REGISTER QUERY fast AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
SELECT ?v FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 1s STEP 1s]
WHERE { ?o dyknow:speed ?v }"""
EVENT = "dyknow:FastEvent(?o, 0)"
SINCE = [("7", 7), ("1970-01-01T00:00:07Z", 7), ("3s", 7), ("PT0S", 10), ("start", 1), ("1h", 1)]
"""Where it begins, and the first of the samples, which are of 1 to 10 s."""

Ask = Callable[[Client, str], dict[str, Any]]
ASK: list[Ask] = [
    lambda client, since: client.request_event(EVENT, since=since),
    lambda client, since: client.request_event("dyknow:FastEvent", ["?o", "0"], since=since),
    lambda client, since: client.register_query(QUERY, since=since),
    lambda client, since: client.subscribe("s", "any change", since=since),
    lambda client, since: client.subscribe_to("speed", sort="UAV", since=since),
]


def publish(client: Client, stream: str, *seconds: int) -> None:
    times = [(second, second * 1_000_000_000) for second in seconds]
    client.publish(
        stream, [{"valid": t, "available": t, "id": "u", "v": float(s)} for s, t in times]
    )


@pytest.fixture
def speeds(client: Client) -> Client:
    client.put_stream("s", {"id": "string", "v": "float"})
    client.annotate("stream s contains speed(UAV) = v [km.h-1] for every UAV = id")
    client.register_template(TEMPLATE)
    return client


def seen(client: Client, stream: str) -> list[float]:
    events = client.events(stream, since="start")
    samples = [event for event in events if event.kind == "sample"]
    return [next(v for v in e.values.values() if isinstance(v, float)) for e in samples]


@pytest.mark.parametrize("ask", ASK)
@pytest.mark.parametrize(("since", "first"), SINCE)
def test_it_begins_at_a_time_or_so_long_before_the_newest_sample(
    speeds: Client, ask: Ask, since: str, first: int
) -> None:
    publish(speeds, "s", *range(1, 11))
    given = f"{since}000000000" if since.isdigit() else since
    view = ask(speeds, given)
    publish(speeds, "s", 11)
    speeds.end("s")
    if view["stream"] is not None and "adaptive" in view and view["adaptive"] is not None:
        # Its stream goes on: another source may come.
        events = speeds.subscription_events(view["id"], since="start")
        found: list[float] = []
        while not found or found[-1] < 11:
            event = next(events)
            if event.kind == "sample":
                found.append(float(event.values["speed"]))
    else:
        found = seen(speeds, view["stream"])
    assert found == [float(n) for n in range(first, 12)]


def test_a_duration_is_shown_as_the_time_that_it_means(speeds: Client) -> None:
    publish(speeds, "s", *range(1, 11))
    time = "1970-01-01T00:00:07Z"
    assert speeds.request_event(EVENT, since="3s")["since"] == time
    assert speeds.subscribe("s", "any change", since="3s")["since"] == time
    assert speeds.subscribe_to("speed", sort="UAV", since="3s")["since"] == time
    # That of a query is compared when it is registered again.
    assert speeds.register_query(QUERY, since="3s")["options"]["since"] == "3s"
    publish(speeds, "s", 11)
    assert speeds.register_query(QUERY, since="3s")["users"] == 2
    with pytest.raises(ServiceError) as refused:
        speeds.register_query(QUERY, since="4s")
    assert refused.value.status == 409
    assert "since=3s" in str(refused.value)


def test_requests_share_a_stream_that_begins_at_the_same_time(speeds: Client) -> None:
    publish(speeds, "s", *range(1, 11))
    now, start = speeds.request_event(EVENT), speeds.request_event(EVENT, since="start")
    first = speeds.request_event(EVENT, since="3s")
    assert len({now["stream"], start["stream"], first["stream"]}) == 3
    assert first["position"] == "e1-0"
    again = speeds.request_event(EVENT, since="1970-01-01T00:00:07Z")
    assert again["stream"] == first["stream"]
    publish(speeds, "s", 11)
    later = speeds.request_event(EVENT, since="3s")
    assert later["stream"] != first["stream"], "the newest sample is another one"
    assert speeds.request_event(EVENT, since="4s")["stream"] == first["stream"]
    speeds.end("s")
    assert [seen(speeds, each["stream"])[0] for each in (start, first, later)] == [1, 7, 8]
    assert seen(speeds, now["stream"]) == [11]


@pytest.mark.parametrize("ask", ASK)
def test_a_past_that_is_forgotten_is_refused(speeds: Client, http: httpx.Client, ask: Ask) -> None:
    speeds.put_stream("s", {"id": "string", "v": "float"}, retention={"samples": 4})
    for second in range(1, 11):
        publish(speeds, "s", second)
    for since in ("4s", "6000000000", "1970-01-01T00:00:06Z"):
        with pytest.raises(ServiceError) as refused:
            ask(speeds, since)
        assert refused.value.status == 410
        assert refused.value.problem["oldest"] == "1970-01-01T00:00:07Z"
    assert speeds.requests() == []
    assert speeds.queries() == []
    assert http.get("/subscriptions").json() == []
    ask(speeds, "3s")
    assert speeds.stream("s")["subscribers"] > 0


@pytest.mark.parametrize("ask", ASK)
@pytest.mark.parametrize("since", ["soon", "", "-1s", "e1-3", "2021-13-01", "5 parsecs"])
def test_what_is_no_beginning_is_refused(speeds: Client, ask: Ask, since: str) -> None:
    with pytest.raises(ServiceError) as refused:
        ask(speeds, since)
    assert refused.value.status == 400
    assert "30s" in refused.value.problem["hint"]


def test_on_the_command_line(dyknow: Any, speeds: Client, tmp_path: Any) -> None:
    publish(speeds, "s", *range(1, 11))
    speeds.end("s")
    text = tmp_path / "fast.rq"
    text.write_text(QUERY)

    def values(*command: str) -> list[float]:
        lines = map(json.loads, dyknow(*command, "--json").stdout.splitlines())
        rows = (line["values"] for line in lines if line["event"] == "sample")
        return [next(v for v in row.values() if isinstance(v, float)) for row in rows]

    for since in ("3s", "1970-01-01T00:00:07Z", "7000000000"):
        assert values("events", EVENT, "--since", since) == [7, 8, 9, 10]
        feature = ("follow", "--feature", "speed", "--sort", "UAV")
        assert values(*feature, "--since", since, "-n", "4") == [7, 8, 9, 10]
        assert values("follow", "s", "--policy", "any change", "--since", since) == [7, 8, 9, 10]
    dyknow("query", "add", str(text), "--since", "3s")
    assert values("follow", "fast", "--since", "start") == [7, 8, 9, 10]
    for command in (("events", EVENT), ("follow", "s"), ("query", "add", str(text))):
        assert "30s" in dyknow(*command, "--since", "soon", status=2).stderr


def test_a_subscription_that_waits_begins_at_its_time(speeds: Client) -> None:
    """The stream that holds the feature comes later, and has forgotten some of what is asked for:
    the subscription is accepted already, and its switch says so."""
    view = speeds.subscribe_to("altitude", sort="UAV", since="4000000000")
    assert view["adaptive"]["state"] == "waiting"
    speeds.put_stream("t", {"id": "string", "v": "float"}, retention={"samples": 3})
    for second in range(1, 11):
        publish(speeds, "t", second)
    speeds.annotate("stream t contains altitude(UAV) = v for every UAV = id")
    events = speeds.subscription_events(view["id"], since="start")
    found: list[float] = []
    while len(found) < 3:
        event = next(events)
        if event.kind == "sample":
            found.append(float(event.values["altitude"]))
    assert found == [8, 9, 10]
    assert [each["lost"] for each in speeds.rematches(view["id"])][-1]
