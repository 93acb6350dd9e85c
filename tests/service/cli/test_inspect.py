"""``dyknow inspect``: what it shows, and that its SSL text and its next commands work."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest
from pages import blocks
from places import ROOT
from typer.testing import CliRunner
from ulog_bytes import TWO_TOPICS

from dyknow.languages.ssl import check_ssl, parse_ssl
from dyknow.ontology.ontology import Ontology
from dyknow.service.cli import app
from dyknow.service.client.client import Client

EXAMPLE = "examples/adsb.csv.gz"
GERMAN = "Zeit;Id;Speed;pos.x;ok\n07.10.2021 14:10:01;a;31,5;1;true\n07.10.2021 14:10:02;a;;2;\n"
DOMAIN = """@prefix : <http://example.org/#> . @prefix o: <http://www.dyknow.eu/ontology#> .
:posX a o:Feature ."""


def skeleton(path: Path, *options: str) -> str:
    """The SSL text that the command writes for a recording."""
    target = path.with_suffix(".ssl")
    call("inspect", str(path), "--skeleton", str(target), *options)
    return target.read_text()


def call(*words: str, status: int = 0, url: str = "") -> Any:
    found = CliRunner().invoke(app, list(words), env={"DYKNOW_URL": url})
    assert found.exit_code == status, (found.output, found.exception)
    return found


def features(text: str, ontology: str | None = None) -> list[tuple[str, str]]:
    """The features and fields of an SSL text, which must be right."""
    known = Ontology.open(None)
    if ontology is not None:
        known.load(ontology, name="urn:domain", format="turtle")
    checked = check_ssl(parse_ssl(text), text, known.vocabulary)
    return [(c.feature.split("/")[-1], c.field) for one in checked for c in one.contents]  # type: ignore[union-attr]


def test_the_page_shows_what_it_prints(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    page = ROOT / "docs" / "reference" / "command-line.md"
    (shown,) = [b.text for b in blocks(page) if b.text.startswith("adsb: ")]
    told = call("inspect", EXAMPLE).stdout
    assert [line.rstrip() for line in told.splitlines()] == shown.splitlines()


def test_the_next_commands_write_the_text_and_play_by_it(
    url: str, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("my table.csv").write_text(GERMAN)
    options = ["--time-column", "Zeit", "--time-format", "day-first"]
    told = call("inspect", "my table.csv", *options).stdout
    first, second = told.split("next:\n")[1].splitlines()
    written = call(*shlex.split(first)[1:]).stdout
    assert "The SSL text is in my table.ssl." in written
    assert written.split("next:\n")[1].splitlines() == [second]
    again = call(*shlex.split(first)[1:], status=1).stderr
    assert "there is a file my table.ssl already" in again
    call(*shlex.split(second)[1:], "--speed", "max", url=url)
    stream = client.stream("my_table")
    assert stream["counters"]["used"] == 2
    assert "speed" in str(stream["annotation"])


def test_the_text_is_valid_before_and_after_it_is_filled_in(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    path.write_text(GERMAN)
    text = skeleton(path, "--time-column", "Zeit", "--time-format", "day-first")
    assert features(text) == [("speed", "Speed")]
    filled = text.replace('# , FEATURE(Thing) = "pos.x"', ', altitude(Thing) = "pos.x"')
    assert features(filled) == [("speed", "Speed"), ("altitude", "pos.x")]


def test_a_table_without_known_features_is_a_comment(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    path.write_text("time,a,b\n1,2,3\n")
    text = skeleton(path)
    assert features(text) == []
    filled = "stream s contains" + text.partition("# stream s contains")[2].replace("#", "")
    filled = filled.replace("a(", "altitude(").replace("b(", "track(")
    assert features(filled) == [("altitude", "a"), ("track", "b")]


def test_a_field_of_another_type_is_no_feature(tmp_path: Path) -> None:
    path = tmp_path / "s.csv"
    path.write_text("time,altitude,speed,on_ground,onGround,distance\n1,high,true,1,true,5\n")
    text = skeleton(path)
    assert features(text) == [("onGround", "onGround")]  # and distance is one of two objects


def test_a_text_is_a_feature_with_a_range(tmp_path: Path) -> None:
    of_text, of_number = "NAME --range xsd:string ", "NAME --unit UNIT "
    file = tmp_path / "robots.csv"
    file.write_text("time,robot,carrying\n1,r1,box\n2,r1,none\n")
    text = skeleton(file)
    assert of_text in text
    assert of_number not in text
    file = tmp_path / "loads.csv"
    file.write_text("time,robot,carrying,load\n1,r1,box,2.5\n2,r1,none,0.5\n")
    text = skeleton(file)
    assert of_text in text
    assert of_number in text


def test_features_of_a_domain_ontology(tmp_path: Path) -> None:
    (tmp_path / "s.csv").write_text(GERMAN.replace("pos.x", "pos_x"))
    (tmp_path / "domain.ttl").write_text(DOMAIN)
    words = ["--time-column", "Zeit", "--time-format", "day-first"]
    words += ["--ontology", str(tmp_path / "domain.ttl")]
    found = features(skeleton(tmp_path / "s.csv", *words), DOMAIN)
    assert found == [("speed", "Speed"), ("#posX", "pos_x")]
    told = call("inspect", str(tmp_path / "s.csv"), *words).stdout.partition("next:")[2]
    assert f"--ontology {tmp_path / 'domain.ttl'} --skeleton" in told


def test_a_flight_log(tmp_path: Path) -> None:
    pytest.importorskip("pyulog", reason="pyulog is not installed: pip install dyknow[px4]")
    path = tmp_path / "flight.ulg"
    path.write_bytes(TWO_TOPICS)
    told = call("inspect", str(path))
    assert "attitude: 3 samples" in told.stdout
    assert "by 'timestamp_sample', available times by its own column" in told.stdout
    assert "dropouts: 2, 0.042 s were not logged" in told.stdout
    assert f"dyknow replay {path} --ssl flight.ssl" in told.stdout
    lines = [json.loads(line) for line in call("inspect", str(path), "--json").stdout.splitlines()]
    assert [line["stream"] for line in lines] == ["attitude", "gps", "gps_1"]


def test_it_is_json_for_programs() -> None:
    (told,) = map(json.loads, call("inspect", str(ROOT / EXAMPLE), "--json").stdout.splitlines())
    text, fields = told.pop("ssl"), told.pop("fields")
    assert told == {
        "stream": "adsb",
        "samples": 8256,
        "first": "2021-10-07T14:10:01Z",
        "last": "2021-10-07T14:15:00Z",
        "rate": 1.0,
        "out_of_order": 0,
        "time_column": "timestamp",
        "has_available": False,
        "id_field": "icao24",
        "objects": 30,
    }
    assert ("latitude", "latitude") in features(text)
    assert fields[0] == {"name": "icao24", "type": "string", "feature": None}
    assert fields[2]["feature"] == "http://www.ida.liu.se/dyknow/latitude"


def test_what_is_no_recording_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("when,x\n1,1\n")
    assert "the columns are when, x" in call("inspect", str(tmp_path / "a.csv"), status=1).stderr
    assert call("inspect", str(tmp_path / "none.csv"), status=2).stderr


def test_a_service_knows_further_features(
    url: str, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = str(ROOT / "examples" / "robots.csv")
    assert "battery(Thing) = battery" in call("inspect", file).stdout
    call("ontology", "add-sort", "Robot", url=url)
    call("ontology", "add-feature", "battery", "--sort", "Robot", "--unit", "percent", url=url)
    told = call("inspect", file, "--url", url).stdout
    assert "stream robots contains\n  battery(Robot) = battery [percent]\n" in told
    assert "--sort Robot" in told
    assert "for every Robot = robot" in told
    write, play = told.partition("next:")[2].splitlines()[1:]
    for command in (write, play):
        call(*shlex.split(command)[1:], *(["--speed", "max"] * (command == play)))
    annotation = client.stream("robots")["annotation"]
    assert "battery(Robot) = battery [percent]" in annotation
