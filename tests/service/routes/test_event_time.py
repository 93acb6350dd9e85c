"""Late samples and idle streams over HTTP, with the client and on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest
from typer.testing import CliRunner, Result

from dyknow.engine.engine import Engine
from dyknow.service.cli import app
from dyknow.service.client.client import Client, ServiceError
from dyknow.streams.time import SECOND

FIELDS = {"id": "string", "spd": "float"}
SSL = "stream {} contains speed(UAV) = spd [km.h-1] for every UAV = id"


@pytest.fixture
def engine(clock: Any) -> Engine:
    """It knows the time before the first tick, as in `dyknow serve`."""
    return Engine(epoch="e1", now=clock.now)


def sample(second: float, available: float | None = None) -> dict[str, Any]:
    time = int(second * 1e9)
    at = time if available is None else int(available * 1e9)
    return {"valid": time, "available": at, "id": "uav1", "spd": 1.0}


def test_late_samples_over_http(client: Client, http: httpx.Client) -> None:
    client.put_stream("s", FIELDS, lateness="2s")
    client.publish("s", [sample(10)])
    assert client.stream("s_late")["fields"] == client.stream("s")["fields"]
    client.publish("s", [sample(3), sample(9), sample(2)])
    client.end("s")
    messages = list(client.events("s_late", since="start"))
    assert [one.kind for one in messages] == ["sample", "sample", "end"]
    assert [one.data["available"] for one in messages[:2]] == [
        "1970-01-01T00:00:10Z",
        "1970-01-01T00:00:10Z",
    ]
    assert [row["valid"] for row in client.history("s_late")] == [
        "1970-01-01T00:00:03Z",
        "1970-01-01T00:00:02Z",
    ]
    assert "s_late" in [stream["name"] for stream in client.streams()]
    assert client.stream("s")["counters"]["late"] == 2
    assert http.post("/streams/s_late/end").status_code == 403
    client.remove_stream("s_late")
    assert "s_late" not in [stream["name"] for stream in client.streams()]
    with pytest.raises(ServiceError) as refused:
        client.put_stream("other_late", FIELDS)
    assert refused.value.status == 403


def test_idle_over_http(client: Client, clock: Any) -> None:
    for name, idle in (("s", None), ("t", "10s")):
        client.put_stream(name, FIELDS, idle=idle)
        client.annotate(SSL.format(name))
    assert client.stream("s")["idle"] is None
    assert (client.stream("t")["idle"], client.stream("t")["is_idle"]) == ("10s", False)
    clauses = " ".join(
        f"FROM STREAM <http://www.ida.liu.se/dyknow/{name}.trdf> [RANGE 5s STEP 5s]"
        for name in ("s", "t")
    )
    text = f"REGISTER QUERY n AS SELECT (COUNT(?v) AS ?n) {clauses} WHERE {{ ?o dyknow:speed ?v }}"
    client.register_query(text)
    client.publish("s", [sample(1), sample(6)])
    client.publish("t", [sample(2)])
    found = client.query("n")
    assert found["waits_for"] == []
    assert (found["watermark"], found["held_back_by"]) == ("1970-01-01T00:00:02Z", ["t"])
    events = client.events("n", since="start")
    clock.now += 10 * SECOND
    assert next(events).values == {"n": 2}  # nobody waits for t any more
    assert client.stream("t")["is_idle"]
    assert client.put_stream("t", FIELDS)["idle"] is None
    assert not client.stream("t")["is_idle"]


@pytest.mark.parametrize("idle", [0, -1, "soon", "0s", 2**63])
def test_an_idle_that_is_none(http: httpx.Client, idle: Any) -> None:
    answer = http.put("/streams/s", json={"fields": FIELDS, "idle": idle})
    assert answer.status_code == 422
    assert "idle" in str(answer.json()["errors"])
    assert http.get("/streams/s").status_code == 404


def test_replay_declares_what_is_idle(url: str, client: Client, tmp_path: Path) -> None:
    def dyknow(*arguments: str) -> Result:
        return CliRunner().invoke(app, list(arguments), env={"DYKNOW_URL": url})

    path = tmp_path / "s.csv"
    path.write_text("timestamp,id,spd\n1,uav1,2.5\n2,uav1,3\n")
    result = dyknow("replay", str(path), "--stream", "s", "--speed", "max", "--idle", "10s")
    assert result.exit_code == 0, result.output
    assert client.stream("s")["idle"] == "10s"
    shown = dyknow("streams", "s").output
    assert "idle  10s" in shown
