"""Monitors over HTTP, with the client and on the command line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from registering import check_shared_until_the_last_has_left, register

from dyknow.service.client.client import Client

TEXT = {"Content-Type": "text/plain"}
LINES = {"Content-Type": "application/x-ndjson"}
SECOND = 1_000_000_000
SSL = "stream s5 contains speed(UAV) = spd [m.s-1] for every UAV = id"
CALM = "monitor calm(?x in UAV) = always[0s, 2s] speed(?x) < 100 with max delay 0s"
MOOD = """@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix o: <http://www.dyknow.eu/ontology#> .
dyknow:mood a o:UnaryFeature ."""
SPEEDS = [(1, 10.0), (2, 20.0), (3, 30.0), (4, 10.0), (8, 5.0)]
"""Of a UAV in m/s: at second 3 it is faster than 100 km/h."""
VIOLATIONS = [("00:00:03Z", f"00:00:0{start}Z", "00:00:03Z") for start in (1, 2, 3)]
"""Available, start and deciding state: without delay a state leaves at its own time."""


@pytest.fixture
def flying(http: httpx.Client) -> httpx.Client:
    """A service with an annotated stream s5."""
    assert http.post("/annotations", content=SSL, headers=TEXT).status_code == 201
    return http


def publish(http: httpx.Client, stream: str, *rows: dict[str, Any]) -> httpx.Response:
    body = "\n".join(map(json.dumps, rows))
    answer = http.post(f"/streams/{stream}/samples", content=body, headers=LINES)
    assert answer.status_code == 202, answer.text
    return answer


def fly(http: httpx.Client, *speeds: tuple[int, float]) -> None:
    rows = ((second * SECOND, speed) for second, speed in speeds)
    publish(http, "s5", *({"valid": t, "available": t, "id": "uav1", "spd": v} for t, v in rows))


def told(client: Client, stream: str) -> tuple[list[tuple[str, str, str]], dict[str, Any]]:
    """The verdicts until the end, as (available, start, deciding state), and the end."""
    *samples, end = client.events(stream, since="start")
    assert {each.kind for each in samples} <= {"sample"}
    times = (
        (each.data["available"], each.data["valid"], each.values["decided"]) for each in samples
    )
    return [tuple(time.rpartition("T")[2] for time in each) for each in times], end.data


# -- registering -----------------------------------------------------------------------------


def test_a_monitor_from_text_to_verdicts(flying: httpx.Client, client: Client) -> None:
    made = register(flying, CALM)
    assert made.status_code == 201, made.text
    assert made.headers["location"] == "/queries/calm"
    view = flying.get("/queries/calm").json()
    assert view == made.json()
    assert (view["kind"], view["dialect"], view["form"]) == ("MONITOR", "MTL", "")
    assert (view["state"], view["reads"], view["waits_for"]) == ("running", ["s5"], ["s5"])
    assert view["fields"] == dict.fromkeys(("x", "verdict", "decided", "witness"), "string")
    assert view["source"] == CALM
    assert (view["stream"], view["windows"], view["last_window"]) == ("calm", 0, None)
    fly(flying, *SPEEDS)
    flying.post("/streams/s5/end")
    found, end = told(client, "calm")
    assert found == VIOLATIONS
    assert (end["reason"], end["sequence"]) == ("ended", 3)
    samples = flying.get("/streams/calm/samples", headers={"Accept": "application/json"}).json()
    assert [(each["x"], each["verdict"]) for each in samples] == [("uav1", "false")] * 3
    assert client.query("calm")["state"] == "ended"


def test_robustness_is_a_number_in_the_view_and_in_samples(flying: httpx.Client) -> None:
    view = register(flying, f"{CALM}, robustness, report verdicts").json()
    assert view["fields"]["robustness"] == "float"
    fly(flying, *SPEEDS)
    flying.post("/streams/s5/end")
    samples = flying.get("/streams/calm/samples", headers={"Accept": "application/json"}).json()
    margins = [each["robustness"] for each in samples]
    assert [each["verdict"] for each in samples] == ["false"] * 3 + ["true"] * 2
    # In km/h, the unit of the feature: 30 m/s is 8 km/h too fast.
    assert margins == pytest.approx([-8.0] * 3 + [64.0, 82.0])


def test_the_events_come_as_they_are_decided(flying: httpx.Client, client: Client) -> None:
    register(flying, CALM)
    events = client.events("calm", since="start")
    fly(flying, *SPEEDS[:4])
    assert [next(events).data["valid"][-3:] for _ in range(3)] == ["01Z", "02Z", "03Z"]
    flying.post("/streams/s5/end")
    assert [each.data.get("reason") for each in events] == ["ended"]


def test_the_same_again_is_shared_until_the_last_has_left(flying: httpx.Client) -> None:
    check_shared_until_the_last_has_left(flying, "calm", CALM, f"\n{CALM}\n")


def test_another_text_of_the_name_is_refused(flying: httpx.Client) -> None:
    register(flying, CALM)
    other = register(flying, CALM.replace("100", "120"))
    assert (other.status_code, "another text" in other.json()["detail"]) == (409, True)
    query = (
        "REGISTER QUERY calm AS SELECT ?o WHERE { ?o dyknow:speed ?v } WINDOW [RANGE 1s STEP 1s]"
    )
    assert register(flying, query).status_code == 409
    assert flying.get("/queries/calm").json()["users"] == 1


def test_a_monitor_whose_verdicts_are_read_stays(flying: httpx.Client) -> None:
    register(flying, CALM)
    reader = {"stream": "calm", "policy": "any order, max delay 1s"}
    made = flying.post("/subscriptions", json=reader).json()
    assert flying.delete("/queries/calm").status_code == 409
    assert flying.delete(f"/subscriptions/{made['id']}").status_code == 204
    assert flying.delete("/queries/calm").status_code == 204


@pytest.mark.parametrize(
    ("text", "place", "words"),
    [
        ("monitor q(?x in UAV) = speed(?x <", (1, 33), "`<` is not allowed here"),
        ("monitor q(?x in UAV) =\n  speed(?x) < true", (2, 3), "a number is compared with a truth"),
        ("monitor q(?x in UAV) = colour(?x) < 3", (1, 24), "knows no feature `colour`"),
        ("monitor q(?x in UAV) = speed(?y) < 3", (1, 30), "`?y` is not bound"),
        ("monitor q(?x in UAV) = speed(?x) < 3 [m]", (1, 24), "do not fit together"),
        ("monitor q(?x in UAV) = speed(?x) < 3 with sometimes", (1, 43), "is not allowed here"),
        ("monitor q(?x in UAV) = always[3s, 1s] speed(?x) < 3", (1, 30), "ends before it begins"),
    ],
)
def test_a_wrong_text_is_refused_with_its_place(
    flying: httpx.Client, text: str, place: tuple[int, int], words: str
) -> None:
    answer = register(flying, text)
    assert answer.status_code == 400, answer.text
    problem = answer.json()
    assert problem["title"] == "syntax error"
    assert words in problem["detail"]
    assert (problem["line"], problem["column"]) == place
    assert "^" in problem["excerpt"]
    explained = flying.get("/explain", params={"query": text})
    assert (explained.status_code, explained.json()["column"]) == (400, place[1])
    assert flying.get("/queries").json() == []


def test_what_is_missing_is_told(flying: httpx.Client) -> None:
    text = "monitor q(?x in UAV) = altitude(?x) < 3 or speed(?x) < 3"
    answer = register(flying, text)
    assert (answer.status_code, answer.json()["title"]) == (422, "no plan")
    (missing,) = answer.json()["missing"]
    assert missing.startswith("dyknow:altitude of every dyknow:UAV: ")
    assert flying.get("/queries").json() == []
    assert {each["name"] for each in flying.get("/streams").json()} == {"s5", "status"}


@pytest.mark.parametrize(
    ("text", "status", "words"),
    [
        ("monitor q(?x in UAV) = speed(uav1) < 3", 400, "leave `?x in dyknow:UAV` out"),
        ("monitor q(?last in UAV) = speed(?last) < 3", 400, "give the variable another name"),
        ("monitor s5(?x in UAV) = speed(?x) < 3", 409, "another name"),
        ("monitor dyknow_q(?x in UAV) = speed(?x) < 3", 403, "the system uses the name"),
    ],
)
def test_what_is_refused_says_why(flying: httpx.Client, text: str, status: int, words: str) -> None:
    answer = register(flying, text)
    assert (answer.status_code, words in answer.text) == (status, True), answer.text
    assert flying.get("/queries").json() == []


@pytest.mark.parametrize(
    ("option", "value"),
    [("semantics", "set"), ("bounds", "[)"), ("origin", "5"), ("report", "change")],
)
def test_options_of_windows_are_refused(flying: httpx.Client, option: str, value: str) -> None:
    answer = register(flying, CALM, **{option: value})
    assert answer.status_code == 400
    assert "a monitor has no windows" in answer.json()["detail"]
    assert "with report changes" in answer.json()["hint"]
    assert flying.get("/queries").json() == []


def test_it_may_begin_with_the_past(flying: httpx.Client, client: Client) -> None:
    fly(flying, *SPEEDS)
    register(flying, CALM, since="start")
    register(flying, CALM.replace("calm", "new"), since="now")
    flying.post("/streams/s5/end")
    assert told(client, "calm")[0] == VIOLATIONS
    assert told(client, "new")[0] == []


# -- reading ---------------------------------------------------------------------------------


def test_why_it_has_reported_nothing(flying: httpx.Client) -> None:
    register(flying, CALM)

    def reason() -> str | None:
        found: str | None = flying.get("/queries/calm").json()["empty"]
        return found

    assert reason() == "no sample read yet from s5"
    fly(flying, *SPEEDS[:1])
    assert "1 samples read, 0 states" in str(reason())
    fly(flying, (2, 20.0))
    assert "2 samples read, 1 states" in str(reason())
    assert "no verdict is decided yet" in str(reason())
    fly(flying, (5, 20.0), (6, 30.0))
    assert "4 samples read, 3 states" in str(reason())
    assert "reports violations" in str(reason())
    fly(flying, (7, 20.0))
    assert reason() is None


def test_the_text_and_the_stages(flying: httpx.Client) -> None:
    plain = {"Accept": "text/plain"}
    before = flying.get("/explain", params={"query": CALM}, headers=plain).text
    assert "at most 2s after the time of the start" in before
    assert flying.get("/queries").json() == []
    register(flying, CALM)
    assert flying.get("/queries/calm", headers=plain).text.strip() == CALM
    fly(flying, *SPEEDS)
    stages = flying.get("/queries/calm?explain=true").json()["explanation"]
    for words in (
        CALM,
        "speed [m.s-1 → km.h-1 × 3.6]",
        "4 by now, of 5 samples",
        "0 true, 3 false, 0 unknown",
    ):
        assert words in stages
    assert flying.get("/queries/calm").json()["explanation"] is None
    same = flying.get("/explain", params={"id": "calm"}, headers=plain).text
    assert same == flying.get("/queries/calm?explain=true", headers=plain).text


def test_it_has_no_windows(flying: httpx.Client) -> None:
    register(flying, CALM)
    for _ in range(2):
        answer = flying.get("/queries/calm/results")
        assert answer.status_code == 404
        assert answer.json()["type"] == "urn:dyknow:problem:no-result-yet"
        assert "is a monitor and has no windows" in answer.json()["detail"]
        assert "GET /streams/calm/samples" in answer.json()["hint"]
        fly(flying, *SPEEDS)


def test_a_single_start_ends_the_stream(flying: httpx.Client, client: Client) -> None:
    text = "monitor ready = eventually[0s, 9s] speed(uav1) > 100 with once, report verdicts"
    register(flying, text)
    fly(flying, *SPEEDS)
    found, end = told(client, "ready")
    assert [each[1:] for each in found] == [("00:00:01Z", "00:00:03Z")]
    assert end["reason"] == "ended"
    assert client.query("ready")["state"] == "ended"
    # The stream that it read goes on.
    fly(flying, (9, 50.0))
    assert not client.stream("s5")["ended"]


def test_verdicts_are_a_stream_like_any_other(flying: httpx.Client) -> None:
    register(flying, f"{CALM}, report changes")
    fly(flying, *SPEEDS)
    flying.post("/streams/s5/end")
    found = flying.get("/streams/calm/samples", headers={"Accept": "application/json"}).json()
    runs = [(each["verdict"], each["valid"][-3:], each["last"][-3:]) for each in found]
    assert runs == [("false", "01Z", "03Z"), ("true", "04Z", "08Z")]
    refused = flying.post("/streams/calm/samples", content="{}", headers=LINES)
    assert refused.status_code == 403


def test_a_value_of_another_kind_fails_it_alone(
    flying: httpx.Client, client: Client, dyknow: Any
) -> None:
    """The feature has no range, so only a sample shows that it is no number."""
    client.load_ontology(MOOD, "http://example.org/mood")
    assert flying.put("/streams/u", json={"fields": {"id": "string", "m": "string"}}).is_success
    ssl = "stream u contains mood(UAV) = m for every UAV = id"
    assert flying.post("/annotations", content=ssl, headers=TEXT).status_code == 201
    text = "monitor sad(?x in UAV) = mood(?x) < 3"
    assert register(flying, text).status_code == 201
    assert register(flying, CALM).status_code == 201
    publish(flying, "u", {"valid": 1, "available": 1, "id": "uav1", "m": "fine"})
    view = {each["name"]: each for each in flying.get("/queries").json()}["sad"]
    assert view["state"] == "failed"
    assert "field 'm' of stream u is string, and the formula needs a number" in view["failure"]
    assert (view["errors"], view["last_error"] is not None) == (1, True)
    (end,) = client.events("sad", since="start")
    assert (end.kind, end.data["reason"]) == ("end", "failed")
    assert end.data["failure"] in view["failure"]
    assert "failed" in dyknow("query", "list").stdout
    assert "the formula needs a number" in dyknow("query", "show", "sad").stdout
    fly(flying, *SPEEDS)
    flying.post("/streams/s5/end")
    assert told(client, "calm")[0] == VIOLATIONS
    # The same text starts it anew.
    assert register(flying, text).json()["state"] == "running"


# -- client and command line -----------------------------------------------------------------


def test_the_client_has_the_verbs(flying: httpx.Client, client: Client) -> None:
    assert client.register_query(CALM)["dialect"] == "MTL"
    fly(flying, *SPEEDS)
    flying.post("/streams/s5/end")
    assert [query["kind"] for query in client.queries()] == ["MONITOR"]
    assert "3 false" in client.query("calm", explain=True)["explanation"]
    client.remove_query("calm")
    assert client.queries() == []


def test_on_the_command_line(dyknow: Any, flying: httpx.Client, tmp_path: Path) -> None:
    path = tmp_path / "calm.mtl"
    path.write_text(CALM)
    added = dyknow("query", "add", str(path)).stdout
    assert "registered calm" in added
    assert "dyknow follow calm" in added
    assert "shared by 2" in dyknow("query", "add", CALM).stdout
    assert "no sample read yet from s5" in dyknow("query", "show", "calm").stdout
    wrong = dyknow("query", "add", "monitor q(?x in UAV) = speed(?x <", status=1).stderr
    assert "line 1, column 33" in wrong
    refused = dyknow("query", "add", CALM, "--report", "close", status=1).stderr
    assert "a monitor has no windows" in refused
    fly(flying, *SPEEDS)
    flying.post("/streams/s5/end")
    listed = dyknow("query", "list").stdout
    assert "calm" in listed
    assert "MTL" in listed
    assert json.loads(dyknow("query", "list", "--json").stdout)["kind"] == "MONITOR"
    shown = dyknow("query", "show", "calm", "--explain").stdout
    assert CALM in shown
    assert "0 unknown" in shown
    results = dyknow("query", "results", "calm", status=1).stderr
    assert "its results are the samples of stream calm" in results
    followed = dyknow("follow", "calm", "--since", "start").stdout
    assert followed.count("false") == 3
    assert "runs on for 1" in dyknow("query", "remove", "calm").stdout
    assert "removed calm" in dyknow("query", "remove", "calm").stdout
    assert "no queries yet" in dyknow("query", "list").stdout
    assert "no query" in dyknow("query", "show", "calm", status=1).stderr
