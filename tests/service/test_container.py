"""The container's files say what the program knows: settings, options, paths, a health check that
checks. No engine is at hand; `docker/check` tries the rest without one."""

from __future__ import annotations

import configparser
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import httpx
import pytest
import yaml
from places import ROOT
from waiting import HANGS

from dyknow.engine.engine import Engine
from dyknow.service.admission.tokens import (
    Scope,
    Tokens,
    TokensError,
    line_of,
    new_token,
)
from dyknow.service.app import create_app
from dyknow.service.cli.main import command as command_of
from dyknow.service.config.file_limits import RESERVED
from dyknow.service.config.settings import Settings
from dyknow.service.runtime.context import Service
from dyknow.service.server import GRACE, running
from dyknow.streams.time import Clock

DOCKERFILE = (ROOT / "docker" / "Dockerfile").read_text()
UNIT = ROOT / "docker" / "dyknow.service"
GIB = 1 << 30


@pytest.fixture(scope="module")
def compose() -> dict[str, Any]:
    found: dict[str, Any] = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text())
    return found


@pytest.fixture(scope="module")
def service(compose: dict[str, Any]) -> dict[str, Any]:
    (found,) = compose["services"].values()
    return dict(found)


def last(instruction: str) -> str:
    """What the Dockerfile says last of it: that is what holds."""
    text = DOCKERFILE.replace("\\\n", " ")
    return re.findall(rf"^{instruction} (.*)$", text, re.MULTILINE)[-1]


def seconds(text: str) -> float:
    match = re.fullmatch(r"(\d+)(s|m)", text)
    assert match is not None
    return int(match[1]) * {"s": 1, "m": 60}[match[2]]


def settings_of(environment: dict[str, str]) -> Settings:
    """Names are settings, and values are of their types."""
    names = {name.removeprefix("DYKNOW_").lower(): value for name, value in environment.items()}
    assert all(name.startswith("DYKNOW_") for name in environment)
    assert names.keys() <= Settings.model_fields.keys()
    return Settings(**names)  # type: ignore[arg-type]


def test_what_is_built_is_there(service: dict[str, Any]) -> None:
    context = ROOT / "docker" / service["build"]["context"]
    assert (context / service["build"]["dockerfile"]).read_text() == DOCKERFILE
    assert context.resolve() == ROOT
    for script in re.findall(r"/source/(\S+)", DOCKERFILE):
        assert (ROOT / script).is_file()


def test_the_command_is_one_and_its_paths_agree(service: dict[str, Any]) -> None:
    assert json.loads(last("ENTRYPOINT")) == ["dyknow"]
    command, *options = json.loads(last("CMD"))
    known = command_of(command)
    context = known.make_context(command, options)
    assert str(context.params["data"]) == last("VOLUME")
    assert context.params["host"] == "0.0.0.0"
    (volume,) = service["volumes"]
    assert volume.partition(":")[2] == last("VOLUME")
    (port,) = service["ports"]
    assert port == f"127.0.0.1:8000:{context.params['port']}"
    assert last("EXPOSE") == str(context.params["port"])


def test_nobody_is_root_and_only_the_data_may_be_written(service: dict[str, Any]) -> None:
    assert last("USER") == "dyknow"
    assert re.search(r"useradd .*--uid 10001 --gid 10001 --home-dir /data .* dyknow", DOCKERFILE)
    assert re.search(r"groupadd .*--gid 10001 dyknow", DOCKERFILE)
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["init"] is True


def test_the_settings_are_settings(service: dict[str, Any]) -> None:
    settings = settings_of(service["environment"])
    assert settings.log_json
    # Time to stop, and a checkpoint at the end.
    assert seconds(service["stop_grace_period"]) >= settings.drain + GRACE + 20
    files = service["ulimits"]["nofile"]
    assert min(files["soft"], files["hard"]) >= settings.max_connections + RESERVED


def test_tokens_are_a_secret_that_is_in_no_image_and_no_commit(
    compose: dict[str, Any], service: dict[str, Any]
) -> None:
    (name,) = service["secrets"]
    assert settings_of(service["environment"]).tokens_file == Path("/run/secrets") / name
    file = Path("docker") / compose["secrets"][name]["file"]
    assert str(file) in (ROOT / ".dockerignore").read_text().splitlines()
    assert f"/{file}" in (ROOT / ".gitignore").read_text().splitlines()


def test_the_service_may_read_the_tokens_and_nobody_else(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A secret that is a file keeps its owner and mode: what the comments say makes one that the
    container's user may use."""
    command = r"sudo install -m (\d+) -o \"\$\(id -u\)\" -g (\d+) /dev/null docker/tokens.txt"
    for text in ("docker/compose.yaml", "docs/how-to/deploy.md"):
        (found,) = re.findall(command, (ROOT / text).read_text())
        mode, group = int(found[0], 8), int(found[1])
        assert f"--uid {group} --gid {group}" in DOCKERFILE
        assert mode & 0o040
        path = tmp_path / "tokens.txt"
        path.write_text("")
        path.chmod(mode)
        token = line_of([Scope.READ], "me", new_token())
        path.write_text(token)  # by its owner, in place
        assert len(Tokens.of(Settings(tokens_file=path))) == 1
        # Another's, and made without that: the container's user is told what to do.
        path.chmod(0o644)
        monkeypatch.setattr(os, "geteuid", lambda: 10001)
        monkeypatch.setattr(os, "getegid", lambda: 10001)
        monkeypatch.setattr(os, "getgroups", lambda: [10001])
        with pytest.raises(TokensError) as caught:
            Tokens.of(Settings(tokens_file=path))
        assert f"chgrp 10001 {path}; chmod 640 {path}" in caught.value.hint
        groups = [10001, path.stat().st_gid]
        monkeypatch.setattr(os, "getgroups", groups.copy)
        with pytest.raises(TokensError) as caught:
            Tokens.of(Settings(tokens_file=path))
        assert caught.value.hint == f"chmod 640 {path}"
        monkeypatch.undo()


def test_a_file_that_the_service_may_not_read_says_who_it_is(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(TokensError, match="Permission denied") as caught:
        Tokens.of(Settings(tokens_file=tmp_path / "tokens"))
    assert f"chgrp {os.getegid()} " in caught.value.hint


def test_the_health_check_says_whether_it_is_ready(
    engine: Engine, settings: Settings, clock: Clock
) -> None:
    options, _, command = last("HEALTHCHECK").partition(" CMD ")
    # The very first start compiles the loops.
    assert seconds(re.findall(r"--start-period=(\w+)", options)[0]) >= 60
    python, *arguments = json.loads(command)
    assert python == "python"
    app = create_app(engine, settings, clock)
    found: Service = app.state.service
    with running(app, settings) as url:
        arguments[-1] = arguments[-1].replace("http://127.0.0.1:8000", url)
        assert url in arguments[-1]

        def check() -> int:
            return subprocess.run([sys.executable, *arguments], capture_output=True).returncode

        end = time.monotonic() + 120
        while httpx.get(f"{url}/readyz", trust_env=False, timeout=60).status_code != 200:
            assert time.monotonic() < end
        assert check() == 0
        found.troubles["journal"] = "no room"
        assert check() != 0
    assert check() != 0


def test_the_container_has_limits_that_suffice(service: dict[str, Any]) -> None:
    """docs/reference/metrics.md, "Memory": at least a gibibyte."""
    limits = service["deploy"]["resources"]["limits"]
    assert int(limits["memory"].removesuffix("G")) * GIB >= GIB
    assert float(limits["cpus"]) >= 1
    assert limits["pids"] >= 100


@pytest.fixture(scope="module")
def unit() -> configparser.SectionProxy:
    """The section of the service; a name that is there twice would be an error."""
    found = configparser.ConfigParser(interpolation=None)
    found.optionxform = str  # type: ignore[assignment, method-assign]
    found.read_string(UNIT.read_text())
    return found["Service"]


def test_the_unit_of_systemd_is_one_of_this_program(unit: configparser.SectionProxy) -> None:
    program, command, *options = shlex.split(unit["ExecStart"])
    assert program.endswith("/dyknow")
    known = command_of(command)
    # The folder of the tokens is of that machine.
    made = [each if each != "/etc/dyknow/tokens" else __file__ for each in options]
    data = known.make_context(command, made).params["data"]
    assert str(data) == f"/var/lib/{unit['StateDirectory']}"
    environment = dict(each.split("=", 1) for each in shlex.split(unit["Environment"]))
    # Not a setting: numba reads it.
    assert environment.pop("NUMBA_CACHE_DIR") == f"/var/cache/{unit['CacheDirectory']}"
    settings = settings_of(environment)
    assert int(unit["TimeoutStopSec"]) > settings.drain + GRACE
    assert int(unit["LimitNOFILE"]) >= settings.max_connections + RESERVED
    assert "-HUP" in unit["ExecReload"]
    assert int(unit["MemoryMax"].removesuffix("G")) * GIB >= GIB


def test_the_unit_of_systemd_may_write_its_own_folders_only(
    unit: configparser.SectionProxy,
) -> None:
    assert unit["ProtectSystem"] == "strict"
    assert unit["User"] not in ("", "root")
    assert unit["CapabilityBoundingSet"] == ""
    assert "ReadWritePaths" not in unit
    for name in ("NoNewPrivileges", "ProtectHome", "PrivateTmp", "PrivateDevices"):
        assert unit[name] == "yes", name
    # The compiler of the loops makes memory that is written and then run.
    assert "MemoryDenyWriteExecute" not in unit


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="there is no systemd-analyze")
def test_systemd_knows_every_line_of_the_unit(tmp_path: Path) -> None:
    path = tmp_path / UNIT.name
    # The program is where the unit is installed, not here.
    path.write_text(UNIT.read_text().replace("/opt/dyknow/bin/dyknow", sys.executable))
    done = subprocess.run(
        ["systemd-analyze", "verify", "--recursive-errors=no", str(path)],
        capture_output=True,
        text=True,
        timeout=HANGS,
    )
    assert (done.returncode, done.stderr) == (0, "")
