"""Logs of robots by the command line: inspected, then played by the commands that this prints."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import pytest
from robot_logs import MESSAGES, write_mcap, write_rosbag
from typer.testing import CliRunner

from dyknow.service.cli import app
from dyknow.service.client.client import Client

pytest.importorskip("mcap", reason="mcap is not installed: pip install 'dyknow[mcap]'")
pytest.importorskip("rosbags", reason="rosbags is not installed: pip install 'dyknow[rosbag]'")


def call(*words: str, status: int = 0, url: str = "") -> Any:
    found = CliRunner().invoke(app, list(words), env={"DYKNOW_URL": url})
    assert found.exit_code == status, (found.output, found.exception)
    return found


@pytest.mark.parametrize("name", ["a.mcap", "a.bag", "folder"])
def test_it_is_played_as_it_was_inspected(
    url: str, client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if name == "a.mcap":
        write_mcap(Path(name))
    else:
        write_rosbag(Path(name), 1 if name == "a.bag" else 2)
    told = call("inspect", name).stdout
    assert f"robot_odom: {MESSAGES} samples in 2s, 1/s (median), all in order" in told
    assert "note: /robot/odom: ranges is left out" in told
    assert "valid times by 'header.stamp', available times by its own column" in told
    for command in told.split("next:\n")[1].splitlines():
        words = shlex.split(command)[1:]
        played = call(*words, *["--speed", "max"] * (words[0] == "replay"), url=url).stdout
    assert "note: /robot/odom: ranges is left out" in played
    assert "dropouts" not in played
    events = client.events("robot_odom", since="start")
    (first, *_) = (event.data for event in events if event.kind == "sample")
    assert (first["available"], first["valid"]) == (
        "2021-10-07T14:10:01Z",
        "2021-10-07T14:10:00.9Z",
    )
    assert first["values"]["position.x"] == 0.5


def test_a_selected_topic_under_another_name(url: str, client: Client, tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap")
    words = ["replay", str(tmp_path / "a.mcap"), "--speed", "max", "--json"]
    found = call(*words, "--stream", "tags=labels", url=url)
    (told,) = map(json.loads, found.stdout.splitlines())
    assert (told["stream"], told["accepted"], told["evaluated"]) == ("labels", MESSAGES, MESSAGES)
    assert "dropouts" not in told


def test_a_folder_that_is_no_bag_is_wrong_usage(url: str, tmp_path: Path) -> None:
    found = call("replay", str(tmp_path), "--stream", "s", status=2, url=url)
    assert "is a folder" in " ".join(found.stderr.replace("│", " ").split())


def test_a_dotted_field_has_a_meaning(url: str, client: Client, tmp_path: Path) -> None:
    write_rosbag(tmp_path / "a.bag", 1)
    ssl = 'stream robot_odom contains altitude(uav1) = "position.x" [m]'
    words = ["replay", str(tmp_path / "a.bag"), "--speed", "max", "--ssl", ssl]
    call(*words, "--stream", "robot_odom", url=url)
    assert "altitude" in str(client.stream("robot_odom")["annotation"])


@pytest.mark.parametrize("name", ["a.mcap", "folder"])
def test_run_reads_a_stream_of_a_log(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    write_mcap(path) if name == "a.mcap" else write_rosbag(path, 2)
    ssl = (
        'stream robot_odom contains altitude(UAV) = "position.x" [m] '
        'for every UAV = "header.frame_id"'
    )
    query = tmp_path / "q"
    words = ["run", str(query), "--ssl", ssl, "--json", "--stream"]
    query.write_text("monitor low(?x in UAV) = altitude(?x) < 2 [m] with report verdicts")
    lines = call(*words, f"robot_odom={path}").stdout.splitlines()
    assert [json.loads(line)["values"]["verdict"] for line in lines] == ["true", "true", "false"]
    query.write_text(
        "REGISTER QUERY q AS SELECT ?v FROM STREAM <http://x/robot_odom> [RANGE 1s STEP 1s] "
        "WHERE { ?x dyknow:altitude ?v }"
    )
    lines = call(*words, f"http://x/robot_odom={path}").stdout.splitlines()
    assert len(lines) == MESSAGES
    query.write_text("monitor low(?x in UAV) = altitude(?x) < 2 [m]")
    words[3] = ssl.replace("robot_odom", "odom")
    told = call(*words, f"odom={path}", status=1).stderr
    assert "there is no stream 'odom' in this recording" in told
    assert "robot_odom, robot_volt" in told


def test_kpl_reads_a_log(tmp_path: Path) -> None:
    write_mcap(tmp_path / "a.mcap")
    file = tmp_path / "a.kpl"
    file.write_text(
        "sort row = (data float)\nsource row robot_volt\nstrmgen x = robot_volt\nstream t = x"
    )
    found = call("kpl", "run", str(file), str(tmp_path / "a.mcap"), "--json").stdout
    assert [json.loads(line)["data"] for line in found.splitlines()] == [12.5] * MESSAGES
