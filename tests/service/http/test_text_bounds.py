"""What one request may declare, and who reads it: XML another process, SSL and KPL another thread
than the one in which everybody waits (docs/explanation/isolation.md)."""

from __future__ import annotations

import threading

import httpx
import pytest

from dyknow.service.config.text_bounds import (
    MOST_CONTENTS,
    MOST_DECLARATIONS,
    MOST_ELEMENTS,
    MOST_PARTS,
    MOST_WORDS,
)
from dyknow.service.http import text_limits
from dyknow.service.models.parts import MOST_ARGUMENTS

TEXT = {"Content-Type": "text/plain"}
XML = {"Content-Type": "application/xml"}
FIELDS = {"fields": {"id": "string", "v": "float"}}
SPEED = "stream {} contains speed(UAV) = v for every UAV = id"
HEAD = '<specification xmlns="http://www.dyknow.eu/ontology#Specification">'
POLICY = (
    '<cu type="policy"><parameter name="policy" value="sample every {}"/><stream name="s"/></cu>'
)
TRANSFORMATION = """:t{} a :Transformation ; :hasAnnotation [
  :hasInputAnnotation [ :describesFeature dyknow:latitude ;
    :nextSegment [ :hasInputAnnotation [ :describesFeature dyknow:longitude ] ] ] ;
  :hasOutputAnnotation [ :describesFeature dyknow:speed ; :hasUnit "m.s-1" ] ] ;
  :hasImplementation [ :hasName "coordinatesToSpeed" ] ."""
PREFIXES = """@prefix : <http://www.dyknow.eu/ontology#> .
@prefix dyknow: <http://www.ida.liu.se/dyknow/> .
"""


def too_long(answer: httpx.Response) -> str:
    assert answer.status_code == 413, answer.text
    problem = answer.json()
    assert problem["title"] == "text too long"
    assert problem["hint"] == text_limits.IN_PARTS
    return str(problem["detail"])


def specification(*parts: str, what: str = "insertions") -> str:
    return f"{HEAD}<{what}>{''.join(parts)}</{what}></specification>"


def test_what_ssl_may_declare_in_one_text(http: httpx.Client) -> None:
    def send(text: str) -> httpx.Response:
        return http.post("/annotations", content=text, headers=TEXT)

    # Seven words and signs each, and three before them.
    contents = [f"speed(uav{i}) = v" for i in range((MOST_WORDS - 3) // 7)]
    assert send("stream s contains " + ", ".join(contents)).status_code == 201
    contents.append("speed(self) = v")
    assert "words and signs" in too_long(send("stream s contains " + ", ".join(contents)))
    short = "\n".join(f"stream s{i} contains speed(uav1)=v" for i in range(MOST_DECLARATIONS + 1))
    assert f"{MOST_DECLARATIONS} declarations" in too_long(send(short))
    # White space at the end is no word, and a comment ends with a carriage return, too.
    text = "stream s contains " + ", ".join(contents[:-1])
    least = MOST_WORDS - 2 - 7 * (len(contents) - 1) + 1
    assert "words" not in send(f"{text}{' a' * (least - 1)}\n ").json()["detail"]
    assert "words and signs" in too_long(send(f"{text}{' a' * least}"))
    many = "stream s contains " + ", ".join(contents)
    assert "words and signs" in too_long(send(f"#\r{many}"))
    # Comments are no words, and a word that nothing is said after is an error as before.
    assert send(SPEED.format("t") + " # and so on" * MOST_WORDS).status_code == 201
    assert send("stream").json()["line"] == 1


def test_what_json_may_annotate_in_one_body(http: httpx.Client) -> None:
    def send(streams: int, contents: int) -> httpx.Response:
        return http.post(
            "/annotations",
            json=[
                {
                    "stream": f"s{number}",
                    "contents": [
                        {"feature": "dyknow:speed", "field": "v", "of": [f"uav{each}"]}
                        for each in range(contents)
                    ],
                }
                for number in range(streams)
            ],
        )

    assert send(2, MOST_CONTENTS // 2).status_code == 201
    assert f"{MOST_CONTENTS} contents" in too_long(send(2, MOST_CONTENTS // 2 + 1))
    assert send(MOST_DECLARATIONS + 1, 1).status_code == 422
    assert http.get("/streams/s2").status_code == 404


def test_what_kpl_may_declare_in_one_text(http: httpx.Client) -> None:
    def send(text: str) -> httpx.Response:
        return http.post("/kpl", content=text, headers=TEXT)

    sources = "\n".join(f"source float a{i}" for i in range(MOST_DECLARATIONS))
    assert "declarations" in too_long(send(sources + "\nsource float b"))
    assert http.get("/kpl").json() == []
    assert len(send(sources).json()) == MOST_DECLARATIONS
    terms = ", ".join(f"a0 with sample every {i + 1}" for i in range(MOST_WORDS // 5))
    assert "words and signs" in too_long(send(f"strmgen j = join({terms})"))


def test_what_a_specification_may_hold(http: httpx.Client) -> None:
    def send(text: str) -> httpx.Response:
        return http.post("/specifications", content=text, headers=XML)

    http.put("/streams/s", json=FIELDS).raise_for_status()
    most = [POLICY.format(number + 1) for number in range(MOST_PARTS)]
    refused = send(specification(*most, POLICY.format(1_000_000)))
    assert (refused.status_code, refused.json()["line"]) == (400, 1)
    assert f"more than {MOST_PARTS} units to insert" in refused.json()["detail"]
    assert http.get("/specifications").json() == []
    assert len(send(specification(*most)).json()["started"]) == MOST_PARTS
    gone = ['<cu name="s"/>'] * (MOST_PARTS + 1)
    detail = send(specification(*gone, what="removals")).json()["detail"]
    assert f"more than {MOST_PARTS} units to remove" in detail
    many = '<cu type="synchronize">' + '<stream name="s"/>' * MOST_ELEMENTS + "</cu>"
    assert f"more than {MOST_ELEMENTS} elements" in send(specification(many)).json()["detail"]


def test_how_many_transformations_a_text_may_describe(http: httpx.Client) -> None:
    several = [TRANSFORMATION.format(number) for number in range(MOST_DECLARATIONS + 1)]
    turtle = {"Content-Type": "text/turtle"}
    text = PREFIXES + "\n".join(several)
    before = len(http.get("/transformations").json())
    assert "declarations" in too_long(http.post("/transformations", content=text, headers=turtle))
    assert len(http.get("/transformations").json()) == before
    text = PREFIXES + "\n".join(several[:-1])
    made = http.post("/transformations", content=text, headers=turtle)
    assert len(made.json()) == MOST_DECLARATIONS


def test_specifications_are_read_by_another_process(
    http: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never(text: object) -> None:
        raise AssertionError("it is read here")

    for module in ("engine.engine", "engine.specification.specifications", "service.workers.jobs"):
        monkeypatch.setattr(f"dyknow.{module}.parse_specification", never)
    http.put("/streams/s", json=FIELDS).raise_for_status()
    answer = http.post("/specifications", content=specification(POLICY.format(7)), headers=XML)
    assert answer.json()["started"][0]["parameters"] == {"term": "s with sample every 7"}
    wrong = http.post("/specifications", content=f"{HEAD}\n  <cux/></specification>", headers=XML)
    assert wrong.status_code == 400
    assert (wrong.json()["line"], wrong.json()["column"]) == (2, 4)
    assert "`cux` is not an element of a specification" in wrong.json()["detail"]


@pytest.mark.parametrize(
    ("path", "parser", "text"),
    [
        ("/annotations", "parse_ssl", SPEED.format("s")),
        ("/kpl", "parse_kpl", "source float a_source"),
    ],
)
def test_declarations_are_parsed_in_another_thread(
    http: httpx.Client, monkeypatch: pytest.MonkeyPatch, path: str, parser: str, text: str
) -> None:
    parse = getattr(text_limits, parser)
    work = parse._work
    threads = []

    def noted(source: str) -> object:
        threads.append(threading.current_thread().name)
        return work(source)

    monkeypatch.setattr(parse, "_work", noted)
    text = f"{text} # that nobody has read yet"
    assert http.post(path, content=text, headers=TEXT).status_code == 201
    # The engine has found it read.
    assert len(threads) == 1
    assert "AnyIO worker" in threads[0]


def test_how_many_arguments_a_wanted_feature_may_have(http: httpx.Client) -> None:
    for path in ("/match", "/subscriptions"):
        wanted = {"feature": "dyknow:speed", "objects": ["dyknow:uav1"] * MOST_ARGUMENTS}
        assert http.post(path, json=wanted).status_code in (200, 201)
        wanted["objects"] += ["dyknow:uav1"]
        assert http.post(path, json=wanted).status_code == 422
