"""Specifications over HTTP and on the command line ([Introspection15 §3.2])."""

XML = "application/xml"
SPEC = """<?xml version="1.0" encoding="UTF-8"?>
<spec:specification xmlns:spec="http://www.dyknow.eu/ontology#Specification">
  <spec:insertions>
    <spec:cu name="speeds" type="coordinatesToSpeed">
      <spec:parameter name="baseline" value="10s"/>
      <spec:stream name="positions"/>
    </spec:cu>
  </spec:insertions>
</spec:specification>"""
REMOVE = """<s:specification xmlns:s="http://www.dyknow.eu/ontology#Specification">
  <s:removals><s:cu name="speeds"/></s:removals></s:specification>"""


def send(http, text):
    return http.post("/specifications", content=text, headers={"Content-Type": XML})


def declare(http):
    fields = {"id": "string", "latitude": "float", "longitude": "float"}
    assert http.put("/streams/positions", json={"fields": fields}).status_code == 201


def test_a_specification_is_applied_shown_and_taken_back(http):
    declare(http)
    answer = send(http, SPEC)
    assert answer.status_code == 200, answer.text
    (unit,) = answer.json()["started"]
    assert (unit["transformation"], unit["inputs"]) == ("coordinatesToSpeed", ["positions"])
    assert unit["parameters"]["baseline"] == "10s"
    assert http.get("/streams/speeds").status_code == 200
    again = send(http, SPEC).json()
    assert (again["started"], [u["name"] for u in again["there"]]) == ([], [unit["name"]])
    (listed,) = http.get("/specifications").json()
    assert (listed["name"], listed["failure"]) == ("speeds", None)
    current = http.get("/specifications/current")
    assert current.headers["content-type"].startswith(XML)
    assert send(http, current.text).json()["started"] == []
    assert [u["name"] for u in send(http, REMOVE).json()["stopped"]] == [unit["name"]]
    assert http.get("/specifications").json() == []


def test_what_cannot_be_applied_has_its_place(http):
    problem = send(http, SPEC)
    assert problem.status_code == 400
    assert problem.json()["line"] == 6
    assert "positions" in problem.json()["detail"]
    assert send(http, "<!DOCTYPE x><x/>").status_code == 400
    assert send(http, b"\xff\xfe\x00").status_code == 400
    assert send(http, "").status_code == 400
    refused = http.post("/specifications", content=SPEC, headers={"Content-Type": "text/plain"})
    assert refused.status_code == 415
