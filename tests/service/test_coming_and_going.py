"""What comes and goes without end, over every route, leaves nothing in a service but what has a
bound."""

from __future__ import annotations

import gc
import json
from asyncio import AbstractEventLoop
from functools import _lru_cache_wrapper
from logging import Handler
from typing import Any

import httpx
import pytest
from asking import asking
from growing import entries, grown, growth
from uvicorn import Server

from dyknow.engine import engine, parts
from dyknow.engine.configuration import configuration, ingest
from dyknow.ontology import replicas
from dyknow.rdf.dictionary import TermDictionary
from dyknow.service.app import create_app
from dyknow.service.config.settings import Settings
from dyknow.service.server import running
from dyknow.service.turns.window_turns import WindowTurns
from dyknow.streams import history
from dyknow.streams.history import FluentStream, Retention
from dyknow.streams.time import SECOND

NDJSON = {"content-type": "application/x-ndjson"}
XML = {"content-type": "application/xml"}
FORMS = ("application/x-ndjson", "text/csv", "application/n-triples", "application/json")
TEMPLATE = """REGISTER TEMPLATE dyknow:{}Event(?o, ?type, ?limit) COMPUTE EVERY 1s AS
PREFIX dyknow: <http://www.ida.liu.se/dyknow/>
CONSTRUCT {{?o dyknow:speed ?average}}
WHERE {{ ?o a ?type . ?o dyknow:speed ?v . }}
AGGREGATE {{(?average, AVG, {{?v}}) FILTER (?average > ?limit)}}
WINDOW [RANGE {}s STEP 1s]"""
QUERY = """REGISTER QUERY q{0} COMPUTE EVERY 1s AS
SELECT ?o ?v FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 3s STEP 1s]
WHERE {{ ?o dyknow:speed ?v FILTER(?v > {0}) }}"""
MADE = """REGISTER QUERY made{0} AS SELECT ?o ?name
FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 3s STEP 1s]
WHERE {{ ?o dyknow:speed ?v BIND(IRI(CONCAT("http://x/{0}", STR(?v))) AS ?name) }}"""
PLACED = """REGISTER QUERY placed{0} AS SELECT ?o ?place
FROM STREAM <http://www.ida.liu.se/dyknow/s.trdf> [RANGE 3s STEP 1s]
FROM NAMED <http://example.org/places>
WHERE {{ ?o dyknow:speed ?v . GRAPH <http://example.org/places> {{ ?place a dyknow:Building }}
FILTER(?v > {1} && ?place != dyknow:none{0}) }}"""
PREFIXES = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
@prefix owl: <http://www.w3.org/2002/07/owl#> .
"""
TRANSFORMATION = """:listed{} a :Transformation ; :hasAnnotation [
  :hasInputAnnotation [ :describesFeature dyknow:latitude ;
    :nextSegment [ :hasInputAnnotation [ :describesFeature dyknow:longitude ] ] ] ;
  :hasOutputAnnotation [ :describesFeature dyknow:speed ; :hasUnit "m.s-1" ] ] ;
  :hasImplementation [ :hasName "coordinatesToSpeed" ] ."""
TURTLE = {"content-type": "text/turtle"}
FOREACH = """sort place = (id string, v float)
source place all_cars
source object cars_in_sight
strmgen positions = all_cars
strmgen cars = cars_in_sight
foreach car in cars {
  strmgen pos[car] = selectObject(positions)
}
strmgen places = aggregate(pos[car] foreach car in cars)"""
NAMESPACE = "http://www.dyknow.eu/ontology#Specification"
ROUNDS = 33
OUTSIDE = (TermDictionary, FluentStream, _lru_cache_wrapper, Handler, Server, AbstractEventLoop)
"""Terms are forgotten in jumps, as samples and texts of streams are; caches of libraries have a
bound; pytest keeps logs; the server and its loop have what goes on."""


class Using:
    """One who does all that can be asked for, each time by other names."""

    def __init__(self, http: httpx.Client, clock: Any) -> None:
        self._http = http
        self._clock = clock
        self._begun = clock.now
        self._send("PUT", "/streams/s", json=stream(retention={"samples": 20}, lateness="1s"))
        self._send("POST", "/annotations", content=annotation("s"))
        self._send("POST", "/templates", content=TEMPLATE.format("Standing", 5))
        self._send("PUT", "/streams/all_cars", json=stream(retention={"samples": 20}))
        self._send("POST", "/kpl", content=FOREACH)

    def round(self, number: int) -> None:
        name = f"{number:04}"
        self._clock.now = self._begun + number * 10 * SECOND
        self._send("POST", "/queries", content=QUERY.format(number))
        self._publish(name)
        self._follow(f"/streams/q{number}/events?since=start")
        self._send("GET", f"/queries/q{number}/results")
        self._send("DELETE", f"/queries/q{number}")
        self._request(name)
        self._subscribe(name)
        self._ask(name)
        self._declare(name)
        self._say_what_is_known(name)
        self._see_others(name)
        self._be_refused(name)

    def _publish(self, name: str) -> None:
        rows = self._rows(name)
        key = {"idempotency-key": name}
        for headers in (key, key, {}):
            self._send("POST", "/streams/s/samples", content=rows, headers=NDJSON | headers)
        late = json.dumps({"valid": self._begun, "available": self._begun, "id": "late", "v": 1})
        self._send("POST", "/streams/s/samples", content=late, headers=NDJSON)
        self._send("POST", "/streams/s/samples/live", content=f"{late}\n", headers=NDJSON)
        for form in FORMS:
            self._send("GET", "/streams/s/samples?limit=20", headers={"accept": form})

    def _request(self, name: str) -> None:
        self._send("POST", "/templates", content=TEMPLATE.format(f"T{name}", 5))
        arguments = (
            f"Standing(?o, dyknow:UAV, {int(name)})",
            f"Standing(dyknow:o{name}, dyknow:UAV, 5)",
        )
        texts = [
            each.replace("(", "Event(", 1) for each in (*arguments, f"T{name}(?o, dyknow:UAV, 5)")
        ]
        for text in texts:
            found = self._send("POST", "/events", content=f"dyknow:{text}")
            self._follow(found["events"])
            self._send("GET", f"/events/{found['id']}")
            self._send("DELETE", f"/events/{found['id']}")
        self._send("PUT", f"/templates/T{name}Event", content=TEMPLATE.format(f"T{name}", 6))
        self._send("DELETE", f"/templates/T{name}Event")

    def _subscribe(self, name: str) -> None:
        policy = f"sample every {int(name) + 1}ms"
        for wanted in (
            {"feature": "dyknow:speed", "objects": [f"dyknow:u{name}"]},
            {"feature": "dyknow:speed", "sort": "dyknow:UAV", "policy": policy},
            {"stream": "s", "policy": f"{policy}, max delay 2s"},
        ):
            found = self._send("POST", "/subscriptions", json=wanted)
            self._follow(f"/subscriptions/{found['id']}/events")
            self._send("DELETE", f"/subscriptions/{found['id']}")

    def _ask(self, name: str) -> None:
        for query in (
            f"SELECT ?s WHERE {{ ?s a ?t FILTER(?s != <x:{name}>) }} LIMIT 5",
            f"CONSTRUCT {{ <x:{name}> ?p ?o }} WHERE {{ ?s ?p ?o }} LIMIT 5",
        ):
            self._send("GET", "/sparql", params={"query": query})
        self._send("GET", "/explain", params={"query": QUERY.format(int(name))})
        self._send(
            "POST", "/match", json={"feature": "dyknow:speed", "objects": [f"dyknow:m{name}"]}
        )
        for path in ("/streams", "/metrics", "/status", "/events", "/specifications/current"):
            self._send("GET", path)

    def _declare(self, name: str) -> None:
        path = f"/streams/other{name}"
        self._send("PUT", path, json=stream())
        self._send("POST", "/annotations", content=annotation(f"other{name}"))
        self._send("POST", f"{path}/samples", content=self._rows(name), headers=NDJSON)
        self._send("PUT", f"{path}/quality", json={"quality": 0.5})
        self._follow(f"{path}/events?since=start")
        self._send("POST", f"{path}/end")
        self._send("DELETE", path)
        unit = f"compunit scaled{name} transforms lat:latitude, lon:longitude to spd:speed [m.s-1]"
        made = {"annotation": unit, "implementation": "coordinatesToSpeed"}
        self._send("POST", "/transformations", json={**made, "parameters": {"baseline": "10s"}})
        self._send("DELETE", f"/transformations/scaled{name}")
        kpl = f"source float source{name}\nstrmgen drawn{name} = source{name}"
        self._send("POST", "/kpl", content=kpl)
        self._send("DELETE", f"/kpl/source{name}?cascade=true")
        policy = '<parameter name="policy" value="sample every 1s"/><stream name="s"/>'
        inserted = specification(f'<cu name="slow{name}" type="policy">{policy}</cu>')
        self._send("POST", "/specifications", content=inserted, headers=XML)
        removed = specification(removals=f'<cu name="slow{name}"/>')
        self._send("POST", "/specifications", content=removed, headers=XML)

    def _say_what_is_known(self, name: str) -> None:
        """An ontology and a transformation in Turtle, and queries that read what is known."""
        places = f"dyknow:place{name} a dyknow:Building, owl:NamedIndividual ; dyknow:of{name} 1 ."
        path = "/ontologies?name=http://example.org/places"
        self._send("POST", path, content=PREFIXES + places, headers=TURTLE)
        made = PREFIXES + TRANSFORMATION.format(name)
        self._send("POST", "/transformations", content=made, headers=TURTLE)
        for query, called in ((MADE, "made"), (PLACED, "placed")):
            self._send("POST", "/queries", content=query.format(name, int(name)))
            self._publish(name)
            self._send("GET", f"/queries/{called}{name}")
            self._send("DELETE", f"/queries/{called}{name}")
        self._send("DELETE", f"/transformations/listed{name}")

    def _see_others(self, name: str) -> None:
        """Objects of which nobody has heard before come into sight, and those of before go."""
        seen = [f"car{name}", f"van{name}"]
        now = {"valid": self._clock.now, "available": self._clock.now}
        lines = [json.dumps({**now, "value": " ".join(seen)})]
        self._send("POST", "/streams/cars_in_sight/samples", content=lines[0], headers=NDJSON)
        lines = [
            json.dumps(
                {
                    "valid": now["valid"] + i,
                    "available": now["available"] + i,
                    "id": seen[i % 2],
                    "v": i,
                }
            )
            for i in range(1, 9)
        ]
        body = "\n".join(lines)
        self._send("POST", "/streams/all_cars/samples", content=body, headers=NDJSON)
        self._send("GET", "/kpl")

    def _be_refused(self, name: str) -> None:
        for path in (f"/{name}", f"/streams/{name}", f"/templates/{name}", f"/events/{name}"):
            self._send("GET", path, 404)
        for path in (
            "/templates",
            "/events",
            "/queries",
            "/kpl",
            "/annotations",
            "/transformations",
        ):
            self._send("POST", path, 400, content=f"{name} (")
        self._send("POST", "/specifications", 400, content=f"<s{name}/>", headers=XML)
        turtle = {"content-type": "text/turtle"}
        self._send("POST", "/ontologies", 400, content=f"<x:{name} a", headers=turtle)
        self._send("POST", "/streams/s/samples", 400, content=f'{{"{name}": 1}}', headers=NDJSON)
        self._send("POST", "/streams/s/samples", 415, headers={"content-type": f"x/{name}"})
        self._send("POST", f"/streams/none{name}/samples", 404, content="{}", headers=NDJSON)
        self._send("POST", "/events", 404, content=f"dyknow:No{name}Event(?o)")
        self._send(
            "POST", "/match", 404, json={"feature": f"dyknow:no{name}", "sort": "dyknow:UAV"}
        )
        self._send("GET", "/streams", 421, headers={"host": f"h{name}.example"})
        self._send("GET", "/streams", 403, headers={"origin": f"http://{name}.example"})
        own = {"user-agent": name, "x-request-id": name, "cookie": f"dyknow_session={name}"}
        self._send("GET", "/streams", headers=own)
        self._send(f"M{name}", "/streams", 400)

    def _rows(self, name: str) -> str:
        start = self._clock.now - 10 * SECOND
        times = range(start, self._clock.now, SECOND // 5)
        rows = [
            {"valid": t, "available": t, "id": f"u{i % 7}", "v": 1.0 * i}
            for i, t in enumerate(times)
        ]
        return "\n".join(map(json.dumps, rows))

    def _follow(self, path: str) -> None:
        """Begin to listen, and break off."""
        with self._http.stream("GET", path) as answer:
            answer.raise_for_status()

    def _send(self, method: str, path: str, status: int = 0, **given: Any) -> Any:
        answer = self._http.request(method, path, **given)
        right = answer.status_code == status if status else answer.is_success
        assert right, f"{method} {path}: {answer.status_code} {answer.text}"
        is_json = answer.headers.get("content-type", "").startswith("application/json")
        return answer.json() if is_json else None


def stream(**more: Any) -> dict[str, Any]:
    return {"fields": {"id": "string", "v": "float"}, **more}


def annotation(name: str) -> str:
    return f"stream {name} contains speed(UAV) = v for every UAV = id"


def specification(insertions: str = "", removals: str = "") -> str:
    return (
        f'<specification xmlns="{NAMESPACE}"><insertions>{insertions}</insertions>'
        f"<removals>{removals}</removals></specification>"
    )


@pytest.mark.long
def test_what_comes_and_goes_leaves_nothing(
    settings: Settings, clock: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What is kept of what was is kept of the last: of few, so that these have come soon.
    monkeypatch.setattr(replicas, "MOST", 0)
    monkeypatch.setattr(configuration, "_MOST_REMOVED", 10)
    monkeypatch.setattr(configuration, "RETENTION", Retention(samples=20))
    monkeypatch.setattr(ingest, "_KEYS_KEPT", 10)
    monkeypatch.setattr(history, "_TEXTS", 10)
    monkeypatch.setattr(parts, "RETENTION", Retention(samples=20))
    app = create_app(engine.Engine(turns=WindowTurns(5, 60)), settings, clock)
    sizes = []
    # What has a bound reaches it in the first third.
    third = ROUNDS // 3
    with (
        running(app, settings) as url,
        asking(url) as http,
    ):
        using = Using(http, clock)
        for number in range(ROUNDS):
            using.round(number)
            if number >= third:
                gc.collect()
                sizes.append(entries(app, *OUTSIDE))
    # One thing that stays of each round would be 11 more.
    before, after = sizes[:third], sizes[third:]
    assert grown(before, after) < 10, growth(before[-1], after[-1])
