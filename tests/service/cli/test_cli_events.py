"""``dyknow events`` and ``streams`` as people use them: joining, stopping, narrow terminals."""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
from typing import Any

import pytest
from typer.testing import CliRunner

from dyknow.service.cli import app
from dyknow.service.cli.output import show_values
from dyknow.service.client.client import Client

TEMPLATE = """REGISTER TEMPLATE dyknow:HighSpeedEvent(?o, ?type, ?threshold) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {?o dyknow:speed ?avgSpeed}
WHERE { ?o a ?type . ?o dyknow:speed ?spd . }
AGGREGATE {(?avgSpeed, AVG, {?spd}) FILTER (?avgSpeed > ?threshold)}
WINDOW [RANGE 5s STEP 1s]
"""
SSL = "stream s5 contains speed(UAV) = spd [km.h-1] for every UAV = id"
REQUEST = "dyknow:HighSpeedEvent(?o, dyknow:UAV, 100)"


@pytest.fixture
def speeds(client: Client) -> Client:
    client.put_stream("s5", {"id": "string", "spd": "float"})
    client.annotate(SSL)
    client.register_template(TEMPLATE)
    return client


def publish(client: Client, seconds: range) -> None:
    times = [second * 1_000_000_000 for second in seconds]
    client.publish("s5", [{"valid": t, "available": t, "id": "uav2", "spd": 150.0} for t in times])


def test_joining_a_request_does_not_show_its_past(dyknow: Any, speeds: Client) -> None:
    first = speeds.request_event(REQUEST)
    assert first["position"] == "e1-0"
    publish(speeds, range(1, 11))
    joined = speeds.request_event(REQUEST)
    assert joined["stream"] == first["stream"]
    number = int(joined["position"].removeprefix("e1-"))
    assert number > 0
    assert speeds.request(joined["id"])["position"] == joined["position"]
    assert [r["position"] for r in speeds.requests()] == ["e1-0", joined["position"]]
    publish(speeds, range(11, 14))
    speeds.end("s5")
    new = [e.id for e in speeds.events(joined["stream"], since=joined["position"])]
    assert new[0] == f"e1-{number + 1}"
    # Whoever asks now has seen nothing; the past is there for those who want it.
    assert dyknow("events", REQUEST).stdout == ""
    assert "uav2" in dyknow("events", REQUEST, "--since", "start").stdout


def test_numbers_have_units_for_people(dyknow: Any, speeds: Client) -> None:
    """Of an event, of a stream, of a stream under a policy, and of a feature, which is in the
    ontology's unit though its stream is not."""
    speeds.annotate(SSL.replace("km.h-1", "m.s-1"))
    publish(speeds, range(1, 11))
    from_start = ("--since", "start", "-n", "1")
    assert "id=uav2  speed=540 km.h-1\n" in dyknow("events", REQUEST, *from_start).stdout
    assert "id=uav2  spd=150 m.s-1\n" in dyknow("follow", "s5", *from_start).stdout
    policy = ("--policy", "sample every 1s")
    assert "spd=150 m.s-1\n" in dyknow("follow", "s5", *policy, *from_start).stdout
    feature = ("follow", "--feature", "speed", "--sort", "UAV", *from_start)
    assert "object=uav2  speed=540 km.h-1\n" in dyknow(*feature).stdout
    assert "speed=540 km.h-1\n" in dyknow(*feature, *policy).stdout
    wanted = speeds.subscribe_to("speed", sort="UAV")["stream"]
    # Known to every client, and no annotation: matching finds the stream behind it.
    (port,) = speeds.stream(wanted)["ports"]
    assert (port["field"], port["unit"]) == ("speed", "km.h-1")
    assert speeds.stream(wanted)["annotation"] is None
    for told in (dyknow(*feature, "--json"), dyknow("events", REQUEST, *from_start, "--json")):
        assert "km.h-1" not in told.stdout.splitlines()[-1]


def test_a_stream_is_followed_from_its_newest_samples_and_in_part(
    dyknow: Any, speeds: Client
) -> None:
    publish(speeds, range(1, 11))
    speeds.end("s5")
    last = dyknow("follow", "s5", "--last", "2", "--fields", "spd").stdout.splitlines()
    assert [line.partition("  ")[2] for line in last] == ["spd=150 km.h-1"] * 2
    conflated = dyknow("follow", "s5", "--since", "start", "--every", "1s").stdout
    assert conflated.endswith("id=uav2  spd=150 km.h-1  (10 samples)\n")
    told = dyknow("follow", "s5", "--last", "4", "--every", "1s", "--json").stdout
    assert json.loads(told.splitlines()[0])["count"] == 4
    for wrong in (
        ("s5", "--last", "2", "--since", "start"),
        ("s5", "--last", "2", "--policy", "any change"),
        ("--feature", "speed", "--sort", "UAV", "--last", "2"),
    ):
        dyknow("follow", *wrong, status=2)
    assert "did you mean spd?" in dyknow("follow", "s5", "--fields", "sped", status=1).stderr


def test_texts_truth_values_and_plain_counts_have_no_unit(dyknow: Any, client: Client) -> None:
    assert show_values({"n": 2, "b": True, "t": "x", "none": None}, {"b": "m", "t": "m"}) == (
        "n=2  b=yes  t=x  none=-"
    )
    client.load_ontology(
        "dyknow:crew a :UnaryFeature ; rdfs:range xsd:integer ; :hasUnit 'no_unit' .", "crews"
    )
    client.put_stream("crews", {"id": "string", "n": "integer"})
    client.annotate("stream crews contains crew(UAV) = n for every UAV = id")
    client.publish("crews", [{"valid": 1, "available": 1, "id": "uav2", "n": 3}])
    assert dyknow("follow", "crews", "--since", "start", "-n", "1").stdout.endswith("n=3\n")


def test_a_request_is_given_up_by_its_id(dyknow: Any, speeds: Client) -> None:
    dyknow("events", REQUEST, "--no-follow")
    assert dyknow("events", "--cancel", "event1").stdout.strip() == "cancelled event1"
    assert speeds.requests() == []
    dyknow("events", "--cancel", "event1", status=1)
    dyknow("events", REQUEST, "--cancel", "event1", status=2)


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP", "SIGINT"])
def test_a_signal_gives_up_what_is_followed(url: str, speeds: Client, name: str) -> None:
    # Who runs the tests may have it ignored, as nohup does, and then so does the command.
    told = "signal.default_int_handler" if name == "SIGINT" else "signal.SIG_DFL"
    heard = f"import signal; signal.signal(signal.{name}, {told})"
    command = [sys.executable, "-c", f"{heard}; from dyknow.service.cli import main; main()"]
    with subprocess.Popen(
        [*command, "events", REQUEST],
        env={**os.environ, "DYKNOW_URL": url},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        # The last words before it listens.
        assert any(line == "waiting for events; Ctrl-C ends\n" for line in process.stderr)
        assert len(speeds.requests()) == 1
        process.send_signal(getattr(signal, name))
        assert "stopped" in process.stderr.read()
        assert process.wait(120) == 0
    assert speeds.requests() == []


def test_signals_are_as_before_afterwards(dyknow: Any) -> None:
    before = signal.getsignal(signal.SIGTERM)
    dyknow("events")
    assert signal.getsignal(signal.SIGTERM) is before


def test_requests_are_listed_as_people_write_them(dyknow: Any, speeds: Client) -> None:
    for threshold in ("100", "1.5", "1.5e2"):
        speeds.request_event("dyknow:HighSpeedEvent", ["?o", "dyknow:UAV", threshold])
    listed = dyknow("events", COLUMNS="80").stdout.splitlines()
    assert "dyknow:HighSpeedEvent" in listed[1]
    assert [r["arguments"][2] for r in speeds.requests()] == ["100", "1.5", "1.5e2"]
    assert "?o, dyknow:UAV, 100" in listed[1]
    assert len(listed) == 4


def test_names_are_whole_even_where_they_do_not_fit(dyknow: Any, client: Client) -> None:
    name = "coordinates_" * 10
    client.put_stream(name, {"a": "float"})
    assert name in dyknow("streams", COLUMNS="80").stdout


def test_streams_in_a_narrow_terminal(dyknow: Any, client: Client) -> None:
    name = "coordinates_of_all_the_aircraft"
    client.put_stream(name, {f"field{i}": "float" for i in range(20)})
    row: dict[str, Any] = {f"field{i}": 1.0 for i in range(20)}
    time = "2021-10-07T19:12:53.123456789Z"
    client.publish(name, [{"valid": time, "available": time, **row}])
    client.end(name)
    listed = dyknow("streams", COLUMNS="80").stdout
    assert name in listed
    assert all(len(line) <= 80 for line in listed.splitlines())
    assert "field1" not in listed
    wide = dyknow("streams", COLUMNS="200").stdout
    assert "19:12:53.123Z (ended)" in wide
    assert "field19: float" in dyknow("streams", name).stdout


def test_help_says_what_it_does() -> None:
    def help_of(*command: str) -> str:
        result = CliRunner().invoke(app, [*command, "--help"], env={"COLUMNS": "300"})
        return " ".join(result.stdout.split())

    assert "leave the request running" in help_of("events")
    assert "weighted:cost=1,quality=10" in help_of("events")
    assert "weighted:cost=1,quality=10" in help_of("match")
    assert help_of("run").count("May be repeated") == 3
    assert "May be repeated" in help_of("match")


def test_silence_has_a_reason_at_ctrl_c(
    dyknow: Any, speeds: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of the query or request behind a stream that is followed."""

    def interrupted(*_: object) -> int:
        raise KeyboardInterrupt

    # Imported before either is patched: `follow` takes the function from `events`, and the commands
    # are loaded when they are first used.
    modules = [
        importlib.import_module(f"dyknow.service.cli.{name}") for name in ("events", "follow")
    ]
    for module in modules:
        monkeypatch.setattr(module, "show_events", interrupted)
    asked = speeds.request_event(REQUEST)
    publish(speeds, range(1, 2))
    nothing = dyknow("events", REQUEST.replace("100", "1000")).stderr
    assert "nothing came: no sample read yet from s5" in nothing
    followed = dyknow("follow", asked["stream"]).stderr
    assert "nothing came: 1 samples read, 1 triples: no window has closed yet" in followed
    assert "nothing came" not in dyknow("follow", "s5").stderr
    publish(speeds, range(2, 20))
    assert "nothing came" not in dyknow("follow", asked["stream"]).stderr
    assert "nothing came" not in dyknow("events", REQUEST).stderr


def test_queries_say_why_there_is_no_result(dyknow: Any, speeds: Client) -> None:
    where = "?o a dyknow:Car ; dyknow:speed ?v"
    speeds.register_query(
        "REGISTER QUERY cars COMPUTE EVERY 1s AS SELECT ?o ?v FROM STREAM "
        f"<http://www.ida.liu.se/dyknow/s5> [RANGE 2s STEP 1s] WHERE {{ {where} }}"
    )
    shown = dyknow("query", "show", "cars").stdout
    assert "nothing came: no sample read yet from s5" in shown
    assert "waits for" not in shown
    assert "it waits for s5" in dyknow("query", "results", "cars", status=1).stderr
    publish(speeds, range(1, 10))
    said = "nothing came: 9 samples read, 9 triples: no member of dyknow:Car seen"
    assert said in dyknow("query", "show", "cars").stdout
    assert said in dyknow("query", "results", "cars").stderr
