"""`dyknow replay` and `dyknow inspect` of files of RDF."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

import pytest
from command_line import run

from dyknow.service.client.client import Client

RESULT_TIME = "http://www.w3.org/ns/sosa/resultTime"
TRIG = """PREFIX xsd: <http://www.w3.org/2001/XMLSchema#>
<urn:g2> <http://www.w3.org/ns/prov#generatedAtTime> "2021-05-01T12:00:02Z"^^xsd:dateTime .
<urn:g1> <http://www.w3.org/ns/prov#generatedAtTime> "2021-05-01T12:00:01Z"^^xsd:dateTime .
<urn:g2> { <urn:a> <urn:p> 2 }
<urn:g1> { <urn:a> <urn:p> 1 ; <urn:q> <urn:b> }
"""
TURTLE = f"""PREFIX xsd: <http://www.w3.org/2001/XMLSchema#>
<urn:o> <{RESULT_TIME}> "2021-05-01T12:00:01Z"^^xsd:dateTime ; <urn:value> 5 .
"""


def numbers(client: Client, stream: str) -> list[tuple[str, Any]]:
    return [(each["available"][17:], each["number"]) for each in client.history(stream)]


def test_a_file_of_graphs_is_played_in_order_of_time(client: Client, tmp_path: Path) -> None:
    file = tmp_path / "facts.trig.gz"
    file.write_bytes(gzip.compress(TRIG.encode()))
    for _ in range(2):  # the second time into the stream that is there
        told = run("replay", file, "--stream", "facts", "--speed", "max", "--url", client.url)
        assert "3 samples accepted" in told.output
    assert client.stream("facts")["kind"] == "rdf"
    assert numbers(client, "facts")[:3] == [("01Z", 1), ("01Z", None), ("02Z", 2)]


def test_a_property_gives_the_times(client: Client, tmp_path: Path) -> None:
    file = tmp_path / "observations.ttl"
    file.write_text(TURTLE)
    play = ("replay", file, "--stream", "obs", "--speed", "max", "--url", client.url)
    assert "observations.ttl says no times" in run(*play, status=1).output
    assert "2 samples accepted" in run(*play, "--time-column", RESULT_TIME).output
    assert numbers(client, "obs") == [("01Z", None), ("01Z", 5)]


@pytest.mark.parametrize(
    ("text", "told"),
    [("<urn:a> <urn:p> oops .", "line 1: column"), ("", "holds no statement")],
)
def test_a_bad_file_is_told_of_and_nothing_declared(
    client: Client, tmp_path: Path, text: str, told: str
) -> None:
    file = tmp_path / "facts.nt"
    file.write_text(text)
    result = run("replay", file, "--stream", "facts", "--url", client.url, status=1)
    assert told in result.output
    assert [each["name"] for each in client.streams()] == ["status"]


def test_a_file_is_inspected(tmp_path: Path) -> None:
    file = tmp_path / "facts.trig"
    file.write_text(TRIG)
    shown = run("inspect", file).output
    assert "facts: 3 samples in 1s" in shown
    assert "it needs no SSL text" in shown
    assert f"dyknow replay {file} --stream facts" in shown.replace("\n", "")
