"""`dyknow serve` as a process of its own, for tests that kill it, or do what a page says."""

from __future__ import annotations

import atexit
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
from functools import cache
from pathlib import Path

from asking import asking
from launching import SERVICE, Forked
from places import TESTS
from waiting import HANGS, PATIENCE, until

from dyknow.service.config.defaults import URL

HERE = TESTS / "support" / "services"
ANYWHERE = re.compile(r"http://[^\s\"]+")


@cache
def launcher() -> str:
    """The socket of this process's launcher (`launching`)."""
    folder = tempfile.TemporaryDirectory(prefix="launcher-")
    path = str(Path(folder.name) / "socket")
    variables = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "OPENBLAS_NUM_THREADS": "1",
    }
    process = subprocess.Popen(
        [sys.executable, HERE / "launcher.py", path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=variables,
    )

    def end() -> None:
        process.communicate()
        folder.cleanup()

    atexit.register(end)
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n"
    return path


def launch(
    *arguments: str, program: str = SERVICE, stdout: int = 1, stderr: int = 2, **environment: str
) -> Forked:
    """Start `dyknow` with these arguments, or another ``program``; the files are descriptors."""
    files = (0, stdout, stderr)
    return Forked(launcher(), program, list(arguments), os.environ | environment, files)


SHELL = f"""set -euo pipefail
dyknow() {{ "$PYTHON" -IS {HERE / "launching.py"} "{SERVICE}" "$@"; }}
python() {{ "$PYTHON" "$@"; }}
curl() {{ command curl -sS --fail-with-body "$@"; }}
"""
"""What comes before the commands of a page."""


def shell(commands: str, folder: Path, url: str, **environment: str) -> str:
    """What the commands of a page print, run in ``folder`` beside a service."""
    done = subprocess.run(
        ["bash", "-c", SHELL + commands.replace(URL, url)],
        cwd=folder,
        env=os.environ
        | {"PYTHON": sys.executable, "LAUNCHER": launcher(), "URL": url, "DYKNOW_URL": url}
        | environment,
        capture_output=True,
        text=True,
        timeout=HANGS,
    )
    assert done.returncode == 0, (done.stdout, done.stderr)
    return done.stdout


class Serving:
    """One run of the service, over a data directory unless ``data`` is None; ``lines`` is what it
    wrote to standard error by now."""

    def __init__(
        self, data: Path | None, *arguments: str, program: str = SERVICE, **environment: str
    ) -> None:
        kept = [] if data is None else ["--data", str(data)]
        given = ["serve", "--port", "0", *kept, *arguments]
        reading, writing = os.pipe()
        try:
            variables = {"DYKNOW_LOG_JSON": "true", **environment}
            self.process = launch(*given, program=program, stderr=writing, **variables)
        finally:
            os.close(writing)
        self._stderr = open(reading)  # noqa: SIM115 - closed at the end of the process
        self.lines: list[str] = []
        self.url = ""
        for line in self._stderr:
            self.lines.append(line)
            found = ANYWHERE.search(line)
            if found is not None:
                self.url = found[0]
                break
        assert self.url, self.lines
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self.http = asking(self.url)

    def __enter__(self) -> Serving:
        return self

    def __exit__(self, *_: object) -> None:
        self.kill()

    @property
    def log(self) -> str:
        """What it wrote to standard error by now."""
        return "".join(self.lines)

    def until(self, found, seconds: float = PATIENCE):
        """What ``found()`` gives as soon as that is true."""
        return until(found, seconds, self.lines)

    def kill(self) -> None:
        self._end(signal.SIGKILL)

    def stop(self) -> int:
        return self._end(signal.SIGTERM)

    def _end(self, sign: signal.Signals) -> int:
        """Send a signal, wait for the end, and return the exit code."""
        self.http.close()
        self.process.send_signal(sign)
        code = self.process.wait()
        self._reader.join()
        self._stderr.close()
        return code

    def _read(self) -> None:
        for line in self._stderr:
            self.lines.append(line)
