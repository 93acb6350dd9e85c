"""`dyknow serve FILE`: one command from a recording to the console."""

from __future__ import annotations

from pathlib import Path

import pytest
from serving import Serving, launch

TABLE = """time,robot,battery
2026-11-27T04:00:00Z,r1,80
2026-11-27T04:00:01Z,r1,79
"""
SSL = "stream my_robot contains speed(UAV) = battery for every UAV = robot"


@pytest.mark.parametrize("ssl", [None, SSL])
def test_a_recording_is_played_into_a_stream_of_its_name(tmp_path: Path, ssl: str | None) -> None:
    file = tmp_path / "my robot.csv"
    file.write_text(TABLE)
    given = () if ssl is None else ("--ssl", ssl)
    # With tokens it has one of its own.
    tokens = {"DYKNOW_TOKENS": "read me read-me-0123456789-0123456789"}
    with Serving(None, str(file), *given, **tokens) as serving:
        serving.http.headers["Authorization"] = "Bearer read-me-0123456789-0123456789"
        path = "/streams/my_robot/samples"
        serving.until(lambda: serving.http.get(path).text.count("\n") == 2)
        assert '"battery":79' in serving.http.get(path).text
        if ssl is not None:
            told = serving.until(lambda: serving.http.get("/streams/my_robot").json()["annotation"])
            assert told == ssl
        assert serving.stop() == 0


def test_a_file_that_cannot_be_played_does_not_end_the_service(tmp_path: Path) -> None:
    file = tmp_path / "untimed.csv"
    file.write_text("a,b\n1,2\n")
    with Serving(None, str(file)) as serving:
        serving.until(lambda: "no column is called" in serving.log)
        assert serving.http.get("/healthz").status_code == 200


def test_an_annotation_needs_a_recording() -> None:
    assert launch("serve", "--ssl", SSL).wait() == 2
