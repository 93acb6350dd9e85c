"""Several streams on one connection: alternation, ends, one id for all, refusals."""

from __future__ import annotations

import itertools
import json
from typing import Any

import httpx
import pytest
from sse_clients import Reader, read_all

from dyknow.engine.engine import Engine
from dyknow.service.client.client import Client, ServiceError
from dyknow.service.sse.multi_stream import MOST_STREAMS, Position

FIELDS = {"n": "integer"}


def publish(client: Client, stream: str, first: int, count: int) -> None:
    rows = [{"valid": i, "available": i, "n": i} for i in range(first, first + count)]
    client.publish(stream, rows)


@pytest.fixture
def streams(client: Client) -> list[str]:
    for name in ("b", "a", "events"):
        client.put_stream(name, FIELDS)
    return ["b", "a", "events"]


def test_samples_of_all_come_each_once_and_in_order(client: Client, streams: list[str]) -> None:
    for name in streams:
        publish(client, name, 1, 300)
    for name in streams:
        client.end(name)
    events = list(client.follow(streams, since="start"))
    for name in streams:
        own = [event for event in events if event.data["stream"] == name]
        assert [event.kind for event in own] == ["sample"] * 300 + ["end"]
        assert [event.data["sequence"] for event in own[:-1]] == list(range(1, 301))
    # Nobody's history keeps the others waiting.
    assert len({event.data["stream"] for event in events[:600]}) == 3


def test_the_end_of_one_does_not_end_the_others(client: Client, streams: list[str]) -> None:
    events = client.follow(["a", "b"], since="start")
    publish(client, "a", 1, 1)
    client.end("a")
    told = [(event.kind, event.data["stream"]) for event in itertools.islice(events, 2)]
    assert told == [("sample", "a"), ("end", "a")]
    publish(client, "b", 1, 1)
    assert next(events).data["stream"] == "b"
    publish(client, "a", 2, 1)  # what has ended goes on
    assert next(events).data["sequence"] == 2
    client.end("a")
    client.remove_stream("b")
    rest = [(event.kind, event.data["stream"], event.data["reason"]) for event in events]
    assert sorted(rest) == [("end", "a", "ended"), ("end", "b", "removed")]


def test_any_id_resumes_all_streams(client: Client, http: httpx.Client, streams: list[str]) -> None:
    for name in ("a", "b"):
        publish(client, name, 1, 20)
        client.end(name)
    events = list(client.follow(["a", "b"], since="start"))
    samples = [event for event in events if event.kind == "sample"]
    for i, event in enumerate(samples):
        rest = client.follow(["b", "a", "a"], since=event.id)
        assert {(e.data["stream"], e.data["sequence"]) for e in rest if e.kind == "sample"} == {
            (e.data["stream"], e.data["sequence"]) for e in samples[i + 1 :]
        }
    answer = http.head("/follow?stream=a&stream=b", headers={"Last-Event-ID": samples[7].id})
    assert answer.headers["dyknow-position"] == samples[7].id


def test_cut_at_any_byte_and_resumed_nothing_is_missed_or_repeated(
    client: Client, url: str, streams: list[str]
) -> None:
    path = "/follow?stream=a&stream=b"
    start = client._http.head(path).headers["dyknow-position"]
    for name in ("a", "b"):
        publish(client, name, 1, 40)
        client.end(name)
    readers = [Reader(url, f"{path}&since={start}", [cut, 2 * cut]) for cut in range(1, 3000, 41)]
    read_all(readers)
    possible = [Position("e1", {"a": a, "b": b}) for a in range(41) for b in range(41)]
    allowed = {str(position).encode(): position for position in possible}
    for reader in readers:
        positions = [allowed[id] for id in reader.samples]
        assert len(positions) == 80
        for before, after in itertools.pairwise([Position("e1", {"a": 0, "b": 0}), *positions]):
            steps = [after.numbers[name] - before.numbers[name] for name in "ab"]
            assert sorted(steps) == [0, 1]


def test_a_removed_stream_is_told_to_who_resumes_and_the_others_go_on(
    client: Client, streams: list[str]
) -> None:
    publish(client, "a", 1, 1)
    publish(client, "b", 1, 1)
    seen = list(itertools.islice(client.follow(["a", "b"], since="start"), 2))
    client.remove_stream("a")
    publish(client, "b", 2, 1)
    client.end("b")
    rest = [(e.kind, e.data["stream"]) for e in client.follow(["a", "b"], since=seen[-1].id)]
    assert rest == [("end", "a"), ("sample", "b"), ("end", "b")]


def test_a_new_life_of_the_service_is_a_gap_of_each(client: Client, streams: list[str]) -> None:
    publish(client, "a", 1, 2)
    client.end("a")
    client.end("b")
    old = Position("e0", {"a": 5, "b": 3})
    events = list(client.follow(["a", "b"], since=str(old)))
    gaps = {e.data["stream"]: e.data["from"] for e in events if e.kind == "gap"}
    assert gaps == {"a": 6, "b": 4}
    assert [e.data["sequence"] for e in events if e.kind == "sample"] == [1, 2]


@pytest.mark.parametrize(
    ("names", "resumed"),
    [("abc", {"a": 2, "b": 4, "c": 5}), ("cb", {"b": 4, "c": 5}), ("a", {"a": 2})],
)
def test_an_id_resumes_with_more_streams_and_with_fewer(
    client: Client, http: httpx.Client, streams: list[str], names: str, resumed: dict[str, int]
) -> None:
    client.put_stream("c", FIELDS)
    for name in "abc":
        publish(client, name, 1, 5)
    id = str(Position("e1", {"a": 2, "b": 4}))
    query = "&".join(f"stream={name}" for name in names)
    answer = http.head(f"/follow?{query}", headers={"Last-Event-ID": id})
    assert answer.headers["dyknow-position"] == str(Position("e1", resumed))
    for name in names:
        client.end(name)
    told = [e.data for e in client.follow(names, since=id) if e.kind == "sample"]
    rest = {(name, n) for name, known in resumed.items() for n in range(known + 1, 6)}
    assert {(data["stream"], data["sequence"]) for data in told} == rest


def test_ids_of_earlier_versions_resume(client: Client, streams: list[str]) -> None:
    """They have one digest of all names."""
    publish(client, "a", 1, 5)
    publish(client, "b", 1, 5)
    client.end("a")
    client.end("b")
    id = "e1-59900c43-4.3"
    told = [e.data for e in client.follow(["b", "a"], since=id) if e.kind == "sample"]
    assert {(data["stream"], data["sequence"]) for data in told} == {("a", 5), ("b", 4), ("b", 5)}
    with pytest.raises(ServiceError, match="of other streams"):
        next(client.follow(["a"], since=id))


@pytest.mark.parametrize(
    "id",
    ["nonsense", "e1-5", "e1-00000000-1.2", str(Position("e1", {"x": 1})), "e1--1.2", "-a:1"],
    ids=["no id", "one stream's", "a wrong digest", "other streams'", "no digest", "no epoch"],
)
def test_an_id_of_other_streams_is_refused(client: Client, streams: list[str], id: str) -> None:
    with pytest.raises(ServiceError) as caught:
        next(client.follow(["a", "b"], since=id))
    assert (caught.value.status, caught.value.title) == (400, "bad event id")


def test_what_cannot_be_followed_is_refused(http: httpx.Client, streams: list[str]) -> None:
    assert http.get("/follow").status_code == 422
    assert http.get("/follow?stream=a&stream=nowhere").status_code == 404
    many = "&".join(f"stream=s{i}" for i in range(MOST_STREAMS + 1))
    assert http.get(f"/follow?{many}").status_code == 422


def test_one_connection_is_one_client_and_leaves_all_streams(
    client: Client, streams: list[str], engine: Engine
) -> None:
    events = client.follow(["a", "b"], since="start")
    publish(client, "a", 1, 1)
    next(events)
    assert client.status()["clients"] == 1
    assert [client.stream(name)["subscribers"] for name in ("a", "b")] == [1, 1]
    events.close()  # type: ignore[attr-defined]
    while client.status()["clients"]:
        pass
    assert [client.stream(name)["subscribers"] for name in ("a", "b")] == [0, 0]


def test_ids_are_bounded() -> None:
    longest = Position("3f2a91c0", {f"s{i}": 10**18 - 1 for i in range(MOST_STREAMS)})
    assert len(str(longest)) <= 8 + 1 + 27 * MOST_STREAMS
    assert Position.parse(str(longest), list(longest.numbers)) == longest


@pytest.mark.parametrize(
    ("since", "first"),
    [
        ("start", 3),
        ("7ns", 3),
        ("5ns", 5),
        ("PT0S", 10),
        ("1970-01-01T00:00:00.000000008Z", 8),
        ("9", 9),
        ("11", None),
    ],
)
def test_the_past_of_a_stream_from_a_time_or_a_duration(
    client: Client, since: str, first: int | None
) -> None:
    """The stream's own time counts: its samples are of 1970, and the last of them is of 10 ns."""
    client.put_stream("a", FIELDS, retention={"samples": 8})
    for n in range(1, 11):
        publish(client, "a", n, 1)
    client.end("a")
    wanted = [] if first is None else list(range(first, 11))
    for events in (client.events("a", since=since), client.follow(["a"], since=since)):
        samples = [event.data["sequence"] for event in events if event.kind == "sample"]
        assert samples == wanted


def test_a_past_that_is_forgotten_is_refused(client: Client) -> None:
    client.put_stream("a", FIELDS, retention={"samples": 8})
    for n in range(1, 11):
        publish(client, "a", n, 1)
    for since in ("8ns", "2", "1h"):
        for ask in (client.events("a", since=since), client.follow(["a"], since=since)):
            with pytest.raises(ServiceError) as refused:
                next(ask)
            assert refused.value.status == 410
            assert refused.value.problem["oldest"] == "1970-01-01T00:00:00.000000003Z"


def test_follow_with_some_history_on_the_command_line(dyknow: Any, client: Client) -> None:
    client.put_stream("a", FIELDS)
    publish(client, "a", 1, 10)
    client.end("a")
    for policy in ("", "any change"):
        found = dyknow("follow", "a", "--since", "3ns", "--policy", policy, "--json").stdout
        events = [json.loads(line) for line in found.splitlines()]
        assert [e["values"]["n"] for e in events if e["event"] == "sample"] == [7, 8, 9, 10]
    wrong = dyknow("follow", "a", "--since", "soon", status=2)
    assert "30s" in wrong.stderr
