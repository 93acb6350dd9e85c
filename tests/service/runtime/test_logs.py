"""What is written to standard error: an object a line whatever happens, with the request's id, and
no token."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
import threading
import warnings
from pathlib import Path

import pytest
from launching import SERVICE
from serving import Serving

from dyknow.service.admission.tokens import new_token
from dyknow.service.config.logs import REQUEST, configure, log

FAILS = """
import asyncio, logging, threading, warnings
from dyknow.service import app
from dyknow.service.routes.introspection import status
async def broken():
    threading.Thread(target=lambda: 1 / 0).start()
    asyncio.get_running_loop().call_soon(lambda: {}["an error of the loop"])
    logging.getLogger("uvicorn.error").exception("of uvicorn", exc_info=ValueError("x\\ny"))
    logging.getLogger("somebody").warning("of %s", "a library")
    warnings.warn("of python")
    raise RuntimeError("of ours, with dyk_" + "s" * 43)
status.router.add_api_route("/broken", broken)
"""


def test_every_line_of_a_service_is_json_with_ids_and_without_tokens(tmp_path: Path) -> None:
    token, other = new_token(), "no-token-of-ours-0123456789"
    path = tmp_path / "tokens"
    path.write_text(f"admin me {token}\nread you {other}")
    path.chmod(0o600)
    variables = {
        "DYKNOW_LOG_LEVEL": "debug",
        "DYKNOW_SSE_PING": "inf",
        "DYKNOW_TOKENS": f"read env {new_token()}",
    }
    bearer = {"Authorization": f"Bearer {token}"}
    given = (tmp_path / "data", "--tokens", str(path))
    with Serving(*given, program=FAILS + SERVICE, **variables) as serving:
        http = serving.http
        serving.until(lambda: http.get("/readyz").status_code == 200)
        for secret in (token, other):
            for target in (
                f"/streams?token={secret}",
                f"/streams?access_token={secret}",
                f"/streams/s/events?since={token}",
                f"/streams/{token}",
            ):
                http.get(target, headers={"X-Request-Id": "mine"})
                http.get(target, headers=bearer)
            http.post("/session", json={"token": secret}).raise_for_status()
            http.post("/session", json={"tokens": secret})
            http.get("/streams", headers={"Authorization": f"Basic {secret}"})
        http.post("/kpl", content="source float \n", headers=bearer)
        failed = http.get("/broken", headers={**bearer, "X-Request-Id": "broken"})
        assert failed.status_code == 500
        path.write_text("nonsense")
        serving.process.send_signal(signal.SIGHUP)
        serving.until(lambda: "not taken" in serving.log)
        serving.stop()
    text = serving.log
    assert token not in text
    assert other not in text

    def refuse(word: str) -> float:
        raise AssertionError(f"{word} is not JSON")

    lines = [json.loads(line, parse_constant=refuse) for line in text.splitlines()]
    assert all({"event", "level", "timestamp"} <= line.keys() for line in lines)
    events = {line["event"] for line in lines}
    assert {"serving", "request", "refused", "request failed", "stopped"} <= events
    for line in lines:
        if line["event"] in ("request", "refused", "slow request", "request failed"):
            assert line["request"], line
    (of_ours,) = (line for line in lines if line["event"] == "request failed")
    assert of_ours["request"] == "broken"
    assert of_ours["exception"].endswith("RuntimeError: of ours, with dyk_***")
    of_uvicorn = [line for line in lines if line["event"] == "of uvicorn"]
    assert [line["exception"].splitlines()[-1] for line in of_uvicorn] == ["y"]
    # Within a request whoever writes a line has its id.
    assert [line["request"] for line in of_uvicorn] == ["broken"]
    assert "of a library" in events
    assert any("of python" in event for event in events)
    (of_thread,) = (line for line in lines if line["event"] == "thread failed")
    assert "ZeroDivisionError" in of_thread["exception"]
    assert any("an error of the loop" in line.get("exception", "") for line in lines)


def test_a_start_that_fails_says_so_in_json(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SERVICE, "serve", "--port", "0", "--tokens", "/nowhere"]
    variables = {**os.environ, "DYKNOW_LOG_JSON": "true"}
    done = subprocess.run(command, capture_output=True, text=True, env=variables, timeout=60)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "cannot be read" in json.loads(line)["detail"]


@pytest.mark.parametrize("as_json", [True, False])
def test_what_looks_like_a_token_is_not_written(
    capsys: pytest.CaptureFixture[str], as_json: bool
) -> None:
    configure("debug", as_json)
    secret = new_token()
    log().info("with one", path=f"/x/{secret}", head=f"Authorization: Bearer {secret[4:]}")
    log().info(f"?token={secret[4:]}&a=b")
    try:
        raise ValueError(f"of {secret}")
    except ValueError:
        log().exception("failed")
    told = capsys.readouterr().err
    assert secret[4:] not in told
    assert "a=b" in told
    assert told.count("***") == 4


def test_lines_within_a_request_have_its_id(capsys: pytest.CaptureFixture[str]) -> None:
    configure("info", as_json=True)
    before = REQUEST.set("r1")
    try:
        log().info("ours")
        log().info("of another", request="r2")
        logging.getLogger("else").warning("theirs")
    finally:
        REQUEST.reset(before)
    log().info("nobody's")
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [line.get("request") for line in lines] == ["r1", "r2", "r1", None]


def test_warnings_and_threads_that_end_are_lines(capsys: pytest.CaptureFixture[str]) -> None:
    configure("info", as_json=True)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        logging.captureWarnings(True)
        warnings.warn("old", stacklevel=1)
    thread = threading.Thread(target=lambda: [][1], name="mine")
    thread.start()
    thread.join()
    first, second = (json.loads(line) for line in capsys.readouterr().err.splitlines())
    assert "old" in first["event"]
    assert (second["thread"], second["level"]) == ("mine", "error")
    assert "IndexError" in second["exception"]
