"""Transformations, JSON annotations, qualities and strategies over HTTP, client and commands."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import httpx
import pytest
from places import ROOT

from dyknow.engine.engine import Engine
from dyknow.engine.processes.registry import Processes
from dyknow.service.client.client import Client

TURTLE = {"Content-Type": "text/turtle"}
LINES = {"Content-Type": "application/x-ndjson"}
SSL = "compunit glider transforms h:altitude(UAV) [ft] to spd:speed(UAV) [m.s-1]"
PREFIXES = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
"""
LISTING = """:{name} a :Transformation ; :hasAnnotation [
    :hasInputAnnotation [ :describesFeature dyknow:{feature} ; :describesSort dyknow:UAV ] ;
    :hasOutputAnnotation [ :describesFeature dyknow:speed ; :hasUnit "m.s-1" ;
        :describesSort dyknow:UAV ] ] ;
  :hasImplementation [ :hasName "Scaled" ] ;
  :hasParameter [ :hasName "factor" ; :hasText "3" ] ;
  :hasCost 2 ; :hasQuality 0.5 .
"""


@pytest.fixture
def engine() -> Engine:
    known = Processes()

    @known.computational_unit(output="speed", inputs=["altitude"])
    def Scaled(time: int, samples: Any, state: Any, *, factor: float = 2.0) -> Any:
        return factor * samples[0].value, state

    @known.sampled(sort="altitude", period="1s")
    def Altimeter(time: int) -> float:
        return 100.0

    return Engine(epoch="e1", processes=known)


def glider(**more: Any) -> dict[str, Any]:
    return {"annotation": SSL, "implementation": "Scaled"} | more


def described(name: str = "glider", **more: Any) -> dict[str, Any]:
    port = {"feature": "altitude", "field": "h", "unit": "ft", "of": ["UAV"]}
    output = {"feature": "dyknow:speed", "field": "spd", "unit": "m.s-1", "of": ["UAV"]}
    return {"name": name, "inputs": [port], "output": output, "implementation": "Scaled"} | more


@pytest.mark.parametrize("body", [glider(), described()], ids=["SSL", "in names"])
def test_registered_read_changed_and_removed(http: httpx.Client, body: dict[str, Any]) -> None:
    body |= {"parameters": {"factor": 3}, "cost": 2, "quality": 0.5}
    answer = http.post("/transformations", json=body)
    assert answer.status_code == 201, answer.text
    assert answer.headers["Location"] == "/transformations/glider"
    found = answer.json()
    assert found["text"] == "glider : altitude[UAV] ⇒ speed[UAV]"
    assert (found["cost"], found["quality"], found["lacks"]) == (2.0, 0.5, "")
    assert found["parameters"] == {"factor": "3"}
    assert found["inputs"][0]["of"] == [
        {"name": "dyknow:UAV", "as": "UAV", "id": None, "every": True}
    ]
    assert http.get("/transformations/glider").json() == found
    assert [one["name"] for one in http.get("/transformations").json()] == [
        "coordinatesToSpeed",
        "glider",
    ]
    # What is shown may be sent again, and changes nothing.
    shown = {key: found[key] for key in ("name", "inputs", "output", "implementation")}
    shown |= {key: found[key] for key in ("parameters", "cost", "quality")}
    again = http.put("/transformations/glider", json=shown)
    assert again.status_code == 200, again.text
    assert {**again.json(), "annotation": ""} == {**found, "annotation": ""}
    changed = http.patch("/transformations/glider", json={"quality": 0.25})
    assert (changed.json()["cost"], changed.json()["quality"]) == (2.0, 0.25)
    assert http.delete("/transformations/glider").status_code == 204
    for method in ("GET", "DELETE"):
        assert http.request(method, "/transformations/glider").status_code == 404
    assert "coordinatesToSpeed" in http.get("/transformations/glider").json()["hint"]


def test_a_plan_uses_it(http: httpx.Client) -> None:
    http.post("/transformations", json=glider())
    http.post(
        "/annotations",
        content="stream h contains altitude(UAV) = alt [m] for every UAV = id",
        headers={"Content-Type": "text/plain"},
    )
    found = http.post("/match", json={"feature": "speed", "objects": ["dyknow:uav1"]}).json()
    assert found["found"]
    assert "glider" in found["plan"]["text"]
    assert (found["quality"], found["proven"]) == (1.0, True)
    assert found["cost"] >= 1.0
    view = http.post("/subscriptions", json={"feature": "speed", "objects": ["uav1"]}).json()
    row = '{"valid": 1000000000, "available": 1000000000, "id": "uav1", "alt": 100}\n'
    assert http.post("/streams/h/samples", content=row, headers=LINES).status_code == 202
    (sample,) = http.get(
        f"/streams/{view['stream']}/samples", headers={"Accept": "application/json"}
    ).json()
    # 100 m are 328.08 ft; twice that, as m/s, in km/h.
    assert sample["speed"] == pytest.approx(2 * 100 / 0.3048 * 3.6)
    refused = http.delete("/transformations/glider")
    assert refused.status_code == 409
    assert "cancel" in refused.json()["hint"]


def test_turtle_is_registered_whole_or_not_at_all(http: httpx.Client) -> None:
    one = PREFIXES + LISTING.format(name="one", feature="altitude")
    two = LISTING.format(name="two", feature="altitude")
    bad = LISTING.format(name="bad", feature="altitud")
    refused = http.post("/transformations", content=one + two + bad, headers=TURTLE)
    assert refused.status_code == 404
    assert "altitude" in refused.json()["hint"]
    assert len(http.get("/transformations").json()) == 1
    answer = http.post("/transformations", content=one + two, headers=TURTLE)
    assert answer.status_code == 201, answer.text
    assert [found["name"] for found in answer.json()] == ["one", "two"]
    assert "Location" not in answer.headers
    assert answer.json()[0]["parameters"] == {"factor": "3"}
    put = http.put("/transformations/three", content=one, headers=TURTLE)
    assert put.status_code == 409
    three = PREFIXES + LISTING.format(name="three", feature="altitude")
    put = http.put("/transformations/three", content=three, headers=TURTLE)
    assert (put.status_code, put.headers["Location"]) == (201, "/transformations/three")


def test_a_source(http: httpx.Client) -> None:
    body = {"annotation": "source altimeter provides h:altitude(self) [ft]"}
    answer = http.post("/transformations", json=body | {"implementation": "Altimeter"})
    assert answer.status_code == 201, answer.text
    found = answer.json()
    assert (found["kind"], found["inputs"]) == ("source", [])
    assert found["output"]["of"] == [{"name": "self", "as": "self", "id": None, "every": False}]
    in_names = {"name": "other", "output": {"feature": "altitude", "of": ["self"]}}
    answer = http.post("/transformations", json=in_names | {"implementation": "Altimeter"})
    assert answer.status_code == 201, answer.text


CYCLE = (
    PREFIXES
    + """:c a :Transformation ; :hasAnnotation :A .
:A :hasInputAnnotation :S ; :hasOutputAnnotation [ :describesFeature dyknow:speed ] .
:S :describesFeature dyknow:altitude ; :nextSegment :A ."""
)


@pytest.mark.parametrize(
    ("body", "status", "said"),
    [
        (glider(annotation="compunit glider trnsforms a:b to c:d"), 400, "is not allowed here"),
        (glider(annotation=SSL + " " + SSL), 400, "twice"),
        (glider(annotation="stream s contains speed(uav1) = v"), 400, "one declaration"),
        (glider(annotation=""), 400, "one declaration"),
        (glider(implementation="Scald"), 404, "Scald"),
        (glider(parameters={"factr": 1}), 400, "factr"),
        (glider(parameters={"factor": "much"}), 400, "a number"),
        (glider(quality=2), 422, "less than or equal to 1"),
        (glider(quality=-0.1), 422, "greater than or equal to 0"),
        (glider(cost=-1), 422, "greater than or equal to 0"),
        (glider(colour="red"), 422, "colour"),
        (glider(annotation=SSL.replace("glider", "selectObject")), 403, "system's own"),
        (glider(annotation=SSL.replace("glider", "dyknow_x")), 403, "system's own"),
        (glider(annotation=SSL.replace("glider", "Stream")), 403, "system's own"),
        (glider(annotation=SSL.replace("glider", "coordinatesToSpeed")), 409, "PUT"),
        (glider(annotation=SSL.replace("h:altitude(UAV) [ft]", "a:altitude, b:altitude"),
                implementation="coordinatesToSpeed", parameters={"factor": 1}), 400, "factor"),
        (glider(implementation="coordinatesToSpeed"), 409, "2 inputs"),
        (glider(implementation="Altimeter"), 409, "no input"),
        (described(name="a b"), 400, "no name of a transformation"),
        (described(name="status"), 403, "system's own"),
        (described(output={"feature": "sped"}), 404, "speed"),
        (described(output={"feature": "speed", "unit": "kg"}), 400, "[mass]"),
        (described(output={"feature": "speed", "field": "valid"}), 400, "sample's time"),
        (described(output={"feature": "speed", "of": ["UAV", "UAV"]}), 400, "one name"),
        (described(inputs=[{"feature": "altitude", "field": "h"}] * 2), 400, "two inputs"),
        (described(inputs=[{"feature": "altitude"}] * 1_000), 422, "at most 100"),
        ({}, 400, "neither way"),
        (glider() | described(), 400, "both ways"),
        ({"name": "x"}, 400, "no output"),
        ({"output": {"feature": "speed"}}, 400, "no name"),
        ([], 422, "body"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_json(http: httpx.Client, body: Any, status: int, said: str) -> None:
    answer = http.post("/transformations", json=body)
    assert answer.status_code == status, answer.text
    assert said in answer.text
    assert len(http.get("/transformations").json()) == 1


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("@prefix : <", "line"),
        ("<http://a> <http://b> <http://c> .", "no :Transformation"),
        (PREFIXES + ":x a :Transformation .", "says not what it gives"),
        (PREFIXES + LISTING.format(name="x", feature="altitude").replace("2 ;", '"much" ;'),
         "a number"),
        (PREFIXES + LISTING.format(name="x", feature="altitude").replace("0.5", "2"), "0 to 1"),
        (PREFIXES + LISTING.format(name="x", feature="altitude").replace("0.5", '"NaN"'),
         "0 to 1"),
        (CYCLE, "comes back to itself"),
        (PREFIXES + ":x a :Transformation ; :hasAnnotation :a0 . :a0 :hasOutputAnnotation [\n"
         ":describesFeature dyknow:speed ] .\n" + "".join(
            f":a{i} :hasInputAnnotation :s{i} . :s{i} :describesFeature dyknow:altitude ;"
            f' :hasName "f{i}" ; :nextSegment :a{i + 1} .\n' for i in range(5_000)),
         "at most 100 inputs"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_turtle(http: httpx.Client, text: str, said: str) -> None:
    answer = http.post("/transformations", content=text, headers=TURTLE)
    assert answer.status_code == 400, answer.text
    assert said in answer.text
    assert len(http.get("/transformations").json()) == 1


def test_bodies_that_are_none(http: httpx.Client) -> None:
    def post(content: bytes, kind: str) -> httpx.Response:
        return http.post("/transformations", content=content, headers={"Content-Type": kind})

    assert post(b"{", "application/json").status_code == 400
    assert post(b'{"annotation": "x", "quality": NaN}', "application/json").status_code == 422
    assert post(b"x", "text/html").status_code == 415
    assert post(b"\xff", "text/turtle").status_code == 400
    assert post(b" " * (1 << 21), "text/turtle").status_code == 413
    wrong = http.post("/transformations", json=glider(annotation="compunit g\ntransforms x"))
    assert (wrong.json()["line"], wrong.json()["title"]) == (2, "syntax error")
    broken = post(PREFIXES.encode() + b":x a ;", "text/turtle").json()
    assert (broken["line"], broken["column"] > 0) == (3, True)


def test_taken_names_and_what_comes_with_the_system(http: httpx.Client) -> None:
    assert http.post("/transformations", json=glider()).status_code == 201
    assert http.post("/transformations", json=glider(cost=3)).status_code == 409
    assert http.put("/transformations/glider", json=glider(cost=3)).json()["cost"] == 3.0
    assert http.put("/transformations/other", json=glider()).status_code == 409
    assert http.delete("/transformations/coordinatesToSpeed").status_code == 409
    assert http.patch("/transformations/nothing", json={"cost": 1}).status_code == 404
    assert http.patch("/transformations/glider", json={"cost": -1}).status_code == 422
    allowed = http.post("/transformations/glider").headers["Allow"]
    assert {each.strip() for each in allowed.split(",")} == {
        "GET",
        "HEAD",
        "PUT",
        "PATCH",
        "DELETE",
    }


# -- annotations and qualities -----------------------------------------------------------------


def contents(stream: str = "s1", **more: Any) -> dict[str, Any]:
    whose = {"name": "UAV", "id": "id"}
    content = {"feature": "dyknow:speed", "field": "spd", "unit": "m.s-1", "of": [whose]}
    return {"stream": stream, "contents": [content | more]}


def test_streams_are_annotated_in_json(http: httpx.Client) -> None:
    answer = http.post("/annotations", json=contents())
    assert answer.status_code == 201, answer.text
    assert answer.json()[0]["features"] == ["http://www.ida.liu.se/dyknow/speed"]
    several = [contents("s2"), contents("s3", feature="dyknow:nothing")]
    refused = http.post("/annotations", json=several)
    assert refused.status_code == 404
    assert http.get("/streams/s2").status_code == 404
    several[1] = contents("s3", of=["uav1"])
    assert http.post("/annotations", json=several).status_code == 201
    found = http.post("/match", json={"feature": "speed", "objects": ["uav1"]}).json()
    assert found["found"]
    fields = http.get("/streams/s2").json()["fields"]
    assert {field["name"] for field in fields} == {"id", "spd"}


@pytest.mark.parametrize(
    ("body", "status", "said"),
    [
        (contents(of=["UAV"]), 400, "no field names the object"),
        (contents(unit="kg"), 400, "[mass]"),
        (contents(field="available"), 400, "sample's time"),
        (contents("status"), 403, "system's own"),
        ([contents(), contents()], 400, "described twice"),
        ({"stream": "s1", "contents": []}, 422, "at least 1"),
        ({"stream": "s1"}, 400, "either stream and contents, or name and output"),
        (contents() | {"name": "f", "output": {"feature": "speed"}}, 400, "either stream"),
        (contents(of=[{"name": "Truck", "id": "id", "every": True}]), 400, "no sort of the"),
        (contents(of=[{"name": "UAC", "id": "id"}]), 400, "did you mean UAV"),
        (contents(of=[{"name": "UAV", "id": "id", "every": False}]), 400, "is a sort"),
        (contents(of=[{"name": "UAV", "id": "id"}, "uav1"]), 400, "has 1 argument, not 2"),
        (contents(of=[{"name": "lorry7", "id": "id", "every": False}]), 201, "lorry7 = id"),
        ([], 201, ""),
        (5, 422, "body"),
    ],
)
def test_json_annotations_that_are_wrong(
    http: httpx.Client, body: Any, status: int, said: str
) -> None:
    answer = http.post("/annotations", json=body)
    assert answer.status_code == status, answer.text
    assert said in answer.text


def test_what_is_shown_of_annotations_can_be_sent_again(http: httpx.Client) -> None:
    truck = {"name": "http://example.org/fleet#truck_7", "id": "who (id)", "every": False}
    several = [contents("s1", of=[truck]), contents("s2")]
    assert http.post("/annotations", json=several).status_code == 201
    http.post("/transformations", json=described())
    shown = http.get("/annotations").json()
    text = http.get("/annotations", headers={"Accept": "text/plain"}).text
    assert '<http://example.org/fleet#truck_7> = "who (id)"' in text
    again = http.post("/annotations", json=shown)
    assert again.status_code == 201, again.text
    # Line breaks of SSL are not kept in JSON.
    for one in [*shown, *(answered := http.get("/annotations").json())]:
        one["source"] = " ".join(one["source"].split())
    assert answered == shown
    again = http.post("/annotations", content=text, headers={"Content-Type": "text/plain"})
    assert again.status_code == 201, again.text
    assert http.get("/annotations", headers={"Accept": "text/plain"}).text == text
    turtle = http.get("/annotations", headers={"Accept": "text/turtle"}).text
    http.post("/annotations", json=contents("s1"))
    again = http.post("/annotations", content=turtle, headers={"Content-Type": "text/turtle"})
    assert again.status_code == 201, again.text
    assert http.get("/annotations", headers={"Accept": "text/turtle"}).text == turtle
    empty = http.post(
        "/annotations", content="<s:a> <s:b> <s:c> .", headers={"Content-Type": "text/turtle"}
    )
    assert (empty.status_code, "annotates no :Stream" in empty.text) == (400, True)


def test_the_quality_of_a_stream_decides(http: httpx.Client) -> None:
    http.post("/annotations", json=[contents("s1"), contents("s2")])
    assert http.put("/streams/s1/quality", json={"quality": 0.5}).status_code == 204
    wanted = {"feature": "speed", "sort": "UAV", "strategy": "quality"}
    found = http.post("/match", json=wanted).json()
    assert (found["plan"]["streams"], found["quality"]) == (["s2"], 1.0)
    assert http.put("/streams/s2/quality", json={"quality": 0.25}).status_code == 204
    found = http.post("/match", json=wanted).json()
    assert (found["plan"]["streams"], found["quality"]) == (["s1"], 0.5)
    assert http.put("/streams/nope/quality", json={"quality": 0.5}).status_code == 404
    for body in (b'{"quality": 2}', b'{"quality": NaN}', b'{"quality": "good"}', b"{}"):
        answer = http.put(
            "/streams/s1/quality", content=body, headers={"Content-Type": "application/json"}
        )
        assert answer.status_code == 422, answer.text


# -- strategies --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "strategy",
    ["fast", "cost", "quality", "weighted", "weighted:cost=1,quality=10", "cost:subscribers=0.1"],
)
def test_every_strategy_matches(http: httpx.Client, strategy: str) -> None:
    http.post("/annotations", json=contents())
    found = http.post(
        "/match", json={"feature": "speed", "sort": "UAV", "strategy": strategy}
    ).json()
    assert found["plan"]["streams"] == ["s1"]
    assert http.get(f"/explain?feature=speed&sort=UAV&strategy={strategy}").status_code == 200


@pytest.mark.parametrize(
    ("strategy", "said"),
    [
        ("cheap", "fast, cost, quality, weighted"),
        ("", "no strategy"),
        ("fast:cost=1", "no parameter"),
        ("cost:subscribers=nan", "a number"),
        ("weighted:quality=-1", "a number"),
    ],
)
def test_an_unknown_strategy_is_refused_everywhere(
    http: httpx.Client, strategy: str, said: str
) -> None:
    template = (ROOT / "templates" / "library" / "high_speed.rq").read_text()
    http.post("/templates", content=template, headers={"Content-Type": "text/plain"})
    wanted = {"feature": "speed", "sort": "UAV", "strategy": strategy}
    event = {"event": "HighSpeedEvent", "arguments": ["?o", "dyknow:UAV", "100"]}
    for path, body in (
        ("/match", wanted),
        ("/subscriptions", wanted),
        ("/events", event | {"strategy": strategy}),
    ):
        answer = http.post(path, json=body)
        assert answer.status_code == 400, (path, answer.text)
        assert said in answer.json()["detail"]
    assert http.get("/subscriptions").json() == []


# -- client and commands -----------------------------------------------------------------------


def test_the_client_has_a_method_for_each(client: Client) -> None:
    (made,) = client.register_transformation(glider())
    turtle = PREFIXES + LISTING.format(name="one", feature="altitude")
    assert [one["name"] for one in client.register_transformation(turtle)] == ["one"]
    client.register_transformation(glider(cost=5), replace="glider")
    assert client.transformation("glider")["cost"] == 5.0
    assert client.change_transformation("one", cost=7)["cost"] == 7.0
    client.remove_transformation("one")
    assert [one["name"] for one in client.transformations()] == ["coordinatesToSpeed", made["name"]]
    assert client.describe(contents())[0]["name"] == "s1"
    client.set_quality("s1", 0.5)
    found = client.match("speed", sort="UAV", strategy="quality")
    assert found["quality"] == 0.5


def test_transformations_on_the_command_line(dyknow: Any, tmp_path: Path) -> None:
    turtle, body = tmp_path / "one.ttl", tmp_path / "glider.json"
    turtle.write_text(PREFIXES + LISTING.format(name="one", feature="altitude"))
    body.write_text(json.dumps(described()))
    said = dyknow("transformation", "add", str(turtle)).stdout
    assert said == "registered one : altitude[UAV] ⇒ speed[UAV]\n"
    dyknow("transformation", "add", str(body))
    options = ["--implementation", "Scaled", "--parameter", "factor=3", "--quality", "0.5"]
    made = dyknow(
        "transformation", "add", "--annotation", SSL.replace("glider", "two"), *options, "--json"
    )
    assert json.loads(made.stdout)["parameters"] == {"factor": "3"}
    listed = dyknow("transformation", "list").stdout
    assert [line.split()[0] for line in listed.splitlines()[1:]] == [
        "coordinatesToSpeed",
        "one",
        "glider",
        "two",
    ]
    shown = dyknow("transformation", "show", "one").stdout
    assert "altitude[UAV] ⇒ speed[UAV]" in shown
    assert "0.5" in shown
    assert json.loads(dyknow("transformation", "show", "one", "--json").stdout)["cost"] == 2.0
    dyknow("transformation", "add", "--annotation", SSL, *options, "--replace", "glider")
    assert dyknow("transformation", "remove", "one").stdout == "removed one\n"
    assert "no transformation" in dyknow("transformation", "show", "one", status=1).stderr
    wrong = dyknow("transformation", "add", "--annotation", "compunit x", status=1)
    assert "line 1" in wrong.stderr
    dyknow("transformation", "add", status=2)
    dyknow("transformation", "add", str(turtle), "--annotation", SSL, status=2)
    dyknow("transformation", "add", "--annotation", SSL, "--parameter", "factor", status=2)
    dyknow("transformation", "add", str(turtle), "--cost", "3", status=2)


def test_match_on_the_command_line(dyknow: Any, client: Client) -> None:
    client.describe(contents())
    said = dyknow("match", "speed", "--object", "uav1", "--strategy", "quality").stdout
    assert "s1" in said
    assert "quality 1" in said
    assert "no strategy" in dyknow("match", "speed", "--strategy", "cheap", status=1).stderr
