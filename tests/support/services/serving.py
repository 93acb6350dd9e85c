"""`dyknow serve` as a process of its own, for tests that kill it, or do what a page says."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import httpx
from waiting import PATIENCE, until

COMMAND = "from dyknow.service.cli import main; main()"


class Serving:
    """One run of the service, over a data directory unless ``data`` is None; ``lines`` is what it
    wrote to standard error by now."""

    def __init__(self, data: Path | None, *arguments: str, **environment: str) -> None:
        kept = [] if data is None else ["--data", str(data)]
        self.process = subprocess.Popen(
            [sys.executable, "-c", COMMAND, "serve", "--port", "0", *kept, *arguments],
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "DYKNOW_LOG_JSON": "true", **environment},
        )
        self.lines: list[str] = []
        self.url = ""
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)
            found = re.search(r"serves at (http://\S+)", line)
            if found is not None:
                self.url = found[1]
                break
        assert self.url, self.lines
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        self.http = httpx.Client(base_url=self.url, trust_env=False, timeout=120)

    def until(self, found, seconds: float = PATIENCE):
        """What ``found()`` gives as soon as that is true."""
        return until(found, seconds, self.lines)

    def kill(self) -> None:
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        self._end(signal.SIGTERM)

    def _end(self, sign: signal.Signals) -> None:
        self.http.close()
        self.process.send_signal(sign)
        self.process.wait()
        self._reader.join()
        assert self.process.stderr is not None
        self.process.stderr.close()

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines.append(line)
