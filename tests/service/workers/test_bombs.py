"""What is made to stop the service is refused or stopped alone (promise P7,
docs/explanation/isolation.md).

The service is a process of its own, as one that is shot at may die.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import httpx
import pytest
from asking import asking
from bombs import NDJSON, SPARQL, SSL, TEXT, WINDOWS, Bomb, documents, evaluations, query, texts
from launching import Forked
from serving import Serving
from waiting import HANGS, until

PATIENCE = 5.0
"""Seconds within which others are answered while a bomb is dealt with: of a machine that does other
things, too. A service that hangs takes longer than any of these."""
DEADLINES = {
    "DYKNOW_SPARQL_DEADLINE": "1",
    "DYKNOW_QUERY_DEADLINE": "0.5",
    "DYKNOW_ONTOLOGY_DEADLINE": "2",
    "DYKNOW_WORKER_MEMORY": str(256 << 20),
}


@dataclass
class Served:
    """A service in a process of its own."""

    process: Forked
    http: httpx.Client
    worst: float = 0.0
    failures: list[str] = field(default_factory=list)

    def watch(self, stop: threading.Event) -> None:
        """Ask for something small all the time."""
        with asking(self.http.base_url) as http:
            while not stop.is_set():
                begin = time.monotonic()
                try:
                    http.get("/streams/s5").raise_for_status()
                except httpx.HTTPError as error:
                    self.failures.append(repr(error))
                    return
                self.worst = max(self.worst, time.monotonic() - begin)
                stop.wait(0.01)

    def shoot(self, bomb: Bomb) -> httpx.Response:
        """The answer; asserts that it is right, and that others are answered meanwhile."""
        stop = threading.Event()
        self.worst, self.failures = 0.0, []
        others = threading.Thread(target=self.watch, args=(stop,))
        others.start()
        try:
            answer = self.http.request(
                bomb.method, bomb.path, content=bomb.body, headers={"Content-Type": bomb.kind}
            )
        finally:
            stop.set()
            others.join()
        assert answer.status_code in bomb.statuses, (answer.status_code, answer.text[:500])
        if answer.status_code >= 400:
            problem = answer.json()
            assert problem["detail"]
            assert len(answer.content) < 100_000  # an error does not send all of it back
        assert self.process.poll() is None
        assert not self.failures
        assert self.worst < PATIENCE
        return answer


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    with Serving(None, **DEADLINES) as serving:
        fields = {"id": "string", "spd": "float"}
        serving.http.put("/streams/s5", json={"fields": fields}).raise_for_status()
        serving.http.post("/annotations", content=SSL, headers={"Content-Type": TEXT})
        yield Served(serving.process, serving.http)


@pytest.mark.parametrize("open", ["(", "ABS("])
def test_what_is_as_deep_as_allowed_is_answered(served: Served, open: str) -> None:
    """The bound is reached before Python's own, which counts the frames of the server, too."""
    where = f"?o dyknow:speed ?v . FILTER({open * 60}?v{')' * 60} > 1)"
    asked = Bomb("", "POST", "/sparql", SPARQL, f"SELECT * {{ {where} }}", (200,))
    served.shoot(asked)
    name = "deep" if open == "(" else "deeper"
    served.shoot(Bomb("", "POST", "/queries", TEXT, query(where, name), (201,)))


def test_eight_texts_at_once(served: Served) -> None:
    """One after the other they took minutes, with nobody else's text parsed meanwhile."""
    bombs = [bomb for bomb in texts() if "sums after <" in bomb.name]
    with ThreadPoolExecutor(8) as pool:
        answers = list(pool.map(lambda n: _sent(served, bombs[n % len(bombs)]), range(8)))
    assert {answer.status_code for answer in answers} == {400}
    assert served.process.poll() is None


def _sent(served: Served, bomb: Bomb) -> httpx.Response:
    with asking(served.http.base_url) as http:
        headers = {"Content-Type": bomb.kind}
        return http.request(bomb.method, bomb.path, content=bomb.body, headers=headers)


SHORT = {
    "/kpl": "strmgen a = " + "f(" * 500 + "s5" + ")" * 500,
    "/annotations": "stream s5 contains speed" + "(" * 900 + ")" * 900 + " = spd",
    "/specifications": "<a>" * 10_000 + "</a>" * 10_000,
}
"""What is short enough to be parsed."""


def named(bomb: Bomb) -> str:
    return bomb.name


@pytest.mark.parametrize("bomb", list(texts()), ids=named)
def test_texts(served: Served, bomb: Bomb) -> None:
    served.shoot(bomb)


@pytest.mark.parametrize("path", SHORT)
def test_texts_that_are_parsed(served: Served, path: str) -> None:
    kind = "application/xml" if path == "/specifications" else TEXT
    served.shoot(Bomb(path, "POST", path, kind, SHORT[path]))


@pytest.mark.parametrize("bomb", list(documents()), ids=named)
def test_documents(served: Served, bomb: Bomb) -> None:
    served.shoot(bomb)


@pytest.mark.parametrize("bomb", list(evaluations()), ids=named)
def test_evaluations(served: Served, bomb: Bomb) -> None:
    served.shoot(bomb)


def test_queries_are_answered_after_the_bombs(served: Served) -> None:
    answer = served.http.get("/sparql", params={"query": "ASK { ?s a owl:Class }"})
    assert answer.json()["boolean"] is True


def samples(second: int) -> str:
    rows: list[dict[str, Any]] = []
    for number in range(400):
        valid = second * 1_000_000_000 + number
        rows.append({"valid": valid, "available": valid, "id": f"u{number}", "spd": float(number)})
    return "\n".join(map(json.dumps, rows))


def evaluated(http: httpx.Client, query: str) -> bool:
    return http.get(f"/queries/{query}").json()["state"] in ("failed", "ended")


@pytest.mark.parametrize("name", WINDOWS)
def test_a_query_whose_windows_explode_is_stopped_alone(served: Served, name: str) -> None:
    http = served.http
    stream = f"s_{name}"
    fields = {"id": "string", "spd": "float"}
    assert http.put(f"/streams/{stream}", json={"fields": fields}).status_code == 201
    for text in (SSL.replace("s5", stream), "REGISTER QUERY"):
        if text.startswith("stream"):
            http.post("/annotations", content=text, headers={"Content-Type": TEXT})
    register = WINDOWS[name].replace("/s5.trdf", f"/{stream}.trdf")
    served.shoot(Bomb(name, "POST", "/queries", TEXT, register, (201,)))
    other = (
        f"REGISTER QUERY beside_{name} AS PREFIX dyknow: <http://www.ida.liu.se/dyknow/>\n"
        "SELECT (COUNT(*) AS ?n) FROM STREAM "
        f"<http://www.ida.liu.se/dyknow/{stream}.trdf> [RANGE 5s STEP 1s]\n"
        "WHERE { ?o dyknow:speed ?v }"
    )
    assert http.post("/queries", content=other, headers={"Content-Type": TEXT}).status_code == 201
    for second in range(1, 7):
        path = f"/streams/{stream}/samples"
        batch = Bomb(name, "POST", path, NDJSON, samples(second), (202, 429))
        # 429: its queries are behind, and it is to be sent again.
        until(lambda batch=batch: served.shoot(batch).status_code == 202, HANGS)
    assert http.post(f"/streams/{stream}/end").status_code == 204
    # The windows of what has been accepted are evaluated as soon as their turn comes.
    until(lambda: evaluated(http, name) and evaluated(http, f"beside_{name}"), HANGS)
    found = http.get(f"/queries/{name}").json()
    assert found["state"] == "failed"
    assert "Quarantined: 3 windows in a row" in found["failure"]
    beside = http.get(f"/queries/beside_{name}").json()
    assert beside["state"] == "ended"
    assert beside["windows"] == 11
    history = http.get("/streams/status/samples", params={"limit": 10_000})
    told = [json.loads(line) for line in history.text.splitlines()]
    failed = [one for one in told if one["change"] == "unit failed"]
    failures = [one["specification"] for one in failed if one["stream"] == name]
    assert sum(" has no result: " in each for each in failures) == 3
    assert any("Quarantined" in each for each in failures)
    for each in (name, f"beside_{name}"):
        assert http.delete(f"/queries/{each}").status_code == 204
