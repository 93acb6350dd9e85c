"""KPL over HTTP, the command line and the client: declared, fed, watched, removed."""

from __future__ import annotations

import sys

import httpx
import pytest
from asking import asking
from typer.testing import CliRunner

from dyknow.engine.engine import Engine
from dyknow.engine.processes.registry import Processes
from dyknow.service.app import create_app
from dyknow.service.cli import app as commands
from dyknow.service.client.client import Client
from dyknow.service.config.settings import Settings
from dyknow.service.runtime.process_watchdog import Watchdog
from dyknow.service.server import running

TEXT = {"Content-Type": "text/plain"}
LINES = {"Content-Type": "application/x-ndjson"}
CARS = """
source float pos_car1
strmgen pos[car1] = pos_car1
stream slow = pos[car1] with sample every 200, max delay 100
"""


def publish(http: httpx.Client, stream: str, *rows: tuple[int, int, float]) -> None:
    body = "".join(
        f'{{"available": {a}000000, "valid": {v}000000, "value": {x}}}\n' for a, v, x in rows
    )
    answer = http.post(f"/streams/{stream}/samples", content=body, headers=LINES)
    assert answer.status_code == 202, answer.text


def values(http: httpx.Client, stream: str) -> list[float]:
    answer = http.get(f"/streams/{stream}/samples", headers={"Accept": "application/json"})
    assert answer.status_code == 200, answer.text
    return [sample["value"] for sample in answer.json()]


def test_the_whole_way(http: httpx.Client) -> None:
    answer = http.post("/kpl", content=CARS, headers=TEXT)
    assert answer.status_code == 201
    assert [one["name"] for one in answer.json()] == ["pos_car1", "pos[car1]", "slow"]
    publish(http, "pos_car1", (280, 200, 1.0), (390, 300, 2.0), (510, 400, 3.0), (620, 600, 4.0))
    # 400 came 110 after it was valid, so the chain of Def. 5.22 is broken there.
    assert values(http, "slow") == [1.0]
    assert values(http, "pos%5Bcar1%5D") == [1.0, 2.0, 3.0, 4.0]
    dropped = http.get("/streams/slow_violations/samples", headers={"Accept": "application/json"})
    assert [(one["reason"], one["value"]) for one in dropped.json()] == [
        ("sample every", 2.0),
        ("max delay", 3.0),
        ("sample every", 4.0),
    ]
    one = http.get("/kpl/slow").json()
    assert one["counters"]["dropped"] == {"sample every": 2, "max delay": 1}
    assert one["violations"] == "slow_violations"
    assert http.get("/kpl/pos[car1]").json()["used_by"] == ["slow"]


def test_text_is_given_back(http: httpx.Client) -> None:
    http.post("/kpl", content=CARS, headers=TEXT)
    text = http.get("/kpl", headers={"Accept": "text/plain"}).text
    assert text == CARS.lstrip()
    assert http.post("/kpl", content=text, headers=TEXT).json() == []


def test_problems_say_where_and_what_next(http: httpx.Client) -> None:
    answer = http.post(
        "/kpl", content=CARS.replace("pos[car1] with", "pso[car1] with"), headers=TEXT
    )
    assert answer.status_code == 400
    problem = answer.json()
    assert (problem["line"], problem["column"]) == (4, 15)
    assert "pos" in problem["hint"]
    assert http.get("/kpl").json() == []

    http.post("/kpl", content=CARS, headers=TEXT)
    missing = "compunit x Missing(float)\nstrmgen x = Missing(pos[car1])"
    assert http.post("/kpl", content=missing, headers=TEXT).status_code == 404
    assert http.get("/kpl/nothing").status_code == 404
    needed = http.delete("/kpl/pos_car1")
    assert needed.status_code == 409
    assert "slow" in needed.json()["detail"]
    assert http.delete("/streams/pos_car1").status_code == 409
    assert http.delete("/streams/slow").status_code == 403
    assert http.post("/kpl", content="x", headers={"Content-Type": "text/html"}).status_code == 415
    assert http.post("/kpl?unit=h", content=CARS, headers=TEXT).status_code == 422


def test_integers_are_in_the_unit_asked_for(http: httpx.Client) -> None:
    found = http.post("/kpl?unit=s", content=CARS, headers=TEXT).json()
    assert found[2]["text"] == (
        "stream slow = pos[car1] with sample every 200000, max delay 100000"
    )


def test_removed_with_all_that_needs_it(http: httpx.Client) -> None:
    http.post("/kpl", content=CARS, headers=TEXT)
    removed = http.delete("/kpl/pos_car1?cascade=true").json()
    assert removed == {"removed": ["slow", "pos[car1]", "pos_car1"]}
    assert http.get("/streams/slow").status_code == 404
    assert [one["name"] for one in http.get("/streams").json()] == ["status"]


def test_an_open_source_takes_what_comes_first(http: httpx.Client) -> None:
    http.post("/kpl", content="source pos raw\nstrmgen pos = raw\nstream p = pos", headers=TEXT)
    first = http.post(
        "/streams/raw/samples", content='{"valid": 1, "x": 1, "y": null}\n', headers=LINES
    )
    assert first.status_code == 400
    assert "'y' has no value" in first.json()["detail"]
    body = '{"valid": 1, "x": 1, "y": "a"}\n{"valid": 2, "x": 2.5, "y": null}\n'
    assert http.post("/streams/raw/samples", content=body, headers=LINES).status_code == 202
    known = http.get("/streams/p").json()["fields"]
    assert [(field["name"], field["type"]) for field in known] == [("x", "float"), ("y", "string")]
    wrong = http.post("/streams/raw/samples", content='{"valid": 3, "x": 1}\n', headers=LINES)
    assert wrong.status_code == 400


def test_the_command_line(url: str, client: Client) -> None:
    def run(*arguments: str) -> tuple[int, str]:
        result = CliRunner().invoke(commands, ["kpl", *arguments, "--url", url])
        return result.exit_code, result.output

    assert run("show") == (0, "nothing is declared yet: dyknow kpl add FILE\n")
    status, said = run("add", CARS)
    assert (status, said) == (0, CARS.lstrip())
    assert run("add", CARS)[1] == "nothing new: an equal declaration exists for each\n"
    assert run("show")[1] == CARS.lstrip()
    assert "used by" in run("show", "pos[car1]")[1]
    status, said = run("remove", "pos_car1")
    assert status == 1
    assert run("remove", "pos_car1", "--cascade")[1] == "removed slow, pos[car1], pos_car1\n"
    assert client.kpl() == []


@pytest.mark.parametrize("deadline", ["2s", None])
@pytest.mark.parametrize("way", ["exit", "interrupt"])
def test_a_unit_that_ends_the_program_fails_and_its_publisher_does_not(
    settings: Settings, clock, deadline: str | None, way: str
) -> None:
    known = Processes()

    @known.computational_unit("out", ["pos"], on_error="stop", deadline=deadline)
    def Leave(time, samples, state):
        if way == "interrupt":
            raise KeyboardInterrupt
        sys.exit(3)

    watchdog = Watchdog()
    engine = Engine(epoch="e1", processes=known, runner=watchdog)
    text = "sort pos = float\nsort out = float\nsource pos place\n"
    text += "compunit out Leave(pos)\nstrmgen p = place\nstrmgen left = Leave(p)\nstream s = left"
    with (
        running(create_app(engine, settings, clock), settings) as url,
        asking(url) as http,
    ):
        answer = http.post("/kpl", content=text, headers=TEXT)
        assert answer.status_code == 201, answer.text
        for _ in range(2):
            publish(http, "place", (280, 200, 1.0))
        found = http.get("/kpl/left").json()
        assert found["failure"].startswith("SystemExit: 3" if way == "exit" else "KeyboardInt")
    watchdog.close()
